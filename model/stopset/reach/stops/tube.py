"""The certified tube of a power-off stop: all positions and speeds the arm can have at any time after the cut.

    M(q) dv/dt + c(q, v) + g(q) + D v + f = u(t),   f_i in (F_i + B_i(t)) Sgn(v_i),   u in U (any function of time)

The tube is marched through time in steps, so nothing has to be guessed about the whole stop.  On a step:

1. *Claims.* Accelerations of every joint while it moves forward and while it moves backward are claimed; with them the
   speeds and angles on the whole step are bounded, hence M, c, g, D v.
2. *Who moves.* At almost every time the joints split into moving ones ``f`` and resting ones, with acceleration exactly
   zero for these (a set where v_i = 0 has v_i' = 0 almost everywhere), and ``M_ff a_f = r_f``.  Joints whose sign is
   certain on the step are fixed; all subsets of the uncertain ones are visited in Gray-code order, each one pivot from
   the last.  The hull over the subsets bounds each joint's acceleration while moving forward and while moving backward.
   Uncertainty of M is carried over as torque ``|dM| |a|`` with the claimed ``a``.
3. *Verification.* The hull must lie inside the claims.  Velocities are continuous, so a first exit from the claimed
   bounds is impossible then; else the claims grow and the step is repeated.
4. *Step.* Bounds of the speed go on with those rates, and stop at zero unless the joint can start from rest: the largest
   solution of the one-sided comparison (a Skorokhod reflection).  Straight lines between knots bound the speed from
   outside at all times, so trapezoids bound the angle.
5. *Energy* (on request, for strong coupling).  The kinetic energy caps all speeds of the step beforehand, without claims of
   accelerations; where these cannot be verified the caps alone bound the step.

Source: stop notes of the project, comparison system with zero crossing; Moreau (1988) for the inclusion;
Goodnight (1979) for the sweep operator; Spong, Hutchinson & Vidyasagar (2006), ch. 7, for the
skew symmetry that the energy rests on.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from stopset.core.library import check, ffi, given, lib, view
from stopset.reach.stops.expansion import Curvature
from stopset.reach.stops.parts import Parts
from stopset.robot.rigid import Chain, arm_struct
from stopset.sets import Box
from stopset.types import Array

OK, ENDLESS, UNBOUNDED = 0, 1, 2  # how a tube ends: at rest; still moving at the last step; claims not verifiable
PASSES: int = lib.STOPSET_TUBE_PASSES  # of claims per step; each grows them, an arm with bounded coupling needs one or two
RECENTRE: float = lib.stopset_tube_recentre  # [rad] sum of angles from the pose of expansion until a new one is worth its cost
ENERGY_CLAIMS: int = lib.STOPSET_ENERGY_CLAIMS  # of caps per step
ENERGY_ROUNDING: float = lib.stopset_energy_rounding  # outward, as a factor
RATE_ROUNDING: float = lib.stopset_rate_rounding  # relative outward widening of accelerations
_recent: list[tuple[tuple[Any, ...], ...]] = [()]  # the last two plants in one tuple: threads ask while others add
_ROWS = (
    "pi_half", "rotor", "rotor_half", "coulomb_lo", "coulomb_hi", "viscous_lo", "viscous_hi", "u_lo", "u_hi", "brake_lo", "brake_hi",
    "delay_lo", "delay_hi", "rise_lo", "rise_hi",
)  # fmt: skip


class Plant(NamedTuple):
    """What bounds a power-off stop: parameters as intervals, SI, (n,) arrays unless said."""

    chain: Chain
    pi: Array  # (n, 10) at the middle of the payload's range
    pi_half: Array  # (n, 10) half the payload's range
    rotor: Array  # middle of its interval
    rotor_half: Array
    coulomb_lo: Array
    coulomb_hi: Array
    viscous_lo: Array
    viscous_hi: Array
    u_lo: Array
    u_hi: Array
    brake_lo: Array
    brake_hi: Array
    delay_lo: Array
    delay_hi: Array
    rise_lo: Array
    rise_hi: Array
    curvature: Curvature


class Tube(NamedTuple):
    """Bounds at the knots ``t`` (K + 1,); displacement since the cut [rad] and speed [rad/s], (K + 1, n) each.

    On step k the speed lies between the straight lines from ``v_lo[k], v_hi[k]`` to ``e_lo[k], e_hi[k]`` (K, n); at the
    knot itself the momenta may have tightened it further.  ``forward_hi`` etc. (K, n): acceleration bounds while moving;
    ``end``: see OK.
    """

    end: int
    t: Array
    d_lo: Array
    d_hi: Array
    v_lo: Array
    v_hi: Array
    e_lo: Array
    e_hi: Array
    forward_lo: Array
    forward_hi: Array
    backward_lo: Array
    backward_hi: Array
    margin: Array  # (n,) brake and Coulomb torque left when holding the arm where it ends [N m]
    energetic: bool  # whether the kinetic energy had to help
    travel_left: Array  # (K + 1, n) [rad]: from this knot on, sum over joints of travel / this <= 1; inf where that is not known
    energy: Array  # (K,) [(kg m^2)^1/2 rad/s]: sqrt(v' M v) is no more on each step; inf where that is not known
    plant: Plant | None = None  # whose stops these are, if they are of one that brakes


def plant_struct(plant: Plant) -> tuple[Any, list[Any]]:
    """``StopsetPlant``, and what must live as long."""
    made: tuple[Any, list[Any]]
    for its_plant, made in _recent[0]:  # most tubes are of the plant of the tube before
        if its_plant is plant:
            return made
    n, K = len(plant.rotor), plant.curvature
    rows = [given(getattr(plant, name)) for name in _ROWS]
    bent = [given(x) for x in (K.M, K.g, K.size, K.load)]
    if (
        rows[0].shape != (n, 10)
        or any(x.shape != (n,) for x in rows[1:])
        or [x.shape for x in bent] != [(n,) * 4, (n,) * 3, (n,), (n,)]
    ):
        raise ValueError(f"a plant of {n} joints with {[x.shape for x in rows]} and curvature {[x.shape for x in bent]}")
    arm = arm_struct(plant.chain, plant.pi)
    struct = ffi.new("StopsetPlant *", (arm[0], *(view(x) for x in rows), tuple(view(x) for x in bent)))
    made = struct, [arm, rows, bent]
    given_as = [*(getattr(plant, name) for name in _ROWS), K.M, K.g, K.size, K.load]
    if all(x is y for x, y in zip(given_as, rows + bent, strict=True)):  # a copy would not see what is written into the original
        _recent[0] = ((plant, made), *_recent[0][:1])
    return made


class Stride(NamedTuple):
    """How a tube is marched: in steps of ``h`` [s], at most ``most`` of them; of at most ``brief`` [s] from when the first brake may close until
    all have."""

    h: float
    most: int
    brief: float = np.inf


def march(plant: Plant, q: Box, dq: Box, steps: Stride, parts: Parts, *, energetic: bool = False) -> Tube:
    """The tube from angles ``q`` and speeds ``dq`` (n,) at the cut.

    ``energetic``: with the kinetic energy's caps, which end the tube whenever brakes and friction surely hold the arm.
    """
    n, made = len(plant.rotor), ffi.new("int64_t *")
    box = [given(x) for x in (q.lo, q.hi, dq.lo, dq.hi)]
    if any(x.shape != (n,) for x in box):
        raise ValueError(f"a box of {[x.shape for x in box]} for {n} joints")
    struct, _held = plant_struct(plant)
    count = steps.most
    t, knots, ends = np.empty(count + 1), np.empty((5, count + 1, n)), np.empty((2, count, n))
    rates, margin, energy = np.empty((4, count, n)), np.empty(n), np.empty(count)
    lines = [view(x) for x in (t, *knots[:4], *ends)]
    tube = ffi.new("StopsetTube *", (*lines, [view(x) for x in rates], view(margin), view(knots[4]), view(energy)))
    states = ffi.new("StopsetBox *", (ffi.NULL, *(view(x) for x in box)))
    stride = ffi.new("StopsetStride *", (steps.h, steps.brief, count, int(energetic)))
    end = lib.stopset_stop_tube(struct, states, stride, ffi.new("StopsetParts *", tuple(parts)), tube, made)
    check(-min(end, 0))
    m = made[0]
    d_lo, d_hi, v_lo, v_hi, travel_left = knots[:, : m + 1]
    e_lo, e_hi = ends[:, :m]
    return Tube(
        end, t[: m + 1], d_lo, d_hi, v_lo, v_hi, e_lo, e_hi, *rates[:, :m], margin, energetic, travel_left, energy[:m], plant
    )  # type: ignore[call-arg]
