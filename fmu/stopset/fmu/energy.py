"""The FMU's stop bound in Python: energy of the whole arm after the power is cut (STOP 0).

With ``y = sqrt(v' M v)`` the power balance reads ``y dy/dt <= sum_i w_i |v_i|``, ``w_i = |g_i| + |u_i| - F_i - b_i(t)``: Coriolis
torque does no work and coupling is inside ``M``.  Where all ``w_i < 0``, ``dy/dt <= -min |w_i| / sqrt(M_ii)``; else
``dy/dt <= sqrt(sum w_i^2 / J_i)`` over the positive ones, because ``M >= J`` (the rotors).  Then ``|v_i| <= y / sqrt(J_i)``.
Looser than `stopset.reach.stops`, but forty lines that hold in any state, so it can run inside a simulator's step.

Domain: rigid links as in the model file, payload as set, brakes and friction within their intervals, any torque within U.
Source: stop notes of the project (energy cap); Bernstein's inequality for the slopes of M (degree 2) and g (degree 1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.reach.stops.plant import brakes_of, friction_of
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torque, link_frames, mass_matrix

Array = NDArray[np.float64]
RAMP = 64  # pieces of the brakes' rise
CLAIMS = 60  # attempts to find angles that the bound confirms


@dataclass(frozen=True, slots=True)
class StopData:
    """What the bound needs beyond the rigid body, (n,) each; see the C field of the same name."""

    rotor: Array
    rotor_hi: Array
    brake_lo: Array
    brake_delay_hi: Array
    brake_rise_hi: Array
    dry_lo: Array
    stop_u_lo: Array
    stop_u_hi: Array
    brake_mid: Array
    brake_delay: Array
    brake_rise: Array
    brakes: bool

    def arrays(self) -> dict[str, Array]:
        """The numbers by their C names."""
        names = [name for name in self.__slots__ if name != "brakes"]
        return {name: getattr(self, name) for name in names}


def stop_data(model: Model) -> StopData:
    """Brakes, friction and disturbance of a model, with the intervals' unfavourable ends."""
    n = model.n
    brakes, friction = brakes_of(model), friction_of(model)
    sets = model.sets.get("stop0", model.powered)
    u_lo, u_hi = sets.U.lo + friction.push.lo, sets.U.hi + friction.push.hi
    rotor = np.array(model.rotor, float)
    # the abstraction may have found more inertia than rigid body and rotor hold: it may be there, it may not
    identified = 1.0 / np.diag(model.abstraction.Minv)
    rigid = np.diag(mass_matrix(model.robot.chain, model.robot.pi, np.zeros(n)))
    rotor_hi = np.maximum(rotor, identified - rigid)
    if brakes is None:
        none = np.zeros(n)
        return StopData(rotor, rotor_hi, none, none, none, friction.dry.lo, u_lo, u_hi, none, none, none, False)
    t, d, r = brakes.torque, brakes.delay, brakes.rise
    return StopData(rotor, rotor_hi, t.lo, d.hi, r.hi, friction.dry.lo, u_lo, u_hi, t.centre, d.centre, r.centre, True)


@dataclass(frozen=True, slots=True)
class EnergyStop:
    """Bounds of one STOP 0: ``time`` [s], ``angle`` (n,) [rad] either way, ``speed`` (n,) [rad/s], ``tcp`` [m]."""

    time: float
    angle: Array
    speed: Array
    tcp: float


def over_all_postures(robot: Robot) -> tuple[Array, Array]:
    """Rigid-body inertia about each axis [kg m^2] and gravity torque [N m] that no posture exceeds, (n,) each."""
    n, p = robot.n, np.linalg.norm(robot.chain.p, axis=1)
    g = float(np.linalg.norm(robot.chain.gravity))
    S, G = np.zeros(n), np.zeros(n)
    for i in range(n):
        far = 0.0
        for k in range(i, n):
            far += float(p[k]) if k > i else 0.0
            m, moment = abs(robot.pi[k, 0]), float(np.linalg.norm(robot.pi[k, 1:4]))
            a, b, c, d, e, f = robot.pi[k, 4:]
            spin = np.sqrt(a * a + c * c + f * f + 2 * (b * b + d * d + e * e))
            S[i] += m * far**2 + 2 * far * moment + spin
            G[i] += g * (m * far + moment)
    return S, G


def _rate(load: Array, share: float, data: StopData, Mii: Array) -> float:
    w = load - data.brake_lo * share
    least = float(np.min(-w / np.sqrt(Mii)))
    return -least if least > 0 else float(np.sqrt(np.sum(np.maximum(w, 0.0) ** 2 / data.rotor)))


def _run_down(y: float, load: Array, data: StopData, Mii: Array) -> tuple[float, float, float] | None:
    """Integral of y, time to rest, largest y; None where the brakes cannot be shown to stop the arm."""
    delay = float(data.brake_delay_hi.max())
    h = (float((data.brake_delay_hi + data.brake_rise_hi).max()) - delay) / RAMP
    way, t, fastest = 0.0, 0.0, y
    for k in range(-1, RAMP):
        length = delay if k < 0 else h
        end = max(y + _rate(load, max(k, 0) / RAMP, data, Mii) * length, 0.0)
        way += 0.5 * (y + end) * length
        fastest, y, t = max(fastest, end), end, t + length
    slope = _rate(load, 1.0, data, Mii)
    if not slope < 0:
        return None
    return way + 0.5 * y * y / -slope, t + y / -slope, fastest


def energy_stop(model: Model, q: Array, dq: Array, q_radius: Array, dq_radius: Array, payload: float = 0.0) -> EnergyStop | None:
    """STOP 0 from the box ``q +- q_radius``, ``dq +- dq_radius`` ((n,) [rad, rad/s]); None where nothing can be proved.

    ``payload`` [kg] at the flange.
    """
    data, robot, n = stop_data(model), model.robot.with_payload(payload, model.robot.tip), model.n
    if not data.brakes or np.any(data.rotor <= 0):
        return None
    S, G = over_all_postures(robot)
    Mii = S + data.rotor_hi
    M = mass_matrix(robot.chain, robot.pi, q) + np.diag(data.rotor_hi)
    g = gravity_torque(robot.chain, robot.pi, q)
    reach = float(np.sqrt(S) @ np.abs(dq))
    y0 = float(np.sqrt(dq @ M @ dq + 2 * q_radius.sum() * reach**2) + np.sqrt(Mii) @ dq_radius)
    offset = model.input.offset
    u = np.maximum(np.abs(data.stop_u_hi - offset), np.abs(data.stop_u_lo - offset))
    claim = np.zeros(n)
    for _ in range(CLAIMS):
        load = np.minimum(G, np.abs(g) + G * float((claim + q_radius).sum())) + u - data.dry_lo
        run = _run_down(y0, load, data, Mii)
        if run is None:
            return None
        way, time, fastest = run
        angle = way / np.sqrt(data.rotor) * (1 + 1e-9)
        if np.all(angle <= claim):
            return EnergyStop(time, angle, fastest / np.sqrt(data.rotor), _tcp(robot, q, q_radius, angle))
        claim = np.maximum(claim, 1.02 * angle + 1e-9)
    return None


def _tcp(robot: Robot, q: Array, q_radius: Array, angle: Array) -> float:
    """Displacement of the flange [m]: each angle times the farthest the flange can be from that axis on the way."""
    R0, o = link_frames(robot.chain, q)
    tip = o[-1] + R0[-1] @ robot.tip
    n = robot.n
    R, out = np.zeros(n), 0.0
    for i in range(n - 1, -1, -1):
        axis = R0[i] @ robot.chain.axis[i]
        R[i] = np.linalg.norm(np.cross(axis, tip - o[i])) + R[i + 1 :] @ (angle + q_radius)[i + 1 :]
        out += R[i] * angle[i]
    return float(out)
