"""Sums over the samples of a campaign, in one pass and constant memory, that the detectors judge afterwards."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stopset.offline.inspect.reversals import add_reversals
from stopset.recording.clock import PAUSE
from stopset.recording.spikes import peaks
from stopset.recording.types import Recording, Spike
from stopset.types import Array

EVEN = 0.02  # relative spread of the period up to which stamps are even
SURE = 3.0  # standard errors of the usual period by which stamps must run late for samples to be missing
GAP = 1.6  # periods between stamps from which on a sample is missing
JUMP, JUMPS_OUT = 0.05, 10.0  # [rad] that no sample explains, and times what the steps of q beside dq usually are
RARE = 0.01  # share of a trial's steps up to which they are jumps, and not a dq that does not follow
STILL = 6.0  # steps of the encoder per window, root mean square: noise makes less
IDLE, IDLE_TRAVEL = 0.05, 0.01  # [rad/s] that the speed of a joint that stands may read, [rad] that it gives way in a trial
WINDOW = 0.1  # [s] way of q against integral of dq: long against noise, short against a motion
LAGS = 15  # samples to each side in which dq is compared with the derivative of q
MOVING = 0.02  # [rad/s]
LONG = 50  # samples from which on a trial's mean period is known to a per cent
FOLLOWS = 0.4  # relative: a step of q is what dq says
SETTLES = 3  # steps at a trial's start that dq does not explain, from which on it is said
PLATEAU = 5  # equal samples in a row at a signal's largest value
NEAR_TOP = 0.9  # of it: sizes whose digits are its own
ROUND = 10.0  # digits by which a smooth maximum falls on either side of the samples that read alike, over as many samples


@dataclass(frozen=True, slots=True)
class Jump:
    """A step of a joint's reading that neither its speed nor the time between two samples explains: ``size`` [rad] at ``t`` [s]."""

    joint: int
    t: float
    size: float
    label: str


@dataclass(slots=True)
class SignalSums:
    """Sums per joint (n,) unless said otherwise; filled by `add`."""

    n: int
    trials: int = 0
    samples: int = 0
    seconds: float = 0.0
    missing: int = 0  # samples, from gaps in the stamps
    gaps: int = 0
    longest_gap: float = 0.0
    pauses: list[float] = field(default_factory=list)  # [s] each
    jumps_of_q: list[Jump] = field(default_factory=list)
    repeated: int = 0  # samples that repeat all signals in the middle of a motion
    jumps: int = 0  # steps of q that dq does not explain, in multiples of a sample, between steps that it does
    over: tuple[float, float] = (0.0, 0.0)  # [rad] by which all steps, and those, are longer than dq says
    twice: int = 0  # rows that the reader left out, as written twice
    unread: int = 0  # and as lacking numbers
    polled: tuple[int, int] = (0, 0)  # and as written again; with those that a logger passed over
    held: float = 1.0  # rows in which a reading stood, at most, of which the reader kept one
    spikes: list[tuple[str, Spike]] = field(default_factory=list)  # trial and torque, for which the reader left a sample out
    peaks: list[tuple[str, Spike]] = field(default_factory=list)  # and those of one sample that stay
    rounded: float = 0.0  # [s] what stamps were printed to, where that is a good part of the period
    settling: float = 0.0  # [s] at a trial's start during which dq does not follow q yet, at most
    bent: tuple[float, float] = (0.0, 0.0)  # [s] that the reader left out at a trial's ends, at most
    jitter: list[float] = field(default_factory=list)  # per trial: spread of the period, relative
    period: list[float] = field(default_factory=list)  # per trial: the usual one
    mean_period: list[float] = field(default_factory=list)  # per trial of at least `LONG`: on average, gaps left out
    windows: int = 0  # of `WINDOW`, that `travel` sums over
    travel: Array = field(init=False)  # (3, n) sums of a^2, a b, b^2: way of q, integral of dq
    lagged: Array = field(init=False)  # (2 LAGS + 1, n) squared difference of dq, shifted, to the derivative of q
    speed2: Array = field(init=False)
    difference: Array = field(init=False)  # (3, n) squared difference of dq to backward, central, forward difference
    power: Array = field(init=False)  # (2, n) sums of tau dq and |tau dq| in motion
    turns: Array = field(init=False)  # (3, n) reversals, and sums of the torque's steps there and of their squares
    resolution: Array = field(init=False)  # smallest step of q
    range_q: Array = field(init=False)  # (n, 2)
    range_dq: Array = field(init=False)
    range_tau: Array = field(init=False)
    range_temp: Array = field(init=False)
    levels: Array = field(init=False)  # different sizes of torque in a trial, at most
    acceleration: Array = field(init=False)  # largest, smoothed over WINDOW
    slow: Array = field(init=False)  # samples in motion below a tenth of the largest speed so far ... of dq_limit
    plateaus: list[tuple[str, int, float, int]] = field(default_factory=list)  # signal, joint, value, samples

    def __post_init__(self) -> None:
        n = self.n
        self.travel, self.difference, self.power, self.turns = (np.zeros((k, n)) for k in (3, 3, 2, 3))
        self.lagged, self.speed2 = np.zeros((2 * LAGS + 1, n)), np.zeros(n)
        self.resolution, self.acceleration, self.slow, self.levels = np.full(n, np.inf), np.zeros(n), np.zeros(n), np.zeros(n)
        for name in ("range_q", "range_dq", "range_tau", "range_temp"):
            setattr(self, name, np.tile([np.inf, -np.inf], (n, 1)))

    @property
    def lost_under_stamps(self) -> bool:
        """Whether the way in all is longer than the stamps by what `jumps` have too much, so that samples were lost; or each step as old as it
        happened to be read."""
        return self.over[0] > 0.5 * self.over[1]

    @property
    def moved(self) -> NDArray[np.bool_]:
        """(n,) whether a joint went further than the steps of its encoder, and than many windows of noise at standstill add up to."""
        step = np.where(np.isfinite(self.resolution), self.resolution, 0.0)
        return np.asarray(self.travel[0] > np.maximum((30 * step) ** 2, self.windows * (STILL * step) ** 2))

    def add(self, r: Recording) -> None:
        """Fold in one trial."""
        self.trials += 1
        self.samples += len(r.t)
        self.seconds += float(r.t[-1] - r.t[0])
        self.twice, self.unread = self.twice + r.twice, self.unread + r.unread
        self.polled = (self.polled[0] + r.again, self.polled[1] + r.skipped)
        self.held = max(self.held, r.held)
        self.spikes += [(r.label, x) for x in r.spikes]
        self.peaks += [(r.label, x) for x in peaks(r)]
        for name, x in (("range_q", r.q), ("range_dq", r.dq), ("range_tau", r.tau), ("range_temp", r.temp)):
            if x is not None:
                old = getattr(self, name)
                setattr(self, name, np.column_stack([np.fmin(old[:, 0], x.min(0)), np.fmax(old[:, 1], x.max(0))]))
        if len(r.t) < 3 * LAGS:
            return
        step = np.abs(np.diff(r.q, axis=0))
        for j in range(self.n):
            moved = step[step[:, j] > 1e-12, j]
            # stored as 32-bit: a smaller step than its rounding is no resolution
            self.resolution[j] = min(self.resolution[j], float(np.percentile(moved, 1)) if len(moved) else np.inf)
        h = self._clock(r)
        self._velocity(r, h, self._torn(r, h))
        self._plateaus(r)
        moving = np.abs(r.dq) > MOVING
        power = np.where(moving, r.tau * r.dq, 0.0)
        self.power += np.array([power.sum(axis=0), np.abs(power).sum(axis=0)])
        if r.phase in ("closed_loop", "open_loop"):
            add_reversals(self.turns, r)

    def _clock(self, r: Recording) -> float:
        dt = np.diff(r.t)
        self.rounded = max(self.rounded, r.rounded)
        self.bent = (max(self.bent[0], r.bent[0]), max(self.bent[1], r.bent[1]))
        h = float(np.median(dt))
        gap, paused = dt > GAP * h, dt >= max(PAUSE, GAP * h)
        lost = gap & ~paused
        self.pauses += dt[paused].tolist()
        self.period.append(h)
        if len(r.t) >= LONG:
            # of stamps as the logger made them: on the robot's clock there are none of what it wrote again
            self.mean_period.append(float(np.mean(dt[~gap])) * (len(r.t) - 1) / (len(r.t) - 1 + r.again))
        self.jitter.append(float(np.std(dt[~gap]) / h) if (~gap).any() else 0.0)
        even = self.jitter[-1] <= EVEN
        missing = int(np.round(dt[lost] / h - 1).sum())
        if not even:  # a late stamp is no lost sample: those after it come early again
            late = float(dt[~paused].sum()) / h - int((~paused).sum()) - SURE * self.jitter[-1] * np.sqrt(len(dt))
            missing = min(missing, max(round(late), 0))
        if missing:
            self.gaps += int(lost.sum())
            self.missing += missing
            self.longest_gap = max(self.longest_gap, float(dt[lost].max()))
        fast = np.abs(r.dq[1:]) > MOVING
        travel = np.abs(0.5 * (r.dq[1:] + r.dq[:-1]) * dt[:, None])
        expected = travel.max(axis=1)
        visible = expected > 4 * np.where(np.isfinite(self.resolution), self.resolution, 0.0).max()
        same = np.all(np.diff(r.q, axis=0) == 0, axis=1) & np.all(np.diff(r.tau, axis=0) == 0, axis=1)
        self.repeated += int(np.sum(same & visible & fast.any(axis=1)))
        step = np.abs(np.diff(r.q, axis=0))
        ratio = step[np.arange(len(step)), travel.argmax(axis=1)] / np.maximum(expected, 1e-12)
        follows = ~visible | (np.abs(ratio - 1.0) < FOLLOWS)
        # a lost sample is one step too long between steps that are right; many in a row are a dq that does not follow
        alone = np.r_[True, follows[:-1]] & np.r_[follows[1:], True]
        if even:  # as made-up stamps are
            long = visible & ~gap & alone & (ratio > 1.7) & (np.abs(ratio - np.round(ratio)) < 0.25)
            self.jumps += int(long.sum())
            over = (ratio - 1.0) * expected
            self.over = (self.over[0] + float(over[visible & ~gap].sum()), self.over[1] + float(over[long].sum()))
        begins = int(np.argmax(follows & visible)) if (follows & visible).any() else 0
        if (~follows[:begins] & visible[:begins]).sum() >= SETTLES:
            self.settling = max(self.settling, float(r.t[begins] - r.t[0]))
        return h

    def _torn(self, r: Recording, h: float) -> NDArray[np.bool_]:
        """(N - 1, n) the steps of q over which it cannot be held against dq: where it jumps, and where nothing was recorded."""
        # a row that repeats the one before is no reading: the next one is as old as that
        new = np.r_[True, np.any(np.diff(r.q, axis=0) != 0, axis=1) | np.any(np.diff(r.tau, axis=0) != 0, axis=1)]
        read = np.maximum.accumulate(np.where(new, np.arange(len(r.t)), 0))
        dt = (r.t[1:] - r.t[read[:-1]])[:, None]
        beside = np.diff(r.q, axis=0) - 0.5 * (r.dq[1:] + r.dq[:-1]) * dt
        silent = np.broadcast_to(dt > max(WINDOW, 2 * GAP * h), beside.shape)
        size = np.where(dt > GAP * h, 0.0, np.abs(beside))
        jump = size > np.maximum(JUMP, JUMPS_OUT * np.percentile(size, 95, axis=0))
        jump &= jump.mean(axis=0) < RARE
        for k, j in np.argwhere(jump):
            jump[k, j] = not self._caught_up(r, new, read, int(k), int(j))
        self.jumps_of_q += [Jump(int(j), float(r.t[k + 1]), float(beside[k, j]), r.label) for k, j in np.argwhere(jump)]
        return jump | silent

    @staticmethod
    def _caught_up(r: Recording, new: NDArray[np.bool_], read: NDArray[np.intp], k: int, j: int) -> bool:
        """Whether from the last ``new`` reading before some that were filled in, up to `WINDOW` ago, the speed explains where a joint is now."""
        early = np.searchsorted(r.t, r.t[k + 1] - WINDOW)
        for at in np.unique(read[early : k + 1][~new[early : k + 1]]).tolist():
            rows = np.r_[at, at + 1 + np.flatnonzero(new[at + 1 : k + 2])]
            travel = float(np.trapezoid(r.dq[rows, j], r.t[rows]))
            if abs(r.q[k + 1, j] - r.q[at, j] - travel) < JUMP:
                return True
        return False

    def _velocity(self, r: Recording, h: float, torn: NDArray[np.bool_]) -> None:
        w = max(3, round(WINDOW / h))
        if len(r.t) > 2 * w:
            integral = np.zeros_like(r.q)
            np.cumsum(0.5 * (r.dq[1:] + r.dq[:-1]) * np.diff(r.t)[:, None], axis=0, out=integral[1:])
            a, b = r.q[w::w] - r.q[:-w:w][: len(r.q[w::w])], integral[w::w] - integral[:-w:w][: len(integral[w::w])]
            whole = ~np.logical_or.reduceat(torn, np.arange(0, len(torn), w), axis=0)[: len(a)]
            # what the speed of a joint that stands reads is no motion that its angle does not follow, nor what it gives way by one of its drive
            stands = (np.ptp(r.q, axis=0) <= IDLE_TRAVEL) & (np.abs(b) < IDLE * w * h)
            a, b = a * whole * ~stands, b * whole * ~stands
            self.windows += len(a)
            self.travel += np.array([(a * a).sum(axis=0), (a * b).sum(axis=0), (b * b).sum(axis=0)])
            mean = np.diff(b, axis=0) * (whole[1:] & whole[:-1]) / (w * h) ** 2
            if len(mean):
                self.acceleration = np.maximum(self.acceleration, np.abs(mean).max(axis=0))
        dt = np.diff(r.t)[:, None]
        backward = np.diff(r.q, axis=0) / dt
        central = (r.q[2:] - r.q[:-2]) / (dt[1:] + dt[:-1])
        inner = slice(LAGS, len(r.t) - LAGS)
        smooth = np.empty_like(r.q)
        smooth[1:-1], smooth[0], smooth[-1] = central, backward[0], backward[-1]
        # a derivative over a torn step is none; rows beside one are left out
        sound = ~(np.r_[torn[:1], torn] | np.r_[torn, torn[-1:]])
        for k in range(-LAGS, LAGS + 1):
            shifted = r.dq[LAGS + k : len(r.t) - LAGS + k]
            self.lagged[k + LAGS] += ((shifted - smooth[inner]) ** 2 * sound[inner]).sum(axis=0)
        self.speed2 += (smooth[inner] ** 2 * sound[inner]).sum(axis=0)
        dq = r.dq[1:-1]
        self.difference += np.array([((dq - d) ** 2 * sound[1:-1]).sum(axis=0) for d in (backward[:-1], central, backward[1:])])

    def _plateaus(self, r: Recording) -> None:
        for name, x in (("tau", r.tau), ("dq", r.dq), ("i", r.current)):
            if x is None:
                continue
            size = np.abs(x)
            for j in range(self.n):
                if name == "tau":
                    self.levels[j] = max(self.levels[j], len(np.unique(size[:, j])))
                top = float(size[:, j].max())
                if top <= 0 or (name == "dq" and top < MOVING):
                    continue
                at_top = size[:, j] >= top * (1 - 1e-6)
                run = _longest(at_top)
                # exact zeros are no reading: no torque asked for yet, or no speed
                usual = _longest((np.diff(x[:, j]) == 0) & (size[1:, j] < 0.95 * top) & (size[1:, j] > 0)) + 1
                if run >= PLATEAU and run > 2 * usual and not _round(size[:, j], at_top, top):
                    self.plateaus.append((name, j, top, run))


def _round(size: Array, at_top: NDArray[np.bool_], top: float) -> bool:
    """Whether every run of a signal's ``size`` (N,) at its ``top`` is a smooth maximum that its digits make flat, and not the edge of a range.

    A parabola that falls by one digit at the end of such a run has fallen by nine a run's length further on, one more by rounding; a signal that
    is clipped comes and goes as steeply as it was.
    """
    decade = 10.0 ** np.floor(np.log10(top))  # digits of a float's decimals: below it they are finer
    values = np.unique(size[size >= max(decade, NEAR_TOP * top)])
    digit = float(np.diff(values).min(initial=np.inf))
    ends = np.flatnonzero(np.diff(np.r_[0, at_top.astype(np.int8), 0])).reshape(-1, 2)
    if not np.isfinite(digit):
        return False
    for a, b in ends.tolist():
        beside = [size[k] for k in (a - (b - a), b + (b - a) - 1) if 0 <= k < len(size)]
        if b - a >= PLATEAU and any(top - x > ROUND * digit for x in beside):
            return False
    return True


def _longest(mask: NDArray[np.bool_]) -> int:
    """Longest run of True."""
    edges = np.flatnonzero(np.diff(np.r_[0, mask.astype(np.int8), 0]))
    return int((edges[1::2] - edges[::2]).max(initial=0))
