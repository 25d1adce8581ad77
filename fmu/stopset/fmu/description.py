"""modelDescription.xml of FMI 2.0 and 3.0, from the one list of variables."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import replace

from stopset.artifact import Model
from stopset.fmu.variables import CLOCKS, JointArray, Variable, Variables

NOTICE = "Monitoring aid, not a safety function: bounds hold for the identified model and its domain only."
# unit symbol -> exponents of the SI base units
BASE = {
    "rad": {"rad": 1}, "s": {"s": 1}, "m": {"m": 1}, "kg": {"kg": 1}, "K": {"K": 1}, "N": {"kg": 1, "m": 1, "s": -2},
    "A": {"A": 1}, "1": {},
}  # fmt: skip


def base_unit(unit: str) -> dict[str, float] | None:
    """Exponents (and for degC the offset) of a unit such as ``N.m.s/rad``, ``rad/s2``; None where it is not understood."""
    if unit == "degC":
        return {"K": 1, "offset": 273.15}
    out: dict[str, float] = {}
    for part, direction in zip(unit.split("/"), (1, -1, -1, -1), strict=False):
        for symbol in re.split(r"[.\s]+", part.strip("() ")):
            match = re.fullmatch(r"([A-Za-z]+|1)\^?(\d*)", symbol)
            if match is None or match[1] not in BASE:
                return None
            # a bracketed denominator was stripped above: all its factors divide
            for name, power in BASE[match[1]].items():
                out[name] = out.get(name, 0) + direction * power * int(match[2] or 1)
    return {k: v for k, v in out.items() if v}


def _units(root: ET.Element, variables: Iterable[Variable]) -> None:
    names = sorted({v.unit for v in variables if v.unit})
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in names:
        unit = ET.SubElement(definitions, "Unit", name=name)
        base = base_unit(name)
        if base is not None:
            ET.SubElement(unit, "BaseUnit", {k: f"{v:g}" for k, v in base.items()})


def _text(value: float | int) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value)


def _initial(v: Variable) -> str | None:
    if v.causality in ("output", "local"):
        return "calculated"
    return "exact" if v.causality == "parameter" else None


def _capabilities(identifier: str, fmi: int, *, cs: bool) -> dict[str, str]:
    state = ("canGetAndSetFMUstate", "canSerializeFMUstate") if fmi == 2 else ("canGetAndSetFMUState", "canSerializeFMUState")
    out = {"modelIdentifier": identifier, "needsExecutionTool": "false", "canBeInstantiatedOnlyOncePerProcess": "false"}
    out |= dict.fromkeys(state, "true")
    if fmi == 2:
        out["canNotUseMemoryManagementFunctions"] = "true"
    out["providesDirectionalDerivative" if fmi == 2 else "providesDirectionalDerivatives"] = "true"
    if fmi == 3:
        out["providesAdjointDerivatives"] = "true"
    if cs:
        out["canHandleVariableCommunicationStepSize"] = "true"
    if cs and fmi == 3:
        early = (
            "hasEventMode",
            "mightReturnEarlyFromDoStep",
            "canReturnEarlyAfterIntermediateUpdate",
            "providesIntermediateUpdate",
        )
        out |= dict.fromkeys(early, "true")
    if fmi == 3 and not cs:
        out["needsCompletedIntegratorStep"] = "true"  # samples are looked at there; FMI 2 calls it unless told otherwise
    return out


def description(model: Model, variables: Variables, identifier: str, token: str, fmi: int, source_files: Iterable[str]) -> str:
    """The text of modelDescription.xml for FMI ``fmi`` (2 or 3)."""
    dt = model.powered.dt
    indicators = variables.count("INDICATOR")
    head = {
        "fmiVersion": "2.0" if fmi == 2 else "3.0",
        "modelName": identifier,  # fmpy's CMake project of the sources knows no other target, and no name with spaces
        "guid" if fmi == 2 else "instantiationToken": token,
        "description": f"Identified dynamics of {model.robot.name} (model {model.abstraction.kind}) with conformance bounds. {NOTICE}",
        "author": "stopset",
        "license": "Apache-2.0",
        "version": str(len(model.revisions) or 1),
        "generationTool": "stopset export-fmu",
        "variableNamingConvention": "flat",
    }
    if fmi == 2:
        head["numberOfEventIndicators"] = str(indicators)
    root = ET.Element("fmiModelDescription", head)
    for tag, cs in (("ModelExchange", False), ("CoSimulation", True)):
        interface = ET.SubElement(root, tag, _capabilities(identifier, fmi, cs=cs))
        if fmi == 2:
            files = ET.SubElement(interface, "SourceFiles")
            for name in source_files:
                ET.SubElement(files, "File", name=name)
    _units(root, variables)
    categories = ET.SubElement(root, "LogCategories")
    for name, what in (("logStatusError", "what is wrong and what to do"), ("logStatusWarning", "what may be wrong")):
        ET.SubElement(categories, "Category", name=name, description=what)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=repr(dt))
    if fmi == 2:
        _fmi2(root, variables)
    else:
        _fmi3(root, variables)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _attributes(v: Variable, reference: int) -> dict[str, str]:
    out = {"name": v.name, "valueReference": str(reference), "description": v.description, "causality": v.causality}
    out["variability"] = v.variability
    initial = _initial(v)
    if initial is not None:
        out["initial"] = initial
    return out


def _typed(v: Variable, derivative: str | None) -> dict[str, str]:
    out: dict[str, str] = {}
    if v.unit:
        out["unit"] = v.unit
    if v.lo is not None:
        out["min"] = _text(int(v.lo) if v.kind == "Integer" else v.lo)
    if v.hi is not None:
        out["max"] = _text(int(v.hi) if v.kind == "Integer" else v.hi)
    if derivative is not None:
        out["derivative"] = derivative
    if v.start is not None:
        out["start"] = _text(v.start if v.kind == "Boolean" else int(v.start) if v.kind == "Integer" else float(v.start))
    return out


def _unknowns(variables: Variables) -> tuple[list[int], list[int], list[int]]:
    """Value references of outputs, state derivatives and initial unknowns."""
    everything = list(variables)
    outputs = [k for k, v in enumerate(everything) if v.causality == "output"]
    derivatives = [k for k, v in enumerate(everything) if v.derivative]
    states = [variables.reference(everything[k].derivative) for k in derivatives]
    return outputs, derivatives, sorted({*outputs, *derivatives, *states})


def _fmi2(root: ET.Element, variables: Variables) -> None:
    box = ET.SubElement(root, "ModelVariables")
    for k, v in enumerate(variables):
        scalar = ET.SubElement(box, "ScalarVariable", _attributes(v, k))
        of = str(variables.reference(v.derivative) + 1) if v.derivative else None
        ET.SubElement(scalar, v.kind, _typed(v, of))
    structure = ET.SubElement(root, "ModelStructure")
    for tag, references in zip(("Outputs", "Derivatives", "InitialUnknowns"), _unknowns(variables), strict=True):
        group = ET.SubElement(structure, tag)
        for k in references:
            ET.SubElement(group, "Unknown", index=str(k + 1))


def _fmi3(root: ET.Element, variables: Variables) -> None:
    box = ET.SubElement(root, "ModelVariables")
    types = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}
    for k, v in enumerate(variables):
        of = str(variables.reference(v.derivative)) if v.derivative else None
        ET.SubElement(box, types[v.kind], {**_attributes(v, k), **_typed(v, of)})
    count = len(variables.all)
    arrays = dict(enumerate(variables.arrays, count))
    for k, a in arrays.items():
        array = ET.SubElement(box, "Float64", _array_attributes(a, k))
        ET.SubElement(array, "Dimension", start=str(len(a.starts)))
    for k, (name, what) in enumerate(CLOCKS.items() if variables.clocks else (), count + len(arrays)):
        clock = {"name": name, "valueReference": str(k), "description": what, "causality": "input", "variability": "discrete"}
        ET.SubElement(box, "Clock", {**clock, "intervalVariability": "triggered"})
    structure = ET.SubElement(root, "ModelStructure")
    tags = ("Output", "ContinuousStateDerivative", "InitialUnknown")
    outputs, derivatives, initial = _unknowns(variables)
    given = [k for k, a in arrays.items() if a.like.causality == "output"]
    for tag, references in zip(tags, ([*outputs, *given], derivatives, [*initial, *given]), strict=True):
        for k in references:
            ET.SubElement(structure, tag, valueReference=str(k))
    for k, v in enumerate(variables):
        if v.group == "INDICATOR":
            ET.SubElement(structure, "EventIndicator", valueReference=str(k))


def _array_attributes(a: JointArray, reference: int) -> dict[str, str]:
    """As the scalars', with all of their starts."""
    starts = [x for x in a.starts if x is not None]
    out = {**_attributes(replace(a.like, name=a.name), reference), **_typed(replace(a.like, start=None), None)}
    return out | ({"start": " ".join(map(_text, starts))} if starts else {})


def build_description(identifier: str, source_files: Iterable[str]) -> str:
    """FMI 3.0 buildDescription.xml, for whoever compiles the sources again."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    # no contraction to fused multiply-add: every compiler rounds alike; options are somebody's, says FMI-VDM (validCompilerOptions)
    sources = ET.SubElement(build, "SourceFileSet", language="C11", compiler="gcc", compilerOptions="-std=c11 -ffp-contract=off")
    for name in source_files:
        ET.SubElement(sources, "SourceFile", name=name)
    ET.SubElement(build, "Library", name="m", external="true")
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
