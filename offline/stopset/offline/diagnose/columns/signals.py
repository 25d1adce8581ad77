"""Signals of the arm over the prepared rows, each computed once when first asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stopset.effects import REFERENCE_TEMPERATURE, Signals
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.gravity import GravityMoments, gravity_moments
from stopset.offline.diagnose.rows.prepare import Prepared
from stopset.offline.diagnose.rows.smooth import calm
from stopset.robot import Robot
from stopset.robot.rigid import mass_matrices, regressors, torques
from stopset.types import Array, Mask


@dataclass(slots=True)
class ArmSignals:
    """Signals of the arm over the prepared rows, each computed once when first asked for."""

    robot: Robot
    data: Prepared
    compensated: bool = False  # the torque is u of eq. (11): the rigid body's torque was taken off already
    gain: float = 1.0  # recorded over true torque: what a new load adds to the record
    gain_std: float = 0.0  # how far that may be off; 0 where no model says it and the recordings' own scale is taken
    friction: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (n, 2) F_c, F_v of the fit so far
    built_up: Array = field(default_factory=lambda: np.zeros(0))  # (n,) share of the Coulomb friction seen in the poses
    body: Array = field(default_factory=lambda: np.zeros(0))  # (10 n,) how far the links are off the description by the last fit
    drive: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (n, 3) rotor, Coulomb and viscous friction by the last fit
    weight: Array = field(default_factory=lambda: np.zeros(0))  # (10 n,) how far the links weigh something else: the load of laws
    _cache: dict[str, Array] = field(default_factory=dict)
    _signals: dict[int, Signals] = field(default_factory=dict)
    _moments: dict[bool, GravityMoments] = field(default_factory=dict)

    def set_friction(self, friction: Array) -> None:
        """Coulomb and viscous coefficients (n, 2), which the modelled torque then holds; what of it the poses show."""
        self.friction = friction
        if len(self.data.q_still):
            half = np.median(self.data.spread_still, axis=0)
            self.built_up = np.clip(half / np.maximum(friction[:, 0], 1e-9), 0.0, 1.0)
        self._signals.clear()

    def set_fit(self, body: Array, drive: Array) -> None:
        """What a fit of the base model says of links (10 n,) and drives (n, 3)."""
        self.body, self.drive = body, drive

    def set_weight(self, weight: Array) -> None:
        """How far the links weigh something else than described (10 n,), by the last fit."""
        self.weight = weight
        for key in ("load", "transmitted"):
            self._cache.pop(key, None)

    def __post_init__(self) -> None:
        n = self.data.n
        self.built_up, self.body, self.weight = np.zeros(n), np.zeros(10 * n), np.zeros(10 * n)
        self.drive = np.column_stack([self.robot.rotor, np.zeros((n, 2))])

    def _get(self, key: str, make: Callable[[], Array]) -> Array:
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
        return self._get("M", lambda: mass_matrices(self.robot.chain, self.robot.pi, self.data.q))

    @property
    def load_fine(self) -> Array:
        """(M, n) gravity torque at the recording's rate [N m], of the links as they weigh."""
        chain, pi = self.robot.chain, self.robot.pi + self.weight.reshape(self.robot.pi.shape)
        return self._get("load", lambda: gravity_moments(chain, pi, self.data.q_fine).torque(chain.gravity))

    @property
    def transmitted_fine(self) -> Array:
        """(M, n) torque that the gears transmit to the links at the recording's rate [N m], of the links as they weigh.

        What moves them is of the rows, between which it hardly bends.
        """
        return self._get("transmitted", lambda: self.load_fine + self._moving_fine())

    def _moving_fine(self) -> Array:
        """(M, n) that torque without gravity's."""
        d, chain, pi = self.data, self.robot.chain, self.robot.pi + self.weight.reshape(self.robot.pi.shape)
        moving = self.regressor @ pi.ravel() - gravity_moments(chain, pi, d.q).torque(chain.gravity)
        out = np.zeros_like(d.q_fine)
        for trial in d.trials:
            if trial.rows.stop > trial.rows.start:
                at = np.arange(trial.fine.start, trial.fine.stop)
                out[trial.fine] = np.stack([np.interp(at, d.centre[trial.rows], x) for x in moving[trial.rows].T], axis=1)
        return out

    @property
    def load_still(self) -> Array:
        """(P, n) gravity torque of the poses [N m], as described."""
        return self._get("load_still", lambda: self.regressor_still @ self.robot.pi.ravel())

    def moments(self, *, still: bool) -> GravityMoments:
        """Moments of gravity in the poses (``still``) or the rows."""
        if still not in self._moments:
            self._moments[still] = gravity_moments(self.robot.chain, self.robot.pi, self.data.q_still if still else self.data.q)
        return self._moments[still]

    @property
    def gravity(self) -> Array:
        """(N, n) gravity torque of the rows [N m]."""
        return self._get("g", lambda: self.moments(still=False).torque(self.robot.chain.gravity))

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
        """`begins` of a joint's gear."""
        return self.begins(self.gravity[:, joint])

    def begins(self, gravity: Array) -> tuple[Array, float]:
        """(N,) torque that bends the gear when a trial starts [N m], nan where it starts in motion; time before its first row.

        From rest the gear carries ``gravity`` (N,) alone; what drives the joint then acts for half a kernel before the first row.
        """
        d = self.data
        out = np.full(len(d.q), np.nan)
        for trial in d.trials:
            if trial.rows.stop > trial.rows.start and np.abs(d.dq_fine[trial.fine.start]).max() < limit.AT_REST:
                out[trial.rows.start] = gravity[trial.rows.start]
        return out, d.kernel.half * d.kernel.dt

    def tilt(self, *, still: bool) -> Array:
        """(N or P, n, 2) derivative of the torques by roll and pitch of the base; exact, as gravity enters linearly."""
        gx, gy, gz = self.robot.chain.gravity
        turned = (-np.array([0.0, -gz, gy]), -np.array([gz, 0.0, -gx]))
        return self._get(f"tilt{still}", lambda: np.stack([self.moments(still=still).torque(g) for g in turned], axis=-1))

    def stiff(self, joint: int, *, still: bool) -> Array:
        """(N or P, n): derivative of every joint's gravity torque by the position of ``joint`` [N m/rad]."""
        return self._get(f"stiff{joint}{still}", lambda: self.moments(still=still).stiffness(self.robot.chain.gravity, joint))

    def fine(self, joint: int) -> Signals:
        """Signals at the recording's rate, for laws of position, speed, direction, temperature and load."""
        d = self.data
        kelvin = 0.0 if d.temp_fine is None else d.temp_fine[:, joint] - REFERENCE_TEMPERATURE
        return Signals(
            q=d.q_fine[:, joint], dq=d.dq_fine[:, joint], given_direction=d.direction_fine[:, joint], temp=kelvin,
            warm=d.warm_fine, load=self.load_fine[:, joint], t=d.t_fine,
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
        tau = self.link[:, joint] + rotor + friction[0] * d.direction[:, joint] + friction[1] * d.dq[:, joint]
        smooth = self.link[:, joint] + rotor + friction[1] * d.dq[:, joint]
        still, swift = self.gravity[:, joint], self.swift[:, joint]
        return Signals(
            q=d.q[:, joint], dq=d.dq[:, joint], ddq=d.ddq[:, joint], given_direction=d.direction[:, joint], load=still, tau=tau,
            dtau=self._rate(calm(smooth, self.first)), link=self.link[:, joint], tip=tuple(Y[:, joint, -10:].T),
            tilt=tuple(self.tilt(still=False)[:, joint].T), stiff=self.stiff(joint, still=False)[:, joint],
            inertia=self.mass[:, joint, joint], coriolis=swift - still, t=d.t, warm=d.warm,
            temp=0.0 if d.temp is None else d.temp[:, joint] - REFERENCE_TEMPERATURE,
        )  # fmt: skip

    def still(self, joint: int) -> Signals:
        """Signals of the poses held still."""
        z, load = np.zeros(len(self.data.q_still)), self.load_still[:, joint]
        weighed = load + self.regressor_still[:, joint] @ self.weight
        return Signals(
            q=self.data.q_still[:, joint], dq=z, ddq=z, given_direction=z, load=weighed, tau=load, dtau=z, link=load, temp=z, warm=z, t=z,
            tip=tuple(self.regressor_still[:, joint, -10:].T), tilt=tuple(self.tilt(still=True)[:, joint].T),
            stiff=self.stiff(joint, still=True)[:, joint], inertia=z, coriolis=z, dq_other=z, ddq_other=z,
        )  # fmt: skip

    def _rate(self, x: Array) -> Array:
        """Time derivative of a row signal, within each trial."""
        out = np.zeros_like(x)
        for trial in self.data.trials:
            if trial.rows.stop - trial.rows.start > 2:
                out[trial.rows] = np.gradient(x[trial.rows], self.data.t[trial.rows])
        return out
