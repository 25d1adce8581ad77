"""What the compiled core was to reach, each figure beside what was asked for, in one run; processor seconds of this process.

    python benchmarks/core_targets.py [--data REC.parquet --robot lwa4p]

The certificate of a box, a conformance step, a call; then `first_start.py` with the demo, which says what commands take cold and warm.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms import prbt_like

from monitor_arm import DT, known_model
from stop_certificate import certify
from stopset.core.library import ffi, given, integers, lib, view
from stopset.reach.flowpipe import deviation_tube, discretise
from stopset.reach.stops import StopBounds

HERE = Path(__file__).resolve().parent
AGES, JOINTS = 100, 6


def median_us(f: Callable[[], object], count: int, times: int = 1) -> float:
    """[us] of processor time of one call; ``times``: calls a measurement."""
    spent = []
    for _ in range(count):
        start = time.process_time_ns()
        for _ in range(times):
            f()
        spent.append((time.process_time_ns() - start) / times)
    return float(np.median(spent)) / 1e3


def step_us() -> float:
    """Of `AGES` predictions, one of each age, a step on and a reading against each."""
    model, n = known_model(horizon=AGES * DT), JOINTS
    Ad, Bd = discretise(model.abstraction, DT)
    tube = deviation_tube(model.abstraction, model.powered)
    lo, hi = given(tube.lo), given(tube.hi)
    e, w, age = np.zeros((AGES, 2 * n)), np.zeros((AGES, 2 * n)), np.arange(AGES)
    foreign, row, nearest = np.zeros(AGES, np.uint8), np.zeros(4 * n, np.int64), np.zeros(2 * n, np.int64)
    middle, reach, room, seen = np.empty_like(lo), np.empty_like(lo), np.empty(2 * n), ffi.new("int64_t[2]")
    struct = ffi.new("StopsetPredictions *", (
        2 * n, AGES, AGES + 1, view(e), view(w), integers(age), ffi.from_buffer("uint8_t[]", foreign), view(Ad), view(Bd), view(lo),
        view(hi), view(middle), view(reach), view(room), integers(nearest), integers(row),
    ))  # fmt: skip
    lib.stopset_centre(struct)
    nothing, none = np.zeros(2 * n), np.zeros(n)
    x, u = view(nothing), view(none)

    def step() -> None:
        age[:] = np.arange(AGES)
        lib.stopset_advance(struct, x, x, u, u, 0, 1, seen)

    def setting() -> None:
        age[:] = np.arange(AGES)

    whole = median_us(step, 200, 50)
    assert seen[1] == 0
    return whole - median_us(setting, 200, 50)


def main() -> None:
    bounds = StopBounds.of(prbt_like(), (0.0, 0.25))
    q, dq = np.array([0.1, 0.5, 0.3, -0.4, 0.2, 0.1]), np.array([1.0, 0.8, -0.7, 0.3, 0.5, -1.0])
    box = np.full(JOINTS, 0.01), np.full(JOINTS, 0.05)
    call = median_us(lambda: lib.stopset_looked_at(3, 100), 200, 1000)
    print(f"a call of the core: {call:.2f} us (asked: under 1)")
    print(f"conformance step of {AGES} ages, {JOINTS} joints: {step_us():.1f} us (asked: under 10)")
    print(
        f"certificate of a box, {JOINTS} joints: {median_us(lambda: certify(bounds, q, dq, *box), 100) / 1e3:.2f} ms (asked: under 1)"
    )
    print("asked: cold within 1.3 of warm, demo under 75 s, identify of the real arm under 8 s cold", flush=True)
    subprocess.run([sys.executable, str(HERE / "first_start.py"), "--demo", *sys.argv[1:]], check=True)


if __name__ == "__main__":
    main()
