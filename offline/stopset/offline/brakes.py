"""Brakes and ramps from recorded stops: what power-off and a controlled stop really do, with intervals and a guarantee.

STOP 0. While joint i slides, its momentum ``p_i = (M v)_i`` obeys ``p_i' = 1/2 v' dM/dq_i v - g_i - D v_i - F s_i - b_i s_i``
with ``s_i`` its direction, so the impulse the brake has given is read off the measured motion without differentiating it.
Per joint a torque, a delay and a rise time are fitted to these curves of all training stops, with a delay and a torque of
their own per stop; the intervals are hulls over the stops with a margin for the next ones, then widened until the stop bound
encloses every training stop.  The held-out stops are only used to count violations.

STOP 1. The speeds follow a common ramp of fixed time or fixed deceleration after a delay; tracking errors are what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from stopset.artifact import Brakes, Guarantee, Model
from stopset.errors import RecordingError
from stopset.offline.conform.guarantee import clopper_pearson
from stopset.offline.stops.measured import trigger_of
from stopset.reach.stops.expansion import expand
from stopset.reach.stops.plant import Setting, setting_of
from stopset.reach.stops.ramp import KEY, Ramp, ramp_tube
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import tubes_of
from stopset.recording import Recording
from stopset.sets import Box

Array = NDArray[np.float64]
CONFIDENCE = 0.95
SLIDING = 0.04  # [rad/s] below this a joint counts as coming to rest
LEAST = 4  # training stops needed
WIDENINGS = 6
WIDEN = 1.15  # of the intervals, per round, until the training stops are enclosed
PIECES = 4
OUTLIER = 9.0  # squared misfit per sample (three times the noise) beyond which a stop counts no more
SIGNIFICANT = 9.0  # squared misfit, three standard deviations of one parameter
FAR = 3.7  # times the median deviation: 2.5 standard deviations of a normal population
SHARP = 0.012  # [s] a delay known no better than this is not counted
REST = 15  # samples at the end of a stop that tell the noise


@dataclass(frozen=True, slots=True)
class StopFit:
    """What the recorded stops tell; None where a phase was not recorded. ``tables``: per joint, for people."""

    brakes: Brakes | None
    ramp: Ramp | None
    noise: Box | None  # (2n,) measurement error of (q, dq), from the arm at rest after its stops
    stop0: Guarantee | None
    stop1: Guarantee | None
    notes: tuple[str, ...]


def with_stops(model: Model, fit: StopFit) -> Model:
    """The model with the identified brakes and ramp; the guarantee lines go into its notes."""
    provenance = dict(model.provenance)
    if fit.ramp is not None:
        provenance[KEY] = fit.ramp.as_dict()
    lines = [g.text for g in (fit.stop0, fit.stop1) if g is not None]
    known = _with_noise(model, fit.noise)
    return replace(known, brakes=fit.brakes or model.brakes, provenance=provenance, notes=(*model.notes, *fit.notes, *lines))


def _with_noise(model: Model, noise: Box | None) -> Model:
    """The model with the regime 'stop0': the powered regime's torque set, and what the measurement of the state errs by."""
    if noise is None:
        return model
    sets = model.powered
    return replace(model, sets={**model.sets, "stop0": replace(sets, X0=noise, V=noise, active=())})


def rest_noise(stops: Sequence[Recording], n: int) -> Box | None:
    """Largest deviations of angle and speed while the arm rests at the end of its stops, half as much again."""
    angle, speed = np.zeros(n), np.zeros(n)
    seen = 0
    for r in stops:
        tail = slice(len(r.t) - REST, len(r.t))
        if len(r.t) < 3 * REST or np.any(np.abs(np.mean(r.dq[tail], axis=0)) > 0.01):
            continue
        angle = np.maximum(angle, np.abs(r.q[tail] - np.mean(r.q[tail], axis=0)).max(axis=0))
        speed = np.maximum(speed, np.abs(r.dq[tail]).max(axis=0))
        seen += 1
    if seen < LEAST:
        return None
    return Box.symmetric(np.concatenate([1.5 * np.maximum(angle, 1e-5), 1.5 * np.maximum(speed, 1e-4)]))


def identify_stops(model: Model, recordings: Iterable[Recording]) -> StopFit:
    """Brakes from stop0 and the ramp from stop1 recordings, every other stop held out.

    Recordings of other phases are ignored.  Raises `RecordingError` if stops carry no ``stop_trigger``.
    """
    stops: dict[str, list[Recording]] = {"stop0": [], "stop1": []}
    for r in recordings:
        if r.phase in stops:
            if trigger_of(r) is None:
                raise RecordingError(
                    f"{r.label} has no stop_trigger that turns true; expected the moment of the stop request: record it or "
                    f"leave the file out"
                )
            stops[r.phase].append(r)
    notes: list[str] = []
    train = [r for rows in stops.values() for r in divide(rows)[0]]
    noise = rest_noise(train, model.n)
    model = _with_noise(model, noise)
    brakes, stop0 = _fit_brakes(model, stops["stop0"], notes) if stops["stop0"] else (None, None)
    ramp, stop1 = _fit_ramp(model, stops["stop1"], notes) if stops["stop1"] else (None, None)
    return StopFit(brakes, ramp, noise, stop0, stop1, tuple(notes))


def divide(stops: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out stops, alternating within each suite."""
    by_suite: dict[int, list[Recording]] = {}
    for r in stops:
        by_suite.setdefault(r.suite, []).append(r)
    train = [r for rows in by_suite.values() for r in rows[0::2]]
    held = [r for rows in by_suite.values() for r in rows[1::2]]
    return train, held


def _beyond(count: int) -> float:
    """By how much of its width a hull of ``count`` values is widened on each side.

    For values spread evenly over a tolerance band the gap to the band's end is exponential with mean width/(count + 1):
    three means hold it with 95 % (`CONFIDENCE`).  The held-out stops judge the result.
    """
    return 3.0 / max(count - 1, 1)


def _spread(values: Array) -> tuple[float, float]:
    """Interval for the next stops, never smaller than what was seen."""
    lo, hi = float(values.min()), float(values.max())
    more = _beyond(len(values)) * (hi - lo)
    return lo - more, hi + more


# ---- STOP 0 ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Impulse:
    """Impulse of one joint's brake in one stop: at ``t`` (K,) [s] after the trigger, ``given`` (K,) [N m s], with its noise."""

    t: Array
    given: Array
    noise: float


def impulses(setting: Setting, r: Recording) -> list[Impulse | None]:
    """What every joint's brake has given, while that joint slid; None for joints that hardly moved."""
    k = trigger_of(r)
    assert k is not None
    plant, n = setting.plant, setting.plant.rotor.shape[0]
    F = 0.5 * (plant.coulomb_lo + plant.coulomb_hi)
    D = 0.5 * (plant.viscous_lo + plant.viscous_hi)
    t, q, v = r.t[k:] - r.t[k], r.q[k:], r.dq[k:]
    sliding = np.logical_and.accumulate((np.abs(v) > SLIDING) & (np.sign(v) == np.sign(v[0])), axis=0)
    longest = int(sliding.sum(axis=0).max())
    if longest < 3:
        return [None] * n
    p, rate = np.empty((longest, n)), np.empty((longest, n))
    M = np.eye(n)
    for s in range(longest):
        E = expand(plant.chain, plant.pi, plant.pi_half, plant.rotor, q[s])
        M = E.M
        p[s] = M @ v[s]
        # resting joints' friction is unknown but their rows are not used
        rate[s] = 0.5 * np.einsum("jki,j,k->i", E.dM, v[s], v[s]) - E.g - D * v[s] - F * np.sign(v[s])
    step = np.diff(t[:longest])[:, None]
    push = np.vstack([np.zeros(n), np.cumsum(0.5 * step * (rate[1:] + rate[:-1]), axis=0)])
    noise = np.sqrt((M**2) @ (setting.noise.radius[n:] / 2.0) ** 2)
    out: list[Impulse | None] = []
    for i in range(n):
        count = int(sliding[:, i].sum())
        if count < 3:
            out.append(None)
            continue
        sign = np.sign(v[0, i])
        given = sign * (p[0, i] + push[:count, i] - p[:count, i])
        out.append(Impulse(t[:count].copy(), given, float(max(noise[i], 1e-6))))
    return out


def _unit_ramp(t: Array, delays: Array, rise: float) -> Array:
    """(D, K) impulse of a brake of 1 N m at ``t`` (K,), for every delay (D,)."""
    x = np.maximum(t[None, :] - delays[:, None], 0.0)
    return np.where(x < rise, 0.5 * x * x / max(rise, 1e-9), x - 0.5 * rise)


def _misfits(c: Impulse, drift: float, delays: Array, rise: float, levels: Array) -> Array:
    """(L, D) squared misfit of one stop for every level and delay, the best offset and friction of this stop taken off.

    A stop's own offset (noise of its first speed) and friction (within ``drift`` of the model's) are linear with priors, so
    they are projected out once.
    """
    H = np.stack([np.ones_like(c.t), drift * c.t / c.noise], axis=1)
    Q = np.eye(len(c.t)) - H @ np.linalg.solve(np.eye(2) + H.T @ H, H.T)
    y, R = c.given / c.noise, _unit_ramp(c.t, delays, rise) / c.noise
    RQ = R @ Q
    out: Array = y @ Q @ y - 2.0 * levels[:, None] * (RQ @ y) + levels[:, None] ** 2 * np.sum(RQ * R, axis=1)
    return out


def _fit_joint(curves: list[Impulse], guess: float, friction: float) -> tuple[float, float, Array, Array]:
    """Torque, rise, and per stop delay and torque of one joint's brake, from the impulses of the training stops.

    A search over torque and rise, each stop taking its own best delay: no start value to be wrong about.
    """
    drift = 0.1 * friction + 1e-3  # how far a stop's friction may lie from the model's, as prior
    delays = np.arange(0.0, max(float(c.t[-1]) for c in curves), 5e-4)
    levels, rises = guess * np.exp(np.linspace(-1.2, 1.2, 97)), np.array([1, 3, 5, 8, 11, 14, 18, 23, 30, 40]) * 1e-3
    prior = (np.log(levels / guess) / 0.3) ** 2
    best = (np.inf, guess, 0.01)
    for rise in rises:
        # one stop that no ramp explains must not decide for the others
        cost = prior + sum(np.minimum(_misfits(c, drift, delays, rise, levels).min(axis=1), OUTLIER * len(c.t)) for c in curves)
        k = int(np.argmin(cost))
        best = min(best, (float(cost[k]), float(levels[k]), float(rise)))
    _, level, rise = best
    told, own = [], []
    for c in curves:
        cost = _misfits(c, drift, delays, rise, np.array([level]))[0]
        d = float(delays[int(np.argmin(cost))])
        alike = delays[cost < cost.min() + SIGNIFICANT]
        # a stop tells its delay if it shows the brake at all, and when: not if the joint came to rest before
        if np.ptp(alike) > SHARP or float(alike[-1]) > float(c.t[-1]) - 0.5 * rise:
            continue
        told.append(d)
        if np.count_nonzero(c.t > d + rise) >= 5:
            near = delays[np.abs(delays - d) < 0.015]
            own.append(float(levels[np.argmin(_misfits(c, drift, near, rise, levels).min(axis=1))]))
    return level, rise, np.array(told), np.array(own)


def _fit_brakes(model: Model, stops: list[Recording], notes: list[str]) -> tuple[Brakes | None, Guarantee | None]:
    train, held = divide(stops)
    if len(train) < LEAST:
        notes.append(f"{len(stops)} stop0 recordings are too few to identify brakes; expected at least {2 * LEAST}")
        return None, None
    n = model.n
    assumed = model.brakes
    wide = assumed or Brakes(
        Box.of(np.ones(n), np.full(n, 100.0)), Box.of(np.zeros(n), np.full(n, 0.1)), Box.of(np.full(n, 1e-3), np.full(n, 0.05))
    )
    setting = setting_of(replace(model, brakes=wide))
    assert setting is not None
    seen = [impulses(setting, r) for r in train]
    rows: list[tuple[tuple[float, float], ...] | None] = []
    delays: list[Array] = []
    for i in range(n):
        curves = [s[i] for s in seen]
        known = [c for c in curves if c is not None and c.t[-1] > 0.01]
        if len(known) < LEAST:
            rows.append(None)
            continue
        level, rise, delay, levels = _fit_joint(known, float(wide.torque.centre[i]), float(setting.plant.coulomb_hi[i]))
        credible = 0.5 * wide.torque.lo[i] <= level <= 2.0 * wide.torque.hi[i]
        if len(delay) < 3 or not credible:
            if len(delay) >= 3:
                notes.append(
                    f"the stops make the brake of {model.joints[i]} {level:.3g} N m, its data sheet "
                    f"{wide.torque.lo[i]:.3g} to {wide.torque.hi[i]:.3g}: not believed"
                )
            rows.append(None)
            continue
        torque = _spread(levels) if len(levels) >= 3 else (0.85 * level, 1.15 * level)
        rows.append((torque, _spread(delay), (0.6 * rise, 1.4 * rise)))
        delays.append(delay)
    _share_delays(rows, delays, notes)
    if not any(rows):
        notes.append("no joint was still moving when its brake engaged; brakes cannot be identified from these stops")
        return None, None
    brakes = _filled(model, wide, rows, notes)
    brakes = _widened(model, brakes, train, notes)
    return brakes, _guarantee(model, brakes, held, len(train))


def _share_delays(rows: list[tuple[tuple[float, float], ...] | None], delays: list[Array], notes: list[str]) -> None:
    """One delay interval for all joints whose delays do not differ by more than they scatter: one power stage cuts them."""
    told = [i for i, r in enumerate(rows) if r is not None]
    if len(told) < 2:
        return
    everything = np.concatenate(delays)
    middle = float(np.median(everything))
    near = np.abs(everything - middle) <= FAR * max(float(np.median(np.abs(everything - middle))), 1e-3)
    if not np.all(near):
        notes.append(f"{int(np.sum(~near))} of {len(near)} brake delays lie far from the others and were left out of the hull")
        everything = everything[near]
    apart = [abs(float(np.median(d)) - middle) for d in delays]
    if max(apart) > 2.0 * float(np.std(everything, ddof=1)):
        return
    for i in told:
        torque, _, rise = rows[i]  # type: ignore[misc]
        rows[i] = (torque, _spread(everything), rise)


def _filled(model: Model, wide: Brakes, rows: Sequence[tuple[tuple[float, float], ...] | None], notes: list[str]) -> Brakes:
    """Intervals of all joints; one that told nothing keeps its torque, and shares the others' delay and rise."""
    n = model.n
    told = [r for r in rows if r is not None]
    common = [(min(r[k][0] for r in told), max(r[k][1] for r in told)) for k in (1, 2)]
    torque, delay, rise = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2))
    for i, r in enumerate(rows):
        if r is None:
            torque[i] = wide.torque.lo[i], wide.torque.hi[i]
            delay[i], rise[i] = common
            notes.append(f"the brake of {model.joints[i]} was not seen: its torque is as before, its timing the other joints'")
        else:
            torque[i], delay[i], rise[i] = r
    delay, rise, torque = np.maximum(delay, 0.0), np.maximum(rise, 1e-4), np.maximum(torque, 1e-3)
    return Brakes(Box.of(*torque.T), Box.of(*delay.T), Box.of(*rise.T), source="identified from stop0 recordings")


def _grown(brakes: Brakes, factor: float) -> Brakes:
    def grow(box: Box, floor: float) -> Box:
        wide = box.inflated(factor)
        return Box(np.maximum(wide.lo, floor), wide.hi)

    # an interval without width does not grow by a factor: 1 ms and 1 % are the resolution of a 250 Hz record
    torque = Box(brakes.torque.lo * 0.99, brakes.torque.hi * 1.01)
    delay = Box(np.maximum(brakes.delay.lo - 1e-3, 0.0), brakes.delay.hi + 1e-3)
    return replace(brakes, torque=grow(torque, 1e-3), delay=grow(delay, 0.0), rise=grow(brakes.rise, 1e-4))


def _widened(model: Model, brakes: Brakes, train: Sequence[Recording], notes: list[str]) -> Brakes:
    """The intervals grown until the stop bound encloses every training stop."""
    for round_ in range(WIDENINGS + 1):
        outside, open_ = violations(replace(model, brakes=brakes), train)
        if not outside:
            if round_:
                notes.append(f"brake intervals were widened {round_} times by {WIDEN:.0%} to enclose all training stops")
            if open_:
                notes.append(f"{open_} of {len(train)} training stops have no certified bound to be held against")
            return brakes
        brakes = _grown(brakes, WIDEN)
    notes.append(
        f"training stops still leave the bound after {WIDENINGS} widenings: {', '.join(outside[:3])}; the model lacks something"
    )
    return brakes


def violations(model: Model, stops: Sequence[Recording]) -> tuple[list[str], int]:
    """Labels of recorded power-off stops that leave their certified tube, and how many have none."""
    setting = setting_of(model)
    assert setting is not None
    outside, open_ = [], 0
    for r in stops:
        fits = stop0_fits(setting, r)
        if fits is None:
            open_ += 1
        elif not fits:
            outside.append(r.label)
    return outside, open_


def stop0_fits(setting: Setting, r: Recording) -> bool | None:
    """Whether every measured sample after the trigger lies in the STOP 0 tube and its noise; None without certificate."""
    k = trigger_of(r)
    assert k is not None
    n, noise = r.q.shape[1], setting.noise
    q, dq = r.q[k] - noise.centre[:n], r.dq[k] - noise.centre[n:]
    tubes = tubes_of(setting, q, dq, noise.radius[:n], noise.radius[n:], PIECES)
    if tubes[-1].end != OK:
        return None
    return bool(np.all(inside(tubes, r.t[k:] - r.t[k], r.q[k:] - r.q[k], r.dq[k:], noise)))


def inside(tubes: Sequence[Tube], t: Array, travel: Array, dq: Array, noise: Box) -> NDArray[np.bool_]:
    """Per sample, whether measured displacement and speed lie in the hull of the tubes, measurement error included."""
    n = travel.shape[1]
    width = 2.0 * noise.radius[:n]  # the displacement is a difference of two measured angles
    lo, hi = np.full(travel.shape, np.inf), np.full(travel.shape, -np.inf)
    v_lo, v_hi = lo.copy(), hi.copy()
    for tube in tubes:
        for j in range(n):
            lo[:, j] = np.minimum(lo[:, j], np.interp(t, tube.t, tube.d_lo[:, j]))
            hi[:, j] = np.maximum(hi[:, j], np.interp(t, tube.t, tube.d_hi[:, j]))
            v_lo[:, j] = np.minimum(v_lo[:, j], np.interp(t, tube.t, tube.v_lo[:, j]))
            v_hi[:, j] = np.maximum(v_hi[:, j], np.interp(t, tube.t, tube.v_hi[:, j]))
    good = (travel >= lo - width) & (travel <= hi + width)
    good &= (dq >= v_lo + noise.lo[n:]) & (dq <= v_hi + noise.hi[n:])
    return np.asarray(good.all(axis=1))


def _guarantee(model: Model, brakes: Brakes, held: Sequence[Recording], trained: int) -> Guarantee:
    outside, open_ = violations(replace(model, brakes=brakes), held)
    return _line("STOP 0", len(held) - open_, len(outside), trained, open_)


def _line(what: str, tried: int, violated: int, trained: int, open_: int = 0) -> Guarantee:
    bound = clopper_pearson(violated, tried, CONFIDENCE) if tried else 1.0
    without = f"; {open_} more have no certified bound" if open_ else ""
    text = (
        f"{what}: {violated} of {tried} held-out stops leave their bound; at {CONFIDENCE:.0%} confidence fewer than "
        f"{bound:.1%} of such stops do ({trained} stops were used to identify{without})"
    )
    return Guarantee(tried, violated, bound, CONFIDENCE, text, trained)


# ---- STOP 1 ------------------------------------------------------------------------------------------------------------


def _shape(kind: str, t: Array, v0: Array, control: float, value: float) -> Array:
    """Speeds (K, n) of a ramp."""
    lasts = np.full(v0.shape, value) if kind == "time" else np.abs(v0) / value
    s = np.clip((t[:, None] - control) / np.maximum(lasts, 1e-9), 0.0, 1.0)
    return v0 * (1.0 - s)


def _fit_one(kind: str, t: Array, v: Array, v0: Array) -> tuple[float, float, float]:
    """Delay, value and squared misfit of the ramp of one stop."""
    area = float(np.sum(np.abs(v)) * np.mean(np.diff(t))) / max(float(np.sum(np.abs(v0))), 1e-9)
    guess = max(2.0 * area, 0.02) if kind == "time" else float(np.max(np.abs(v0))) / max(2.0 * area, 0.02)

    def miss(x: Array) -> Array:
        return np.asarray(v - _shape(kind, t, v0, abs(float(x[0])), float(np.exp(x[1])))).ravel()

    fit = least_squares(miss, [0.005, np.log(guess)], loss="soft_l1", f_scale=0.01, max_nfev=80)
    return abs(float(fit.x[0])), float(np.exp(fit.x[1])), float(2.0 * fit.cost)


def _fit_ramp(model: Model, stops: list[Recording], notes: list[str]) -> tuple[Ramp | None, Guarantee | None]:
    train, held = divide(stops)
    if len(train) < LEAST:
        notes.append(f"{len(stops)} stop1 recordings are too few to identify a ramp; expected at least {2 * LEAST}")
        return None, None
    setting = setting_of(model)
    noise = setting.noise if setting is not None else model.sets.get("stop0", model.powered).V
    n = model.n
    fits = {kind: [_fit_one(kind, *_motion(r)) for r in train] for kind in ("time", "deceleration")}
    kind = min(fits, key=lambda k: sum(f[2] for f in fits[k]))
    control, value = np.array([f[0] for f in fits[kind]]), np.array([f[1] for f in fits[kind]])
    c, x = _spread(control), _spread(value)
    everywhere: Callable[[tuple[float, float]], Box] = lambda b: Box.of(np.full(n, max(b[0], 0.0)), np.full(n, b[1]))  # noqa: E731
    errors = np.array([_tracking(kind, r, f) for r, f in zip(train, fits[kind], strict=True)])  # (stops, 2, n)
    q_error, dq_error = errors.max(axis=0) + _beyond(len(train)) * np.ptp(errors, axis=0)
    ramp = Ramp(
        "time" if kind == "time" else "deceleration", everywhere((max(x[0], 1e-3), x[1])), everywhere(c),
        q_error, dq_error, source="identified from stop1 recordings",
    )  # fmt: skip
    for round_ in range(WIDENINGS + 1):
        outside = [r.label for r in train if not stop1_fits(ramp, noise, r)]
        if not outside:
            break
        ramp = replace(
            ramp, value=ramp.value.inflated(WIDEN), q_error=1.1 * ramp.q_error + 1e-5, dq_error=1.1 * ramp.dq_error + 1e-4
        )
        notes.append(f"the ramp's sets were widened ({round_ + 1}) to enclose {len(outside)} training stops")
    violated = sum(not stop1_fits(ramp, noise, r) for r in held)
    return ramp, _line("STOP 1", len(held), violated, len(train))


def _motion(r: Recording) -> tuple[Array, Array, Array]:
    k = trigger_of(r)
    assert k is not None
    return r.t[k:] - r.t[k], r.dq[k:], r.dq[k]


def _tracking(kind: str, r: Recording, fit: tuple[float, float, float]) -> Array:
    """(2, n) largest error of angle and speed against the stop's own ramp."""
    k = trigger_of(r)
    assert k is not None
    t, v, v0 = _motion(r)
    reference = _shape(kind, t, v0, fit[0], fit[1])
    step = np.diff(t)[:, None]
    way = np.vstack([np.zeros(v.shape[1]), np.cumsum(0.5 * step * (reference[1:] + reference[:-1]), axis=0)])
    return np.array([np.abs(r.q[k:] - r.q[k] - way).max(axis=0), np.abs(v - reference).max(axis=0)])


def stop1_fits(ramp: Ramp, noise: Box, r: Recording) -> bool:
    """Whether every measured sample after the request lies in the ramp's bounds and its noise."""
    k = trigger_of(r)
    assert k is not None
    t, v, v0 = _motion(r)
    n = v.shape[1]
    tube = ramp_tube(ramp, v0 - noise.hi[n:], v0 - noise.lo[n:])
    return bool(np.all(inside([tube], t, r.q[k:] - r.q[k], v, noise)))
