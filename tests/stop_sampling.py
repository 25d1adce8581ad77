"""Try to break a stop bound: many stops of the nonlinear coupled arm, parameters where they hurt, every half millisecond held
against the tube.

The stops are drawn by `stopset.simulation.stop`, which shares no line with the bound.  Besides random corners there are
directed ones: a joint slow (or fast) in everything of its own, and the others' brakes as the inverse inertia says they
hurt it most.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stopset.reach.stops.cartesian import Slices, reached
from stopset.reach.stops.tube import Plant, Tube
from stopset.reach.stops.tubes import stopped_after
from stopset.robot.rigid import Chain, link_frames, mass_matrix
from stopset.simulation.stop import StoppingArm, simulate_stop
from stopset.types import Array

DT = 0.5e-3  # [s] between checks, and the step of the simulation
PIECES = 8  # of the horizon, with a constant disturbance each
# The simulation errs by O(dt^2): against dt / 16 its worst difference over 2000 stops of the reference arm was
# 1.0e-6 rad and 6e-4 rad/s, the latter at brake onset and rest only (see benchmarks).
ANGLE_ERROR = 2e-6  # [rad]
SPEED_ERROR = 1e-3  # [rad/s]


def point_motion(chain: Chain, q: Array, q_radius: Array, parts: Slices, link: int, point: Array) -> tuple[float, float, Array]:
    """How far [m] and how fast [m/s] one point of a link can get, and the box (3, 2) [m] of its displacements."""
    (found,) = reached(chain, q, q_radius, parts, [link], [point])
    return found.far, found.fast, found.box


class Samples(NamedTuple):
    """Worst of the sampled stops from one state: escapes, angles both ways [rad], times [s], TCP displacement [m]."""

    stops: int
    escaped: int
    forward: Array
    back: Array
    time: Array
    tcp: float
    excess: float  # largest distance outside the tube, in widths of nothing: [rad] or [rad/s], 0 if none


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


def _pick(lo: Array, hi: Array, share: Array) -> Array:
    return lo + (hi - lo) * share


def _shares(kind: int, n: int, rng: np.random.Generator) -> Array:
    return np.asarray(rng.integers(0, 2, n) * 1.0 if kind == 0 else rng.random(n))


class Draw(NamedTuple):
    """One arm out of a plant's intervals: constants of a stop, and a disturbance (PIECES, n) [N m]; ``ahead``: (n,) +1 where
    the joint was drawn to go far, -1 where to stop short, 0 where neither."""

    pi: Array
    rotor: Array
    F: Array
    D: Array
    B: Array
    delay: Array
    rise: Array
    u: Array
    ahead: Array


def draw(plant: Plant, kind: int, sign: Array, W: Array, rng: np.random.Generator) -> Draw:
    """Kinds 0: any corner; 1: anywhere inside; 2: all joints slow but one; 3: slow or fast joints; 4: one joint slow or fast,
    and the rest as the inverse inertia ``W`` says it hurts this one most. ``sign``: (n,) direction of motion."""
    n = sign.shape[0]
    load = float(rng.integers(0, 2)) if kind != 1 else rng.random()
    pi = plant.pi + (2.0 * load - 1.0) * plant.pi_half
    rotor = _pick(plant.rotor - plant.rotor_half, plant.rotor + plant.rotor_half, _shares(min(kind, 1), n, rng))
    u = np.empty((PIECES, n))
    if kind <= 1:
        for p in range(PIECES):
            u[p] = _pick(plant.u_lo, plant.u_hi, _shares(kind, n, rng))
        return Draw(
            pi, rotor, _pick(plant.coulomb_lo, plant.coulomb_hi, _shares(kind, n, rng)),
            _pick(plant.viscous_lo, plant.viscous_hi, _shares(kind, n, rng)), _pick(plant.brake_lo, plant.brake_hi, _shares(kind, n, rng)),
            _pick(plant.delay_lo, plant.delay_hi, _shares(kind, n, rng)), _pick(plant.rise_lo, plant.rise_hi, _shares(kind, n, rng)),
            u, np.zeros(n),
        )  # fmt: skip
    slow = _shares(0, n, rng)
    if kind == 2:
        slow[:] = 1.0
        slow[rng.integers(n)] = float(rng.integers(0, 2))
    elif kind == 4:
        j = rng.integers(n)
        slow[j] = float(rng.integers(0, 2))
        along = slow[j] * 2.0 - 1.0
        for i in range(n):
            if i != j:
                slow[i] = 1.0 if along * W[j, i] * sign[i] * sign[j] > 0.0 else 0.0
    ahead = sign * (2.0 * slow - 1.0)
    for p in range(PIECES):
        u[p] = np.where(ahead > 0.0, plant.u_hi, plant.u_lo)
    return Draw(
        pi, rotor, _pick(plant.coulomb_hi, plant.coulomb_lo, slow), _pick(plant.viscous_hi, plant.viscous_lo, slow),
        _pick(plant.brake_hi, plant.brake_lo, slow), _pick(plant.delay_lo, plant.delay_hi, slow),
        _pick(plant.rise_lo, plant.rise_hi, slow), u, ahead,
    )  # fmt: skip


def inverse_inertia(plant: Plant, q: Array) -> Array:
    """(n, n): of the arm with rotors and the middle payload."""
    return np.asarray(np.linalg.inv(mass_matrix(plant.chain, plant.pi, q) + np.diag(plant.rotor)))


def start_of(
    d: Draw, kind: int, q: Array, dq: Array, q_radius: Array, dq_radius: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """A true state behind the measured one: at its corners, or anywhere for kind 1."""
    n = q.shape[0]
    q0 = q + q_radius * (2.0 * _shares(kind if kind <= 1 else 0, n, rng) - 1.0)
    if kind <= 1:
        return q0, dq + dq_radius * (2.0 * _shares(kind, n, rng) - 1.0)
    return q0, dq + dq_radius * d.ahead


def sample_stops(
    plant: Plant, q: Array, dq: Array, q_radius: Array, dq_radius: Array, tip: Array, tube: Tube, count: int, seed: int
) -> Samples:
    """Simulate ``count`` stops from the box around (q, dq) and hold each against ``tube`` every `DT` seconds."""
    rng = np.random.default_rng(seed)
    n = q.shape[0]
    steps = int(np.ceil(tube.t[-1] / DT)) + 2
    times = np.linspace(0.0, steps * DT, steps + 1)
    dl, dh, vl, vh = tube_at(tube, times)
    forward, back, time = np.zeros(n), np.zeros(n), np.zeros(n)
    tcp, excess, escaped = 0.0, 0.0, 0
    W = inverse_inertia(plant, q)
    sign = np.where(dq >= 0.0, 1.0, -1.0)
    for s in range(count):
        kind = s % 5
        x = draw(plant, kind, sign, W, rng)
        q0, v0 = start_of(x, kind, q, dq, q_radius, dq_radius, rng)
        qs, vs = simulate_stop(
            StoppingArm(plant.chain, x.pi, x.rotor, x.F, x.D, x.B, x.delay, x.rise), q0, v0, DT, steps, x.u
        )  # fmt: skip
        R, o = link_frames(plant.chain, np.vstack([q0[None], qs[::8], qs[-1:]]))
        p = o[:, -1] + R[:, -1] @ tip
        d = qs - q0
        forward, back = np.maximum(forward, d.max(axis=0)), np.maximum(back, -d.min(axis=0))
        moves = np.abs(vs) > SPEED_ERROR
        time = np.maximum(time, np.where(moves, times[:, None], 0.0).max(axis=0))
        beyond = max(
            float(np.maximum(d - dh, dl - d).max()) - ANGLE_ERROR, float(np.maximum(vs - vh, vl - vs).max()) - SPEED_ERROR
        )
        tcp = max(tcp, float(np.linalg.norm(p[1:] - p[0], axis=1).max()))
        if not beyond <= 0.0:
            escaped, excess = escaped + 1, max(excess, beyond)
    return Samples(count, escaped, forward, back, time, tcp, excess)


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
