"""How far the trials of a suite are from repeating one motion, in the measure of `stopset.recording.repetition`: open loop, and all else.

    python benchmarks/repetitions.py FOLDER

Reads every Parquet file below FOLDER; prints, over trials that are numbered as repetitions of their suite's first one, the nearer of torque and
angle: the farthest in open loop, where they repeat by definition, and the nearest under a controller, where a suite is any grouping.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.errors import RecordingError
from stopset.recording import stream_recordings
from stopset.recording.repetition import POWERED, Motion


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    files = sorted(folder.rglob("*.parquet"))
    if not files:
        parser.error(f"{folder} holds no Parquet file; expected recordings")
    far: dict[str, list[float]] = {phase: [] for phase in POWERED}
    for path in files:
        first: dict[tuple[str, int], Motion] = {}
        try:
            for r in stream_recordings(path):
                if r.phase in far:
                    mine = Motion.of(r.t, r.q, r.tau)
                    key = (r.phase, r.suite)
                    if key in first:
                        far[r.phase].append(first[key].difference(mine))
                    first.setdefault(key, mine)
        except RecordingError as e:
            print(f"{path}: {e}")
    for phase, x in far.items():
        print(
            f"{phase}: {len(x)} trials, from {min(x):.2f} to {max(x):.2f}" if x else f"{phase}: nothing numbered as a repetition"
        )


if __name__ == "__main__":
    main()
