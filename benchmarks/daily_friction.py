"""How much a real arm's friction differs from day to day, joint by joint, at the speeds at which it moved.

    python benchmarks/daily_friction.py FOLDER

FOLDER holds the UR10e's ``robot.urdf`` and ``identification.parquet`` of nine days (`ur10e_splits.DAYS`).  One model is identified from
all of them; its torque is taken off each day's recordings, and what is left is regressed on direction, speed and a constant.  Printed:
friction that a day has more than the model says, at that day's mean speed, in percent of the model's, and what of it is common to all
joints.  What `DAILY` of the diagnosis' thresholds stands above.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from one_answer import campaign
from ur10e_splits import DAYS

from stopset.artifact import Model
from stopset.offline.compare.known import left_over
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Settings, identified
from stopset.offline.nominal.preprocess import Preprocessing, motions
from stopset.recording import Recording, read_recordings

Array = NDArray[np.float64]
ENOUGH = 100  # moving rows of a joint


def more(model: Model, day: Sequence[Recording]) -> Array:
    """(n,) share of its friction that each joint has more than the model says; nan where it hardly moved."""
    speed, left = [], []
    for m in (m for r in day for m in motions(r, Preprocessing())):
        k = m.retained
        q, dq, ddq, tau = (np.ascontiguousarray(x[k]) for x in (m.q, m.dq, m.ddq, m.tau))
        part = Recording("closed_loop", 0, 0, 0, m.t[k], q, dq, tau)
        left.append(left_over(model, part, model.input(q, dq, tau, None, 0.0, m.t[k]), float("nan"), ddq, window=1))
        speed.append(np.where(m.moving[k], dq, 0.0))
    v, e = np.concatenate(speed), np.concatenate(left)
    values = {(f.effect, f.joint): next(iter(f.values.values())) for f in model.effects if f.effect in ("coulomb", "viscous")}
    out = np.full(model.n, np.nan)
    for j, joint in enumerate(model.joints):
        use = v[:, j] != 0.0
        if use.sum() >= ENOUGH:
            x, usual = v[use, j], float(np.mean(np.abs(v[use, j])))
            a, b, _ = np.linalg.lstsq(np.column_stack([np.sign(x), x, np.ones(len(x))]), e[use, j], rcond=None)[0]
            out[j] = (a + usual * b) / (values["coulomb", joint] + usual * values["viscous", joint])
    return out


def main() -> None:
    folder = Path(sys.argv[1])
    robot = load_robot(folder / "robot.urdf")
    data = read_recordings(folder / "identification.parquet", robot)
    model = identified(robot, campaign(data), Settings()).model
    print("day (suites), seconds: more friction than the model's at each joint [%]")
    for suites in DAYS:
        day = [r for r in data if r.suite in suites]
        shares = " ".join(f"{x:6.1f}" for x in 100 * more(model, day))
        print(f"{suites}, {sum(r.t[-1] - r.t[0] for r in day):.0f} s: {shares}", flush=True)


if __name__ == "__main__":
    main()
