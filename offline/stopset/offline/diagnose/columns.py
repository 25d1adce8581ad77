"""Columns of every law over the prepared rows, for one joint or pair of joints or the whole arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numba import njit

from stopset.effects import REFERENCE_TEMPERATURE, Effect, Signals
from stopset.offline.diagnose.prepare import CREEP, Array, Index, Mask, Prepared
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torques, mass_matrix, regressors, torques

RIGID = frozenset({"ddq", "tau", "dtau", "link", "tip", "tilt", "stiff", "inertia", "coriolis"})
SWING_ROUNDS = 4  # each round shrinks the error by about the bend in radians, 0.1 at worst
SUBSTEPS = 8  # integration steps of the swinging link per row: 2.5 ms, a tenth of the fastest period that rows can show


@njit(cache=True)
def _mass_matrices(chain, pi, q):  # type: ignore[no-untyped-def]
    out = np.empty((q.shape[0], q.shape[1], q.shape[1]))
    for k in range(q.shape[0]):
        out[k] = mass_matrix(chain, pi, q[k])
    return out


@dataclass(slots=True)
class Source:
    """Signals of the arm over the prepared rows, each computed once when first asked for."""

    robot: Robot
    data: Prepared
    compensated: bool = False  # the torque is u of eq. (11): the rigid body's torque was taken off already
    gain: float = 1.0  # recorded over true torque: what a new load adds to the record
    friction: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (n, 2) F_c, F_v of the fit so far
    built_up: Array = field(default_factory=lambda: np.zeros(0))  # (n,) share of the Coulomb friction seen in the poses
    _cache: dict[str, Array] = field(default_factory=dict)
    _signals: dict[int, Signals] = field(default_factory=dict)

    def set_friction(self, friction: Array) -> None:
        """Coulomb and viscous coefficients (n, 2), which the modelled torque then holds; what of it the poses show."""
        self.friction = friction
        if len(self.data.q_still):
            half = np.median(self.data.spread_still, axis=0)
            self.built_up = np.clip(half / np.maximum(friction[:, 0], 1e-9), 0.0, 1.0)
        self._signals.clear()

    def __post_init__(self) -> None:
        self.built_up = np.zeros(self.data.n)

    def _get(self, key: str, make) -> Array:  # type: ignore[no-untyped-def]
        if key not in self._cache:
            self._cache[key] = make()
        return self._cache[key]

    @property
    def regressor(self) -> Array:
        """(N, n, 10 n) rigid-body regressor of the rows."""
        d = self.data
        return self._get("Y", lambda: regressors(self.robot.chain, d.q, d.dq, d.ddq))

    @property
    def regressor_still(self) -> Array:
        """(P, n, 10 n) of the poses."""
        q = self.data.q_still
        return self._get("Ys", lambda: regressors(self.robot.chain, q, np.zeros_like(q), np.zeros_like(q)))

    @property
    def link(self) -> Array:
        """(N, n) links' torque [N m] within what was recorded."""
        pi = self.robot.pi.ravel() * (not self.compensated)
        return self._get("link", lambda: self.regressor @ pi)

    @property
    def mass(self) -> Array:
        """(N, n, n) links' mass matrix [kg m^2]."""
        return self._get("M", lambda: _mass_matrices(self.robot.chain, self.robot.pi, self.data.q))

    @property
    def load_fine(self) -> Array:
        """(M, n) gravity torque at the recording's rate [N m]."""
        return self._get("load", lambda: gravity_torques(self.robot.chain, self.robot.pi, self.data.q_fine))

    @property
    def load_still(self) -> Array:
        """(P, n) gravity torque of the poses [N m]."""
        return self._get("load_still", lambda: self.regressor_still @ self.robot.pi.ravel())

    @property
    def gravity(self) -> Array:
        """(N, n) gravity torque of the rows [N m]."""
        return self._get("g", lambda: gravity_torques(self.robot.chain, self.robot.pi, self.data.q))

    @property
    def swift(self) -> Array:
        """(N, n) gravity and speed-dependent torque of the rows [N m]."""
        d = self.data
        return self._get("c", lambda: torques(self.robot.chain, self.robot.pi, d.q, d.dq, np.zeros_like(d.q)))

    @property
    def first(self) -> Mask:
        """(N,) the first row of each trial."""
        out = np.zeros(len(self.data.q), np.bool_)
        out[[t.rows.start for t in self.data.trials if t.rows.stop > t.rows.start]] = True
        return out

    def start(self, joint: int) -> tuple[Array, float]:
        """(N,) torque that bends the gear when a trial starts [N m], nan where it starts in motion; time before its first row.

        From rest the gear carries gravity alone; what drives the joint then acts for half a kernel before the first row.
        """
        d = self.data
        out = np.full(len(d.q), np.nan)
        for trial in d.trials:
            if trial.rows.stop > trial.rows.start and np.abs(d.dq_fine[trial.fine.start]).max() < 2 * CREEP:
                out[trial.rows.start] = self.gravity[trial.rows.start, joint]
        return out, d.kernel.half * d.kernel.dt

    def tilt(self, still: bool) -> Array:
        """(N or P, n, 2) derivative of the torques by roll and pitch of the base; exact, as gravity enters linearly."""
        q = self.data.q_still if still else self.data.q
        gx, gy, gz = self.robot.chain.gravity

        def make() -> Array:
            turned = (-np.array([0.0, -gz, gy]), -np.array([gz, 0.0, -gx]))
            parts = [gravity_torques(self.robot.chain._replace(gravity=g), self.robot.pi, q) for g in turned]
            return np.stack(parts, axis=-1)

        return self._get(f"tilt{still}", make)

    def stiff(self, joint: int, still: bool) -> Array:
        """(N or P, n): derivative of every joint's gravity torque by the position of ``joint`` [N m/rad]."""
        q = self.data.q_still if still else self.data.q
        step = 1e-4 * np.eye(self.data.n)[joint]

        def make() -> Array:
            up, down = (gravity_torques(self.robot.chain, self.robot.pi, q + s * step) for s in (1, -1))
            return (up - down) / 2e-4

        return self._get(f"stiff{joint}{still}", make)

    def fine(self, joint: int) -> Signals:
        """Signals at the recording's rate, for laws of position, speed, direction, temperature and load."""
        d = self.data
        kelvin = 0.0 if d.temp_fine is None else d.temp_fine[:, joint] - REFERENCE_TEMPERATURE
        return Signals(
            q=d.q_fine[:, joint], dq=d.dq_fine[:, joint], way=d.way_fine[:, joint], temp=kelvin,
            warm=d.warm_fine, load=self.load_fine[:, joint],
        )  # fmt: skip

    def rigid(self, joint: int) -> Signals:
        """Signals of the rows, for laws of the rigid body's torques."""
        if joint not in self._signals:
            self._signals[joint] = self._rigid(joint)
        return self._signals[joint]

    def _rigid(self, joint: int) -> Signals:
        d, Y = self.data, self.regressor
        rotor = self.robot.rotor[joint] * d.ddq[:, joint]
        friction = self.friction[joint] if len(self.friction) else np.zeros(2)
        tau = self.link[:, joint] + rotor + friction[0] * d.way[:, joint] + friction[1] * d.dq[:, joint]
        smooth = self.link[:, joint] + rotor + friction[1] * d.dq[:, joint]
        still, swift = self.gravity[:, joint], self.swift[:, joint]
        return Signals(
            q=d.q[:, joint], dq=d.dq[:, joint], ddq=d.ddq[:, joint], way=d.way[:, joint], load=still, tau=tau,
            dtau=self._rate(_calm(smooth, self.first)), link=self.link[:, joint], tip=tuple(Y[:, joint, -10:].T),
            tilt=tuple(self.tilt(False)[:, joint].T), stiff=self.stiff(joint, False)[:, joint],
            inertia=self.mass[:, joint, joint], coriolis=swift - still,
        )  # fmt: skip

    def still(self, joint: int) -> Signals:
        """Signals of the poses held still."""
        z, load = np.zeros(len(self.data.q_still)), self.load_still[:, joint]
        return Signals(
            q=self.data.q_still[:, joint], dq=z, ddq=z, way=z, load=load, tau=load, dtau=z, link=load, temp=z, warm=z,
            tip=tuple(self.regressor_still[:, joint, -10:].T), tilt=tuple(self.tilt(True)[:, joint].T),
            stiff=self.stiff(joint, True)[:, joint], inertia=z, coriolis=z, dq_other=z,
        )  # fmt: skip

    def _rate(self, x: Array) -> Array:
        """Time derivative of a row signal, within each trial."""
        out = np.zeros_like(x)
        for trial in self.data.trials:
            if trial.rows.stop - trial.rows.start > 2:
                out[trial.rows] = np.gradient(x[trial.rows], self.data.t[trial.rows])
        return out


def columns(
    source: Source, effect: Effect, joints: tuple[int, ...], shapes: Mapping[str, float]
) -> dict[int, tuple[Array, Array]]:
    """Columns of an effect by the joint whose row they stand in: moving rows (N, k) and poses (P, k)."""
    d = source.data
    if effect.name == "elasticity":
        return _swing(source, joints[0], shapes["K"], shapes["D"], "exact" in shapes)
    if effect.name == "encoder_offset":
        j = joints[0]
        return {i: (source.stiff(j, False)[:, i, None], source.stiff(j, True)[:, i, None]) for i in range(d.n)}
    if effect.enters == "input_delay" and shapes.get("d0"):
        return {joints[0]: (_lagged(source, joints[0], shapes["d0"], "exact" in shapes), np.zeros((len(d.q_still), 1)))}
    out = {}
    rows = range(d.n) if effect.scope == "arm" else joints
    for i in rows:
        other = [j for j in joints if j != i]
        if RIGID & set(effect.needs):
            moving = np.stack([np.broadcast_to(c, (len(d.q),)) for c in effect.columns(source.rigid(i), shapes)], axis=1)
        else:
            s = source.fine(i)
            if other:
                s = replace(s, dq_other=d.dq_fine[:, other[0]])
            if effect.states:
                s = replace(s, memory=memory(effect, s, shapes, d.start_fine, d.kernel.dt))
            moving = d.thin(np.stack([np.broadcast_to(c, (len(d.q_fine),)) for c in effect.columns(s, shapes)], axis=1))
        gain = source.gain if effect.name == "payload" else 1.0
        out[i] = (gain * moving, gain * _at_rest(source, effect, i, shapes))
    return out


def _at_rest(source: Source, effect: Effect, joint: int, shapes: Mapping[str, float]) -> Array:
    """(P, k) columns of the poses: the mean over approaches from both sides, as far as friction had built up there."""
    P = len(source.data.q_still)
    rest = replace(source.still(joint), memory=tuple(np.zeros(P) for _ in effect.states))

    def law(way: float) -> Array:
        made = effect.columns(replace(rest, way=np.full(P, way), memory=tuple(np.full(P, way) for _ in effect.states)), shapes)
        return np.stack([np.broadcast_to(np.asarray(c, float), (P,)) for c in made], axis=1)

    none, both = law(0.0), 0.5 * (law(1.0) + law(-1.0))
    out: Array = none + source.built_up[joint] * (both - none)
    return out


def memory(effect: Effect, s: Signals, shapes: Mapping[str, float], start: Mask, dt: float) -> tuple[Array, ...]:
    """The effect's states along the samples, zero at the start of each trial; Dahl's curve exactly in the way travelled.

    Other flows are integrated by Heun's method at the recording's rate, all trials beside each other.
    """
    if effect.name == "hysteresis":
        return (_dahl(np.asarray(s.dq) * dt / shapes["delta"], start),)
    first = np.flatnonzero(start)
    length = np.diff(np.append(first, len(start)))
    states = np.zeros((len(effect.states), len(start)))
    x = np.zeros((len(effect.states), len(first)))
    arrays = {k: np.asarray(v) for k in ("q", "dq", "way", "temp", "warm", "load") if np.ndim(v := getattr(s, k))}
    for k in range(int(length.max(initial=0)) - 1):
        live = np.flatnonzero(length > k + 1)
        at = first[live] + k

        def rate(x: Array, at: Index) -> Array:
            now: dict[str, Any] = {name: v[at] for name, v in arrays.items()}
            here = replace(s, memory=tuple(x), **now)
            return np.stack([np.broadcast_to(r, (len(at),)) for r in effect.rates(here, shapes)])

        r1 = rate(x[:, live], at)
        r2 = rate(x[:, live] + dt * r1, at + 1)
        x[:, live] += 0.5 * dt * (r1 + r2)
        states[:, at + 1] = x[:, live]
    return tuple(states)


@njit(cache=True)
def _dahl(step: Array, start: Mask) -> Array:
    z = np.zeros(step.shape[0])
    for k in range(1, step.shape[0]):
        if not start[k]:
            way = np.sign(step[k])
            z[k] = way + (z[k - 1] - way) * np.exp(-np.abs(step[k]))
    return z


def _lagged(source: Source, joint: int, lag: float, exact: bool) -> Array:
    """(N, 1) change of the modelled torque by a lag [s], per second of lag: the law's ``-dtau``, exact at that lag.

    Its odd part (late minus early) is orthogonal to the position's noise, which stands in torque and column alike; its even
    part is not, so that is taken from the calmed torque unless ``exact``.
    """
    d, s = source.data, source.rigid(joint)
    smooth = s.tau - source.friction[joint, 0] * s.way
    calm = smooth if exact else _calm(smooth, source.first)
    way = d.way_fine[:, joint]
    late_way, change = np.empty_like(way), np.empty_like(smooth)
    shift = round(lag / d.kernel.dt)
    for trial in d.trials:
        rows, fine = trial.rows, trial.fine
        late, early = (_shifted(smooth[rows], k * lag / (d.step * d.kernel.dt)) for k in (1, -1))
        calm_late, calm_early = (_shifted(calm[rows], k * lag / (d.step * d.kernel.dt)) for k in (1, -1))
        change[rows] = 0.5 * (late - early) + 0.5 * (calm_late + calm_early) - calm[rows]
        samples = np.arange(fine.stop - fine.start) - shift
        late_way[fine] = way[fine][np.clip(samples, 0, fine.stop - fine.start - 1)]
    jump = source.friction[joint, 0] * d.thin(late_way - way)
    out: Array = ((change + jump) / lag)[:, None]
    return out


def _shifted(x: Array, rows: float) -> Array:
    """``x`` late by so many rows (a fraction too), by cubic interpolation; held at the ends."""
    whole = int(np.floor(rows))
    u = rows - whole
    weights = (-u * (1 - u) * (2 - u) / 6, (1 + u) * (1 - u) * (2 - u) / 2, (1 + u) * u * (2 - u) / 2, -(1 + u) * u * (1 - u) / 6)
    at = np.arange(len(x)) - whole
    out = np.zeros_like(x)
    for k, w in zip((1, 0, -1, -2), weights, strict=True):
        out += w * x[np.clip(at + k, 0, len(x) - 1)]
    return out


def _swing(source: Source, joint: int, K: float, D: float, exact: bool) -> dict[int, tuple[Array, Array]]:
    """A link that swings behind its motor: row ``i`` sees ``M_ij x'' + dg_i/dq_j x``.

    The swing ``x`` follows ``M_jj x'' + D x' + (K + dg_j/dq_j) x = -link``; the poses see it at rest.
    The link torque is calmed unless ``exact``, see `_calm`.
    """
    d, M, g, first = source.data, source.mass, source.stiff(joint, False), source.first
    dt = d.step * d.kernel.dt
    if exact:
        moving = _true_swing(source, joint, K, D, dt)
    else:
        calm = _calm(source.link[:, joint], first)
        x, _, ddx = _link_filter(calm, M[:, joint, joint], g[:, joint], first, *source.start(joint), K, D, dt, SUBSTEPS)
        moving = M[:, :, joint] * ddx[:, None] + g * x[:, None]
    g_still = source.stiff(joint, True)
    x_still = -source.load_still[:, joint] / (K + g_still[:, joint])
    return {i: (moving[:, i, None], (g_still[:, i] * x_still)[:, None]) for i in range(d.n)}


def _true_swing(source: Source, joint: int, K: float, D: float, dt: float) -> Array:
    """(N, n) what a swinging link adds to every row, with gravity and inertia at the bent position: fixed-point iteration."""
    d, robot, first = source.data, source.robot, source.first
    unit = np.eye(d.n)[joint]
    x = dx = ddx = np.zeros(len(d.q))
    none = np.zeros_like(d.q[:, 0])
    bent = source.link
    for _ in range(SWING_ROUNDS):
        M = _mass_matrices(robot.chain, robot.pi, d.q + x[:, None] * unit)[:, joint, joint]
        x, dx, ddx = _link_filter(bent[:, joint] - M * ddx, M, none, first, *source.start(joint), K, D, dt, SUBSTEPS)
        position, speed, acceleration = (a + b[:, None] * unit for a, b in ((d.q, x), (d.dq, dx), (d.ddq, ddx)))
        bent = torques(robot.chain, robot.pi, position, speed, acceleration)
    out: Array = bent - source.link
    return out


@njit(cache=True)
def _calm(x: Array, first: Mask) -> Array:
    """A row signal smoothed over about +-3 rows within its trial.

    The link torque holds the position's noise in its second derivative, and the swing differentiates it twice more: without
    this, noise common to the column and the torque would pass for elasticity.
    """
    weights = np.array([0.2, 0.18, 0.13, 0.07, 0.02])
    out = np.empty_like(x)
    lo = 0
    for k in range(x.shape[0]):
        if first[k]:
            lo = k
        hi = k
        total, norm = weights[0] * x[k], weights[0]
        for s in range(1, 5):
            hi = k + s
            if k - s >= lo and hi < x.shape[0] and not first[k + 1 : hi + 1].any():
                total += weights[s] * (x[k - s] + x[hi])
                norm += 2 * weights[s]
            else:
                break
        out[k] = total / norm
    return out


@njit(cache=True)
def _link_filter(
    link: Array, M: Array, g: Array, first: Mask, rest: Array, lead: float, K: float, D: float, dt: float, sub: int
) -> tuple[Array, Array, Array]:
    """Position, speed, acceleration of the link against the motor, by Newmark's rule; ``rest, lead``: see `Source.start`."""
    N = link.shape[0]
    out, rate, acc = np.zeros(N), np.zeros(N), np.zeros(N)
    h = dt / sub
    x = dx = 0.0
    for k in range(N):
        steps, before = sub, k - 1
        if first[k]:
            steps, before = round(lead / h), k
            x, dx = -rest[k] / (K + g[k]), 0.0
            if np.isnan(rest[k]):
                x, steps = -link[k] / (K + g[k]), 0
        stiff = K + g[k]
        for s in range(steps):
            w = (s + 0.5) / steps
            f = -(link[before] + w * (link[k] - link[before]))
            m = M[before] + w * (M[k] - M[before])
            ddx = (f - D * dx - stiff * (x + 0.5 * h * dx)) / (m + 0.5 * h * D + 0.25 * h * h * stiff)
            x += h * dx + 0.5 * h * h * ddx
            dx += h * ddx
        out[k], rate[k] = x, dx
        acc[k] = (-link[k] - D * dx - stiff * x) / M[k]
    return out, rate, acc
