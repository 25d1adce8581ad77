"""The rigid body for the loops that numba still compiles: the core's own functions, found by name in the loaded library."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import binding
from numba import njit, types

from stopset.core.build import HERE, library_name
from stopset.core.library import Array
from stopset.robot.rigid import Chain

binding.load_library_permanently(str(HERE / library_name()))
_at = types.uintp  # a pointer
_link_frames: Any = types.ExternalFunction("stopset_link_frames", types.int32(_at, types.int64, _at, _at, _at))
_mass_matrices: Any = types.ExternalFunction("stopset_mass_matrices", types.int32(_at, types.int64, _at, _at))


@njit(cache=True)
def _arm(chain: Chain, pi: Array) -> Array:
    """``StopsetArm``: the number of joints, and where its numbers lie."""
    out: Array = np.array(
        [
            len(chain.p),
            chain.R.ctypes.data,
            chain.p.ctypes.data,
            chain.axis.ctypes.data,
            chain.gravity.ctypes.data,
            pi.ctypes.data,
        ],
        dtype=np.uint64,
    )
    return out


@njit(cache=True)
def link_frames(chain: Chain, q: Array) -> tuple[Array, Array]:
    """`stopset.robot.rigid.link_frames` of one pose ``q`` (n,)."""
    n = q.shape[0]
    arm, here, R, o = _arm(chain, q), q.copy(), np.empty((n, 3, 3)), np.empty((n, 3))
    _link_frames(arm.ctypes.data, 1, here.ctypes.data, R.ctypes.data, o.ctypes.data)
    return R, o


@njit(cache=True)
def mass_matrix(chain: Chain, pi: Array, q: Array) -> Array:
    """`stopset.robot.rigid.mass_matrix` of one pose ``q`` (n,)."""
    arm, links, here, M = _arm(chain, pi), pi.copy(), q.copy(), np.empty((q.shape[0], q.shape[0]))
    arm[5] = links.ctypes.data
    _mass_matrices(arm.ctypes.data, 1, here.ctypes.data, M.ctypes.data)
    return M
