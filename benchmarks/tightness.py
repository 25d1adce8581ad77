"""How much wider than what was seen the sets of recordings are: one row per recording, half width over largest deviation.

    python benchmarks/tightness.py FOLDER...

FOLDER holds a ``robot.urdf`` and recordings; each file that moves is identified by itself.  Without a ``robot.urdf`` the shipped
LWA-4P is taken.  Columns: median over angles and speeds after 0.1 s, the widest joint at one sample, 0.1 s and 1 s, the widest error
of a speed reading beside its noise and the fastest speed, sum of U widths, held-out motions and how many of them left the sets.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from stopset.errors import StopsetError
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import identify

HEAD = (
    "recording", "median 0.1 s", "widest 1 sample", "0.1 s", "1 s", "V speed [rad/s]", "noise", "fastest", "U [N m]", "held out, left",
    "time [s]",
)  # fmt: skip


def row(robot: str | Path, path: Path) -> list[str]:
    start = time.monotonic()
    found = identify(load_robot(robot), [path])
    s, n, t = found.model.powered, found.model.n, found.tightness
    widest = [f"{np.nanmax(x):.1f}" if np.isfinite(x).any() else "-" for x in t.by_joint]
    j = int(np.argmax(s.V.hi[n:]))
    fastest = max(abs(found.survey.dq.lo[j]), abs(found.survey.dq.hi[j]))
    promise = found.model.guarantee
    return [
        f"{path.parent.name}/{path.stem}", f"{t.median:.2f}", *widest, f"{s.V.hi[n + j]:.3f}",
        f"{found.survey.readings.least.hi[n + j]:.4f}", f"{fastest:.2f}", f"{s.U.width.sum():.1f}",
        f"{promise.motions}, {promise.violated}", f"{time.monotonic() - start:.0f}",
    ]  # fmt: skip


def main() -> None:
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    print("| " + " | ".join(HEAD) + " |\n" + "|---" * len(HEAD) + "|")
    for folder in map(Path, sys.argv[1:]):
        described = folder / "robot.urdf"
        for path in sorted(folder.glob("*.parquet")):
            try:
                cells = row(described if described.exists() else "lwa4p", path)
            except StopsetError as e:
                cells = [f"{folder.name}/{path.stem}", f"refused: {str(e)[:90]}"]
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
