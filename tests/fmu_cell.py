"""A cell as an SSP: controller, arm, light curtain with a person, and stop logic; the logic asks for a STOP 0 as late as it dares."""

from __future__ import annotations

import ctypes
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fmu_models import arm_model
from stopset.artifact import Brakes, Model
from stopset.fmu import PLATFORMS, Contents, build, export
from stopset.fmu.build import native
from stopset.fmu.sources import fmi_headers
from stopset.offline.description import robot_from_text
from stopset.sets import Box
from stopset.types import Array

LINKS = (0.7, 0.6)  # [m] of a horizontal arm of two joints
INERTIA, DAMPING, SPEED, CYCLE = 12.0, 1.0, 1.3, 0.01  # [kg m^2], [N m s/rad], [rad/s], [s]
TORQUE = (36.0, 44.0)  # [N m] of the brakes
PERSON, BODY, BREAKS = (
    1.7,
    0.25,
    0.2,
)  # [rad] where she stops, beside the tool's circle; [m] half her width; [s] when she breaks the beam
WALK = 0.8  # [m] from the curtain to where she stops
REACH = sum(LINKS)
EDGE = PERSON - BODY / REACH  # [rad] at which the tool touches her
DECELERATION = 0.5 * sum(TORQUE) / INERTIA  # [rad/s^2] of a text book's v^2/2a


def horizontal_arm() -> Model:
    """Made up; brakes that close after 60 to 100 ms and hold 10 % about their mean."""
    links = "".join(
        f"<link name='l{k}'><inertial><origin xyz='{x / 2} 0 0'/><mass value='2'/>"
        f"<inertia ixx='0.01' iyy='0.02' izz='0.02' ixy='0' ixz='0' iyz='0'/></inertial></link>"
        f"<joint name='axis_{k}' type='revolute'><parent link='{'base' if k == 1 else 'l1'}'/><child link='l{k}'/>"
        f"<origin xyz='{0.0 if k == 1 else LINKS[0]} 0 0.3'/><axis xyz='0 0 1'/>"
        f"<limit lower='-3' upper='3' velocity='1.5' effort='300'/></joint>"
        for k, x in enumerate(LINKS, start=1)
    )
    tool = f"<link name='flange'/><joint name='tip' type='fixed'><parent link='l2'/><child link='flange'/><origin xyz='{LINKS[1]} 0 0'/></joint>"
    base = arm_model(2)
    robot = robot_from_text(f"<robot name='cell arm'><link name='base'/>{links}{tool}</robot>")
    two = np.ones(2)
    a = replace(base.abstraction, Minv=np.diag(1.0 / (INERTIA * two)), viscous=DAMPING * two[:, None])
    brakes = Brakes(
        torque=Box.of(TORQUE[0] * two, TORQUE[1] * two),
        delay=Box.of(0.06 * two, 0.10 * two),
        rise=Box.of(0.005 * two, 0.02 * two),
    )
    return replace(base, robot=robot, rotor=np.full(2, INERTIA - 3.0), abstraction=a, brakes=brakes)


@dataclass(frozen=True, slots=True)
class Part:
    """A unit of fmu_cell.c: ``values`` are (name, causality); ``numbers`` its constants."""

    name: str
    values: tuple[tuple[str, str], ...]
    numbers: dict[str, float]


def parts(textbook: bool) -> tuple[Part, ...]:
    q, dq = ("q", "input"), ("dq", "input")
    logic = (q, dq, ("forward", "input"), ("broken", "input"), ("stop", "output"), ("ahead", "output"))
    numbers = {"TEXTBOOK": int(textbook), "DECELERATION": DECELERATION, "CYCLE": CYCLE, "EDGE": EDGE}
    return (
        Part("controller", (q, dq, ("tau", "output")), {"SPEED": SPEED, "DAMPING": DAMPING}),
        Part("curtain", (("broken", "output"), ("walked", "output")), {"BREAKS": BREAKS}),
        Part("logic", logic, numbers),
    )


ARM = (
    ("tau_axis_1", "input", "Real"), ("stop", "input", "Integer"), ("q_axis_1", "output", "Real"), ("dq_axis_1", "output", "Real"),
    ("stop_forward_axis_1", "output", "Real"), ("covered", "output", "Boolean"),
)  # fmt: skip
WIRES = (
    ("arm.q_axis_1", "controller.q"), ("arm.dq_axis_1", "controller.dq"), ("controller.tau", "arm.tau_axis_1"), ("arm.q_axis_1", "logic.q"),
    ("arm.dq_axis_1", "logic.dq"), ("arm.stop_forward_axis_1", "logic.forward"), ("curtain.broken", "logic.broken"), ("logic.stop", "arm.stop"),
)  # fmt: skip


def _kind(name: str) -> str:
    return "Integer" if name == "stop" else "Real"


def _unit(part: Part, folder: Path) -> Path:
    """Compiled for this machine."""
    platform = PLATFORMS[str(native())]
    library, source = folder / f"{part.name}{platform.suffix}", Path(__file__).with_name("fmu_cell.c")
    flags = [
        "-shared",
        "-fPIC",
        "-O1",
        "-I",
        str(fmi_headers()),
        f"-D{part.name.upper()}",
        *(f"-D{k}={v!r}" for k, v in part.numbers.items()),
    ]
    subprocess.run([*build.compiler(), "cc", *flags, str(source), "-lm", "-o", str(library)], check=True)
    rows = []
    for k, (name, causality) in enumerate(part.values):
        start = ' start="0"' if causality == "input" else ""
        rows.append(
            f'<ScalarVariable name="{name}" valueReference="{k}" causality="{causality}" '
            f'variability="{"discrete" if _kind(name) == "Integer" else "continuous"}"><{_kind(name)}{start}/></ScalarVariable>'
        )
    out = "".join(f'<Unknown index="{k + 1}"/>' for k, v in enumerate(part.values) if v[1] == "output")
    xml = (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="{part.name}" guid="{{{part.name}}}">'
        f'<CoSimulation modelIdentifier="{part.name}" canHandleVariableCommunicationStepSize="true"/><ModelVariables>{"".join(rows)}'
        f"</ModelVariables><ModelStructure><Outputs>{out}</Outputs><InitialUnknowns>{out}</InitialUnknowns></ModelStructure>"
        "</fmiModelDescription>"
    )
    target = folder / f"{part.name}.fmu"
    with zipfile.ZipFile(target, "w") as z:
        z.writestr("modelDescription.xml", xml)
        z.write(library, f"binaries/{platform.fmi2}/{library.name}")
    return target


def _component(name: str, values: list[tuple[str, str, str]]) -> str:
    connectors = "".join(f'<ssd:Connector name="{n}" kind="{c}"><ssc:{t}/></ssd:Connector>' for n, c, t in values)
    return (
        f'<ssd:Component name="{name}" type="application/x-fmu-sharedlibrary" source="resources/{name}.fmu">'
        f"<ssd:Connectors>{connectors}</ssd:Connectors></ssd:Component>"
    )


def cell(folder: Path, textbook: bool) -> Path:
    """The SSP; ``textbook``: the logic has v^2/2a in place of the arm's own bound."""
    model, made = horizontal_arm(), parts(textbook)
    arm = export(model, folder / "arm.fmu", Contents(2, (str(native()),)))
    units = {p.name: _unit(p, folder) for p in made} | {"arm": arm}
    elements = [_component(p.name, [(n, c, _kind(n)) for n, c in p.values]) for p in made] + [_component("arm", list(ARM))]
    wires = "".join(
        '<ssd:Connection startElement="{}" startConnector="{}" endElement="{}" endConnector="{}"/>'.format(
            *a.split("."), *b.split(".")
        )
        for a, b in WIRES
    )
    ssd = (
        '<?xml version="1.0" encoding="UTF-8"?><ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription" '
        'xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0" name="cell"><ssd:System name="cell"><ssd:Elements>'
        f"{''.join(elements)}</ssd:Elements><ssd:Connections>{wires}</ssd:Connections></ssd:System></ssd:SystemStructureDescription>"
    )
    target = folder / f"cell{int(textbook)}.ssp"
    with zipfile.ZipFile(target, "w") as z:
        z.writestr("SystemStructure.ssd", ssd)
        for name, path in units.items():
            z.write(path, f"resources/{name}.fmu")
    return target


@dataclass(frozen=True, slots=True)
class Run:
    """``t`` (N,) [s], the arm's angle ``q``, where the logic thinks it can come ``ahead`` (N,) [rad], ``stop`` (N,), ``walked`` (N,) [m]."""

    t: Array
    q: Array
    dq: Array
    ahead: Array
    stop: Array
    walked: Array

    @property
    def gap(self) -> Array:
        """(N,) [m] along the tool's circle to where she stops."""
        return REACH * (EDGE - self.q)


OUTPUTS = (
    ("arm", "q_axis_1"),
    ("arm", "dq_axis_1"),
    ("logic", "ahead"),
    ("logic", "stop"),
    ("curtain", "walked"),
)  # of a Run, in its order
END = 2.5  # [s]


def by_fmpy(ssp: Path) -> Run:
    """Its simulation of SSPs."""
    from fmpy.ssp.simulation import simulate_ssp

    out = simulate_ssp(str(ssp), stop_time=END, step_size=CYCLE)
    return Run(*(np.asarray(out[n], float) for n in ("time", *(".".join(x) for x in OUTPUTS))))


def by_ecos(ssp: Path) -> Run:
    """Ecos; its library needs tbb, which its package does not load."""
    ctypes.CDLL(str(next(Path(sys.prefix).glob("lib/libtbb.so.12"))), mode=ctypes.RTLD_GLOBAL)
    from ecospy import EcosSimulation

    rows = []
    with EcosSimulation(step_size=CYCLE, ssp_path=str(ssp)) as s:
        s.init()
        for k in range(round(END / CYCLE)):
            s.step()
            read = [s.get_integer if name == "stop" else s.get_real for _, name in OUTPUTS]
            rows.append([CYCLE * (k + 1), *(get(f"{part}::{name}") for get, (part, name) in zip(read, OUTPUTS, strict=True))])
    return Run(*np.array(rows, float).T)


def by_libcosim(ssp: Path) -> Run:
    """libcosim, which takes the unpacked description and names variables by their numbers."""
    from fmpy import read_model_description
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.FATAL)
    folder = ssp.with_suffix("")
    with zipfile.ZipFile(ssp) as z:
        z.extractall(folder)
    execution = CosimExecution.from_ssp_file(str(folder / "SystemStructure.ssd"), round(1e9 * CYCLE))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    parts = {part for part, _ in OUTPUTS}
    number = {
        (part, v.name): v.valueReference
        for part in parts
        for v in read_model_description(str(folder / "resources" / f"{part}.fmu")).modelVariables
    }
    index = {part: execution.slave_index_from_instance_name(part) for part in parts}
    rows = []
    for k in range(round(END / CYCLE)):
        execution.step()
        read = [observer.last_integer_values if name == "stop" else observer.last_real_values for _, name in OUTPUTS]
        rows.append([CYCLE * (k + 1), *(get(index[x[0]], [number[x]])[0] for get, x in zip(read, OUTPUTS, strict=True))])
    return Run(*np.array(rows, float).T)


IMPORTERS: dict[str, Callable[[Path], Run]] = {"fmpy": by_fmpy, "Ecos": by_ecos, "libcosim": by_libcosim}
