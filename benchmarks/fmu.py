"""How exact, large and fast the FMU is: export time, size per platform, agreement with Python, time per step and per bound of every kind of stop.

Run: python benchmarks/fmu.py MODEL.model.json ... ur10e

Prints every figure that docs/fmu.md quotes of it. The model "ur10e" is the UR10e-like arm of stop_arms_wide.py, its payload anything from 0 to
12.5 kg. A model without a ramp gets one of `RAMP` seconds, so that STOP 1 and 2 have bounds.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from stop_arms_wide import ur10e_like

from stopset.artifact import Model, load_model
from stopset.fmu import PLATFORMS, Contents, export
from stopset.fmu.build import native
from stopset.fmu.reference import reference
from stopset.fmu.stops import bounds_of
from stopset.reach.stops.bounds import StopBounds
from stopset.reach.stops.ramp import KEY, Ramp, ramp_of

RAMP = 0.35  # [s]
LIMIT = 1 << 20  # [byte] of a platform's library


def named(name: str) -> Model:
    """The model, with a ramp."""
    model = ur10e_like() if name == "ur10e" else load_model(name)
    if ramp_of(model) is not None:
        return model
    print(f"a stated ramp of {RAMP} s: the model holds none")
    errors = {"q_error": np.full(model.n, 2e-3), "dq_error": np.full(model.n, 5e-3)}
    return replace(model, provenance={**model.provenance, KEY: replace(Ramp.stated(model.n, time=RAMP), **errors).as_dict()})


def main() -> int:
    """One table per model; 1 where a library is too large or bytes differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="+", metavar="MODEL", help="a model file, or ur10e")
    parser.add_argument("--states", type=int, default=20, help="states at which the stop bounds are compared")
    parser.add_argument("--cold", action="store_true", help="as a first export: with an empty cache of compiled files")
    args = parser.parse_args()
    if args.cold:
        os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp()
    bad = 0
    for name in args.models:
        print(f"{name}, at load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
        model = named(name)
        with tempfile.TemporaryDirectory() as folder:
            fmu, good = exports(model, Path(folder))
            bad += not good
            run(model, fmu)
            stops(model, fmu, args.states)
            in_c(fmu, Path(folder))
    return int(bad > 0)


def exports(model: Model, folder: Path) -> tuple[Path, bool]:
    """The unit of this platform, with time and size of all; whether these are as small and the same again as they must be."""
    start = time.perf_counter()
    fmu = export(model, folder / "F.fmu", Contents(3, (str(native()),)))
    print(f"export, this platform: {time.perf_counter() - start:.2f} s")
    start = time.perf_counter()
    every = export(model, folder / "G.fmu")
    print(f"export, {len(PLATFORMS)} platforms: {time.perf_counter() - start:.2f} s, {every.stat().st_size / 1024:.0f} KiB")
    start, first = time.perf_counter(), every.read_bytes()
    again = export(model, every).read_bytes() == first
    print(f"again: {time.perf_counter() - start:.2f} s, {'the same' if again else 'OTHER'} bytes")
    with zipfile.ZipFile(every) as z:
        sizes = {name: sum(x.file_size for x in z.infolist() if x.filename.startswith(f"binaries/{name}/")) for name in PLATFORMS}
    for name, size in sizes.items():
        print(f"  {name}: {size / 1024:.0f} KiB")
    print(f"  each {min(sizes.values()) / 1024:.0f} to {max(sizes.values()) / 1024:.0f} KiB of {LIMIT / 1024:.0f} allowed")
    return fmu, again and max(sizes.values()) <= LIMIT


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
    sys.exit(main())
