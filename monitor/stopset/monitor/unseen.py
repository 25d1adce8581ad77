"""Laws that look at what a monitor never sees: they are refused, for any value taken in its place would be another law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from stopset.effects import Effect, Fitted
from stopset.effects.base import Signals
from stopset.effects.registry import get
from stopset.errors import NotCovered
from stopset.types import Array

NOT_SEEN = {
    "t": "the time since its recording began, and an arm that is watched does not say when that is",
    "dtau": "the rate of its torque, which single samples do not hold",
}


def refuse_unseen(effects: Sequence[Fitted]) -> None:
    """Raises `NotCovered` for the first effect whose law the monitor could only evaluate at a made-up value."""
    for f in effects:
        effect = get(f.effect)
        why = next((words for name, words in NOT_SEEN.items() if name in effect.needs), "")
        if not why and "warm" in effect.needs and not even_in_session(effect):
            why = "the place in the session along a curve, of which the monitor knows the ends only"
        if why:
            raise NotCovered(f"the model holds {f.label}, which looks at {why}; use a revision without it")


@cache
def even_in_session(effect: Effect) -> bool:
    """Whether the law is a straight line over the place in the session, tried at random signals: then its ends are its extremes."""
    rng = np.random.default_rng(0)

    def draw(*shape: int) -> Array:
        return rng.uniform(-2.0, 2.0, (*shape, 20))

    drawn = Signals(
        q=draw(), dq=draw(), load=draw(), tau=draw(), link=draw(), temp=draw(), stiff=draw(), coriolis=draw(), dq_other=draw(),
        inertia=np.abs(draw()) + 0.1, tip=tuple(draw(10)), tilt=tuple(draw(2)), memory=tuple(draw(len(effect.states))),
        ddq=np.zeros(20), dtau=np.zeros(20), t=np.zeros(20),
    )  # fmt: skip

    def values(warm: float) -> Array:
        return np.array([c + np.zeros(20) for c in effect.columns(replace(drawn, warm=np.full(20, warm)))])

    first, last = values(0.0), values(1.0)
    return all(np.allclose(values(w), (1 - w) * first + w * last, rtol=1e-9, atol=1e-9) for w in (0.25, 0.5, 0.9))
