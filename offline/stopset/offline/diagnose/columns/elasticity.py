"""The column of an elastic gear: a link that swings behind its motor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stopset.core.library import ffi, flags, given, lib, view
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.columns.signals import ArmSignals
from stopset.offline.diagnose.rows.smooth import calm
from stopset.offline.diagnose.side_by_side import side_by_side
from stopset.robot.rigid import Bend, bent_torques
from stopset.types import Array, Mask

SWING_ROUNDS = 2  # the first swing is that of a straight link; each round shrinks its error by the bend in radians, 0.1 at worst
RATHER_NOT = 1e-6  # share of the rows' largest pattern below which one is not told from the others
SUBSTEPS = 8  # integration steps of the swinging link per row: 2.5 ms, a tenth of the fastest period that rows can show


def swing(source: ArmSignals, joint: int, shapes: Mapping[str, float]) -> dict[int, tuple[Array, Array]]:
    """A link that swings behind its motor: row ``i`` sees ``M_ij x'' + dg_i/dq_j x``.

    The swing ``x`` follows ``M_jj x'' + D x' + (K + dg_j/dq_j) x = -link``; the poses see it at rest.  ``shapes``: ``K, D``;
    the link torque is calmed unless ``exact``, see `calm`; ``begun``: a trial may begin in the middle of a swing, see `_begun`.
    """
    d, g, K, D = source.data, source.stiff(joint, still=False), shapes["K"], shapes["D"]
    if not np.all(source.mass[:, joint, joint] > 0):  # described without inertia: a link that cannot swing leaves no trace
        return {i: (np.zeros((len(d.q), 1)), np.zeros((len(d.q_still), 1))) for i in range(d.n)}
    if "exact" in shapes:
        moving = _true_swing(source, joint, K, D, begun="begun" in shapes)
    else:
        filtered = _Filter.of(source, joint, K, D)
        quiet = calm(np.ascontiguousarray(source.link[:, joint]), source.first)
        x, _, ddx = filtered(quiet, *filtered.at_rest(quiet))
        moving = source.mass[:, :, joint] * ddx[:, None] + g * x[:, None]
    g_still = source.stiff(joint, still=True)
    x_still = -source.load_still[:, joint] / (K + g_still[:, joint])
    return {i: (moving[:, i, None], (g_still[:, i] * x_still)[:, None]) for i in range(d.n)}


@dataclass(frozen=True, slots=True)
class _Filter:
    """The equation of the swing: inertia ``M`` (N,), gravity's stiffness ``g`` (N,), ``K``, ``D``, ``dt`` [s] between rows."""

    M: Array
    g: Array
    K: float
    D: float
    dt: float
    first: Mask
    rest: Array
    lead: float

    @staticmethod
    def of(source: ArmSignals, joint: int, K: float, D: float) -> _Filter:
        d = source.data
        M = np.ascontiguousarray(source.mass[:, joint, joint])
        g = np.ascontiguousarray(source.stiff(joint, still=False)[:, joint])
        return _Filter(M, g, K, D, d.step * d.kernel.dt, source.first, *source.start(joint))

    def __call__(self, link: Array, x0: Array, dx0: Array) -> tuple[Array, Array, Array]:
        """Position, speed, acceleration (N,) of the swing that ``link`` [N m] drives, from its state at each trial's first row."""
        found = np.empty((3, len(link)))
        lib.stopset_swung(
            self._struct(), len(link), view(given(link)), view(given(x0)), view(given(dx0)), view(found)
        )  # by Newmark's rule
        out, rate, acc = found
        return out, rate, acc

    def at_rest(self, link: Array) -> tuple[Array, Array]:
        """(N,) state at each trial's first row where the trial began at rest; bent by the present torque where it began in motion."""
        h, (x0, dx0) = self.dt / SUBSTEPS, np.empty((2, len(link)))
        lead = round(self.lead / h)
        lib.stopset_led(self._struct(), len(link), view(given(link)), view(given(self.rest)), lead, view(x0), view(dx0))
        return x0, dx0

    def _struct(self) -> Any:
        if not self.M.shape == self.g.shape == self.first.shape:
            raise ValueError(f"inertia {self.M.shape} and stiffness {self.g.shape} for {self.first.shape} rows")
        return ffi.new("StopsetSwing *", (view(self.M), view(self.g), flags(self.first), self.K, self.D, self.dt, SUBSTEPS))


def driven(
    source: ArmSignals, torque: Array, gravity: Array, M: Array, g: Array, spring: tuple[float, float]
) -> tuple[Array, Array]:
    """Position and acceleration (N,) of what swings on a ``spring`` (K, D) as ``torque`` (N,) drives it, of which ``gravity`` at rest."""
    d, (K, D) = source.data, spring
    rest, lead = source.begins(gravity)
    M, g = np.ascontiguousarray(M), np.ascontiguousarray(g)
    filtered = _Filter(M, g, K, D, d.step * d.kernel.dt, source.first, rest, lead)
    torque = np.ascontiguousarray(torque)
    x, _, ddx = filtered(torque, *filtered.at_rest(torque))
    return x, ddx


def _true_swing(source: ArmSignals, joint: int, K: float, D: float, *, begun: bool = False) -> Array:
    """(N, n) what a swinging link adds to every row, with gravity and inertia at the bent position: fixed-point iteration.

    A joint's own inertia does not depend on its own position, so it is the same in every round; what gravity does to a small
    bend is solved for, so that a round only mends what is not linear in it.
    """
    d = source.data
    filtered = _Filter.of(source, joint, K, D)
    x = ddx = np.zeros(len(d.q))
    bent = source.link.copy()
    more = source.regressor[:, joint] @ source.body * begun  # what a fit says beyond the description
    for k in range(SWING_ROUNDS):
        driving = bent[:, joint] + more - filtered.M * ddx - filtered.g * x
        state = filtered.at_rest(driving)
        if begun:
            state = _begun(source, joint, filtered, driving, state)
        x, dx, ddx = filtered(driving, *state)
        lowest = joint if k + 1 < SWING_ROUNDS else 0
        _bend(source, joint, x, dx, ddx, lowest, bent)
    out: Array = bent - source.link
    return out


def _bend(source: ArmSignals, joint: int, x: Array, dx: Array, ddx: Array, lowest: int, out: Array) -> None:
    """`bent_torques` of all rows, by halves."""
    d = source.data

    def part(r: slice) -> None:
        bend = Bend(joint, x[r], dx[r], ddx[r])
        bent_torques(source.robot.chain, source.robot.pi, (d.q[r], d.dq[r], d.ddq[r]), bend, lowest, out[r])

    side_by_side(part, (slice(len(x) // 2), slice(len(x) // 2, None)))


def _begun(source: ArmSignals, joint: int, filtered: _Filter, driving: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
    """(N,) state at each trial's first row that its own torque speaks for; swings as large as later ones are expected.

    What the link did before is in no channel, and a swing that is hardly damped lasts longer than a stop.  Two numbers for each
    trial fit a part of anything: this is for a gear whose elasticity is certain.
    """
    d, (x0, dx0) = source.data, (part.copy() for part in state)
    j, first, nothing = joint, np.flatnonzero(source.first), np.zeros(len(d.q))
    K, M = filtered.K, float(np.median(filtered.M))
    x, dx, _ = filtered(driving, x0, dx0)
    # beside rotor and friction the motor carries the gear, which is bent by -x
    own = np.stack([d.ddq[:, j], d.direction[:, j], d.dq[:, j]], axis=1) @ source.drive[j]
    left = d.tau[:, j] - own + K * x + filtered.D * dx
    usual = max(float(np.std((K * x + driving)[d.ok[:, j]])), 1e-9)  # torque of the swing beyond that of a rigid gear
    unit = np.where(source.first, usual / K, 0.0)
    free = [filtered(nothing, unit, nothing), filtered(nothing, nothing, unit * np.sqrt(K / M))]
    torques = [-K * x - filtered.D * dx for x, dx, _ in free]
    A = np.stack([*torques, d.direction[:, j], d.dq[:, j], np.ones(len(d.q))], axis=1)
    noise = float(np.median(d.torque_noise[:, j]) * np.linalg.norm(d.kernel.h))
    for at, trial in zip(first, (t for t in d.trials if t.rows.stop > t.rows.start), strict=True):
        rows = np.arange(trial.rows.start, trial.rows.stop)[d.ok[trial.rows, j]]
        if len(rows) > limit.BEGINNINGS:
            expected = noise * np.eye(2, A.shape[1])  # of each start swing: the usual size
            found = np.linalg.lstsq(np.vstack([A[rows], expected]), np.append(left[rows], np.zeros(2)), rcond=RATHER_NOT)[0]
            x0[at] += found[0] * unit[at]
            dx0[at] += found[1] * unit[at] * np.sqrt(K / M)
    return x0, dx0
