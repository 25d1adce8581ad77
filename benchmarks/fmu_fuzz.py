"""The FMU of any model called in any order with any values, under the sanitizers and under valgrind: what tests/test_fmu_fuzz.py does.

Run: python benchmarks/fmu_fuzz.py MODEL.model.json ... --runs 200 --valgrind 10
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from stopset.artifact import Model, load_model
from stopset.fmu.stops import stop_refusal

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from test_fmu_fuzz import SANITIZE, VALGRIND, fuzzers, held_against_python


def main() -> int:
    """One line per model and checker; 1 where one found something."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--runs", type=int, default=200, help="of 60 calls each, under the sanitizers")
    parser.add_argument("--valgrind", type=int, default=10, help="of them under valgrind, which takes some forty times as long")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    found = 0
    for path in args.models:
        model = load_model(path)
        found += checked(model, path.name, "sanitizers", SANITIZE, [], (args.seed, args.runs))
        if args.valgrind and shutil.which("valgrind"):
            found += checked(model, path.name, "valgrind", [], VALGRIND, (args.seed, args.valgrind))
    return int(found > 0)


def checked(model: Model, name: str, checker: str, flags: list[str], runner: list[str], seeds: tuple[int, int]) -> int:
    """How many of the fuzzers of FMI 2 and 3 found something, came by no bound of a model that has some, or by one that is not Python's."""
    found = 0
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) / "kept"
        for fmi, program in zip((2, 3), fuzzers(Path(folder), model, *flags), strict=True):
            begin = time.perf_counter()
            done = subprocess.run(
                [*runner, *program, *map(str, seeds), str(kept)], capture_output=True, text=True, check=False,
                env={**os.environ, "ASAN_OPTIONS": "detect_leaks=1"},
            )  # fmt: skip
            good = done.returncode == 0 and done.stdout.startswith("ok")
            said = done.stdout.strip() if good else done.stdout[-1000:] + done.stderr[-3000:]
            took = time.perf_counter() - begin
            if good and not stop_refusal(model):
                equal, bounds = held_against_python(model, kept)
                said += f"; {equal} of {bounds} bounds are Python's to the last bit"
                good = equal == bounds and (bounds > 0 or bool(runner))  # few runs are made under valgrind
            print(f"{name}, FMI {fmi}, {checker}, {seeds[1]} runs in {took:.0f} s: {said}", flush=True)
            found += not good
    return found


if __name__ == "__main__":
    sys.exit(main())
