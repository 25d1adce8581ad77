"""The units in the reference simulator of the Modelica Association, which nobody here wrote against.

Its source is public (the folder ``fmusim`` of modelica/Reference-FMUs up to 2026); built, it is named by the variable STOPSET_FMUSIM
or found on the path. docs/fmu.md says how it is built. It prints numbers with 16 digits: all of them are compared.
"""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import Model
from stopset.fmu import Contents, export
from stopset.fmu.build import native
from stopset.fmu.check import Instance
from test_fmu import EFFECTS, names
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
class Case:
    model: Model
    request: int


CASES = {
    "linear": Case(braking(), 2),
    "effects": Case(braked(8.0, 3, effort="motor_torque", effects=EFFECTS, offset=True), 1),
    "cubic": Case(braked(8.0, 2, cubic=0.2), 1),
}


def torques(n: int) -> np.ndarray:
    """(STEPS + 1, n) [N m] steps of torque, then a stop."""
    k = np.arange(STEPS + 1)[:, None]
    return 3.0 * (np.arange(n) + 1.0) * ((k // 10) % 5 - 2)


def asked_rows(n: int, request: int) -> list[tuple[float, list[float], int]]:
    """Time [s], torques [N m] and stop request from then on."""
    return [(k * STEP, row, request if k >= ASKED else 0) for k, row in enumerate(torques(n).tolist())]


def by_fmusim(
    fmu: Path, model: Model, request: int, watched: list[str], *options: str, jumps: bool = False
) -> list[dict[str, str]]:
    """Its rows as it prints them; ``jumps``: inputs end in one row and begin in the next, which makes an event, else it draws lines
    between them in model exchange."""
    given, got = fmu.with_suffix(".in.csv"), fmu.with_suffix(".out.csv")
    with given.open("w", newline="") as f:
        out = csv.writer(f)
        out.writerow(["time", *names(model, "tau"), "stop"])
        before: tuple[list[float], int] | None = None
        for t, tau, stop in asked_rows(model.n, request):
            if jumps and before is not None:
                out.writerow([repr(t), *map(repr, before[0]), before[1]])
            out.writerow([repr(t), *map(repr, tau), stop])
            before = tau, stop
    wanted = [x for name in watched for x in ("--output-variable", name)]
    times = ["--stop-time", repr(STEPS * STEP), "--output-interval", repr(STEP)]
    files = ["--input-file", str(given), "--output-file", str(got)]
    done = subprocess.run(
        [str(FMUSIM), *options, *times, *files, *wanted, str(fmu)], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    with got.open() as f:
        return list(csv.DictReader(f))


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", CASES)
def test_fmusim_prints_every_digit_of_fmpy(tmp_path: Path, name: str, fmi: int) -> None:
    """Motion, bounds, flags and stop bounds, before and after the request, FMI 2 and 3."""
    import fmpy

    model, request = CASES[name].model, CASES[name].request
    fmu = export(model, tmp_path / "F.fmu", Contents(fmi, (str(native()),), reference=False))
    numbers = [*names(model, "q", "dq", "q_lo", "dq_hi", "stop_time", "stop_angle"), "tcp_stop_distance"]
    rows = by_fmusim(fmu, model, request, numbers, "--interface-type", "cs")
    described, folder = fmpy.read_model_description(str(fmu)), tmp_path / "unpacked"
    fmpy.extract(str(fmu), str(folder))
    u, tau = Instance(described, str(folder)), torques(model.n)
    u.slave.exitInitializationMode()
    printed = []
    for k in range(STEPS):
        for n, x in zip(names(model, "tau"), tau[k], strict=True):
            u.set(n, x)
        u.set("stop", request if k >= ASKED else 0)
        u.step(k * STEP, STEP)
        printed.append([f"{x:.16g}" for x in u.get(numbers)])
    u.slave.freeInstance()
    assert len(rows) == STEPS + 1
    for k, want in enumerate(printed):
        got = [f"{float(rows[k + 1][n]):.16g}" for n in numbers]
        assert got == want, f"row {k + 1}"
    moved = np.ptp([[float(r[n]) for n in names(model, "q")] for r in rows], axis=0)
    assert np.all(moved > 1e-3), "an arm that stands still shows nothing"
