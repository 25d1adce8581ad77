"""The torque set U as a zonotope: template generators from the data, whose lengths the linear program finds.

A box says what each joint may suffer; where joints are disturbed together it also holds what never happens, all of them
at their worst at once.  With ``U = c + sum a_i g_i [-1, 1]`` the inputs are a box again, in the coordinates of the centre
and the generators, so the program, the check, the margin and the guarantee are those of boxes (`linear`).  With the axes
among the generators a box is one of its points: a zonotope is never wider in the mean of the directions it is asked for,
and narrower exactly where joints are disturbed together and a direction across joints counts, as at the tool.

Source: Liu & Althoff (2018), Sec. IV-C, with template sets in place of intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stopset.artifact import Abstraction
from stopset.offline.abstraction.grid import Trial
from stopset.offline.abstraction.metrics import AVERAGING
from stopset.reach.flowpipe import along_joints
from stopset.robot import Robot
from stopset.robot.rigid import link_frames
from stopset.types import Array

POSES = 6  # at which the tool's directions are taken
SAME = 1.0 - 1e-6  # cosine of directions that are one
REACH = 1e-3  # [m] per rad; a direction the tool moves less in says nothing


@dataclass(frozen=True, slots=True)
class Template:
    """What a zonotope is made of: unit ``generators`` (n, m), and the ``directions`` (k, n) in which it is to be narrow."""

    generators: Array
    directions: Array

    @property
    def torques(self) -> Array:
        """Torques of the inputs (n, n + m): the centre's, then the generators'."""
        return np.hstack([np.eye(len(self.generators)), self.generators])

    @property
    def rows(self) -> Array:
        """Rows (2k, 2n) that read positions, then speeds, along the directions."""
        return along_joints(self.directions)


def template(trials: Sequence[Trial], abstraction: Abstraction, robot: Robot, dt: float) -> Template:
    """Generators from the torque deviations of some trials every ``dt`` [s], directions from the poses they were in."""
    spread = [x[len(x) // 2, : abstraction.n] for x, _ in trials]
    poses = [spread[k] for k in np.unique(np.linspace(0, len(spread) - 1, POSES).astype(int))]
    directions = np.vstack([np.eye(abstraction.n), *(tool_directions(robot, q) for q in poses)])
    return Template(generators(torque_deviations(trials, abstraction, dt), abstraction), _different(directions))


def tool_directions(robot: Robot, q: Array) -> Array:
    """Unit directions (up to 3, n) of the joints along which the tool moves in x, y, z at the pose ``q`` (n,)."""
    R, o = link_frames(robot.chain, q)
    tip = o[-1] + R[-1] @ robot.tip
    axes = np.einsum("irk,ik->ir", R, robot.chain.axis)
    J = np.cross(axes, tip - o).T
    length = np.linalg.norm(J, axis=1)
    return np.asarray(J[length > REACH] / length[length > REACH, None])


def torque_deviations(trials: Sequence[Trial], abstraction: Abstraction, dt: float) -> Array:
    """Torque [N m] the model lacks, averaged over `AVERAGING` windows, one row per window (W, n)."""
    n, m = abstraction.n, max(1, round(AVERAGING / dt))
    M = np.linalg.inv(abstraction.Minv)
    rows = []
    for x, u in trials:
        at = np.arange(0, len(x) - m, m)
        gained = (x[at + m, n:] - x[at, n:]) @ M.T
        friction = abstraction.viscous[:, 0] * (x[at + m, :n] - x[at, :n])
        torque = np.array([u[s : s + m].sum(axis=0) * dt for s in at]).reshape(-1, n)
        rows.append((gained + friction - torque) / (m * dt))
    return np.vstack(rows)


def generators(deviations: Array, abstraction: Abstraction) -> Array:
    """Unit generators (n, up to 3n): axes, principal directions of the torque deviations (W, n), and the inertia's columns.

    The last are what an acceleration of one joint alone costs: errors of the mass matrix look like that.  A direction that
    is there already is left out.
    """
    n = deviations.shape[1]
    scale = deviations.std(axis=0) + 1e-12
    principal = np.linalg.svd((deviations - deviations.mean(axis=0)) / scale, full_matrices=False)[2].T * scale[:, None]
    G = np.hstack([np.eye(n), principal, np.linalg.inv(abstraction.Minv)])
    return _different((G / np.linalg.norm(G, axis=0)).T).T


def _different(unit: Array) -> Array:
    """Unit rows without those that are there already, either way round."""
    return np.asarray(unit[[k for k in range(len(unit)) if np.all(np.abs(unit[:k] @ unit[k]) < SAME)]])
