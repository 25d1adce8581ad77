"""Columns of every law over the prepared rows, for one joint or pair of joints or the whole arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stopset.effects import Effect, Signals
from stopset.offline.diagnose.columns.delay import lagged
from stopset.offline.diagnose.columns.elasticity import swing
from stopset.offline.diagnose.columns.memory import memory
from stopset.offline.diagnose.columns.signals import ArmSignals
from stopset.types import Array

TRANSMITTED = "transmitted"  # form of a law of the load: of all torque that the gear transmits, not of gravity's alone
MOVING = "moving"  # what that form has beyond gravity's
RIGID = frozenset({"ddq", "tau", "dtau", "link", "tip", "tilt", "stiff", "inertia", "coriolis"})


def of_the_load(effect: Effect) -> bool:
    """Whether a law is of friction that grows with the load, which has both forms."""
    return effect.role == "friction" and "load" in effect.needs


def columns(
    source: ArmSignals, effect: Effect, joints: tuple[int, ...], shapes: Mapping[str, float]
) -> dict[int, tuple[Array, Array]]:
    """Columns of an effect by the joint whose row they stand in: moving rows (N, k) and poses (P, k)."""
    d = source.data
    if effect.role == "swing":
        return swing(source, joints[0], shapes)
    if effect.role == "reading" and effect.needs == ("stiff",):  # a joint turned for good: gravity differs at all of them
        j = joints[0]
        return {i: (source.stiff(j, still=False)[:, i, None], source.stiff(j, still=True)[:, i, None]) for i in range(d.n)}
    if effect.enters == "input_delay" and shapes.get("d0"):
        return {joints[0]: (lagged(source, effect, joints[0], shapes["d0"]), np.zeros((len(d.q_still), 1)))}
    out = {}
    rows = range(d.n) if effect.scope == "arm" else joints
    for i in rows:
        other = [j for j in joints if j != i]
        if RIGID & set(effect.needs):
            moving = np.stack([np.broadcast_to(c, (len(d.q),)) for c in effect.columns(source.rigid(i), shapes)], axis=1)
        else:
            s = source.fine(i)
            if other:
                s = replace(s, dq_other=d.dq_fine[:, other[0]], ddq_other=_rate(source, other[0]))
            if effect.states:
                s = replace(s, memory=memory(effect, s, shapes, d.start_fine, d.kernel.dt))
            fine = _stacked(effect, s, shapes)
            if {TRANSMITTED, MOVING} & set(shapes):
                fine = beyond_gravity(effect, s, source.transmitted_fine[:, i]) + (fine if TRANSMITTED in shapes else 0.0)
            moving = d.thin(fine)
        gain = source.gain if effect.carried else 1.0
        still = _at_rest(source, effect, i, shapes)
        out[i] = (gain * moving, (0.0 if MOVING in shapes else gain) * still)
    return out


def _stacked(effect: Effect, s: Signals, shapes: Mapping[str, float]) -> Array:
    """(M, k) columns of a law at the recording's rate."""
    return np.stack([np.broadcast_to(c, s.q.shape) for c in effect.columns(s, shapes)], axis=1)


def beyond_gravity(effect: Effect, s: Signals, transmitted: Array) -> Array:
    """(M, k) what a law of the load adds where it is of all torque ``transmitted`` (M,) by the gear: friction, which turns over with the direction.

    What does not turn over with it is a share of the load itself: of gravity it is told by the poses, of all torque it would be another name
    of the drive's scale and of its inertia.
    """
    back = replace(s, given_direction=-np.asarray(s.given_direction))

    def friction(load: Array) -> Array:
        there, again = (_stacked(effect, replace(x, load=load), {}) for x in (s, back))
        return 0.5 * (there - again)

    return friction(transmitted) - friction(np.asarray(s.load))


def _rate(source: ArmSignals, joint: int) -> Array:
    """(M,) acceleration of a joint at the recording's rate [rad/s^2], trial by trial."""
    d, out = source.data, np.zeros(len(source.data.t_fine))
    for trial in d.trials:
        out[trial.fine] = np.gradient(d.dq_fine[trial.fine, joint], d.kernel.dt)
    return out


def _at_rest(source: ArmSignals, effect: Effect, joint: int, shapes: Mapping[str, float]) -> Array:
    """(P, k) columns of the poses: the mean over approaches from both sides, as far as friction had built up there."""
    P = len(source.data.q_still)
    rest = replace(source.still(joint), memory=tuple(np.zeros(P) for _ in effect.states))

    def law(sign: float) -> Array:
        made = effect.columns(
            replace(rest, given_direction=np.full(P, sign), memory=tuple(np.full(P, sign) for _ in effect.states)), shapes
        )
        return np.stack([np.broadcast_to(np.asarray(c, float), (P,)) for c in made], axis=1)

    none, both = law(0.0), 0.5 * (law(1.0) + law(-1.0))
    out: Array = none + source.built_up[joint] * (both - none)
    return out
