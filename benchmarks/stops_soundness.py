"""Soundness and tightness of STOP 0 bounds: ten million sampled stops of 24 arms light to heavy, every half millisecond inside the tube.

    python benchmarks/stops_soundness.py [--stops 10000000] [--arms WORD ...] [--box] [--kept FILE [--seconds 150]] [--json FILE]

For each arm of `stop_arms_wide` and more random ones, with no payload, the rated one and one between: random poses, speeds up to full
speed, one tube each, held against sampled stops of the nonlinear arm (directed ones, and more bred from the farthest) and compared with
the worst of them. States come in turn from all cases, so that a part of a run is a smaller run. Prints one line per case: states,
shares certified and by the kinetic energy, stops, escapes, 5/50/95 % points of bound over worst sampled. ``--box``: boxes of +-0.01 rad and
+-0.05 rad/s in the monitor's steps instead. ``--coverage``: shares with a certificate on an arm of strong coupling, and nothing else.

With ``--kept`` it is done in pieces of ``--seconds``: the file holds what was sampled and which code was; every state draws its own
numbers, so pieces give what one run gives. Other code is refused. Exit code 1: a stop escaped; 3: not done yet.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
import zlib
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms import prbt_like, uncertain_rotors, ur5_like
from stop_arms_wide import arms, random_arm

from stop_sampling import sample_stops, tightness, tool_travel
from stopset.artifact import Model
from stopset.core.library import ffi, lib
from stopset.reach.stops import StopBounds
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK
from stopset.reach.stops.tubes import tubes_of
from stopset.types import Array

ROOT = Path(__file__).resolve().parents[1]
BOX = 0.01, 0.05  # [rad], [rad/s]
PER_STATE, AT_LEAST, LASTS = 500, 125, 0.25  # stops of a state; fewer where they last longer than so many seconds
EVERY = 100_000  # stops between two looks at the whole
# random arms beside those of `arms`, 20 in all; (2, 1) and (2, 3) have upright axes alone, so brakes that hold nothing
MORE = (2, 2), (2, 4), (3, 1), (3, 2), (4, 1), (4, 2), (5, 1), (5, 2), (6, 3), (7, 3)
PAYLOADS = ("0", "rated", "between")


class Case(NamedTuple):
    """An arm, the payload [kg] known within an interval (of ``between`` another for each state), top speeds [rad/s]."""

    model: Model
    top: Array
    payload: tuple[float, float] | None

    def setting(self, rng: np.random.Generator) -> Setting:
        """What bounds of its stops rest on; a payload between is drawn."""
        if self.payload:
            return of(self)
        x, rated = rng.uniform(0.0, 0.98), self.model.domain.payload[1]
        return of(self._replace(payload=(x * rated, (x + 0.02) * rated)))

    def __hash__(self) -> int:
        return hash((id(self.model), self.payload))


@lru_cache(maxsize=200)
def of(case: Case) -> Setting:
    """Made once for each arm and payload."""
    found = StopBounds.of(case.model, case.payload).setting
    assert found is not None
    return found


def cases(words: list[str]) -> dict[str, Case]:
    """By name: those with one of these words in it."""
    every = arms() | {f"random arm of {n} joints, {k}": (random_arm(n, k), random_arm(n, k).domain.dq.hi) for n, k in MORE}
    out = {}
    for name, (model, top) in every.items():
        rated = model.domain.payload[1]
        for what, payload in zip(PAYLOADS, ((0.0, 0.0), (0.98 * rated, rated), None), strict=True):
            out[f"{name}, {what if payload is None else f'{payload[1]:.3g} kg'}"] = Case(model, top, payload)
    slow = np.full(6, 1.25)
    out["PRBT-like, 0 to 0.25 kg"] = Case(prbt_like(), slow, (0.0, 0.25))
    out["PRBT-like, rotors known to 30 %, 0 to 0.25 kg"] = Case(uncertain_rotors(), slow, (0.0, 0.25))
    out["UR5-like, heavy rotors, 0 to 0.25 kg"] = Case(ur5_like(rotor_scale=1.0), slow, (0.0, 0.25))
    return {name: case for name, case in out.items() if any(word in name for word in words)}


def code() -> str:
    """Of everything that decides a bound or a sampled stop: the core, and the Python around the proofs and the samples."""
    h = hashlib.sha256(ffi.string(lib.stopset_sources()))
    for path in (*sorted((ROOT / "model/stopset/reach/stops").glob("*.py")), ROOT / "tests/stop_sampling.py", *BENCHES):
        h.update(path.read_bytes())
    return h.hexdigest()[:16]


BENCHES = (Path(__file__), *(Path(__file__).with_name(f"{x}.py") for x in ("stop_arms", "stop_arms_wide")))
NONE: dict[str, Any] = {"states": 0, "certified": 0, "energy": 0, "stops": 0, "escapes": 0, "excess": 0.0}
LISTS = ("angle", "time", "tcp", "ms")


def one_state(name: str, case: Case, seen: dict[str, Any], box: bool) -> None:
    """The next state of a case: bounded, sampled, into ``seen``."""
    seen["states"] += 1
    seed = [zlib.crc32(name.encode()), seen["states"]]
    rng, n = np.random.default_rng(seed), case.model.n
    s = case.setting(rng)
    r, v = s.noise.radius[:n], s.noise.radius[n:]
    if box:
        r, v = r + BOX[0], v + BOX[1]
    q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * case.top
    start = time.thread_time()
    tube = tubes_of(s, Start(q, dq, r, v), 1, fast=box)[-1]
    seen["ms"].append(round(1e3 * (time.thread_time() - start), 2))
    if tube.end != OK:
        return
    seen["certified"] += 1
    seen["energy"] += int(tube.energetic)
    tcp = tool_travel(s, q, r, tube)
    stops = int(np.clip(PER_STATE * LASTS / tube.t[-1], AT_LEAST, PER_STATE))
    x = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, stops - stops // 2, int(rng.integers(2**62)), stops // 2)
    seen["stops"] += x.stops
    seen["escapes"] += x.escaped + int(x.tcp > tcp)
    seen["excess"] = max(seen["excess"], x.excess)
    ratio = tightness(tube, tcp, x, dq, case.top)
    seen["angle"] += ratio.angle.round(4).tolist()
    seen["time"].append(round(ratio.time, 4))
    seen["tcp"].append(round(ratio.tcp, 4))


def summary(seen: dict[str, Any]) -> dict[str, Any]:
    """What was counted, and 5/50/95 % points of what was compared."""
    out = {
        key: [round(float(y), 2) for y in np.percentile(x, [5, 50, 95])] if isinstance(x, list) and x else x
        for key, x in seen.items()
    }
    return out | {key: round(100.0 * seen[key] / max(seen["states"], 1), 1) for key in ("certified", "energy")}


def together(results: dict[str, Any]) -> tuple[int, int, int]:
    """Stops, escapes and states of all cases."""
    stops, escapes, states = (sum(x[key] for x in results["cases"].values()) for key in ("stops", "escapes", "states"))
    return stops, escapes, states


def sampled(wanted: dict[str, Any], words: list[str], store: Path | None, seconds: float) -> tuple[dict[str, Any], bool]:
    """Results by case, and whether all are done; those of an earlier piece are read and gone on with."""
    results: dict[str, Any] = {**wanted, "cases": {}}
    if store and store.exists():
        results = json.loads(store.read_text())
        if before := {key: results[key] for key in wanted if results[key] != wanted[key]}:
            raise SystemExit(f"{store} holds {before}; expected { {key: wanted[key] for key in before} }: name another file")
    chosen, told = cases(words), together(results)[0]
    done = told >= wanted["stops"]
    until = time.monotonic() + seconds
    while not done and time.monotonic() < until:
        for name, case in chosen.items():
            one_state(name, case, results["cases"].setdefault(name, {**NONE, **{key: [] for key in LISTS}}), wanted["box"])
        stops, escapes, states = together(results)
        done = stops >= wanted["stops"]
        if done or stops >= told + EVERY or time.monotonic() >= until:
            told = stops
            print(f"{stops} stops of {states} states, {escapes} escapes", flush=True)
            if store:
                half = store.with_suffix(".half")
                half.write_text(json.dumps(results) + "\n")
                half.replace(store)
    return results, done


def coverage(model: Model, top: float, pieces: int, states: int) -> tuple[float, float]:
    """Shares of random states with a certificate of at most ``pieces`` tubes: without the kinetic energy, and with it."""
    s = StopBounds.of(model, (4.75, 5.0)).setting
    assert s is not None
    n, rng, tight, good = model.n, np.random.default_rng(77), 0, 0
    for _ in range(states):
        q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-top, top, n)
        start = Start(q, dq, s.noise.radius[:n], s.noise.radius[n:])
        alone = tubes_of(s, start, pieces, last_resort=False)[-1].end == OK
        tight += alone
        good += alone or tubes_of(s, start, pieces)[-1].end == OK
    return tight / states, good / states


def cover() -> None:
    """Prints coverage on the arm with strong coupling."""
    for what, arm in (("as stated", ur5_like()), ("brake times within 2.5 ms", ur5_like(delay=(0.0175, 0.0225)))):
        for top in (1.25, 1.5, 2.0):
            tight, all_ = coverage(arm, top, 64, 40)
            print(
                f"{what}, {top} rad/s: {tight:.0%} certified by joint speeds in 64 pieces, {all_:.0%} with the kinetic energy",
                flush=True,
            )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stops", type=int, default=10_000_000)
    parser.add_argument("--arms", nargs="*", default=[""], help="only cases with one of these words in their name")
    parser.add_argument("--box", action="store_true")
    parser.add_argument("--coverage", action="store_true")
    parser.add_argument("--kept", dest="store", type=Path, help="go on with what this file holds, and keep there what is added")
    parser.add_argument("--seconds", type=float, default=np.inf, help="of one piece, with --kept")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    if args.coverage:
        cover()
        return 0
    wanted = {"code": code(), "stops": args.stops, "box": args.box, "arms": args.arms}
    results, done = sampled(wanted, args.arms, args.store, args.seconds)
    shown = {name: summary(x) for name, x in results["cases"].items()}
    for name, x in shown.items():
        print(f"{name}: {x}")
    stops, escapes, states = together(results)
    print(f"{stops} stops of {states} states, {escapes} escapes, code {results['code']}{'' if done else ', not done'}")
    if args.json:
        args.json.write_text(json.dumps(shown, indent=1) + "\n")
    return 1 if escapes else 0 if done else 3


if __name__ == "__main__":
    sys.exit(main())
