"""A unit as it is imported, fed an arm's own recording: what is covered, the verdicts, the stop bounds, and whether these are the monitor's.

Run: python benchmarks/fmu_recording.py MODEL.model.json RECORDING.parquet ... [--seconds 30] [--every 10]

Nothing is set but the inputs. Each trial is drawn onto the model's step by straight lines, as who wires a table into a tool gets it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

import fmpy
import numpy as np

from stopset.artifact import Model, load_model
from stopset.fmu import Contents, export
from stopset.fmu.build import native
from stopset.fmu.check import Instance
from stopset.fmu.stops import bounds_of
from stopset.recording import Recording, read_recordings

NAMES = ("no verdict", "conformant", "violated")


def main() -> int:
    """A line for each recording; 1 where a bound is not the monitor's."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("recordings", type=Path, nargs="+")
    parser.add_argument("--seconds", type=float, default=30.0, help="of each trial")
    parser.add_argument("--every", type=int, default=10, help="steps from one stop bound that is read to the next")
    args = parser.parse_args()
    model, same = load_model(args.model), True
    with tempfile.TemporaryDirectory() as folder:
        fmu = export(model, Path(folder) / "F.fmu", Contents(3, (str(native()),), reference=False))
        fmpy.extract(str(fmu), folder)
        for path in args.recordings:
            same &= told(path, model, fmu, folder, args.seconds, args.every)
    return int(not same)


def told(path: Path, model: Model, fmu: Path, folder: str, seconds: float, every: int) -> bool:
    """Print one recording's line; whether every bound has the monitor's bits."""
    description, rows, covered, said = fmpy.read_model_description(str(fmu)), 0, 0, Counter[str]()
    angle, tool, asked, equal, monitor = [], [], 0, 0, bounds_of(model)
    for trial in read_recordings(path, model.robot):
        q, dq, tau = on_the_step(trial, model.powered.dt, seconds)
        u = Instance(description, folder)
        u.set("measured", 1)
        u.slave.exitInitializationMode()
        for k in range(len(q)):
            for stem, row in (("q_measured", q[k]), ("dq_measured", dq[k]), ("tau", tau[k])):
                for joint, x in zip(model.joints, row, strict=True):
                    u.set(f"{stem}_{joint}", x)
            if k % every == 0:
                got = u.get([f"stop_angle_{j}" for j in model.joints] + ["tcp_stop_distance"])
                want = monitor.bound(q[k], dq[k])
                asked += 1
                equal += np.array_equal(got, np.r_[want.angle, want.tcp]) if want.certified else bool(np.isnan(got).all())
                angle.append(got[:-1])
                tool.append(got[-1])
            u.step(k * model.powered.dt, model.powered.dt)
            flag, verdict = u.slave.getBoolean([u.variables["covered"].valueReference])[0], u.variables["verdict"].valueReference
            rows, covered = rows + 1, covered + bool(flag)
            said[NAMES[u.slave.getInt32([verdict])[0]]] += 1
        u.slave.freeInstance()
    bounded = int(np.isfinite(tool).sum())
    verdicts = ", ".join(f"{n} {word}" for word, n in said.most_common())
    print(
        f"{path.name}: {covered} of {rows} steps covered; {verdicts}; a stop bound in {bounded} of {asked} states, {equal} with the monitor's bits"
    )
    if bounded:
        turned = ", ".join(f"{x:.3f}" for x in np.nanmax(angle, axis=0))
        print(
            f"  STOP 0: tool {np.nanmedian(tool):.3f} m in the middle, {np.nanmax(tool):.3f} at most; angles at most {turned} rad",
            flush=True,
        )
    return equal == asked


def on_the_step(trial: Recording, dt: float, seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, dq, tau (rows, n)."""
    t = trial.t - trial.t[0]
    grid = np.arange(0.0, min(float(t[-1]), seconds), dt)
    drawn = [np.column_stack([np.interp(grid, t, x[:, i]) for i in range(x.shape[1])]) for x in (trial.q, trial.dq, trial.tau)]
    return drawn[0], drawn[1], drawn[2]


if __name__ == "__main__":
    sys.exit(main())
