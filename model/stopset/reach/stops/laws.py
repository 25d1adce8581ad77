"""The laws of a model's effects as the core bounds them in a stop: their columns on tape, parameters and states as intervals.

What is asked of a law, and why the answer encloses it, stands in `stopset.effects.bound`; here it is recorded, once per effect and joint.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stopset.artifact.taped import MEMORY, RIGID, SIGNALS, TILT
from stopset.core.library import ffi, given, lib, view
from stopset.effects.base import Effect, Fitted, Signals
from stopset.effects.bound import Unbounded, labelled, parameter, straight
from stopset.effects.memory import affine, whole
from stopset.errors import NotCovered
from stopset.ring import Interval, Tape
from stopset.ring.tape import SIGNAL, needed
from stopset.types import Array

ROLES = {"friction": lib.STOPSET_RUBS, "torque": lib.STOPSET_PULLS, "arm or drive": lib.STOPSET_ARM_OR_DRIVE}
# signals with which an effect is another one wherever the arm stands, or moves as a whole
ROAMING = ("q", "load", "stiff", "inertia", "coriolis", "dq_other")


@dataclass(frozen=True, slots=True)
class BoundLaw:
    """Steps (K, 3) and constants as intervals (c, 2); ``at``: the steps that give the results; ``looks``: the numbers of the signals."""

    steps: NDArray[np.int32]
    numbers: Array
    at: NDArray[np.int32]
    looks: frozenset[int]


@dataclass(frozen=True, slots=True)
class ActingLaw:
    """An effect at one joint: ``StopsetActing`` by the names of its fields."""

    label: str
    joint: int
    other: int
    role: int
    straight: bool
    roams: bool
    needs: int
    columns: BoundLaw
    value: Array  # (terms, 2)
    state: Array  # (states, 2)
    flow: BoundLaw | None
    start: float
    range: tuple[float, float]

    def struct(self, keep: list[Any]) -> Any:
        """For ``StopsetActing``; what it points at is added to ``keep``."""

        def law(x: BoundLaw | None) -> tuple[int, Any, Any]:
            if x is None:
                return 0, ffi.NULL, ffi.NULL
            steps = ffi.from_buffer("int32_t[]", np.ascontiguousarray(x.steps.ravel()))
            numbers = given(x.numbers.ravel())
            keep.extend((steps, numbers))
            return len(x.steps), steps, view(numbers)

        column = ffi.from_buffer("int32_t[]", self.columns.at)
        value, state = given(self.value.ravel()), given(self.state.ravel())
        keep.extend((column, value, state))
        return (
            self.joint, self.other, self.role, int(self.straight), int(self.roams), len(self.columns.at), len(self.state),
            law(self.columns), column, view(value), view(state), law(self.flow), self.start, list(self.range),
        )  # fmt: skip


def acting_law(effect: Effect, f: Fitted, joint: int, other: int, fastest: float, *, warm: bool) -> ActingLaw:
    """The effect ``f`` at ``joint``, ``other``: a pair's partner, else -1; ``fastest`` [rad/s]: it was seen no faster; ``warm``:
    whether temperatures were recorded.

    Raises `NotCovered` with the effect's label and what it lacks.
    """
    with labelled(f.label):
        terms = [parameter([f], t) for t in effect.terms]
        shapes = {p.symbol: parameter([f], p) for p in effect.shapes}
        if len(terms) > lib.STOPSET_COLUMNS:
            raise NotCovered(f"its law has {len(terms)} terms, more than {lib.STOPSET_COLUMNS}")
        columns = _recorded(effect, shapes, warm=warm, flow=False)
        state, flow = np.array([[x.lo, x.hi] for x in effect.states], float).reshape(-1, 2), None
        if affine(effect):
            state = np.array([whole(effect, {k: Interval(x.lo[0], x.hi[0]) for k, x in shapes.items()}, fastest)], float)
            if set(effect.needs) <= {"dq", "memory"}:
                flow = _recorded(effect, shapes, warm=warm, flow=True)
        if not np.all(np.isfinite(state)):
            raise NotCovered("a state of it has no bound")
        looks = {SIGNALS[k] for k in columns.looks if k < len(SIGNALS)}
        if effect.role == "friction":
            looks -= {"load"}  # it is taken as loaded by the brakes, either way
        tilts = any(TILT <= k < TILT + 2 for k in columns.looks)
        needs = RIGID["tilt"] if tilts else 0
        for name in looks & {"load", "stiff", "inertia", "coriolis"}:
            needs |= RIGID[name]
        z = effect.states[0] if flow else None
        return ActingLaw(
            f.label, joint, other, ROLES[effect.role], straight(effect), tilts or bool(looks & set(ROAMING)), needs, columns,
            np.array([[x.lo[0], x.hi[0]] for x in terms]), state, flow, effect.at_start[0] if flow else 0.0,
            (0.0, 0.0) if z is None else (z.lo, z.hi),
        )  # fmt: skip


def _recorded(effect: Effect, shapes: dict[str, Interval], *, warm: bool, flow: bool) -> BoundLaw:
    """The law's columns on tape, or the rate of its state, with its shapes as intervals."""
    tape = Tape()
    values = {k: tape.parameter(float(x.mid[0])) for k, x in shapes.items()}
    s = _seen(tape, len(effect.states), warm=warm)
    results = effect.rates(s, values)[:1] if flow else effect.columns(s, values)
    at = [x.at if hasattr(x, "at") else tape.constant(float(x)).at for x in results]
    steps, places = needed(tape.steps, at)
    numbers = np.array([tape.numbers, tape.numbers]).T if tape.numbers else np.zeros((1, 2))
    for k, x in enumerate(shapes.values()):
        numbers[k] = x.lo[0], x.hi[0]
    return BoundLaw(
        np.array(steps, np.int32).reshape(-1, 3), numbers, np.array(places, np.int32),
        frozenset(k for what, k, _ in steps if what == SIGNAL),
    )  # fmt: skip


def _seen(tape: Tape, states: int, *, warm: bool) -> Signals:
    """What a law may look at in a stop; who computes with anything else is refused."""
    bounded = (
        "q",
        "dq",
        "given_direction",
        "load",
        "warm",
        "stiff",
        "inertia",
        "coriolis",
        "dq_other",
        *(("temp",) if warm else ()),
    )
    every: dict[str, Any] = {f.name: Unbounded(f.name) for f in fields(Signals)}
    if not warm:
        every["temp"] = Unbounded("temp, and no temperature was recorded")
    every |= {name: tape.signal(SIGNALS.index(name)) for name in bounded}
    every["tip"] = (Unbounded("tip"),) * 10
    every["tilt"] = tuple(tape.signal(TILT + k) for k in range(2))
    every["memory"] = tuple(tape.signal(MEMORY + k) for k in range(states))
    return Signals(**every)
