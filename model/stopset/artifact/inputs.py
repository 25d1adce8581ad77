"""From measured torque to the input ``u`` of the abstraction: what the model knows is taken off.

``u = tau - friction and other algebraic effects - g(q) - offset``, Liu & Althoff (2018), eq. (11).  Identification, monitor
and comparison all go through this one function (trap P18).  A recording of compensated torque holds ``u`` already; only the
identified offset and effects added later are taken off it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact.abstraction import Abstraction
from stopset.artifact.taped import taped
from stopset.effects.base import Effect, Fitted, Signals
from stopset.effects.memory import along, coefficients, stepped
from stopset.effects.registry import get
from stopset.effects.signals import Samples, arm_signals, paired
from stopset.errors import EffectError
from stopset.robot import Robot
from stopset.types import Array

Memories = Mapping[int, tuple[Array, ...]]  # states (N,) of effects with memory, by the effect's place in the list

# signals that hang on what links weigh
BODY = frozenset({"load", "tau", "dtau", "link", "tip", "tilt", "stiff", "inertia", "coriolis"})
ENTRIES = {
    "damping": "the damping of the abstraction", "inertia": "the mass matrix M and gravity",
    "input_gain": "the scale of the measured torque",
}  # fmt: skip


def entry(effect: Effect) -> str:
    """Where an effect goes in the reachset model, in words, as `InputMap` and the abstraction do it."""
    if effect.enters in ENTRIES:
        return ENTRIES[effect.enters]
    if not effect.compensated():
        return "the torque set U, which holds what it does: no torque of the measured state can take it off"
    return "the compensation of eq. (11)" + (", with a state of its own along the motion" if effect.states else "")


def compensated(effects: Sequence[Fitted], abstraction: Abstraction) -> tuple[Fitted, ...]:
    """The effects whose torque is taken off the measured one; the others are part of ``abstraction``, or left to ``U``."""
    degree = int(np.flatnonzero(np.any(abstraction.viscous != 0.0, axis=0)).max(initial=0)) + 1
    return tuple(f for f in effects if get(f.effect).compensated(degree))


@dataclass(frozen=True, slots=True)
class InputMap:
    """Turns torque into ``u``.

    ``effects``: those whose torque is taken off, see `compensated`; ``gain``: (n,) recorded torque per true torque;
    ``offset``: (n,) constant torque [N m] that every motion shows; ``standstill``: (n,) speed [rad/s] below which a joint
    counts as still: there friction is set-valued and balances what it can, so only the rest of the torque is input;
    ``swift``: Coriolis and centrifugal torque at the measured speed is taken off like gravity.
    """

    robot: Robot
    effects: tuple[Fitted, ...]
    effort: str
    gain: Array
    offset: Array
    standstill: Array
    swift: bool

    @property
    def plain(self) -> bool:
        """Whether ``u = tau - offset`` alone."""
        return self.effort == "compensated_torque" and not self.effects and bool(np.all(self.gain == 1.0))

    def __call__(
        self, q: Array, dq: Array, tau: Array, temp: Array | None = None, warm: float = 0.0, t: Array | None = None,
        memories: Memories | None = None,
    ) -> Array:  # fmt: skip
        """``u`` (N, n) [N m] for samples ``q, dq, tau`` (N, n) in time order; ``temp`` (N, n) [degC], ``warm`` 0 to 1.

        Effects with memory need the times ``t`` (N,) [s], or their states ``memories`` where the caller carries these.
        """
        samples = Samples(q, dq, temp=temp, warm=warm, t=t)
        if memories is None:
            memories = memories_along(self.robot, self.effects, samples)
        return taped(self)(self, samples, tau, memories)


_made: deque[tuple[tuple[Robot, tuple[Fitted, ...], str, Abstraction], InputMap]] = deque(maxlen=8)


def input_map(robot: Robot, effects: tuple[Fitted, ...], effort: str, abstraction: Abstraction) -> InputMap:
    """The `InputMap` that belongs to an abstraction and its effects, made once: its laws are put on tape for it."""
    parts = (robot, effects, effort, abstraction)
    for seen, it in tuple(_made):
        if all(a is b for a, b in zip(seen, parts, strict=True)):
            return it
    fresh = _input_map(*parts)
    _made.appendleft((parts, fresh))
    return fresh


def _input_map(robot: Robot, effects: tuple[Fitted, ...], effort: str, abstraction: Abstraction) -> InputMap:
    none = np.zeros(robot.n)
    gain = np.ones(robot.n)
    for f in effects:
        effect = get(f.effect)
        if effect.enters == "input_gain" and f.joint is not None:
            gain[robot.joints.index(f.joint)] += f.values[effect.terms[0].symbol]
    offset = abstraction.offset if abstraction.offset.size else none
    standstill = abstraction.standstill if abstraction.standstill.size else none
    return InputMap(robot, compensated(effects, abstraction), effort, gain, offset, standstill, abstraction.swift)


def effect_torques(
    robot: Robot, effects: Sequence[Fitted], samples: Samples, *, direction: float | None = None, memories: Memories | None = None
) -> Array:
    """Torque (N, n) [N m] of all ``effects`` together.

    ``direction``: of motion, to assume in place of the sign of ``dq`` (at rest: the side friction is about to take);
    ``memories``: the states of effects with memory, else from their start along ``t``.
    """
    laws = [(f, get(f.effect)) for f in effects]
    signals = law_signals(robot, laws, samples)
    if memories is None:
        memories = memories_along(robot, effects, samples)
    if direction is not None:
        signals = tuple(replace(s, given_direction=np.full(len(samples.q), direction)) for s in signals)
    out = np.zeros_like(samples.q)
    for k, (f, effect) in enumerate(laws):
        values = dict(f.values)
        if effect.scope == "arm" or f.joint is None:
            for j in range(robot.n):
                out[:, j] += effect.torque(signals[j], values)
        elif effect.scope == "pair":
            i, j = effect.acts_on(f.joint, robot.joints)
            a, b = paired(signals, i, j)
            out[:, i] += effect.torque(a, values)
            out[:, j] += effect.torque(b, values)
        else:
            j = robot.joints.index(f.joint)
            out[:, j] += effect.torque(replace(signals[j], memory=memories.get(k, ())), values)
    return out


def memories_along(robot: Robot, effects: Sequence[Fitted], samples: Samples) -> Memories:
    """States of the effects with memory along one recording, each from its own start; empty where none has a memory."""
    laws = [(f, get(f.effect)) for f in effects]
    lasting = {k: (f, e) for k, (f, e) in enumerate(laws) if e.states and f.joint is not None}
    if not lasting:
        return {}
    t = samples.t
    if t is None:
        names = ", ".join(f.label for f, _ in lasting.values())
        raise EffectError(f"{names} has a memory, and the samples have no times; give the times, or the states themselves")
    signals = law_signals(robot, list(lasting.values()), samples)
    first = np.arange(len(t)) == 0
    step = np.diff(t, append=t[-1:])
    out = {}
    for k, (f, effect) in lasting.items():
        assert f.joint is not None
        out[k] = along(effect, signals[robot.joints.index(f.joint)], f.values, first, step)
    return out


def memories_after(robot: Robot, effects: Sequence[Fitted], memories: Memories, samples: Samples, dt: float) -> Memories:
    """The states of affine effects ``dt`` [s] after the samples, each from its own state of ``memories``."""
    lasting = {k: (effects[k], get(effects[k].effect)) for k in memories}
    if not lasting:
        return {}
    signals = law_signals(robot, list(lasting.values()), samples)
    out = {}
    for k, (f, effect) in lasting.items():
        assert f.joint is not None
        b, a = coefficients(effect, signals[robot.joints.index(f.joint)], f.values)
        out[k] = (stepped(memories[k][0], b, a, dt),)
    return out


def law_signals(robot: Robot, laws: Sequence[tuple[Fitted, Effect]], samples: Samples) -> tuple[Signals, ...]:
    """Signals of every joint as far as ``laws`` read them."""
    needs = {name for _, e in laws for name in e.needs}
    return arm_signals(robot, samples, needs & BODY or {"none"})
