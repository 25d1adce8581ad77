"""The FMU's STOP 0 bound in Python: two proofs for the coupled arm, the smaller bound of each joint counts.

*Accelerations.*  At almost every time the joints split into moving and resting ones, ``M_ff a_f = r_f``.  Where the comparison
matrix of ``M`` (least diagonal, largest off-diagonal) is an M-matrix, its inverse times ``|r|`` bounds ``|a|`` for every
split; coupling then is a torque among others, and each speed obeys a one-sided comparison with reflection at zero.
*Energy.*  ``y = sqrt(v' M v)`` obeys ``y dy/dt <= sum w_i |v_i|``, ``w_i = |g_i| + |u_i| - F_i - b_i(t)``: Coriolis torque does
no work and coupling is inside ``M``.  Loose, but it does not fail where coupling is strong.

Looser than `stopset.reach.stops`, and small enough to run inside a simulator's step; core/stop.c is the same in C.
Domain: rigid links as in the model file, payload as set, brakes and friction within their intervals, any torque within U.
Source: stop notes of the project; Berman & Plemmons (1994), ch. 6 (M-matrices); Bernstein (1912) for slopes of M and g.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from stopset.artifact import Model
from stopset.errors import NotCovered
from stopset.reach.stops.brakes import brakes_of
from stopset.reach.stops.friction import BEYOND, Torques, misreading, torques_of
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torque, link_frames, mass_matrix
from stopset.types import Array

RAMP, CLAIMS, PIECES, STEPS = 64, 60, 40, 2000
DIFFERENCE = 1e-3  # [rad] of the slope of M; its error is below (8/6) 1e-6 of the bound of M


@dataclass(frozen=True, slots=True)
class StopData:
    """What the bound needs beyond the rigid body, (n,) each; the names of the C fields.

    ``stop_angle``, ``stop_speed``: what the effects give was computed for stops no longer and no faster than these.
    ``refusal``: why no stop is bounded, empty where one may be.
    """

    rotor: Array
    rotor_hi: Array
    brake_lo: Array
    brake_hi: Array
    brake_delay_lo: Array
    brake_delay_hi: Array
    brake_rise_lo: Array
    brake_rise_hi: Array
    dry_lo: Array
    dry_hi: Array
    viscous_hi: Array
    stop_u_lo: Array
    stop_u_hi: Array
    brake_mid: Array
    brake_delay: Array
    brake_rise: Array
    stop_angle: Array
    stop_speed: Array
    refusal: str

    def arrays(self) -> dict[str, Array]:
        """The numbers by their C names."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "refusal"}


NO_BRAKES = (
    "a STOP 0 is asked for, but the model knows no brakes; give their torque, delay and rise in robot.json and identify again"
)


def stop_refusal(model: Model) -> str:
    """Why this model's FMU bounds no stop, empty where it may."""
    if brakes_of(model) is None:
        return NO_BRAKES
    try:
        torques_of(model)
    except NotCovered as e:
        return str(e)
    misread = misreading(model)
    if misread:
        return (
            f"no stop is bounded with {', '.join(misread)}: an FMU takes positions as they are read; expected a model without "
            "misread positions: correct the joint's zero, or use the bounds of stopset stops"
        )
    return ""


def stop_data(model: Model) -> StopData:
    """Brakes, friction and disturbance of a model."""
    n = model.n
    refusal = stop_refusal(model)
    # where no stop is bounded the numbers below are never used
    brakes, torques = (None, torques_of(replace(model, effects=()))) if refusal else (brakes_of(model), torques_of(model))
    friction = torques.everywhere
    sets = model.sets.get("stop0", model.powered)
    rotor = np.array(model.rotor, float)
    # the abstraction may have found more inertia than rigid body and rotor hold: it may be there, it may not
    rigid = np.diag(mass_matrix(model.robot.chain, model.robot.pi, np.zeros(n)))
    more = np.maximum(rotor, 1.0 / np.diag(model.abstraction.Minv) - rigid)
    none = np.zeros(n)
    t, d, r = (brakes.torque, brakes.delay, brakes.rise) if brakes is not None else (None, None, None)
    return StopData(
        rotor=rotor, rotor_hi=more,
        brake_lo=t.lo if t else none, brake_hi=t.hi if t else none, brake_mid=t.centre if t else none,
        brake_delay_lo=d.lo if d else none, brake_delay_hi=d.hi if d else none, brake_delay=d.centre if d else none,
        brake_rise_lo=r.lo if r else none, brake_rise_hi=r.hi if r else none, brake_rise=r.centre if r else none,
        dry_lo=friction.dry.lo, dry_hi=friction.dry.hi, viscous_hi=friction.viscous.hi,
        stop_u_lo=sets.U.lo + friction.push.lo, stop_u_hi=sets.U.hi + friction.push.hi,
        stop_angle=np.full(n, BEYOND if torques.roaming else np.inf), stop_speed=_known_speed(torques), refusal=refusal,
    )  # fmt: skip


def _known_speed(torques: Torques) -> Array:
    """(n,) [rad/s]: the effects were evaluated up to here; a pair's torque by the other joint's speed too."""
    return torques.fastest if torques.roaming else torques.speed


@dataclass(frozen=True, slots=True)
class FmuStop:
    """Bounds of one STOP 0: ``time`` [s], ``angle`` (n,) [rad] either way, ``speed`` (n,) [rad/s], ``tcp`` [m]."""

    time: float
    angle: Array
    speed: Array
    tcp: float = 0.0


@dataclass(frozen=True, slots=True)
class _Start:
    """What does not change while claims are tried; the names of the C structure."""

    data: StopData
    T: Array  # (n, n) bound of |M_ij| over all postures [kg m^2]
    G: Array  # (n,) bound of |g_i| [N m]
    g: Array
    M: Array
    slope: Array  # (n, n, n) |dM_ij / dq_k|
    u: Array
    v: Array
    rq: Array
    rdq: Array


def over_all_postures(robot: Robot) -> tuple[Array, Array]:
    """``|M_ij|`` of the links (n, n) [kg m^2] and ``|g_i|`` (n,) [N m] that no posture exceeds."""
    n, p = robot.n, np.linalg.norm(robot.chain.p, axis=1)
    g = float(np.linalg.norm(robot.chain.gravity))
    T, G = np.zeros((n, n)), np.zeros(n)
    for k in range(n):
        far = np.array([p[i + 1 : k + 1].sum() for i in range(k + 1)])
        m, moment = abs(robot.pi[k, 0]), float(np.linalg.norm(robot.pi[k, 1:4]))
        a, b, c, d, e, f = robot.pi[k, 4:]
        spin = np.sqrt(a * a + c * c + f * f + 2 * (b * b + d * d + e * e))
        G[: k + 1] += g * (m * far + moment)
        T[: k + 1, : k + 1] += m * np.outer(far, far) + moment * (far[:, None] + far) + spin
    return T, G


def _start(model: Model, robot: Robot, q: Array, dq: Array, rq: Array, rdq: Array) -> _Start:
    n, data = model.n, stop_data(model)
    T, G = over_all_postures(robot)
    slope = np.empty((n, n, n))
    for k in range(n):
        d = np.zeros(n)
        d[k] = DIFFERENCE
        change = mass_matrix(robot.chain, robot.pi, q + d) - mass_matrix(robot.chain, robot.pi, q - d)
        slope[:, :, k] = np.abs(change) / (2 * DIFFERENCE)
    # the constant torque of the powered data may belong to the drives or to the arm: with and without it
    ends = [data.stop_u_lo, data.stop_u_hi, data.stop_u_lo - model.input.offset, data.stop_u_hi - model.input.offset]
    u = np.abs(ends).max(axis=0)
    M = mass_matrix(robot.chain, robot.pi, q)
    return _Start(data, T, G, gravity_torque(robot.chain, robot.pi, q), M, slope, u, dq, rq, rdq)


def _ramp(t: float, delay: Array, rise: Array) -> Array:
    return np.clip((t - delay) / rise, 0.0, 1.0)


def _march(x: _Start, claim: Array, fastest: Array) -> FmuStop | None:
    d, n = x.data, len(claim)
    moved = float((claim + x.rq).sum())
    slope = x.slope + ((4 * moved + 2e-6) * x.T)[:, :, None]
    wide = slope @ (claim + x.rq)
    off = np.minimum(np.abs(x.M) + wide, x.T)
    np.fill_diagonal(off, 0.0)
    least = np.maximum(np.diag(x.M) - np.diag(wide), 0.0) + d.rotor
    most = np.minimum(np.diag(x.M) + np.diag(wide), np.diag(x.T)) + d.rotor_hi
    inverse = np.linalg.inv(np.diag(least) - off)
    if np.any(inverse < 0):
        return None  # not an M-matrix: coupling too strong for this proof
    gamma = slope + 0.5 * np.transpose(slope, (2, 0, 1))
    load = np.minimum(x.G, np.abs(x.g) + x.G * moved) + x.u + (gamma @ fastest) @ fastest
    z = np.abs(x.v) + x.rdq
    angle, speed = np.zeros(n), z.copy()
    engaged = float((d.brake_delay_hi + d.brake_rise_hi).max())
    h = engaged / PIECES
    for step in range(STEPS):
        t = step * h
        torque = load + d.dry_hi + d.viscous_hi * fastest + d.brake_hi * _ramp(t + h, d.brake_delay_lo, d.brake_rise_lo)
        dry = d.dry_lo + d.brake_lo * _ramp(t, d.brake_delay_hi, d.brake_rise_hi)
        rest = np.zeros(n, bool)
        for _ in range(3):
            A = np.where(rest, 0.0, inverse @ np.where(rest, 0.0, torque))
            net = load - dry + off @ A
            rate = np.where(net > 0, net / least, net / most)
            rest |= (z == 0) & (rate <= 0)
        end = np.where(rest, 0.0, np.maximum(z + h * rate, 0.0))
        angle += 0.5 * h * (z + end)
        speed = np.maximum(speed, end)
        z = end
        if np.all(rest) and t >= engaged:
            return FmuStop(t, angle, speed)
    return None


def by_accelerations(x: _Start) -> FmuStop | None:
    """The comparison system with claims that it confirms; None where coupling or load are too strong for it."""
    claim, fastest = np.zeros(len(x.v)), np.abs(x.v) + x.rdq
    for _ in range(CLAIMS):
        out = _march(x, claim, fastest)
        if out is None or (np.all(out.angle <= claim) and np.all(out.speed <= fastest)):
            return out
        claim = np.maximum(claim, 1.02 * out.angle + 1e-9)
        fastest = np.maximum(fastest, 1.02 * out.speed + 1e-9)
    return None


def _energy_rate(load: Array, share: float, data: StopData, Mii: Array) -> float:
    w = load - data.brake_lo * share
    least = float(np.min(-w / np.sqrt(Mii)))
    return -least if least > 0 else float(np.sqrt(np.sum(np.maximum(w, 0.0) ** 2 / data.rotor)))


def _run_down(y: float, load: Array, data: StopData, Mii: Array) -> tuple[float, float, float] | None:
    """Integral of y, largest y, time to rest; None where the brakes cannot be shown to stop the arm."""
    delay = float(data.brake_delay_hi.max())
    h = (float((data.brake_delay_hi + data.brake_rise_hi).max()) - delay) / RAMP
    way, t, fastest = 0.0, 0.0, y
    for k in range(-1, RAMP):
        length = delay if k < 0 else h
        end = max(y + _energy_rate(load, max(k, 0) / RAMP, data, Mii) * length, 0.0)
        way += 0.5 * (y + end) * length
        fastest, y, t = max(fastest, end), end, t + length
    rate = _energy_rate(load, 1.0, data, Mii)
    return (way + 0.5 * y * y / -rate, fastest, t + y / -rate) if rate < 0 else None


def by_energy(x: _Start) -> FmuStop | None:
    """The power balance with claims that it confirms; None where brakes and friction do not surely hold the arm."""
    d = x.data
    Mii = np.diag(x.T) + d.rotor_hi
    energy = x.v @ (x.M + np.diag(d.rotor_hi)) @ x.v + 2 * x.rq.sum() * (np.abs(x.v) @ x.T @ np.abs(x.v))
    y0 = float(np.sqrt(energy) + np.sqrt(Mii) @ x.rdq)
    claim = np.zeros(len(x.v))
    for _ in range(CLAIMS):
        load = np.minimum(x.G, np.abs(x.g) + x.G * float((claim + x.rq).sum())) + x.u - d.dry_lo
        run = _run_down(y0, load, d, Mii)
        if run is None:
            return None
        angle = run[0] / np.sqrt(d.rotor)
        if np.all(angle <= claim):
            return FmuStop(run[2], angle, run[1] / np.sqrt(d.rotor))
        claim = np.maximum(claim, 1.02 * angle + 1e-9)
    return None


def fmu_stop(model: Model, q: Array, dq: Array, q_radius: Array, dq_radius: Array, payload: float = 0.0) -> FmuStop | None:
    """STOP 0 from the box ``q +- q_radius``, ``dq +- dq_radius`` ((n,) [rad, rad/s]); None where nothing can be proved.

    ``payload`` [kg] at the flange.
    """
    if stop_refusal(model):
        return None
    robot = model.robot.with_payload(payload, model.robot.tip)
    x = _start(model, robot, q, dq, q_radius, dq_radius)
    if np.any(x.data.rotor <= 0):
        return None
    found = [b for b in (by_accelerations(x), by_energy(x)) if b is not None]
    if not found:
        return None
    # a part in 1e9 covers the rounding of some thousand additions
    angle = np.min([b.angle for b in found], axis=0) * (1 + 1e-9)
    speed = np.min([b.speed for b in found], axis=0) * (1 + 1e-9)
    if np.any(angle > x.data.stop_angle) or np.any(speed > x.data.stop_speed):
        return None
    return FmuStop(min(b.time for b in found), angle, speed, _tcp(robot, q, q_radius, angle))


def _tcp(robot: Robot, q: Array, q_radius: Array, angle: Array) -> float:
    """Displacement of the flange [m]: each angle times the farthest the flange can be from that axis on the way."""
    R0, o = link_frames(robot.chain, q)
    tip = o[-1] + R0[-1] @ robot.tip
    R, out = np.zeros(robot.n), 0.0
    for i in range(robot.n - 1, -1, -1):
        axis = R0[i] @ robot.chain.axis[i]
        R[i] = np.linalg.norm(np.cross(axis, tip - o[i])) + R[i + 1 :] @ (angle + q_radius)[i + 1 :]
        out += R[i] * angle[i]
    # the flange never leaves the ball of its reach
    far = np.linalg.norm(robot.chain.p[1:], axis=1).sum() + np.linalg.norm(robot.tip)
    return float(min(out, 2 * far))
