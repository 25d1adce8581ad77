"""How well recordings tell the inertia that a stop rests on.

    python benchmarks/inertia.py ROBOT.urdf RECORDING [RECORDING ...] [--lock J,K]

One line per joint: rotor and inertia about the axis (median over poses) [kg m^2], and three standard errors of it over it; and whether any
joint's torque tells its rotor from none, as torque that is measured behind the gears does not.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from stopset.effects.bound import SIGMAS
from stopset.offline.description import load_robot
from stopset.offline.nominal import identify_nominal
from stopset.offline.nominal.rotors import inertia_std, rotors_shown
from stopset.recording import read_recordings
from stopset.robot.rigid import mass_matrices


def main() -> None:
    args = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    args.add_argument("robot", type=Path)
    args.add_argument("recordings", type=Path, nargs="+")
    args.add_argument("--lock", default="", help="joints that stand still, by name")
    given = args.parse_args()
    robot = load_robot(given.robot, lock=tuple(x for x in given.lock.split(",") if x))
    found = identify_nominal(robot, read_recordings(given.recordings, robot))
    std = inertia_std(robot, found.covariance, found.span)
    q = np.random.default_rng(0).uniform(*found.span.T, (100, robot.n))
    M = np.median(np.einsum("kii->ki", mass_matrices(robot.chain, found.pi, q)), axis=0) + found.rotor
    for joint, rotor, inertia, error in zip(robot.joints, found.rotor, M, std, strict=True):
        print(
            f"{joint:24} rotor {rotor:8.4f}   about the axis {inertia:8.4f}   three standard errors {SIGMAS * error / inertia:8.1%}"
        )
    if not rotors_shown(found.theta, found.covariance, robot.n):
        print("most joints' torque shows no rotor")


if __name__ == "__main__":
    main()
