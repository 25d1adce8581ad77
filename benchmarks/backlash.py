"""Play in a gear told by a second encoder: its width against the hidden one, over stiffness, width, encoder and seed.

    python benchmarks/backlash.py [--robot URDF] [--joint J] [--seeds N] [--first SEED]

An arm of three joints, or a UR10e (``--robot URDF``), with a gear of 1e5 or 1e4 N m/rad and play of 0 to 5 arcmin at its second joint, along a
program of six motions of 8 s at 100 Hz, its description 2 to 5 % off in mass.  Second encoders of 19 bit.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from as_found import ARCMIN, PROGRAM, Trouble, geared, recorded

from stopset.errors import RobotError
from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.diagnose.plays import plays
from stopset.robot import Robot
from stopset.simulation import prepare
from stopset.simulation.cell import LINK_RESOLUTION

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from test_hidden_effects import ARM

SIDES = 1.96  # standard deviations to either side of a 95 % interval
GAPS = (0.0, 0.5, 1.0, 3.0, 5.0)  # [arcmin]


def asked(doc: str, first: int) -> tuple[argparse.Namespace, Robot]:
    """What a benchmark of second encoders is asked, and its arm; ``first``: the seed to begin with."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", type=Path)
    parser.add_argument("--joint", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=first)
    args = parser.parse_args()
    try:
        robot = load_robot(args.robot) if args.robot else robot_from_text(ARM)
    except RobotError as error:
        parser.error(str(error))
    if args.seeds < 1 or args.first < 0 or not 0 <= args.joint < robot.n:
        parser.error(f"expected a seed at least, counted from 0 on, and a joint of 0 to {robot.n - 1}")
    return args, robot


def main() -> None:
    args, robot = asked(__doc__ or "", 20)
    print(
        "| stiffness [N m/rad] | gap [arcmin] | named, of | 95 % intervals that hold it | largest error | elsewhere |\n|---|---|---|---|---|---|"
    )
    for stiffness in (1e5, 1e4):
        for gap in GAPS:
            named, inside, off, false = 0, 0, 0.0, 0
            for seed in range(args.first, args.first + args.seeds):
                s = prepare(robot, ["none"], seed, "short", cad="wrong")
                trouble = Trouble(change=geared(args.joint, stiffness, gap * ARCMIN), behind=LINK_RESOLUTION)
                for r in plays(s.robot, recorded(s, PROGRAM, 100.0, trouble, seed + 100)).ranked:
                    p = r.parameters["gap"]
                    if r.joints != (robot.joints[args.joint],) or gap == 0.0:
                        false += 1
                        continue
                    error = abs(p.value / ARCMIN - gap)
                    named, off = named + 1, max(off, error)
                    inside += p.std is not None and error <= SIDES * p.std / ARCMIN
            print(
                f"| {stiffness:g} | {gap:g} | {named} of {args.seeds} | {inside} of {named} | {off:.2f} | {false} |", flush=True
            )


if __name__ == "__main__":
    main()
