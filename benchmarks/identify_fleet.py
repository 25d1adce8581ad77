"""A hundred arms identified and diagnosed with one command, in so many processes of this machine, and whether it was as alone.

python benchmarks/identify_fleet.py OUT [--arms 100] [--workers 2]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from stopset.cli.main import main as stopset

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from synthetic import names, recordings, save_trials, urdf


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    for k in range(args.arms):
        folder = args.out / "fleet" / f"arm{k:03d}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "robot.urdf").write_text(urdf(names(2)))
        save_trials(folder / "rec.parquet", recordings((2.0 + 0.01 * k, 0.7), (9.0, 4.0)), names(2))
    begin = time.monotonic()
    words = [
        "identify-fleet",
        str(args.out / "fleet"),
        "--out",
        str(args.out / "models"),
        "--workers",
        str(args.workers),
        "--quiet",
    ]
    code = stopset(words)
    took = time.monotonic() - begin
    first = args.out / "fleet" / "arm000"
    alone = args.out / "alone.model.json"
    stopset(
        ["identify", "--robot", str(first / "robot.urdf"), "--data", str(first / "rec.parquet"), "--out", str(alone), "--quiet"]
    )
    same = alone.read_bytes() == (args.out / "models" / "arm000.model.json").read_bytes()
    print(f"{args.arms} arms in {took:.0f} s with {args.workers} processes ({took / args.arms:.2f} s an arm); as alone: {same}")
    return code


if __name__ == "__main__":
    sys.exit(main())
