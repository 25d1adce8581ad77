"""The FMU's variables: one list that writes the model description, the C positions and the documentation alike.

Real variables come first, then integers, then booleans, so that a variable's place in its C array and its value reference
differ only by a constant.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stopset.artifact import Model
from stopset.fmu.laws import EffectParameter, effect_laws, effect_parameters

Kind = Literal["Real", "Integer", "Boolean"]
REFERENCE_TEMPERATURE_degC = 30.0


@dataclass(frozen=True, slots=True)
class Variable:
    """``name`` as in recordings where it is the same thing; ``group``: C name of the block it begins or belongs to."""

    name: str
    group: str
    kind: Kind
    causality: Literal["independent", "input", "output", "parameter", "local"]
    unit: str
    description: str
    start: float | int | bool | None = None
    variability: Literal["continuous", "discrete", "fixed", "tunable"] = "continuous"
    derivative: str = ""  # name of the variable this one is the time derivative of
    lo: float | None = None
    hi: float | None = None


@dataclass(frozen=True, slots=True)
class Variables:
    """All variables in order of their value references."""

    all: tuple[Variable, ...]
    effects: tuple[EffectParameter, ...]
    viscous_orders: int

    def __iter__(self) -> Iterator[Variable]:
        return iter(self.all)

    def of(self, kind: Kind) -> list[Variable]:
        """Those of one type."""
        return [v for v in self.all if v.kind == kind]

    def reference(self, name: str) -> int:
        """Value reference of a variable."""
        return next(k for k, v in enumerate(self.all) if v.name == name)

    def first(self, group: str) -> int:
        """Position of a block within the C array of its type; -1 if there is none."""
        for kind in ("Real", "Integer", "Boolean"):
            for k, v in enumerate(self.of(kind)):  # type: ignore[arg-type]
                if v.group == group:
                    return k
        return -1

    def count(self, group: str) -> int:
        """How many variables a block has."""
        return sum(v.group == group for v in self.all)


def viscous_orders(model: Model) -> int:
    """Order of the damping polynomial, trailing zeros left out."""
    used = np.flatnonzero(np.any(model.abstraction.viscous != 0.0, axis=0))
    return int(used[-1]) + 1 if used.size else 1


def _per_joint(
    joints: Sequence[str], stem: str, group: str, causality: str, unit: str, what: str, start: object = None,
    variability: str = "continuous", derivative: str = "",
) -> list[Variable]:  # fmt: skip
    starts: list[object] = list(start) if isinstance(start, (list, tuple, np.ndarray)) else [start] * len(joints)
    return [
        Variable(
            f"{stem}_{j}", group, "Real", causality, unit, what.format(j), s,  # type: ignore[arg-type]
            variability, f"{derivative}_{j}" if derivative else "",  # type: ignore[arg-type]
        )
        for j, s in zip(joints, starts, strict=True)
    ]  # fmt: skip


def variables(model: Model) -> Variables:
    """The variables of a model's FMU."""
    J, n = model.joints, model.n
    effects, orders = effect_parameters(model), viscous_orders(model)
    torque = "motor torque, link side" if model.effort != "compensated_torque" else "torque after compensation (u)"
    temp = model.domain.temp.centre if model.domain.temp is not None else np.full(n, REFERENCE_TEMPERATURE_degC)
    offset = model.abstraction.offset if model.abstraction.offset.size else np.zeros(n)
    R: list[Variable] = [Variable("time", "TIME", "Real", "independent", "s", "time")]
    R += _per_joint(J, "tau", "TAU", "input", "N.m", f"{torque}, {{}}", 0.0)
    R += _per_joint(J, "temp", "TEMP", "input", "degC", "temperature of the drive, {}", temp)
    R += _per_joint(J, "q_measured", "Q_MEASURED", "input", "rad", "measured position, {} (used while `measured`)", 0.0)
    R += _per_joint(J, "dq_measured", "DQ_MEASURED", "input", "rad/s", "measured velocity, {} (used while `measured`)", 0.0)
    R += _per_joint(J, "q", "Q", "output", "rad", "position, {}")
    R += _per_joint(J, "dq", "DQ", "output", "rad/s", "velocity, {}", derivative="q")
    R += _per_joint(J, "ddq", "DDQ", "local", "rad/s2", "acceleration, {}", derivative="dq")
    R += _per_joint(J, "q_lo", "Q_LO", "output", "rad", "lower bound of the measured position, {}")
    R += _per_joint(J, "q_hi", "Q_HI", "output", "rad", "upper bound of the measured position, {}")
    R += _per_joint(J, "dq_lo", "DQ_LO", "output", "rad/s", "lower bound of the measured velocity, {}")
    R += _per_joint(J, "dq_hi", "DQ_HI", "output", "rad/s", "upper bound of the measured velocity, {}")
    R += _per_joint(J, "stop_time", "STOP_TIME", "output", "s", "bound of the time to standstill, {}; NaN: not provable")
    R += _per_joint(J, "stop_angle", "STOP_ANGLE", "output", "rad", "bound of the angle to standstill, {}; NaN: not provable")
    R += [
        Variable("tcp_stop_distance", "TCP_STOP_DISTANCE", "Real", "output", "m", "bound of the flange's stop distance; NaN: not provable"),
        Variable("age", "AGE", "Real", "output", "s", "age of the prediction that the bounds belong to"),
    ]  # fmt: skip
    if effect_laws(model).direction:
        R += _per_joint(J, "friction_margin", "INDICATOR", "local", "", "positive while the direction of friction holds, {}")
    fixed = {"variability": "fixed"}
    R += _per_joint(J, "q_start", "Q_START", "parameter", "rad", "position at the start, {}", 0.0, **fixed)
    R += _per_joint(J, "dq_start", "DQ_START", "parameter", "rad/s", "velocity at the start, {}", 0.0, **fixed)
    com = dict(zip("xyz", model.robot.tip, strict=True))
    R.append(Variable("payload_mass", "PAYLOAD_MASS", "Real", "parameter", "kg", "load at the flange", 0.0, "fixed", lo=0.0))
    R += [
        Variable(f"payload_com_{a}", "PAYLOAD_COM", "Real", "parameter", "m", f"{a} of the load's centre of mass in the last link's frame", float(v), "fixed")
        for a, v in com.items()
    ]  # fmt: skip
    R.append(
        Variable("warm", "WARM", "Real", "parameter", "1", "place in the session, 0 cold to 1 warm", 0.0, "tunable")
    )
    # from here on: what changes the arm itself; the bounds hold for the identified values only
    for k in range(orders):
        stem, power = ("viscous", "") if k == 0 else (f"viscous_{k + 1}", f"^{k + 1}")
        unit = "N.m.s/rad" if k == 0 else f"N.m.s{k + 1}/rad{k + 1}"
        R += _per_joint(
            J, stem, "VISCOUS", "parameter", unit, f"friction per dq{power}, {{}}", model.abstraction.viscous[:, k], **fixed
        )
    if model.abstraction.decoupled:
        R += _per_joint(
            J, "inertia", "INERTIA", "parameter", "kg.m2", "inertia with rotor, {}", 1.0 / np.diag(model.abstraction.Minv), **fixed
        )  # fmt: skip
    R += _per_joint(J, "offset", "OFFSET", "parameter", "N.m", "constant torque taken off the input, {}", offset, **fixed)
    R += [Variable(p.name, "EFFECT", "Real", "parameter", p.unit, p.means, p.value, "fixed") for p in effects]
    discrete = {"variability": "discrete"}
    integers = [
        Variable("stop", "STOP", "Integer", "input", "", "stop request: 0 none, 1 STOP 0, 2 STOP 1", 0, "discrete", lo=0, hi=2),
        Variable("verdict", "VERDICT", "Integer", "output", "", "0 no verdict, 1 conformant, 2 violated (stays until reset)", **discrete),
        Variable("violated_joint", "VIOLATED_JOINT", "Integer", "output", "", "number of the joint that violated first, 0 none", **discrete),
    ]  # fmt: skip
    booleans = [
        Variable("measured", "MEASURED", "Boolean", "input", "", "whether q_measured and dq_measured are connected", False, "discrete"),
        Variable("conformant", "CONFORMANT", "Boolean", "output", "", "measured inputs inside the bounds; false also where there is no verdict", **discrete),
        Variable("covered", "COVERED", "Boolean", "output", "", "whether the bounds were tested: domain, horizon and parameters as identified", **discrete),
        Variable("stop_certified", "STOP_CERTIFIED", "Boolean", "output", "", "whether the stop bounds are proven", **discrete),
        Variable("restart", "RESTART", "Boolean", "parameter", "", "start a new prediction from the measured state when the horizon is over", False, "fixed"),
    ]  # fmt: skip
    return Variables((*R, *integers, *booleans), effects, orders)
