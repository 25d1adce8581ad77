"""How exact and how fast the FMU is: export time, agreement with Python, time per step, stop bounds against samples.

Run: python benchmarks/fmu.py MODEL.model.json
"""

from __future__ import annotations

import argparse
import ctypes
import os
import shutil
import subprocess
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from stopset.artifact import Model, load_model
from stopset.fmu import PLATFORMS, Contents, export
from stopset.fmu.build import native
from stopset.fmu.reference import reference
from stopset.fmu.stops import bounds_of
from stopset.reach.stops.bounds import StopBounds


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--states", type=int, default=20, help="states at which the stop bounds are compared")
    parser.add_argument("--cold", action="store_true", help="as a first export: with an empty cache of compiled files")
    args = parser.parse_args()
    if args.cold:
        os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp()
    model = load_model(args.model)
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        fmu = export(model, Path(folder) / "F.fmu", Contents(3, (str(native()),)))
        print(f"export, this platform: {time.perf_counter() - start:.2f} s")
        start = time.perf_counter()
        every = export(model, Path(folder) / "G.fmu")
        print(f"export, {len(PLATFORMS)} platforms: {time.perf_counter() - start:.2f} s, {every.stat().st_size / 1024:.0f} KiB")
        start, first = time.perf_counter(), every.read_bytes()
        again = export(model, every).read_bytes() == first
        print(f"again: {time.perf_counter() - start:.2f} s, {'the same' if again else 'OTHER'} bytes")
        with zipfile.ZipFile(every) as z:
            for name in PLATFORMS:
                size = sum(x.file_size for x in z.infolist() if x.filename.startswith(f"binaries/{name}/"))
                print(f"  {name}: {size / 1024:.0f} KiB")
        run(model, fmu)
        stops(model, fmu, args.states)
        in_c(every, Path(folder))


def in_c(fmu: Path, folder: Path) -> None:
    """The unit's own sources in a program without an importer, by gcc -O3."""
    gcc = shutil.which("gcc")
    if gcc is None:
        print("in C: gcc is not installed, nothing measured")
        return
    with zipfile.ZipFile(fmu) as z:
        z.extractall(folder / "unpacked")
    unpacked = folder / "unpacked"
    token = (unpacked / "modelDescription.xml").read_text().split('instantiationToken="')[1].split('"')[0]
    units = sorted(str(p) for p in (unpacked / "sources").rglob("*.c"))
    flags = [
        "-std=gnu11",
        "-O3",
        "-ffp-contract=off",
        "-fno-math-errno",
        "-Wl,--wrap=stopset_power_off",
        "-I",
        str(unpacked / "sources"),
    ]
    program, source = folder / "program", str(Path(__file__).with_suffix(".c"))
    subprocess.run([gcc, *flags, source, *units, "-lm", "-o", str(program)], check=True)
    inputs = next(str(p) for p in (unpacked / "documentation").glob("*_in.csv"))
    print(subprocess.run([str(program), inputs, token], check=True, capture_output=True, text=True).stdout, end="")


def opened(fmu: Path) -> tuple[Any, dict[str, int]]:
    """An instance after initialization, and its value references by name."""
    import fmpy
    from fmpy.fmi3 import FMU3Slave

    description = fmpy.read_model_description(str(fmu))
    slave = FMU3Slave(
        guid=description.guid, unzipDirectory=fmpy.extract(str(fmu)), instanceName="a",
        modelIdentifier=description.coSimulation.modelIdentifier,
    )  # fmt: skip
    slave.instantiate()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave, {v.name: v.valueReference for v in description.modelVariables}


def plain_step(slave: Any) -> Callable[[float, float], None]:
    """The unit's own step, without what fmpy does around it."""
    call = slave.dll["fmi3DoStep"]
    call.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_bool, *[ctypes.c_void_p] * 4]
    flags, last = [ctypes.byref(ctypes.c_bool()) for _ in range(3)], ctypes.byref(ctypes.c_double())

    def step(t: float, h: float) -> None:
        if call(slave.component, t, h, True, *flags, last):
            raise RuntimeError(f"no step at {t} s")

    return step


def run(model: Model, fmu: Path) -> None:
    """Agreement on the reference run, and CPU time per step with the measured state connected and without."""
    r, J, dt = reference(model), model.joints, model.powered.dt
    for measured in (True, False):
        slave, vr = opened(fmu)
        given = [vr[f"{s}_{j}"] for s in ("tau", "temp", "q_measured", "dq_measured") for j in J]
        asked = [vr[f"{s}_{j}"] for s in ("q", "dq", "q_lo", "dq_lo", "q_hi", "dq_hi") for j in J]
        slave.setBoolean([vr["measured"]], [measured])
        step, stepping, worst, getting = plain_step(slave), [], 0.0, 0.0
        for k in range(len(r.t) - 1):
            slave.setFloat64(given, np.concatenate([r.tau[k], r.temp[k], r.x[k]]).tolist())
            a = time.process_time()
            step(k * dt, dt)
            b = time.process_time()
            out = np.array(slave.getFloat64(asked))
            stepping.append(b - a)
            getting += time.process_time() - b
            wanted = np.concatenate([r.x[k + 1], r.lo[k + 1], r.hi[k + 1]])
            worst = max(worst, float(np.abs(out - wanted)[np.isfinite(wanted)].max()))
        rows = len(r.t) - 1
        if measured:
            print(f"largest difference from Python over {r.t[-1]:.2f} s, state and bounds: {worst:.1e}")
        how = "measured state connected" if measured else "free running"
        steps = f"doStep {1e6 * np.median(stepping):.1f} us CPU (median), {1e6 * np.mean(stepping):.1f} us (mean)"
        print(f"{how}: {steps}; {len(asked)} outputs {1e6 * getting / rows:.0f} us (with fmpy's calls)")
        slave.terminate()
        slave.freeInstance()


def stops(model: Model, fmu: Path, states: int) -> None:
    """The FMU's bounds at random states of the domain: equal to the monitor's, how long they take, how they compare to a table's."""
    monitor, table, rng, d, J = (
        bounds_of(model),
        StopBounds.of(model, pieces=64),
        np.random.default_rng(0),
        model.domain,
        model.joints,
    )
    slave, vr = opened(fmu)
    given = [vr[f"{s}_{j}"] for s in ("q_measured", "dq_measured") for j in J]
    asked = [[vr[f"{s}_{j}"] for j in J] for s in ("stop_time", "stop_angle")] + [[vr["tcp_stop_distance"]]]
    slave.setBoolean([vr["measured"]], [True])
    ratios, took, same, proved = [], [], 0, 0
    for _ in range(states):
        q, dq = rng.uniform(d.q.lo, d.q.hi), rng.uniform(d.dq.lo, d.dq.hi)
        slave.setFloat64(given, [*q.tolist(), *dq.tolist()])
        begin = time.process_time()
        mine = [np.array(slave.getFloat64(x)) for x in asked]
        took.append(time.process_time() - begin)
        want, best = monitor.bound(q, dq), table.bound(q, dq)
        proved += bool(np.isfinite(mine[2][0]))
        if want.time is None or want.angle is None or best.time is None or best.angle is None or best.tcp is None:
            same += bool(np.isnan(mine[2][0])) and not want.certified
            continue
        same += np.array_equal(mine[0], want.time) and np.array_equal(mine[1], want.angle) and mine[2][0] == want.tcp
        ratios.append([mine[0].max() / best.time.max(), np.median(mine[1] / best.angle), mine[2][0] / best.tcp])
    print(f"stops proved: {proved} of {states}; equal to the monitor's to the last bit: {same}")
    print(f"a bound takes {1e3 * np.median(took):.2f} ms CPU (median), {1e3 * max(took):.2f} ms at most")
    if ratios:
        t, a, p = np.median(ratios, axis=0)
        print(f"over the bounds of a table (64 pieces), median: time {t:.2f}, angle {a:.2f}, tool {p:.2f}")
    slave.freeInstance()


if __name__ == "__main__":
    main()
