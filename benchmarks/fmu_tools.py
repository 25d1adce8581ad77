"""Units of many kinds in tools that nobody here wrote: check-fmu, fmusim, CVODE, the rules of FMI-VDM. One line for each unit and version.

Run: python benchmarks/fmu_tools.py MODEL.model.json ... [--catalogue]
fmusim and the checkers are named by STOPSET_FMUSIM, STOPSET_VDMCHECK2 and STOPSET_VDMCHECK3, see docs/fmu.md; what is not here is left out.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from stopset.artifact import Model, load_model
from stopset.effects import catalogue
from stopset.fmu import Contents, export
from stopset.fmu.build import native
from stopset.fmu.check import check_fmu
from stopset.fmu.stops import stop_refusal
from stopset.reach.stops.path import Path as StopPath

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from test_fmu import names
from test_fmu_catalogue import fitted
from test_fmu_exchange import co_simulated, exchanged_by_fmpy, exchanged_by_fmusim
from test_fmu_fmusim import FMUSIM, Drive, digits_apart
from test_fmu_fuzz import MODELS
from test_fmu_path import posed, rows
from test_fmu_stops import braked


def main() -> None:
    """Print the lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", type=Path, nargs="*")
    parser.add_argument("--catalogue", action="store_true", help="a unit for every effect of the catalogue, alone")
    parser.add_argument("--only", default="", help="units whose name begins so")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name, (model, path) in units(args.models, every_effect=args.catalogue):
            for fmi in (2, 3) if name.startswith(args.only) else ():
                contents = Contents(fmi, (str(native()),), path=path)
                said = [f() for f in looks(model, export(model, Path(folder) / "F.fmu", contents), fmi)]
                print(f"{name}, FMI {fmi}: {'; '.join(x for x in said if x)}", flush=True)


def units(models: list[Path], *, every_effect: bool) -> Iterator[tuple[str, tuple[Model, StopPath | None]]]:
    """Names, models, and the path of one."""
    for path in models:
        yield path.name.removesuffix(".model.json"), (load_model(path), None)
    if every_effect:
        for name in sorted(catalogue()):
            yield name, (braked(8.0, 3, effort="motor_torque", effects=[fitted(name)]), None)
        return
    for name in ("linear", "effects", "cubic", "model 2", "model 3"):
        yield name, (MODELS[name](), None)
    loaded = braked(8.0, 3)
    yield "payload from nothing to 5 kg", (replace(loaded, domain=replace(loaded.domain, payload=(0.0, 5.0))), None)
    yield "with a path", (posed(), StopPath.through(rows(3)))


def looks(model: Model, fmu: Path, fmi: int) -> list[Callable[[], str]]:
    """What is said of a unit, each by a tool."""
    size = np.minimum(0.5 * model.domain.u.hi, 30.0)
    drive = Drive(0 if model.brakes is None or stop_refusal(model) else 1, size)

    def checked() -> str:
        c = check_fmu(fmu)
        worst = max(c.differences.values())
        return f"check-fmu {'good' if c.good else 'NOT GOOD'} ({worst:.0e}, {c.equal} of {c.stops} states), {fmu.stat().st_size >> 10} KiB"

    def digits() -> str:
        if FMUSIM is None:
            return ""
        other, moved = digits_apart(fmu, model, drive, names(model, "q", "dq", "q_lo", "dq_hi", "stop_time", "stop_angle"))
        return f"fmusim: {other} rows with another digit, moved {moved:.2g} rad"

    def exchange() -> str:
        wanted = co_simulated(model, fmu, drive)
        with contextlib.redirect_stdout(io.StringIO()):
            off = [np.abs(exchanged_by_fmpy(model, fmu, drive) - wanted).max()]
        off += [np.abs(exchanged_by_fmusim(model, fmu, drive) - wanted).max()] if FMUSIM else []
        return "model exchange within " + ", ".join(f"{x:.1e}" for x in off) + " (fmpy, fmusim)"

    def rules() -> str:
        script = os.environ.get(f"STOPSET_VDMCHECK{fmi}")
        if script is None:
            return ""
        done = subprocess.run([script, str(fmu)], capture_output=True, text=True, check=False)
        return "FMI-VDM: " + (done.stdout + done.stderr).strip()

    return [checked, digits, exchange, rules]


if __name__ == "__main__":
    main()
