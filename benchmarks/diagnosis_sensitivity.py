"""Which answers change when a threshold of the diagnosis is 30 % smaller or larger.

Every set is asked once, with thresholds that know what they would be 30 % smaller and larger.  Where a comparison with one would come
out otherwise, and where one enters a computation, the process forks, and the child goes on with that threshold changed: rows, columns
and fits that were made before are its own.  Where nothing forks nothing can differ.  The answers go to diagnosis_sensitivity.json
beside this script, set by set, so a run may be broken off and taken up again; `doc_tables` makes the table of docs from it.

    python benchmarks/diagnosis_sensitivity.py SETS... [--minutes 10] [--only d01,p03]

SETS are folders of `diagnosis_labelled` or `diagnosis_unseen`.
"""

from __future__ import annotations

import argparse
import json
import operator
import os
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar
from unittest.mock import patch

import numpy as np
from diagnosis_labelled import right

from stopset.files import write_text
from stopset.offline.diagnose import thresholds as limit  # before anything that copies a default from it

FACTORS = {"less": 0.7, "more": 1.3}
STORED = Path(__file__).with_suffix(".json")
Key = tuple[str, str]  # threshold, one of `FACTORS`


def varied(value: Any, factor: float) -> Any:
    """A threshold ``factor`` times as large; of a count the nearest other one."""
    if isinstance(value, tuple):
        return tuple(varied(v, factor) for v in value)
    if isinstance(value, int):
        return round(value * factor) if round(value * factor) != value else value + (1 if factor > 1 else -1)
    return value * factor


class Walk:
    """One process's walk through a question: ``branch`` is the threshold that is another one in it; None: all are as they are."""

    branch: ClassVar[Key | None] = None
    parted: ClassVar[set[Key]] = set()
    read: ClassVar[set[str]] = set()

    @classmethod
    def part(cls, keys: Iterable[Key]) -> None:
        """Where the walk with another threshold parts from this one: a child goes on there, and is waited for."""
        if cls.branch is not None:
            return
        for key in sorted(set(keys) - cls.parted):
            cls.parted.add(key)
            pid = os.fork()
            if pid == 0:
                cls.branch = key
                for t in limit.TABLE:  # from here on nothing is watched
                    setattr(limit, t.name, settled(t.value))
                return
            if os.waitpid(pid, 0)[1]:
                raise SystemExit(f"the walk with another {key[0]} broke off")


class Watched:
    """A number with what it would be if a threshold behind it were another: ``other`` by threshold and factor."""

    def __init__(self, value: Any, other: dict[Key, Any]) -> None:
        self.value, self.other = value, other

    @staticmethod
    def of(name: str, value: Any) -> Any:
        """A threshold watched; of a grid every number of it."""
        if isinstance(value, tuple):
            return tuple(Watched.of(name, v) for v in value)
        return Watched(value, {(name, change): varied(value, f) for change, f in FACTORS.items()})

    def at(self, key: Key | None) -> Any:
        return self.value if key is None else self.other.get(key, self.value)

    def plain(self) -> Any:
        """The number for a computation that cannot be watched."""
        Walk.read.update(name for name, _ in self.other)
        Walk.part(self.other)
        return self.at(Walk.branch)

    def __abs__(self) -> Any:
        if Walk.branch is not None:
            return abs(self.at(Walk.branch))
        return Watched(abs(self.value), {key: abs(value) for key, value in self.other.items()})

    def __format__(self, spec: str) -> str:
        return format(self.at(Walk.branch), spec)

    def __float__(self) -> float:
        return float(self.plain())

    def __index__(self) -> int:
        return operator.index(self.plain())

    def __hash__(self) -> int:
        return hash(self.plain())

    def __bool__(self) -> bool:
        return bool(self.plain())

    def __array__(self, *_: Any, **__: Any) -> Any:
        return np.asarray(self.plain())

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        if method == "__call__" and ufunc in UFUNCS and not options:
            return applied(UFUNCS[ufunc], *inputs)
        return getattr(ufunc, method)(*(x.plain() if isinstance(x, Watched) else x for x in inputs), **options)


def settled(value: Any) -> Any:
    """A threshold, or a grid of them, as it is in this process's walk."""
    if isinstance(value, tuple):
        return tuple(map(settled, value))
    return value.at(Walk.branch) if isinstance(value, Watched) else value


COMPARE = (operator.lt, operator.le, operator.gt, operator.ge, operator.eq, operator.ne)
ARITHMETIC = (operator.add, operator.sub, operator.mul, operator.truediv)
UFUNCS = {
    np.less: operator.lt, np.less_equal: operator.le, np.greater: operator.gt, np.greater_equal: operator.ge,
    np.equal: operator.eq, np.not_equal: operator.ne, np.add: operator.add, np.subtract: operator.sub,
    np.multiply: operator.mul, np.true_divide: operator.truediv,
}  # fmt: skip


def applied(op: Callable[[Any, Any], Any], a: Any, b: Any) -> Any:
    """An operation with watched numbers: watched again, or, of a comparison, plain, and the walk parts where it comes out otherwise."""
    if op in ARITHMETIC and any(isinstance(x, np.ndarray) and x.ndim for x in (a, b)):
        return op(*(x.plain() if isinstance(x, Watched) else x for x in (a, b)))
    keys = {key for x in (a, b) if isinstance(x, Watched) for key in x.other}
    Walk.read.update(name for name, _ in keys)

    def at(key: Key | None) -> Any:
        return op(*(x.at(key) if isinstance(x, Watched) else x for x in (a, b)))

    if Walk.branch is None and op in COMPARE:
        result = at(None)
        Walk.part(key for key in keys - Walk.parted if np.any(at(key) != result))
    if Walk.branch is not None or op in COMPARE:
        return at(Walk.branch)
    return Watched(at(None), {key: at(key) for key in keys})


def _operators() -> None:
    swapped = {operator.lt: "gt", operator.le: "ge", operator.gt: "lt", operator.ge: "le", operator.eq: "eq", operator.ne: "ne"}
    for op in (*COMPARE, *ARITHMETIC):
        name = op.__name__
        setattr(Watched, f"__{name}__", lambda a, b, op=op: applied(op, a, b))
        if op not in swapped:
            setattr(Watched, f"__r{name}__", lambda a, b, op=op: applied(op, b, a))
    Watched.__neg__ = lambda a: applied(operator.sub, 0.0, a)
    for name in ("pow", "rpow"):
        setattr(Watched, f"__{name}__", lambda a, *b, name=name: getattr(float(a), f"__{name}__")(*b))


_operators()


def asked(path: Path) -> list[str]:
    """The answer: verdict, then what is named, in order."""
    from stopset.offline.description import load_robot
    from stopset.recording import read_recordings

    question = import_module("stopset.offline.diagnose.diagnose")
    robot = load_robot(path / "robot.urdf")
    with patch.object(
        question, "blind_spots", lambda *_: ()
    ):  # what these recordings cannot tell changes neither verdict nor names
        found = question.diagnose(robot, read_recordings(path / "recording.parquet", robot))
    return [found.verdict, *(r.label for r in found.ranked)]


def walks(question: Callable[[], Any], folder: Path) -> None:
    """Answer a question with all thresholds as they are, and with each that may change it; one file each in ``folder``."""
    try:
        answer = question()
    except Exception as error:  # a value that the code cannot work with
        if Walk.branch is None:
            raise
        answer = [f"no answer: {error}"]
    if Walk.branch is None:
        (folder / "as it is.json").write_text(json.dumps({"answer": answer, "read": sorted(Walk.read)}))
    else:
        (folder / f"{'.'.join(Walk.branch)}.json").write_text(json.dumps(answer))
        os._exit(0)


def sensitivity(question: Callable[[], Any]) -> dict[str, Any]:
    """The ``answer``, which thresholds were ``read`` for it, and what is ``changed`` by threshold and factor.

    It is asked in a process of its own: what modules keep in memory rests on the thresholds, too.
    """
    with tempfile.TemporaryDirectory() as folder:
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                walks(question, Path(folder))
                code = 0
            finally:
                if code:
                    traceback.print_exc()
                os._exit(code)
        if os.waitpid(pid, 0)[1]:
            raise SystemExit("the question broke off")
        found = {f.stem: json.loads(f.read_text()) for f in sorted(Path(folder).iterdir())}
    out: dict[str, Any] = found.pop("as it is")
    out["changed"], out["walked"] = {}, len(found)
    for key, answer in found.items():
        name, change = key.split(".")
        if answer != out["answer"]:
            out["changed"].setdefault(name, {})[change] = answer
    return out


def watched(question: Callable[[], Any], names: Iterable[str]) -> Callable[[], Any]:
    """A question with the thresholds ``names`` of the diagnosis watched while it is answered."""

    def answer() -> Any:
        for name in names:
            setattr(limit, name, Watched.of(name, getattr(limit, name)))
        return question()

    return answer


def stored() -> dict[str, Any]:
    """What was asked so far; ``due`` of a set: thresholds that are new since it was asked, or have another value."""
    values = json.loads(json.dumps({t.name: t.value for t in limit.TABLE}))
    out: dict[str, Any] = json.loads(STORED.read_text(encoding="utf-8")) if STORED.exists() else {"values": {}, "sets": {}}
    new = {name for name, value in values.items() if out["values"].get(name) != value}
    for entry in out["sets"].values():
        entry["due"] = sorted((new | set(entry["due"])) & values.keys())
        entry["read"] = [name for name in entry["read"] if name in values and name not in new]
        entry["changed"] = {name: x for name, x in entry["changed"].items() if name in values and name not in new}
    return out | {"values": values}


def asked_again(path: Path, label: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """What is stored of a set, once all thresholds have been asked; ``before``: what is stored of it."""
    found = sensitivity(watched(lambda: asked(path), before["due"]))
    if before.get("answer", found["answer"]) != found["answer"]:
        return asked_again(path, label, {"due": [t.name for t in limit.TABLE]})
    changed = {
        name: {c: {"answer": a, "right": right_of(label, a)} for c, a in x.items()} for name, x in found["changed"].items()
    }
    return {
        "hidden": hidden(label),
        "answer": found["answer"],
        "right": right_of(label, found["answer"]),
        "read": sorted({*before.get("read", ()), *found["read"]}),
        "changed": before.get("changed", {}) | changed,
        "due": [],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", type=Path, nargs="+")
    parser.add_argument("--only", default="", help="comma-separated names of sets")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no other set after this time")
    args = parser.parse_args()
    only, until = set(filter(None, args.only.split(","))), time.monotonic() + 60 * args.minutes
    for folder in args.sets:
        labels = json.loads((folder / "labels.json").read_text())
        for name, label in sorted(labels.items()):
            key = f"{folder.name}/{name}"
            before = stored()["sets"].get(key, {"due": [t.name for t in limit.TABLE]})
            if (only and name not in only) or not before["due"] or time.monotonic() > until:
                continue
            start = sum(os.times()[:4])
            entry = asked_again(folder / name, label, before)
            known = stored()  # another run may have asked other sets meanwhile
            write(known | {"sets": known["sets"] | {key: entry}})
            print(key, entry["answer"], f"{sum(os.times()[:4]) - start:.0f} s:", entry["changed"], flush=True)


def write(known: dict[str, Any]) -> None:
    """Store it, one set a line."""
    sets = ",\n".join(f"  {json.dumps(key)}: {json.dumps(entry)}" for key, entry in sorted(known["sets"].items()))
    write_text(STORED, f'{{\n "values": {json.dumps(known["values"])},\n "sets": {{\n{sets}\n }}\n}}\n')


def hidden(label: dict[str, Any]) -> list[str]:
    """What a set hides, as the diagnosis would name it."""
    return [":".join(filter(None, (e["effect"], "+".join(e["joints"])))) for e in label["effects"]]


def right_of(label: dict[str, Any], answer: list[str]) -> bool:
    """Whether an answer is what its set's label says."""
    parts = [name.partition(":") for name in answer[1:]]
    return right(label, answer[0], [(effect, tuple(filter(None, where.split("+")))) for effect, _, where in parts])


if __name__ == "__main__":
    main()
