"""How often the 95 % interval of the torque's lag that identification finds holds the true one: programs and single trajectories, stamps that
scatter, true lags, and arms that creep.

A simulated drive holds its torque for the tick after its stamp, so that a torque on time acts half a tick (0.5 ms) after its stamp, and the
true lag is that less the delay.

    python benchmarks/lags.py [ARMS...] [--seed 40] [--seeds 10] [--scatter 0 0.5 1] [--late 0 5 11]
"""

from __future__ import annotations

import argparse

import numpy as np
from as_found import ONE, PROGRAM, Trouble, recorded

from stopset.effects.selection import usual_friction
from stopset.errors import StopsetError
from stopset.offline.description import load_robot
from stopset.offline.nominal.delay import estimate_delay
from stopset.offline.nominal.nominal import trusted
from stopset.offline.nominal.normal_equations import accumulate
from stopset.offline.nominal.prior import prior_of
from stopset.robot import Robot
from stopset.simulation import prepare
from stopset.simulation.cell import TICK
from stopset.types import Array

CREEPS = 0.06  # of the speed limits
KINDS = {"program": (PROGRAM, 0.8), "one trajectory": (ONE, 0.8), "creeping program": (PROGRAM, CREEPS)}
TWO_SIDES = 1.96


def found(robot: Robot, kind: str, trouble: Trouble, seed: int) -> Array:
    """How far off the common lag is, its standard deviation [ms], and whether it is taken out."""
    lengths, speed = KINDS[kind]
    scenario = prepare(robot, ["none"], seed, "short", cad="wrong" if seed % 3 else "exact")
    made = recorded(
        scenario, lengths, (100.0, 125.0)[seed % 2], Trouble(scatter=trouble.scatter, late=trouble.late, speed=speed), seed + 100
    )
    lag = estimate_delay(accumulate(scenario.robot, made.trials, usual_friction()), prior_of(scenario.robot))
    return 1e3 * np.array([lag.common - TICK / 2 + trouble.late, lag.common_std, 1e-3 * trusted(lag)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("arms", nargs="*", default=["lwa4p"])
    parser.add_argument("--seed", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--scatter", type=float, nargs="+", default=[0.0, 0.2, 0.5, 1.0], help="[ms] of the stamps")
    parser.add_argument("--late", type=float, nargs="+", default=[0.0, 5.0, 11.0], help="[ms] of the torque")
    args = parser.parse_args()
    for arm in args.arms:
        try:
            robot = load_robot(arm)
        except StopsetError as e:
            parser.error(str(e))
        for kind in args.kinds:
            for scatter in args.scatter:
                for late in args.late:
                    trouble = Trouble(scatter=1e-3 * scatter, late=1e-3 * late)
                    off, std, out = np.array([found(robot, kind, trouble, args.seed + k) for k in range(args.seeds)]).T
                    known = np.isfinite(std)
                    inside = int(np.sum(np.abs(off) <= TWO_SIDES * std))
                    worst = float(np.max(np.abs(off[known]), initial=0.0))
                    usual = float(np.median(std[known])) if known.any() else np.inf
                    print(
                        f"{robot.name}, {kind}, stamps scatter by {scatter:g} ms, torque {late:g} ms late: inside {inside} of {args.seeds}; "
                        f"known in {known.sum()}, to {usual:.1f} ms, at most {worst:.1f} ms off, taken out in {out.sum():.0f}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
