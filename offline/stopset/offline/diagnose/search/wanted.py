"""What to look for: every effect of the catalogue at every place, with start values of its shapes."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from stopset.effects import Effect, catalogue
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.columns.laws import TRANSMITTED, of_the_load
from stopset.offline.diagnose.evidence.candidate import Candidate
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hyper

LAGS = (-0.08, -0.05, -0.03, -0.018, -0.01, -0.006, 0.006, 0.01, 0.018, 0.03, 0.05, 0.08)  # [s] start values of a delay

Wanted = tuple[Effect, tuple[int, ...], Mapping[str, float]]


def wanted(engine: Engine, names: Sequence[str] | None = None, own: Sequence[Candidate] = ()) -> list[Wanted]:
    """All effects of the catalogue at all joints these data can speak of, with the start values of their shapes.

    ``own``: effects that the model has, for `load_forms`.
    """
    n = engine.data.n
    out: list[Wanted] = []
    for effect in catalogue().values():
        if not asked(effect, names) or effect.periodic or effect.acting == "through a lag" or not askable(engine, effect):
            continue  # a drive's lag is looked for as a delay, and told from it afterwards: see `formed`
        places: list[tuple[int, ...]] = [(j,) for j in range(n) if engine.rows[j].size > limit.FEWEST_ROWS]
        if effect.scope == "arm":
            places = [()]
        elif effect.scope == "pair":
            places = [(a[0], b[0]) for a, b in itertools.combinations(places, 2)]
            if effect.adjacent:
                places = [(a, b) for a, b in places if b == a + 1]
        if effect.loaded:
            places = [p for p in places if engine.loaded(p)]
        places = [p for p in places if not engine.drowned(effect, p)]
        grids = [s.grid for s in effect.shapes]
        for place in places:
            if effect.enters == "input_delay":
                out.extend((effect, place, {"d0": lag}) for lag in LAGS)
                continue
            for values in itertools.product(*grids):
                shapes = dict(zip([s.symbol for s in effect.shapes], values, strict=True))
                if effect.role != "swing" or _swings(engine, place[0], shapes["K"]):
                    out.extend((effect, place, {**shapes, **form}) for form in load_forms(engine, effect, place, own))
    return out


def load_forms(
    engine: Engine, effect: Effect, place: tuple[int, ...], own: Sequence[Candidate] = ()
) -> tuple[Mapping[str, float], ...]:
    """Forms of one law: friction that grows with the load may be of gravity's torque alone or of all that the gear transmits.

    Where the model has a law of the load, among its ``own``, it is asked in the model's form: what that leaves is no other law.
    """
    transmits = of_the_load(effect) and engine.loaded(place)
    known = any(c.joints == place and of_the_load(c.effect) for c in own)
    return ({}, {TRANSMITTED: 1.0}) if transmits and not known else ({},)


def asked(effect: Effect, names: Sequence[str] | None) -> bool:
    """Whether an effect is looked for where only these ``names`` are; a lag's plainer form is, on the way to its finer one."""
    if names is None or effect.name in names:
        return True
    return any(effect.name in e.refines and e.acting for e in catalogue().values() if e.name in names)


def askable(engine: Engine, effect: Effect) -> bool:
    """Whether these recordings can speak of an effect beside the base model."""
    if effect.base or effect.role == "play":
        return False  # of a play the torque shows nothing: see `plays`
    if effect.effort == "compensated_torque" and not engine.source.compensated:
        return False  # the whole rigid body is in the base model
    measured = engine.data.temp is not None
    return not (("temp" in effect.needs and not measured) or (effect.instead_of == "temp" and measured))


def exact(engine: Engine, hyper: Hyper, names: Sequence[str] | None) -> list[Wanted]:
    """Uncalmed columns of elasticity, for the joints whose rows hold far more than the position's noise.

    There noise common to torque and column can't decide, and calming would hide a swing of more than 5 Hz.
    """
    far = (j for j in range(engine.data.n) if hyper.kappa[j] > limit.FAR_OVER_NOISE)
    noisiest = sorted(far, key=lambda j: -hyper.kappa[j])[: limit.SWING_JOINTS]
    out: list[Wanted] = []
    for effect in catalogue().values():
        if names is not None and effect.name not in names:
            continue
        for j in noisiest:
            if effect.role == "swing":
                M = float(np.median(engine.source.mass[:, j, j]))
                grid = [K for K in effect.shapes[0].grid if _swings(engine, j, K)]
                out.extend((effect, (j,), {"K": K, "D": 0.1 * float(np.sqrt(K * M)), "exact": 1.0}) for K in grid)
    return out


def _swings(engine: Engine, joint: int, K: float) -> bool:
    """Whether a stiffness gives a period that rows can show: 0.1 to 1.5 s."""
    M = float(np.median(engine.source.mass[:, joint, joint]))
    slow, fast = limit.SWINGS
    return bool(slow**2 * M < K < fast**2 * M)  # a link described without inertia swings at no frequency
