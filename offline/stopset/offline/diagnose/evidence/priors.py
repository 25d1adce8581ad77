"""What is known of the arm before the question is asked, and how well."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.nominal.prior import Tolerance
from stopset.robot import Robot
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Known:
    """What a model from other recordings adds to the description: then only what has *changed* is asked for.

    ``friction, error``: (n, 2) Coulomb and viscous coefficients and the model's own error of them; ``spread``: how far they drift
    from day to day, relative; ``gain``, ``gain_std``: recorded over true torque, common to the drives; ``scales``: how far the
    rigid body may be off, as `SCALES` of the thresholds; ``left_open`` (13 n, k): what the model's own recordings left open of it, see
    `stopset.offline.nominal.parameter_uncertainty.left_open`; ``own`` (n,) [N m]: torque that the model leaves of its own recordings, nan
    where it does not say, and ``now`` (n,): of those that are asked;
    ``own_excess`` (n,): residual variance over the sensors' noise of its own recordings, where the model says it.
    """

    friction: Array
    error: Array
    gain: float = 1.0
    gain_std: float = field(default_factory=lambda: limit.DRIVES)
    spread: float = field(default_factory=lambda: limit.DRIFT)
    scales: tuple[float, ...] = field(default_factory=lambda: limit.KNOWN_SCALES)
    left_open: Array = field(default_factory=lambda: np.zeros((0, 0)))
    own: Array = field(default_factory=lambda: np.zeros(0))
    now: Array = field(default_factory=lambda: np.zeros(0))
    own_excess: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def deviation(self) -> Array:
        """(n, 2) how far the friction may be off the model's today: no model is truer than its own error."""
        return np.hypot(self.spread * self.friction, self.error)

    @property
    def as_before(self) -> NDArray[np.bool_]:
        """(n,) joints of whose torque the model leaves no more here than of its own recordings: it holds there as it did."""
        if self.own.shape != self.now.shape or not len(self.own):
            return np.zeros(len(self.friction), bool)
        return np.asarray(self.now <= limit.AS_BEFORE * self.own)

    @property
    def hidden_before(self) -> Array:
        """(n,) variance over the sensors' noise that its own recordings may have held unnoticed; inf where the model does not say."""
        n = len(self.friction)
        return np.maximum(self.own_excess, limit.SENSORS) - 1.0 if len(self.own_excess) == n else np.full(n, np.inf)


@dataclass(frozen=True, slots=True)
class Beforehand:
    """What is known before recordings are asked: the description's ``tolerance``, a model's ``known``, ``lag_std`` [s], how far off the
    lag is that was taken out of all joints' torque, 0 where none was, and the laws ``effect:joint`` that identification had ``chosen`` in them."""

    tolerance: Tolerance | None = None
    known: Known | None = None
    lag_std: float = 0.0
    chosen: tuple[str, ...] = ()


def link_tolerance(robot: Robot, tol: Tolerance) -> Array:
    """(n, 10) standard deviations of the links' standard parameters from the description's tolerance."""
    pi = robot.pi
    m = pi[:, :1]
    first = np.sqrt((tol.mass * pi[:, 1:4]) ** 2 + (tol.centre * m) ** 2)
    size = np.maximum(np.abs(pi[:, [4, 6, 9]]).max(axis=1, keepdims=True), 1e-4)
    return np.concatenate([tol.mass * m, first, np.repeat(tol.inertia * size, 6, axis=1)], axis=1)
