"""The two C files that hold one model: ``model_config.h`` (sizes, positions) and ``model_data.c`` (every number)."""

from __future__ import annotations

import hashlib
import importlib.util
import uuid
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.core.library import lib
from stopset.effects import REFERENCE_TEMPERATURE, get
from stopset.errors import OutputError
from stopset.fmu.ctext import array, quoted
from stopset.fmu.laws import Laws, laws_of
from stopset.fmu.stops import stop_data
from stopset.fmu.variables import Variable, Variables
from stopset.reach.flowpipe import torque_set
from stopset.reach.nonlinear import FAR, dynamics
from stopset.reach.stops.ramp import ramp_of

OWN_UNITS = (
    "arrays.c",
    "core.c",
    "prepare.c",
    "sample.c",
    "motion.c",
    "nonlinear.c",
    "ramp.c",
    "stops.c",
    "fmi.c",
    "fmi2.c",
    "fmi3.c",
)
OWN_HEADERS = ("runge_kutta.h", "stopset_core.h", "stopset_fmi.h")
# the compiled core's own files: what the monitor runs is what the FMU runs
CORE = "core"
PROOF = (
    "bound",
    "cartesian",
    "drives",
    "energy",
    "expansion",
    "laws",
    "local",
    "momentum",
    "moving",
    "path",
    "pulls",
    "ramp",
    "related",
    "swiftness",
    "torques",
    "tube",
)
SHARED = (
    "along",
    "inputs",
    "law",
    "linear",
    "maths",
    "polynomials",
    "predict",
    "predictions",
    "predictions_along",
    "rigid",
    "watch",
)
CORE_UNITS = (*(f"{name}.c" for name in SHARED), *(f"stops/{name}.c" for name in PROOF))
CORE_HEADERS = (
    "inputs.h",
    "law.h",
    "maths.h",
    "stopset.h",
    "vectors.h",
    "wide.h",
    "stops/bound.h",
    "stops/laws.h",
    "stops/stops.h",
)
UNITS = (*OWN_UNITS, *(f"{CORE}/{name}" for name in CORE_UNITS))
FMI_HEADERS = (
    "fmi2FunctionTypes.h", "fmi2Functions.h", "fmi2TypesPlatform.h",
    "fmi3FunctionTypes.h", "fmi3Functions.h", "fmi3PlatformTypes.h",
)  # fmt: skip
MOST_PREDICTIONS = 1500  # rows of the comparison, as `stopset.monitor.watch`
GROUPS_ALWAYS = ("EFFECT", "INERTIA", "INDICATOR", "MEMORY", "MEMORY_RATE", "MEMORY_START")
CONTROLLED = ("STOP1_NOMINAL", "STOP1_GUARANTEED", "STOP2")  # categories that only a model with a ramp has
ON_PATH = "PATH_STOP"  # and one that only a unit with a path has
KINDS = {"independent": "KIND_TIME", "input": "KIND_INPUT", "output": "KIND_OUTPUT", "local": "KIND_LOCAL"}


def _config(variables: Variables, n: int, flags: Mapping[str, int]) -> str:
    lines = [f"#define NJ {n}", f"#define NV {variables.viscous_orders}", f"#define N_ARRAYS {len(variables.arrays)}"]
    for kind, size in (("Real", "N_REAL"), ("Integer", "N_INT"), ("Boolean", "N_BOOL")):
        lines.append(f"#define {size} {len(variables.of(kind))}")  # type: ignore[arg-type]
    seen: list[str] = []
    for v in variables:
        if v.group not in seen:
            seen.append(v.group)
            prefix = "VR" if v.kind == "Real" else "IX"
            lines.append(f"#define {prefix}_{v.group} {variables.first(v.group)}")
    for category in (*CONTROLLED, ON_PATH):
        if f"{category}_TIME" not in seen:
            lines += [f"#define VR_{category}_TIME N_REAL", f"#define IX_{category}_CERTIFIED N_BOOL"]
        if f"{category}_END_STOP" not in seen:
            lines.append(f"#define IX_{category}_END_STOP N_BOOL")
    for group in GROUPS_ALWAYS:
        if group not in seen:
            lines.append(f"#define VR_{group} 0")
        lines.append(f"#define N_{group} {variables.count(group)}")
    for group in ("VISCOUS", "INERTIA", "OFFSET"):
        if group in seen:
            lines.append(f"#define VR_FIRST_PHYSICAL VR_{group}")
            break
    if "VISCOUS" not in seen:
        lines.append("#define VR_VISCOUS VR_FIRST_PHYSICAL")
    if "TEMP_LO" not in seen:
        lines += ["#define VR_TEMP_LO VR_TEMP", "#define VR_TEMP_HI VR_TEMP"]  # of a model without bounds on them: not looked at
    physical = sum(variables.count(g) for g in ("VISCOUS", "INERTIA", "OFFSET", "EFFECT", "MEMORY_START"))
    lines += [f"#define N_PHYSICAL {physical}", f"#define N_KEY {physical + 5}"]
    lines += [f"#define {name} {value}" for name, value in flags.items()]
    return "/* Written by stopset export-fmu. */\n" + "\n".join(lines) + "\n"


def _sizes(model: Model, variables: Variables, laws: Laws) -> dict[str, int]:
    """Of the grid of ages, of predictions that are compared, of directions in which U acts."""
    a, sets, steps = model.abstraction, model.powered, steps_of(model)
    stride = max(1, -(-steps // MOST_PREDICTIONS)) if a.linear else 1
    generators = 0 if sets.zonotope is None or not a.linear else sets.zonotope.generators.shape[1]
    struct, paths = dynamics(a)[0], not (a.linear or a.decoupled)
    return {
        "KIND": a.kind, "CORNERS": int(a.decoupled and not a.linear), "PATHS": int(paths),
        "ROOM": lib.stopset_along_room(struct, steps) if paths else lib.stopset_ahead_room(struct, 0),
        "HAS_DIRECTION": int(laws.direction), "HAS_INDICATORS": int(variables.count("INDICATOR") > 0), "AGES": steps + 1,
        "STRIDE": stride, "PREDICTIONS": steps // stride + 1, "N_TORQUES": model.n + generators,
        "N_STOPS": len(variables.categories), "HAS_PATH": int(variables.path is not None),
    }  # fmt: skip


def steps_of(model: Model) -> int:
    """Of the grid, up to the oldest age that is looked at."""
    sets, a = model.powered, model.abstraction
    steps = round(sets.horizon / sets.dt)
    return steps if a.linear or a.decoupled else min(steps, FAR)


def _polynomials(model: Model) -> str:
    """``stopset_polynomials_of``."""
    a, lines = model.abstraction, []
    if not (a.coriolis or a.acceleration):
        return "const StopsetPolynomials stopset_polynomials_of = {0};\n"
    p = a.program
    for name, x in (("parent", p.parent), ("variable", p.variable)):
        lines.append(f"static const int64_t monomial_{name}[] = {{{', '.join(map(str, x.tolist()))}}};")
    lines.append(f"static const double monomial_coefficient[] = {array(p.coefficient.ravel())};")
    sizes = f"{p.coefficient.shape[0]}, {p.coefficient.shape[1]}, {p.dimension}"
    table = f"{{{sizes}, monomial_parent, monomial_variable, monomial_coefficient}}"
    return "\n".join([*lines, f"const StopsetPolynomials stopset_polynomials_of = {table};\n"])


def _kind(v: Variable) -> str:
    if v.causality == "parameter":
        return "KIND_TUNABLE" if v.variability == "tunable" else "KIND_FIXED"
    return KINDS[v.causality]


def _starts(items: Iterable[Variable]) -> list[float]:
    return [float(v.start) if v.start is not None else 0.0 for v in items]


def _numbers(model: Model) -> dict[str, Any]:
    """The model's arrays, by the names of their C fields."""
    sets, a, d, chain, n = model.powered, model.abstraction, model.domain, model.robot.chain, model.n
    torques, U = torque_set(sets) if a.linear else (None, sets.U)
    temp = (np.full(n, -np.inf), np.full(n, np.inf)) if d.temp is None else (d.temp.lo, d.temp.hi)
    return {
        "Minv": a.Minv, "X0_lo": sets.X0.lo, "X0_hi": sets.X0.hi, "V_lo": sets.V.lo, "V_hi": sets.V.hi,
        "U_lo": U.lo, "U_hi": U.hi, "across": np.eye(n) if torques is None else torques, "dt": sets.dt,
        "horizon": steps_of(model) * sets.dt,
        "lo": np.concatenate([d.q.lo, d.dq.lo, d.u.lo, temp[0]]), "hi": np.concatenate([d.q.hi, d.dq.hi, d.u.hi, temp[1]]),
        "payload_lo": d.payload[0], "payload_hi": d.payload[1],
        "R": chain.R, "p": chain.p, "axis": chain.axis, "gravity": chain.gravity, "pi": model.robot.pi,
        "gain": model.input.gain, "standstill": model.input.standstill, "q_a": model.provenance.get("q_a", np.zeros(n)),
        "reference_temperature": REFERENCE_TEMPERATURE,
    }  # fmt: skip


def _flags(model: Model) -> dict[str, bool]:
    sets, a = model.powered, model.abstraction
    return {
        "decoupled": a.decoupled, "generators": sets.zonotope is not None, "position_only": sets.conform == "position",
        "motor_torque": model.effort != "compensated_torque", "swift": a.swift, "sliding": sets.windows == "sliding",
        "ramp_timed": (ramp := ramp_of(model)) is None or ramp.kind == "time", "plain": model.input.plain,
        "timed": any("t" in get(f.effect).needs for f in model.input.effects),
        "has_domain_temp": model.domain.temp is not None,
    }  # fmt: skip


def _data(model: Model, variables: Variables, laws: Laws, token: str) -> str:
    stop = stop_data(model, variables.path)
    rows = [f"    .{k} = {array(v)}," for k, v in (_numbers(model) | stop.numbers).items()]
    rows += [f"    .{k} = {int(v)}," for k, v in (_flags(model) | {"has_brakes": not stop.refusal}).items()]
    rows += [f"    .{k} = {text}," for k, text in laws.fields.items()]
    rows.append(f"    .start_real = {array(_starts(variables.of('Real')))},")
    for field, kind in (("start_int", "Integer"), ("start_bool", "Boolean")):
        starts = ", ".join(str(int(x)) for x in _starts(variables.of(kind)))  # type: ignore[arg-type]
        rows.append(f"    .{field} = {{{starts}}},")
    rows.append(f"    .kind = {{{', '.join(_kind(v) for v in variables)}}},")
    arrays = ", ".join(str(a.first) for a in variables.arrays)
    names = ",\n        ".join(f'"{v.name}"' for v in variables)
    rows.append(f"    .name = {{\n        {names}}},")
    return (
        f"/* Written by stopset export-fmu from the model with SHA-256 {model.sha256 or '(unsaved)'}. */\n"
        f'#include <math.h>\n\n#include "stopset_core.h"\n\nconst char stopset_token[] = "{token}";\n'
        f"const uint32_t stopset_arrays[] = {{{arrays}}};\n"
        f"const char stopset_refusal[] = {quoted(stop.refusal)};\n\n{stop.c}\n{laws.c}\n{_polynomials(model)}\n"
        "const StopsetModel stopset_model = {\n" + "\n".join(rows) + "\n};\n"
    )


def fmi_headers() -> Path:
    """Folder of the FMI standard's C headers, as fmpy brings them (BSD-2; they go into the FMU with their notice).

    Raises `OutputError` where that package is not installed.
    """
    found = importlib.util.find_spec("fmpy")  # located, not imported: it is heavy
    if found is None or not found.submodule_search_locations:
        raise OutputError("the FMI headers come with the package fmpy, which is not here; install stopset[fmu]")
    return Path(found.submodule_search_locations[0]) / "c-code"


def sources(model: Model, variables: Variables) -> tuple[dict[str, str], str]:
    """File name -> text of all C sources of a model's FMU, and the instantiation token (from the sources' hash)."""
    core = resources.files("stopset.fmu") / "core"
    shared = resources.files("stopset.core") / "c"
    text = {name: (core / name).read_text() for name in (*OWN_UNITS, *OWN_HEADERS)}
    text |= {f"{CORE}/{name}": (shared / name).read_text() for name in (*CORE_UNITS, *CORE_HEADERS)}
    # two FMUs in one process must not share their functions
    text[f"{CORE}/stopset.h"] = "#define STOPSET_API /* inside an FMU */\n" + text[f"{CORE}/stopset.h"]
    text |= {name: (fmi_headers() / name).read_text() for name in FMI_HEADERS}
    laws = laws_of(model)
    text["model_config.h"] = _config(variables, model.n, laws.sizes | _sizes(model, variables, laws))
    content = _data(model, variables, laws, "") + "".join(text[k] for k in sorted(text))
    token = "{" + str(uuid.UUID(hashlib.sha256(content.encode()).hexdigest()[:32])) + "}"
    text["model_data.c"] = _data(model, variables, laws, token)
    return text, token
