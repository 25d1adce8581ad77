"""Brakes from recorded power-off stops: torque, delay and rise as intervals, and the uncertainty sets of the regime STOP 0.

What varies between stops is what the intervals hold: per stop and joint one delay and one torque are estimated (`timing`),
and each suite's values are widened by how few they are (`bands`); a suite that tells too few leaves what was assumed
before possible.  What one brake was seen to do, relative to its own middle, the other brakes of the arm are taken to be able
to do too: a few stops do not show every joint's worst.  The joints' delays go together where one power stage cuts them: the
model keeps by how much they differ within one stop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Brakes, Model, UncertaintySets
from stopset.errors import RecordingError
from stopset.offline.brakes.bands import DOUBLINGS, TORQUES, WIDEN, WIDENINGS, band, farther, hull
from stopset.offline.brakes.impulse import impulses, speed_error
from stopset.offline.brakes.judge import judge_stop0
from stopset.offline.brakes.timing import GRID, RISES, BrakeEstimate, brake_estimate
from stopset.reach.stops.setting import setting_of
from stopset.recording import Recording, SuiteKey, suite_label
from stopset.sets import Box
from stopset.types import Array

LEAST = 4  # training stops, and told values, that an interval needs
TAIL = 6  # samples at the end of a joint's slide over which its brake is taken to be fully closed, where it ever is
ENOUGH = 8  # stops that tell their delay, to believe their interval alone
SIGMAS = 4.0  # of a measured speed's noise within its bound
USUALLY = 0.8  # of the stops that tell delays: a joint that tells its own in fewer may have been at rest in all of its late ones
OWN_LAG = 3e-3  # [s] a joint's own delay must differ by more from the other joints' to be its own
ROUNDS = 10  # of medians
STRAY = 8e-3  # [s] and three times the median deviation: a delay this far from the others of its stop is a misfit
TYPICAL = 0.1  # relative spread of friction between stops
TYPICAL_U = 0.15  # and what is left of the powered regime's U, of its width, as one sigma
LEAST_TORQUE = 0.05  # share of its middle that a brake surely keeps: an interval must not reach zero by widening alone
USUAL_RISE = (2e-3, 0.03)  # [s] where no stop tells it


@dataclass(frozen=True, slots=True)
class Seen:
    """What one stop told, joint by joint; ``start``: (n,) [rad/s] by which it went as if started faster, nan if not known."""

    suite: SuiteKey
    estimates: tuple[BrakeEstimate | None, ...]
    start: Array


def look(model: Model, brakes: Brakes, stops: Sequence[Recording], noise: Box) -> list[Seen]:
    """What each of ``stops`` tells, under the torques that ``brakes`` assume."""
    setting = setting_of(replace(model, brakes=brakes))
    assert setting is not None
    n = model.n
    u = setting.plant.u_hi - setting.plant.u_lo
    spread = TYPICAL * setting.plant.coulomb_hi + TYPICAL_U * u + 1e-3
    torque, out = brakes.torque.centre, []
    for r in stops:
        curves = impulses(setting, r, noise.radius[n:] / SIGMAS)
        estimates = tuple(
            None if c is None else brake_estimate(c, float(torque[i]), float(spread[i])) for i, c in enumerate(curves)
        )
        momentum = np.array(
            [0.0 if w is None or c is None else c.sign * w.impulse for c, w in zip(curves, estimates, strict=True)]
        )
        signs = [0.0 if c is None else c.sign for c in curves]
        estimates = tuple(
            None if w is None else replace(w, torque_error=w.torque_error * s) for w, s in zip(estimates, signs, strict=True)
        )
        out.append(Seen(r.suite_key, estimates, speed_error(setting, r, momentum)))
    return out


def guessed_brakes(model: Model, stops: Sequence[Recording], noise: Box) -> Brakes:
    """Brakes where no data sheet tells: torque from the steepest end of a joint's curves, timing as of any servo brake."""
    n = model.n
    delay, rise = Box.of(np.zeros(n), np.full(n, 0.1)), Box.of(np.full(n, 1e-3), np.full(n, 0.05))
    setting = setting_of(replace(model, brakes=Brakes(Box.of(np.ones(n), np.full(n, 100.0)), delay, rise)))
    assert setting is not None
    torque = np.ones(n)
    for r in stops:
        for i, c in enumerate(impulses(setting, r, noise.radius[n:] / SIGMAS)):
            if c is not None and len(c.t) > TAIL:
                torque[i] = max(torque[i], (c.taken[-1] - c.taken[-TAIL]) / (c.t[-1] - c.t[-TAIL]))
    return Brakes(Box.of(0.7 * torque, 1.3 * torque), delay, rise)


def _table(seen: Sequence[Seen], field: str) -> Array:
    """(stops, n) of one field of what was told, nan where nothing was."""
    return np.array([[np.nan if w is None else getattr(w, field) for w in s.estimates] for s in seen])


def fit_brakes(model: Model, train: Sequence[Recording], noise: Box, notes: list[str]) -> Model | None:
    """The model with brakes and the regime STOP 0 from the training stops; None, and a note, if they cannot tell."""
    wide = model.brakes or guessed_brakes(model, train, noise)
    seen, said = look(model, wide, train, noise), list[str]()
    known = brakes_from(model, wide, seen, noise, said)
    if known is not None and _strays_are_real(known, seen, train):
        said = ["delays that lie far from others of their stop are counted: without them that stop leaves its bound"]
        known = brakes_from(model, wide, seen, noise, said, strays=True)
    notes += said
    return None if known is None else widened(known, train, notes)


def _strays_are_real(known: Model, seen: Sequence[Seen], train: Sequence[Recording]) -> bool:
    """Whether a stop of which a delay was left out as a misfit leaves its bound: its brake was as late as it looked."""
    delays = _table(seen, "delay")
    left_out = ~np.isnan(delays) & np.isnan(without_strays(delays, own_lags(delays), []))
    odd = [r for r, row in zip(train, left_out, strict=True) if row.any()]
    return bool(odd) and bool(judge_stop0(known, odd).outside)


def brakes_from(
    model: Model, wide: Brakes, seen: Sequence[Seen], noise: Box, notes: list[str], *, strays: bool = False
) -> Model | None:
    """The model with brakes and the regime STOP 0 from what stops told under the brakes ``wide`` assumed before; ``strays``: with the
    delays, too, that lie far from others of their stop."""
    n = model.n
    delays = _table(seen, "delay")
    own = own_lags(delays)
    delay = delays if strays else without_strays(delays, own, notes)
    if np.sum(~np.isnan(delay)) < LEAST:
        notes.append("too few joints were still moving when their brakes engaged; brakes cannot be identified from these stops")
        return None
    torque = np.where(np.isnan(delay), np.nan, _table(seen, "torque"))
    unknown = [model.joints[i] for i in np.flatnonzero(np.isnan(torque).all(axis=0))]
    if model.brakes is None and unknown:
        notes.append(
            f"no data sheet tells the brake torque of {', '.join(unknown)} and no stop shows it; state it, or record faster stops: "
            "no STOP 0 can be bounded"
        )
        return None
    suites = [s.suite for s in seen]
    timing, delay_spread, silent = timing_of(delay, own, suites)
    informative = int(np.sum(~np.isnan(delay).all(axis=1)))
    if informative < ENOUGH:
        notes.append(f"only {informative} stops tell when the brakes engaged: the delays assumed before stay possible")
    elif silent:
        notes.append(
            f"fewer than {LEAST} stops of {silent} tell when the brakes engaged: the delays assumed before stay possible"
        )
    if informative < ENOUGH or silent:
        timing = timing | wide.delay
    lost = np.isnan(delay).all(axis=0) & ~np.isnan(delays).all(axis=0)
    if np.any(lost):
        names = ", ".join(model.joints[i] for i in np.flatnonzero(lost))
        notes.append(f"every delay told of the brakes of {names} was left out: those assumed before stay possible, at any time")
        delay_spread, both = None, timing | wide.delay
        timing = Box.of(np.where(lost, both.lo, timing.lo), np.where(lost, both.hi, timing.hi))
    brakes = Brakes(
        _torques(model, wide, torque, suites, notes), timing, Box.of(*np.tile(_rises(_table(seen, "rise")), (n, 1)).T),
        source=f"identified from {len(seen)} recorded stops, {informative} of which tell a delay and {int(np.isfinite(torque).sum())} "
        "joints a torque", delay_spread=delay_spread, lag=None if delay_spread is None or not own.any() else own - own.min(),
    )  # fmt: skip
    return replace(model, brakes=brakes, sets={**model.sets, "stop0": _regime(model, seen, noise)})


def own_lags(delay: Array) -> Array:
    """(n,) [s] by how much each joint's brake always engages later than the others of its stop: 0 where it does not, nor where
    too few stops tell it.  ``delay``: (stops, n), nan where a stop tells nothing.

    A stop's common time and a joint's lag are fitted in turn, by medians: a few misfits move neither.  A brake that engages after its joint has
    come to rest tells nothing, so a joint that is seldom heard of is heard of when its brake is early, and is not always early for that.
    """
    n, given = delay.shape[1], ~np.isnan(delay)
    together = given.sum(axis=1) > 1
    rows, own = delay[together], np.zeros(n)
    if not len(rows):
        return own
    for _ in range(ROUNDS):
        common = np.nanmedian(rows - own, axis=1, keepdims=True)
        for i in range(n):
            mine = (rows - common)[given[together, i], i]
            own[i] = np.median(mine) if len(mine) >= LEAST else 0.0
            if own[i] < 0.0 and len(mine) < USUALLY * len(rows):
                own[i] = 0.0
    for i in range(n):
        mine = (rows - common)[given[together, i], i]
        if len(mine) < LEAST or abs(own[i]) <= max(OWN_LAG, 2.0 * 1.4826 * float(np.median(np.abs(mine - own[i])))):
            own[i] = 0.0
    return own


def without_strays(delay: Array, own: Array, notes: list[str]) -> Array:
    """The same without delays that, less their joint's ``own`` lag, lie far from the others of their stop."""
    common = delay - own
    two = np.sum(~np.isnan(delay), axis=1) == 2
    two[two] = np.ptp(np.sort(common[two], axis=1)[:, :2], axis=1) > 2.0 * STRAY
    common = np.where(two[:, None], np.nan, common)  # of two that differ nobody knows which one is wrong
    several = np.sum(~np.isnan(common), axis=1) > 2
    off = np.full(delay.shape, np.nan)
    off[several] = np.abs(common[several] - np.nanmedian(common[several], axis=1, keepdims=True))
    stray = off > (max(STRAY, 3.0 * float(np.nanmedian(off))) if np.any(several) else np.inf)
    if np.any(stray):
        notes.append(
            f"{int(stray.sum())} of {int(np.sum(~np.isnan(common)))} brake delays lie far from others of their stop; left out"
        )
    if np.any(two):
        notes.append(f"{int(two.sum())} stops show two brake delays far apart; left out")
    return np.where(stray | two[:, None], np.nan, delay)


def timing_of(delay: Array, own: Array, suites: Sequence[SuiteKey]) -> tuple[Box, float | None, str]:
    """(n,) delays [s]; how far apart those of one stop lie, each less its joint's ``own`` lag, None if not known; and the suites
    that told too little."""
    rows = np.isfinite(delay)
    common = delay - own
    groups: dict[SuiteKey, tuple[list[float], int]] = {}
    for s, suite in enumerate(suites):
        if rows[s].any():
            values, count = groups.get(suite, ([], 0))
            groups[suite] = ([*values, *common[s][rows[s]]], count + 1)
    lo, hi = hull(groups)
    box = Box.of(np.maximum(lo + own, 0.0), np.maximum(hi + own, 1e-3))
    spreads = [float(np.ptp(common[s][rows[s]])) for s in range(len(delay)) if rows[s].sum() > 1]
    if len(spreads) < 2:
        return box, None, _silent(groups, suites)
    return box, farther(len(spreads)) * max(spreads) + GRID, _silent(groups, suites)


def _silent(groups: Mapping[SuiteKey, tuple[list[float], int]], suites: Sequence[SuiteKey]) -> str:
    """The suites that told too few values to know what they vary by."""
    return ", ".join(suite_label(s) for s in sorted(set(suites)) if groups.get(s, ([], 0))[1] < LEAST)


def _torques(model: Model, wide: Brakes, torque: Array, suites: Sequence[SuiteKey], notes: list[str]) -> Box:
    """(n,) [N m]: each brake's middle times what all brakes of the arm varied by."""
    nominal = wide.torque.centre
    share = torque / nominal
    given = ~np.isnan(share)
    if given.sum() < LEAST:
        notes.append("no brake's torque could be told from these stops; it stays as before")
        return wide.torque
    usual = float(np.nanmedian(share))
    middle = np.full(model.n, usual)
    for i in range(model.n):
        mine = share[given[:, i], i]
        if len(mine) >= LEAST:
            middle[i] = float(np.median(mine))
        elif len(mine) == 0:
            notes.append(f"the brake of {model.joints[i]} was not seen closing: it is taken to vary as the others do")
    groups: dict[SuiteKey, tuple[list[float], int]] = {}
    for s, i in np.argwhere(given):
        values, count = groups.get(suites[s], ([], 0))
        groups[suites[s]] = ([*values, float(share[s, i] / middle[i])], count + 1)
    lo, hi = hull(groups, TORQUES)
    silent = _silent(groups, suites)
    if silent:
        lo, hi = min(lo, float((wide.torque.lo / nominal).min())), max(hi, float((wide.torque.hi / nominal).max()))
        notes.append(f"fewer than {LEAST} brake torques can be told from {silent}: those assumed before stay possible")
    return Box.of(np.maximum(middle * max(lo, LEAST_TORQUE) * nominal, 1e-3), middle * hi * nominal)


def _rises(rise: Array) -> tuple[float, float]:
    values = rise[~np.isnan(rise)]
    if len(values) < LEAST:
        return USUAL_RISE
    lo, hi = band(values)
    half = 0.5 * (RISES[1] - RISES[0])  # of the grid they were looked for on
    return max(lo - half, GRID), hi + half


def _regime(model: Model, seen: Sequence[Seen], noise: Box) -> UncertaintySets:
    """The sets of the regime STOP 0: start error X0 with what the drive still gives, U before the brakes close, V."""
    powered, n = model.powered, model.n
    error, std = _table(seen, "torque_error"), _table(seen, "torque_error_std")
    u_lo, u_hi = powered.U.lo.copy(), powered.U.hi.copy()
    for i in range(n):
        clear = ~np.isnan(error[:, i]) & (std[:, i] < 0.5 * max(u_hi[i] - u_lo[i], 1e-9))
        if clear.sum() < LEAST:
            continue
        lo, hi = band(error[clear, i])
        u_lo[i], u_hi[i] = (
            min(float(np.min(error[clear, i])), max(lo, u_lo[i])),
            max(float(np.max(error[clear, i])), min(hi, u_hi[i])),
        )
    start = np.array([s.start for s in seen])
    most = farther(len(seen)) * np.abs(start).max(axis=0)
    X0 = Box.symmetric(np.maximum(noise.radius, np.concatenate([np.zeros(n), most])))
    return replace(powered, X0=X0, U=Box.of(u_lo, u_hi), V=noise, active=(), zonotope=None)


def widened(model: Model, stops: Sequence[Recording], notes: list[str]) -> Model:
    """The model with its brakes and disturbance grown until the stop bound encloses every one of ``stops``, or there is none any more."""
    grown: set[int] = set()
    for round_ in range(WIDENINGS + DOUBLINGS):
        verdict = judge_stop0(model, stops)
        if not verdict.outside:
            if round_:
                model = _grown(model, sorted(grown))  # what only just encloses these stops is too small for the next
                notes.append(f"torque sets of the stops were widened {round_} times to enclose all of {len(stops)} stops")
            if round_ >= WIDENINGS:
                notes.append(f"{WIDENINGS} widenings by {WIDEN:.0%} did not enclose them: the model lacks something")
            if verdict.certified < verdict.stops:
                notes.append(f"{verdict.stops - verdict.certified} of {verdict.stops} training stops have no certified bound")
            return model
        joints = {joint for _, joint, _ in verdict.outside}
        grown |= joints
        model = _grown(model, sorted(joints), WIDEN if round_ < WIDENINGS else 2.0)
    raise RecordingError(
        f"recorded stops leave every bound of this model ({', '.join(verdict.labels[:3])}); expected stops of the arm that was identified: "
        "look at these recordings, or leave them out"
    )


def _grown(model: Model, joints: Sequence[int], by: float = WIDEN) -> Model:
    """U, start speed and brake torque of ``joints`` wider, by a little or much."""
    assert model.brakes is not None
    n, sets, torque = model.n, model.sets["stop0"], model.brakes.torque
    factor = np.ones(n)
    factor[list(joints)] = by
    t_lo, t_hi = torque.centre - factor * torque.radius, torque.centre + factor * torque.radius
    wide = Box.of(
        sets.U.centre - factor * sets.U.radius - (factor > 1) * 0.05, sets.U.centre + factor * sets.U.radius + (factor > 1) * 0.05
    )
    both = np.concatenate([np.ones(n), factor])
    X0 = Box.symmetric(both * sets.X0.radius)
    brakes = replace(model.brakes, torque=Box(np.maximum(t_lo, 1e-3), t_hi))
    return replace(model, brakes=brakes, sets={**model.sets, "stop0": replace(sets, U=wide, X0=X0)})
