"""Filtered rows of motions whose torque is held against the described rigid body, with what goes with each joint taken out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stopset.offline.nominal.preprocess import Preprocessing, motions
from stopset.recording.types import Recording
from stopset.types import Array, Mask

FEWEST = 100  # rows of a joint


class TorqueRows(NamedTuple):
    """(N, n) each [rad, rad/s, rad/s^2, N m], and where a joint moves."""

    q: Array
    dq: Array
    ddq: Array
    tau: Array
    moving: Mask

    @classmethod
    def of(cls, trials: Sequence[Recording]) -> TorqueRows | None:
        """The rows that preprocessing retains of ``trials``; None where it retains none."""
        parts = [(m, m.retained) for r in trials for m in motions(r, Preprocessing())]
        if not parts:
            return None
        q, dq, ddq, tau = (np.concatenate([getattr(m, x)[at] for m, at in parts]) for x in ("q", "dq", "ddq", "tau"))
        return cls(q, dq, ddq, tau, np.concatenate([m.moving[at] for m, at in parts]))

    def thinned(self, most: int) -> TorqueRows:
        """Rows evenly apart, of which about ``most`` are left."""
        k = max(1, len(self.q) // most)
        return TorqueRows(self.q[::k], self.dq[::k], self.ddq[::k], self.tau[::k], self.moving[::k])

    def beside_friction(self, joint: int, columns: Array) -> Array:
        """``columns`` (N, k) where ``joint`` moves, its friction, offset and rotor projected out."""
        dq, moving = self.dq[:, joint], self.moving[:, joint]  # where it turns round friction is anything
        own = np.column_stack([np.sign(dq), dq, self.ddq[:, joint], np.ones(len(dq))])[moving]
        there = columns[moving]
        return np.asarray(there - own @ np.linalg.lstsq(own, there, rcond=None)[0])
