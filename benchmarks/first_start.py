"""What the first start costs: commands in a copy of the tree without any compiled Python, then again, and a fresh process's first stop.

Nothing of the core is compiled at run time, so cold is: no ``__pycache__`` of stopset, libraries as they were installed.  Wall and
processor seconds and peak memory of each process and its children, cold | warm.
Run: python benchmarks/first_start.py [--data REC.parquet] [--demo]
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("model", "offline", "monitor", "fmu")
FIRST_STOP = """
import sys
import numpy as np
from stopset.artifact import load_model
from stopset.reach.stops import StopBounds
model = load_model(sys.argv[1])
bound = StopBounds.of(model).bound(model.domain.q.centre, 0.5 * model.domain.dq.hi, "0")
print(bound.certified, bound.angle)
"""


def copied(where: Path) -> dict[str, str]:
    """The tree without compiled Python, and the environment in which it is the one that runs."""
    for part in PARTS:
        shutil.copytree(ROOT / part, where / part, ignore=shutil.ignore_patterns("__pycache__"))
    return {**os.environ, "PYTHONPATH": os.pathsep.join(str(where / part) for part in PARTS), "OPENBLAS_NUM_THREADS": "1"}


def cost(words: Sequence[str | Path], env: dict[str, str], where: Path) -> tuple[float, float, float]:
    """Wall and processor seconds, peak MiB. Raises `RuntimeError` if the command fails."""
    start = time.monotonic()
    with (where / "said.txt").open("wb") as said:
        child = subprocess.Popen([sys.executable, *map(str, words)], env=env, cwd=where, stdout=said, stderr=subprocess.STDOUT)
        _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    answers = (0,) if "demo" in words else (0, 1)  # 1: the answer is "no"; of the demo, that it failed
    if child.returncode not in answers:
        raise RuntimeError(f"{words}: {(where / 'said.txt').read_text()[-500:]}")
    return time.monotonic() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


class Cost(NamedTuple):
    """Of one command: wall and processor seconds, peak MiB; first without compiled Python, then again."""

    name: str
    cold: tuple[float, float, float]
    warm: tuple[float, float, float]


def costs(data: Path | None, robot: str, *, demo: bool) -> Iterator[Cost]:
    """Of each command on recordings ``data`` of a real arm, else on a simulated campaign; a table's head is printed."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        cli = ("-m", "stopset.cli.main")
        made, model = work / "made", work / "m.json"
        plain = copied(work / "setup")
        cost([*cli, "simulate", "--plan", "short", "--seed", "1", "--out", made], plain, work)
        data, described = (data.resolve(), robot) if data else (made / "recording.parquet", str(made / "robot.urdf"))
        jobs: list[tuple[str, list[str | Path]]] = [
            ("stopset --help", [*cli, "--help"]),
            ("inspect", [*cli, "inspect", data]),
            ("identify", [*cli, "identify", "--data", data, "--robot", described, "--accept-wide", "--out", model]),
            ("compare", [*cli, "compare", model, "--data", data]),
            ("stops --at, STOP 0", [*cli, "stops", model, "--category", "0", "--at", "0,0.3,0.3,0,0.3,0", "--speed", "50%"]),
            ("first stop bound of a process", ["-c", FIRST_STOP, model]),
        ]
        if demo:
            jobs.append(("demo", [*cli, "demo", "--out", work / "demo"]))
        print(f"{'':32} {'cold: wall':>10} {'cpu s':>7} {'MiB':>6}   {'warm: wall':>10} {'cpu s':>7}   cold/warm cpu")
        for k, (name, words) in enumerate(jobs):
            env = copied(work / f"cold-{k}")
            yield Cost(name, cost(words, env, work), cost(words, env, work))


def arguments(doc: str | None) -> argparse.ArgumentParser:
    """Which recordings: those of a real arm, or simulated ones."""
    parser = argparse.ArgumentParser(description=doc)
    parser.add_argument("--data", type=Path, help="recordings of a real arm, with --robot; else a simulated campaign")
    parser.add_argument("--robot", default="lwa4p")
    return parser


def line(c: Cost) -> str:
    """A row of the table."""
    cold, warm = c.cold, c.warm
    return f"{c.name:32} {cold[0]:10.2f} {cold[1]:7.2f} {cold[2]:6.0f}   {warm[0]:10.2f} {warm[1]:7.2f}   {cold[1] / warm[1]:.2f}"


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--demo", action="store_true", help="the demo too, a minute or two")
    args = parser.parse_args()
    for c in costs(args.data, args.robot, demo=args.demo):
        print(line(c), flush=True)


if __name__ == "__main__":
    main()
