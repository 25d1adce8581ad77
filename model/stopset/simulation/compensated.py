"""Recordings as a robot hands them out that takes gravity and dry friction off its torques before it shows them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stopset.recording import Recording
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques
from stopset.simulation.hidden import Truth

PHASES = frozenset({"closed_loop", "open_loop"})  # what such a robot records: powered motion
STILL = 0.01  # [rad/s] below it dry friction holds what it can


def compensated(r: Recording, robot: Robot, truth: Truth) -> Recording:
    """``u`` of eq. (11) in place of the torque: less the described gravity (but ``left_gravity`` of it) and Coulomb friction.

    Source: Liu & Althoff (2018), eq. (11).
    """
    gravity = gravity_torques(robot.chain, robot.pi, np.ascontiguousarray(r.q))
    held = np.clip(r.tau - gravity, -truth.plant.fc, truth.plant.fc)  # at rest friction balances what is left, as far as it can
    friction = np.where(np.abs(r.dq) < STILL, held, truth.plant.fc * np.sign(r.dq))
    return replace(r, tau=r.tau - (1.0 - truth.left_gravity) * gravity - friction)
