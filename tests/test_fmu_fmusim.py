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
from dataclasses import dataclass, replace
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


def called(fmu: Path, inputs: list[list[str]], watched: list[str], *options: str) -> list[dict[str, str]]:
    """Its rows as it prints them, of the inputs in rows below their names."""
    given, got = fmu.with_suffix(".in.csv"), fmu.with_suffix(".out.csv")
    with given.open("w", newline="") as f:
        csv.writer(f).writerows(inputs)
    wanted = [x for name in watched for x in ("--output-variable", name)]
    times = ["--stop-time", repr(STEPS * STEP), "--output-interval", repr(STEP)]
    files = ["--input-file", str(given), "--output-file", str(got)]
    done = subprocess.run(
        [str(FMUSIM), *options, *times, *files, *wanted, str(fmu)], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    with got.open() as f:
        return list(csv.DictReader(f))


def by_fmusim(
    fmu: Path, model: Model, drive: Drive, watched: list[str], *options: str, jumps: bool = False
) -> list[dict[str, str]]:
    """Its rows; ``jumps``: inputs end in one row and begin in the next, which makes an event, else it draws lines between them in
    model exchange."""
    inputs, before = [["time", *names(model, "tau"), "stop"]], list[str]()
    for k, (tau, stop) in enumerate(zip(drive.torques.tolist(), drive.stop.tolist(), strict=True)):
        now = [*map(repr, tau), repr(stop)]
        if jumps and before:
            inputs.append([repr(k * STEP), *before])
        inputs.append([repr(k * STEP), *now])
        before = now
    return called(fmu, inputs, watched, *options)


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


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> tuple[Model, Drive, Path]:
    """What FMI 3 has more, of a unit that integrates."""
    model, drive = CASES["effects"].made()
    return model, drive, export(model, tmp_path_factory.mktemp("three") / "F.fmu", Contents(3, (str(native()),), reference=False))


def test_fmusim_sets_and_reads_arrays(three: tuple[Model, Drive, Path]) -> None:
    model, drive, fmu = three
    rows = [[repr(k * STEP), " ".join(map(repr, tau))] for k, tau in enumerate(drive.torques.tolist())]
    arrays = called(fmu, [["time", "tau"], *rows], ["q", "q_lo"], "--interface-type", "cs")
    scalars = by_fmusim(fmu, model, replace(drive, request=0), names(model, "q", "q_lo"), "--interface-type", "cs")
    for stem in ("q", "q_lo"):
        assert [r[stem].split() for r in arrays] == [[r[n] for n in names(model, stem)] for r in scalars]
    assert len({r["q"] for r in arrays}) == STEPS + 1


def test_fmusim_reads_within_a_step(three: tuple[Model, Drive, Path]) -> None:
    """At the steps of the integrator too, and at the ends of steps what it reads without."""
    model, drive, fmu = three
    plain, many = (
        by_fmusim(fmu, model, drive, names(model, "q"), "--interface-type", "cs", *option) for option in ((), ("--record-intermediate-values",))
    )  # fmt: skip
    assert len(many) > len(plain) + STEPS // 2
    assert [float(r["time"]) for r in many] == sorted(float(r["time"]) for r in many)
    ends = {r["time"]: r for r in many}
    assert all(ends[r["time"]] == r for r in plain)


@pytest.mark.parametrize("mode", [(), ("--event-mode-used",)])
def test_fmusim_takes_a_step_that_ends_at_rest(three: tuple[Model, Drive, Path], mode: tuple[str, ...]) -> None:
    model, drive, fmu = three
    plain = by_fmusim(fmu, model, drive, names(model, "q", "dq"), "--interface-type", "cs")
    early = by_fmusim(fmu, model, drive, names(model, "q", "dq"), "--interface-type", "cs", "--early-return-allowed", *mode)
    more = [r for r in early if r["time"] not in {x["time"] for x in plain}]
    assert len(more) == 1 and all(float(more[0][n]) == 0.0 for n in names(model, "dq")), "where the last joint comes to rest"
    assert ASKED * STEP < float(more[0]["time"]) < STEPS * STEP
    for n in names(model, "q"):
        assert abs(float(early[-1][n]) - float(plain[-1][n])) < 1e-9
