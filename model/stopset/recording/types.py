"""What a recording is: samples of one trial, and what is known about how they were taken."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stopset.recording.repetition import POWERED, Motion
from stopset.types import Array

SuiteKey = tuple[int, str, int, int]  # (file, phase, suite, motions of that suite before: 0 where its trials repeat one)
TrialKey = tuple[int, str, int, int, int]  # and the trial

PHASES = ("static", "closed_loop", "open_loop", "stop0", "stop1")
UNCOUNTED = -1  # of a recording made by hand, until `counted` has told its place among the others
EFFORTS = ("motor_torque", "compensated_torque", "motor_current")


@dataclass(frozen=True, slots=True)
class Meta:
    """How the samples were taken; the Parquet key-value metadata ``recording``."""

    joints: tuple[str, ...]
    robot: str = ""
    effort: str = "motor_torque"  # one of EFFORTS; compensated_torque is u of Liu & Althoff (2018), eq. (11)
    velocity: str = "measured"  # or "derived"
    clock: str = "recorded"  # or "assumed"
    rate_hz: float = float("nan")
    torque_constant: tuple[float, ...] | None = None  # [N m/A], link side
    warnings: tuple[str, ...] = ()
    sources: tuple[tuple[str, str], ...] = ()  # (file name, SHA-256)
    said: tuple[str, ...] = ()  # what a monitor took for the causes of violations in it

    @property
    def causes(self) -> tuple[str, ...]:
        """Sentences on what the monitor that wrote the file took its violations for."""
        name = self.sources[0][0] if self.sources else "it"
        return tuple(f"The monitor that wrote {name} took its violation for {cause}" for cause in self.said)


@dataclass(frozen=True, slots=True)
class Spike:
    """A sample at ``t`` [s] whose torque of ``joint`` is by ``size`` [N m] off both neighbours; `without_spikes` says of which nothing happened."""

    t: float
    joint: int
    size: float


@dataclass(frozen=True, slots=True)
class Recording:
    """One trial: ``t`` (N,) [s]; ``q, dq, tau`` (N, n) [rad, rad/s, N m]; the rest where it was recorded.

    ``suite`` and ``trial`` are names: nothing may depend on which numbers a recorder gave.  What counts is the order in the
    campaign: ``place`` of the trial (0, 1, ... in file order; what warms up does so along it), ``begun``: suites of its
    phase that its file began before its own, ``other``: motions that its suite held before its own, 0 where the trials of a suite
    repeat one as they should, ``repetition``: trials of this motion before it (see `counted`).
    """

    phase: str
    suite: int
    trial: int
    place: int
    t: Array
    q: Array
    dq: Array
    tau: Array
    temp: Array | None = None  # (N, n) [degC]
    current: Array | None = None  # (N, n) [A]
    q_link: Array | None = None  # (N, n) [rad] angle behind the gear, by a second encoder; nan where a joint has none
    stop_trigger: NDArray[np.bool_] | None = None  # (N,)
    file: int = 0  # which of the files read together it comes from
    condition: str = ""  # what the arm carried, which day it was: recordings of different conditions are not fitted as one
    rounded: float = 0.0  # [s] what its stamps were printed to, where they were put back on the even clock they came from
    bent: tuple[float, float] = (0.0, 0.0)  # [s] left out at its beginning and end, where speeds contradict positions
    twice: int = 0  # rows left out that were written twice
    unread: int = 0  # rows left out that lack numbers, see `sound_rows`
    spikes: tuple[Spike, ...] = ()  # for which samples were left out, see `without_spikes`
    again: int = 0  # readings left out that a logger wrote again for want of a new one, see `on_its_clock`
    skipped: int = 0  # readings that it passed over: lost samples on the clock that the trial stands on
    held: float = 1.0  # rows in which each reading stood, of which one is here, see `each_once`
    repetition: int = UNCOUNTED
    begun: int = UNCOUNTED
    other: int = 0

    def __post_init__(self) -> None:
        # made by hand, trials and suites are numbered in their order
        if self.repetition == UNCOUNTED:
            object.__setattr__(self, "repetition", self.trial)
        if self.begun == UNCOUNTED:
            object.__setattr__(self, "begun", self.suite)

    @property
    def suite_key(self) -> SuiteKey:
        """What repeats: trials of one suite share start and torques, so the suite, not the trial, is independent.

        Every recorder counts its suites from zero: suites of another file are other suites, whatever their number; and so are
        trials that were given one suite's number and repeat nothing.
        """
        return (self.file, self.phase, self.suite, self.other)

    @property
    def key(self) -> TrialKey:
        return (*self.suite_key, self.trial)

    @property
    def label(self) -> str:
        return f"{self.phase} suite {self.suite} trial {self.trial}{_of_file(self.file)}"

    @property
    def fingerprint(self) -> bytes:
        """Of its angles and torques: noise makes every recording its own, so that only a copy has the same."""
        return hashlib.blake2b(self.q.tobytes() + self.tau.tobytes()).digest()

    @property
    def stop_requested(self) -> int | None:
        """Index of the first sample of the stop request; None where the recording does not hold it."""
        if self.stop_trigger is None or not np.any(self.stop_trigger):
            return None
        return int(np.argmax(self.stop_trigger))

    def cut(self, lo: int, hi: int) -> Recording:
        """Samples ``lo`` up to ``hi`` (exclusive) of every signal."""
        return self.rows(slice(lo, hi))

    def rows(self, at: slice | NDArray[np.intp]) -> Recording:
        """The samples ``at`` of every signal."""

        def part(x: Array | None) -> Array | None:
            return None if x is None else x[at]

        trigger = None if self.stop_trigger is None else self.stop_trigger[at]
        return replace(
            self, t=self.t[at], q=self.q[at], dq=self.dq[at], tau=self.tau[at],
            temp=part(self.temp), current=part(self.current), q_link=part(self.q_link), stop_trigger=trigger,
        )  # fmt: skip


def suite_label(key: SuiteKey) -> str:
    """The suite in words."""
    file, phase, suite, other = key
    return f"{phase} suite {suite}{f', motion {other + 1}' if other else ''}{_of_file(file)}"


def _of_file(file: int) -> str:
    return f" of file {file + 1}" if file else ""


@dataclass(frozen=True, slots=True)
class Recordings:
    """All trials of one or several files, in campaign order."""

    meta: Meta
    trials: tuple[Recording, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.trials)

    def __iter__(self) -> Iterator[Recording]:
        return iter(self.trials)

    def phase(self, *names: str) -> Recordings:
        """The trials of these phases only."""
        return replace(self, trials=tuple(r for r in self.trials if r.phase in names))

    @property
    def phases(self) -> tuple[str, ...]:
        return tuple(p for p in PHASES if any(r.phase == p for r in self.trials))

    @property
    def suites(self) -> dict[SuiteKey, tuple[Recording, ...]]:
        """Trials by `Recording.suite_key`."""
        out: dict[SuiteKey, list[Recording]] = {}
        for r in self.trials:
            out.setdefault(r.suite_key, []).append(r)
        return {k: tuple(v) for k, v in out.items()}

    @property
    def samples(self) -> int:
        return sum(len(r.t) for r in self.trials)


def counted(trials: Iterable[Recording]) -> Iterator[Recording]:
    """``trials``, whole files in campaign order, with the ``other``, ``repetition`` and ``begun`` that this order gives them."""
    motions: dict[tuple[int, str, int], list[Motion]] = {}
    repetitions: dict[SuiteKey, int] = {}
    suites: dict[tuple[int, str], dict[int, int]] = {}
    for r in trials:
        mine = replace(r, other=_motion_of(r, motions.setdefault((r.file, r.phase, r.suite), [])))
        repetition = repetitions.get(mine.suite_key, 0)
        repetitions[mine.suite_key] = repetition + 1
        here = suites.setdefault((r.file, r.phase), {})
        yield replace(mine, repetition=repetition, begun=here.setdefault(r.suite, len(here)))


def _motion_of(r: Recording, known: list[Motion]) -> int:
    """Which of the motions that its suite held so far a trial repeats; one that repeats none is added to them."""
    if r.phase not in POWERED:
        return 0
    mine = Motion.of(r.t, r.q, r.tau)
    for k, motion in enumerate(known):
        if motion.repeated_by(mine):
            return k
    known.append(mine)
    return len(known) - 1
