"""How much narrower sets per temperature band are than one set for all temperatures.

python benchmarks/bands.py ROBOT RECORDING [ROBOT RECORDING]...
"""

from __future__ import annotations

import sys

from stopset.offline.conform.bands import narrower
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Settings, identify

BANDS = 3


def main() -> None:
    if len(sys.argv) < 3 or len(sys.argv) % 2 == 0:
        sys.exit(__doc__)
    print("| recordings | band | position tube, share of the whole's | sum of U widths, share of the whole's |")
    print("|---|---|---|---|")
    for robot, recording in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        model = identify(load_robot(robot), [recording], Settings(bands=BANDS)).model
        for b in narrower(model):
            tube = "" if b.tube_share is None else f"{b.tube_share:.0%}"
            print(f"| {recording} | {b.at} | {tube} | {b.torque_share:.0%} |", flush=True)


if __name__ == "__main__":
    main()
