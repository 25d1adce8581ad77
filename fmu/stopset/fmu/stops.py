"""What the FMU's stop bounds are computed from: the plant of `stopset stops`, as C for the core's proof."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.artifact import Brakes, Model
from stopset.core.library import lib
from stopset.errors import NotCovered
from stopset.fmu.ctext import array
from stopset.reach.stops import StopBounds
from stopset.reach.stops.brakes import brakes_of
from stopset.reach.stops.compiled import ramp_fields
from stopset.reach.stops.friction import torque_fields
from stopset.reach.stops.laws import BoundLaw
from stopset.reach.stops.path import Path, path_fields
from stopset.reach.stops.payload import per_kg, weighed
from stopset.reach.stops.ramp import Ramp, ramp_of
from stopset.reach.stops.setting import Setting
from stopset.types import Array

NO_BRAKES = (
    "a STOP 0 is asked for, but the model knows no brakes; give their torque, delay and rise in robot.json and identify again"
)
STOP1_TIME = 0.5  # [s] a common controlled ramp, where the model holds none; the controller's own value belongs there
EDGE = 1e-9  # [rad, rad/s] of the domain, as in `stopset.reach.stops.setting.beyond_domain`
# the C structs' fields, in their order
PLANT = (
    "pi_half", "rotor", "rotor_half", "coulomb_lo", "coulomb_hi", "viscous_lo", "viscous_hi", "u_lo", "u_hi", "brake_lo", "brake_hi",
    "delay_lo", "delay_hi", "rise_lo", "rise_hi",
)  # fmt: skip


def bounds_of(model: Model) -> StopBounds:
    """The bounds that the FMU computes, in Python: those of the monitor. Raises `NotCovered` for a model without any."""
    n, most = model.n, int(lib.STOPSET_STOP_JOINTS)
    if n > most:
        raise NotCovered(
            f"an arm of {n} joints; expected {most} at most for a stop bound: describe the chain that is stopped alone"
        )
    out = StopBounds.of(model, fast=True)
    if out.setting is None:
        raise NotCovered(NO_BRAKES)
    return out


def stop_refusal(model: Model) -> str:
    """Why this model's FMU bounds no stop, empty where it may."""
    try:
        bounds_of(model)
    except NotCovered as e:
        return str(e)
    return ""


@dataclass(frozen=True, slots=True)
class StopData:
    """``numbers`` by the names of their C fields; ``c``: the definition of ``stopset_stops``; ``refusal``: why no stop is bounded."""

    numbers: dict[str, Array]
    c: str
    refusal: str


def stop_data(model: Model, path: Path | None = None) -> StopData:
    """Everything about a model's stops that the FMU carries, and those along a ``path``."""
    refusal, brakes, d, limit = stop_refusal(model), brakes_of(model), model.domain, model.robot.q_limit
    n = model.n
    numbers = _nominal(brakes, n) | _nominal_ramp(model) | {
        "stop_q_lo": np.maximum(d.q.lo - EDGE, limit[:, 0]), "stop_q_hi": np.minimum(d.q.hi + EDGE, limit[:, 1]),
        "range_lo": limit[:, 0], "range_hi": limit[:, 1],
        "stop_dq_lo": d.dq.lo - EDGE, "stop_dq_hi": d.dq.hi + EDGE, "stop_per_kg": per_kg(weighed(model, None)[1]),
        "stop_weighed": np.array(weighed(model, None)[0]),
    }  # fmt: skip
    names = ("stop_centre", "stop_radius", "truth_centre", "truth_radius", "noise_lo", "noise_hi")
    if refusal:
        none = "const StopsetStops stopset_stops = {0};\nconst StopsetRamp stopset_ramp = {0};\n" + NO_PATH
        return StopData(numbers | dict.fromkeys(names, np.zeros(2 * n)), none, refusal)
    setting = bounds_of(model).setting
    assert setting is not None
    start, truth, noise = setting.start, setting.truth, setting.noise
    values = (start.centre, start.radius, truth.centre, truth.radius, noise.lo, noise.hi)
    definition = _definition(setting) + _ramp_definition(setting, ramp_of(model)) + _path_definition(setting, path)
    return StopData(numbers | dict(zip(names, values, strict=True)), definition, "")


def controlled(model: Model) -> Ramp | None:
    """The ramp whose stops the FMU bounds, None where the model holds none or no stop is bounded."""
    return None if stop_refusal(model) else ramp_of(model)


def ramp_time_of(model: Model) -> float:
    """The length [s] of the longest joint's ramp, where ramps have one; else a common one, which belongs to no model."""
    ramp = ramp_of(model)
    return STOP1_TIME if ramp is None or ramp.kind != "time" else float(ramp.value.centre.max())


def _nominal_ramp(model: Model) -> dict[str, Array]:
    """The ramp of the nominal motion."""
    ramp, n = ramp_of(model), model.n
    if ramp is None:
        return {"ramp_value": np.ones(n), "ramp_delay": np.zeros(n), "ramp_pace": np.array(0.0)}
    value = ramp.value.centre / (ramp_time_of(model) if ramp.kind == "time" else 1.0)
    return {"ramp_value": value, "ramp_delay": ramp.control.centre, "ramp_pace": np.array(np.clip(0.0, *ramp.pace))}


def _ramp_definition(setting: Setting, ramp: Ramp | None) -> str:
    """``stopset_ramp`` and its arrays."""
    if ramp is None:
        return "const StopsetRamp stopset_ramp = {0};\n"
    arrays, numbers = ramp_fields(setting, ramp)
    lines = [f"static const double ramp_{k}[] = {array(x)};" for k, x in arrays.items()]
    fields = [f".{k} = ramp_{k}" for k in arrays] + [f".{k} = {array(x)}" for k, x in numbers.items()]
    return "\n".join(lines) + f"\nconst StopsetRamp stopset_ramp = {{{', '.join(fields)}}};\n"


NO_PATH = "const StopsetPath stopset_path = {0};\n"


def _path_definition(setting: Setting, path: Path | None) -> str:
    """``stopset_path`` and its arrays."""
    if path is None:
        return NO_PATH
    arrays = path_fields(setting, path)
    lines = [f"static const double path_{k}[] = {array(np.ravel(x))};" for k, x in arrays.items()]
    fields = [f".pieces = {len(path.coefficient)}", *(f".{k} = path_{k}" for k in arrays)]
    return "\n".join(lines) + f"\nconst StopsetPath stopset_path = {{{', '.join(fields)}}};\n"


def _nominal(brakes: Brakes | None, n: int) -> dict[str, Array]:
    """The brakes of the nominal motion."""
    if brakes is None:
        return dict.fromkeys(("brake_mid", "brake_delay", "brake_rise"), np.zeros(n))
    return {"brake_mid": brakes.torque.centre, "brake_delay": brakes.delay.centre, "brake_rise": brakes.rise.centre}


def _definition(setting: Setting) -> str:
    """``stopset_stops`` and the arrays it points at."""
    lines: list[str] = []

    def stored(name: str, x: Array) -> str:
        lines.append(f"static const double stops_{name}[] = {array(np.ravel(x))};")
        return f"stops_{name}"

    p = setting.plant
    chain = [stored(k, getattr(p.chain, k)) for k in ("R", "p", "axis", "gravity")]
    plant = [stored(k, getattr(p, k)) for k in PLANT]
    bent = [stored(f"curvature_{k}", getattr(p.curvature, k)) for k in ("M", "g", "size", "load")]
    arm = ", ".join(["NJ", *chain, stored("pi", p.pi)])
    lag = "0" if setting.lag is None else stored("lag", setting.lag)
    delay_spread = -1.0 if setting.delay_spread is None else setting.delay_spread
    tool = stored("tool", setting.payload_com)
    torques = "0" if setting.torques.settled else _torques(setting, lines)
    whole = f"{{{{{arm}}}, {', '.join(plant)}, {{{', '.join(bent)}}}}}"
    lines.append(f"const StopsetStops stopset_stops = {{{whole}, {lag}, {delay_spread!r}, {tool}, {torques}, 0}};")
    return "\n".join(lines) + "\n"


def _torques(setting: Setting, lines: list[str]) -> str:
    """``StopsetTorques``: the effects by their laws, as `stopset.reach.stops.friction.torques_struct` gives them to the core."""
    x = setting.torques

    def stored(name: str, values: Array) -> str:
        lines.append(f"static const double {name}[] = {array(np.ravel(values))};")
        return name

    def law(name: str, tape: BoundLaw | None) -> str:
        if tape is None:
            return "{0}"
        lines.append(f"static const int32_t {name}_steps[] = {{{', '.join(map(str, tape.steps.ravel().tolist()))}}};")
        return f"{{{len(tape.steps)}, {name}_steps, {stored(f'{name}_numbers', tape.numbers)}}}"

    rows = []
    for k, e in enumerate(x.laws):
        name = f"acting_{k}"
        columns, flow = law(f"{name}_law", e.columns), law(f"{name}_flow", e.flow)
        lines.append(f"static const int32_t {name}_column[] = {{{', '.join(map(str, e.columns.at.tolist()))}}};")
        state = stored(f"{name}_state", e.state) if e.state.size else "0"
        numbers = [e.joint, e.other, e.role, int(e.straight), int(e.roams), len(e.columns.at), len(e.state)]
        parts = [*map(str, numbers), columns, f"{name}_column", stored(f"{name}_value", e.value), state, flow]
        rows.append(f"{{{', '.join([*parts, array(e.start), array(e.range)])}}}")
    fields = {k: "0" if v is None else stored(f"torques_{k}", v) for k, v in torque_fields(x, setting.free).items()}
    lines.append(f"static const StopsetActing stops_acting[] = {{{', '.join(rows) or '{0}'}}};")
    named = ", ".join(f".{k} = {v}" for k, v in fields.items())
    lines.append(f"static const StopsetTorques stops_torques = {{{len(rows)}, {x.needs}, stops_acting, {named}}};")
    return "&stops_torques"
