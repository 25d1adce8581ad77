"""Torque that rigid body, friction and effects leave in full, beside what an abstraction of them leaves.

An abstraction may take the mass matrix as constant: its error then holds what the arm's pose changes.  This one holds only what
nobody has explained, and is the number to hold against other identifications.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stopset.artifact import Abstraction, Model
from stopset.artifact.inputs import InputMap, input_map
from stopset.effects.base import Fitted
from stopset.offline.abstraction.metrics import AVERAGING
from stopset.offline.abstraction.nominal_part import shared_inertia
from stopset.offline.nominal.preprocess import Preprocessing, derivative, motions
from stopset.recording import Recording
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques, torques
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class TorqueModel:
    """What a model says of motor torque, before there are sets to make a model of it."""

    robot: Robot
    rotor: Array
    effects: tuple[Fitted, ...]
    abstraction: Abstraction

    @property
    def input(self) -> InputMap:
        """As `Model.input`."""
        return input_map(self.robot, self.effects, "motor_torque", self.abstraction)


def left_over(
    model: Model | TorqueModel, r: Recording, u: Array, dt: float, ddq: Array | None = None, window: int | None = None
) -> Array:
    """(W, n) [N m] torque without explanation, averaged over windows of `AVERAGING`; ``u`` (N, n): the model's input.

    Accelerations are differences of the recorded speeds where ``ddq`` (N, n) is not given; averaged, their noise is that of a
    window's two ends.  ``window``: in samples, where another one is wanted.
    """
    ddq = np.gradient(r.dq, dt, axis=0) if ddq is None else ddq
    chain, pi, q = model.robot.chain, model.robot.pi, np.ascontiguousarray(r.q)
    dq = np.ascontiguousarray(r.dq)
    taken_off = torques(chain, pi, q, dq, np.zeros_like(q)) if model.abstraction.swift else gravity_torques(chain, pi, q)
    needed = torques(chain, pi, q, dq, ddq) - taken_off + model.rotor * ddq
    needed = needed + ddq @ shared_inertia(model.robot, model.effects)
    for power, v in enumerate(model.abstraction.viscous.T, start=1):
        needed = needed + v * r.dq**power
    left = u - needed
    m = window or max(1, round(AVERAGING / dt))
    count = len(left) // m
    return np.asarray(left[: count * m].reshape(count, m, left.shape[1]).mean(axis=1))


class Rows(NamedTuple):
    """Filtered rows of a motion: ``q, dq, ddq``, the torque ``left`` without explanation, nan where a joint stands, and the ``rate`` [N m/s]
    of the recorded torque; (rows, n) each.
    """

    q: Array
    dq: Array
    ddq: Array
    left: Array
    rate: Array


def rows_left(model: Model | TorqueModel, r: Recording, *, filtered: bool = False) -> Iterator[Rows]:
    """`left_over` of a recording, low-passed as identification fits it, motion by motion; ``filtered``: what laws say, too.

    A ripple of 10 Hz is not in the torque behind that filter, and a Stribeck peak at a reversal is beside it, too.
    """
    for m in motions(r, Preprocessing()):
        k = m.retained
        q, dq, ddq, tau = (np.ascontiguousarray(x[k]) for x in (m.q, m.dq, m.ddq, m.tau))
        u = model.input(q, dq, tau, None if m.temp is None else m.temp[k], 0.0, m.t[k])
        if filtered:
            said, whole = (model.input(m.q, m.dq, x, m.temp, 0.0, m.t) for x in (np.zeros_like(m.tau), m.tau))
            u = (whole - said + m.smooth(said))[k]
        part = Recording("closed_loop", 0, 0, 0, m.t[k], q, dq, tau)
        left = left_over(model, part, u, float("nan"), ddq, window=1)
        yield Rows(q, dq, ddq, np.where(m.moving[k], left, np.nan), derivative(m.tau, m.period)[k])


def rms_left(model: Model | TorqueModel, recordings: Sequence[Recording], *, filtered: bool = False) -> Array:
    """(n,) [N m] root mean square of `rows_left`; nan for a joint that never moves."""
    total, count = np.zeros(model.robot.n), np.zeros(model.robot.n)
    for r in recordings:
        for rows in rows_left(model, r, filtered=filtered) if r.phase != "static" else ():
            total += np.nansum(rows.left**2, axis=0)
            count += np.isfinite(rows.left).sum(axis=0)
    return np.asarray(np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan)))
