"""A cycle of the monitor in this tree beside that of another, in turns: ``python benchmarks/monitor_beside.py OTHER [--rounds N] [--core C]``.

OTHER: a clone of another commit, with its core built. A process of each runs 200 cycles, then the other, on one core; what a shared machine does
to one it does to both, so that the ratio of neighbours says what the code does.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1]
ROOTS = ("model", "offline", "monitor", "fmu", "tests", "benchmarks")
BURST, WARM = 200, 900
SHARES = {"median": 0.5, "p05": 0.05, "p99": 0.99}

WORKER = """
import gc, os, sys, tempfile, time
from pathlib import Path
import numpy as np
import monitor
from stopset.artifact import load_model, save_model
core, rounds, burst, warm = (int(x) for x in sys.argv[1:])
os.sched_setaffinity(0, {core})
path = Path(tempfile.mkdtemp()) / "torque.json"
save_model(monitor.torque_input(), path)
monitor.CYCLES = warm + burst * rounds + 10
daemon, bus, clock = monitor.prepared(load_model(path), path, monitor.motion(0, 4000))
gc.collect()
gc.disable()
def run(cycles):
    took = []
    for _ in range(cycles):
        bus.ready = bus.cycles.pop(0)
        clock.now += daemon.cycle_s
        begin = time.thread_time_ns()
        daemon.cycle()
        took.append(time.thread_time_ns() - begin)
    return 1e-3 * np.array(took)
run(warm)
print("ready", flush=True)
for _ in sys.stdin:
    print(*np.quantile(run(burst), [0.5, 0.05, 0.99]), flush=True)
"""


def started(root: Path, core: int, rounds: int) -> subprocess.Popen[str]:
    """A process with the code of the tree at ``root``, warmed up."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(str(root / r) for r in ROOTS)}
    command = [sys.executable, "-c", WORKER, *map(str, (core, rounds, BURST, WARM))]
    return subprocess.Popen(command, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def asked(worker: subprocess.Popen[str]) -> list[float]:
    """Shares of its next burst [us]."""
    assert worker.stdin is not None
    assert worker.stdout is not None
    worker.stdin.write("\n")
    worker.stdin.flush()
    return [float(x) for x in worker.stdout.readline().split()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("other", type=Path)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--core", type=int, default=1)
    args = parser.parse_args()
    if not (args.other / "benchmarks").is_dir():
        parser.error(f"{args.other} is no checkout of stopset; expected the folder of another one")
    workers = [started(root.resolve(), args.core, args.rounds) for root in (args.other, HERE)]
    for w in workers:
        assert w.stdout is not None
        if w.stdout.readline() != "ready\n":
            sys.exit(
                "a tree's monitor does not run; expected two clones with their cores built: python -m stopset.core.build in each"
            )
    took = np.empty((2, args.rounds, len(SHARES)))
    for k in range(args.rounds):
        for i in (0, 1) if k % 2 else (1, 0):
            took[i, k] = asked(workers[i])
    for w in workers:
        w.communicate()
    for j, name in enumerate(SHARES):
        other, here = np.median(took[:, :, j], axis=1)
        print(
            f"{name:<7} other {other:.1f} us, here {here:.1f}; ratio of neighbours {np.median(took[1, :, j] / took[0, :, j]):.3f}"
        )


if __name__ == "__main__":
    main()
