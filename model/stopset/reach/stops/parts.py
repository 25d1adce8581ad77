"""Parts of the stop proofs that the tests leave out, to show that each is needed."""

from __future__ import annotations

from typing import NamedTuple


class Parts(NamedTuple):
    """How much of each part of the bound is taken: all of it. The tests take less, to show that each part is needed."""

    coupling: float = 1.0  # off-diagonal inertia
    christoffel: float = 1.0
    gravity_slope: float = 1.0
    whole_step: float = 1.0  # 0: brakes and speeds taken at the end of each step only
    bend: float = 1.0  # what the inertia has beyond its first slopes
    pull: float = 1.0  # what the others pull at a joint that rests
    shared: float = 1.0  # what one angle, one speed and the payload do to all accelerations at once
    held: float = 1.0  # of the momenta with which what moves holds the kinetic energy
    still: float = 1.0  # of the kinetic energy that a way with it still has


ALL_PARTS = Parts()
