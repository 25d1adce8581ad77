"""Recordings as found: a simulated arm's production program, or one trajectory, and all that goes wrong with such files.

No campaign, no temperature, no phases but motion; drives whose torque constants are off alike, lost samples, stamps that scatter,
a torque sensor that drifts, a late torque, a gear with play.  The healthy arm must be called healthy, or what is wrong with the
recording must be said; no effect may be named that is not there.

    python benchmarks/as_found.py [--robot lwa4p] [--seed 5]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.offline.description import load_robot
from stopset.offline.diagnose import Diagnosis, diagnose
from stopset.recording import Recording, Recordings
from stopset.robot import Robot
from stopset.simulation import Scenario, prepare
from stopset.simulation.cell import TICK, Cell, Measurement, play, reported, temperatures
from stopset.simulation.motions import fourier, point_to_point
from stopset.simulation.plant import SimulatedPlant

Array = NDArray[np.float64]
PROGRAM, ONE = (8.0,) * 6, (30.0,)  # [s] of each motion
ARCMIN = np.pi / 180 / 60
MIDDAY = 0.6  # place in the day: the arm is warm


@dataclass(frozen=True, slots=True)
class Trouble:
    """What is wrong: ``gain`` true over recorded torque of all drives, ``lost`` share of samples, ``scatter`` [s] of the stamps,
    ``drift`` [N m] of the first joint's torque from begin to end, ``late`` [s] torque of all joints, ``change`` of the arm itself,
    ``speed`` of its motions, in shares of their limits; ``behind``: [rad] what encoders behind the gears resolve, 0: there are none."""

    gain: float = 1.0
    lost: float = 0.0
    scatter: float = 0.0
    drift: float = 0.0
    late: float = 0.0
    change: Callable[[SimulatedPlant], SimulatedPlant] = lambda plant: plant
    behind: float = 0.0
    speed: float = 0.8


def geared(joint: int, stiffness: float, gap: float) -> Callable[[SimulatedPlant], SimulatedPlant]:
    """An arm with a gear of this ``stiffness`` [N m/rad] and play of ``gap`` [rad] at one joint."""

    def change(plant: SimulatedPlant) -> SimulatedPlant:
        at = np.arange(len(plant.fc)) == joint
        damping = 5.0 + 2.5e-4 * stiffness
        return plant._replace(stiffness=np.where(at, stiffness, plant.stiffness), twist_damping=damping * at, gap=gap * at)

    return change


# three minutes of arc in the second joint's gear, stiff as an industrial arm's
play_in_the_gear = geared(1, 1e5, 3 * ARCMIN)


def recorded(s: Scenario, lengths: tuple[float, ...], rate: float, trouble: Trouble, seed: int) -> Recordings:
    """Motions of these ``lengths`` [s] as a logger of ``rate`` [Hz] writes them."""
    plant = trouble.change(s.cell.truth.plant)
    truth = replace(s.cell.truth, plant=plant._replace(gain=plant.gain * trouble.gain), delay=s.cell.truth.delay + trouble.late)
    cell = replace(s.cell, truth=truth, seed=seed)
    build = point_to_point if len(lengths) > 1 else fourier
    trials = []
    for k, seconds in enumerate(lengths):
        motion = build(cell.space, seconds, trouble.speed, TICK, cell.random("production", k))
        trials.append(_logged(cell, Measurement("closed_loop", k, 0, motion), rate, trouble))
    return Recordings(replace(s.meta, sources=(), rate_hz=rate), tuple(trials))


def _logged(cell: Cell, job: Measurement, rate: float, trouble: Trouble) -> Recording:
    every, rng = round(1.0 / (rate * TICK)), cell.random("logger", job.suite)
    log = play(cell, job, temperatures(cell, MIDDAY), cell.random("trial", job.suite))
    t = every * TICK * np.arange(len(log.q[::every]))
    tau = reported(cell, log)[::every]
    tau = tau + rng.normal(0.0, 1.0, tau.shape) * cell.torque_noise
    tau[:, 0] += trouble.drift * (t / t[-1] - 0.5)
    received = rng.random(len(t)) >= trouble.lost
    stamps = np.maximum.accumulate(t + trouble.scatter * rng.normal(0.0, 1.0, len(t)))[received] + 1e-9 * np.arange(
        received.sum()
    )
    behind = None
    if trouble.behind:
        read = log.link[::every] + trouble.behind * rng.normal(0.0, 1.0, tau.shape)
        behind = trouble.behind * np.round(read / trouble.behind)[received]
    q, dq = log.q[::every][received], log.dq[::every][received]
    return Recording("closed_loop", job.suite, 0, job.suite, stamps, q, dq, tau[received], q_link=behind)


CASES: dict[str, tuple[tuple[float, ...], Trouble]] = {
    "healthy program": (PROGRAM, Trouble()),
    "healthy, one trajectory": (ONE, Trouble()),
    "torque constants 4 % off": (PROGRAM, Trouble(gain=1.04)),
    "torque constants 4 % off, one trajectory": (ONE, Trouble(gain=1.04)),
    "3 % of the samples lost": (PROGRAM, Trouble(lost=0.03)),
    "stamps scatter by 1 ms": (PROGRAM, Trouble(scatter=1e-3)),
    "torque sensor drifts by 1 N m, one trajectory": (ONE, Trouble(drift=1.0)),
    "3 arcmin of play": (PROGRAM, Trouble(change=play_in_the_gear)),
    "3 arcmin of play, one trajectory": (ONE, Trouble(change=play_in_the_gear)),
    "torque 12 ms late": (PROGRAM, Trouble(late=0.012)),
    "all at once": (PROGRAM, Trouble(gain=1.04, lost=0.03, scatter=1e-3)),
    "all at once, one trajectory": (ONE, Trouble(gain=1.04, lost=0.03, scatter=1e-3, drift=0.5)),
}


def answer(robot: Robot, case: str, rate: float, seed: int) -> Diagnosis:
    """What the diagnosis says of one case, against a description that is off."""
    lengths, trouble = CASES[case]
    scenario = prepare(robot, ["none"], seed, "short", cad="wrong")
    return diagnose(scenario.robot, recorded(scenario, lengths, rate, trouble, seed + 100))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="lwa4p")
    parser.add_argument("--seed", type=int, default=5)
    args = parser.parse_args()
    robot, named = load_robot(args.robot), 0
    for case in CASES:
        for rate in (100.0, 125.0):
            found = answer(robot, case, rate, args.seed)
            false = [r.label for r in found.ranked if not (r.effect == "delay" and CASES[case][1].late)]
            named += len(false)
            labels = ", ".join(r.label for r in found.ranked)
            print("; ".join([f"{case}, {rate:g} Hz: {found.verdict} {labels}", *found.depends_on, *found.notes]), flush=True)
    print(f"{named} names of what is not there")


if __name__ == "__main__":
    main()
