"""A small arm whose truth is known: model 1 of the LWA-4P with sets that hold by construction, and motions inside them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stopset.artifact import Abstraction, Brakes, Domain, Guarantee, Model, UncertaintySets
from stopset.offline.description import load_robot
from stopset.reach.flowpipe import discretise
from stopset.recording import Meta, Recording
from stopset.sets import Box

DT = 0.004
INERTIA = np.array([1.89, 12.4, 1.93, 1.82, 0.55, 0.43])
VISCOUS = np.array([12.6, 30.8, 8.5, 8.1, 3.5, 4.0])
U = Box.of([-0.5, -1.0, -0.5, -0.3, -0.1, -0.1], [0.7, 1.0, 0.4, 0.3, 0.2, 0.1])
NOISE = 1e-4


def known_model(horizon: float = 0.4, windows: str = "sliding") -> Model:
    """Sets: disturbance torque in `U`, readings true to within ``NOISE``."""
    robot = load_robot("lwa4p")
    n = robot.n
    still = Box.symmetric(np.full(2 * n, NOISE))
    sets = UncertaintySets(X0=still, U=U, V=still, dt=DT, horizon=horizon, windows=windows)
    return Model(
        robot=robot,
        rotor=robot.rotor,
        effort="compensated_torque",
        effects=(),
        abstraction=Abstraction(1, 1, np.diag(1 / INERTIA), VISCOUS[:, None]),
        sets={"powered": sets},
        domain=Domain(
            q=Box.symmetric(np.full(n, 3.0)), dq=Box.symmetric(np.full(n, 2.0)), u=Box.symmetric([40, 90, 30, 30, 12, 12])
        ),
        guarantee=Guarantee(0, 0, 1.0, 0.95, "made for a test"),
        brakes=Brakes(
            torque=Box.of([155, 155, 74, 74, 17, 8], [289, 289, 138, 138, 33, 16]),
            delay=Box.of([0.015] * n, [0.06] * n),
            rise=Box.of([0.005] * n, [0.02] * n),
        ),
    )


def motion(seed: int = 0, samples: int = 300, trial: int = 0) -> Recording:
    """A trial of the known arm: smooth torques, disturbances jumping between the corners of `U`, noisy readings."""
    rng = np.random.default_rng(seed)
    Ad, Bd = discretise(known_model().abstraction, DT)
    n = len(INERTIA)
    t = DT * np.arange(samples)
    phase = rng.uniform(0, 2 * np.pi, n)
    u = VISCOUS * 0.5 * np.sin(2 * np.pi * rng.uniform(0.5, 1.5, n) * t[:, None] + phase)
    held = np.repeat(rng.integers(0, 2, (samples // 20 + 1, n)), 20, axis=0)[:samples]
    push = np.where(held == 1, U.hi, U.lo)
    x = np.zeros((samples, 2 * n))
    for k in range(samples - 1):
        x[k + 1] = Ad @ x[k] + Bd @ (u[k] + push[k])
    x += rng.uniform(-NOISE, NOISE, x.shape)
    return Recording("open_loop", 0, trial, trial, t, x[:, :n], x[:, n:], u)


def meta() -> Meta:
    return Meta(joints=load_robot("lwa4p").joints, robot="known arm", effort="compensated_torque", rate_hz=1 / DT)


def with_torque_scaled(r: Recording, joint: int, factor: float) -> Recording:
    tau = r.tau.copy()
    tau[:, joint] *= factor
    return replace(r, tau=tau)
