"""Searches that push one stop towards its bound: CMA-ES with restarts, from the worst of random ones.

    pip install cma
    python benchmarks/stops_search.py [--arms 4] [--states 3] [--stops 3000] [--seed 1]

For random states of the arms of `benchmarks/stop_arms_wide.py`, joint by joint in turn: all that a stop may vary in (start state, payload,
friction, brakes, their times, rotors, the disturbance on eight pieces) is searched so that this joint goes as far, for its bound, as
it can, from the worst of random corners on.
Prints what share of the bound as many directed random stops and the search reach, and whether any stop leaves it (exit code 1).
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms_wide import arms

from stop_sampling import ANGLE_ERROR, DT, PIECES, sample_stops
from stopset.reach.stops.bounds import StopBounds
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import march_box
from stopset.simulation.stop import StoppingArm, simulate_stop
from stopset.types import Array

try:
    import cma
except ImportError:
    raise SystemExit("cma is not installed; expected it for the searches: pip install cma") from None

SPREAD = 0.1  # of a share, at a search's beginning
RESTARTS = 3


class Varied:
    """A stop as shares in [0, 1] of all that is not known, from one state."""

    def __init__(self, s: Setting, tube: Tube, q: Array, dq: Array) -> None:
        n = len(q)
        self.s, self.tube, self.q, self.dq, self.n = s, tube, q, dq, n
        self.size = 1 + (8 + PIECES) * n
        self.bound = np.stack([tube.d_hi.max(axis=0), -tube.d_lo.min(axis=0)])
        self.steps = int(np.ceil(tube.t[-1] / DT)) + 2

    def travel(self, share: Array) -> Array:
        """(2, n) [rad] forward and back."""
        p, n, r = self.s.plant, self.n, self.s.noise.radius
        x = np.clip(share, 0.0, 1.0)
        rows, u = x[1 : 1 + 8 * n].reshape(8, n), x[1 + 8 * n :].reshape(PIECES, n)
        names = ("coulomb", "viscous", "brake", "delay", "rise")
        values = [getattr(p, f"{k}_lo") + rows[i] * (getattr(p, f"{k}_hi") - getattr(p, f"{k}_lo")) for i, k in enumerate(names)]
        rotor = p.rotor + (2.0 * rows[5] - 1.0) * p.rotor_half
        arm = StoppingArm(p.chain, p.pi + (2.0 * x[0] - 1.0) * p.pi_half, rotor, *values)
        q0 = self.q + (2.0 * rows[6] - 1.0) * r[:n]
        v0 = self.dq + (2.0 * rows[7] - 1.0) * r[n:]
        qs, _ = simulate_stop(arm, q0, v0, DT, self.steps, p.u_lo + u * (p.u_hi - p.u_lo))
        return np.stack([(qs - q0).max(axis=0), (q0 - qs).max(axis=0)])

    def escaped(self, travel: Array) -> bool:
        return bool(np.any(travel > self.bound + ANGLE_ERROR))


def worst_corner(x: Varied, side: int, joint: int, count: int, rng: np.random.Generator) -> tuple[Array, int]:
    """The farthest of ``count`` stops at corners, this joint slow in everything of its own; how many leave any bound."""
    far, best, escapes = -1.0, np.full(x.size, 0.5), 0
    for _ in range(count):
        share = rng.integers(0, 2, x.size).astype(float)
        rows, u = share[1 : 1 + 8 * x.n].reshape(8, x.n), share[1 + 8 * x.n :].reshape(PIECES, x.n)
        rows[:, joint] = (0.0, 0.0, 0.0, 1.0, 1.0, rows[5, joint], rows[6, joint], 1.0 - side)
        u[:] = u[0]
        u[:, joint] = 1.0 - side
        found = x.travel(share)
        escapes += x.escaped(found)
        if found[side, joint] > far:
            far, best = float(found[side, joint]), share
    return best, escapes


def search(x: Varied, side: int, joint: int, stops: int, seed: int) -> tuple[float, int]:
    """Share of the bound that one joint reaches, and how many of some ``stops`` leave any joint's bound."""
    best, escapes = 0.0, 0
    rng = np.random.default_rng(seed)
    for restart in range(RESTARTS):
        begin, left = worst_corner(x, side, joint, stops // RESTARTS // 3, rng)
        escapes += left
        es = cma.CMAEvolutionStrategy(
            0.98 * begin + 0.01, SPREAD,
            {"bounds": [0.0, 1.0], "maxfevals": stops // RESTARTS * 2 // 3, "verbose": -9, "seed": seed * RESTARTS + restart + 1,
                "CMA_diagonal": True},
        )  # fmt: skip
        while not es.stop():
            shares = es.ask()
            found = [x.travel(np.asarray(a)) for a in shares]
            escapes += sum(x.escaped(f) for f in found)
            reached = [float(f[side, joint] / x.bound[side, joint]) for f in found]
            best = max(best, *reached)
            es.tell(shares, [-r for r in reached])
    return best, escapes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--states", type=int, default=3)
    parser.add_argument("--stops", type=int, default=3000, help="of one search")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    warnings.simplefilter("ignore")  # the search's remarks on its own progress
    escapes = 0
    for name, (model, top) in list(arms().items())[: args.arms]:
        load, n, rng = model.domain.payload[1], model.n, np.random.default_rng(args.seed)
        s = StopBounds.of(model, (0.98 * load, load)).setting
        assert s is not None
        sampled, searched = [], []
        for k in range(args.states):
            q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top
            tube = march_box(s, s.plant, Start(q, dq, s.noise.radius[:n], s.noise.radius[n:]), energetic=True)
            if tube.end != OK:
                continue
            x, joint = Varied(s, tube, q, dq), k % n
            side = int(dq[joint] < 0.0)
            random = sample_stops(s.plant, q, dq, s.noise.radius[:n], s.noise.radius[n:], s.payload_com, tube, args.stops, k)
            best, left = search(x, side, joint, args.stops, args.seed * 1000 + k)
            escapes += left + random.escaped
            sampled.append(float((random.back if side else random.forward)[joint] / x.bound[side, joint]))
            searched.append(best)
        said = (
            f"random {np.round(sampled, 3).tolist()}, searched {np.round(searched, 3).tolist()}"
            if searched
            else "no state has a bound"
        )
        print(f"{name}, {load:.3g} kg: share of the bound reached by {args.stops} stops each: {said}", flush=True)
    print(f"{escapes} stops left their bound")
    return int(escapes > 0)


if __name__ == "__main__":
    sys.exit(main())
