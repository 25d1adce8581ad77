"""How much farther than a table's row does the arm go from other poses of the same extension? ``python benchmarks/stops_poses.py
[--arm PRBT-like] [--sampled 24] [--tried 1 3 6]``.

Rows are STOP 0 at full speed with the rated payload, of each of the three axes at 33, 66 and 100 % extension, for as many poses as ``--poses``
tries; the others are drawn among those near the extension. Told is the tool's way from the worst of them over the row's: the largest and the
median of the nine rows.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from stop_arms_wide import arms

from stopset.artifact import Model
from stopset.offline.stops.poses import SLACK, Poses
from stopset.offline.stops.table import SHARES, Question, prepared, three_axes, top_speed
from stopset.reach.stops import StopBounds
from stopset.types import Array


def travel(bounds: StopBounds, q: Array, joint: int, speed: Array) -> float:
    """[m] how far the tool goes from the pose ``q`` with one joint at its ``speed`` either way; nan where that is not provable."""
    found = [bounds.bound(q, sign * speed * np.eye(len(q))[joint]).tcp for sign in (1.0, -1.0)]
    return float("nan") if None in found else max(float(x) for x in found if x is not None)


def ratios(model: Model, tried: list[int], sampled: int, seed: int) -> Array:
    """(9, tried) the tool's way from the worst of other poses over that of a row of so many poses."""
    poses, speed, rng = Poses.of(model.robot, model.robot.tip, model.domain.q), top_speed(model), np.random.default_rng(seed)
    bounds, out = prepared(model, model.domain.payload[1], Question()), []
    assert bounds.setting is not None
    for joint in three_axes(model, poses, speed):
        for share in SHARES:
            near = poses.q[(np.abs(poses.extension - share / 100.0) <= SLACK) & poses.seen]
            others = near[rng.permutation(len(near))[:sampled]]
            rows = [
                travel(bounds, q, joint, speed)
                for q in poses.worst_few(joint, share / 100.0, bounds.setting.plant.pi, max(tried))
            ]
            worst = np.nanmax([travel(bounds, q, joint, speed) for q in others])
            out.append([worst / np.nanmax(rows[:k]) for k in tried])
    return np.array(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    known = arms()
    parser.add_argument("--arm", choices=list(known), default="PRBT-like", metavar="NAME")
    parser.add_argument("--sampled", type=int, default=24)
    parser.add_argument("--tried", type=int, nargs="+", default=[1, 3, 6])
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if given.sampled < 1 or min(given.tried) < 1:
        parser.error("expected at least one pose drawn and one tried: with none nothing is compared")
    begun = time.process_time()
    found = ratios(known[given.arm][0], given.tried, given.sampled, given.seed)
    for k, column in zip(given.tried, found.T, strict=True):
        print(f"{given.arm}, rows of {k} poses: the tool goes {column.max():.2f} times as far from the worst of {given.sampled} others "
              f"(median of {len(column)} rows {np.median(column):.2f})", flush=True)  # fmt: skip
    print(f"{time.process_time() - begun:.0f} s of processor time")


if __name__ == "__main__":
    main()
