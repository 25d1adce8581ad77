"""Effects that are known with their numbers: how they change the robot's description and a recording, before a fit.

What is inertial becomes part of the robot, a wrong torque scale is undone, a late torque is shifted back, one that a drive followed
slowly is taken as it acted, and every other
torque is taken off.  What is left is a recording of the plain arm with plain friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stopset.artifact.inputs import effect_torques
from stopset.effects.base import Effect, Fitted, Signals
from stopset.effects.registry import get
from stopset.effects.signals import Samples
from stopset.offline.nominal.filters import first_order
from stopset.recording import Recording
from stopset.robot import Robot
from stopset.types import Array


def described(robot: Robot, known: Sequence[Fitted]) -> Robot:
    """The robot with known payloads and rotor inertias in its description."""
    pi, drives = robot.pi.copy(), list(robot.drives)
    for f in known:
        effect = get(f.effect)
        if effect.carried:
            pi[-1] += [f.values[t.symbol] for t in effect.terms]
        elif effect.enters == "inertia" and f.joint is not None:
            j, more = robot.joints.index(f.joint), effect.torque(Signals(ddq=1.0), f.values)
            drives[j] = replace(drives[j], rotor_inertia=float(robot.rotor[j]) + more)
    return replace(robot.with_parameters(pi), drives=tuple(drives))


def plain(r: Recording, robot: Robot, known: Sequence[Fitted], warm: float) -> Recording:
    """The recording as the arm without the ``known`` effects would have made it; ``robot`` as `described`."""
    if not known:
        return r
    tau = r.tau.copy()
    for f in known:
        effect = get(f.effect)
        if effect.enters == "input_delay" and f.joint is not None:
            j = robot.joints.index(f.joint)
            tau[:, j] = _acted(r, effect, f.values[effect.terms[0].symbol], tau[:, j])
        elif effect.enters == "input_gain" and f.joint is not None:
            tau[:, robot.joints.index(f.joint)] /= 1.0 + f.values[effect.terms[0].symbol]
    torques = [f for f in known if get(f.effect).compensated()]
    if torques:
        # what acts on accelerations (a motor that two joints share) needs them; their noise passes the torque's own filter later
        ddq = np.gradient(r.dq, r.t, axis=0) if any("ddq_other" in get(f.effect).needs for f in torques) else None
        tau -= effect_torques(robot, torques, Samples(r.q, r.dq, ddq, r.temp, warm, r.t))
    return replace(r, tau=tau)


def _acted(r: Recording, effect: Effect, lag: float, tau: Array) -> Array:
    """(N,) the torque that acted where the recorded one ``tau`` is apart from it by ``lag`` [s]."""
    if effect.acting == "through a lag":
        return np.asarray(first_order(tau[:, None], lag / float(np.median(np.diff(r.t))))[:, 0])
    return np.interp(r.t + lag, r.t, tau)
