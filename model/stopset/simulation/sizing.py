"""How large to make a hidden effect: so that the torque residual of its joint grows by a wanted factor.

The residual is what a first model leaves in the closed-loop recordings: measured torque minus rigid body and rotor
(both known here), minus Coulomb and viscous friction fitted to the joint.  Its size without the effect is the floor: torque
noise, noise of the acceleration, friction that differs between trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.recording import Recording
from stopset.robot.rigid import torques
from stopset.simulation.campaign import Schedule, closed_loop_jobs
from stopset.simulation.cell import Cell, record, temperatures
from stopset.simulation.hidden import Hidden, Parameters, Truth, kinds
from stopset.types import Array

RATIOS = {"large": float(np.sqrt(50.0)), "easy": float(np.sqrt(10.0)), "hard": float(np.sqrt(2.0))}
SLOW = 0.015  # [rad/s] where a joint gets slower within the filter's window, its friction may be on either side
HALF_WINDOW = 6  # samples to each side for derivatives and smoothing
CLOSE = 0.03  # relative distance of the reached from the wanted factor
TRIES = 9


@dataclass(frozen=True, slots=True)
class Sized:
    """A hidden effect with its size, and what it does: residual over floor per joint, (n,)."""

    hidden: Hidden
    ratios: Array
    wanted: float
    note: str = ""

    @property
    def ratio(self) -> float:
        """The factor that counts: of its joint, or the largest where it belongs to the whole arm."""
        return float(self.ratios.max() if self.hidden.joint is None else self.ratios[self.hidden.joint])


def inject(cell: Cell, hidden: Sequence[Hidden]) -> tuple[Cell, list[Parameters]]:
    """The cell with effects hidden in it, and the parameters of each for the record."""
    truth: Truth = cell.truth
    said = []
    for h in hidden:
        joint = 0 if h.joint is None else h.joint
        rng = cell.random("effect", h.effect, h.joint)
        truth, parameters = kinds()[h.effect].inject(truth, cell.cad, joint, h.size, rng)
        said.append(parameters)
    return replace(cell, truth=truth), said


def closed_loop(cell: Cell, plan: Schedule) -> list[Recording]:
    """The closed-loop part of the campaign, evenly from cold to warm."""
    jobs = closed_loop_jobs(cell, plan)
    places = np.linspace(0.1, 1.0, len(jobs))
    return [
        record(cell, replace(job, progress=float(s)), temperatures(cell, float(s))) for job, s in zip(jobs, places, strict=True)
    ]


def residual_rms(cell: Cell, recordings: Sequence[Recording], top: float = np.inf) -> Array:
    """(n,) rms of the torque residual [N m] against the true rigid body and fitted Coulomb and viscous friction.

    Friction is fitted to all moving samples, the rms taken over those slower than ``top`` [rad/s].
    """
    n = cell.cad.n
    pi, rotor = cell.truth.plant.pi, cell.truth.plant.rotor
    rows: list[tuple[Array, ...]] = []
    for r in recordings:
        q, dq = _filtered(r.q, 0), _filtered(r.dq, 0)
        ddq = _filtered(r.dq, 1) / float(r.t[1] - r.t[0])
        tau = r.tau[HALF_WINDOW:-HALF_WINDOW]
        rows.append((tau - torques(cell.cad.chain, pi, q, dq, ddq) - rotor * ddq, dq, _slowest(r.dq)))
    y, dq, slowest = (np.vstack(part) for part in zip(*rows, strict=True))
    out = np.empty(n)
    for j in range(n):
        moving = slowest[:, j] > SLOW
        X = np.column_stack([np.sign(dq[moving, j]), dq[moving, j]])
        rest = y[moving, j] - X @ np.linalg.lstsq(X, y[moving, j], rcond=None)[0]
        out[j] = np.sqrt(np.mean(rest[np.abs(dq[moving, j]) < top] ** 2))
    return out


def _slowest(dq: Array) -> Array:
    """Smallest speed within the filter's window, its own noise averaged over a third of it; zero where it changes sign."""
    third = np.array([np.convolve(c, np.full(5, 0.2), "same") for c in dq.T]).T
    near = np.lib.stride_tricks.sliding_window_view(third, 2 * HALF_WINDOW + 1, axis=0)
    return np.asarray(np.maximum(near.min(axis=-1), -near.max(axis=-1)))


def _filtered(x: Array, derivative: int) -> Array:
    """Local quadratic fit over 2 x HALF_WINDOW + 1 samples: value, or slope per sample; ends are cut off."""
    k = np.arange(-HALF_WINDOW, HALF_WINDOW + 1, dtype=float)
    weights = np.linalg.pinv(np.column_stack([np.ones_like(k), k, k * k]))[derivative]
    return np.column_stack([np.correlate(c, weights, "valid") for c in x.T])


def size_effect(cell: Cell, plan: Schedule, healthy: Sequence[Recording], effect: str, joint: int | None, wanted: float) -> Sized:
    """The size of ``effect`` at which the residual is ``wanted`` times that of ``healthy`` recordings, by secant.

    Where physics ends earlier (`Kind.most`), the largest sensible size is taken and the note says what it reaches.
    """
    kind = kinds()[effect]
    if kind.fixed:
        return Sized(Hidden(effect, joint, kind.guess), np.ones(cell.cad.n), wanted, f"size fixed, {kind.fixed}")
    floor = residual_rms(cell, healthy, kind.top)

    def ratios(size: float) -> Array:
        changed, _ = inject(cell, [Hidden(effect, joint, size)])
        return residual_rms(cell, closed_loop(changed, plan), kind.top) / floor

    def excess(r: Array) -> float:  # what the effect itself adds: grows about linearly with its size
        ratio = float(r.max() if joint is None else r[joint])
        return float(np.sqrt(max(ratio * ratio - 1.0, 1e-6)))

    goal = float(np.sqrt(wanted * wanted - 1.0))
    size, best = kind.guess, Sized(Hidden(effect, joint, 0.0), np.ones(cell.cad.n), wanted)
    seen: list[tuple[float, float]] = []
    for _ in range(TRIES):
        r = ratios(size)
        e = excess(r)
        now = Sized(Hidden(effect, joint, size), r, wanted)
        if abs(now.ratio / wanted - 1) < abs(best.ratio / wanted - 1):
            best = now
        if abs(now.ratio / wanted - 1) < CLOSE:
            return now
        seen.append((np.log(size), np.log(e)))
        power = 1.0
        if len(seen) > 1 and abs(seen[-1][0] - seen[-2][0]) > 1e-9:
            power = float(np.clip((seen[-1][1] - seen[-2][1]) / (seen[-1][0] - seen[-2][0]), 0.3, 3.0))
        step = float(np.clip((np.log(goal) - np.log(e)) / power, -2.5, 2.5))
        if size == kind.most and step > 0:
            break
        size = min(float(np.exp(seen[-1][0] + step)), kind.most)
    return replace(best, note=f"reaches {best.ratio:.2f} of the wanted {wanted:.2f} within its sensible range")
