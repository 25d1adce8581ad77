"""The units in the reference simulator of the Modelica Association, which nobody here wrote against.

Its source is public (the folder ``fmusim`` of modelica/Reference-FMUs up to 2026); built, it is named by the variable STOPSET_FMUSIM
or found on the path. docs/fmu.md says how it is built. It prints numbers with 16 digits: all of them are compared.
"""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import Model
from stopset.fmu import Contents, export
from stopset.fmu.build import native
from stopset.fmu.check import Instance
from test_fmu import EFFECTS, names
from test_fmu_fuzz import MODELS
from test_fmu_stops import braked, braking

FMUSIM = os.environ.get("STOPSET_FMUSIM") or shutil.which("fmusim")
pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = [
    pytest.mark.skipif(native() is None, reason="no FMU binaries for this platform"),
    pytest.mark.skipif(FMUSIM is None, reason="fmusim is not here; build it as docs/fmu.md says and set STOPSET_FMUSIM"),
]
STEP, STEPS, ASKED = 1.0 / 128.0, 100, 60  # a step without rounding; the row of the stop request


@dataclass(frozen=True)
class Drive:
    """Torques that change every ten rows, ``size`` (n,) [N m] the steps between them, and a stop asked for at a row."""

    request: int
    size: np.ndarray

    @property
    def torques(self) -> np.ndarray:
        """(STEPS + 1, n) [N m]."""
        return self.size * ((np.arange(STEPS + 1)[:, None] // 10) % 5 - 2)

    @property
    def stop(self) -> np.ndarray:
        """(STEPS + 1,)"""
        return np.where(np.arange(STEPS + 1) >= ASKED, self.request, 0)


@dataclass(frozen=True)
class Case:
    make: Callable[[], Model]
    request: int

    def made(self) -> tuple[Model, Drive]:
        model = self.make()
        return model, Drive(self.request, 3.0 * (np.arange(model.n) + 1.0))


CASES = {
    "linear": Case(braking, 2),
    "effects": Case(lambda: braked(8.0, 3, effort="motor_torque", effects=EFFECTS, offset=True), 1),
    "cubic": Case(lambda: braked(8.0, 2, cubic=0.2), 1),
    "model 3": Case(MODELS["model 3"], 1),
    "from outside": Case(MODELS["from outside"], 2),  # no STOP 0 is bounded with it
}


def by_fmusim(
    fmu: Path, model: Model, drive: Drive, watched: list[str], *options: str, jumps: bool = False
) -> list[dict[str, str]]:
    """Its rows as it prints them; ``jumps``: inputs end in one row and begin in the next, which makes an event, else it draws lines
    between them in model exchange."""
    given, got = fmu.with_suffix(".in.csv"), fmu.with_suffix(".out.csv")
    with given.open("w", newline="") as f:
        out = csv.writer(f)
        out.writerow(["time", *names(model, "tau"), "stop"])
        before: list[str] = []
        for k, (tau, stop) in enumerate(zip(drive.torques.tolist(), drive.stop.tolist(), strict=True)):
            now = [*map(repr, tau), repr(stop)]
            if jumps and before:
                out.writerow([repr(k * STEP), *before])
            out.writerow([repr(k * STEP), *now])
            before = now
    wanted = [x for name in watched for x in ("--output-variable", name)]
    times = ["--stop-time", repr(STEPS * STEP), "--output-interval", repr(STEP)]
    files = ["--input-file", str(given), "--output-file", str(got)]
    done = subprocess.run(
        [str(FMUSIM), *options, *times, *files, *wanted, str(fmu)], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    with got.open() as f:
        return list(csv.DictReader(f))


def digits_apart(fmu: Path, model: Model, drive: Drive, numbers: list[str]) -> tuple[int, float]:
    """At how many rows fmusim prints another digit than fmpy, and the smallest range of an angle [rad]; co-simulation."""
    import fmpy

    rows = by_fmusim(fmu, model, drive, numbers, "--interface-type", "cs")
    assert len(rows) == STEPS + 1
    with tempfile.TemporaryDirectory() as folder:
        described = fmpy.read_model_description(str(fmu))
        fmpy.extract(str(fmu), folder)
        u = Instance(described, folder)
        u.slave.exitInitializationMode()
        other = 0
        for k in range(STEPS):
            for n, x in zip(names(model, "tau"), drive.torques[k], strict=True):
                u.set(n, x)
            u.set("stop", drive.stop[k])
            u.step(k * STEP, STEP)
            other += [f"{float(rows[k + 1][n]):.16g}" for n in numbers] != [f"{x:.16g}" for x in u.get(numbers)]
        u.slave.freeInstance()
    return other, float(np.ptp([[float(r[n]) for n in names(model, "q")] for r in rows], axis=0).min())


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", CASES)
def test_fmusim_prints_every_digit_of_fmpy(tmp_path: Path, name: str, fmi: int, own_effect: object) -> None:
    """Motion, bounds, flags and stop bounds, before and after the request, FMI 2 and 3."""
    model, drive = CASES[name].made()
    fmu = export(model, tmp_path / "F.fmu", Contents(fmi, (str(native()),), reference=False))
    numbers = [*names(model, "q", "dq", "q_lo", "dq_hi", "stop_time", "stop_angle"), "tcp_stop_distance"]
    other, moved = digits_apart(fmu, model, drive, numbers)
    assert other == 0
    assert moved > 1e-3, "an arm that stands still shows nothing"
