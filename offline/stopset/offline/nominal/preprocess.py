"""From raw samples to what a regression can use: even spacing, zero-phase low-pass, derivatives, stiction left out.

Friction turns over where a joint reverses; a step that went through the low-pass on the torque side only would look
like a missing effect, so `PreparedMotion.smooth` passes every non-smooth regressor through the very same filter.  At standstill
the motor torque is anything inside the stiction band: such samples say nothing of friction and are masked, together
with the filter's ringing around them.

Source: Gautier (1997), Dynamic identification of robots with power model; Liu & Althoff (2018), sec. IV-A.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Generic, NamedTuple, TypeVar
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from stopset.offline.nominal.filters import low_pass, zero_phase
from stopset.offline.nominal.stamps import even_clock, roughness
from stopset.recording.types import Recording
from stopset.types import Array

IRREGULAR = 0.02  # stamps that leave the even grid by more than this part of the period are resampled
GAP = 5.5  # a hole of more samples than this splits a trial: nothing may be invented across it
SLOWEST = 0.06  # cut-off over sampling rate: twice differentiated positions are noise above it
LOWEST = 6.0  # [Hz] of an adapted cut-off: below, the ringing around reversals costs more samples than noise does
CLEAR, ABOVE = 4.0, 1.5  # spectrum over noise where the motion's band ends; cut-off over that end
SEAM = 0.4  # periods of a recorded low-pass within which a piece's end, which it did not have, is felt
T = TypeVar("T")
RINGING = 0.8  # the filter's step response settles to 2 % within this many periods of the cut-off frequency


@dataclass(frozen=True, slots=True)
class Preprocessing:
    """How samples are prepared; part of the identification's settings, so that later recordings are treated alike.

    ``cutoff`` [Hz], lowered to the motion's own `band` and to `SLOWEST` of the sampling rate;
    ``still`` [rad/s]: below it a joint is
    taken to stand still; ``rate`` [Hz] of the rows kept for the regression; ``low_pass`` [Hz]: the cut-off of what the torque went
    through before it was recorded (`stopset.offline.nominal.low_pass`), 0: nothing.
    """

    cutoff: float = 15.0
    still: float = 0.015
    rate: float = 20.0
    low_pass: float = 0.0


@dataclass(frozen=True, slots=True)
class PreparedMotion:
    """One even piece of a trial: ``q, dq, ddq, tau`` (N, n) filtered at full rate, ``retained`` the rows of the regression.

    ``moving`` (N, n): joint not within the stiction band or its ringing; ``raw_tau`` (N, n) before filtering; ``narrow``: the torque
    came low-passed below the motion's band, so that all of a model must pass the same filter, not only what is not smooth.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    raw_tau: Array
    moving: NDArray[np.bool_]
    temp: Array | None
    retained: NDArray[np.intp]
    sos: Array
    narrow: bool = False

    @property
    def period(self) -> float:
        return float(self.t[1] - self.t[0])

    def smooth(self, x: Array) -> Array:
        """A regressor (N, ...) through the filter that the torque went through."""
        return zero_phase(self.sos, x)

    def delayed(self, x: Array, delays: Array) -> Array:
        """``x(t - d)`` (kept rows, n, len(delays)) of a filtered, hence smooth, signal (N, n); the ends repeat."""
        last = len(x) - 1
        steps = np.asarray(delays, float) / self.period
        whole = np.floor(steps).astype(np.intp)
        w = (steps - whole)[:, None, None]
        # four-point Lagrange: exact for cubics, where linear interpolation would lose amplitude near the cut-off
        factors = (
            -(1 - w) * w * (1 + w) / 6,
            (2 - w) * w * (1 + w) / 2,
            (1 - w) * (2 - w) * (1 + w) / 2,
            -(1 - w) * (2 - w) * w / 6,
        )
        at = self.retained - whole[:, None]
        first, *more = (f * x[np.minimum(np.maximum(at + s, 0), last)] for s, f in zip((-2, -1, 0, 1), factors, strict=True))
        for part in more:
            first += part
        return np.ascontiguousarray(first.transpose(1, 2, 0))


def band(q: Array, h: float) -> float:
    """Cut-off [Hz] that keeps the motion and drops what is encoder noise, from the spectrum of ``q`` (N, n).

    Twice differentiated, noise above the motion's band outweighs it; on the regressor's side it pulls inertias down and,
    where viscous torque is large, delays up with them.  The noise is flat in ``q`` and read from its upper half band.
    """
    N = len(q)
    ramp = q[0] + (q[-1] - q[0]) * np.linspace(0, 1, N)[:, None]
    P = np.abs(np.fft.rfft((q - ramp) * np.hanning(N)[:, None], axis=0)) ** 2
    f = np.fft.rfftfreq(N, h)
    noise = np.median(P[len(f) // 2 :], axis=0)
    w = min(5, len(f))
    smooth = np.array([np.convolve(p, np.ones(w) / w, mode="same") for p in P.T]).T
    ends = [f[int(np.argmax(below))] if (below := smooth[:, j] < CLEAR * noise[j]).any() else f[-1] for j in range(q.shape[1])]
    # rounded to half a hertz: few distinct filters, and a trial's end does not decide
    return float(max(LOWEST, np.ceil(2 * ABOVE * float(max(ends))) / 2))


def derivative(x: Array, h: float) -> Array:
    """Time derivative of even samples, five points, error of fourth order; second order at the two ends."""
    out = np.gradient(x, h, axis=0)
    if len(x) > 4:
        out[2:-2] = (x[:-4] - 8 * x[1:-3] + 8 * x[3:-1] - x[4:]) / (12 * h)
    return out


@dataclass(slots=True)
class _Remembered(Generic[T]):
    """What positions give, for the next pass over the same recording: its torque may be another one then, its positions are not."""

    _known: dict[tuple[int, Hashable], tuple[ref[Array], Array, T]] = field(default_factory=dict)

    def of(self, q: Array, beside: Hashable, make: Callable[[], T]) -> T:
        """What ``make`` makes of positions ``q`` and of what stands ``beside`` them; kept as long as the positions are, and are the same."""
        key = (id(q), beside)
        if (found := self._known.get(key)) is not None and found[0]() is q and np.array_equal(found[1], q):
            return found[2]
        out = make()
        self._known[key] = ref(q, lambda _: self._known.pop(key, None)), q.copy(), out
        return out


class _Resampled(NamedTuple):
    """Samples ``taken`` (N,) [s] at times that are not even: the positions ``q`` (M, n) on an even grid ``t`` (M,)."""

    taken: Array
    t: Array
    q: Array

    def on_grid(self, x: Array) -> Array:
        """(M, k) of other readings ``x`` (N, k) of these samples."""
        return np.column_stack([np.interp(self.t, self.taken, c) for c in x.T])


_resampled_of: _Remembered[_Resampled] = _Remembered()


def even_pieces(r: Recording) -> Iterator[tuple[Array, Array, Array, Array | None]]:
    """Evenly spaced ``t, q, tau, temp`` of each stretch without a hole; evenly sampled trials pass unchanged.

    Stamps that scatter are read as the clock they scatter about, where the positions are smoother so.
    """
    dt = np.diff(r.t)
    step = float(np.median(dt))
    holes = np.flatnonzero(dt > GAP * step)
    edges = [0, *(holes + 1).tolist(), len(r.t)]
    for lo, hi in pairwise(edges):
        t, tau, temp = r.t[lo:hi], r.tau[lo:hi], None if r.temp is None else r.temp[lo:hi]
        if hi - lo < 8:
            continue
        even = t[0] + step * np.arange(hi - lo)
        if np.abs(t - even).max() <= IRREGULAR * step:
            yield even, r.q if len(edges) == 2 else r.q[lo:hi], tau, temp
            continue
        read = _resampled_of.of(r.q, (lo, t.tobytes()), partial(_resampled, t, r.q[lo:hi], step))
        yield read.t, read.q, read.on_grid(tau), None if temp is None else read.on_grid(temp)


def _resampled(t: Array, q: Array, step: float) -> _Resampled:
    """Positions ``q`` (N, n) of the stamps ``t``, which are about ``step`` [s] apart."""
    clock, _ = even_clock(t, step)
    stamped = _read(q, t.copy(), float(np.mean(np.diff(t))))  # a copy: what is remembered of a recording must not hold it
    if clock is None:
        return stamped
    return min(stamped, _read(q, clock, float(np.min(np.diff(clock)))), key=lambda x: roughness(x.q))


def _read(q: Array, taken: Array, h: float) -> _Resampled:
    """The positions ``q`` (N, n), taken at the times ``taken``, on a grid of step ``h`` [s]."""
    from scipy.interpolate import CubicSpline  # half a second, for what few recordings need

    grid = taken[0] + h * np.arange(int((taken[-1] - taken[0]) / h + 1e-6) + 1)
    return _Resampled(taken, grid, CubicSpline(taken, q)(grid))


class _Moved(NamedTuple):
    """The positions of an even piece: filtered, differentiated, and where its joints move; `PreparedMotion` says what is what."""

    cutoff: float
    q: Array
    dq: Array
    ddq: Array
    moving: NDArray[np.bool_]


_moved_of: _Remembered[_Moved] = _Remembered()


def _moved(q: Array, h: float, settings: Preprocessing) -> _Moved:
    """Of positions ``q`` (N, n) at a step of ``h`` [s]."""
    cutoff = min(settings.cutoff, SLOWEST / h, band(q, h))
    qf = zero_phase(low_pass(round(cutoff * h, 9)), q)
    dq = derivative(qf, h)
    return _Moved(cutoff, qf, dq, derivative(dq, h), ~_dilated(np.abs(dq) < settings.still, _ring(cutoff * h)))


def _ring(relative: float) -> int:
    """Samples that a filter rings, for its cut-off relative to the sampling rate."""
    return int(np.ceil(RINGING / relative))


def motions(r: Recording, settings: Preprocessing) -> Iterator[PreparedMotion]:
    """The usable pieces of a moving trial, filtered and differentiated; short ones (under the filter's length) are left out."""
    for t, q, tau, temp in even_pieces(r):
        h = float(t[1] - t[0])
        cutoff, qf, dq, ddq, moving = _moved_of.of(q, (h, settings), partial(_moved, q, h, settings))
        ring = _ring(cutoff * h)
        if len(t) < 6 * ring:
            continue
        sos = low_pass(round(cutoff * h, 9))
        every = max(1, round(1 / (h * settings.rate)))
        edge = 2 * ring
        if narrow := 0.0 < settings.low_pass < cutoff:
            sos = low_pass(round(settings.low_pass * h, 9))
            edge = max(edge, int(np.ceil(SEAM / (settings.low_pass * h))))
        retained = np.arange(edge, len(t) - edge, every)
        # what was low-passed already is not low-passed again: the columns then pass its filter once, as it did
        yield PreparedMotion(t, qf, dq, ddq, tau if narrow else zero_phase(sos, tau), tau, moving, temp, retained, sos, narrow)


def _dilated(mask: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """True within ``by`` samples of a True, column by column."""
    count = np.zeros((len(mask) + 1, mask.shape[1]), np.intp)
    np.cumsum(mask, axis=0, out=count[1:])
    k = np.arange(len(mask))
    return np.asarray(count[np.minimum(k + by + 1, len(mask))] - count[np.maximum(k - by, 0)] > 0)


@dataclass(frozen=True, slots=True)
class Pose:
    """A static pose reached from both sides: ``q, tau, direction`` (2, n); friction cancels in the mean of the rows.

    ``direction``: +1 where the joint came from below, -1 from above, by the sign of the torque difference;
    ``count``: samples averaged in each row.
    """

    q: Array
    tau: Array
    direction: Array
    count: int


def pose_of(pair: list[Recording]) -> Pose | None:
    """Mean signals of a pose's trials, or None when it was approached from one side only."""
    if len(pair) < 2:
        return None
    tau = np.array([r.tau.mean(axis=0) for r in pair])
    q = np.array([r.q.mean(axis=0) for r in pair])
    if len(pair) > 2:  # several visits: the extremes of each side are averaged alike, pairs in order
        half = len(pair) // 2 * 2
        tau = tau[:half].reshape(-1, 2, tau.shape[1]).mean(axis=0)
        q = q[:half].reshape(-1, 2, q.shape[1]).mean(axis=0)
    up = np.where(tau[0] >= tau[1], 1.0, -1.0)
    return Pose(q, tau, np.array([up, -up]), min(len(r.t) for r in pair))
