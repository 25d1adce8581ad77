"""Which answers change when a threshold of the diagnosis is 30 % smaller or larger.

A threshold that is only compared with changes an answer only where a comparison comes out otherwise.  So every set is asked once
with all thresholds *watched*: each comparison is made with the threshold as it is, 30 % smaller and 30 % larger, and only sets in
which one comes out otherwise are asked again with that threshold.  Where a threshold enters a computation (a prior, a grid) its effect
cannot be watched: those are asked again on all sets of ``--few``.  Answers are kept, so the run may be broken off and taken up again.

    python benchmarks/diagnosis_sensitivity.py watch SETS... --out ANSWERS [--parallel 2]
    python benchmarks/diagnosis_sensitivity.py again SETS... --out ANSWERS [--few SET,SET...]
    python benchmarks/diagnosis_sensitivity.py table SETS... --out ANSWERS     (into docs/diagnosis.md)

SETS are folders of `diagnosis_labelled` or `diagnosis_unseen`; the first one counts as labelled, the others as unseen.
"""

from __future__ import annotations

import argparse
import json
import operator
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
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
    for name in ("neg", "pow", "rpow"):
        setattr(Watched, f"__{name}__", lambda a, *b, name=name: getattr(float(a), f"__{name}__")(*b))


_operators()


def sets(folders: list[Path]) -> dict[str, Path]:
    """Name of each set, with its folder's."""
    return {f"{f.name}.{s}": f / s for f in folders for s in sorted(json.loads((f / "labels.json").read_text()))}


def asked(path: Path) -> list[str]:
    """The answer: verdict, then what is named, in order."""
    from stopset.offline.description import load_robot
    from stopset.offline.diagnose import diagnose
    from stopset.recording import read_recordings

    robot = load_robot(path / "robot.urdf")
    found = diagnose(robot, read_recordings(path / "recording.parquet", robot))
    return [found.verdict, *(r.label for r in found.ranked)]


def watch(todo: dict[str, Path], out: Path) -> None:
    """Ask sets once, all thresholds watched that are single numbers."""
    names = [t.name for t in limit.TABLE if not isinstance(t.value, tuple)]
    for name in names:
        setattr(limit, name, Watched.of(name, getattr(limit, name)))
    for key, path in todo.items():
        FLIPPED.clear()
        LEAKED.clear()
        answer = asked(path)
        said = {"answer": answer, "flipped": {n: sorted(w) for n, w in FLIPPED.items()}, "leaked": sorted(LEAKED)}
        (out / f"{key}.watched.json").write_text(json.dumps(said))
        print(key, answer, flush=True)


def vary(name: str, change: str, todo: dict[str, Path], out: Path) -> None:
    """Ask sets again with one threshold another."""
    setattr(limit, name, varied(getattr(limit, name), FACTORS[change]))
    for key, path in todo.items():
        try:
            answer = asked(path)
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:  # a value that the code cannot work with
            answer = [f"no answer: {error}"]
        (out / f"{key}.{name}.{change}.json").write_text(json.dumps(answer))


def read(folders: list[Path], out: Path) -> dict[str, Any]:
    """What was watched so far, by set."""
    files = {key: out / f"{key}.watched.json" for key in sets(folders)}
    return {key: json.loads(f.read_text()) for key, f in files.items() if f.exists()}


def work(folders: list[Path], out: Path, few: set[str]) -> Iterator[tuple[str, str, list[str]]]:
    """Threshold, factor and the sets to ask again with it."""
    watched = read(folders, out)
    leaked = {n for w in watched.values() for n in w["leaked"]} | {t.name for t in limit.SETTLED if isinstance(t.value, tuple)}
    for t in limit.SETTLED:
        for change in FACTORS:
            keys = [
                key for key, w in watched.items()
                if (key in few or not few if t.name in leaked else change in w["flipped"].get(t.name, ()))
            ]  # fmt: skip
            yield t.name, change, keys


def parts(todo: dict[str, Path], count: int) -> list[dict[str, Path]]:
    return [dict(list(todo.items())[k::count]) for k in range(count)]


def table(folders: list[Path], out: Path) -> str:
    """The table of docs: which answers change with each threshold, of how many sets whose answer to that is known."""
    watched = read(folders, out)
    leaked = {n for w in watched.values() for n in w["leaked"]} | {t.name for t in limit.SETTLED if isinstance(t.value, tuple)}
    rows, still, later = [], [], []
    for t in limit.SETTLED:
        cells, fewest, changes = [], len(watched), 0
        for change in FACTORS:
            files = {key: out / f"{key}.{t.name}.{change}.json" for key in watched}
            new = {key: json.loads(f.read_text()) for key, f in files.items() if f.exists()}
            known = set(new)
            if t.name not in leaked:  # without a comparison that comes out otherwise the answer is the same
                known |= {key for key, w in watched.items() if change not in w["flipped"].get(t.name, ())}
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
    parser.add_argument("command", choices=("watch", "again", "table", "_watch", "_vary"))
    parser.add_argument("sets", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--few", default="", help="sets asked again where a threshold cannot be watched; all, unless given")
    parser.add_argument("--parallel", type=int, default=2)
    parser.add_argument("--job", default="")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    known = sets(args.sets)
    if args.command == "_watch":
        return watch({k: known[k] for k in args.job.split(",")}, args.out)
    if args.command == "_vary":
        name, change, keys = args.job.split(":")
        return vary(name, change, {k: known[k] for k in keys.split(",")}, args.out)
    if args.command == "table":
        text = PAGE.read_text(encoding="utf-8")
        mark = "<!-- sensitivity: made by benchmarks/diagnosis_sensitivity.py -->\n"
        PAGE.write_text(
            re.sub(
                f"({re.escape(mark)}).*?(\n<!-- end -->)", lambda m: m[1] + table(args.sets, args.out) + m[2], text, flags=re.S
            )
        )
        return None
    if args.command == "watch":
        todo = {k: p for k, p in known.items() if not (args.out / f"{k}.watched.json").exists()}
        jobs = [("_watch", ",".join(part)) for part in parts(todo, args.parallel) if part]
    else:
        jobs = []
        for name, change, keys in work(args.sets, args.out, set(filter(None, args.few.split(",")))):
            keys = [k for k in keys if not (args.out / f"{k}.{name}.{change}.json").exists()]
            jobs += [("_vary", f"{name}:{change}:{','.join(keys)}")] if keys else []
    running: list[subprocess.Popen[bytes]] = []
    for k, (command, job) in enumerate(jobs):
        print(f"{k + 1} of {len(jobs)}: {job[:100]}", flush=True)
        words = [sys.executable, __file__, command, *map(str, args.sets), "--out", str(args.out), "--job", job]
        running.append(subprocess.Popen(words, env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}))
        while sum(p.poll() is None for p in running) >= args.parallel:
            running[-args.parallel].wait() if len(running) >= args.parallel else running[0].wait()
            running = [p for p in running if p.poll() is None]
    for p in running:
        p.wait()
    return None


if __name__ == "__main__":
    main()
