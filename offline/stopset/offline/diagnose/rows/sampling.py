"""When the samples of a trial were taken, told before anything is made of them: even, stamped anyhow, or with some lost.

Stamps that scatter about an even clock are read as that clock, where the positions are smoother so: a stamp a millisecond off is a
position a milliradian off.  Positions between samples come from a cubic; what lies in a gap says nothing of torque or acceleration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.nominal.stamps import even_clock, lost_between, roughness
from stopset.recording import Recording, Recordings
from stopset.types import Array

ROUNDING = 1e-9  # [s] of stamps that are even but for lost samples


@dataclass(frozen=True, slots=True)
class Sampled:
    """A trial's signals on an even grid; ``torn`` (M,): in a gap; ``scatter`` [s] of stamps that were taken as even, ``lost`` samples."""

    t: Array
    q: Array
    tau: Array
    temp: Array | None
    torn: NDArray[np.bool_]
    scatter: float = 0.0
    lost: int = 0


def period_of(trials: Sequence[Recording]) -> float:
    """Time between samples [s]: of the even clock that the stamps scatter about where there is one, else the usual one."""
    usual = float(np.median([np.median(np.diff(r.t)) for r in trials]))
    uneven = [r.t for r in trials if not _even(r.t, usual)]
    clocks = [clock for t in uneven if (clock := even_clock(t, usual, limit.EVEN)[0]) is not None]
    if not clocks or len(uneven) < limit.UNEVEN * len(trials):
        return usual
    return float(np.median([np.min(np.diff(clock)) for clock in clocks]))


def sampled(r: Recording, dt: float) -> Sampled:
    """A trial on an even grid of step ``dt`` [s], its stamps read as positions are smoother."""
    if _even(r.t, dt):
        return Sampled(r.t, r.q, r.tau, r.temp, np.zeros(len(r.t), np.bool_))
    clock, lost = even_clock(r.t, dt, limit.EVEN)
    readings = [_read(r, r.t, dt, 0.0, lost_between(r.t, dt))]
    if clock is not None:
        readings.append(_read(r, clock, dt, float(np.std(r.t - clock)), lost))
    return min(readings, key=lambda x: roughness(x.q))


def _even(t: Array, dt: float) -> bool:
    return bool(np.max(np.abs(np.diff(t) - dt)) < limit.EVEN * dt)


def _read(r: Recording, t: Array, dt: float, scatter: float, lost: int) -> Sampled:
    """The trial as sampled at the times ``t``."""
    from scipy.interpolate import CubicSpline  # half a second, for what few recordings need

    grid = t[0] + dt * np.arange(int((t[-1] - t[0]) / dt + 1e-6) + 1)
    before = np.clip(np.searchsorted(t, grid, "right") - 1, 0, len(t) - 2)

    def between(x: Array) -> Array:
        return np.stack([np.interp(grid, t, c) for c in x.T], axis=1)

    torn = np.diff(t)[before] > limit.GAP * dt
    return Sampled(
        grid, CubicSpline(t, r.q)(grid), between(r.tau), None if r.temp is None else between(r.temp), torn, scatter, lost
    )


def in_step(recordings: Recordings, lag: float, std: float = 0.0) -> Recordings:
    """The recordings with every torque taken ``lag`` [s] after its stamp, by whole samples; ``std`` [s]: error of the lag.

    What is left of the lag is within what stamps mean; between samples the torque would lose some of its noise.  So is a lag that may be
    less than half a sample: taken for a whole one it would put into the record what every joint's delay then has to take out.
    """

    def earlier(r: Recording) -> Recording:
        dt = period_of([r])
        late = dt * whole_samples(lag, std, dt)
        inside = np.flatnonzero((r.t + late > r.t[0] - dt / 2) & (r.t + late < r.t[-1] + dt / 2))
        if late == 0.0 or r.phase == "static" or len(inside) < 2:
            return r
        tau = np.stack([np.interp(r.t + late, r.t, c) for c in r.tau.T], axis=1)
        return replace(r, tau=tau).cut(int(inside[0]), int(inside[-1]) + 1)

    return replace(recordings, trials=tuple(map(earlier, recordings)))


def whole_samples(lag: float, std: float, dt: float) -> int:
    """How many samples of ``dt`` [s] a ``lag`` [s] is that has the error ``std`` [s]; 0 where it may be less than half of one."""
    return round(lag / dt) if abs(lag) - limit.SURE * std > dt / 2 else 0


def in_words(read: Sequence[Sampled]) -> tuple[str, ...]:
    """What was made of the stamps, where they were not as even as a clock."""
    out, samples = [], sum(len(x.t) for x in read)
    uneven = [x.scatter for x in read if x.scatter > ROUNDING]
    if uneven:
        out.append(
            f"stamps scatter by {1e3 * float(np.median(uneven)):.2g} ms about an even clock in {len(uneven)} of {len(read)} trials: "
            "positions are smoother on that clock, so it was taken"
        )
    lost = sum(x.lost for x in read)
    if lost:
        out.append(f"{lost} samples are lost ({lost / (samples + lost):.1%}): nothing was asked of the torque beside a gap")
    return tuple(out)
