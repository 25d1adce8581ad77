"""The nominal prediction of an abstraction, linear or not.

Source: Liu & Althoff (2018), sec. IV-C.
"""

from __future__ import annotations

import numpy as np

from stopset.artifact import Abstraction
from stopset.core.library import given, lib, view
from stopset.reach.flowpipe import discretise
from stopset.reach.nonlinear import nominal
from stopset.types import Array


def predict(abstraction: Abstraction, dt: float, x0: Array, u: Array) -> Array:
    """Nominal prediction ``x*`` (N, 2n) from ``x0`` (2n,) under inputs ``u`` (N, n) held over each step."""
    if not abstraction.linear:
        path: Array = nominal(abstraction, x0[None], u[None, :-1], dt)[0]
        return path
    Ad, Bd = discretise(abstraction, dt)
    out = np.empty((u.shape[0], x0.shape[0]))
    out[0] = x0
    lib.stopset_predict(abstraction.n, view(Ad), view(Bd), len(out), view(given(u)), view(out))
    return out
