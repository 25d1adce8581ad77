"""How much of bound over worst sampled stop is that samples are not the worst? Searches that push each joint towards its bound.

    pip install cma
    python benchmarks/stops_search.py [--arms WORD ...] [--states 8] [--stops 3000] [--seed 1]

For random states of the arms of `benchmarks/stop_arms_wide.py` with their rated payload, joint by joint and both ways: all that a stop may
vary in (start state, payload, friction, brakes, their times, rotors, the disturbance on eight pieces) is searched so that this joint goes as
far as it can: directed random stops, as many more bred from the farthest, then CMA-ES with restarts from the farthest found and from corners.
Prints medians over joints in motion of bound over the farthest, after each of these, of the tool the same after the first two, and whether
any stop leaves its bound (exit code 1).  Last, the same for stops whose brakes may be any function of time between what the bound counts
with, as they are in the proof: where these go no farther, it is not that numbers are constant in a stop that the proof lacks.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms_wide import arms

from stop_sampling import (
    DT,
    PIECES,
    Farthest,
    Held,
    Measured,
    Samples,
    U,
    compare,
    hold,
    sample_stops,
    stops_of,
    tightness,
    tool_travel,
)
from stopset.reach.stops.bounds import StopBounds
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import tubes_of
from stopset.simulation.stop import simulate_stops
from stopset.types import Array

try:
    import cma
except ImportError:
    raise SystemExit("cma is not installed; expected it for the searches: pip install cma") from None

SPREADS = (0.05, 0.2, 0.3)  # of a share, where a search begins: two from the farthest found, the last from a corner
DIRECTED = 250
CHUNK, CHUNKS = 4, 20  # steps of `DT` on which a brake may take a torque of its own, from the first delay on; how many of them
FAST = 0.2  # of full speed: slower joints move by their disturbance only


def travels(s: Setting, at: Measured, tube: Tube, flat: Array) -> Held:
    """What the stops of these shares (count, 1 + rows of all joints) come to."""
    return hold(stops_of(s.plant, at, flat[:, 0], flat[:, 1:].reshape(len(flat), -1, len(at.q))), tube, s.payload_com)


def search(s: Setting, at: Measured, tube: Tube, x: Samples, place: int, stops: int, seed: int) -> tuple[float, int]:
    """How far [rad] one joint goes (``place``: forward, then back) and how many of some ``stops`` leave any bound."""
    n, escapes = len(at.q), 0
    found, rng = x.farthest, np.random.default_rng(seed)
    best = float(found.score[place])
    begins = np.tile(np.r_[found.load[place], found.shares[place].ravel()], (len(SPREADS), 1))
    begins[-1] = rng.integers(0, 2, begins.shape[1])
    for k, (begin, spread) in enumerate(zip(begins, SPREADS, strict=True)):
        options = {
            "bounds": [0.0, 1.0], "maxfevals": stops // len(SPREADS), "verbose": -9, "seed": seed * len(SPREADS) + k + 1, "CMA_diagonal": True,
        }  # fmt: skip
        es = cma.CMAEvolutionStrategy(0.98 * begin + 0.01, spread, options)
        while not es.stop():
            shares = np.array(es.ask())
            held = travels(s, at, tube, np.clip(shares, 0.0, 1.0))
            reached = (held.forward if place < n else held.back)[:, place % n]
            escapes += int((held.beyond > 0.0).sum())
            best = max(best, float(reached.max()))
            es.tell(list(shares), (-reached).tolist())
    return best, escapes


def wild(s: Setting, at: Measured, tube: Tube, load: Array, x: Array) -> Held:
    """Stops whose brakes take on each `CHUNK` any torque that is possible on all of it; the last rows of ``x`` say which."""
    p, stops = s.plant, stops_of(s.plant, at, load, x[:, : U + PIECES])
    never = stops.arms._replace(brake_torque=0.0 * stops.v0, brake_delay=stops.arms.brake_delay + 1e9)
    first, steps = int(p.delay_lo.min() / DT), int(np.ceil(tube.t[-1] / DT)) + 2
    pieces, q, v = [stops.arms.fc] * (CHUNKS + 2), [stops.q0[:, None]], [stops.v0[:, None]]
    borders = [0, first, *(first + CHUNK * np.arange(1, CHUNKS + 1)).tolist(), steps]
    for c in range(CHUNKS):
        lo = p.brake_lo * np.clip((borders[c + 2] * DT - p.delay_hi) / p.rise_hi, 0.0, 1.0)
        hi = p.brake_hi * np.clip((borders[c + 1] * DT - p.delay_lo) / p.rise_lo, 0.0, 1.0)
        pieces[c + 1] = stops.arms.fc + lo + x[:, U + PIECES + c] * np.maximum(hi - lo, 0.0)
    pieces[-1] = stops.arms.fc + stops.arms.brake_torque
    for c, dry in enumerate(pieces):
        qs, vs = simulate_stops(
            never._replace(fc=dry), q[-1][:, -1], v[-1][:, -1], DT, borders[c + 1] - borders[c], stops.u[:, :1]
        )
        q.append(qs[:, 1:])
        v.append(vs[:, 1:])
    return compare(np.concatenate(q, axis=1), np.concatenate(v, axis=1), stops, tube, s.payload_com)


def farthest_wild(s: Setting, at: Measured, tube: Tube, x: Samples, stops: int, seed: int) -> tuple[Farthest, int]:
    """The farthest of some ``stops`` of `wild`, bred from the farthest with brakes that are as they are; how many leave the bound."""
    rng, n, rows = np.random.default_rng(seed), len(at.q), U + PIECES + CHUNKS
    found, escapes = Farthest(n, rows), 0
    load, shares = x.farthest.load, np.concatenate([x.farthest.shares, np.zeros((2 * n + 2, CHUNKS, n))], axis=1)
    for k in range(stops // 48):
        if k < 8:  # brakes as soon and as hard as possible, not, or as it comes
            shares[:, U + PIECES :] = (
                k % 2 if k < 2 else rng.integers(0, 2, (2 * n + 2, 1, n)) if k < 5 else rng.integers(0, 2, (2 * n + 2, CHUNKS, n))
            )
        else:
            load, shares = found.breed(48, rng)
        held = wild(s, at, tube, load, shares)
        escapes += int((held.beyond > 0.0).sum())
        found.learn(held, load, shares)
    return found, escapes


def one_state(s: Setting, q: Array, dq: Array, top: Array, stops: int, seed: int) -> tuple[Array, int] | None:
    """(joints in motion, 4) bound over farthest after each kind of search, with a last row of the tool's; escapes; none without a bound."""
    n, r, v = len(q), s.noise.radius[: len(q)], s.noise.radius[len(q) :]
    tube = tubes_of(s, Start(q, dq, r, v), 1)[-1]
    if tube.end != OK:
        return None
    at = Measured(q, dq, r, v)
    far = tool_travel(s, q, r, tube)
    random = sample_stops(s.plant, *at, s.payload_com, tube, DIRECTED, seed)
    bred = sample_stops(s.plant, *at, s.payload_com, tube, DIRECTED, seed, stops)
    columns = [tightness(tube, far, x, dq, top, FAST) for x in (random, bred)]
    joints, escapes = np.flatnonzero(np.abs(dq) > FAST * top), random.escaped + bred.escaped
    bound, searched = np.maximum(tube.d_hi.max(axis=0), -tube.d_lo.min(axis=0)), []
    for j in joints:
        ends = [search(s, at, tube, bred, place, stops // 2, seed * 1000 + place) for place in (int(j), n + int(j))]
        escapes += sum(left for _, left in ends)
        searched.append(float(bound[j]) / max(best for best, _ in ends))
    free, left = farthest_wild(s, at, tube, bred, stops, seed)
    ways = np.maximum(free.score[:n], free.score[n : 2 * n])
    rows = np.column_stack([columns[0].angle, columns[1].angle, searched, (bound / ways)[joints]])
    return np.vstack([rows, [columns[0].tcp, columns[1].tcp, np.nan, np.nan]]), escapes + left


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", nargs="*", default=[""], help="only arms with one of these words in their name")
    parser.add_argument("--states", type=int, default=8)
    parser.add_argument("--stops", type=int, default=3000, help="of each search")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    warnings.simplefilter("ignore")  # the search's remarks on its own progress
    escapes = 0
    for name, (model, top) in arms().items():
        if not any(word in name for word in args.arms):
            continue
        load, n, rng = model.domain.payload[1], model.n, np.random.default_rng(args.seed)
        s = StopBounds.of(model, (0.98 * load, load)).setting
        assert s is not None
        rows, tools = [], []
        for k in range(args.states):
            q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top
            found = one_state(s, q, dq, top, args.stops, args.seed * 1000 + k)
            if found is None:
                continue
            rows.append(found[0][:-1])
            tools.append(found[0][-1, :2])
            escapes += found[1]
        angle, tool = np.median(np.vstack(rows), axis=0).round(2), np.median(tools, axis=0).round(2)
        print(f"{name}, {load:.3g} kg, {len(rows)} states: angle {angle.tolist()}, tool {tool.tolist()}", flush=True)
    print(f"{escapes} stops left their bound")
    return int(escapes > 0)


if __name__ == "__main__":
    sys.exit(main())
