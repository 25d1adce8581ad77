"""What stop bounds beside the loop cost, and how much of the time they hold, while an arm repeats its motions in real time:
``python benchmarks/monitor_bounds.py MODEL RECORDING [--rounds 3]``; ``./run demo --out FOLDER`` leaves both.

Per round: processor time of the bounding process as a part of a core, states with a certified bound of every category, and the
median flange travel told for STOP 0.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

from stopset.artifact import load_model
from stopset.monitor.config import Stops
from stopset.monitor.sample import Quantum
from stopset.monitor.stopdesk import StopDesk, seen_by
from stopset.recording import read_recordings


def cpu_of(pid: int) -> float:
    """[s] user and system time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    model, trials = load_model(args.model), list(read_recordings(args.recording))
    q, dq = np.concatenate([r.q for r in trials]), np.concatenate([r.dq for r in trials])
    dt, stops = model.powered.dt, Stops(("0", "1"), ramp_time_s=0.35, ramp_off_after_s=0.5)
    desk = StopDesk(str(args.model), seen_by(model), stops, 0.0, Quantum.none(model.n))
    try:
        while not desk._ready:
            desk.offer(0.0, q[0], 0.0 * dq[0])
            time.sleep(0.01)
        begin, k = time.monotonic(), 0
        for turn in range(args.rounds):
            before, held, travel = cpu_of(desk._process.pid), 0, []
            for i in range(len(q)):
                time.sleep(max(0.0, begin + k * dt - time.monotonic()))
                desk.offer(k * dt, q[i], dq[i])
                numbers, fresh = desk.now(q[i], dq[i])
                held += fresh and all(x.proven for x in numbers.values())
                travel.append(numbers["0"].tcp)
                k += 1
            share = (cpu_of(desk._process.pid) - before) / (len(q) * dt)
            print(f"round {turn + 1}: {100 * share:.1f} % of a core, bounds for {100 * held / len(q):.1f} % of the states, "
                  f"STOP 0 median {1e3 * np.median(travel):.0f} mm at the flange")  # fmt: skip
    finally:
        desk.close()


if __name__ == "__main__":
    main()
