"""Simulate the abstraction in open loop with its effects at the *simulated* state, many trials side by side.

For recordings of compensated torque, where every joint is a system of its own:
``J ddq + v dq + offset + sum of effects(q, dq, ...) = u``.  Nothing of the measurement enters after the first sample, so
this is the honest judge of a model: torque error can fall while the simulation diverges.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Abstraction
from stopset.artifact.inputs import compensated
from stopset.effects.base import REFERENCE_TEMPERATURE, Effect, Fitted, Signals
from stopset.effects.memory import affine, coefficients, stepped
from stopset.effects.registry import get
from stopset.errors import EffectError
from stopset.recording import Recording
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques
from stopset.types import Array

# [rad/s] width of the change of direction: a sign would chatter within a step, a tenth of a degree per second does not
DIRECTION_WIDTH = 0.01
SPEED_LIMIT = 20.0  # [rad/s] a diverging simulation goes on at this speed instead of overflowing


@dataclass(frozen=True, slots=True)
class JointBatch:
    """One joint of ``B`` trials on a grid of ``N`` steps, padded at the end; ``inside``: (N, B) true where there are data."""

    dt: float
    q: Array  # (N, B)
    dq: Array
    u: Array
    load: Array
    temp: Array
    warm: Array  # (B,)
    inside: NDArray[np.bool_]

    def trials(self, chosen: NDArray[np.int64]) -> JointBatch:
        """Some of the trials, in the order of ``chosen``."""
        q, dq, u, load, temp = (np.ascontiguousarray(x[:, chosen]) for x in (self.q, self.dq, self.u, self.load, self.temp))
        return JointBatch(self.dt, q, dq, u, load, temp, self.warm[chosen], self.inside[:, chosen])


@dataclass(frozen=True, slots=True)
class EffectTerm:
    """An effect in a simulation: its law, shapes, and the values of its terms where they are ``given``."""

    effect: Effect
    shapes: Mapping[str, float]
    given: tuple[float, ...] = ()

    @classmethod
    def known(cls, f: Fitted) -> EffectTerm:
        """An effect whose numbers stay as they are."""
        effect = get(f.effect)
        return cls(effect, {x.symbol: f.values[x.symbol] for x in effect.shapes}, tuple(f.values[t.symbol] for t in effect.terms))

    def columns(self, s: Signals) -> tuple[Array, ...]:
        return tuple(np.asarray(c) for c in self.effect.columns(s, self.shapes))

    def begun(self, shape: tuple[int, ...]) -> Array:
        """What an effect with memory remembers at the start; raises `EffectError` where its state cannot be stepped."""
        if not affine(self.effect):
            raise EffectError(
                f"effect {self.effect.name} remembers {', '.join(x.symbol for x in self.effect.states)}; the open-loop simulation of "
                "compensated torque carries one state per effect whose law and flow are affine in it: leave it out, or record motor torque"
            )
        return np.array([np.full(shape, z) for z in self.effect.at_start])

    def stepped(self, s: Signals, dt: float) -> Array:
        """What it remembers ``dt`` [s] after ``s``."""
        return stepped(s.memory[0], *coefficients(self.effect, s, self.shapes), dt)[None]


def joint_batches(robot: Robot, trials: Sequence[Recording], warm: Sequence[float], dt: float) -> list[JointBatch]:
    """Every joint of the trials (all on the grid ``dt`` [s]); ``warm``: place in the session of each."""
    N, B, n = max(len(r.t) for r in trials), len(trials), robot.n
    shape = (n, N, B)
    q, dq, u, load, temp = (np.zeros(shape) for _ in range(5))
    inside = np.zeros((N, B), bool)
    for b, r in enumerate(trials):
        N_b = len(r.t)
        inside[:N_b, b] = True
        gravity = gravity_torques(robot.chain, robot.pi, np.ascontiguousarray(r.q))
        kelvin = np.zeros_like(r.q) if r.temp is None else r.temp - REFERENCE_TEMPERATURE
        for to, signal in ((q, r.q), (dq, r.dq), (u, r.tau), (load, gravity), (temp, kelvin)):
            to[:, :N_b, b] = signal.T
            to[:, N_b:, b] = signal[-1][:, None]
    places = np.array(warm, float)
    return [JointBatch(dt, q[j], dq[j], u[j], load[j], temp[j], places, inside) for j in range(n)]


def roll_out(
    batch: JointBatch, inertia: Array, damping: Array, torque: Array, terms: Sequence[EffectTerm]
) -> tuple[Array, Array]:
    """Simulated ``q, dq`` (S, N, B) for ``S`` parameter sets at once.

    ``inertia, damping`` (S,); ``torque`` (S, 1 + columns): the offset [N m] and the value of every column of ``terms``.
    Exact for the linear part with the input held over each step.
    """
    N, B = batch.q.shape
    S = len(inertia)
    # whole arrays throughout, written in place: for so few numbers numpy's own work is most of a step
    J, v = (np.tile(x[:, None], B) for x in (inertia, np.maximum(damping, 1e-6)))
    decay = np.exp(-v * batch.dt / J)
    gain = -np.expm1(-v * batch.dt / J) / v
    offset, *theta = (np.tile(x[:, None], B) for x in torque.T)
    furthest = SPEED_LIMIT * batch.dt
    Q, DQ = np.empty((N, S, B)), np.empty((N, S, B))
    q, dq, direction = np.tile(batch.q[0], (S, 1)), np.tile(batch.dq[0], (S, 1)), np.empty((S, B))
    load, temp, t = np.empty(B), np.empty(B), np.empty(())
    s = Signals(q=q, dq=dq, given_direction=direction, load=load, temp=temp, warm=batch.warm, t=t)
    memories = {j: term.begun((S, B)) for j, term in enumerate(terms) if term.effect.states}
    for k in range(N):
        Q[k], DQ[k] = q, dq
        u = batch.u[k] - offset
        if terms:
            np.tanh(np.divide(dq, DIRECTION_WIDTH, out=direction), out=direction)
            load[:], temp[:], t[()] = batch.load[k], batch.temp[k], k * batch.dt
            seen = {j: replace(s, memory=tuple(m)) for j, m in memories.items()}
            columns = [c for j, term in enumerate(terms) for c in term.columns(seen.get(j, s))]
            for value, column in zip(theta, columns, strict=True):
                u -= value * column
            memories = {j: terms[j].stepped(now, batch.dt) for j, now in seen.items()}
        # clipped by hand: what `np.clip` looks at first takes longer than this
        faster = np.minimum(np.maximum(decay * dq + gain * u, -SPEED_LIMIT), SPEED_LIMIT)
        q += np.minimum(np.maximum((batch.dt * u - J * (faster - dq)) / v, -furthest), furthest)
        dq[:] = faster
    return Q.transpose(1, 0, 2), DQ.transpose(1, 0, 2)


@dataclass(frozen=True, slots=True)
class RollOut:
    """Open-loop simulation of whole trials by a decoupled abstraction with its effects."""

    robot: Robot
    abstraction: Abstraction
    effects: tuple[Fitted, ...]
    warm: Callable[[Recording], float]

    def __call__(self, trials: Sequence[Recording], dt: float) -> list[Array]:
        """States (N, 2n) over (q, dq) of each trial, from its measured start."""
        batches = joint_batches(self.robot, trials, [self.warm(r) for r in trials], dt)
        inertia = 1.0 / np.diag(self.abstraction.Minv)
        states = []
        for j, (name, batch) in enumerate(zip(self.robot.joints, batches, strict=True)):
            mine = [f for f in compensated(self.effects, self.abstraction) if f.joint in (name, None)]
            terms = [EffectTerm(get(f.effect), {p.symbol: f.values[p.symbol] for p in get(f.effect).shapes}) for f in mine]
            values = [f.values[t.symbol] for f in mine for t in get(f.effect).terms]
            torque = np.array([[self.abstraction.offset[j], *values]])
            q, dq = roll_out(batch, inertia[j : j + 1], self.abstraction.viscous[j, :1], torque, terms)
            states.append((q[0], dq[0]))
        return [np.column_stack([x[: len(r.t), b] for k in (0, 1) for x in (s[k] for s in states)]) for b, r in enumerate(trials)]
