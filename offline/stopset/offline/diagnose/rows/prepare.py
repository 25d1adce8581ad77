"""Recordings made ready for diagnosis: smoothed, thinned to about 50 Hz, with the rows that say nothing marked.

One Gaussian kernel smooths everything alike: its derivatives give speed and acceleration from the position, and each
column of a law passes through the same kernel as the torque, so that smoothing itself can't look like an effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stopset.core.library import check, ffi, given, integers, lib, view
from stopset.errors import RecordingError
from stopset.offline.campaign.session import Session
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.rows.sampling import Sampled, in_words, period_of, sampled
from stopset.offline.nominal.filters import first_order
from stopset.offline.nominal.stamps import step_of, white
from stopset.recording import Recording, Recordings, SuiteKey
from stopset.recording.types import TrialKey
from stopset.types import Array, Index, Mask

KERNEL = 0.012  # [s] standard deviation: -3 dB at 11 Hz; keeps the ripple of 100 cycles per turn at slow and medium speed
LIGHT = 0.006  # [s] for the direction of motion: short, so that a reversal is placed within a sample or two
ONE_DIRECTION = 1.0 - 1e-6  # of a smoothed direction that never changes, but for rounding
ROW_STEP = 0.02  # [s] one row per 20 ms: the kernel leaves little above 25 Hz
WIDER = (1.5, 2.0, 3.0)  # times the usual kernel, for arms that creep: -3 dB at 3.7 Hz, beyond which they do hardly anything


@dataclass(frozen=True, slots=True)
class Kernel:
    """Smoothing over ``+-half`` samples; ``h, h1, h2``: value, first and second derivative; ``sigma`` [s] its width."""

    dt: float
    sigma: float
    half: int
    h: Array
    h1: Array
    h2: Array

    @staticmethod
    def gaussian(dt: float, sigma: float) -> Kernel:
        """A Gaussian of standard deviation ``sigma`` [s], its derivatives exact on polynomials up to second degree."""
        half = int(np.ceil(4 * sigma / dt))
        x = np.arange(-half, half + 1) * dt
        h = np.exp(-0.5 * (x / sigma) ** 2)
        h /= h.sum()
        h1 = x * h
        h1 /= np.sum(x * h1)
        h2 = (x**2 / sigma**2 - 1.0) * h
        h2 -= h2.mean()
        h2 *= 2.0 / np.sum(h2 * x * x)
        return Kernel(dt, sigma, half, h, h1, h2)

    def later(self, part: float) -> Array:
        """``h`` about a point ``part`` of a sample later: unlike interpolation it leaves white noise as it is."""
        x = (np.arange(-self.half, self.half + 1) - part) * self.dt
        h = np.exp(-0.5 * (x / self.sigma) ** 2)
        out: Array = h / h.sum()
        return out


@dataclass(frozen=True, slots=True)
class PreparedTrial:
    """Where one moving trial lies: ``fine`` samples at the recording's rate, ``rows`` after thinning."""

    key: TrialKey
    fine: slice
    rows: slice

    @property
    def unit(self) -> SuiteKey | TrialKey:
        """What is held out together: repetitions of one open-loop suite, else the trial."""
        return self.key[:4] if self.key[1] == "open_loop" else self.key


@dataclass(frozen=True, slots=True)
class Prepared:
    """All moving trials one after another, and the poses held still.

    Rows (N, n): ``q, dq, ddq, tau`` [rad, rad/s, rad/s^2, N m], ``direction`` smoothed direction, ``ok`` the row of this joint says
    something, ``temp`` [degC] or None, ``warm`` (N,) place in the session, ``trial`` (N,) index, ``centre`` (N,) its sample.
    Fine (M, n): the samples lightly smoothed: ``q_fine, dq_fine, direction_fine``; as recorded: ``tau_fine, temp_fine``; (M,)
    ``warm_fine, t_fine``.
    Standstill (P, n): ``q_still, tau_still``, the mean over a pose's approaches from both sides; ``spread_still``: half their
    difference.
    ``torque_noise`` (P, n), ``position_noise`` (n,): white noise of a sample [N m, rad]; ``phase`` (N,): number of each row's phase, as
    a controller's own jitter is in the torque of one phase and not in another's.
    """

    joints: tuple[str, ...]
    kernel: Kernel
    step: int
    trials: tuple[PreparedTrial, ...]
    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    direction: Array
    ok: Mask
    temp: Array | None
    warm: Array
    trial: Index
    centre: Index
    q_fine: Array
    dq_fine: Array
    direction_fine: Array
    tau_fine: Array
    temp_fine: Array | None
    warm_fine: Array
    t_fine: Array
    start_fine: Mask
    q_still: Array
    tau_still: Array
    spread_still: Array
    torque_noise: Array
    phase: Index
    sampling: tuple[str, ...]  # what was made of the stamps, in words
    position_noise: Array

    @property
    def n(self) -> int:
        return len(self.joints)

    def thin(self, fine: Array) -> Array:
        """A column at the recording's rate (M, ...), smoothed like the torque and thinned to the rows (N, ...)."""
        return _at(fine, self.centre, self.kernel.h)

    def torque_at(self, joint: int, lag: float) -> Array:
        """(N,) recorded torque of a joint ``lag`` [s] after each row (before it where negative), held beyond a trial's ends."""
        off = lag / self.kernel.dt
        whole = round(off)
        h, reach = self.kernel.later(off - whole), self.kernel.half + abs(whole)
        out = np.empty(len(self.centre))
        for trial in self.trials:
            x = self.tau_fine[trial.fine, joint]
            padded = np.concatenate([np.full(reach, x[0]), x, np.full(reach, x[-1])])
            out[trial.rows] = _at(padded, self.centre[trial.rows] - trial.fine.start + reach + whole, h)
        return out

    def torque_through(self, joint: int, time: float) -> Array:
        """(N,) recorded torque of a joint through 1 / (``time`` s + 1), each trial begun at rest."""
        x = self.tau_fine[:, joint]
        acted = np.concatenate([first_order(x[trial.fine, None], time / self.kernel.dt)[:, 0] for trial in self.trials])
        return self.thin(acted)


def _at(x: Array, centre: Index, h: Array) -> Array:
    """``x`` weighted by the kernel ``h`` about each sample of ``centre``."""
    flat = np.ascontiguousarray(x.reshape(len(x), -1))
    return _weighted(flat, centre, h).reshape(len(centre), *x.shape[1:])


def _weighted(x: Array, centre: Index, h: Array) -> Array:
    out = np.empty((len(centre), x.shape[1]))
    at, weights = np.ascontiguousarray(centre, np.int64), given(h)
    kernel = ffi.new("StopsetKernel *", (len(h), view(weights)))
    check(lib.stopset_weighted(*x.shape, view(x), len(at), integers(at), kernel, view(out)))
    return out


def prepare(recordings: Recordings) -> Prepared:
    """Make recordings ready. Raises `RecordingError` if no trial is long enough to say anything."""
    moving = [c for r in recordings if r.phase != "static" and (c := _before_brake(r)) is not None]
    if not moving:
        raise RecordingError(
            f"no moving trial of more than {limit.FEWEST_SAMPLES} samples in these recordings; diagnosis needs closed- or open-loop motion"
        )
    dt = period_of(moving)
    kernel, light = Kernel.gaussian(dt, max(KERNEL, 1.2 * dt)), Kernel.gaussian(dt, max(LIGHT, dt))
    step = max(1, round(ROW_STEP / dt))
    grids = [(r, sampled(r, dt)) for r in moving]
    grids = _long_enough(grids, kernel, step)
    if not grids:
        raise RecordingError(f"every moving trial is shorter than {2 * kernel.half * dt:.2f} s; diagnosis needs longer ones")
    noises = [(r.phase, _noise(g.tau, r.tau), _noise(g.q, r.q)) for r, g in grids]
    position_noise = np.median([x for _, _, x in noises], axis=0)
    wide = _widened(kernel, [g.q for _, g in grids], position_noise)
    sparse = round(step * wide.sigma / kernel.sigma)
    smoothed: tuple[str, ...] = ()
    if wide is not kernel and len(_long_enough(grids, wide, sparse)) == len(grids):
        smoothed = (_more(kernel, wide),)
        kernel, step = wide, sparse
    session = Session.of(recordings)
    fine_parts: dict[str, list[Array]] = {k: [] for k in ("raw", "q", "dq", "tau", "t", "warm")}
    temps: list[Array] = []
    trials, centres, offset, rows = [], [], 0, 0
    for r, g in grids:
        m = len(g.t)
        q = g.q
        padded = np.concatenate([2 * q[:1] - q[light.half : 0 : -1], q, 2 * q[-1:] - q[-2 : -light.half - 2 : -1]])
        inside = np.arange(m) + light.half
        fine_parts["raw"].append(q)
        fine_parts["q"].append(_at(padded, inside, light.h))
        fine_parts["dq"].append(_at(padded, inside, light.h1))
        fine_parts["tau"].append(g.tau)
        fine_parts["t"].append(g.t)
        fine_parts["warm"].append(np.full(m, session.warm(r)))
        if g.temp is not None:
            temps.append(g.temp)
        centre = np.arange(kernel.half, m - kernel.half, step) + offset
        trials.append(PreparedTrial(r.key, slice(offset, offset + m), slice(rows, rows + len(centre))))
        centres.append(centre)
        offset, rows = offset + m, rows + len(centre)
    fine = {k: np.concatenate(v) for k, v in fine_parts.items()}
    temp_fine = np.concatenate(temps) if len(temps) == len(grids) else None
    centre, torn = np.concatenate(centres), np.concatenate([g.torn for _, g in grids])
    dq, direction = _at(fine["raw"], centre, kernel.h1), _at(np.sign(fine["dq"]), centre, kernel.h)
    start = np.zeros(offset, bool)
    start[[x.fine.start for x in trials]] = True
    q_still, tau_still, spread_still = _standstill(recordings)
    phases = list(dict.fromkeys(r.phase for r, _ in grids))
    noise = [[x for p, x, _ in noises if p == phase] or [x for _, x, _ in noises] for phase in phases]
    which = np.repeat(np.arange(len(trials)), [x.rows.stop - x.rows.start for x in trials])
    return Prepared(
        joints=recordings.meta.joints, kernel=kernel, step=step, trials=tuple(trials), t=fine["t"][centre],
        q=_at(fine["raw"], centre, kernel.h), dq=dq, ddq=_at(fine["raw"], centre, kernel.h2),
        tau=_at(fine["tau"], centre, kernel.h), direction=direction, ok=_moving(fine["dq"], direction, centre, kernel) & _whole(torn, centre, kernel),
        temp=None if temp_fine is None else _at(temp_fine, centre, kernel.h), warm=fine["warm"][centre],
        trial=which, centre=centre,
        q_fine=fine["q"], dq_fine=fine["dq"], direction_fine=np.sign(fine["dq"]), tau_fine=fine["tau"], temp_fine=temp_fine,
        warm_fine=fine["warm"], t_fine=fine["t"], start_fine=start, q_still=q_still, tau_still=tau_still, spread_still=spread_still,
        torque_noise=np.array([np.median(x, axis=0) for x in noise]), position_noise=position_noise,
        phase=np.array([phases.index(r.phase) for r, _ in grids])[which], sampling=(*in_words([g for _, g in grids]), *smoothed),
    )  # fmt: skip


def _long_enough(grids: Sequence[tuple[Recording, Sampled]], kernel: Kernel, step: int) -> list[tuple[Recording, Sampled]]:
    """The trials that have a row."""
    return [(r, g) for r, g in grids if len(g.t) > 2 * kernel.half + step]


def _widened(kernel: Kernel, positions: Sequence[Array], noise: Array) -> Kernel:
    """The narrowest kernel of `WIDER` through which ``noise`` (n,) [rad] of the ``positions`` is next to nothing of what joints accelerate at.

    It stands in the acceleration and, times the inertia, in what the rows leave: of an arm that creeps it is most of both, and
    evidence that the two agree grows with the rows, for an inertia that is short by the share that it has, for whatever else holds
    inertia (a scale of the torque, a lag, a load), and against what does not.  An arm that creeps moves slowly enough for more smoothing.
    """
    wide = kernel
    for factor in WIDER:
        if _share_of_noise(wide, positions, noise) <= limit.ACCELERATED:
            break
        wide = Kernel.gaussian(kernel.dt, factor * kernel.sigma)
    return wide


def _more(usual: Kernel, wide: Kernel) -> str:
    """That more was smoothed, and what is lost by it."""
    passes = np.sqrt(np.log(2.0)) / (2 * np.pi * wide.sigma)  # -3 dB
    return (
        f"the joints accelerate so little that the positions' noise is more than {limit.ACCELERATED:.0%} of it: all was smoothed over "
        f"{1e3 * wide.sigma:.0f} ms instead of {1e3 * usual.sigma:.0f}, and of what is faster than {passes:.1f} Hz little is told"
    )


def _share_of_noise(kernel: Kernel, positions: Sequence[Array], noise: Array) -> float:
    """Share of ``noise`` (n,) [rad] in the mean square of the acceleration, the median over the joints that move."""
    square, count = np.zeros(len(noise)), np.zeros(len(noise))
    for q in positions:
        at = np.arange(kernel.half, len(q) - kernel.half)
        moving = np.abs(_at(q, at, kernel.h1)) > limit.CREEP
        square += np.sum(_at(q, at, kernel.h2) ** 2 * moving, axis=0)
        count += moving.sum(axis=0)
    asked = (count > limit.FEWEST_ROWS) & (square > 0.0)
    share = noise[asked] ** 2 * float(np.sum(kernel.h2**2)) * count[asked] / square[asked]
    return float(np.median(share)) if len(share) else 0.0


def _before_brake(r: Recording) -> Recording | None:
    """The part of a trial whose torque the drive made: after a power cut the brake's torque is in no channel."""
    if r.phase == "stop0" and r.stop_trigger is not None and r.stop_trigger.any():
        r = r.cut(0, int(np.argmax(r.stop_trigger)))
    return r if len(r.t) > limit.FEWEST_SAMPLES else None


def _whole(torn: Mask, centre: Index, kernel: Kernel) -> Mask:
    """(N, 1) rows within whose kernel no sample was lost."""
    before = np.concatenate([[0], np.cumsum(torn)])
    return np.asarray(before[centre + kernel.half + 1] == before[centre - kernel.half])[:, None]


def _moving(dq_fine: Array, direction: Array, centre: Index, kernel: Kernel) -> Mask:
    """Rows whose joint keeps one direction and moves faster than `CREEP` of the thresholds all through the kernel's inner half."""
    slow = np.zeros(direction.shape, bool)
    reach = kernel.half // 2
    for k in range(-reach, reach + 1):
        slow |= np.abs(dq_fine[centre + k]) < limit.CREEP
    return (np.abs(direction) > ONE_DIRECTION) & ~slow


def _standstill(recordings: Recordings) -> tuple[Array, Array, Array]:
    """One row per pose approached at least twice: friction is what the controller left, but its mean is small."""
    poses: dict[SuiteKey, list[Recording]] = {}
    for r in recordings:
        if r.phase == "static":
            poses.setdefault(r.suite_key, []).append(r)
    repeated: Sequence[list[Recording]] = [rs for rs in poses.values() if len(rs) > 1]
    n = len(recordings.meta.joints)
    if not repeated:
        return np.zeros((0, n)), np.zeros((0, n)), np.zeros((0, n))
    q = np.array([np.mean([r.q.mean(axis=0) for r in rs], axis=0) for rs in repeated])
    tau = np.array([np.mean([r.tau.mean(axis=0) for r in rs], axis=0) for rs in repeated])
    spread = np.array([np.ptp([r.tau.mean(axis=0) for r in rs], axis=0) / 2 for rs in repeated])
    return q, tau, spread


def _noise(x: Array, recorded: Array) -> Array:
    """(n,) white noise of a signal; no less than the steps it was recorded in leave open, also where it was read between samples."""
    steps = np.array([step_of(c) for c in recorded.T])
    return np.asarray(np.maximum(white(x), steps / np.sqrt(12.0)))
