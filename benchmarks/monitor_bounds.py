"""What stop bounds beside the loop cost, and how much of the time they hold, while an arm moves in real time:
``python benchmarks/monitor_bounds.py MODEL [RECORDING] [--rounds 3] [--seconds 30] [--payload KG] [--share 0.1]``.

``./run demo --out FOLDER`` leaves a model and recordings; the model "ur10e" is the UR10e-like arm of stop_arms_wide.py. Without a
recording the arm goes from one random pose to the next and comes by no state twice in a round. Per round: processor time of
the bounding process as a part of a core, states with a certified bound of every category, and the median flange travel told for
STOP 0.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from stop_arms_wide import ur10e_like

from stopset.artifact import Model, load_model, save_model
from stopset.monitor.config import Stops
from stopset.monitor.sample import Quantum
from stopset.monitor.stopdesk import StopDesk, seen_by
from stopset.recording import read_recordings
from stopset.types import Array

REACH, TOP = 0.8, 0.6  # of the angles and speeds identification has seen
SHORTEST = 0.4  # [s] a motion takes


def cpu_of(pid: int) -> float:
    """[s] user and system time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def never_twice(model: Model, seconds: float, seed: int = 3) -> tuple[Array, Array]:
    """Angles and speeds (N, n) of fifth-order motions between random poses, one after another."""
    rng, seen, n, dt = np.random.default_rng(seed), seen_by(model), model.n, model.powered.dt
    lo, hi = np.maximum(seen.lo[:n], -np.pi), np.minimum(seen.hi[:n], np.pi)
    middle, half = 0.5 * (lo + hi), 0.5 * REACH * (hi - lo)
    top = TOP * np.minimum(-seen.lo[n:], seen.hi[n:])
    at, q, dq = middle, [middle[None]], [np.zeros((1, n))]
    while sum(len(x) for x in q) * dt < seconds:
        displacement = middle + half * rng.uniform(-1.0, 1.0, n) - at
        takes = max(SHORTEST, float(np.max(1.875 * np.abs(displacement) / top)))
        z = np.arange(dt, takes, dt)[:, None] / takes
        q.append(at + displacement * (10 * z**3 - 15 * z**4 + 6 * z**5))
        dq.append(displacement * (30 * z**2 - 60 * z**3 + 30 * z**4) / takes)
        at = at + displacement
    return np.concatenate(q)[: round(seconds / dt)], np.concatenate(dq)[: round(seconds / dt)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("recording", type=Path, nargs="?")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=30.0, help="of a round without a recording")
    parser.add_argument("--payload", type=float, default=0.0)
    parser.add_argument("--share", type=float, default=Stops().core_share)
    args = parser.parse_args()
    path = args.model
    if path == "ur10e":
        path = f"{tempfile.mkdtemp()}/ur10e.model.json"
        save_model(ur10e_like(), path)
    model = load_model(path)
    if args.recording:
        trials = list(read_recordings(args.recording))
        q, dq = np.concatenate([r.q for r in trials]), np.concatenate([r.dq for r in trials])
    else:
        q, dq = never_twice(model, args.seconds)
    dt, stops = model.powered.dt, Stops(("0", "1"), ramp_time_s=0.35, ramp_off_after_s=0.5, core_share=args.share)
    desk = StopDesk(path, seen_by(model), stops, args.payload, Quantum.none(model.n))
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
