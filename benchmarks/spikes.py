"""Torques that stand out for one sample: what of recordings is left out for them, and how near others come to that.

    python benchmarks/spikes.py FILE...

Per file: samples left out (`stopset.recording.spikes.without_spikes`); of what stays the largest one-sample torque over the peaks that all
but a hundredth of samples stay below, in the middle of a motion that goes on and elsewhere.  `OUT` is what the first must reach.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.errors import RecordingError
from stopset.recording import spikes as rule
from stopset.recording import stream_recordings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+")
    args = parser.parse_args()
    try:
        table(args.files)
    except RecordingError as error:
        parser.error(str(error))


def table(files: list[Path]) -> None:
    """Print a row per file. Raises `RecordingError`."""
    print("| recording | left out | largest in mid-motion | elsewhere, or answered |\n|---|---|---|---|")
    for path in files:
        out, middle, elsewhere = 0, 0.0, 0.0
        for r in stream_recordings(path):
            if r.phase not in ("closed_loop", "open_loop") or len(r.t) < rule.FEWEST:
                continue
            out += len(r.spikes)
            for p, times in rule.standing_out(r, 1.0):
                if rule.goes_on(r, p):
                    middle = max(middle, times)
                else:
                    elsewhere = max(elsewhere, times)
        print(f"| {path.parent.name}/{path.stem} | {out} | {middle:.1f} | {elsewhere:.1f} |", flush=True)


if __name__ == "__main__":
    main()
