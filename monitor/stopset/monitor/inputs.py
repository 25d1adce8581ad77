"""The monitor's input ``u``: the same map as the identification's, and how far bus rounding can move it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.artifact.inputs import InputMap, compensated
from stopset.effects.registry import get
from stopset.errors import NotCovered

if TYPE_CHECKING:
    from stopset.monitor.watch import Quantum

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Inputs:
    """``u`` (n,) [N m] of a sample, and ``du`` (n,): how much rounding of the readings can have changed it."""

    map: InputMap
    quantum: Quantum
    warm: float
    plain: bool  # u = tau - offset: rounding of q and dq does not enter

    @classmethod
    def of(cls, model: Model, quantum: Quantum, warm: float) -> Inputs:
        """Raises `NotCovered` for effects with a memory, which a single sample cannot evaluate."""
        active = compensated(model.effects, model.abstraction)
        lasting = [f.label for f in active if get(f.effect).states]
        if lasting:
            raise NotCovered(
                f"the model holds {', '.join(lasting)}, whose memory the monitor cannot see from its first sample on; "
                "use a revision without it"
            )
        plain = model.effort == "compensated_torque" and not active
        return cls(model.input, quantum, warm, plain)

    def __call__(self, q: Array, dq: Array, tau: Array, temp: Array | None) -> tuple[Array, Array]:
        """See the class; all arguments (n,)."""
        if self.plain:
            u = self.map(q[None], dq[None], tau[None])[0]
            return u, self.quantum.tau
        # friction depends on the sign of dq: around zero half a count decides, so both ends are evaluated
        d, h = self.quantum.dq, self.quantum.q
        rows = [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] if (np.any(d) or np.any(h)) else [(0.0, 0.0)]
        qs = np.array([q + b * h for _, b in rows])
        dqs = np.array([dq + a * d for a, _ in rows])
        temps = None if temp is None else np.tile(temp, (len(rows), 1))
        us = self.map(qs, dqs, np.tile(tau, (len(rows), 1)), temps, self.warm)
        moved = np.abs(us[1:3] - us[0]).max(axis=0, initial=0.0) + np.abs(us[3:5] - us[0]).max(axis=0, initial=0.0)
        return us[0], self.quantum.tau + moved
