"""How long a diagnosis takes: 50,000 samples of a simulated arm, the whole catalogue; also as a ratio to plain least squares.

    python benchmarks/diagnosis_speed.py
    python benchmarks/diagnosis_speed.py --compile    # with every kernel compiled anew, as after an installation

Each case runs in a process of its own: *cold* is that process's first diagnosis with imports and reading the recording,
*warm* its second.  The ratio is to one least squares of y on the base model and every start column of the catalogue, joint
by joint, over the same rows in the same process: processor time varies with what else the machine does, the ratio less.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

SAMPLES = 50_000
CASES = ("none", "stribeck", "delay", "elasticity", "thermal_viscous+payload")


def simulate(hide: str, folder: Path) -> Path:
    """A campaign with hidden effects, cut off at `SAMPLES`, as a Parquet file beside its robot."""
    from stopset.offline.description import load_robot
    from stopset.recording import write_recordings
    from stopset.simulation import prepare

    scenario = prepare(load_robot("lwa4p"), hide.split("+"), 7, "compact")
    trials, left = [], SAMPLES
    for r in scenario.recordings():
        if left > 0:
            trials.append(r if len(r.t) <= left else r.cut(0, left))
            left -= len(r.t)
    path = folder / f"{hide}.parquet"
    write_recordings(path, dataclasses.replace(scenario.meta, sources=()), trials)
    return path


def spent(work: Callable[[], Any]) -> tuple[float, float, Any]:
    """Wall and processor seconds of a piece of work, and its result."""
    wall, cpu = time.perf_counter(), time.process_time()
    out = work()
    return time.perf_counter() - wall, time.process_time() - cpu, out


def child(path: Path) -> dict[str, Any]:
    """Everything measured in this process."""

    def whole() -> Any:
        from stopset.offline.description import load_robot
        from stopset.offline.diagnose import diagnose
        from stopset.recording import read_recordings
        from stopset.simulation.scenario import complete_robot

        robot = complete_robot(load_robot("lwa4p"), 7)
        recordings = read_recordings(path, robot)
        return robot, recordings, diagnose(robot, recordings)

    wall, cpu, (robot, recordings, found) = spent(whole)
    warm_wall, warm_cpu, _ = spent(whole)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "samples": sum(len(r.t) for r in recordings), "joints": robot.n, "cold": [wall, cpu], "warm": [warm_wall, warm_cpu],
        "megabytes": peak, "plain": plain(robot, recordings), "found": [found.verdict, *(r.label for r in found.ranked)],
    }  # fmt: skip


def plain(robot: Any, recordings: Any) -> float:
    """Processor seconds of one least squares per joint on the base model and all start columns of the catalogue."""
    import numpy as np

    from stopset.offline.diagnose.evidence.engine import Engine
    from stopset.offline.diagnose.search.wanted import wanted

    engine = Engine.build(robot, recordings)
    engine.add_all(wanted(engine))
    designs = [gram.X for gram in engine.grams]
    return spent(lambda: [np.linalg.lstsq(X[:, 1:], X[:, 0], rcond=1e-10) for X in designs])[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--compile", action="store_true", help="start from an empty cache of compiled kernels")
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        print(json.dumps(child(args.child)))
        return
    with tempfile.TemporaryDirectory() as name:
        for hide in args.cases.split(","):
            path = simulate(hide, Path(name))
            environment = dict(os.environ)
            if args.compile:
                environment["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(dir=name)
            command = [sys.executable, __file__, "--child", str(path)]
            done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
            r = json.loads(done.stdout.splitlines()[-1])
            (wall, cpu), (warm_wall, warm_cpu) = r["cold"], r["warm"]
            print(
                f"{hide}: {r['samples']} samples, {r['joints']} joints: cold {cpu:.1f} s CPU ({wall:.1f} s wall), "
                f"warm {warm_cpu:.1f} s CPU ({warm_wall:.1f} s wall), {warm_cpu / r['plain']:.1f} times plain least squares, "
                f"{r['megabytes']:.0f} MB; {' '.join(r['found'])}",
                flush=True,
            )


if __name__ == "__main__":
    main()
