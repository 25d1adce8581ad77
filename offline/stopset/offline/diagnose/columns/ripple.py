"""The search for torque ripple: which cycles per turn a joint's residual holds, from a fine grid of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit

from stopset.effects import Effect
from stopset.offline.diagnose.evidence.engine import Engine, Hyper
from stopset.offline.diagnose.rows.noise import whiten_adjoint
from stopset.offline.diagnose.rows.prepare import Array, Mask
from stopset.offline.diagnose.rows.rows import JointRows
from stopset.offline.diagnose.search.wanted import Wanted

STEP = 0.5  # [cycles per turn]
RIPPLES = np.arange(12.0, 161.0, STEP)  # [cycles per turn]


class Power(NamedTuple):
    """Sums over one joint's rows of the whitened sines and cosines of every ripple: ``ss, cc, sc`` (R,)."""

    ss: Array
    cc: Array
    sc: Array


@dataclass(slots=True)
class Ripples:
    """Ripples in the residuals of an engine's joints; what depends on the rows alone is computed once."""

    engine: Engine
    effect: Effect
    _power: dict[int, tuple[JointRows, Power]] = field(default_factory=dict)

    def strongest(self, theta: Array, hyper: Hyper) -> list[Wanted]:
        """The strongest two cycles per turn in each joint's residual, beyond what chance gives."""
        out: list[Wanted] = []
        view, d = self.engine.view(), self.engine.data
        full = np.concatenate([[1.0], -theta])
        spread = d.kernel.dt * np.sqrt(np.sum(d.kernel.h * np.arange(-d.kernel.half, d.kernel.half + 1) ** 2))
        for j, rows in enumerate(self.engine.rows):
            k = len(rows.take)
            if k < 100:
                continue
            gram = view.grams[j]
            r = gram.residual(full[gram.index], hyper.sigma[j], hyper.kappa[j])[:k]
            q, fade = d.q[rows.take, j], 0.5 * (d.dq[rows.take, j] * spread) ** 2
            if j not in self._power or self._power[j][0] is not rows:
                self._power[j] = rows, Power(*_power(q, fade, rows.start, rows.a, rows.sd, RIPPLES, STEP))
            ss, cc, sc = self._power[j][1]
            a, b = _products(q, fade, whiten_adjoint(r, rows.start, rows.a, rows.sd), RIPPLES, STEP)
            power = (cc * a * a - 2 * sc * a * b + ss * b * b) / np.maximum(ss * cc - sc * sc, 1e-9 * ss * cc + 1e-12)
            power = power / hyper.kappa[j]
            for _ in range(2):
                top = int(np.argmax(power))
                if power[top] < 2 * np.log(len(RIPPLES)):
                    break
                out.append((self.effect, (j,), {"n": float(RIPPLES[top])}))
                power[np.abs(RIPPLES - RIPPLES[top]) < 4.0] = 0.0
        return out


@njit(cache=True, nogil=True)
def _waves(q: float, fade: float, n: Array, step: float, s: Array, c: Array) -> None:
    """``exp(-fade n^2)`` times sine and cosine of ``n q`` for evenly spaced ``n``: each from the one before it."""
    turn_s, turn_c = np.sin(step * q), np.cos(step * q)
    now_s, now_c = np.sin(n[0] * q), np.cos(n[0] * q)
    size = np.exp(-fade * n[0] ** 2)
    ratio, fall = np.exp(-fade * step * (2 * n[0] + step)), np.exp(-2 * fade * step**2)
    for m in range(len(n)):
        s[m], c[m] = size * now_s, size * now_c
        now_s, now_c = now_s * turn_c + now_c * turn_s, now_c * turn_c - now_s * turn_s
        size *= ratio
        ratio *= fall


@njit(cache=True, nogil=True)
def _products(q: Array, fade: Array, r: Array, n: Array, step: float) -> tuple[Array, Array]:
    """Sums over the rows of ``r`` times sine and cosine, (R,) each."""
    s, c, a, b = np.empty(len(n)), np.empty(len(n)), np.zeros(len(n)), np.zeros(len(n))
    for k in range(len(q)):
        _waves(q[k], fade[k], n, step, s, c)
        for m in range(len(n)):
            a[m] += r[k] * s[m]
            b[m] += r[k] * c[m]
    return a, b


@njit(cache=True, nogil=True)
def _power(q: Array, fade: Array, start: Mask, a: Array, sd: Array, n: Array, step: float) -> tuple[Array, Array, Array]:
    """Sums of squares and products of the whitened sines and cosines; the last rows stand in a ring."""
    order = len(sd) - 1
    s, c = np.zeros((order + 1, len(n))), np.zeros((order + 1, len(n)))
    x, y = np.empty(len(n)), np.empty(len(n))
    ss, cc, sc = np.zeros(len(n)), np.zeros(len(n)), np.zeros(len(n))
    run = 0
    for k in range(len(q)):
        run = 0 if start[k] else run + 1
        history = min(run, order)
        here = k % (order + 1)
        _waves(q[k], fade[k], n, step, s[here], c[here])
        x[:], y[:] = s[here], c[here]
        for p in range(history):
            row = (k - 1 - p) % (order + 1)
            weight = a[history, p]
            for m in range(len(n)):
                x[m] -= weight * s[row, m]
                y[m] -= weight * c[row, m]
        scale = 1.0 / sd[history] ** 2
        for m in range(len(n)):
            ss[m] += scale * x[m] * x[m]
            cc[m] += scale * y[m] * y[m]
            sc[m] += scale * x[m] * y[m]
    return ss, cc, sc
