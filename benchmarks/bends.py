"""A gear's stiffness told by a second encoder: against the hidden one, over stiffness and seed, and of rigid gears whose encoders err.

    python benchmarks/bends.py [--robot URDF] [--joint J] [--seeds N] [--first SEED]

An arm of three joints, or another (``--robot``), with a soft gear at one joint, along a program of six motions of 8 s at 100 Hz, its description
2 to 5 % off in mass.  Second encoders of 19 bit at every joint, mounted by up to 0.2 rad off zero, with an error of 20 arcsec once per turn.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from as_found import PROGRAM, Trouble, geared, recorded

from stopset.errors import RobotError
from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.diagnose.explain.uncertainty import TWO_SIDES
from stopset.offline.diagnose.plays import plays
from stopset.recording import Recordings
from stopset.simulation import prepare

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from test_hidden_effects import ARM

BITS, ONCE = 2 * np.pi / 2**19, np.deg2rad(20 / 3600)  # [rad]


def mounted(data: Recordings, seed: int) -> Recordings:
    """The recordings with second encoders that are off zero and err once per turn."""
    rng = np.random.default_rng(seed)
    n = len(data.meta.joints)
    off, phase = rng.uniform(-0.2, 0.2, n), rng.uniform(0, 2 * np.pi, n)
    return replace(data, trials=tuple(replace(r, q_link=r.q_link + off + ONCE * np.sin(r.q_link + phase)) for r in data))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot")
    parser.add_argument("--joint", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=40)
    args = parser.parse_args()
    try:
        robot = load_robot(args.robot) if args.robot else robot_from_text(ARM)
    except RobotError as error:
        parser.error(str(error))
    if args.seeds < 1 or args.first < 0 or not 0 <= args.joint < robot.n:
        parser.error(f"expected a seed at least, counted from 0 on, and a joint of 0 to {robot.n - 1}")
    print(
        "| stiffness [N m/rad] | named, of | 95 % intervals that hold it | largest error | elsewhere, or play |\n|---|---|---|---|---|"
    )
    for stiffness in (0.0, 1e5, 3e4, 1e4, 2e3):
        named, inside, off, false = 0, 0, 0.0, 0
        for seed in range(args.first, args.first + args.seeds):
            s = prepare(robot, ["none"], seed, "short", cad="wrong")
            trouble = Trouble(change=geared(args.joint, stiffness, 0.0), behind=BITS) if stiffness else Trouble(behind=BITS)
            found = plays(s.robot, mounted(recorded(s, PROGRAM, 100.0, trouble, seed + 100), seed))
            false += len(found.ranked)
            for r in found.bends:
                p = r.parameters["K"]
                if r.joints != (robot.joints[args.joint],) or not stiffness:
                    false += 1
                    continue
                error = abs(p.value - stiffness)
                named, off = named + 1, max(off, error / stiffness)
                inside += p.std is not None and error <= TWO_SIDES * p.std
        print(f"| {stiffness or 'rigid'} | {named} of {args.seeds} | {inside} of {named} | {off:.1%} | {false} |", flush=True)


if __name__ == "__main__":
    main()
