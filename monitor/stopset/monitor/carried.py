"""What the model's effects remember: intervals that hold their states, whatever the arm did before the first sample.

Both ends of each interval are stepped like the states of the identification, whose flow keeps their order, so the state that
the identification would carry lies between them from wherever it began.  Friction that builds up over a way forgets its start
after a few ways, a warm drive after a few time constants; then the ends have come together.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stopset.artifact import Model
from stopset.effects import Effect, Fitted
from stopset.effects.memory import affine, whole
from stopset.effects.registry import get
from stopset.errors import NotCovered
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class _State:
    """One state: of the effect at ``place`` in the list of the compensation, of joint number ``joint``; ``whole``: no more is known."""

    place: int
    fitted: Fitted
    effect: Effect
    joint: int
    whole: tuple[float, float]


@dataclass(slots=True)
class Carried:
    """The states' intervals ``ends`` (m, 2), stepped by the core; `forget` when the samples are no longer those of one motion."""

    states: tuple[_State, ...]
    ends: Array = field(init=False)

    @classmethod
    def of(cls, model: Model) -> Carried:
        """Raises `NotCovered` for an effect whose states cannot be enclosed by their ends."""
        fastest = np.maximum(np.abs(model.domain.dq.lo), np.abs(model.domain.dq.hi))
        limit = model.robot.dq_limit
        fastest = np.where(np.isfinite(limit), np.maximum(limit, fastest), fastest)
        states = []
        for k, f in enumerate(model.input.effects):
            effect = get(f.effect)
            if not effect.states:
                continue
            if f.joint is None or not affine(effect):
                raise NotCovered(
                    f"the model holds {f.label}, which remembers {', '.join(x.symbol for x in effect.states)}; the monitor can carry "
                    "one state per effect whose law and flow are affine in it; use a revision without it"
                )
            j = model.joints.index(f.joint)
            states.append(_State(k, f, effect, j, whole(effect, f.values, float(fastest[j]))))
        return cls(tuple(states))

    def __post_init__(self) -> None:
        self.ends = np.empty((len(self.states), 2))
        self.forget()

    def forget(self) -> None:
        """Nothing is known of what came before the next sample."""
        self.ends[:] = np.array([s.whole for s in self.states]).reshape(-1, 2)
