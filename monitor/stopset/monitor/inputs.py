"""The monitor's input ``u``: the same map as the identification's, and how far what is not known exactly can move it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.artifact.inputs import InputMap
from stopset.effects.registry import get
from stopset.monitor.carried import Carried

if TYPE_CHECKING:
    from stopset.monitor.watch import Quantum

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Inputs:
    """``u`` (n,) [N m] of a sample, and ``du`` (n,): how much rounding, an unknown place in the session and unknown states of
    effects with memory can have changed it.  Samples are taken one after another; `forget` where they are no longer one motion."""

    map: InputMap
    quantum: Quantum
    warm: tuple[float, float]
    plain: bool  # u = tau - offset: q, dq and the place in the session do not enter
    carried: Carried

    @classmethod
    def of(cls, model: Model, quantum: Quantum, warm: tuple[float, float]) -> Inputs:
        """Raises `NotCovered` for effects with a memory that cannot be carried, see `Carried`.

        ``warm``: between which places of the session (0 first trial of the identification, 1 last) the arm is now.
        """
        taken_off = model.input
        plain = model.effort == "compensated_torque" and not taken_off.effects and bool(np.all(taken_off.gain == 1.0))
        uses_warm = any("warm" in get(f.effect).needs for f in taken_off.effects)
        return cls(taken_off, quantum, warm if uses_warm else (warm[0], warm[0]), plain, Carried.of(model))

    def forget(self) -> None:
        """The next sample does not follow the last one."""
        self.carried.forget()

    def __call__(self, q: Array, dq: Array, tau: Array, temp: Array | None) -> tuple[Array, Array]:
        """See the class; all arguments (n,). Friction turns round at standstill, so rounding is tried both ways."""
        if self.plain:
            return self.map(q[None], dq[None], tau[None])[0], self.quantum.tau
        h, d = self.quantum.q, self.quantum.dq
        around = [(0.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0)] if np.any(h) or np.any(d) else [(0.0, 0.0)]
        qs, dqs = np.array([q + a * h for a, _ in around]), np.array([dq + b * d for _, b in around])
        rows = len(around)
        temps = None if temp is None else np.tile(temp, (rows, 1))
        taus, states = np.tile(tau, (rows, 1)), self.carried.middle(rows)
        ends = sorted(set(self.warm))  # the laws are linear in the place, so its ends are the extremes
        us = [self.map(qs, dqs, taus, temps, w, memories=states) for w in ends]
        u = 0.5 * (us[0][0] + us[-1][0])
        du = self.quantum.tau / self.map.gain + 0.5 * np.abs(us[-1][0] - us[0][0])
        if rows > 1:
            du = du + np.max([np.abs(x[1:3] - x[0]).max(axis=0) + np.abs(x[3:5] - x[0]).max(axis=0) for x in us], axis=0)
        return u, du + self._remembered(qs, dqs, temps, ends)

    def _remembered(self, qs: Array, dqs: Array, temps: Array | None, ends: list[float]) -> Array:
        """What unknown states can change; they go on to the next sample. A joint that may have stood still counts as still too."""
        if not self.carried.states:
            return np.zeros(qs.shape[1])
        slowest = np.where(np.abs(dqs[0]) <= np.maximum(self.quantum.dq, self.map.standstill), 0.0, dqs[0])
        qs, dqs = np.vstack([qs, qs[:1]]), np.vstack([dqs, slowest])
        temps = None if temps is None else np.vstack([temps, temps[:1]])
        return self.carried.take(qs, dqs, temps, ends)
