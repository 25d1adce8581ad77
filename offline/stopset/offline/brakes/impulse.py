"""What every joint's brake has given in a recorded power-off stop, read off the measured motion without differentiating it.

While joint i slides, its momentum ``p_i = (M v)_i`` obeys

    p_i' = 1/2 v' dM/dq_i v - g_i - D_i v_i - F_i s_i + w_i - b_i s_i,     s_i: its direction, w_i: what effects push it with,

so ``s_i (p_i(0) + int (all but b) - p_i(t))`` is the impulse of the brake since the trigger, plus what the drive still gave
while its power went, plus what the model's friction and gravity are wrong by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.reach.stops.expansion import expand
from stopset.reach.stops.setting import Setting
from stopset.recording import Recording
from stopset.robot.rigid import mass_matrix
from stopset.sets import Box
from stopset.types import Array

SLIDING = 0.04  # [rad/s] below this a joint counts as coming to rest
SHORTEST = 3  # samples


@dataclass(frozen=True, slots=True)
class Impulse:
    """``taken`` (K,) [N m s] from one joint in its direction of motion until ``t`` (K,) [s] after the trigger.

    ``noise``: its standard deviation per sample [N m s]; ``sign``: the direction; ``drive``: motor torque at the trigger [N m].
    """

    t: Array
    taken: Array
    noise: float
    sign: float
    drive: float


def impulses(setting: Setting, r: Recording, speed_noise: Array) -> list[Impulse | None]:
    """One curve per joint while it slides, None for joints that hardly moved; ``speed_noise`` (n,) [rad/s], one sigma."""
    k = r.stop_requested
    assert k is not None
    plant, n = setting.plant, setting.plant.rotor.shape[0]
    t, q, v = r.t[k:] - r.t[k], r.q[k:], r.dq[k:]
    sliding = np.logical_and.accumulate((np.abs(v) > SLIDING) & (np.sign(v) == np.sign(v[0])), axis=0)
    longest = int(sliding.sum(axis=0).max())
    if longest < SHORTEST:
        return [None] * n
    p, rate = np.empty((longest, n)), np.empty((longest, n))
    M = np.eye(n)
    for s in range(longest):
        E = expand(plant.chain, plant.pi, plant.pi_half, plant.rotor, q[s])
        M = E.M
        p[s] = M @ v[s]
        # resting joints' friction is unknown but their rows are not used
        f = setting.torques.over(Box.point(q[s]), np.abs(v[s]))
        friction = f.viscous.centre * v[s], f.dry.centre * np.sign(v[s])
        rate[s] = 0.5 * np.einsum("jki,j,k->i", E.dM, v[s], v[s]) - E.g - friction[0] - friction[1] + f.push.centre
    step = np.diff(t[:longest])[:, None]
    push = np.vstack([np.zeros(n), np.cumsum(0.5 * step * (rate[1:] + rate[:-1]), axis=0)])
    noise = np.sqrt((M**2) @ speed_noise**2)
    out: list[Impulse | None] = []
    for i in range(n):
        count = int(sliding[:, i].sum())
        if count < SHORTEST:
            out.append(None)
            continue
        sign = float(np.sign(v[0, i]))
        taken = sign * (p[0, i] + push[:count, i] - p[:count, i])
        out.append(Impulse(t[:count].copy(), taken, float(max(noise[i], 1e-6)), sign, float(r.tau[k, i])))
    return out


def speed_error(setting: Setting, r: Recording, momentum: Array) -> Array:
    """(n,) [rad/s] by how much the arm behaves as if it had started faster than measured, for that much more ``momentum``."""
    k = r.stop_requested
    assert k is not None
    plant = setting.plant
    M = mass_matrix(plant.chain, plant.pi, r.q[k]) + np.diag(plant.rotor)
    return np.asarray(np.linalg.solve(M, momentum), dtype=np.float64)
