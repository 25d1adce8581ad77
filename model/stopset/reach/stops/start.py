"""The box of states at which a stop begins, and what of unseen states and payloads is asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.sets import Box
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Start:
    """True states ``q +- q_radius`` [rad], ``dq +- dq_radius`` [rad/s], (n,) each."""

    q: Array
    dq: Array
    q_radius: Array
    dq_radius: Array

    @property
    def angles(self) -> Box:
        """(n,) [rad]."""
        return Box(self.q - self.q_radius, self.q + self.q_radius)

    @property
    def speeds(self) -> Box:
        """(n,) [rad/s]."""
        return Box(self.dq - self.dq_radius, self.dq + self.dq_radius)

    @property
    def fastest(self) -> Array:
        """(n,) [rad/s] the largest speed of each joint."""
        return np.asarray(np.abs(self.dq) + self.dq_radius)


@dataclass(frozen=True, slots=True)
class Extrapolation:
    """Whether a ``payload`` that no recording carried and a ``state`` that none held get numbers, marked and not certified."""

    payload: bool = False
    state: bool = False


NONE = Extrapolation()
