"""Model exchange over a moving stop: an importer's own solver comes to where co-simulation comes.

Friction and brakes make the right side jump. Event indicators say when a joint comes to rest or breaks loose, time events when a brake
begins to rise and when it has risen, and at every event the importer is told to begin its solver anew: the simulator of the Modelica
Association does so only where states are said to have changed, and its solver ended on the old history ("error test failed repeatedly").
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stopset.artifact import Model
from stopset.types import Array
from test_fmu import HERE, columns, exported, names, simulate
from test_fmu_fmusim import ASKED, CASES, FMUSIM, STEP, STEPS, Drive, by_fmusim

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = pytest.mark.skipif(HERE is None, reason="no FMU binaries for this platform")
__all__ = ["exported"]  # the fixture

TOLERANCE = 1e-9  # relative and absolute, of both solvers
AGREE = 1e-6  # [rad, rad/s] of the whole run; 1.5e-7 was seen


def co_simulated(model: Model, fmu: Path, drive: Drive) -> Array:
    """(STEPS + 1, 2n) [rad, rad/s] with inputs held from each row on."""
    given = dict(zip(names(model, "tau"), drive.torques.T, strict=True)) | {"stop": drive.stop}
    out = simulate(model, fmu, STEP * np.arange(STEPS + 1), given, names(model, "q", "dq"))
    return columns(out, model, "q", "dq")


def last_at_each_step(time: Array, x: Array) -> Array:
    return x[[np.flatnonzero(np.abs(time - k * STEP) < 1e-9)[-1] for k in range(STEPS + 1)]]


def exchanged_by_fmpy(model: Model, fmu: Path, drive: Drive) -> Array:
    """(STEPS + 1, 2n) [rad, rad/s] of its CVODE."""
    twice = np.repeat(STEP * np.arange(STEPS + 1), 2)[1:]  # the end of one step and the begin of the next
    held = {k: np.repeat(x, 2)[:-1] for k, x in zip([*names(model, "tau"), "stop"], [*drive.torques.T, drive.stop], strict=True)}
    out = simulate(
        model, fmu, twice, held, names(model, "q", "dq"), kind="ModelExchange", output_interval=STEP, relative_tolerance=TOLERANCE
    )  # fmt: skip
    return last_at_each_step(out["time"], columns(out, model, "q", "dq"))


def exchanged_by_fmusim(model: Model, fmu: Path, drive: Drive) -> Array:
    """(STEPS + 1, 2n) [rad, rad/s] of its CVODE."""
    watched = names(model, "q", "dq")
    options = ["--interface-type", "me", "--solver", "cvode", "--tolerance", repr(TOLERANCE)]
    rows = by_fmusim(fmu, model, drive, watched, *options, jumps=True)
    got = np.array([[float(r[n]) for n in ["time", *watched]] for r in rows])
    return last_at_each_step(got[:, 0], got[:, 1:])


def holds(model: Model, wanted: Array, got: Array) -> None:
    speed = np.abs(wanted[:, model.n :]).max(axis=1)
    assert np.all(np.ptp(wanted[:ASKED], axis=0) > 1e-3) and speed[ASKED] > 0.02, "it moves when it is stopped"
    assert speed[-1] < 0.8 * speed[ASKED], "and is slowed down"
    assert np.abs(got - wanted).max() < AGREE


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", CASES)
def test_fmpy_s_solver_follows_a_moving_stop(exported: Any, name: str, fmi: int, own_effect: object) -> None:
    model, drive = CASES[name].made()
    fmu = exported(model, f"exchange {name}", fmi)
    holds(model, co_simulated(model, fmu, drive), exchanged_by_fmpy(model, fmu, drive))


@pytest.mark.skipif(FMUSIM is None, reason="fmusim is not here; build it as docs/fmu.md says and set STOPSET_FMUSIM")
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", CASES)
def test_fmusim_s_solver_follows_a_moving_stop(exported: Any, name: str, fmi: int, own_effect: object) -> None:
    model, drive = CASES[name].made()
    fmu = exported(model, f"exchange {name}", fmi)
    holds(model, co_simulated(model, fmu, drive), exchanged_by_fmusim(model, fmu, drive))
