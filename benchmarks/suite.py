"""How long the tests take, by file: what a run cost by the clock, how much of it its processes computed, and where the rest went.

    python benchmarks/suite.py                  # runs all tests, as `./run test` does in an environment that stands
    python benchmarks/suite.py --read tests.xml # of a run with --junitxml tests.xml; then without processor time

Sums of tests' own times: of two workers at once each, so twice the clock where none waits for work.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]


def spent(report: Path) -> Counter[str]:
    """[s] of each test file, set-up and tear-down of its tests included."""
    out: Counter[str] = Counter()
    for case in ElementTree.parse(report).iter("testcase"):
        out[case.get("classname", "").split(".")[-1]] += float(case.get("time", 0.0))
    return out


def run(report: Path) -> tuple[float, float]:
    """[s] by the clock and of processors, of the run that writes the report."""
    begin = time.monotonic()
    # a run with failures is a run, too: pytest has said which
    subprocess.run([sys.executable, "-m", "pytest", f"--junitxml={report}"], cwd=ROOT, check=False)
    of = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.monotonic() - begin, of.ru_utime + of.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--read", type=Path, metavar="XML")
    parser.add_argument("--files", type=int, default=25, help="how many of the dearest are printed")
    args = parser.parse_args()
    if args.read and not args.read.is_file():
        parser.error(f"{args.read} is not there; expected what a run with --junitxml wrote")
    with tempfile.TemporaryDirectory() as folder:
        report = args.read or Path(folder) / "tests.xml"
        if not args.read:
            clock, processor = run(report)
            print(f"{clock / 60:.1f} min by the clock, {processor / 60:.1f} min of processors, {os.cpu_count()} of them here")
        files = spent(report)
    whole = sum(files.values())
    print(f"{whole / 60:.1f} min of tests in {len(files)} files; the dearest, in s:")
    for name, seconds in files.most_common(args.files):
        print(f"  {name:40} {seconds:6.0f}  {seconds / whole:4.0%}")


if __name__ == "__main__":
    main()
