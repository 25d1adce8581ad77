"""Files that cannot be of one arm in one state: what is identified from one of them fails on another, far beyond its own error.

A load that some recordings carry and others do not ends in the torque sets of all; told here it can be stated instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import islice
from operator import add

import numpy as np
from numpy.typing import NDArray

from stopset.effects.selection import usual_friction
from stopset.offline.inspect.finding import Finding
from stopset.offline.nominal.delay import Delay, joint_reduced, lag_in_words, lag_weights, own_clock
from stopset.offline.nominal.fit import problem_of, residual
from stopset.offline.nominal.nominal import Nominal, solve_nominal
from stopset.offline.nominal.normal_equations import TOGETHER, NormalEquations, accumulate
from stopset.recording import Recording
from stopset.recording.repetition import POWERED
from stopset.robot import Robot
from stopset.types import Array

FAILS = 3.0  # times the error that each file leaves of itself: friction of another day leaves up to twice
NOTABLE = 0.1  # of the torque, root mean square
LOAD = 0.5  # of what fails that a load at the flange must explain to be named
ALIGN = "put torque and motion on one clock, or identify these files apart"
MOST_TRIALS = 64  # that are held against each other
SECONDS = 10.0  # of a trial that is asked by itself
ROWS = 200  # filtered rows of a file, ten seconds: less shows too little of the arm to fail on another


@dataclass(frozen=True, slots=True)
class _File:
    """A file's sums without lags, and what they say by themselves: ``own``, ``torque`` (n,) root mean squares [N m]."""

    parts: list[Array]
    places: list[NDArray[np.intp]]
    rows: Array
    nominal: Nominal
    own: Array
    torque: Array

    @classmethod
    def of(cls, robot: Robot, data: NormalEquations, nominal: Nominal | None = None) -> _File:
        """``nominal``: what another file says, in place of its own."""
        nominal = solve_nominal(robot, data) if nominal is None else nominal
        lags = [lag_weights(float(d)) for d in nominal.delay_applied]
        moving = np.array([joint_reduced(data.moving[:, j].sum(axis=0), w) for j, w in enumerate(lags)])
        rows = data.rows_moving.sum(axis=0)
        p = problem_of(data.layout, moving, 0.0 * moving, rows, data.rows_still)
        total = np.array([G[-1, -1] for G in p.moving])
        own = np.array([residual(G, nominal.theta[at]) for G, at in zip(p.moving, p.index, strict=True)])
        count = np.maximum(rows, 1.0)
        return cls(p.moving, p.index, rows, nominal, np.sqrt(own / count), np.sqrt(total / count))

    def error(self, theta: Array) -> Array:
        """(n,) root mean square [N m] that parameters of another file leave of this one."""
        left = [residual(G, theta[at]) for G, at in zip(self.parts, self.places, strict=True)]
        return np.sqrt(np.array(left) / np.maximum(self.rows, 1.0))

    def with_load(self, theta: Array) -> Array:
        """``theta`` with what the last link must carry besides to explain this file."""
        n, prior = len(self.rows), self.nominal.prior
        A, b = np.linalg.inv(prior.carried), np.zeros(10)
        for G, at, own in zip(self.parts, self.places, self.own, strict=True):
            w = 1.0 / (TOGETHER * max(float(own), 1e-6) ** 2)
            A += w * G[10 * n - 10 : 10 * n, 10 * n - 10 : 10 * n]
            b += w * (G[:-1, -1] - G[:-1, :-1] @ theta[at])[10 * n - 10 : 10 * n]
        out = theta.copy()
        out[10 * n - 10 : 10 * n] += np.linalg.solve(A, b)
        return out


@dataclass(frozen=True, slots=True)
class Dissent:
    """File ``file`` contradicts file ``first`` at ``joint``: by ``error`` [N m] where ``least`` would do and it leaves ``own`` of itself.

    ``mass`` [kg]: what must hang at the flange besides to explain it; None where no load does.
    """

    file: int
    first: int
    joint: str
    error: float
    own: float
    least: float
    mass: float | None

    def seen(self, names: Sequence[str]) -> str:
        """What is wrong, in words; ``names`` of all files."""
        load = "" if self.mass is None else f"about {abs(self.mass):.2g} kg {'more' if self.mass > 0 else 'less'}"
        return (
            f"what {names[self.first]} says of the torque is {self.error:.3g} N m off in {names[self.file]}, which by itself leaves "
            f"{self.own:.3g} N m{f', as if {load} hung at the flange' if load else ''}"
        )


@dataclass(frozen=True, slots=True)
class OwnClock:
    """File ``file`` has its torque ``lag`` after the motion at all joints, file ``first`` another: ``usual``."""

    file: int
    first: int
    lag: Delay
    usual: Delay

    def seen(self, names: Sequence[str]) -> str:
        """What is wrong, in words; ``names`` of all files."""
        return f"the torque of {names[self.file]} is {lag_in_words(self.lag)} the motion, that of {names[self.first]} {lag_in_words(self.usual)} it"


def contradictions(robot: Robot, names: Sequence[str], sums: Sequence[NormalEquations | None]) -> list[list[Finding]]:
    """Per file, what contradicts the one with the most samples; ``sums`` of motor torque, None where there are none."""
    out: list[list[Finding]] = [[] for _ in names]
    for d in dissents(robot, sums):
        if isinstance(d, OwnClock):
            found = Finding("contradiction", "error", None, d.seen(names), "one clock", ALIGN, d.lag.common)
        else:
            found = Finding(
                "contradiction", "warning", d.joint, d.seen(names), f"files of one arm in one state, {d.least:.3g} N m off at most",
                "identify them apart, or tell their conditions (--condition payload=..@FILE)", d.error,
            )  # fmt: skip
        out[d.file].append(found)
    return out


def dissents(robot: Robot, sums: Sequence[NormalEquations | None], first: int | None = None) -> list[Dissent | OwnClock]:
    """Files that contradict the ``first``, else the one with the most samples, by their clocks or at their worst joint; ``sums`` as of
    `contradictions`."""
    some = {k: d for k, d in enumerate(sums) if d is not None and d.rows_moving.sum(axis=0).max() >= ROWS and not d.compensated}
    if len(some) < 2:
        return []
    files = {k: _File.of(robot, d) for k, d in some.items()}
    first = max(files, key=lambda k: float(files[k].rows.sum())) if first is None else first
    base, out = files[first], list[Dissent | OwnClock]()
    for k, f in files.items():
        if k == first:
            continue
        if own_clock(f.nominal.delay, base.nominal.delay, some[k].period):
            out.append(OwnClock(k, first, f.nominal.delay, base.nominal.delay))
            continue
        error = f.error(base.nominal.theta)
        least = np.maximum(FAILS * np.maximum(f.own, base.own), NOTABLE * f.torque)
        over = np.where((f.rows > 0) & (base.rows > 0), error / np.maximum(least, 1e-12), 0.0)
        if float(over.max()) > 1.0:
            # what one motion leaves open another one shows: they contradict each other where no arm moves as both say
            over *= f.error(solve_nominal(robot, some[first] + some[k]).theta) > least
        if float(over.max()) > 1.0:
            j = int(over.argmax())
            mass = _load(f, base, j, error)
            out.append(Dissent(k, first, robot.joints[j], float(error[j]), float(f.own[j]), float(least[j]), mass))
    return out


def sums_of(robot: Robot, r: Recording) -> NormalEquations | None:
    """What `loaded_trials` needs of a trial; None of one that is too short to be asked by itself."""
    if r.phase not in POWERED or r.t[-1] - r.t[0] < SECONDS:
        return None
    return accumulate(robot, [r], usual_friction())


def loaded_trials(robot: Robot, trials: Mapping[str, NormalEquations]) -> list[tuple[str, Dissent]]:
    """Trials of motor torque, by their labels, that carry another load than the rest.

    The rest are those that agree with the longest trial; what differs otherwise between motions is left to the files' own sums.
    """
    sums = {k: d for k, d in islice(trials.items(), MOST_TRIALS) if d.rows_moving.sum(axis=0).max() >= ROWS and not d.compensated}
    if len(sums) < 2:
        return []
    longest = max(sums, key=lambda k: float(sums[k].rows_moving.sum()))
    base = _File.of(robot, sums[longest])
    # cheap: what the longest trial says of the others; only those that it fails on are fitted by themselves
    said = {k: _File.of(robot, sums[k], base.nominal) for k in sums}
    strange = [
        k for k, f in said.items()
        if k != longest and (f.own > np.maximum(NOTABLE * f.torque, FAILS * base.own))[(f.rows > 0) & (base.rows > 0)].any()
    ]  # fmt: skip
    rest = reduce(add, (d for k, d in sums.items() if k not in strange))
    found = ((k, d) for k in strange for d in dissents(robot, [rest, sums[k]], first=0))
    return [(k, d) for k, d in found if isinstance(d, Dissent) and d.mass is not None]


def of_trials(robot: Robot, trials: Mapping[str, NormalEquations]) -> list[Finding]:
    """Of one file, that some of its trials carry another load: what `inspect` says."""
    found = loaded_trials(robot, trials)
    return [
        Finding("contradiction", "warning", d.joint, d.seen(("the rest", label)), f"trials of one arm in one state, {d.least:.3g} N m off at most",
                "part them, or tell their conditions (column condition)", d.error)
        for label, d in found
    ]  # fmt: skip


def _load(f: _File, base: _File, joint: int, error: Array) -> float | None:
    """What load explains it, where one does."""
    theta = base.nominal.theta
    loaded = f.with_load(theta)
    if f.error(loaded)[joint] > LOAD * error[joint]:
        return None
    return float((loaded - theta)[10 * len(f.rows) - 10])
