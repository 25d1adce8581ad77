"""The ramp of a controlled stop from recorded ones: fixed time or fixed deceleration, its delay, and what tracking errs by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.offline.brakes.bands import DOUBLINGS, WIDEN, WIDENINGS, farther, hull
from stopset.offline.brakes.judge import judge_stop1, pace_before
from stopset.reach.stops.ramp import STILL, Ramp
from stopset.recording import Recording, SuiteKey
from stopset.sets import Box
from stopset.types import Array

KINDS = ("time", "deceleration")
START = 0.005  # [s] delay to start the fit from
SOFT = 0.01  # [rad/s] speeds farther than this from the ramp count less
CONTROL = 2e-3  # [s] least standard deviation of the ramp's start between stops


def fit_ramp(train: Sequence[Recording], requests: Sequence[Recording], noise: Box, notes: list[str]) -> Ramp:
    """The ramp whose bounds enclose the training stops and, by their spread, the next ones.

    ``requests``: training stops of every category: how their speeds were changing when the stop was asked for.
    """
    return ramp_from({kind: fit_all(kind, train) for kind in KINDS}, train, requests, noise, notes)


def ramp_from(
    fits: Mapping[str, Sequence[RampFit]], train: Sequence[Recording], requests: Sequence[Recording], noise: Box, notes: list[str]
) -> Ramp:
    """The same from the ramps of single stops, for either kind of ramp one per training stop."""
    n = train[0].q.shape[1]
    kind = min(fits, key=lambda k: sum(f.misfit for f in fits[k]))
    suites = [r.suite_key for r in train]
    control = _band_of([f.control for f in fits[kind]], suites)
    value = _band_of([f.value for f in fits[kind]], suites)
    # a programmed motion that speeds up slows down again, and may begin to while the ramp slows it further
    paces = [abs(p) for p in (pace_before(r) for r in requests) if p is not None]
    pace = farther(len(paces)) * max(paces) if paces else 0.0
    errors = np.array([_tracking(kind, r, f) for r, f in zip(train, fits[kind], strict=True)])  # (stops, 2, n)
    q_error, dq_error = farther(len(train)) * errors.max(axis=0)
    still = np.maximum(STILL, noise.radius[n:])
    ramp = Ramp(
        "time" if kind == "time" else "deceleration",
        Box.of(np.full(n, max(value[0], 1e-3)), np.full(n, value[1])), Box.of(np.full(n, max(control[0], 0.0)), np.full(n, control[1])),
        q_error, dq_error, source="identified from stop1 recordings", pace=(-pace, pace),
        settle=_settling(kind, train, fits[kind], still, notes), standstill=still,
        fastest=np.max([np.abs(v0) for _, _, v0 in map(_motion, train)], axis=0),
    )  # fmt: skip
    for round_ in range(WIDENINGS + DOUBLINGS):
        outside = judge_stop1(ramp, noise, train).outside
        if not outside:
            break
        by = WIDEN if round_ < WIDENINGS else 2.0
        ramp = replace(
            ramp, value=ramp.value.inflated(WIDEN), q_error=by * ramp.q_error + 1e-5, dq_error=by * ramp.dq_error + 1e-4,
            settle=None if ramp.settle is None else by * ramp.settle,
        )  # fmt: skip
        notes.append(f"the ramp's sets were widened ({round_ + 1}) to enclose {len(outside)} training stops")
    return ramp


def _band_of(values: Sequence[float], suites: Sequence[SuiteKey]) -> tuple[float, float]:
    groups: dict[SuiteKey, tuple[list[float], int]] = {}
    for v, s in zip(values, suites, strict=True):
        seen, count = groups.get(s, ([], 0))
        groups[s] = ([*seen, v], count + 1)
    return hull(groups)


@dataclass(frozen=True, slots=True)
class RampFit:
    """One stop's ramp: start [s], length [s] or deceleration [rad/s^2], pace [1/s] of the motion slowed down, squared misfit."""

    control: float
    value: float
    pace: float
    misfit: float


def _shape(kind: str, t: Array, v0: Array, control: float, value: float, pace: float) -> tuple[Array, Array]:
    """Displacement and speeds (K, n) of a ramp."""
    lasts = np.maximum(np.full(v0.shape, value) if kind == "time" else np.abs(v0) / value, 1e-9)
    s = np.clip((t[:, None] - control) / lasts, 0.0, 1.0)
    path_time = np.minimum(t[:, None], control) + lasts * (s - 0.5 * s * s)
    return v0 * (path_time + 0.5 * pace * path_time * path_time), v0 * (1.0 - s) * np.maximum(1.0 + pace * path_time, 0.0)


def fit_all(kind: str, stops: Sequence[Recording]) -> list[RampFit]:
    """The ramps of all stops.  One that tells start and length only together (a slow one, or one asked for while the motion
    changed its speed) is read with where the others started."""
    alone = np.array([_fit_one(kind, r).control for r in stops])
    middle = float(np.median(alone))
    spread = max(1.4826 * float(np.median(np.abs(alone - middle))), CONTROL)
    return [_fit_one(kind, r, (middle, spread)) for r in stops]


def _fit_one(kind: str, r: Recording, usual: tuple[float, float] | None = None) -> RampFit:
    """The ramp of one stop; ``usual``: mean and standard deviation [s] of the time at which ramps start."""
    from scipy.optimize import least_squares  # half a second, not for who only reads models

    t, v, v0 = _motion(r)
    area = float(np.sum(np.abs(v)) * np.mean(np.diff(t))) / max(float(np.sum(np.abs(v0))), 1e-9)
    guess = max(2.0 * area, 0.02) if kind == "time" else float(np.max(np.abs(v0))) / max(2.0 * area, 0.02)
    before = pace_before(r) or 0.0

    def miss(x: Array) -> Array:
        # a motion goes on changing its speed as before the request, or less when it reaches its constant speed meanwhile
        control, size, pace = x
        _, speeds = _shape(kind, t, v0, float(control), float(np.exp(size)), before * float(pace))
        prior = [] if usual is None else [SOFT * (control - usual[0]) / usual[1]]
        return np.concatenate([(v - speeds).ravel(), prior])

    bounds = ([0.0, -np.inf, 0.0], [0.5 * float(t[-1]), np.inf, 1.0])
    fit = least_squares(miss, [START, np.log(guess), 0.5], bounds=bounds, loss="soft_l1", f_scale=SOFT, max_nfev=80)
    control, size, pace = fit.x.tolist()
    return RampFit(control, float(np.exp(size)), before * pace, float(2.0 * fit.cost))


def _motion(r: Recording) -> tuple[Array, Array, Array]:
    k = r.stop_requested
    assert k is not None
    return r.t[k:] - r.t[k], r.dq[k:], r.dq[k]


def _settling(kind: str, train: Sequence[Recording], fits: Sequence[RampFit], band: Array, notes: list[str]) -> float | None:
    """[s] from the end of the next stop's own ramp until every joint stays slower than ``band`` (n,); None if a stop never rests."""
    late = []
    for r, fit in zip(train, fits, strict=True):
        t, v, v0 = _motion(r)
        moving = np.abs(v) > band
        if moving[-1].any():
            continue
        lasts = np.full(v0.shape, fit.value) if kind == "time" else np.abs(v0) / fit.value
        last = len(t) - 1 - np.argmax(moving[::-1], axis=0)
        rests = np.where(moving.any(axis=0), t[np.minimum(last + 1, len(t) - 1)], 0.0)
        late.append(max(float(np.max(rests - fit.control - lasts)), 0.0))
    if len(late) < len(train):
        notes.append(f"{len(train) - len(late)} of {len(train)} controlled stops were still moving when their recording ended")
        return None
    return farther(len(late)) * max(late)


def _tracking(kind: str, r: Recording, fit: RampFit) -> Array:
    """(2, n) largest error of angle and speed against the stop's own ramp."""
    k = r.stop_requested
    assert k is not None
    t, v, v0 = _motion(r)
    path_time, speeds = _shape(kind, t, v0, fit.control, fit.value, fit.pace)
    return np.array([np.abs(r.q[k:] - r.q[k] - path_time).max(axis=0), np.abs(v - speeds).max(axis=0)])
