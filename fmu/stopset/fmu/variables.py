"""The FMU's variables: one list that writes the model description, the C positions and the documentation alike.

Real variables come first, then integers, then booleans, so that a variable's place in its C array and its value reference
differ only by a constant.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.effects import REFERENCE_TEMPERATURE
from stopset.errors import NotCovered
from stopset.fmu.laws import EffectParameter, effect_parameters, laws_of, remembered
from stopset.fmu.stops import controlled, ramp_time_of
from stopset.reach.stops.brakes import brakes_of
from stopset.reach.stops.path import Path
from stopset.reach.stops.payload import weighed

VariableKind = Literal["Real", "Integer", "Boolean"]
Causality = Literal["independent", "input", "output", "parameter", "local"]
Variability = Literal["continuous", "discrete", "fixed", "tunable"]
KINDS: tuple[VariableKind, ...] = ("Real", "Integer", "Boolean")


@dataclass(frozen=True, slots=True)
class Variable:
    """``name`` as in recordings where it is the same thing; ``group``: C name of the block it begins or belongs to."""

    name: str
    group: str
    kind: VariableKind
    causality: Causality
    unit: str
    description: str
    start: float | int | bool | None = None
    variability: Variability = "continuous"
    derivative: str = ""  # name of the variable this one is the time derivative of
    lo: float | None = None
    hi: float | None = None


@dataclass(frozen=True, slots=True)
class JointArray:
    """Of FMI 3: the joints' scalars under one name, ``like`` the ``first`` of them; ``starts`` are theirs."""

    name: str
    like: Variable
    first: int
    starts: tuple[float | None, ...]


CLOCKS = {
    f"request_stop_{k}": f"a tick asks for a STOP {k} that begins at once" for k in range(3)
}  # of FMI 3, in the order of their values


@dataclass(frozen=True, slots=True)
class Variables:
    """All scalars in order of their value references; arrays and `CLOCKS` come behind them, in FMI 3."""

    all: tuple[Variable, ...]
    effects: tuple[EffectParameter, ...]
    viscous_orders: int
    arrays: tuple[JointArray, ...]
    clocks: bool
    categories: tuple[StopCategory, ...]
    path: Path | None

    def __iter__(self) -> Iterator[Variable]:
        return iter(self.all)

    def of(self, kind: VariableKind) -> list[Variable]:
        """Those of one type."""
        return [v for v in self.all if v.kind == kind]

    def reference(self, name: str) -> int:
        """Value reference of a variable."""
        return next(k for k, v in enumerate(self.all) if v.name == name)

    def first(self, group: str) -> int:
        """Position of a block within the C array of its type; -1 if there is none."""
        for kind in KINDS:
            for k, v in enumerate(self.of(kind)):
                if v.group == group:
                    return k
        return -1

    def count(self, group: str) -> int:
        """How many variables a block has."""
        return sum(v.group == group for v in self.all)


def viscous_orders(model: Model) -> int:
    """Order of the damping polynomial, trailing zeros left out; model 3 has it in its accelerations."""
    if model.abstraction.kind == 3:
        return 0
    used = np.flatnonzero(np.any(model.abstraction.viscous != 0.0, axis=0))
    return int(used[-1]) + 1 if used.size else 1


Starts = Sequence[float] | NDArray[np.float64] | float | None


def _joints(model: Model, like: Variable, start: Starts = None) -> list[Variable]:
    """One variable per joint: ``like`` with the joint behind its names and in its description."""
    starts = [None] * model.n if start is None else np.broadcast_to(start, model.n).tolist()
    return [
        replace(
            like, name=f"{like.name}_{j}", group=like.group or like.name.upper(), description=like.description.format(j), start=s,
            derivative=f"{like.derivative}_{j}" if like.derivative else "",
        )
        for j, s in zip(model.joints, starts, strict=True)
    ]  # fmt: skip


def _real(stem: str, causality: Causality, unit: str, what: str, variability: Variability = "continuous") -> Variable:
    return Variable(stem, "", "Real", causality, unit, what, variability=variability)


def _inputs(m: Model) -> list[Variable]:
    torque = "motor torque, link side" if m.effort != "compensated_torque" else "torque after compensation (u)"
    temp = m.domain.temp.centre if m.domain.temp is not None else REFERENCE_TEMPERATURE
    return [
        *_joints(m, _real("tau", "input", "N.m", f"{torque}, {{}}"), 0.0),
        *_joints(m, _real("temp", "input", "degC", "temperature of the drive, {}"), temp),
        *_joints(m, _real("q_measured", "input", "rad", "measured position, {} (used while `measured`)"), 0.0),
        *_joints(m, _real("dq_measured", "input", "rad/s", "measured velocity, {} (used while `measured`)"), 0.0),
    ]


_ON_PATH = (
    Variable("path_row", "PATH_ROW", "Real", "input", "1", "row of the path where the arm is, a fraction too", 0.0),
    Variable("path_rate", "PATH_RATE", "Real", "input", "1/s", "rows of the path passed per second; 0: no path is followed", 0.0),
)


@dataclass(frozen=True, slots=True)
class StopCategory:
    """Names of a category's outputs begin with ``stem``, those of the tool with ``tool``; ``what`` kind of stop in words."""

    stem: str
    tool: str
    what: str


POWER_OFF = StopCategory("stop", "tcp_stop", "a STOP 0")
CONTROLLED = (
    StopCategory("stop1_nominal", "tcp_stop1_nominal", "a STOP 1 whose ramp works"),
    StopCategory("stop1_guaranteed", "tcp_stop1_guaranteed", "a STOP 1 whose ramp may fail"),
    StopCategory("stop2", "tcp_stop2", "a STOP 2, standstill window included"),
)


ON_PATH = StopCategory("path_stop", "tcp_path_stop", "a STOP 1 that keeps to the path from its row `path_row` on")


def categories(m: Model, path: Path | None = None) -> tuple[StopCategory, ...]:
    """The kinds of stop that the unit has outputs of. Raises `NotCovered` for a path and a model without a ramp."""
    if controlled(m) is None:
        if path is not None:
            raise NotCovered(
                "a path, and the model bounds no controlled stop; expected a ramp and brakes: identify it with stop1 recordings and "
                "brakes, or leave the path out"
            )
        return (POWER_OFF,)
    return (POWER_OFF, *CONTROLLED, *(() if path is None else (ON_PATH,)))


def _stop_outputs(m: Model, c: StopCategory) -> list[Variable]:
    """In the order of stops.c."""
    until = f"to standstill of {c.what} that begins now, {{}}; NaN: no bound"
    tool = f"of the tool centre point in {c.what} that begins now; NaN: no bound"
    larger, group = f"the larger of {c.stem}_forward and {c.stem}_back {until}", c.stem.upper()
    return [
        *_joints(m, _real(f"{c.stem}_time", "output", "s", f"bound of the time {until}")),
        *_joints(m, _real(f"{c.stem}_angle", "output", "rad", larger)),
        *_joints(m, _real(f"{c.stem}_forward", "output", "rad", f"bound of the angle in positive direction {until}")),
        *_joints(m, _real(f"{c.stem}_back", "output", "rad", f"bound of the angle in negative direction {until}")),
        Variable(f"{c.tool}_distance", f"{group}_DISTANCE", "Real", "output", "m", f"bound of the displacement {tool}"),
        Variable(f"{c.tool}_speed", f"{group}_SPEED", "Real", "output", "m/s", f"bound of the speed {tool}"),
        Variable(
            f"{c.stem}_age", f"{group}_AGE", "Real", "output", "s", f"how long ago the bounds of {c.what} were computed; NaN: there are none"
        ),
    ]  # fmt: skip


def _outputs(m: Model, kinds: Sequence[StopCategory]) -> list[Variable]:
    out = [
        *_joints(m, _real("q", "output", "rad", "position, {}")),
        *_joints(m, replace(_real("dq", "output", "rad/s", "velocity, {}"), derivative="q")),
        *_joints(m, replace(_real("ddq", "local", "rad/s2", "acceleration, {}"), derivative="dq")),
        *_joints(m, _real("q_lo", "output", "rad", "lower bound of the measured position, {}")),
        *_joints(m, _real("q_hi", "output", "rad", "upper bound of the measured position, {}")),
        *_joints(m, _real("dq_lo", "output", "rad/s", "lower bound of the measured velocity, {}")),
        *_joints(m, _real("dq_hi", "output", "rad/s", "upper bound of the measured velocity, {}")),
    ]
    for c in kinds:
        out += _stop_outputs(m, c)
    out.append(Variable("age", "AGE", "Real", "output", "s", "age of the prediction that the bounds belong to"))
    for r in remembered(m):
        out.append(Variable(r.name, "MEMORY", "Real", "local", r.unit, r.means))
    for r in remembered(m):
        rate = f"rate of {r.name}"
        out.append(Variable(f"der_{r.name}", "MEMORY_RATE", "Real", "local", f"{r.unit}/s", rate, derivative=r.name))
    if laws_of(m).direction or brakes_of(m) is not None:
        margin = "positive while the direction of friction holds, {}"
        out += _joints(m, replace(_real("friction_margin", "local", "", margin), group="INDICATOR"))
    return out


def start_posture(model: Model) -> NDArray[np.float64]:
    """Where the FMU starts unless told otherwise (n,) [rad]: zero where the domain holds it well inside, else its middle."""
    q = model.domain.q
    inside = np.abs(q.centre) <= 0.8 * q.radius
    return np.where(inside, 0.0, q.centre)


def _conditions(m: Model) -> list[Variable]:
    """Parameters that say where the arm starts and what it carries."""
    what = "{} of the load's centre of mass in the last link's frame"
    com = [
        Variable(f"payload_com_{a}", "PAYLOAD_COM", "Real", "parameter", "m", what.format(a), float(x), "fixed")
        for a, x in zip("xyz", weighed(m, None)[1], strict=True)
    ]
    d, carried = m.domain, "{} load that stop bounds hold for"
    ramp = "length of the controller's STOP 1 ramp, all joints alike; set yours"
    session = "place in the session, 0 cold to 1 warm"
    failing = []
    if (braking := controlled(m)) is not None:
        after = -1.0 if braking.off_after is None else braking.off_after
        what_then = "SS1-t: power is taken so long after the request whatever happens; negative: never"
        failing.append(Variable("ss1_off_after", "SS1_OFF_AFTER", "Real", "parameter", "s", what_then, after, "tunable"))
    return [
        *_joints(
            m,
            _real("q_start", "parameter", "rad", "position at the start, unless one is measured, {}", "fixed"),
            start_posture(m),
        ),
        *_joints(m, _real("dq_start", "parameter", "rad/s", "velocity at the start, unless one is measured, {}", "fixed"), 0.0),
        Variable("payload_mass", "PAYLOAD_MASS", "Real", "parameter", "kg", "load at the flange", 0.0, "tunable", lo=0.0),
        *com,
        Variable("payload_lo", "PAYLOAD_LO", "Real", "parameter", "kg", carried.format("least"), d.payload[0], "tunable"),
        Variable("payload_hi", "PAYLOAD_HI", "Real", "parameter", "kg", carried.format("largest"), d.payload[1], "tunable"),
        *_temperatures(m),
        Variable("stop1_time", "STOP1_TIME", "Real", "parameter", "s", ramp, ramp_time_of(m), "fixed"),
        *failing,
        Variable("warm", "WARM", "Real", "parameter", "1", session, 0.0, "tunable"),
    ]


def _temperatures(m: Model) -> list[Variable]:
    """The range of temperatures that bounds are asked for, of a model that has bounds on them."""
    if (temp := m.domain.temp) is None:
        return []
    what = "{} temperature of the drive that bounds are asked for, {{}}"
    return [
        *_joints(m, _real("temp_lo", "parameter", "degC", what.format("least"), "tunable"), temp.lo),
        *_joints(m, _real("temp_hi", "parameter", "degC", what.format("largest"), "tunable"), temp.hi),
    ]


def _physics(m: Model, effects: Sequence[EffectParameter]) -> list[Variable]:
    """Parameters of the arm itself; the bounds hold for the identified values only."""
    a = m.abstraction
    out: list[Variable] = []
    for k in range(viscous_orders(m)):
        stem, unit = ("viscous", "N.m.s/rad") if k == 0 else (f"viscous_{k + 1}", f"N.m.s{k + 1}/rad{k + 1}")
        what = "friction per " + ("dq" if k == 0 else f"dq^{k + 1}") + ", {}"
        out += _joints(m, replace(_real(stem, "parameter", unit, what, "fixed"), group="VISCOUS"), a.viscous[:, k])
    if a.decoupled:
        J = 1.0 / np.diag(a.Minv)
        out += _joints(m, _real("inertia", "parameter", "kg.m2", "inertia with rotor, {}", "fixed"), J)
    offset = a.offset if a.offset.size else 0.0
    out += _joints(m, _real("offset", "parameter", "N.m", "constant torque taken off the input, {}", "fixed"), offset)
    out += [Variable(p.name, "EFFECT", "Real", "parameter", p.unit, p.means, p.value, "fixed") for p in effects]
    for r in remembered(m):
        out.append(
            Variable(r.start_name, "MEMORY_START", "Real", "parameter", r.unit, f"at the start: {r.means}", r.start, "fixed")
        )
    return out


_END_STOP = (
    "{} can lead a joint to the end of its range: its bounds hold until one strikes there, not after; false without bounds"
)


def _switches(m: Model, kinds: Sequence[StopCategory]) -> list[Variable]:
    """Integers and booleans: (name, causality, description, start)."""
    every = "steps from one computation of the stop bounds to the next; 1: of every state that is read, 0: only when asked for"
    integers: tuple[tuple[str, Causality, str, int | None], ...] = (
        ("stop", "input", "stop request: 0 none, 1 STOP 0, 2 STOP 1, 3 STOP 2", 0),
        ("stop_every", "parameter", every, 1),
        ("verdict", "output", "0 no verdict, 1 conformant, 2 violated (stays until reset)", None),
        ("violated_joint", "output", "number of the joint that violated first, 0 none", None),
    )
    braking, monitored = controlled(m), "SS1-r: power is taken when the ramp is left"
    booleans: tuple[tuple[str, Causality, str, bool | None], ...] = (
        ("measured", "input", "whether q_measured and dq_measured are connected", False),
        ("evaluate_stop", "input", "compute the stop bounds of exactly this state", False),
        ("conformant", "output", "measured inputs inside the bounds; false also where there is no verdict", None),
        ("covered", "output", "whether the bounds were tested here: domain, horizon, parameters as identified", None),
        *((f"{c.stem}_certified", "output", f"whether the bounds of {c.what} are proven for this state", None) for c in kinds),
        *((("ss1_monitored", "parameter", monitored, braking.monitored),) if braking is not None else ()),
        ("restart", "parameter", "predict anew from the measured state when the horizon is over", True),
        *((f"{c.stem}_end_stop", "output", _END_STOP.format(c.what), None) for c in kinds),
    )
    out = []
    for name, causality, what, start in integers:
        lo, hi = (0.0, 3.0) if name == "stop" else (0.0, None) if name == "stop_every" else (None, None)
        changes: Variability = "tunable" if causality == "parameter" else "discrete"
        out.append(Variable(name, name.upper(), "Integer", causality, "", what, start, changes, lo=lo, hi=hi))
    for name, causality, what, flag in booleans:
        variability: Variability = "fixed" if causality == "parameter" else "discrete"
        out.append(Variable(name, name.upper(), "Boolean", causality, "", what, flag, variability))
    return out


def variables(model: Model, *, clocks: bool = False, path: Path | None = None) -> Variables:
    """The variables of a model's FMU; ``clocks``: whether those of FMI 3 are said to be there; ``path``: along which stops are bounded."""
    kinds = categories(model, path)
    effects = effect_parameters(model)
    real = [Variable("time", "TIME", "Real", "independent", "s", "time")]
    real += [
        *_inputs(model),
        *(_ON_PATH if path is not None else ()),
        *_outputs(model, kinds),
        *_conditions(model),
        *_physics(model, effects),
    ]
    scalars = (*real, *_switches(model, kinds))
    return Variables(scalars, effects, viscous_orders(model), _arrays(model, real), clocks, kinds, path)


def _arrays(m: Model, scalars: Sequence[Variable]) -> tuple[JointArray, ...]:
    """Of what goes in and comes out per joint, and where the arm starts."""
    out, n = [], m.n
    for k, v in enumerate(scalars):
        name = v.name.removesuffix(f"_{m.joints[0]}")
        block = scalars[k : k + n]
        carried = v.causality in ("input", "output") or name in ("q_start", "dq_start")
        if carried and [b.name for b in block] == [f"{name}_{j}" for j in m.joints]:
            text = v.description.replace(m.joints[0], "every joint")
            starts = tuple(None if b.start is None else float(b.start) for b in block)
            out.append(JointArray(name, replace(v, description=text, derivative=""), k, starts))
    return tuple(out)
