"""Try to break a stop bound: many stops of the nonlinear coupled arm, parameters where they hurt, every half millisecond held
against the tube.

The stops are drawn by `stopset.simulation.stop`, which shares no line with the bound.  Besides random corners there are
directed ones: a joint slow (or fast) in everything of its own, and the others' brakes as the inverse inertia says they
hurt it most.  And there are bred ones: the farthest so far, with something changed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stopset.reach.stops.cartesian import SLICES, Slices, reached, slices
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.swiftness import swiftness
from stopset.reach.stops.tube import Plant, Tube
from stopset.reach.stops.tubes import stopped_after
from stopset.robot.rigid import Chain, link_frames, mass_matrix
from stopset.simulation.stop import StoppingArm, simulate_stops
from stopset.types import Array, Index

DT = 0.5e-3  # [s] between checks, and the step of the simulation
POSES = 60  # of a stop, at which the TCP is looked at, or every eighth step
PIECES = 8  # of the horizon, with a constant disturbance each
# The simulation errs by O(dt^2): against dt / 16 its worst difference over 2000 stops of the reference arm was
# 1.0e-6 rad and 6e-4 rad/s, the latter at brake onset and rest only (see benchmarks).
ANGLE_ERROR = 2e-6  # [rad]
SPEED_ERROR = 1e-3  # [rad/s]


def point_motion(
    chain: Chain, q: Array, q_radius: Array, parts: Slices, link: int, point: Array, swift: float = 0.0
) -> tuple[float, float, Array]:
    """How far [m] and how fast [m/s] one point of a link of this `swiftness` can get, and the box (3, 2) [m] of its displacements."""
    (found,) = reached(chain, q, q_radius, parts, [link], [point], np.array([swift]))
    return found.far, found.fast, found.box


def tool_travel(s: Setting, q: Array, q_radius: Array, tube: Tube) -> float:
    """How far [m] the tool can get in a tube, as bounds say it."""
    link = len(q) - 1
    cut, swift = slices(tube, SLICES), swiftness(s.plant, link, s.payload_com)
    return point_motion(s.plant.chain, q, q_radius, cut, link, s.payload_com, swift)[0]


class Samples(NamedTuple):
    """Worst of the sampled stops from one state: escapes, angles both ways [rad], times [s], TCP displacement [m]."""

    stops: int
    escaped: int
    forward: Array
    back: Array
    time: Array
    tcp: float
    excess: float  # largest distance outside the tube, in widths of nothing: [rad] or [rad/s], 0 if none
    farthest: Farthest


def tube_at(tube: Tube, times: Array) -> tuple[Array, Array, Array, Array]:
    """Bounds of displacement and speed at ``times`` (T,), exactly as the tube means them between its knots."""
    k = np.clip(np.searchsorted(tube.t, times, side="right") - 1, 0, len(tube.t) - 2)
    h = np.diff(tube.t)[k][:, None]
    s = np.clip(times[:, None] - tube.t[k][:, None], 0.0, h)
    out = []
    for d, v, e, side in ((tube.d_lo, tube.v_lo, tube.e_lo, -1.0), (tube.d_hi, tube.v_hi, tube.e_hi, 1.0)):
        a, b = v[k], e[k]
        a = np.where((side * a < 0.0) & (side * b >= 0.0), b, a)  # the bound may cross zero at once and stay there
        out += [d[k] + s * (a + 0.5 * (b - a) * s / h), a + (b - a) * s / h]
    return out[0], out[2], out[1], out[3]


class Measured(NamedTuple):
    """A measured state, and by what the true one may differ: (n,) each [rad], [rad/s]."""

    q: Array
    dq: Array
    q_radius: Array
    dq_radius: Array


class Stops(NamedTuple):
    """Stops out of a plant's intervals: arms, true states (count, n), disturbances (count, PIECES, n) [N m]."""

    arms: StoppingArm
    q0: Array
    v0: Array
    u: Array

    def one(self, k: int) -> tuple[StoppingArm, Array, Array, Array]:
        """Arm, true state and disturbance of one of them."""
        return StoppingArm(self.arms.chain, *(x[k] for x in self.arms[1:])), self.q0[k], self.v0[k], self.u[k]


def inverse_inertia(plant: Plant, q: Array) -> Array:
    """(n, n): of the arm with rotors and the middle payload."""
    return np.asarray(np.linalg.inv(mass_matrix(plant.chain, plant.pi, q) + np.diag(plant.rotor)))


# rows of a stop's shares: where between the ends of its interval each joint's number is
COULOMB, VISCOUS, BRAKE, DELAY, RISE, ROTOR, ANGLE, SPEED, U = range(9)


def shares_of(kinds: Index, W: Array, sign: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """(count,) of the payload's interval and (count, U + PIECES, n) of all others. Kinds 0: any corner; 1: anywhere inside; 2: all
    joints slow but one; 3: slow or fast joints; 4: one joint slow or fast, and the rest as the inverse inertia ``W`` says it hurts
    this one most. ``sign``: (n,) direction of motion."""
    count, n = len(kinds), len(sign)
    x = rng.integers(0, 2, (count, U + PIECES, n)) * 1.0
    load = rng.integers(0, 2, count) * 1.0
    inside = kinds == 1
    x[inside], load[inside] = rng.random((int(inside.sum()), U + PIECES, n)), rng.random(int(inside.sum()))
    slow, joint = x[:, DELAY].copy(), rng.integers(0, n, count)
    own = rng.integers(0, 2, count) * 1.0
    slow[kinds == 2] = 1.0
    helps = (2.0 * own - 1.0)[:, None] * W[joint] * sign[joint, None] * sign > 0.0
    slow[kinds == 4] = helps[kinds == 4]
    alone = (kinds == 2) | (kinds == 4)
    slow[alone, joint[alone]] = own[alone]
    ahead = (sign * (2.0 * slow - 1.0) + 1.0) / 2.0
    for row, share in (
        (COULOMB, 1.0 - slow),
        (VISCOUS, 1.0 - slow),
        (BRAKE, 1.0 - slow),
        (DELAY, slow),
        (RISE, slow),
        (SPEED, ahead),
    ):
        x[kinds >= 2, row] = share[kinds >= 2]
    x[kinds >= 2, U:] = ahead[kinds >= 2, None]
    return load, x


def stops_of(plant: Plant, at: Measured, load: Array, x: Array) -> Stops:
    """The stops that shares say."""

    def pick(name: str, share: Array) -> Array:
        lo, hi = getattr(plant, f"{name}_lo"), getattr(plant, f"{name}_hi")
        return np.asarray(lo + (hi - lo) * share)

    names = ("coulomb", "viscous", "brake", "delay", "rise")
    arms = StoppingArm(
        plant.chain, plant.pi + (2.0 * load - 1.0)[:, None, None] * plant.pi_half,
        plant.rotor + (2.0 * x[:, ROTOR] - 1.0) * plant.rotor_half, *(pick(name, x[:, i]) for i, name in enumerate(names)),
    )  # fmt: skip
    q0, v0 = at.q + at.q_radius * (2.0 * x[:, ANGLE] - 1.0), at.dq + at.dq_radius * (2.0 * x[:, SPEED] - 1.0)
    return Stops(arms, q0, v0, pick("u", x[:, U:]))


def draws(plant: Plant, at: Measured, kinds: Index, rng: np.random.Generator) -> Stops:
    """Stops of these kinds (`shares_of`), one of each."""
    sign = np.where(at.dq >= 0.0, 1.0, -1.0)
    return stops_of(plant, at, *shares_of(kinds, inverse_inertia(plant, at.q), sign, rng))


class Held(NamedTuple):
    """What each of some stops came to, (count, n) or (count,), and by how much it left its tube."""

    forward: Array
    back: Array
    time: Array
    tcp: Array
    beyond: Array


def hold(stops: Stops, tube: Tube, tip: Array) -> Held:
    """Simulate stops and hold each against ``tube`` every `DT` seconds."""
    steps = int(np.ceil(tube.t[-1] / DT)) + 2
    return compare(*simulate_stops(stops.arms, stops.q0, stops.v0, DT, steps, stops.u), stops, tube, tip)


def compare(qs: Array, vs: Array, stops: Stops, tube: Tube, tip: Array) -> Held:
    """Hold simulated ``stops`` (count, steps + 1, n) against ``tube``."""
    steps = qs.shape[1] - 1
    times = np.linspace(0.0, steps * DT, steps + 1)
    dl, dh, vl, vh = tube_at(tube, times)
    d = qs - stops.q0[:, None]
    forward, back = d.max(axis=1), -d.min(axis=1)
    moves = np.abs(vs) > SPEED_ERROR
    last = (steps - np.argmax(moves[:, ::-1], axis=1)) * moves.any(axis=1)
    inside = (d <= dh + ANGLE_ERROR) & (d >= dl - ANGLE_ERROR) & (vs <= vh + SPEED_ERROR) & (vs >= vl - SPEED_ERROR)
    left = ~inside.all(axis=(1, 2))
    beyond = np.zeros(len(d))
    for k in np.flatnonzero(left):
        angle, speed = np.maximum(d[k] - dh, dl - d[k]).max(), np.maximum(vs[k] - vh, vl - vs[k]).max()
        beyond[k] = max(float(angle) - ANGLE_ERROR, float(speed) - SPEED_ERROR)
    at = np.unique(np.r_[0 : int(last.max()) + 1 : max(8, int(last.max()) // POSES), last.max(), steps])
    R, o = link_frames(stops.arms.chain, qs[:, at].reshape(-1, qs.shape[2]))
    p = (o[:, -1] + R[:, -1] @ tip).reshape(len(d), len(at), 3)
    tcp = np.sqrt(((p - p[:, :1]) ** 2).sum(axis=2)).max(axis=1)
    return Held(forward, back, times[last], tcp, np.where(left & ~(beyond > 0.0), np.inf, beyond))


class Farthest:
    """Of each thing that is bounded the stop that came nearest to its bound; more are bred from these."""

    def __init__(self, n: int, rows: int = U + PIECES) -> None:
        self.score = np.full(2 * n + 2, -np.inf)
        self.load, self.shares = np.zeros(2 * n + 2), np.zeros((2 * n + 2, rows, n))

    def learn(self, found: Held, load: Array, x: Array) -> None:
        """Keep the better ones: forward and back of each joint, time, TCP."""
        scores = np.column_stack([found.forward, found.back, found.time.max(axis=1), found.tcp])
        best = np.argmax(scores, axis=0)
        better = scores[best, np.arange(len(best))] > self.score
        self.score[better] = scores[best, np.arange(len(best))][better]
        self.load[better], self.shares[better] = load[best][better], x[best][better]

    def breed(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Some number changed, of one joint or of many, at times to those of another that went far."""
        n = self.shares.shape[2]
        fore = self.score[:n] >= self.score[n : 2 * n]
        parents = np.r_[np.where(fore, np.arange(n), n + np.arange(n)), 2 * n, 2 * n + 1]  # the way each joint goes, time, TCP
        one, other = parents[rng.integers(0, len(parents), (2, count))]
        load, x = self.load[one], self.shares[one].copy()
        rate = 2.0 ** rng.integers(0, 5, (count, 1, 1)) / x[0].size
        change = rng.random(x.shape) < rate
        whole = rng.random(count) < 0.5  # the disturbance as a whole
        change[whole, U:] = change[whole, U : U + 1]
        x = np.where(change, np.where(rng.random(x.shape) < 0.8, np.round(1.0 - x), rng.random(x.shape)), x)
        mixed = (rng.random((count, 1, 1)) < 0.3) & (rng.random((count, 1, n)) < 0.5)
        x = np.where(mixed, self.shares[other], x)
        return np.where(rng.random(count) < 0.1, 1.0 - load, load), x


BLOCK, ROWS = 48, 60_000  # stops simulated together: no more than that, and their numbers stay in the cache


def sample_stops(
    plant: Plant, q: Array, dq: Array, q_radius: Array, dq_radius: Array, tip: Array, tube: Tube, count: int, seed: int,
    bred: int = 0,
) -> Samples:  # fmt: skip
    """Simulate ``count`` stops from the box around (q, dq) and ``bred`` more of the farthest of them, and hold each against ``tube``."""
    rng, n, at = np.random.default_rng(seed), len(q), Measured(q, dq, q_radius, dq_radius)
    W, sign, farthest = inverse_inertia(plant, q), np.where(dq >= 0.0, 1.0, -1.0), Farthest(n)
    time, excess, escaped, done = np.zeros(n), 0.0, 0, 0
    block = int(np.clip(ROWS * DT / (tube.t[-1] * n), 4, BLOCK))
    while done < count + bred:
        if done < count:
            load, x = shares_of(np.arange(done, min(done + block, count)) % 5, W, sign, rng)
        else:
            load, x = farthest.breed(min(block, count + bred - done), rng)
        found = hold(stops_of(plant, at, load, x), tube, tip)
        farthest.learn(found, load, x)
        done, time = done + len(x), np.maximum(time, found.time.max(axis=0))
        escaped, excess = escaped + int((found.beyond > 0.0).sum()), max(excess, float(found.beyond.max()))
    far = farthest.score
    return Samples(done, escaped, far[:n], far[n : 2 * n], time, float(far[-1]), excess, farthest)


class Tightness(NamedTuple):
    """Bound over worst sampled stop, of one state: angles of the joints that moved, time, TCP."""

    angle: Array
    time: float
    tcp: float


def tightness(tube: Tube, tcp: float, samples: Samples, dq: Array, top_speed: Array, share: float = 0.2) -> Tightness:
    """Ratios for the joints faster than ``share`` of ``top_speed`` (slower ones move by their disturbance only)."""
    angle = np.maximum(tube.d_hi.max(axis=0), -tube.d_lo.min(axis=0)) / np.maximum(
        np.maximum(samples.forward, samples.back), 1e-9
    )
    return Tightness(
        angle[np.abs(dq) > share * top_speed], float(stopped_after(tube).max() / samples.time.max()), tcp / samples.tcp
    )
