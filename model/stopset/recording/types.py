"""What a recording is: samples of one trial, and what is known about how they were taken."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PHASES = ("static", "closed_loop", "open_loop", "stop0", "stop1")
SUITES_PER_FILE = 2**32  # more than a 32-bit suite number can count
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


@dataclass(frozen=True, slots=True)
class Recording:
    """One trial: ``t`` (N,) [s]; ``q, dq, tau`` (N, n) [rad, rad/s, N m]; the rest where it was recorded.

    ``place`` is the trial's position in the campaign (0, 1, ... in file order): what warms up does so along it.
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
    stop_trigger: NDArray[np.bool_] | None = None  # (N,)
    file: int = 0  # which of the files read together it comes from

    @property
    def key(self) -> tuple[str, int, int]:
        return (self.phase, self.suite, self.trial)

    @property
    def label(self) -> str:
        return f"{self.phase} suite {self.suite} trial {self.trial}" + (f" of file {self.file + 1}" if self.file else "")

    @property
    def motion(self) -> tuple[str, int]:
        """What repeats: trials of one suite share start and torques, so the suite, not the trial, is independent.

        Every recorder counts its suites from zero: suites of another file are other suites, whatever their number.
        """
        return (self.phase, self.suite + SUITES_PER_FILE * self.file)

    def cut(self, lo: int, hi: int) -> Recording:
        """Samples ``lo`` up to ``hi`` (exclusive) of every signal."""

        def part(x: Array | None) -> Array | None:
            return None if x is None else x[lo:hi]

        trigger = None if self.stop_trigger is None else self.stop_trigger[lo:hi]
        return replace(
            self, t=self.t[lo:hi], q=self.q[lo:hi], dq=self.dq[lo:hi], tau=self.tau[lo:hi],
            temp=part(self.temp), current=part(self.current), stop_trigger=trigger,
        )  # fmt: skip


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
    def suites(self) -> dict[tuple[str, int], tuple[Recording, ...]]:
        """Trials by `Recording.motion`."""
        out: dict[tuple[str, int], list[Recording]] = {}
        for r in self.trials:
            out.setdefault(r.motion, []).append(r)
        return {k: tuple(v) for k, v in out.items()}

    @property
    def samples(self) -> int:
        return sum(len(r.t) for r in self.trials)
