"""Mass matrix and bias torque of an arm in one pass, as the simulator computes them: in base coordinates, by code of its own.

Nothing here shares a line with `stopset.robot.rigid`, to which the tests hold it.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 2.10 (acceleration), 5.3 and 6.2, in base coordinates.
"""

from __future__ import annotations

import numpy as np

from stopset.core.library import check, given, lib, view
from stopset.robot.rigid import Chain, arm_struct
from stopset.types import Array


def motor_torques(chain: Chain, pi: Array, rotor: Array, q: Array, dq: Array, ddq: Array) -> Array:
    """(K, n) torque [N m] of rigid body and rotors for every row of ``q, dq, ddq`` (K, n)."""
    if not q.shape == dq.shape == ddq.shape == (len(q), len(pi)) or rotor.shape != (len(pi),):
        raise ValueError(f"rows of {q.shape}, {dq.shape}, {ddq.shape} for {len(pi)} joints")
    out = np.empty(q.shape)
    rows = [view(given(x)) for x in (q, dq, ddq)]
    check(lib.stopset_sim_torques(arm_struct(chain, pi), view(given(rotor)), len(q), *rows, view(out)))
    return out
