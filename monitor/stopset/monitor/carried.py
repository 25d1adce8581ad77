"""What the model's effects remember: intervals that hold their states, whatever the arm did before the first sample.

Both ends of each interval are stepped like the states of the identification, whose flow keeps their order, so the state that
the identification would carry lies between them from wherever it began.  Friction that builds up over a way forgets its start
after a few ways, a warm drive after a few time constants; then the ends have come together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.artifact.inputs import Memories, law_signals
from stopset.effects import Effect, Fitted, Signals
from stopset.effects.memory import affine, coefficients, stepped, whole
from stopset.effects.registry import get
from stopset.errors import NotCovered
from stopset.robot import Robot

Array = NDArray[np.float64]


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
    """The states' intervals ``ends`` (m, 2), stepped by `take`; `forget` when the samples are no longer those of one motion."""

    robot: Robot
    states: tuple[_State, ...]
    dt: float  # [s]
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
        return cls(model.robot, tuple(states), model.powered.dt)

    def __post_init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Nothing is known of what came before the next sample."""
        self.ends = np.array([s.whole for s in self.states], float).reshape(-1, 2)

    def middle(self, rows: int) -> Memories:
        """The intervals' middles as the states of ``rows`` samples."""
        return {s.place: (np.full(rows, m),) for s, m in zip(self.states, self.ends.mean(axis=1), strict=True)}

    def take(self, q: Array, dq: Array, temp: Array | None, warm: Sequence[float]) -> Array:
        """Half width (n,) [N m] of the torques between the ends at this sample, moving or at rest; then step to the next one.

        Of several samples ``q, dq`` (rows, n) and places ``warm`` that this one may have been, those that reach farthest count.
        """
        half = np.zeros(q.shape[1])
        if not self.states:
            return half
        laws = [(s.fitted, s.effect) for s in self.states]
        places = [law_signals(self.robot, laws, q, dq, temp=temp, warm=w) for w in warm]
        for k, s in enumerate(self.states):
            seen = [signals[s.joint] for signals in places]
            half[s.joint] += max(_slope(s, x) for x in seen) * 0.5 * float(self.ends[k, 1] - self.ends[k, 0])
            flows = [coefficients(s.effect, x, s.fitted.values) for x in seen]
            reached = np.concatenate([stepped(self.ends[k][:, None], b, a, self.dt) for b, a in flows], axis=1)
            self.ends[k] = reached[0].min(), reached[1].max()
        return half


def _slope(s: _State, signals: Signals) -> float:
    """Largest change of torque [N m] per unit of the state, for both directions: at rest friction may take either."""
    zero_one, ways = np.array([[0.0], [1.0]]), np.array([[[1.0]], [[-1.0]]])
    torque = s.effect.torque(replace(signals, way=ways, memory=(zero_one,)), s.fitted.values)
    both, _ = np.broadcast_arrays(torque, zero_one)
    return float(np.abs(both[..., 1, :] - both[..., 0, :]).max())
