"""Soundness, coverage and tightness of STOP 0 bounds: a million sampled stops, every half millisecond inside the tube.

    python benchmarks/stops_soundness.py [--stops 1000000] [--json FILE]

Prints one line per case: states certified, stops sampled, escapes, and the 5/50/95 % points of bound over worst sampled.
A full run takes some 15 minutes on one core.
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

from stop_arms import prbt_like, uncertain_rotors, ur5_like

from stop_sampling import sample_stops, tightness
from stop_tubes import tube_of
from stopset.artifact import Model
from stopset.reach.stops import StopBounds
from stopset.reach.stops.cartesian import SLICES, point_motion, slices
from stopset.reach.stops.tube import OK
from stopset.reach.stops.tubes import tubes_of

PER_STATE = 250
CASES: list[tuple[str, Model, tuple[float, float], float, float]] = [  # name, model, payload, top speed, share of the stops
    ("PRBT-like, no load", prbt_like(), (0.0, 0.0), 1.26, 0.25),
    ("PRBT-like, 0 to 0.25 kg", prbt_like(), (0.0, 0.25), 1.26, 0.25),
    ("PRBT-like, 2.75 to 3 kg", prbt_like(), (2.75, 3.0), 1.26, 0.20),
    ("PRBT-like, rotors known to 30 %, 0 to 0.25 kg", uncertain_rotors(), (0.0, 0.25), 1.26, 0.05),
    ("UR5-like, 0 to 0.25 kg", ur5_like(rotor_scale=1.0), (0.0, 0.25), 1.25, 0.10),
    ("UR5-like, a quarter of the rotors, 0 to 0.25 kg", ur5_like(), (0.0, 0.25), 1.25, 0.05),
    ("UR5-like, a quarter of the rotors, 4.75 to 5 kg", ur5_like(), (4.75, 5.0), 1.25, 0.05),
]
# states that one tube of joint speeds does not close: bounded with the help of the kinetic energy
STRONG: list[tuple[str, Model, tuple[float, float], float, float]] = [
    ("UR5-like, a quarter of the rotors, 4.75 to 5 kg, 2 rad/s, kinetic energy", ur5_like(), (4.75, 5.0), 2.0, 0.05),
]


def run(model: Model, payload: tuple[float, float], top: float, stops: int, seed: int, energetic: bool = False) -> dict[str, Any]:
    """One case; ``energetic``: only the states that need the kinetic energy."""
    s = StopBounds.of(model, payload).setting
    assert s is not None
    n, rng = model.n, np.random.default_rng(seed)
    r, v = s.noise.radius[:n], s.noise.radius[n:]
    angle: list[float] = []
    times, tcps = [], []
    states = certified = sampled = escaped = 0
    excess = 0.0
    while sampled < stops:
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-top, top, n)
        states += 1
        if states > 4 * max(stops // PER_STATE, 1):
            break
        tube = tube_of(s, q, dq, r, v)
        if energetic:
            if tube.end == OK:
                states -= 1
                continue
            tube = tubes_of(s, q, dq, r, v, 1)[0]
        if tube.end != OK:
            continue
        certified += 1
        tcp = point_motion(s.plant.chain, q, r, slices(tube, SLICES), n - 1, s.payload_com)[0]
        x = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, PER_STATE, seed * 1_000_003 + states)
        sampled += x.stops
        escaped += x.escaped + int(x.tcp > tcp)
        excess = max(excess, x.excess)
        ratio = tightness(tube, tcp, x, dq, np.full(n, top))
        angle += ratio.angle.tolist()
        times.append(ratio.time)
        tcps.append(ratio.tcp)

    def points(x: list[float]) -> list[float]:
        return [round(float(y), 3) for y in np.percentile(x, [5, 50, 95])] if x else []

    return {
        "states": states, "certified": certified, "stops": sampled, "escapes": escaped, "excess": excess,
        "angle": points(angle), "time": points(times), "tcp": points(tcps),
    }  # fmt: skip


def coverage(model: Model, payload: tuple[float, float], top: float, pieces: int, states: int) -> tuple[float, float]:
    """Shares of random states with a certificate of at most ``pieces`` tubes: without the kinetic energy, and with it."""
    s = StopBounds.of(model, payload).setting
    assert s is not None
    n, rng, tight, good = model.n, np.random.default_rng(77), 0, 0
    for _ in range(states):
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-top, top, n)
        tubes = tubes_of(s, q, dq, s.noise.radius[:n], s.noise.radius[n:], pieces)
        good += tubes[-1].end == OK
        tight += tubes[-1].end == OK and not any(t.energetic for t in tubes)
    return tight / states, good / states


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=1_000_000)
    parser.add_argument("--states", type=int, default=40, help="for coverage")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    results: dict[str, Any] = {}
    for seed, (name, model, payload, top, share) in enumerate([*CASES, *STRONG], 1):
        start = time.perf_counter()
        results[name] = run(model, payload, top, int(args.stops * share), seed, seed > len(CASES))
        print(f"{name}: {results[name]} {time.perf_counter() - start:.0f} s", flush=True)
    for what, arm in (("as stated", ur5_like()), ("brake times within 2.5 ms", ur5_like(delay=(0.0175, 0.0225)))):
        for top in (1.25, 1.5, 2.0):
            tight, all_ = coverage(arm, (4.75, 5.0), top, 64, args.states)
            results[f"coverage, UR5-like, a quarter of the rotors, 5 kg, {what}, {top} rad/s, 64 pieces"] = [tight, all_]
            print(
                f"UR5-like, a quarter of the rotors, 5 kg, {what}, {top} rad/s: {tight:.0%} certified by joint speeds in at most 64 "
                f"pieces, {all_:.0%} with the kinetic energy",
                flush=True,
            )
    total = sum(r["stops"] for r in results.values() if isinstance(r, dict))
    escapes = sum(r["escapes"] for r in results.values() if isinstance(r, dict))
    print(f"{total} stops, {escapes} escapes")
    if args.json:
        args.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
