"""What could sets that hold how angles, speeds and momenta belong together give the bound of a STOP 0?

    python benchmarks/stops_related_sets.py [--arms WORD ...] [--states 3] [--moments 10 20 24 28 32 40] [--hand-overs 8 4 2]

Random states of the arms of `benchmarks/stop_arms_wide.py` with their rated payload, each with its tube by the kinetic energy and 1,000
sampled stops, directed and bred.  Medians over joints in motion and over states, everything over the worst sampled stop, at moments [ms]
after the cut:

- *alone*: how far the proof goes on from single sampled states at that moment, one at a time, the farthest of them: speeds, angles and
  momenta as points, only what the stop's numbers are uncertain by still to come.  Every set that holds the states of that moment holds
  these, so none that is used up to then, related or not, leaves less.
- *so far*: how far the tube has come by then.  No better proof from that moment on leaves less.
- *box of speeds*, *and momenta, energy*: how far simulated stops go that begin anywhere in the box of the sampled states of that moment,
  any number of theirs being any other again (a search: at least).  What such boxes forget at one moment.
- *sub-chain*: how far a sub-chain's energy lets the joints go over how far all of the energy does, the best sub-chain for each joint, most
  favourable: sampled states, no Coriolis torque, nothing uncertain but brakes; none where no sub-chain is surely braked.
- signs that may be either (of the tube; of the samples, joints that rest in some count), and how wide the sampled speeds are along
  the thinnest and the widest of their principal axes, over the box's side.

``--hand-overs``: instead the states handed over as the box of angles, speeds, momenta and energy every so many milliseconds until 48 ms,
each box being the next one's start, by search: what is lost by boxes alone if each step were proved exactly.  Exit code 1 if any stop
leaves its tube.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms_wide import arms

from stop_sampling import BLOCK, DT, Farthest, Measured, compare, inverse_inertia, shares_of, stops_of
from stopset.artifact import Model
from stopset.reach.stops import StopBounds
from stopset.reach.stops.parts import ALL_PARTS
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Plant, Stride, Tube, march
from stopset.reach.stops.tubes import ENERGY_KNOTS, MORE_PATIENCE, expected_stop, march_box
from stopset.robot.rigid import gravity_torque, mass_matrix
from stopset.sets import Box
from stopset.simulation.stop import simulate_stops
from stopset.types import Array, Mask

DIRECTED, BRED = 250, 750
ALONE = 24  # single states that the proof goes on from
HAIR = 1e-6  # [rad], [rad/s] half width of a single state
FIRST, BREEDINGS = 10, 25  # blocks of a search at random, and bred
BRIEF = 5, 12  # the same of one hand-over
UNTIL = 48e-3  # [s] last hand-over
FAST = 0.2  # of full speed: slower joints move by their disturbance only
STILL = 1e-3  # [rad/s]


class Cloud(NamedTuple):
    """Sampled stops of one state: angles and speeds (count, steps + 1, n), parameters, rotors; the farthest (n,) [rad], the latest [s]."""

    q: Array
    v: Array
    pi: Array
    rotor: Array
    worst: Array
    lasts: float
    escaped: int


class Case(NamedTuple):
    """A measured state, its tube, its stops, which joints count."""

    s: Setting
    start: Start
    tube: Tube
    cloud: Cloud
    fast: Mask

    def over_worst(self, far: Array) -> float:
        """Median over joints in motion of ``far`` (n,) [rad] over the worst sampled stop."""
        return float(np.median((far / self.cloud.worst)[self.fast]))


class Known(NamedTuple):
    """What is handed over of the states of a moment."""

    q: Box
    v: Box
    p: Box
    y: float


def cloud_of(s: Setting, start: Start, tube: Tube, seed: int) -> Cloud:
    """Directed stops and more bred from the farthest, with their motion."""
    rng, n = np.random.default_rng(seed), len(start.q)
    at, W = Measured(start.q, start.dq, start.q_radius, start.dq_radius), inverse_inertia(s.plant, start.q)
    sign, found, out = np.where(start.dq >= 0.0, 1.0, -1.0), Farthest(n), []
    steps, keep, escaped, lasts = int(np.ceil(tube.t[-1] / DT)) + 2, round(0.06 / DT), 0, 0.0
    for done in range(0, DIRECTED + BRED, BLOCK):
        load, x = shares_of(np.arange(BLOCK) % 5, W, sign, rng) if done < DIRECTED else found.breed(BLOCK, rng)
        stops = stops_of(s.plant, at, load, x)
        q, v = simulate_stops(stops.arms, stops.q0, stops.v0, DT, steps, stops.u)
        held = compare(q, v, stops, tube, s.payload_com)
        found.learn(held, load, x)
        escaped, lasts = escaped + int((held.beyond > 0.0).sum()), max(lasts, float(held.time.max()))
        out.append((q[:, : keep + 1], v[:, : keep + 1], stops.arms.pi, stops.arms.rotor))
    q, v, pi, rotor = (np.concatenate(rows) for rows in zip(*out, strict=True))
    return Cloud(q, v, pi, rotor, np.maximum(found.score[:n], found.score[n : 2 * n]), lasts, escaped)


def case_of(model: Model, s: Setting, top: Array, rng: np.random.Generator, seed: int) -> Case | None:
    """A random state up to full speed; none without a tube."""
    n = model.n
    start = Start(rng.uniform(-np.pi, np.pi, n), rng.uniform(-top, top), s.noise.radius[:n], s.noise.radius[n:])
    tube = march_box(s, s.plant, start, energetic=True)
    if tube.end != OK:
        return None
    return Case(s, start, tube, cloud_of(s, start, tube, seed), np.abs(start.dq) > FAST * top)


def later(plant: Plant, t: float) -> Plant:
    """The plant as it is ``t`` seconds after the cut."""
    return plant._replace(delay_lo=plant.delay_lo - t, delay_hi=plant.delay_hi - t)


def momenta(s: Setting, q: Array, v: Array, pi: Array, rotor: Array) -> tuple[Array, Array]:
    """(count, n) momenta and (count,) roots of twice the energy of states."""
    p = np.array([mass_matrix(s.plant.chain, pi[k], q[k]) @ v[k] + rotor[k] * v[k] for k in range(len(q))])
    return p, np.sqrt((p * v).sum(axis=1))


def known_at(c: Case, step: int) -> Known:
    """Hull of the sampled states at a moment."""
    q, v = c.cloud.q[:, step], c.cloud.v[:, step]
    p, y = momenta(c.s, q, v, c.cloud.pi, c.cloud.rotor)
    return Known(Box(q.min(0), q.max(0)), Box(v.min(0), v.max(0)), Box(p.min(0), p.max(0)), float(y.max()))


def alone(c: Case, step: int, rng: np.random.Generator) -> Array:
    """(n,) [rad] how far the proof goes from single sampled states of a moment."""
    far, p = np.zeros(len(c.start.q)), c.s.plant
    lasts, knots = expected_stop(p, c.start.q, c.start.fastest), ENERGY_KNOTS
    closes, plant = float((p.delay_hi + p.rise_hi).max() - p.delay_lo.min()), later(p, step * DT)
    stride = Stride(lasts / knots.stop, knots.stop * MORE_PATIENCE + knots.closing, closes / knots.closing)
    for k in rng.choice(len(c.cloud.q), ALONE, replace=False):
        q, v, gone = c.cloud.q[k, step], c.cloud.v[k, step], c.cloud.q[k, : step + 1] - c.cloud.q[k, 0]
        tube = march(plant, Box(q - HAIR, q + HAIR), Box(v - HAIR, v + HAIR), stride, ALL_PARTS, energetic=True)
        on = np.maximum((gone[-1] + tube.d_hi).max(axis=0), -(gone[-1] + tube.d_lo).min(axis=0))
        far = np.maximum(far, np.maximum(on, np.abs(gone).max(axis=0)))
    return far


class Search:
    """Stops that begin anywhere in what is known of a moment, bred towards each of some scores."""

    def __init__(self, c: Case, known: Known, t: float, *, related: bool) -> None:
        self.c, self.known, self.related, self.plant = c, known, related, later(c.s.plant, t)
        middle = 0.5 * (known.q.lo + known.q.hi)
        self.M = mass_matrix(c.s.plant.chain, c.s.plant.pi, middle) + np.diag(c.s.plant.rotor)
        self.W, self.sign = np.linalg.inv(self.M), np.where(c.start.dq >= 0.0, 1.0, -1.0)
        self.at = Measured(middle, np.zeros_like(middle), 0.5 * (known.q.hi - known.q.lo), np.zeros_like(middle))

    def speeds(self, along: Array) -> Array | None:
        """The speeds of what is known that are farthest along a direction."""
        v, p = self.known.v, self.known.p
        if not self.related:
            return np.where(along > 0.0, v.hi, v.lo)
        rows, ends = np.vstack([self.M, -self.M]), np.r_[p.hi, -p.lo]
        x = linprog(-along, A_ub=rows, b_ub=ends, bounds=np.column_stack([v.lo, v.hi]), method="highs")
        if x.status != 0:
            return None
        y = float(np.sqrt(x.x @ self.M @ x.x))
        return np.asarray(x.x * min(1.0, self.known.y / max(y, 1e-12)))

    def directions(self, rng: np.random.Generator) -> Array:
        """(BLOCK, n): of one speed, one momentum, what pushes one joint most, or any."""
        n = len(self.sign)
        kinds = [np.eye(n), self.M / np.abs(self.M).max(axis=1)[:, None], self.W / np.abs(self.W).max(axis=1)[:, None]]
        rows = [
            kinds[k][rng.integers(n)] * rng.choice([-1.0, 1.0]) if k < 3 else rng.normal(size=n)
            for k in rng.integers(0, 4, BLOCK)
        ]
        return np.array(rows) + 1e-3 * rng.normal(size=(BLOCK, n))

    def run(self, steps: int, score: Callable[[Array, Array, Array, Array], Array], blocks: tuple[int, int], seed: int) -> Array:
        """The largest of each of the scores (count, m) of angles, speeds, parameters and rotors of stops of so many steps."""
        rng, best, kept = np.random.default_rng(seed), None, []
        for block in range(sum(blocks)):
            if best is None or block < blocks[0]:
                (load, x), along = shares_of(np.arange(BLOCK) % 5, self.W, self.sign, rng), self.directions(rng)
            else:
                parents = [kept[k] for k in rng.integers(0, len(kept), BLOCK)]
                load, x, along = (np.array(rows) for rows in zip(*parents, strict=True))
                change = rng.random(x.shape) < 2.0 ** rng.integers(0, 6, (BLOCK, 1, 1)) / x[0].size
                x, size = np.where(change, np.round(1.0 - x), x), np.abs(along).mean(axis=1, keepdims=True)
                turned = rng.random((BLOCK, 1)) < 0.6
                along = along + turned * rng.normal(size=along.shape) * size * 2.0 ** rng.integers(-3, 2, (BLOCK, 1))
            begins = [self.speeds(row) for row in along]
            good = [k for k, v in enumerate(begins) if v is not None]
            if not good:
                continue
            load, x, along = load[good], x[good], along[good]
            stops = stops_of(self.plant, self.at, load, x)
            q, v = simulate_stops(stops.arms, stops.q0, np.array([begins[k] for k in good]), DT, steps, stops.u)
            scores = score(q, v, stops.arms.pi, stops.arms.rotor)
            if best is None:
                best, kept = np.full(scores.shape[1], -np.inf), [(load[0], x[0], along[0])] * scores.shape[1]
            for m, k in enumerate(np.argmax(scores, axis=0)):
                if scores[k, m] > best[m]:
                    best[m], kept[m] = scores[k, m], (load[k], x[k], along[k])
        assert best is not None
        return best


def travel(q: Array, _v: Array, _pi: Array, _rotor: Array) -> Array:
    """Forward and back of each joint."""
    d = q - q[:, :1]
    return np.hstack([d.max(axis=1), -d.min(axis=1)])


def from_known(c: Case, known: Known, t: float, *, related: bool) -> Array:
    """(n,) [rad] how far stops go from the angles at the cut that begin anywhere in what is known of a moment (at least)."""
    n = len(c.start.q)
    steps = int(min(c.tube.t[-1], 2.0 * c.cloud.lasts) / DT)
    ways = Search(c, known, t, related=related).run(steps, travel, (FIRST, BREEDINGS), 5)
    return np.maximum(known.q.hi - c.start.q + ways[:n], c.start.q - known.q.lo + ways[n:])


def handed_over(c: Case, every: float) -> float:
    """Over the worst sampled stop: states as boxes, each found by search from the one before, every so many seconds."""
    known, t, n = known_at(c, 0), 0.0, len(c.start.q)

    def ends(q: Array, v: Array, pi: Array, rotor: Array) -> Array:
        p, y = momenta(c.s, q[:, -1], v[:, -1], pi, rotor)
        return np.hstack([q[:, -1], -q[:, -1], v[:, -1], -v[:, -1], p, -p, y[:, None]])

    far = np.zeros(n)
    while t < UNTIL - 1e-9:
        x = Search(c, known, t, related=True).run(round(every / DT), ends, BRIEF, 3)
        up = [x[k * n : (k + 1) * n] for k in range(6)]
        known, t = Known(Box(-up[1], up[0]), Box(-up[3], up[2]), Box(-up[5], up[4]), float(x[-1])), t + every
        far = np.maximum(far, np.maximum(known.q.hi - c.start.q, c.start.q - known.q.lo))
    return c.over_worst(np.maximum(far, from_known(c, known, t, related=True)))


def sub_chains(c: Case, step: int) -> Array:
    """(n,): way by the energy of the best sub-chain over that by all of it, which brakes surely take; infinite where none is surely braked.

    Zero where only the sub-chain is.  With K = M_wb M_bb^-1, a sub-chain w has the energy 1/2 v_w' S v_w beyond what the momenta of the
    rest b hold, and is braked where its brakes are stronger than `g_w - K g_b` and what K makes of the rest's brakes: of known sign where
    these move one way in all samples.
    """
    p, v, t, n = c.s.plant, c.cloud.v[:, step], step * DT, len(c.start.q)
    q = c.cloud.q[:, step].mean(axis=0)
    M, g = mass_matrix(p.chain, p.pi, q) + np.diag(p.rotor), gravity_torque(p.chain, p.pi, q)
    lo = p.coulomb_lo + p.brake_lo * np.clip((t - p.delay_hi) / p.rise_hi, 0.0, 1.0)
    hi = p.coulomb_hi + p.brake_hi * np.clip((t - p.delay_lo) / p.rise_lo, 0.0, 1.0)
    f_lo, f_hi = np.where((v > STILL).all(axis=0), lo, -hi), np.where((v < -STILL).all(axis=0), -lo, hi)
    best = np.full(n, np.inf)
    for w in (list(w) for m in range(1, n) for w in combinations(range(n), m)):
        b = [j for j in range(n) if j not in w]
        K = np.linalg.solve(M[np.ix_(b, b)], M[np.ix_(b, w)]).T
        S = M[np.ix_(w, w)] - K @ M[np.ix_(b, w)]
        pushed = np.abs(g[w] - K @ (g[b] + 0.5 * (f_lo + f_hi)[b])) + np.abs(K) @ (0.5 * (f_hi - f_lo)[b])
        left = lo[w] - pushed
        if (left > 0.0).all():
            energy = float(((v[:, w] @ S) * v[:, w]).sum(axis=1).max())
            best[w] = np.minimum(best[w], energy / left)
    whole, own = float(((v @ M) * v).sum(axis=1).max()), lo - np.abs(g)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(best * np.maximum(own, 0.0) / whole, nan=np.inf, posinf=np.inf)


class Row(NamedTuple):
    """What one state says at one moment."""

    alone: float
    so_far: float
    box: float
    related: float
    sub_chain: float
    signs: float
    sampled_signs: float
    thinnest: float
    widest: float


def row_of(c: Case, step: int) -> Row:
    """All that is asked of one state at one moment."""
    t, known, v = step * DT, known_at(c, step), c.cloud.v[:, step]
    k = int(np.searchsorted(c.tube.t, t))
    far = np.maximum(c.tube.d_hi[: k + 1].max(axis=0), -c.tube.d_lo[: k + 1].min(axis=0))
    gone = c.cloud.q[:, : step + 1] - c.cloud.q[:, :1]
    before = np.maximum(gone.max(axis=(0, 1)), -gone.min(axis=(0, 1)))
    box, related = (np.maximum(before, from_known(c, known, t, related=x)) for x in (False, True))
    side = known.v.hi - known.v.lo
    scaled = (v - v.mean(axis=0)) / np.maximum(side, 1e-9)
    axes = np.ptp(scaled @ np.linalg.svd(scaled, full_matrices=False)[2].T, axis=0)
    either = ((known.v.lo < STILL) & (known.v.hi > -STILL)).sum()
    signs = ((c.tube.v_lo[k] <= 0.0) & (c.tube.v_hi[k] >= 0.0)).sum()
    return Row(
        c.over_worst(np.maximum(before, alone(c, step, np.random.default_rng(step)))), c.over_worst(far), c.over_worst(box),
        c.over_worst(related), float(np.median(sub_chains(c, step)[c.fast])), float(signs), float(either), axes.min(), axes.max(),
    )  # fmt: skip


def show(name: str, cases: list[Case], moments: list[float], every: list[float]) -> None:
    """Prints one arm."""
    stated = [c.over_worst(np.maximum(c.tube.d_hi.max(axis=0), -c.tube.d_lo.min(axis=0))) for c in cases]
    print(f"{name}, {len(cases)} states: the tube {np.median(stated):.2f} times the worst sampled stop", flush=True)
    for ms in every:
        over = [handed_over(c, 1e-3 * ms) for c in cases]
        print(f"  boxes handed over every {ms:g} ms: {np.median(over):.2f} ({min(over):.2f} to {max(over):.2f})", flush=True)
    for ms in [] if every else moments:
        r = Row(*np.median([row_of(c, round(1e-3 * ms / DT)) for c in cases], axis=0))
        print(
            f"  {ms:g} ms: alone {r.alone:.2f}, so far {r.so_far:.2f}, box of speeds {r.box:.2f}, and momenta, energy {r.related:.2f}, "
            f"sub-chain {r.sub_chain:.2f}, signs {r.signs:.0f} and {r.sampled_signs:.0f}, axes {r.thinnest:.2f} and {r.widest:.2f}",
            flush=True,
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--arms",
        nargs="*",
        default=["6 joints, 0", "6 joints, 2", "7 joints, 0", "7 joints, 1"],
        help="with one of these in their name",
    )
    parser.add_argument("--states", type=int, default=3)
    parser.add_argument("--moments", type=float, nargs="*", default=[10, 20, 24, 28, 32, 40], help="[ms] after the cut, up to 50")
    parser.add_argument("--hand-overs", type=float, nargs="*", default=[], help="[ms]")
    args = parser.parse_args()
    escapes = 0
    if not any(word in name for name in arms() for word in args.arms):
        parser.error(f"no arm is called by {' or '.join(args.arms)}; expected words of names as in docs/stops.md")
    for name, (model, top) in arms().items():
        if not any(word in name for word in args.arms):
            continue
        load, rng = model.domain.payload[1], np.random.default_rng(77)
        s = StopBounds.of(model, (0.98 * load, load)).setting
        assert s is not None and s.torques.settled
        found = [case_of(model, s, top, rng, k) for k in range(args.states)]
        cases = [c for c in found if c is not None]
        show(f"{name}, {load:.3g} kg", cases, args.moments, args.hand_overs)
        escapes += sum(c.cloud.escaped for c in cases)
    print(f"{escapes} stops left their tube")
    return int(escapes > 0)


if __name__ == "__main__":
    sys.exit(main())
