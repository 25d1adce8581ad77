"""Does the unit say on this machine what the Python model said where it was exported? Its own reference results tell."""

from __future__ import annotations

import csv
import hashlib
import io
import tempfile
import time
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stopset.errors import OutputError
from stopset.fmu.build import native
from stopset.types import Array
from stopset.unpacked import TooLargeError, check_zip

AGREE = 1e-9  # [rad, rad/s] nominal motion and bounds
SUMS = "documentation/SHA256SUMS"  # of every file of a unit as it was exported
STEMS = {"q": "rad", "dq": "rad/s", "q_lo": "rad", "q_hi": "rad", "dq_lo": "rad/s", "dq_hi": "rad/s"}


@dataclass(frozen=True, slots=True)
class FmuCheck:
    """``problems``: of fmpy's validator, and files that are not as exported; ``rows``: compared, 0 where nothing was run.

    ``differences``: largest of motion and bounds by quantity [rad, rad/s].

    ``stops``: states whose stop bounds were compared, ``equal``: those with every bit the same; ``step``: CPU time of a step [s].
    """

    fmi: str
    platform: str
    problems: tuple[str, ...]
    rows: int
    differences: dict[str, float]
    stops: int
    equal: int
    step: float

    @property
    def good(self) -> bool:
        """Whether nothing differs and nothing is wrong."""
        return (
            self.rows > 0
            and not self.problems
            and self.equal == self.stops
            and all(x <= AGREE for x in self.differences.values())
        )


def check_fmu(path: str | Path, *, trusted: bool = True) -> FmuCheck:
    """Run a unit of `stopset.fmu.export` against the reference results inside it.

    Nothing of it is run where a library is not that of the export (a damaged one may end the process), nor unless ``trusted``.
    Raises `OutputError` for a file that is no such unit, holds none, or has no library for this machine.
    """
    from fmpy import extract, platform_tuple  # heavy
    from fmpy.fmi1 import FMICallException
    from fmpy.validation import validate_fmu

    here = native()
    description, names, changed, tables = _read(path)
    if not tables["in"] or not tables["ref"]:
        raise OutputError(f"{path} holds no reference results; expected a unit of stopset export-fmu: export it with them")
    if here is None or not _runs_here(names):
        raise OutputError(
            f"{path} has no library for this machine ({here or platform_tuple}); expected one: export it with --platform, or build "
            "its sources into it"
        )
    problems = (*changed.values(), *(str(p) for p in validate_fmu(str(path))))
    nothing = FmuCheck(description.fmiVersion, here, problems, 0, {}, 0, 0, 0.0)
    if not trusted or any(n.split("/")[0] == "binaries" for n in changed):
        return nothing
    try:
        with tempfile.TemporaryDirectory(prefix="stopset-fmu-") as folder:
            extract(str(path), folder)
            rows, differences, step = _run(description, folder, tables["in"], tables["ref"])
            stops, equal = _stops(description, folder, tables["stops"]) if tables["stops"] else (0, 0)
    except (
        FMICallException,
        LookupError,
        ValueError,
        AttributeError,
        ArithmeticError,
        OSError,
    ) as e:  # by another description, other tables
        ended = f"its run ended: {_line(e)}; expected one to the last row of its reference results: export the unit again"
        return replace(nothing, problems=(*problems, ended))
    return FmuCheck(description.fmiVersion, here, problems, rows, differences, stops, equal, step)


def _read(path: str | Path) -> tuple[Any, list[str], dict[str, str], dict[str, dict[str, Array]]]:
    """Description, names of files, what is wrong with which of them, tables by their ends."""
    import fmpy  # heavy

    try:
        check_zip(Path(path))
        description = fmpy.read_model_description(str(path), validate=False)
        with zipfile.ZipFile(path) as z:
            names = z.namelist()
            changed = _changed(z, names)
            tables = {end: _table(z, names, f"_{end}.csv") for end in ("in", "ref", "stops")}
    except TooLargeError as e:
        raise OutputError(f"{path} {e}") from e
    except OSError as e:
        raise OutputError(f"{path}: {e.strerror or e}; expected an FMU that can be read: name another file") from e
    except Exception as e:
        raise OutputError(f"{path} cannot be read ({_line(e)}); expected an FMU of stopset export-fmu: export it again") from e
    if description.coSimulation is None:
        raise OutputError(f"{path} offers no co-simulation; expected an FMU of stopset export-fmu: export it again")
    return description, names, changed, tables


def _line(e: Exception) -> str:
    return f"{type(e).__name__} {' '.join(str(e).split())}"[:200]


def _runs_here(names: list[str]) -> bool:
    import fmpy

    folders = {fmpy.platform, fmpy.platform_tuple}
    return any(n.split("/")[0] == "binaries" and n.split("/")[1] in folders for n in names if n.count("/") > 1)


def _changed(z: zipfile.ZipFile, names: list[str]) -> dict[str, str]:
    """A sentence each of files that are missing or others than at the export; libraries that were built from the sources since may be more."""
    if SUMS not in names:
        return {
            SUMS: f"{SUMS} is missing, so nothing says what the files were; expected that of the export: export the unit again"
        }
    out = {}
    for line in z.read(SUMS).decode().splitlines():
        wanted, name = line.split("  ", 1)
        if name not in names:
            out[name] = f"{name} is missing; expected the file of the export: export the unit again"
        elif hashlib.sha256(z.read(name)).hexdigest() != wanted:
            out[name] = f"{name} is not the file of the export; expected SHA-256 {wanted[:12]}...: export the unit again"
    return out


def _table(z: zipfile.ZipFile, names: list[str], end: str) -> dict[str, Array]:
    found = [n for n in names if n.startswith("documentation/") and n.endswith(end)]
    if not found:
        return {}
    try:
        head, *rows = csv.reader(io.StringIO(z.read(found[0]).decode()))
        return dict(zip(head, np.array(rows, float).T, strict=True))
    except ValueError as e:
        raise ValueError(f"{found[0]} is no table of numbers") from e


class Instance:
    """A co-simulation instance, FMI 2 or 3, by names."""

    def __init__(self, description: Any, folder: str) -> None:
        from fmpy import fmi2, fmi3

        self.two = description.fmiVersion.startswith("2")
        self.variables = {v.name: v for v in description.modelVariables}
        kind: Any = fmi2.FMU2Slave if self.two else fmi3.FMU3Slave
        self.slave = kind(
            guid=description.guid, unzipDirectory=folder, modelIdentifier=description.coSimulation.modelIdentifier, instanceName="check"
        )  # fmt: skip
        self.slave.instantiate()
        if self.two:
            self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()

    def set(self, name: str, value: float) -> None:
        v = self.variables[name]
        call = {
            "Real": "setReal", "Integer": "setInteger", "Boolean": "setBoolean", "Float64": "setFloat64", "Int32": "setInt32",
        }[v.type]  # fmt: skip
        getattr(self.slave, call)([v.valueReference], [float(value) if v.type in ("Real", "Float64") else int(value)])

    def get(self, names: list[str]) -> Array:
        of = self.slave.getReal if self.two else self.slave.getFloat64
        return np.array(of([self.variables[n].valueReference for n in names]))

    def step(self, t: float, h: float) -> None:
        self.slave.doStep(t, h)


def _run(description: Any, folder: str, given: dict[str, Array], wanted: dict[str, Array]) -> tuple[int, dict[str, float], float]:
    """Rows compared, largest difference by quantity, CPU time of a step."""
    u, t = Instance(description, folder), wanted["time"]
    names = [n for n in wanted if n != "time"]
    worst, took = np.zeros(len(names)), 0.0
    inputs = [n for n in given if n != "time"]

    def connect(row: int) -> None:
        for n in inputs:
            u.set(n, given[n][row])

    connect(0)
    u.slave.exitInitializationMode()
    for k in range(len(t)):
        worst = np.maximum(worst, np.abs(u.get(names) - [wanted[n][k] for n in names]))
        if k + 1 < len(t):
            connect(k)
            begin = time.process_time()
            u.step(t[k], t[k + 1] - t[k])
            took += time.process_time() - begin
    u.slave.terminate()
    u.slave.freeInstance()
    worst = np.where(np.isnan(worst), np.inf, worst)
    out: dict[str, float] = {}
    for name, x in zip(names, worst, strict=True):
        stem = max((s for s in STEMS if name.startswith(f"{s}_")), key=len)
        out[stem] = max(out.get(stem, 0.0), float(x))
    return len(t), out, took / max(len(t) - 1, 1)


def _stops(description: Any, folder: str, table: dict[str, Array]) -> tuple[int, int]:
    """States, and those whose bounds have the same bits."""
    u = Instance(description, folder)
    u.slave.exitInitializationMode()
    u.set("measured", 1)
    states = [n for n in table if n.startswith(("q_measured_", "dq_measured_"))]
    names = [n for n in table if n not in states]
    rows = len(table[states[0]])
    equal = 0
    for k in range(rows):
        for n in states:
            u.set(n, table[n][k])
        equal += np.array_equal(u.get(names), [table[n][k] for n in names], equal_nan=True)
    u.slave.freeInstance()
    return rows, equal
