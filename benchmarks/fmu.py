"""How exact and how fast the FMU is: export time, agreement with Python, time per step, stop bounds against samples.

Run: python benchmarks/fmu.py MODEL.model.json
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from stopset.artifact import Model, load_model
from stopset.fmu import PLATFORMS, export
from stopset.fmu.build import native
from stopset.fmu.reference import reference
from stopset.fmu.stops import fmu_stop
from stopset.reach.stops.bounds import StopBounds


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--states", type=int, default=20, help="states at which the stop bounds are compared")
    args = parser.parse_args()
    model = load_model(args.model)
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        fmu = export(model, Path(folder) / "F.fmu", 3, [str(native())])
        print(f"export, this platform: {time.perf_counter() - start:.2f} s")
        start = time.perf_counter()
        every = export(model, Path(folder) / "G.fmu", 3)
        print(f"export, {len(PLATFORMS)} platforms: {time.perf_counter() - start:.2f} s, {every.stat().st_size / 1024:.0f} KiB")
        run(model, fmu)
    stops(model, args.states)


def run(model: Model, fmu: Path) -> None:
    """Agreement on the reference run, and time per step without an importer's overhead."""
    import fmpy
    from fmpy.fmi3 import FMU3Slave

    r, J = reference(model), model.joints
    description = fmpy.read_model_description(str(fmu))
    vr = {v.name: v.valueReference for v in description.modelVariables}
    folder = fmpy.extract(str(fmu))
    slave = FMU3Slave(
        guid=description.guid, unzipDirectory=folder, modelIdentifier=description.coSimulation.modelIdentifier, instanceName="a"
    )  # fmt: skip
    slave.instantiate()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    given = [vr[f"{s}_{j}"] for s in ("tau", "temp", "q_measured", "dq_measured") for j in J]
    asked = [vr[f"{s}_{j}"] for s in ("q", "dq", "q_lo", "dq_lo", "q_hi", "dq_hi") for j in J]
    slave.setBoolean([vr["measured"]], [True])
    dt, worst, stepping, getting = model.powered.dt, 0.0, 0.0, 0.0
    for k in range(len(r.t) - 1):
        slave.setFloat64(given, np.concatenate([r.tau[k], r.temp[k], r.x[k]]).tolist())
        a = time.perf_counter()
        slave.doStep(k * dt, dt)
        b = time.perf_counter()
        out = np.array(slave.getFloat64(asked))
        stepping, getting = stepping + b - a, getting + time.perf_counter() - b
        wanted = np.concatenate([r.x[k + 1], r.lo[k + 1], r.hi[k + 1]])
        worst = max(worst, float(np.abs(out - wanted)[np.isfinite(wanted)].max()))
    rows = len(r.t) - 1
    print(f"largest difference from Python over {r.t[-1]:.2f} s, state and bounds: {worst:.1e}")
    print(f"doStep {1e6 * stepping / rows:.0f} us, {len(asked)} outputs {1e6 * getting / rows:.0f} us (with fmpy's calls)")
    slave.terminate()
    slave.freeInstance()


def stops(model: Model, states: int) -> None:
    """The FMU's bound over the certified tube of `stopset.reach`, at random states of the domain."""
    n, bounds, rng = model.n, StopBounds.of(model), np.random.default_rng(0)
    d, V = model.domain, model.powered.V
    ratios, proved = [], 0
    for _ in range(states):
        q, dq = rng.uniform(d.q.lo, d.q.hi), rng.uniform(d.dq.lo, d.dq.hi)
        mine = fmu_stop(model, q - V.centre[:n], dq - V.centre[n:], V.radius[:n], V.radius[n:])
        other = bounds.bound(q, dq)
        proved += mine is not None
        if mine is not None and other.time is not None and other.angle is not None and other.tcp is not None:
            ratios.append([mine.time / other.time.max(), np.median(mine.angle / other.angle), mine.tcp / other.tcp])
    print(f"stops proved: {proved} of {states}")
    if ratios:
        t, a, p = np.median(ratios, axis=0)
        print(f"bound over the tube of stopset.reach, median: time {t:.1f}, angle {a:.1f}, flange {p:.1f}")


if __name__ == "__main__":
    main()
