"""Which answers change when a threshold of the diagnosis is 30 % smaller or larger.

A threshold that is only compared with changes an answer only where a comparison comes out otherwise.  So every set is asked once
with all thresholds *watched*: each comparison is made with the threshold as it is, 30 % smaller and 30 % larger, and only sets in
which one comes out otherwise are asked again with that threshold.  Where a threshold enters a computation (a prior, a grid) its effect
cannot be watched: those are asked again on all sets.  Where it is not even read, the answer is the same.  Answers are kept, so the run
may be broken off (``--minutes``) and taken up again; ``again`` says how many are still to be asked.

    python benchmarks/diagnosis_sensitivity.py watch SETS... --out ANSWERS [--minutes 10]
    python benchmarks/diagnosis_sensitivity.py again SETS... --out ANSWERS [--minutes 10] [--first SET,SET...]
    python benchmarks/diagnosis_sensitivity.py table SETS... --out ANSWERS     (into docs/diagnosis.md)

SETS are folders of `diagnosis_labelled` or `diagnosis_unseen`; the first one counts as labelled, the others as unseen.
"""

from __future__ import annotations

import argparse
import json
import operator
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from stopset.offline.diagnose import thresholds as limit  # before anything that copies a default from it

FACTORS = {"less": 0.7, "more": 1.3}
PAGE = Path(__file__).parents[1] / "docs" / "diagnosis.md"
FLIPPED: dict[str, set[str]] = {}  # threshold -> factors that turn a comparison round
LEAKED: set[str] = set()  # thresholds that entered a computation


def varied(value: Any, factor: float) -> Any:
    """A threshold ``factor`` times as large; of a count the nearest other one."""
    if isinstance(value, tuple):
        return tuple(varied(v, factor) for v in value)
    if isinstance(value, int):
        return round(value * factor) if round(value * factor) != value else value + (1 if factor > 1 else -1)
    return value * factor


class Watched:
    """A number with what it would be if a threshold behind it were another: ``other`` by threshold and factor."""

    def __init__(self, value: Any, other: dict[tuple[str, str], Any]) -> None:
        self.value, self.other = value, other

    @staticmethod
    def of(name: str, value: Any) -> Watched:
        return Watched(value, {(name, change): varied(value, f) for change, f in FACTORS.items()})

    def _leak(self) -> Any:
        LEAKED.update(name for name, _ in self.other)
        return self.value

    def __format__(self, spec: str) -> str:
        return format(self.value, spec)

    def __float__(self) -> float:
        return float(self._leak())

    def __index__(self) -> int:
        return operator.index(self._leak())

    def __hash__(self) -> int:
        return hash(self._leak())

    def __array__(self, *_: Any, **__: Any) -> Any:
        return np.asarray(self._leak())

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        if method == "__call__" and ufunc in UFUNCS and not options:
            return applied(UFUNCS[ufunc], *inputs)
        plain = [x._leak() if isinstance(x, Watched) else x for x in inputs]
        return getattr(ufunc, method)(*plain, **options)


COMPARE = (operator.lt, operator.le, operator.gt, operator.ge, operator.eq, operator.ne)
ARITHMETIC = (operator.add, operator.sub, operator.mul, operator.truediv)
UFUNCS = {
    np.less: operator.lt, np.less_equal: operator.le, np.greater: operator.gt, np.greater_equal: operator.ge,
    np.equal: operator.eq, np.not_equal: operator.ne, np.add: operator.add, np.subtract: operator.sub,
    np.multiply: operator.mul, np.true_divide: operator.truediv,
}  # fmt: skip


def applied(op: Callable[[Any, Any], Any], a: Any, b: Any) -> Any:
    """An operation with watched numbers: watched again, or, of a comparison, plain and noted where it would come out otherwise."""
    if op in ARITHMETIC and any(isinstance(x, np.ndarray) and x.ndim for x in (a, b)):
        return op(*(x._leak() if isinstance(x, Watched) else x for x in (a, b)))
    keys = {k for x in (a, b) if isinstance(x, Watched) for k in x.other}

    def at(x: Any, key: tuple[str, str] | None) -> Any:
        return x if not isinstance(x, Watched) else x.other.get(key, x.value) if key else x.value

    result = op(at(a, None), at(b, None))
    others = {key: op(at(a, key), at(b, key)) for key in keys}
    if op not in COMPARE:
        return Watched(result, others)
    for (name, change), other in others.items():
        if np.any(other != result):
            FLIPPED.setdefault(name, set()).add(change)
    return result


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


def sets(folders: list[Path]) -> dict[str, Path]:
    """Name of each set, with its folder's."""
    return {f"{f.name}.{s}": f / s for f in folders for s in sorted(json.loads((f / "labels.json").read_text()))}


def asked(path: Path) -> list[str]:
    """The answer: verdict, then what is named, in order."""
    from stopset.offline.description import load_robot
    from stopset.recording import read_recordings

    question = import_module("stopset.offline.diagnose.diagnose")
    question.blind_spots = lambda *_: ()  # what these recordings cannot tell changes neither verdict nor names
    robot = load_robot(path / "robot.urdf")
    found = question.diagnose(robot, read_recordings(path / "recording.parquet", robot))
    return [found.verdict, *(r.label for r in found.ranked)]


def watch(known: dict[str, Path], out: Path, until: float) -> None:
    """Ask sets once, all thresholds watched that were not watched in them before."""
    settled = {t.name: getattr(limit, t.name) for t in limit.TABLE}
    for key, path in known.items():
        file = out / f"{key}.watched.json"
        before = json.loads(file.read_text()) if file.exists() else {"flipped": {}, "leaked": [], "watched": []}
        new = [name for name in settled if name not in before["watched"]]
        if not new or time.monotonic() > until:
            continue
        for name, value in settled.items():
            parts = tuple(Watched.of(name, v) for v in value) if isinstance(value, tuple) else Watched.of(name, value)
            setattr(limit, name, parts if name in new else value)
        FLIPPED.clear()
        LEAKED.clear()
        answer = asked(path)
        if before.get("answer", answer) != answer:
            raise SystemExit(f"{key}: {answer}, but {before['answer']} when it was watched before; expected the same: begin anew")
        flipped = before["flipped"] | {n: sorted(w) for n, w in FLIPPED.items()}
        leaked = sorted({*before["leaked"], *LEAKED})
        file.write_text(json.dumps({"answer": answer, "flipped": flipped, "leaked": leaked, "watched": list(settled)}))
        print(key, answer, flush=True)


def again(todo: list[tuple[str, str, str]], known: dict[str, Path], out: Path, until: float) -> None:
    """Ask sets again with one threshold another: (set, threshold, factor)."""
    for k, (key, name, change) in enumerate(todo):
        if time.monotonic() > until:
            print(f"{len(todo) - k} still to be asked", flush=True)
            return
        settled = getattr(limit, name)
        setattr(limit, name, varied(settled, FACTORS[change]))
        try:
            answer = asked(known[key])
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:  # a value that the code cannot work with
            answer = [f"no answer: {error}"]
        setattr(limit, name, settled)
        (out / f"{key}.{name}.{change}.json").write_text(json.dumps(answer))


def read(folders: list[Path], out: Path) -> dict[str, Any]:
    """What was watched so far, by set."""
    files = {key: out / f"{key}.watched.json" for key in sets(folders)}
    return {key: json.loads(f.read_text()) for key, f in files.items() if f.exists()}


def open_to(watched: Mapping[str, Any], name: str, change: str) -> bool:
    """Whether a set's answer may change with a threshold: one that entered a computation, turned a comparison round, or was not watched."""
    return name not in watched["watched"] or name in watched["leaked"] or change in watched["flipped"].get(name, ())


def work(folders: list[Path], out: Path, first: set[str]) -> list[tuple[str, str, str]]:
    """(set, threshold, factor) to ask: where a decision is near before what is open to most sets, the sets of ``first`` before others."""
    watched = read(folders, out)
    openings = [
        (key, t.name, change) for key, w in watched.items() for t in limit.TABLE for change in FACTORS if open_to(w, t.name, change)
    ]  # fmt: skip
    count = Counter(name for _, name, _ in openings)
    jobs = [(key, name, change) for key, name, change in openings if not (out / f"{key}.{name}.{change}.json").exists()]
    return sorted(jobs, key=lambda j: (count[j[1]] > len(watched), bool(first) and j[0] not in first))


def table(folders: list[Path], out: Path) -> str:
    """The table of docs: which answers change with each threshold, of how many sets whose answer to that is known."""
    watched = read(folders, out)
    rows, still, later = [], [], []
    for t in limit.TABLE:
        cells, fewest, changes = [], len(watched), 0
        for change in FACTORS:
            files = {key: out / f"{key}.{t.name}.{change}.json" for key in watched}
            new = {key: json.loads(f.read_text()) for key, f in files.items() if f.exists()}
            known = set(new) | {key for key, w in watched.items() if not open_to(w, t.name, change)}
            changed = [f"{key.partition('.')[2]} {_words(watched[key]['answer'])} → {_words(a)}"
                       for key, a in new.items() if a != watched[key]["answer"]]  # fmt: skip
            fewest, changes = min(fewest, len(known)), changes + len(changed)
            cells.append(f"{len(changed)} of {len(known)}{': ' * bool(changed)}{'; '.join(changed)}")
        if changes:
            rows.append(f"| `{t.name}` | " + " | ".join(cells) + " |")
        elif fewest:
            still.append(f"`{t.name}`" + (f" ({fewest})" if fewest < len(watched) else ""))
        else:
            later.append(f"`{t.name}`")
    head = ["| threshold | 30 % less | 30 % more |", "|---|---|---|", *rows, ""] if rows else []
    head.append(
        f"No answer changes of {len(watched)} sets (of fewer, where a number stands in brackets) with 30 % of {', '.join(still)}."
    )
    if later:
        head.append(f"Not asked yet: {', '.join(later)}.")
    return "\n".join(head)


def _words(answer: list[str]) -> str:
    return " ".join(answer[:1] if len(answer) == 1 else answer[1:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("watch", "again", "table"))
    parser.add_argument("sets", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--first", default="", help="sets to ask again before the others")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no other question after this time")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    known, until = sets(args.sets), time.monotonic() + 60 * args.minutes
    if args.command == "watch":
        watch(known, args.out, until)
    elif args.command == "again":
        again(work(args.sets, args.out, set(filter(None, args.first.split(",")))), known, args.out, until)
    else:
        text = PAGE.read_text(encoding="utf-8")
        mark = "<!-- sensitivity: made by benchmarks/diagnosis_sensitivity.py -->\n"
        made = table(args.sets, args.out)
        PAGE.write_text(re.sub(f"({re.escape(mark)}).*?(\n<!-- end -->)", lambda m: m[1] + made + m[2], text, flags=re.S))


if __name__ == "__main__":
    main()
