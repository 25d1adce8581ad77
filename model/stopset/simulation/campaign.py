"""A measuring campaign on the simulated arm, as a cell engineer would run it: the same phases, instruments and flaws.

Five rounds from cold to warm; each holds a share of every phase:

- ``static``: poses crept into from both sides, a few samples each;
- ``closed_loop``: slow and fast point-to-point and Fourier motions (suites 0 to 3), every trial a motion of its own;
- ``open_loop``: suites of equal start and equal replayed torques, which drift apart because friction differs;
- ``stop0``, ``stop1``: power off with brakes, and a ramp with brakes and power off after it; suite 1 varies more.

Between recordings the arm goes on working and warms up.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from stopset.recording import Recording
from stopset.simulation.cell import EVERY, HOLD, RAMP, RUN_UP, STATIC_WORK, TICK, Cell, Measurement, play, record, temperatures
from stopset.simulation.motions import creep, fourier, from_rest, point_to_point, pose, ramp_down, run_up
from stopset.types import Array

ROUNDS = 5
REACTION = 0.008  # [s] of the controller to a stop request
STRAYED = 0.8  # [rad] from the reference: an open-loop trial ends there


@dataclass(frozen=True, slots=True)
class Schedule:
    """How much is measured."""

    poses: int = 150
    closed_loop: int = 3  # trials per suite
    closed_loop_time: float = 6.0  # [s]
    suites: int = 8
    repeats: int = 5  # open-loop trials per suite
    stops: tuple[int, int] = (20, 5)  # regular, varied; of each category

    @property
    def counts(self) -> dict[str, int]:
        """Recordings of each phase, of which nothing need be simulated to know."""
        return {
            "static": 2 * self.poses,
            "closed_loop": 4 * self.closed_loop,
            "open_loop": self.suites * self.repeats,
            "stop0": sum(self.stops),
            "stop1": sum(self.stops),
        }


SHORT = Schedule(poses=60, closed_loop=2, suites=4, stops=(8, 2))
PLANS = {
    "short": SHORT,
    "compact": Schedule(),
    # many motions, hardly repeated: guarantees count motions, and 22 held-out ones can promise less than 20 % with one outside
    "motions": Schedule(poses=60, closed_loop=2, suites=88, repeats=2, stops=(16, 4)),
    "full": Schedule(closed_loop=4, closed_loop_time=7.5, suites=20, repeats=8, stops=(40, 10)),
}


def closed_loop_jobs(cell: Cell, plan: Schedule) -> list[Measurement]:
    """Suites 0 to 3: slow point to point, slow Fourier, fast point to point, fast Fourier."""
    space = cell.space
    out = []
    for trial in range(4 * plan.closed_loop):
        suite = int(cell.random("suites", trial // 4).permutation(4)[trial % 4])
        rng = cell.random("closed_loop", trial)
        build = point_to_point if suite % 2 == 0 else fourier
        out.append(
            Measurement(
                "closed_loop",
                suite,
                trial,
                build(space, plan.closed_loop_time, 0.33 if suite < 2 else 1.0, TICK, rng),
            )
        )
    return out


def static_jobs(cell: Cell, plan: Schedule) -> list[Measurement]:
    """Two recordings per pose: reached from below and from above in every joint, sides drawn per joint."""
    space, out = cell.space, []
    for k in range(plan.poses):
        rng = cell.random("static", k)
        target, direction = pose(space, rng), rng.choice([-1.0, 1.0], cell.cad.n)
        out += [Measurement("static", k, side, creep(target, direction * (1 - 2 * side), TICK)) for side in (0, 1)]
    return out


def open_loop_jobs(cell: Cell, plan: Schedule) -> list[Measurement]:
    """Each suite replays the torques that its motion took once, in the middle of the campaign."""
    space, out = cell.space, []
    for suite in range(plan.suites):
        rng = cell.random("open_loop", suite)
        build = fourier if suite % 2 else point_to_point
        motion = from_rest(build(space, float(rng.uniform(2.1, 2.7)), 0.9, TICK, rng), TICK)
        master = Measurement("open_loop", suite, -1, motion, 0.5)
        torque = play(cell, master, temperatures(cell, 0.5), rng).tau
        out += [Measurement("open_loop", suite, trial, motion, feedforward=torque) for trial in range(plan.repeats)]
    return out


def stop_jobs(cell: Cell, plan: Schedule, phase: str) -> list[Measurement]:
    """Straight runs and a stop request after 0.1 s."""
    space, out = cell.space, []
    for suite, count in enumerate(plan.stops):
        for trial in range(count):
            rng = cell.random(phase, suite, trial)
            motion = run_up(space, 0.7, TICK, rng)
            if phase == "stop1":  # the controller reacts a little after the request
                ramp = RAMP * (rng.uniform(0.8, 1.3) if suite else 1.0)
                motion = ramp_down(motion, round((RUN_UP + REACTION) / TICK), ramp, HOLD, TICK)
            out.append(Measurement(phase, suite, trial, motion))
    return out


def schedule(cell: Cell, plan: Schedule) -> list[Measurement]:
    """All recordings in the order they are made: rounds from cold to warm, varied stops before and after them."""
    rounds: list[list[Measurement]] = [[] for _ in range(ROUNDS + 2)]
    for job in static_jobs(cell, plan):
        rounds[1 + job.suite * ROUNDS // plan.poses].append(job)
    closed = closed_loop_jobs(cell, plan)
    for k, job in enumerate(closed):
        rounds[1 + k * ROUNDS // len(closed)].append(job)
    for job in open_loop_jobs(cell, plan):
        rounds[1 + job.trial * ROUNDS // plan.repeats].append(job)
    for phase in ("stop0", "stop1"):
        regular, varied = plan.stops
        for job in stop_jobs(cell, plan, phase):
            if job.suite == 0:
                rounds[1 + job.trial * ROUNDS // regular].append(job)
            else:
                rounds[0 if 2 * job.trial < varied else -1].append(job)
    flat = [job for k, part in enumerate(rounds) for job in _mixed(part, cell.random("order", k))]
    work = np.cumsum([STATIC_WORK if job.phase == "static" else 1.0 for job in flat])
    return [replace(job, progress=float(w / work[-1])) for job, w in zip(flat, work, strict=True)]


def _mixed(jobs: list[Measurement], rng: np.random.Generator) -> list[Measurement]:
    """In random order, so that no motion is always the cold one; the two sides of a static pose stay together."""
    place = {key: rng.random() for key in dict.fromkeys(_together(job) for job in jobs)}
    return sorted(jobs, key=lambda job: (place[_together(job)], job.trial))


def _together(job: Measurement) -> tuple[str, int, int]:
    return (job.phase, job.suite, 0 if job.phase == "static" else job.trial)


def make(cell: Cell, plan: Schedule, phases: Collection[str] | None = None) -> Iterator[Recording]:
    """Make the whole campaign (or these ``phases`` of it), recording by recording, in the order of time."""
    jobs = schedule(cell, plan)
    box = cell.cad.q_limit
    for place, job in enumerate(jobs):
        if phases is not None and job.phase not in phases:
            continue
        r = replace(record(cell, job, temperatures(cell, job.progress)), place=place)
        if job.phase == "open_loop":
            r = r.cut(0, _within(r, job, box))
        yield r


def _within(r: Recording, job: Measurement, limits: Array) -> int:
    """Samples until an open-loop trial strays: STRAYED from where it should be, or beyond a joint's range."""
    away = np.abs(r.q - job.motion.q[::EVERY]) > STRAYED
    beyond = (r.q < limits[:, 0]) | (r.q > limits[:, 1])
    bad = np.flatnonzero((away | beyond).any(axis=1))
    return int(bad[0]) if len(bad) else len(r.t)
