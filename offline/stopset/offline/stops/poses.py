"""Test poses of stop tables: how far the arm is stretched, and where gravity hurts an axis most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stopset.robot import Robot
from stopset.robot.rigid import Chain, gravity_torques, link_frames, mass_matrices
from stopset.sets import Box
from stopset.types import Array

SAMPLES = 6000
SWEEPS = 40  # of coordinate ascent
SLACK = 0.02  # of the full reach: poses this close to the wanted extension count


def _radii(chain: Chain, q: Array, tip: Array) -> Array:
    """Distance of the tool centre point from the first axis [m], for rows of ``q``."""
    R, o = link_frames(chain, q)
    z = R[0, 0] @ chain.axis[0]  # which turns about itself alone
    d = o[:, -1] + R[:, -1] @ tip - o[:, 0]
    return np.asarray(np.sqrt(np.maximum((d**2).sum(axis=1) - (d @ z) ** 2, 0.0)))


@dataclass(frozen=True, slots=True)
class Poses:
    """Poses of an arm by extension: ``q`` (N, n) sorted arbitrarily, ``extension`` (N,) share of the full reach; ``seen`` (N,):
    whether the model's recordings hold them."""

    robot: Robot
    tip: Array
    reach: float  # [m] largest distance of the tool centre point from the first axis
    q: Array
    extension: Array
    seen: NDArray[np.bool_]

    @classmethod
    def of(cls, robot: Robot, tip: Array, domain: Box, seed: int = 1) -> Poses:
        """Random poses within the limits, as many within the ``domain`` of angles where that is narrower, and the fully stretched
        ones found from the best of them."""
        rng = np.random.default_rng(seed)
        lo, hi = np.maximum(robot.q_limit[:, 0], -np.pi), np.minimum(robot.q_limit[:, 1], np.pi)
        q = rng.uniform(lo, hi, (SAMPLES, robot.n))
        q[: SAMPLES // 2, robot.n // 2 + 1 :] = np.clip(0.0, lo, hi)[robot.n // 2 + 1 :]  # half with a straight wrist
        radius = _radii(robot.chain, q, tip)
        best = _stretched(robot, q[np.argsort(radius)[-12:]], lo, hi, tip)
        q = np.vstack([q, best])
        inner_lo, inner_hi = np.maximum(lo, domain.lo), np.minimum(hi, domain.hi)
        if np.any(inner_lo > lo) or np.any(inner_hi < hi):
            share = rng.uniform(0.0, 1.0, (SAMPLES, robot.n))
            inner = inner_lo + share * np.maximum(inner_hi - inner_lo, 0.0)
            top = inner[np.argsort(_radii(robot.chain, inner, tip))[-12:]]
            q = np.vstack([q, inner, _stretched(robot, top, inner_lo, np.maximum(inner_hi, inner_lo), tip)])
        radius = _radii(robot.chain, q, tip)
        seen = np.all((q >= domain.lo) & (q <= domain.hi), axis=1)
        return cls(robot, tip, float(radius.max()), q, radius / radius.max(), seen)

    def worst_for(self, joint: int, extension: float, pi: Array) -> Array:
        """The pose near an extension (share of the reach) where gravity loads ``joint`` most; ``pi``: with payload.

        Of those that recordings hold, where there are any near the extension.
        """
        near = self._near(extension)
        load = np.abs(gravity_torques(self.robot.chain, pi, self.q[near])[:, joint])
        # where gravity does not load the axis at all (a vertical one) the longest lever counts
        return np.array(self.q[near[int(np.argmax(load + 1e-3 * self.extension[near]))]])

    def worst_few(self, joint: int, extension: float, pi: Array, count: int) -> list[Array]:
        """`worst_for` and up to ``count - 1`` other poses near the extension: that in which the tool is farthest from the axis of ``joint``,
        that of most inertia about it, that which gravity loads most the other way, then each time the one farthest from all before."""
        first, chain = self.worst_for(joint, extension, pi), self.robot.chain
        q = self.q[self._near(extension)]
        R, o = link_frames(chain, q)
        axis, arm = R[:, joint] @ chain.axis[joint], o[:, -1] + R[:, -1] @ self.tip - o[:, joint]
        load = gravity_torques(chain, pi, q)[:, joint]
        sign = np.sign(gravity_torques(chain, pi, first[None])[0, joint])
        rankings = np.linalg.norm(np.cross(axis, arm), axis=1), mass_matrices(chain, pi, q)[:, joint, joint], -sign * load
        chosen = [first]
        for k in range(count - 1):
            distance = np.min([np.linalg.norm(q - x, axis=1) for x in chosen], axis=0)
            best = int(np.argmax(np.where(distance > 0.0, rankings[k], -np.inf) if k < len(rankings) else distance))
            if distance[best] == 0.0:  # there are no others
                break
            chosen.append(np.array(q[best]))
        return chosen

    def _near(self, extension: float) -> NDArray[np.intp]:
        """The numbers of the poses near an extension, of those that recordings hold where there are any."""
        near = np.abs(self.extension - extension) <= SLACK
        if np.any(near & self.seen):
            near &= self.seen
        if not np.any(near):
            near = np.abs(self.extension - extension) <= np.abs(self.extension - extension).min() + SLACK
        return np.flatnonzero(near)

    def extension_of(self, q: Array) -> float:
        """Share of the full reach of one pose."""
        return float(_radii(self.robot.chain, q[None, :], self.tip)[0] / self.reach)


def _stretched(robot: Robot, start: Array, lo: Array, hi: Array, tip: Array) -> Array:
    """Coordinate ascent of the reach from several poses."""
    out = start.copy()
    step = 0.5
    for _ in range(SWEEPS):
        for j in range(robot.n):
            trials = np.stack([out, out, out])
            trials[1, :, j], trials[2, :, j] = out[:, j] - step, out[:, j] + step
            trials = np.clip(trials, lo, hi)
            radius = _radii(robot.chain, np.ascontiguousarray(trials.reshape(-1, robot.n)), tip).reshape(3, -1)
            out = trials[np.argmax(radius, axis=0), np.arange(len(out))]
        step *= 0.8
    return out
