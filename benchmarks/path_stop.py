"""How long the core takes for a stop along a path of six axes: python benchmarks/path_stop.py."""

from __future__ import annotations

import time

import numpy as np
from stop_arms import prbt_like

from stopset.core.library import ffi, given, lib, view
from stopset.reach.stops import Ramp, StopBounds
from stopset.reach.stops.compiled import CompiledStops
from stopset.reach.stops.path import Path, path_fields

REPEATS, ROWS = 300, 8


def main() -> None:
    """Print one line."""
    bounds, rng = StopBounds.of(prbt_like((0.0, 0.5)), ramp=Ramp.stated(6, time=0.3, control=0.02)), np.random.default_rng(1)
    path, setting = Path.through(0.5 * rng.uniform(-0.8, 0.8, (ROWS, 6)).cumsum(axis=0)), bounds.setting
    assert setting is not None
    core, work = CompiledStops.of(setting, bounds.ramp), np.empty(lib.stopset_path_room(6))
    fields = {k: given(x) for k, x in path_fields(setting, path).items()}
    struct = ffi.new("StopsetPath *", {"pieces": len(path.coefficient)} | {k: view(x) for k, x in fields.items()})
    passed, out = ffi.new("StopsetPassed *"), [np.empty(k) for k in (6, 6, 6, 6, 2)]
    bound, took, proved = ffi.new("StopsetBound *", tuple(view(x) for x in out)), [], 0
    for _ in range(REPEATS):
        row, rate = rng.uniform(0.0, ROWS - 3.0), rng.uniform(0.3, 2.0)
        request = ffi.new("StopsetRequest *", (row, rate))
        begin = time.process_time()
        proved += not lib.stopset_path_stop(core.struct, core.braking, struct, request, view(work), passed, bound)
        took.append(time.process_time() - begin)
    most = f"{1e3 * np.quantile(took, 0.99):.2f} ms at 99 %"
    print(f"{proved} of {REPEATS} stops bounded; {1e3 * np.median(took):.2f} ms CPU (median), {most}")


if __name__ == "__main__":
    main()
