"""What the laws look at, computed from a robot and a motion: one `Signals` per joint."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from stopset.effects.base import REFERENCE_TEMPERATURE, Signals
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques, mass_matrix, regressors, torques
from stopset.types import Array

_STEP = 1e-4  # [rad] central difference of the gravity torque: error ~ step^2 = 1e-8 of the torque, rounding 1e-12


@dataclass(frozen=True, slots=True)
class Samples:
    """A motion, (N, n) each in time order: ``q, dq, ddq`` [rad, rad/s, rad/s^2], accelerations zero if left out.

    ``temp`` (N, n) [degC]; ``warm``: place in the session, 0 to 1; ``t`` (N,) [s], which laws with memory and ``dtau`` need.
    """

    q: Array
    dq: Array
    ddq: Array | None = None
    temp: Array | None = None
    warm: float = 0.0
    t: Array | None = None


def arm_signals(robot: Robot, samples: Samples, needs: Collection[str] = ()) -> tuple[Signals, ...]:
    """Signals of every joint; ``needs``: which of the rigid-body signals to compute (all, if empty), for speed."""
    q, dq, temp, warm, t = samples.q, samples.dq, samples.temp, samples.warm, samples.t
    ddq = np.zeros_like(q) if samples.ddq is None else samples.ddq
    chain, pi, n = robot.chain, robot.pi, robot.n
    want = set(needs) or {"load", "tau", "dtau", "link", "tip", "tilt", "stiff", "inertia", "coriolis"}
    zero = np.zeros_like(q)
    load = gravity_torques(chain, pi, q) if want & {"load", "coriolis"} else zero
    link = torques(chain, pi, q, dq, ddq) if want & {"tau", "dtau", "link"} else zero
    tau = link + robot.rotor * ddq
    dtau = np.gradient(tau, t, axis=0) if t is not None and "dtau" in want and len(t) > 1 else zero
    coriolis = torques(chain, pi, q, dq, zero) - load if "coriolis" in want else zero
    tip = regressors(chain, q, dq, ddq)[:, :, -10:] if "tip" in want else np.zeros((len(q), n, 10))
    tilt = _tilt(robot, q) if "tilt" in want else np.zeros((len(q), n, 2))
    stiff = _stiffness(robot, q) if "stiff" in want else zero
    inertia = np.array([np.diag(mass_matrix(chain, pi, x)) for x in q]) if "inertia" in want else zero
    kelvin = zero if temp is None else temp - REFERENCE_TEMPERATURE
    return tuple(
        Signals(
            q=q[:, j], dq=dq[:, j], ddq=ddq[:, j], load=load[:, j], tau=tau[:, j], dtau=dtau[:, j], link=link[:, j],
            temp=kelvin[:, j], warm=np.full(len(q), warm), t=np.zeros(len(q)) if t is None else t,
            tip=tuple(tip[:, j].T), tilt=tuple(tilt[:, j].T), stiff=stiff[:, j], inertia=inertia[:, j],
            coriolis=coriolis[:, j],
        )
        for j in range(n)
    )  # fmt: skip


def paired(signals: tuple[Signals, ...], i: int, j: int) -> tuple[Signals, Signals]:
    """The signals of joints ``i`` and ``j``, each knowing the other's speed and acceleration."""
    a, b = signals[i], signals[j]
    return replace(a, dq_other=b.dq, ddq_other=b.ddq), replace(b, dq_other=a.dq, ddq_other=a.ddq)


def _tilt(robot: Robot, q: Array) -> Array:
    """(N, n, 2): gravity torque by roll and pitch of the base, exact because it is linear in the gravity vector."""
    chain = robot.chain
    columns = [gravity_torques(chain._replace(gravity=d), robot.pi, q) for d in tilt_directions(chain.gravity)]
    return np.stack(columns, axis=-1)


def tilt_directions(gravity: Array) -> tuple[Array, Array]:
    """(3,) each: derivatives of the ``gravity`` that the base sees by its roll and pitch [m/s^2 per rad]."""
    gx, gy, gz = gravity
    # a base rolled by +a sees gravity rolled by -a: g' = g - a e_x x g
    return -np.array([0.0, -gz, gy]), -np.array([gz, 0.0, -gx])


def _stiffness(robot: Robot, q: Array) -> Array:
    """(N, n): derivative of each joint's gravity torque by its own position [N m/rad]."""
    out = np.empty_like(q)
    for j in range(robot.n):
        step = np.zeros(robot.n)
        step[j] = _STEP
        up, down = gravity_torques(robot.chain, robot.pi, q + step), gravity_torques(robot.chain, robot.pi, q - step)
        out[:, j] = (up - down)[:, j] / (2 * _STEP)
    return out
