"""The column of an elastic gear: a link that swings behind its motor."""

from __future__ import annotations

import numpy as np
from numba import njit

from stopset.offline.diagnose.motion import bent_torques
from stopset.offline.diagnose.prepare import Array, Mask
from stopset.offline.diagnose.smooth import calm
from stopset.offline.diagnose.source import Source

SWING_ROUNDS = 2  # the first swing is that of a straight link; each round shrinks its error by the bend in radians, 0.1 at worst
SUBSTEPS = 8  # integration steps of the swinging link per row: 2.5 ms, a tenth of the fastest period that rows can show


def swing(source: Source, joint: int, K: float, D: float, exact: bool) -> dict[int, tuple[Array, Array]]:
    """A link that swings behind its motor: row ``i`` sees ``M_ij x'' + dg_i/dq_j x``.

    The swing ``x`` follows ``M_jj x'' + D x' + (K + dg_j/dq_j) x = -link``; the poses see it at rest.
    The link torque is calmed unless ``exact``, see `calm`.
    """
    d, M, g, first = source.data, source.mass, source.stiff(joint, False), source.first
    dt = d.step * d.kernel.dt
    if exact:
        moving = _true_swing(source, joint, K, D, dt)
    else:
        quiet = calm(np.ascontiguousarray(source.link[:, joint]), first)
        inertia, stiff = np.ascontiguousarray(M[:, joint, joint]), np.ascontiguousarray(g[:, joint])
        x, _, ddx = _link_filter(quiet, inertia, stiff, first, *source.start(joint), K, D, dt, SUBSTEPS)
        moving = M[:, :, joint] * ddx[:, None] + g * x[:, None]
    g_still = source.stiff(joint, True)
    x_still = -source.load_still[:, joint] / (K + g_still[:, joint])
    return {i: (moving[:, i, None], (g_still[:, i] * x_still)[:, None]) for i in range(d.n)}


def _true_swing(source: Source, joint: int, K: float, D: float, dt: float) -> Array:
    """(N, n) what a swinging link adds to every row, with gravity and inertia at the bent position: fixed-point iteration.

    A joint's own inertia does not depend on its own position, so it is the same in every round; what gravity does to a small
    bend is solved for, so that a round only mends what is not linear in it.
    """
    d, chain, first = source.data, source.robot.chain, source.first
    M = np.ascontiguousarray(source.mass[:, joint, joint])
    stiff = np.ascontiguousarray(source.stiff(joint, False)[:, joint])
    rest, lead = source.start(joint)
    x = ddx = np.zeros(len(d.q))
    bent = source.link.copy()
    for k in range(SWING_ROUNDS):
        x, dx, ddx = _link_filter(bent[:, joint] - M * ddx - stiff * x, M, stiff, first, rest, lead, K, D, dt, SUBSTEPS)
        lowest = joint if k + 1 < SWING_ROUNDS else 0
        bent_torques(chain, source.robot.pi, d.q, d.dq, d.ddq, joint, x, dx, ddx, lowest, bent)
    out: Array = bent - source.link
    return out


@njit(cache=True, nogil=True)
def _link_filter(
    link: Array, M: Array, g: Array, first: Mask, rest: Array, lead: float, K: float, D: float, dt: float, sub: int
) -> tuple[Array, Array, Array]:
    """Position, speed, acceleration of the link against the motor, by Newmark's rule; ``rest, lead``: see `Source.start`."""
    N = link.shape[0]
    out, rate, acc = np.zeros(N), np.zeros(N), np.zeros(N)
    h = dt / sub
    x = dx = 0.0
    for k in range(N):
        steps, before = sub, k - 1
        if first[k]:
            steps, before = round(lead / h), k
            x, dx = -rest[k] / (K + g[k]), 0.0
            if np.isnan(rest[k]):
                x, steps = -link[k] / (K + g[k]), 0
        stiff = K + g[k]
        for s in range(steps):
            w = (s + 0.5) / steps
            f = -(link[before] + w * (link[k] - link[before]))
            m = M[before] + w * (M[k] - M[before])
            ddx = (f - D * dx - stiff * (x + 0.5 * h * dx)) / (m + 0.5 * h * D + 0.25 * h * h * stiff)
            x += h * dx + 0.5 * h * h * ddx
            dx += h * ddx
        out[k], rate[k] = x, dx
        acc[k] = (-link[k] - D * dx - stiff * x) / M[k]
    return out, rate, acc
