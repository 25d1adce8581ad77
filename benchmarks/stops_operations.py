"""What a STOP 0 bound asks of the core where the kinetic energy has to help: tubes, steps, pivots, rows; and how many operations these are at least.

    python benchmarks/stops_operations.py [--states 20]

The core is compiled for gcov, which counts calls: the same numbers on every machine, however busy. Operations are multiplications and
additions of four numbers at once, in the loops of `OPERATIONS` alone: sines, divisions, comparisons, choices, loads, and all that is done one
number at a time come on top.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms_wide import arms

from stopset.core.build import SOURCES
from stopset.reach.stops import StopBounds
from stopset.reach.stops.compiled import CompiledStops

ARMS = ("UR10e-like", "cobot of seven joints")
FLAGS = (
    "-std=c11",
    "-O0",
    "--coverage",
    "-DSTOPSET_NARROW",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fPIC",
    '-DSTOPSET_SOURCES="counted"',
    "-w",
)
SHOWN = {
    "tubes": "tube.c march", "steps": "tube.c take_step", "boxes": "local.c box_terms", "exchanges": "pulls.c exchange",
    "subsets in them": "pulls.c rows_read", "columns": "related.c stops_related", "rows of subsets in them": "related.c row_of",
    "pivots": "related.c pivot_values", "with slopes": "related.c pivot_slopes",
}  # fmt: skip


def fours(n: int) -> int:
    return -(-n // 4)


def bends(n: int) -> int:
    """Of second slopes: a row of those behind joint i for each of its pairs."""
    return sum((n - i) * fours(n - 1 - i) * (n - 1 - i) * 2 for i in range(n - 1))


# of one call, by the arm's joints: see the loops
OPERATIONS: dict[str, Callable[[int], int]] = {
    "related.c pivot_values": lambda n: 2 * n * fours(n),
    "related.c pivot_slopes": lambda n: 4 * fours(n + 1) * n * (n + 1) // 2,
    "related.c symbol_of": lambda n: 5 * fours(n),
    "related.c coriolis": lambda n: 3 * n * n * fours(n),
    "related.c row_of": lambda n: 6 * fours(n + 1),
    "pulls.c rows_read": lambda n: 10 * n * fours(n),
    "pulls.c add_slopes": lambda n: 4 * (n - 1),
    "local.c velocity_terms": lambda n: 19 * fours(n) * n * (n + 1) // 2,
    "local.c sum_bends": bends,
    "moving.c visit": lambda n: 10 * fours(n),
}


def compiled(folder: Path) -> Path:
    """The core with counters."""
    objects = []
    for file in sorted(SOURCES.rglob("*.c")):
        objects.append(folder / f"{file.parent.name}_{file.stem}.o")
        subprocess.run(["gcc", *FLAGS, "-c", str(file), "-o", str(objects[-1])], check=True)
    library = folder / "counted.so"
    subprocess.run(["gcc", "-shared", "--coverage", *map(str, objects), "-o", str(library)], check=True)
    return library


def ask(name: str, least: float, states: int) -> None:
    """The bounds that are counted: measured states, payloads from ``least`` of the rated one."""
    model, top = arms()[name]
    rated, n, rng = model.domain.payload[1], model.n, np.random.default_rng(1)
    setting = StopBounds.of(model, (least * rated, rated)).setting
    assert setting is not None
    core = CompiledStops.of(setting)
    for _ in range(states):
        core.bound(rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top)


def calls_in(folder: Path, library: Path, command: list[str]) -> dict[str, int]:
    """Calls of every function of the core's stops while ``command`` runs."""
    for old in folder.glob("*.gcda"):
        old.unlink()
    subprocess.run(command, check=True, env={**os.environ, "STOPSET_CORE": str(library)})
    files = sorted(str(x) for x in folder.glob("stops_*.gcda"))
    told = subprocess.run(
        ["gcov", "--json-format", "--stdout", *files], check=True, capture_output=True, text=True, cwd=folder
    ).stdout
    return {
        f"{Path(file['file']).name} {f['name']}": f["execution_count"]
        for line in told.splitlines()
        if line.strip()
        for file in json.loads(line)["files"]
        for f in file["functions"]
    }


def counted(folder: Path, library: Path, name: str, least: float, states: int) -> dict[str, float]:
    """Calls of every function of the core, per bound."""
    command = [sys.executable, __file__, "--ask", name, str(least), "--states", str(states)]
    return {f: calls / states for f, calls in calls_in(folder, library, command).items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=int, default=20)
    parser.add_argument("--ask", nargs=2, metavar=("ARM", "LEAST"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.ask:
        ask(args.ask[0], float(args.ask[1]), args.states)
        return
    if args.states < 1:
        parser.error(f"{args.states} states; expected at least one: what is counted is told of one bound")
    if not shutil.which("gcc") or not shutil.which("gcov"):
        parser.error("no gcc and gcov here; expected both, they count")
    print(f"of one STOP 0 bound, {args.states} measured states: calls; millions of operations on four numbers at once, at least")
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        library = compiled(folder)
        for name in ARMS:
            model = arms()[name][0]
            for least in (0.98, 0.0):
                calls = counted(folder, library, name, least, args.states)
                operations = sum(calls[f] * of(model.n) for f, of in OPERATIONS.items())
                said = ", ".join(f"{what} {calls[f]:.0f}" for what, f in SHOWN.items())
                print(f"  {name}, {least:.0%} to 100 % of its load: {said}; {operations / 1e6:.1f}", flush=True)


if __name__ == "__main__":
    main()
