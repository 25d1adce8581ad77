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
from stopset.errors import OutputError
from stopset.fmu.ctext import array, quoted
from stopset.fmu.laws import effect_laws
from stopset.fmu.stops import stop_data
from stopset.fmu.variables import Variable, Variables
from stopset.ring.ctext import PRELUDE

OWN_UNITS = ("core.c", "linear.c", "tube.c", "body.c", "motion.c", "stops.c", "fmi.c", "fmi2.c", "fmi3.c")
OWN_HEADERS = ("stopset_core.h", "stopset_fmi.h")
# the compiled core's own files: what the monitor runs is what the FMU runs
CORE = "core"
PROOF = ("bound", "cartesian", "energy", "expansion", "local", "momentum", "moving", "pulls", "tube")
CORE_UNITS = ("maths.c", "rigid.c", *(f"stops/{name}.c" for name in PROOF))
CORE_HEADERS = ("maths.h", "stopset.h", "vectors.h", "stops/stops.h")
UNITS = (*OWN_UNITS, *(f"{CORE}/{name}" for name in CORE_UNITS))
FMI_HEADERS = (
    "fmi2FunctionTypes.h", "fmi2Functions.h", "fmi2TypesPlatform.h",
    "fmi3FunctionTypes.h", "fmi3Functions.h", "fmi3PlatformTypes.h",
)  # fmt: skip
GROUPS_ALWAYS = ("EFFECT", "INERTIA", "INDICATOR", "MEMORY", "MEMORY_RATE", "MEMORY_START")
KINDS = {"independent": "KIND_TIME", "input": "KIND_INPUT", "output": "KIND_OUTPUT", "local": "KIND_LOCAL"}


def _config(variables: Variables, n: int, flags: Mapping[str, int]) -> str:
    lines = [f"#define NJ {n}", f"#define NV {variables.viscous_orders}"]
    for kind, size in (("Real", "N_REAL"), ("Integer", "N_INT"), ("Boolean", "N_BOOL")):
        lines.append(f"#define {size} {len(variables.of(kind))}")  # type: ignore[arg-type]
    seen: list[str] = []
    for v in variables:
        if v.group not in seen:
            seen.append(v.group)
            prefix = "VR" if v.kind == "Real" else "IX"
            lines.append(f"#define {prefix}_{v.group} {variables.first(v.group)}")
    for group in GROUPS_ALWAYS:
        if group not in seen:
            lines.append(f"#define VR_{group} 0")
        lines.append(f"#define N_{group} {variables.count(group)}")
    lines.append("#define VR_FIRST_PHYSICAL VR_VISCOUS")
    lines.append(
        f"#define N_PHYSICAL {sum(variables.count(g) for g in ('VISCOUS', 'INERTIA', 'OFFSET', 'EFFECT', 'MEMORY_START'))}"
    )
    lines += [f"#define {name} {value}" for name, value in flags.items()]
    return "/* Written by stopset export-fmu. */\n" + "\n".join(lines) + "\n"


def _kind(v: Variable) -> str:
    if v.causality == "parameter":
        return "KIND_TUNABLE" if v.variability == "tunable" else "KIND_FIXED"
    return KINDS[v.causality]


def _starts(items: Iterable[Variable]) -> list[float]:
    return [float(v.start) if v.start is not None else 0.0 for v in items]


def _data(model: Model, variables: Variables, laws: str, token: str) -> str:
    sets, a, d, chain = model.powered, model.abstraction, model.domain, model.robot.chain
    n = model.n
    temp_lo = d.temp.lo if d.temp is not None else np.full(n, -np.inf)
    temp_hi = d.temp.hi if d.temp is not None else np.full(n, np.inf)
    signed = a.decoupled and bool(np.all(a.viscous[:, 0] >= 0) and np.all(np.diag(a.Minv) > 0))
    numbers: dict[str, Any] = {
        "Minv": a.Minv, "X0_lo": sets.X0.lo, "X0_hi": sets.X0.hi, "V_lo": sets.V.lo, "V_hi": sets.V.hi,
        "U_lo": sets.U.lo, "U_hi": sets.U.hi, "dt": sets.dt, "horizon": round(sets.horizon / sets.dt) * sets.dt,
        "q_lo": d.q.lo, "q_hi": d.q.hi, "dq_lo": d.dq.lo, "dq_hi": d.dq.hi, "u_lo": d.u.lo, "u_hi": d.u.hi,
        "temp_lo": temp_lo, "temp_hi": temp_hi, "payload_lo": d.payload[0], "payload_hi": d.payload[1],
        "R": chain.R, "p": chain.p, "axis": chain.axis, "gravity": chain.gravity, "pi": model.robot.pi,
        "tip": model.robot.tip, "standstill": model.input.standstill, "q_a": model.provenance.get("q_a", np.zeros(n)),
    }  # fmt: skip
    stop = stop_data(model)
    numbers |= stop.numbers
    whole = {
        "decoupled": a.decoupled, "signed_response": signed, "position_only": sets.conform == "position",
        "motor_torque": model.effort != "compensated_torque", "swift": a.swift, "has_domain_temp": d.temp is not None, "has_brakes": not stop.refusal,
    }  # fmt: skip
    rows = [f"    .{k} = {array(v)}," for k, v in numbers.items()]
    rows += [f"    .{k} = {int(v)}," for k, v in whole.items()]
    rows.append(f"    .start_real = {array(_starts(variables.of('Real')))},")
    for field, kind in (("start_int", "Integer"), ("start_bool", "Boolean")):
        starts = ", ".join(str(int(x)) for x in _starts(variables.of(kind)))  # type: ignore[arg-type]
        rows.append(f"    .{field} = {{{starts}}},")
    rows.append(f"    .kind = {{{', '.join(_kind(v) for v in variables)}}},")
    names = ",\n        ".join(f'"{v.name}"' for v in variables)
    rows.append(f"    .name = {{\n        {names}}},")
    head = f"/* Written by stopset export-fmu from the model with SHA-256 {model.sha256 or '(unsaved)'}. */\n"
    prelude = "\n".join(line for line in PRELUDE.splitlines() if _used(line, laws)).replace("stopset.h", f"{CORE}/stopset.h")
    return (
        f'{head}{prelude}\n#include "stopset_core.h"\n\n'
        f'const char stopset_token[] = "{token}";\nconst char stopset_refusal[] = {quoted(stop.refusal)};\n\n{stop.c}\n{laws}\n'
        "const StopsetModel stopset_model = {\n" + "\n".join(rows) + "\n};\n"
    )


def _used(line: str, laws: str) -> bool:
    """Whether a line of the prelude is an include or defines a function that the laws call."""
    return line.startswith("#") or any(f"{w}(" in laws for w in ("stopset_sign", "stopset_square") if w in line)


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
    laws = effect_laws(model)
    flags = {"HAS_EFFECTS": int(laws.effects), "HAS_DIRECTION": int(laws.direction), "HAS_LOAD": int(laws.load)}
    flags["HAS_INDICATORS"] = int(variables.count("INDICATOR") > 0)
    text["model_config.h"] = _config(variables, model.n, flags)
    content = _data(model, variables, laws.c, "") + "".join(text[k] for k in sorted(text))
    token = "{" + str(uuid.UUID(hashlib.sha256(content.encode()).hexdigest()[:32])) + "}"
    text["model_data.c"] = _data(model, variables, laws.c, token)
    return text, token
