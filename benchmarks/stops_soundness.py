"""Soundness, coverage and tightness of STOP 0 bounds: a million sampled stops, every half millisecond inside the tube.

    python benchmarks/stops_soundness.py [--stops 1000000] [--kept FILE [--seconds 150]] [--json FILE]

Prints one line per case: states certified, stops sampled, escapes, and the 5/50/95 % points of bound over worst sampled.
A full run takes some 15 minutes on one core. With ``--kept`` it is done in pieces of ``--seconds``: the file holds what was sampled and
which code was; every state draws its own numbers, so pieces give what one run gives. Other code is refused.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms import prbt_like, uncertain_rotors, ur5_like

from stop_sampling import point_motion, sample_stops, tightness
from stop_tubes import tube_of
from stopset.artifact import Model
from stopset.core.library import ffi, lib
from stopset.reach.stops import StopBounds
from stopset.reach.stops.cartesian import SLICES, slices
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK
from stopset.reach.stops.tubes import tubes_of

ROOT = Path(__file__).resolve().parents[1]
PER_STATE = 250
Case = tuple[str, Model, tuple[float, float], float, float]
CASES: list[Case] = [  # name, model, payload, top speed, share of the stops
    ("PRBT-like, no load", prbt_like(), (0.0, 0.0), 1.26, 0.25),
    ("PRBT-like, 0 to 0.25 kg", prbt_like(), (0.0, 0.25), 1.26, 0.25),
    ("PRBT-like, 2.75 to 3 kg", prbt_like(), (2.75, 3.0), 1.26, 0.20),
    ("PRBT-like, rotors known to 30 %, 0 to 0.25 kg", uncertain_rotors(), (0.0, 0.25), 1.26, 0.05),
    ("UR5-like, 0 to 0.25 kg", ur5_like(rotor_scale=1.0), (0.0, 0.25), 1.25, 0.10),
    ("UR5-like, a quarter of the rotors, 0 to 0.25 kg", ur5_like(), (0.0, 0.25), 1.25, 0.05),
    ("UR5-like, a quarter of the rotors, 4.75 to 5 kg", ur5_like(), (4.75, 5.0), 1.25, 0.05),
]
# states that one tube of joint speeds does not close: bounded with the help of the kinetic energy
STRONG: list[Case] = [
    ("UR5-like, a quarter of the rotors, 4.75 to 5 kg, 2 rad/s, kinetic energy", ur5_like(), (4.75, 5.0), 2.0, 0.05),
]


def code() -> str:
    """Of everything that decides a bound or a sampled stop: the core, and the Python around the proofs and the samples."""
    h = hashlib.sha256(ffi.string(lib.stopset_sources()))
    for path in (*sorted((ROOT / "model/stopset/reach/stops").glob("*.py")), ROOT / "tests/stop_sampling.py", Path(__file__)):
        h.update(path.read_bytes())
    return h.hexdigest()[:16]


def run(case: Case, number: int, stops: int, seen: dict[str, Any], until: float) -> bool:
    """Sample one case on, state by state, into ``seen``; whether it is done. The last of `STRONG` take states that need the energy."""
    _, model, payload, top, share = case
    s = StopBounds.of(model, payload).setting
    assert s is not None
    n, wanted, energetic = model.n, int(stops * share), number > len(CASES)
    r, v = s.noise.radius[:n], s.noise.radius[n:]
    while seen["stops"] < wanted and seen["states"] < 4 * max(wanted // PER_STATE, 1):
        if time.monotonic() > until:
            return False
        seen["drawn"] += 1
        rng = np.random.default_rng((number, seen["drawn"]))
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-top, top, n)
        tube = tube_of(s, q, dq, r, v)
        if energetic:
            if tube.end == OK:
                continue
            tube = tubes_of(s, Start(q, dq, r, v), 1)[0]
        seen["states"] += 1
        if tube.end != OK:
            continue
        seen["certified"] += 1
        tcp = point_motion(s.plant.chain, q, r, slices(tube, SLICES), n - 1, s.payload_com)[0]
        x = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, PER_STATE, number * 1_000_003 + seen["drawn"])
        seen["stops"] += x.stops
        seen["escapes"] += x.escaped + int(x.tcp > tcp)
        seen["excess"] = max(seen["excess"], x.excess)
        ratio = tightness(tube, tcp, x, dq, np.full(n, top))
        seen["angle"] += ratio.angle.tolist()
        seen["time"].append(ratio.time)
        seen["tcp"].append(ratio.tcp)
    return True


def summary(seen: dict[str, Any]) -> dict[str, Any]:
    """What was counted, and 5/50/95 % points of what was compared."""

    def points(x: list[float]) -> list[float]:
        return [round(float(y), 3) for y in np.percentile(x, [5, 50, 95])] if x else []

    return {key: points(x) if isinstance(x, list) else x for key, x in seen.items() if key != "drawn"}


def coverage(model: Model, payload: tuple[float, float], top: float, pieces: int, states: int) -> tuple[float, float]:
    """Shares of random states with a certificate of at most ``pieces`` tubes: without the kinetic energy, and with it."""
    s = StopBounds.of(model, payload).setting
    assert s is not None
    n, rng, tight, good = model.n, np.random.default_rng(77), 0, 0
    for _ in range(states):
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-top, top, n)
        start = Start(q, dq, s.noise.radius[:n], s.noise.radius[n:])
        alone = tubes_of(s, start, pieces, last_resort=False)[-1].end == OK
        tight += alone
        good += alone or tubes_of(s, start, pieces)[-1].end == OK
    return tight / states, good / states


def sampled(stops: int, store: Path | None, seconds: float) -> tuple[dict[str, Any], bool]:
    """Results by case, and whether all are done; those of an earlier piece are read and gone on with."""
    results: dict[str, Any] = {"code": code(), "stops": stops}
    if store and store.exists():
        before = json.loads(store.read_text())
        if (before["code"], before["stops"]) != (results["code"], stops):
            was = f"{before['stops']} stops of code {before['code']}"
            raise SystemExit(f"{store} holds {was}; expected {stops} of {results['code']}: name another file")
        results = before
    until, done = time.monotonic() + (seconds if store else np.inf), True
    for number, case in enumerate([*CASES, *STRONG], 1):
        none = {
            "drawn": 0,
            "states": 0,
            "certified": 0,
            "stops": 0,
            "escapes": 0,
            "excess": 0.0,
            "angle": [],
            "time": [],
            "tcp": [],
        }
        seen = results.setdefault(case[0], none)
        done &= run(case, number, stops, seen, until)
        print(f"{case[0]}: {summary(seen)}", flush=True)
        if store:
            store.write_text(json.dumps(results) + "\n")
        if not done:
            break
    return results, done


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=1_000_000)
    parser.add_argument("--states", type=int, default=40, help="for coverage; 0: none")
    parser.add_argument("--kept", dest="store", type=Path, help="go on with what this file holds, and keep there what is added")
    parser.add_argument("--seconds", type=float, default=150.0, help="of one piece, with --kept")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    results, done = sampled(args.stops, args.store, args.seconds)
    cases = {name: summary(x) for name, x in results.items() if isinstance(x, dict)}
    total, escapes = (sum(x[key] for x in cases.values()) for key in ("stops", "escapes"))
    print(f"{total} stops, {escapes} escapes of code {results['code']}{'' if done else ', not done'}", flush=True)
    if not done:
        raise SystemExit(3)
    shares: dict[str, Any] = {}
    for what, arm in (("as stated", ur5_like()), ("brake times within 2.5 ms", ur5_like(delay=(0.0175, 0.0225)))):
        for top in (1.25, 1.5, 2.0) if args.states else ():
            tight, all_ = coverage(arm, (4.75, 5.0), top, 64, args.states)
            shares[f"coverage, UR5-like, a quarter of the rotors, 5 kg, {what}, {top} rad/s, 64 pieces"] = [tight, all_]
            print(
                f"UR5-like, a quarter of the rotors, 5 kg, {what}, {top} rad/s: {tight:.0%} certified by joint speeds in at most 64 "
                f"pieces, {all_:.0%} with the kinetic energy",
                flush=True,
            )
    if args.json:
        args.json.write_text(json.dumps(cases | shares, indent=1) + "\n")


if __name__ == "__main__":
    main()
