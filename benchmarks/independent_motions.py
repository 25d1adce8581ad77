"""Reference motions of the independent arm's sessions."""

from __future__ import annotations

import numpy as np
from independent_arm import Array
from independent_plant import DT

Generator = np.random.Generator


def _trapezoid(length: float, speed: float, acceleration: float) -> Array:
    """Way (K,) from 0 to ``length`` with rounded ramps."""
    ramp = speed / acceleration
    if speed * ramp > length:
        speed = float(np.sqrt(length * acceleration))
        ramp = speed / acceleration
    cruise = length / speed - ramp
    n = max(2, round(ramp / DT))
    rise = 0.5 * (1 - np.cos(np.pi * np.arange(n) / n))
    v = speed * np.concatenate([rise, np.ones(max(0, round(cruise / DT))), rise[::-1]])
    path = np.cumsum(v) * DT
    return np.asarray(path * (length / path[-1]))


def point_to_point(reach: Array, speed: float, duration: float, rng: Generator) -> Array:
    """(N, n) positions: all joints together to random targets, dwells between; a quarter of the joints stays."""
    N, n = round(duration / DT), len(reach)
    q = [rng.uniform(-reach, reach) * 0.9]
    while len(q) < N:
        target = np.where(rng.random(n) < 0.15, q[-1], rng.uniform(-reach, reach) * 0.95)
        step = target - q[-1]
        length = float(np.abs(step).max())
        if length < 0.2:
            continue
        s = _trapezoid(length, speed * rng.uniform(0.85, 1.0), 1.2 if speed < 0.5 else 3.5)
        q.extend(q[-1] + step * (s[:, None] / length))
        q.extend([q[-1]] * round(rng.uniform(0.3, 0.55) / DT))
    return np.array(q[:N])


def fourier(reach: Array, speed: float, duration: float, rng: Generator) -> Array:
    """(N, n) positions: six harmonics of the duration's inverse, from rest."""
    N, n = round(duration / DT), len(reach)
    t = np.arange(N) * DT
    w = 2 * np.pi / duration * np.arange(1, 7)
    a, ph = rng.normal(size=(2, 6, n))
    f = np.einsum("kn,tkn->tn", a / w[:, None], np.sin(w[None, :, None] * t[:, None, None] + 3 * ph))
    u = np.clip(t / 1.0, 0, 1)[:, None]
    f = (f - f[0]) * (u**3 * (10 - 15 * u + 6 * u * u))
    peak = np.abs(np.gradient(f, DT, axis=0)).max(axis=0)
    f *= speed * rng.uniform(0.82, 1.0, n) / peak
    middle = rng.uniform(-0.35, 0.35, n) * reach
    f *= np.minimum(1.0, (reach - np.abs(middle)) / np.maximum(np.abs(f).max(axis=0), 1e-9))
    return np.asarray(middle + f)
