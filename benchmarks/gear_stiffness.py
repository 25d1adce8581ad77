"""Stiffness of gears with a second encoder, two ways: over the link's torque, and over the drive's torque less what its rotor takes.

    python benchmarks/gear_stiffness.py MODEL RECORDING...

MODEL: a model file of these recordings, whose rigid body and rotors tell both torques.  The angle of the link beside its motor is fitted with a
constant, dry and viscous friction, and errors of the encoders once a turn (and twice, in the second line); the error is the scatter over
parts of 2.5 s that are left out.  Also: the torque [N m] that the model leaves of each joint, root mean square, where it moves and where it stands.
"""

from __future__ import annotations

import argparse

import numpy as np

from stopset.artifact import load_model
from stopset.offline.compare.restored import model_torque
from stopset.offline.nominal.preprocess import Preprocessing, motions
from stopset.recording import read_recordings
from stopset.robot.rigid import torques

MOVES = 0.03  # [rad/s]
PART = 2.5  # [s]
STILL = 0.015  # [rad/s] below which friction may point anywhere


def stiffness(x: np.ndarray, torque: np.ndarray, beside: list[np.ndarray], part: np.ndarray) -> str:
    """Stiffness [N m/rad] of angles ``x`` (N,) over a ``torque``, ``beside`` other columns, with its relative error."""
    A = np.column_stack([*beside, torque])
    bend = -np.linalg.lstsq(A, x, rcond=None)[0][-1]
    per = np.array([-np.linalg.lstsq(A[part != k], x[part != k], rcond=None)[0][-1] for k in np.unique(part)])
    error = np.sqrt((len(per) - 1) * np.mean((per - per.mean()) ** 2)) / abs(bend)
    return f"{1 / bend:.2e} +- {error:.0%}"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model")
    parser.add_argument("recordings", nargs="+")
    args = parser.parse_args()
    model = load_model(args.model)
    robot, recordings = model.robot, read_recordings(args.recordings, model.robot)
    rows: list[tuple[np.ndarray, ...]] = []
    for k, r in enumerate(recordings):
        for m in motions(r, Preprocessing()):
            left, moves = m.tau - model_torque(model, m), np.abs(m.dq) > MOVES
            for j, name in enumerate(robot.joints):
                there, rest = (np.sqrt(np.mean(left[at, j] ** 2)) for at in (moves[:, j], ~moves[:, j]))
                print(
                    f"{r.label} {name}: left {there:.0f} N m where it moves, {rest:.0f} where it stands, {np.abs(left[:, j]).max():.0f} at most"
                )
            if r.q_link is None:
                continue
            q, dq, ddq, tau = (np.ascontiguousarray(x[m.retained]) for x in (m.q, m.dq, m.ddq, m.tau))
            t = m.t[m.retained]
            x = np.column_stack([np.interp(t, r.t, r.q_link[:, j] - r.q[:, j]) for j in range(robot.n)])
            part = np.tile((1e4 * k + np.floor(t / PART))[:, None], robot.n)
            rows.append((x, torques(robot.chain, robot.pi, q, dq, ddq), tau - model.rotor * ddq, q, dq, part))
    if not rows:
        return
    x, link, drive, q, dq, part = (np.concatenate(c) for c in zip(*rows, strict=True))
    for j, name in enumerate(robot.joints):
        if not np.isfinite(x[:, j]).all():
            continue
        once = [np.ones(len(x)), np.tanh(dq[:, j] / STILL), dq[:, j], np.sin(q[:, j]), np.cos(q[:, j])]
        for turns, beside in (("once", once), ("twice", [*once, np.sin(2 * q[:, j]), np.cos(2 * q[:, j])])):
            a, b = (stiffness(x[:, j], y[:, j], beside, part[:, j]) for y in (link, drive))
            print(f"{name}, encoder errors up to {turns} a turn: over the link's torque {a}, over the drive's {b} N m/rad")


if __name__ == "__main__":
    main()
