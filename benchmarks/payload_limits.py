"""What limits a load that is weighed from its own recording alone: what the description says of the empty arm, and the torque's scale.

    python benchmarks/payload_limits.py FOLDER

FOLDER holds ``robot.urdf``, ``identification.parquet`` without a load and ``payload_*.parquet`` with one.  Each is asked by plain least
squares, rows weighed by what their joint leaves, which body at the flange explains most beside the rigid body as described, times an
assumed scale of the torque, and every joint's rotor, offset, dry, viscous, cubic and load-dependent friction.  What the empty arm
"carries" is no load: it is by how much the description is off.  The difference between loaded and empty is the load.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from stopset.offline.description import load_robot
from stopset.recording import Recording, read_recordings
from stopset.robot import Robot
from stopset.robot.rigid import regressors
from stopset.types import Array

RATE, WIDTH, EVERY = 100.0, 0.03, 5  # [Hz] of the grid, [s] of the smoothing, rows between two that are taken
EDGE, CREEP = 0.1, 0.02  # [s] left out at either end; [rad/s] below which dry friction is indeterminate
SCALES = (0.85, 1.0, 1.15)  # of the recorded torque, common to all drives
ROUNDS = 4  # of weighing


def rows(robot: Robot, trials: Sequence[Recording]) -> tuple[Array, Array, Array, Array]:
    """Speed, acceleration and torque (rows, n) and the rigid body's columns (rows, n, 10 n), all smoothed alike."""
    parts = []
    for r in trials:
        t = np.arange(r.t[0] + EDGE, r.t[-1] - EDGE, 1 / RATE)
        q, tau = (np.column_stack([np.interp(t, r.t, x) for x in signal.T]) for signal in (r.q, r.tau))
        smooth = [gaussian_filter1d(q, WIDTH * RATE, axis=0, order=k) * RATE**k for k in range(3)]
        q, dq, ddq = (np.ascontiguousarray(x[::EVERY]) for x in smooth)
        tau = gaussian_filter1d(tau, WIDTH * RATE, axis=0)[::EVERY]
        parts.append((dq, ddq, tau, regressors(robot.chain, q, dq, ddq)))
    dq, ddq, tau, Y = (np.concatenate(x) for x in zip(*parts, strict=True))
    return dq, ddq, tau, Y


def carried(robot: Robot, trials: Sequence[Recording], scale: float) -> tuple[float, Array]:
    """Mass at the flange [kg] and what each joint leaves (n,) [N m], with the recorded torque ``scale`` times the true one."""
    dq, ddq, tau, Y = rows(robot, trials)
    N, n = tau.shape
    rigid = np.einsum("tjk,k->tj", Y, robot.pi.ravel())
    columns = [Y[:, :, -10 + k] for k in range(10)]
    for j in range(n):
        s = np.tanh(dq[:, j] / CREEP)
        for law in (s, dq[:, j], dq[:, j] ** 3, s * np.abs(rigid[:, j]), ddq[:, j], np.ones(N)):
            columns.append(np.zeros((N, n)))
            columns[-1][:, j] = law
    X, moving = np.stack(columns, axis=2), np.abs(dq) > CREEP
    y, left = tau - scale * rigid, np.ones(n)
    for _ in range(ROUNDS):
        A, b = (X / left[:, None])[moving], (y / left)[moving]
        size = np.linalg.norm(A, axis=0) + 1e-12
        theta = np.linalg.lstsq(A / size, b, rcond=1e-10)[0] / size
        e = np.where(moving, y - X @ theta, 0.0)
        left = np.sqrt((e**2).sum(axis=0) / moving.sum(axis=0))
    return float(theta[0]) / scale, left


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    robot = load_robot(folder / "robot.urdf")
    files = [folder / "identification.parquet", *sorted(folder.glob("payload_*.parquet"))]
    print("| torque's scale | recording | mass at the flange [kg] | more than the empty arm [kg] | left, sum over joints [N m] |")
    print("|---|---|---|---|---|")
    for scale in SCALES:
        empty = None
        for file in files:
            mass, left = carried(robot, read_recordings(file, robot).trials, scale)
            empty = mass if empty is None else empty
            print(f"| {scale} | {file.stem} | {mass:.2f} | {mass - empty:.2f} | {left.sum():.2f} |", flush=True)


if __name__ == "__main__":
    main()
