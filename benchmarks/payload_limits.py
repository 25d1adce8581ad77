"""What limits a load that is weighed from its own recording alone: what the description says of the empty arm, and the torque's scale.

    python benchmarks/payload_limits.py FOLDER
    python benchmarks/payload_limits.py FOLDER --same EMPTY LOADED MASS

FOLDER holds ``robot.urdf``, ``identification.parquet`` without a load and ``payload_*.parquet`` with one.  Each is asked by plain least
squares, rows weighed by what their joint leaves, which body at the flange explains most beside the rigid body as described, times an
assumed scale of the torque, and every joint's rotor, offset, dry, viscous, cubic and load-dependent friction.  What the empty arm
"carries" is no load: it is by how much the description is off.  The difference between loaded and empty is the load.

``--same``: EMPTY and LOADED are files of FOLDER of the same motion without and with MASS [kg].  Their torques' difference is the load and
nothing else, whatever the description says of the arm: stated is what it weighs if every drive is taken to be right, if each is as far off as
the identified arm's gravity torque is off the described one's, and by which factor each drive would have to be off for MASS to hang there.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from stopset.errors import StopsetError
from stopset.offline.campaign.source import Campaign
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Settings, identified
from stopset.recording import Recording, Recordings, read_recordings
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques, regressors
from stopset.types import Array

RATE, WIDTH, EVERY = 100.0, 0.03, 5  # [Hz] of the grid, [s] of the smoothing, rows between two that are taken
EDGE, CREEP = 0.1, 0.02  # [s] left out at either end; [rad/s] below which dry friction is indeterminate
SCALES = (0.85, 1.0, 1.15)  # of the recorded torque, common to all drives
ROUNDS = 4  # of weighing
POSES, LOADED = 500, 0.05  # at which gravity torques are compared; of the largest, from which on a joint's tells


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


def drives_as_described(robot: Robot, empty: Recordings) -> Array:
    """(n,) identified over described gravity torque of each joint; 1 where gravity hardly loads it."""
    model = identified(robot, Campaign(empty.meta, lambda: iter(empty.trials)), Settings()).model
    q = np.random.default_rng(0).uniform(model.domain.q.lo, model.domain.q.hi, (POSES, robot.n))
    ours, theirs = (gravity_torques(r.chain, r.pi, q) for r in (model.robot, robot))
    size = (theirs**2).sum(axis=0)
    return np.where(size > LOADED**2 * size.max(), (ours * theirs).sum(axis=0) / np.maximum(size, 1e-12), 1.0)


def same_motion(robot: Robot, empty: Recordings, loaded: Recordings, mass: float) -> None:
    """Print what the difference of the two recordings weighs."""
    (_, _, without, _), (dq, _, tau, Y) = (rows(robot, x.trials) for x in (empty, loaded))
    count, n = min(len(tau), len(without)), robot.n
    dq, more, Y = dq[:count], tau[:count] - without[:count], Y[:count, :, -10:-6]

    def left(m: float, centre: Array, drives: Array, size: Array) -> Array:
        out = []
        for j in range(n):
            law = np.column_stack([np.tanh(dq[:, j] / CREEP), dq[:, j], np.ones(count)])
            e = more[:, j] - drives[j] * (Y[:, j] @ np.concatenate([[m], m * centre]))
            out.append((e - law @ np.linalg.lstsq(law, e, rcond=None)[0]) / size[j])
        return np.concatenate(out)

    def fitted(asked: Callable[[Array, Array], Array], start: Array) -> tuple[Array, Array]:
        size = np.ones(n)
        for _ in range(ROUNDS):
            found = least_squares(asked, start, args=(size,))
            size = size * np.sqrt(np.mean(found.fun.reshape(n, -1) ** 2, axis=1))
        return found.x, size

    here = np.array([0.0, 0.0, 0.05])
    described = drives_as_described(robot, empty)
    print("| drives | m [kg] | centre [m] | left by joint [N m] |\n|---|---|---|---|")
    for title, drives in (("taken to be right", np.ones(n)), (f"as described: {described.round(2)}", described)):
        p, size = fitted(lambda p, s, d=drives: left(p[3], p[:3], d, s), np.append(here, 0.5 * mass))  # type: ignore[misc]
        print(f"| {title} | {p[3]:.2f} | {p[:3].round(3)} | {size.round(3)} |", flush=True)
    p, size = fitted(lambda p, s: left(mass, p[:3], p[3:], s), np.concatenate([here, np.ones(n)]))
    felt = np.sqrt(np.mean((Y @ np.concatenate([[mass], mass * p[:3]])) ** 2, axis=0))
    each = ", ".join(f"{x:.2f}" if f > LOADED * felt.max() else "-" for x, f in zip(p[3:], felt, strict=True))
    print(f"| {each} times, for it to be | {mass:.2f} | {p[:3].round(3)} | {size.round(3)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--same", nargs=3, metavar=("EMPTY", "LOADED", "MASS"), help="files of one motion, and the load [kg]")
    args = parser.parse_args()
    try:
        asked(args.folder, args.same)
    except (StopsetError, ValueError) as e:
        parser.error(str(e))


def asked(folder: Path, same: Sequence[str] | None) -> None:
    """All that is printed, of recordings in ``folder``."""
    robot = load_robot(folder / "robot.urdf")
    if same:
        empty, loaded = (read_recordings(folder / f, robot) for f in same[:2])
        same_motion(robot, empty, loaded, float(same[2]))
        return
    files = [folder / "identification.parquet", *sorted(folder.glob("payload_*.parquet"))]
    print("| torque's scale | recording | mass at the flange [kg] | more than the empty arm [kg] | left, sum over joints [N m] |")
    print("|---|---|---|---|---|")
    for scale in SCALES:
        nothing = None
        for file in files:
            mass, left = carried(robot, read_recordings(file, robot).trials, scale)
            nothing = mass if nothing is None else nothing
            print(f"| {scale} | {file.stem} | {mass:.2f} | {mass - nothing:.2f} | {left.sum():.2f} |", flush=True)


if __name__ == "__main__":
    main()
