"""STOP 1 guaranteed, in numbers: how often it is bounded, by what, how tightly, and whether any failed ramp leaves the bound.

    python benchmarks/stops_failed.py [--stops 20000]

Each joint's speed varies as it likes until power is taken; then a stop of the nonlinear coupled arm, every half millisecond.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms import prbt_like

from stop_failing import sample_failed_ramps
from stopset.reach.stops import Ramp, StopBounds

PER_STATE = 100
RAMPS = {
    "SS1-t, power off after 0.1 s": Ramp.stated(6, time=0.3).failing(off_after=0.1),
    "SS1-t, power off after 0.3 s": Ramp.stated(6, time=0.3).failing(off_after=0.3),
    "SS1-r, 0.3 s": Ramp.stated(6, time=0.3).failing(monitored=True),
    "SS1-r, 0.3 s, drives may accelerate to 120 %": Ramp.stated(6, time=0.3).failing(monitored=True, share=1.2),
    "SS1-r, 5 rad/s^2": Ramp.stated(6, deceleration=5.0).failing(monitored=True),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=20_000)
    parser.add_argument("--pieces", type=int, default=4)
    args = parser.parse_args()
    cases = [(name, ramp, load) for name, ramp in RAMPS.items() for load in ((0.0, 0.25), (2.75, 3.0))]
    states = max(1, args.stops // (PER_STATE * len(cases)))
    total = escaped = 0
    for seed, (name, ramp, load) in enumerate(cases):
        rng, layers = np.random.default_rng(seed), Counter[str]()
        bounds = StopBounds.of(prbt_like(), load, ramp=ramp, pieces=args.pieces)
        angles: list[float] = []
        times, tcps, left = [], [], 0
        for k in range(states):
            q, dq = rng.uniform(-2.3, 2.3, 6), rng.uniform(-1.26, 1.26, 6)
            bound = bounds.bound(q, dq, "1 guaranteed")
            layers[bound.layer or "none"] += 1
            if bound.angle is None or bound.time is None or bound.tcp is None:
                continue
            found = sample_failed_ramps(bounds, bound, q, dq, PER_STATE, 1000 * seed + k)
            total, left = total + found.stops, left + found.escaped
            angles += (bound.angle / found.angle)[np.abs(dq) > 0.25].tolist()
            times.append(float(bound.time.max()) / found.time)
            tcps.append(bound.tcp / found.tcp)
        how = ", ".join(f"{v} by {k}" for k, v in sorted(layers.items()))
        escaped += left
        print(
            f"{name}, {load[0]:g} to {load[1]:g} kg: {states} states, {how}; median bound over worst sampled: angle "
            f"{np.median(angles):.2f}, time {np.median(times):.2f}, TCP {np.median(tcps):.2f}; {left} escapes",
            flush=True,
        )
    print(f"{total} failed ramps, {escaped} escapes")


if __name__ == "__main__":
    main()
