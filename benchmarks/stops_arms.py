"""Are stop bounds of use on every arm? Shares certified, by what, and how tight, on arms light to heavy, empty and loaded.

    python benchmarks/stops_arms.py [--states 20] [--stops 100] [--arms WORD ...] [--box] [--json FILE]

For each arm of `stop_arms_wide` and for no payload and the rated one: random poses, speeds up to full speed, one tube each.
Each bound is held against sampled stops of the nonlinear arm every half millisecond and compared with the worst of them.
``--box``: instead boxes of +-0.01 rad and +-0.05 rad/s in the monitor's steps.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms_wide import arms

from stop_sampling import point_motion, sample_stops, tightness
from stopset.artifact import Model
from stopset.reach.stops import StopBounds
from stopset.reach.stops.cartesian import SLICES, slices
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK
from stopset.reach.stops.tubes import tubes_of

BOX = 0.01, 0.05  # [rad], [rad/s]


def run(model: Model, payload: tuple[float, float], top: np.ndarray, states: int, stops: int, box: bool) -> dict[str, Any]:
    """One arm with one payload."""
    s = StopBounds.of(model, payload).setting
    assert s is not None
    n, rng = model.n, np.random.default_rng(1)
    r, v = s.noise.radius[:n], s.noise.radius[n:]
    if box:
        r, v = r + BOX[0], v + BOX[1]
    ratios: dict[str, list[float]] = {"angle": [], "fall-back": [], "time": [], "tcp": []}
    certified = energy = escaped = sampled = 0
    seconds = []
    for k in range(states):
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top
        start = time.thread_time()
        tube = tubes_of(s, Start(q, dq, r, v), 1, fast=box)[-1]
        seconds.append(time.thread_time() - start)
        if tube.end != OK:
            continue
        certified += 1
        energy += tube.energetic
        tcp = point_motion(s.plant.chain, q, r, slices(tube, SLICES), n - 1, s.payload_com)[0]
        x = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, stops, k)
        sampled += x.stops
        escaped += x.escaped + int(x.tcp > tcp)
        ratio = tightness(tube, tcp, x, dq, top)
        ratios["fall-back" if tube.energetic else "angle"] += ratio.angle.tolist()
        ratios["time"].append(ratio.time)
        ratios["tcp"].append(ratio.tcp)
    points = {k: [round(float(y), 2) for y in np.percentile(x, [5, 50, 95])] for k, x in ratios.items() if x}
    every = ratios["angle"] + ratios["fall-back"]
    return {
        "states": states, "certified": certified / states, "energy": energy / states, "stops": sampled, "escapes": escaped,
        "median angle": round(float(np.median(every)), 2) if every else None, **points,
        "ms": round(1e3 * float(np.median(seconds)), 1),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=int, default=20)
    parser.add_argument("--stops", type=int, default=100, help="sampled for each state")
    parser.add_argument("--arms", nargs="*", default=[""], help="only arms with one of these words in their name")
    parser.add_argument("--box", action="store_true")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    out = {}
    for name, (model, top) in arms().items():
        if not any(word in name for word in args.arms):
            continue
        rated = model.domain.payload[1]
        for payload in ((0.0, 0.0), (0.98 * rated, rated)):
            key = f"{name}, {payload[1]:.3g} kg"
            out[key] = run(model, payload, top, args.states, args.stops, args.box)
            print(key, out[key], flush=True)
    print(f"{sum(x['stops'] for x in out.values())} stops, {sum(x['escapes'] for x in out.values())} escapes")
    if args.json:
        args.json.write_text(json.dumps(out, indent=1) + "\n")


if __name__ == "__main__":
    main()
