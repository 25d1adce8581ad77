"""The compensation of eq. (11) as the compiled core computes it: a model's laws on tape, and what they look at.

Each law is recorded once, with its parameters' values in it, and then played for every sample, here, in the monitor and in
the FMU alike.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from stopset.core.library import check, ffi, given, lib, view
from stopset.effects.base import REFERENCE_TEMPERATURE, Effect, Fitted, Shape, Signals, Term
from stopset.effects.registry import get
from stopset.effects.signals import Samples
from stopset.errors import EffectError
from stopset.ring import Tape
from stopset.robot import Robot
from stopset.robot.rigid import torques
from stopset.types import Array

# numbers of the signals a law may look at, in the order of the core's inputs.h; pairs of tilt, ten of tip, then the states
SIGNALS = (
    "q", "dq", "ddq", "given_direction", "load", "tau", "dtau", "link", "temp", "warm", "t", "stiff", "inertia", "coriolis", "dq_other",
)  # fmt: skip
TILT, TIP, MEMORY = len(SIGNALS), len(SIGNALS) + 2, len(SIGNALS) + 12
RIGID = {
    "load": lib.STOPSET_NEEDS_LOAD, "coriolis": lib.STOPSET_NEEDS_LOAD | lib.STOPSET_NEEDS_LINK, "tau": lib.STOPSET_NEEDS_LINK,
    "link": lib.STOPSET_NEEDS_LINK, "stiff": lib.STOPSET_NEEDS_STIFF, "inertia": lib.STOPSET_NEEDS_INERTIA,
    "tilt": lib.STOPSET_NEEDS_TILT, "tip": lib.STOPSET_NEEDS_TIP,
}  # fmt: skip


def _signals(tape: Tape, states: int) -> Signals:
    named = {name: tape.signal(k) for k, name in enumerate(SIGNALS)}
    return Signals(
        **named, tilt=tuple(tape.signal(TILT + k) for k in range(2)), tip=tuple(tape.signal(TIP + k) for k in range(10)),
        memory=tuple(tape.signal(MEMORY + k) for k in range(states)),
    )  # fmt: skip


@dataclass(slots=True)
class Pinned:
    """C structs, and what they point at."""

    held: list[Any]

    def array(self, x: Any, dtype: Any = np.float64) -> Any:
        """A pointer to the numbers of ``x``, a copy of them where they are not contiguous."""
        return self.shared(np.ascontiguousarray(x, dtype))

    def shared(self, x: NDArray[Any]) -> Any:
        """A pointer to the memory of ``x`` itself, which lives as long as this."""
        kind = {"f8": "double *", "i4": "int32_t *", "i8": "int64_t *", "u1": "uint8_t *", "b1": "uint8_t *"}[x.dtype.str[1:]]
        self.held.append(ffi.from_buffer(x))
        return ffi.cast(kind, self.held[-1])

    def program(self, effect: Effect, values: Mapping[str, float], rate: int = -1) -> tuple[int, Any, Any]:
        """``StopsetProgram`` of `recorded`."""
        r = recorded(effect, values, rate)
        return len(r.steps), self.array(r.steps, np.int32), self.array(r.numbers)


@dataclass(frozen=True, slots=True)
class Recorded:
    """A law's steps (K, 3) and constants; ``parametric``: these begin with its parameters, in the order of `parameters_of`; else the law
    could only be recorded with their values in it."""

    steps: NDArray[np.int32]
    numbers: Array
    parametric: bool


def recorded(effect: Effect, values: Mapping[str, float], rate: int = -1) -> Recorded:
    """An effect's torque on tape, or the rate of its state number ``rate``; raises `EffectError` where it has no steps."""
    try:
        return _record(effect, values, rate, parametric=True)
    except EffectError:  # a law may ask of a parameter what no tape answers, such as whether it is positive
        return _record(effect, values, rate, parametric=False)


def _record(effect: Effect, values: Mapping[str, float], rate: int, *, parametric: bool) -> Recorded:
    tape = Tape()
    given: dict[str, Any] = {k: tape.parameter(values[k]) if parametric else values[k] for k in parameters_of(effect, values)}
    s = _signals(tape, len(effect.states))
    try:
        steps, numbers = tape.finished(effect.torque(s, given) if rate < 0 else effect.rates(s, given)[rate])
    except (TypeError, ValueError, AttributeError) as e:
        raise EffectError(
            f"effect {effect.name}: its law cannot be taken apart into elementary steps ({e}); expected + - * / ** and the "
            "functions of stopset.ring: write it with those"
        ) from e
    return Recorded(steps, numbers, parametric)


def parameters_of(effect: Effect, values: Mapping[str, float]) -> list[str]:
    """Symbols of the terms, then of the shapes, that ``values`` holds."""
    every: list[Term | Shape] = [*effect.terms, *effect.shapes]
    return [p.symbol for p in every if p.symbol in values]


def places(f: Fitted, effect: Effect, joints: Sequence[str]) -> list[tuple[int, int]]:
    """(joint, partner or -1) of every torque of a fitted effect."""
    if effect.scope == "arm" or f.joint is None:
        return [(j, -1) for j in range(len(joints))]
    names = f.joint.split("+")
    i = joints.index(names[0])
    if effect.scope != "pair":
        return [(i, -1)]
    k = joints.index(names[1]) if len(names) > 1 else min(i + 1, len(joints) - 1)
    return [(i, k), (k, i)]


class Compensation(Protocol):
    """What is put on tape; see `stopset.artifact.inputs.InputMap`, which is one."""

    @property
    def robot(self) -> Robot: ...
    @property
    def effects(self) -> tuple[Fitted, ...]: ...
    @property
    def effort(self) -> str: ...
    @property
    def gain(self) -> Array: ...
    @property
    def offset(self) -> Array: ...
    @property
    def standstill(self) -> Array: ...
    @property
    def swift(self) -> bool: ...


@dataclass(frozen=True, slots=True)
class Taped:
    """``StopsetInputs`` of a `Compensation`; ``first``: column of the first state of each effect with memory, by its place."""

    struct: Any
    pinned: Pinned
    first: Mapping[int, int]
    columns: int
    uses_dtau: bool

    @classmethod
    def of(cls, m: Compensation) -> Taped:
        """Raises `EffectError` for a law that cannot be taken apart."""
        pinned, laws, first, columns, needs = Pinned([]), [], {}, 0, set()
        for k, f in enumerate(m.effects):
            effect = get(f.effect)
            needs |= set(effect.needs)
            if effect.states:
                if len(effect.states) > lib.STOPSET_MEMORIES:
                    raise EffectError(
                        f"effect {f.label} has {len(effect.states)} states; expected {lib.STOPSET_MEMORIES} at most"
                    )
                first[k], columns = columns, columns + len(effect.states)
            program = pinned.program(effect, f.values)
            laws += [(j, other, first.get(k, 0), len(effect.states), program) for j, other in places(f, effect, m.robot.joints)]
        c, table = m.robot.chain, ffi.new("StopsetLaw[]", laws or 1)
        arm = (m.robot.n, *(pinned.array(x) for x in (c.R, c.p, c.axis, c.gravity, m.robot.pi)))
        mask = 0
        for name in needs:
            mask |= RIGID.get(name, 0)
        if "dtau" in needs:
            mask |= lib.STOPSET_NEEDS_LINK
        struct = ffi.new("StopsetInputs *", (
            arm, int(m.effort != "compensated_torque"), int(m.swift), mask, columns, len(laws), table,
            pinned.array(m.gain), pinned.array(m.offset), pinned.array(m.standstill), REFERENCE_TEMPERATURE,
        ))  # fmt: skip
        pinned.held += [table]
        return cls(struct, pinned, first, columns, "dtau" in needs)

    def __call__(self, m: Compensation, samples: Samples, tau: Array, memories: Mapping[int, tuple[Array, ...]]) -> Array:
        """``u`` (N, n) [N m], see `stopset.artifact.inputs.InputMap.__call__`."""
        n, q, dq, temp, t = m.robot.n, samples.q, samples.dq, samples.temp, samples.t
        if q.shape != dq.shape or q.shape != tau.shape or q.shape[1:] != (n,) or (temp is not None and temp.shape != q.shape):
            raise ValueError(f"samples of shapes {q.shape}, {dq.shape}, {tau.shape} for {n} joints; expected one shape (N, {n})")
        states = np.zeros((len(q), self.columns))
        for k, at in self.first.items():
            for i, z in enumerate(memories[k]):
                states[:, at + i] = z
        dtau = None
        if self.uses_dtau and t is not None and len(t) > 1:
            dtau = np.gradient(torques(m.robot.chain, m.robot.pi, q, dq, np.zeros_like(q)), t, axis=0)
        arrays = [None if x is None else given(x) for x in (q, dq, tau, temp, dtau, t, states)]
        struct = ffi.new("StopsetSamples *", (*(ffi.NULL if x is None else view(x) for x in arrays), samples.warm))
        u = np.empty(q.shape)
        check(lib.stopset_inputs(self.struct, len(q), struct, view(u)))
        return u


_recent: deque[tuple[Compensation, Taped]] = deque(maxlen=8)


def taped(m: Compensation) -> Taped:
    """The `Taped` of a map, recorded once."""
    for seen, it in tuple(_recent):  # threads ask too
        if seen is m:
            return it
    fresh = Taped.of(m)
    _recent.appendleft((m, fresh))
    return fresh
