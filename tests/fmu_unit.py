"""One co-simulation instance of an exported FMU, by names, as an importer holds it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from stopset.types import Array


class Unit:
    """FMI 3 by fmpy; begins in initialization mode. ``options``: of its instantiation."""

    def __init__(self, fmu: Path, folder: str, **options: Any) -> None:
        import fmpy
        from fmpy.fmi3 import FMU3Slave

        description = fmpy.read_model_description(str(fmu))
        self.variables = {v.name: v for v in description.modelVariables}
        fmpy.extract(str(fmu), folder)
        self.slave = FMU3Slave(
            guid=description.guid, unzipDirectory=folder, modelIdentifier=description.coSimulation.modelIdentifier, instanceName="a"
        )  # fmt: skip
        self.slave.instantiate(**options)
        self.slave.enterInitializationMode()
        self.t = 0.0

    def set(self, values: Mapping[str, Any]) -> None:
        for name, x in values.items():
            v = self.variables[name]
            of = {"Float64": self.slave.setFloat64, "Int32": self.slave.setInt32, "Boolean": self.slave.setBoolean}[v.type]
            of([v.valueReference], [x])

    def begin(self) -> None:
        self.slave.exitInitializationMode()

    def state(self, model: Any, q: Array, dq: Array) -> None:
        """A measured state."""
        self.set({f"q_measured_{j}": x for j, x in zip(model.joints, q.tolist(), strict=True)})
        self.set({f"dq_measured_{j}": x for j, x in zip(model.joints, dq.tolist(), strict=True)})
        self.set({"measured": True})

    def get(self, name: str) -> float:
        v = self.variables[name]
        of = {"Float64": self.slave.getFloat64, "Int32": self.slave.getInt32, "Boolean": self.slave.getBoolean}[v.type]
        return float(of([v.valueReference])[0])

    def joints(self, stem: str, joints: Sequence[str]) -> Array:
        return np.array(self.slave.getFloat64([self.variables[f"{stem}_{j}"].valueReference for j in joints]))

    def step(self, h: float) -> None:
        self.slave.doStep(self.t, h)
        self.t += h

    def array(self, name: str, size: int) -> Array:
        return np.array(self.slave.getFloat64([self.variables[name].valueReference], size))

    def tick(self, clock: str) -> None:
        """In event mode, and on into step mode."""
        self.slave.enterEventMode()
        self.slave.setClock([self.variables[clock].valueReference], [True])
        self.slave.updateDiscreteStates()
        self.slave.enterStepMode()


@contextmanager
def unit(fmu: Path, **options: Any) -> Iterator[Unit]:
    with tempfile.TemporaryDirectory() as folder:
        it = Unit(fmu, folder, **options)
        yield it
        it.slave.freeInstance()
