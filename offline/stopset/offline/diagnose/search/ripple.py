"""The search for torque ripple: which cycles per turn a joint's residual holds, from a fine grid of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from stopset.core.library import ffi, flags, given, lib, view
from stopset.effects import Effect
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.rows.noise import Whitening
from stopset.offline.diagnose.rows.rows import JointRows
from stopset.offline.diagnose.search.wanted import Wanted
from stopset.types import Array

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

    def strongest(self, now: Hypothesis, theta: Array, hyper: Hyper) -> list[Wanted]:
        """The strongest two cycles per turn in each joint's residual of ``now``, beyond what chance gives."""
        out: list[Wanted] = []
        view, d = now.view(), self.engine.data
        full = np.concatenate([[1.0], -theta])
        spread = d.kernel.dt * np.sqrt(np.sum(d.kernel.h * np.arange(-d.kernel.half, d.kernel.half + 1) ** 2))
        for j, rows in enumerate(self.engine.rows):
            k = len(rows.take)
            if k < limit.PATTERN_ROWS:
                continue
            gram = view.engine.grams[j]
            r = gram.residual(full[gram.index], hyper.sigma[j], hyper.kappa[j])[:k]
            q, fade = d.q[rows.take, j], 0.5 * (d.dq[rows.take, j] * spread) ** 2
            if j not in self._power or self._power[j][0] is not rows:
                self._power[j] = rows, Power(*_power(q, fade, rows.whiten, RIPPLES, STEP))
            ss, cc, sc = self._power[j][1]
            a, b = _products(q, fade, rows.whiten.adjoint(r), RIPPLES, STEP)
            power = (cc * a * a - 2 * sc * a * b + ss * b * b) / np.maximum(ss * cc - sc * sc, 1e-9 * ss * cc + 1e-12)
            power = power / hyper.kappa[j]
            for _ in range(2):
                top = int(np.argmax(power))
                if power[top] < 2 * np.log(len(RIPPLES)):
                    break
                out.append((self.effect, (j,), {"n": float(RIPPLES[top])}))
                power[np.abs(RIPPLES - RIPPLES[top]) < limit.RIPPLE_SEPARATION] = 0.0
        return out


def _products(q: Array, fade: Array, r: Array, n: Array, step: float) -> tuple[Array, Array]:
    """Sums over the rows of ``r`` times sine and cosine, (R,) each, of ripples ``n`` (R,), evenly spaced by ``step``."""
    a, b, work = np.empty(len(n)), np.empty(len(n)), np.empty((2, len(n)))
    ripples, _held = _ripples(q, fade, n, step)
    lib.stopset_ripple_products(ripples, view(given(r)), view(work), view(a), view(b))
    return a, b


def _ripples(q: Array, fade: Array, n: Array, step: float) -> tuple[Any, list[Array]]:
    """``StopsetRipples``, and what must live as long."""
    held = [given(q), given(fade)]
    return ffi.new("StopsetRipples *", (len(q), len(n), *(view(x) for x in held), n[0], step)), held


def _power(q: Array, fade: Array, whiten: Whitening, n: Array, step: float) -> tuple[Array, Array, Array]:
    """Sums of squares and products of the whitened sines and cosines."""
    ss, cc, sc = np.empty((3, len(n)))
    work = np.empty((2 * whiten.sd.shape[1] + 2, len(n)))
    ripples, _held = _ripples(q, fade, n, step)
    lib.stopset_ripple_power(whiten.struct(len(q)), ripples, flags(whiten.start), view(work), view(ss), view(cc), view(sc))
    return ss, cc, sc
