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
Goodnight (1979) for the sweep operator.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from stopset.reach.stops.claims import claimed_speeds, claims_hold, guess_claims, nothing_known
from stopset.reach.stops.energy import by_power, cap_bands, cap_lines, largest, power_excess, start_energy, step_energy
from stopset.reach.stops.expansion import Curvature, Expansion, Scratch, empty_expansion, expand_into
from stopset.reach.stops.local import Local, Parts, box_terms, empty_local
from stopset.reach.stops.momentum import Bands, carry_on, kept_impulse, start_bands, start_momentum, tighten, total
from stopset.reach.stops.moving import accelerations
from stopset.robot.rigid import Array, Chain

OK, ENDLESS, UNBOUNDED = 0, 1, 2  # how a tube ends: at rest; still moving at the last step; claims not verifiable
REDOS = 4  # of a step, when a first excursion can end with less brake impulse than was taken
PASSES = 40  # of claims per step; each grows them, an arm with bounded coupling needs one or two
RECENTRE = 0.01  # [rad] sum of angles from the pose of expansion after which a new one is worth its cost


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


@njit(cache=True)
def _ramp(t: float, delay: float, rise: float) -> float:
    if t <= delay:
        return 0.0
    if t >= delay + rise:
        return 1.0
    return (t - delay) / rise


@njit(cache=True)
def _advance(b: Bands, out: Array, zero: Array, h: float, end: Bands) -> None:
    """Bands at the end of a step of ``h`` seconds, from the verified accelerations ``out`` (see `accelerations`)."""
    for i in range(zero.shape[0]):
        start_up, start_down = h * max(0.0, out[8, i]), h * min(0.0, out[9, i])
        end.alive[i], end.rested[i] = b.alive[i], b.rested[i]
        end.later_lo[i], end.later_hi[i] = 0.0, 0.0
        if b.rested[i] > 0.0:
            # the rate refined at the bound's own speed belongs to the first excursion while that may last
            up = out[8, i] if b.alive[i] > 0.0 else out[4, i]
            down = out[9, i] if b.alive[i] > 0.0 else out[7, i]
            end.later_hi[i] = max(b.later_hi[i] + h * up, 0.0) if b.later_hi[i] > 0.0 else start_up
            end.later_lo[i] = min(b.later_lo[i] + h * down, 0.0) if b.later_lo[i] < 0.0 else start_down
        if b.alive[i] == 0.0:
            continue
        if b.sign[i] > 0.0:
            end.first_hi[i] = max(b.first_hi[i] + h * out[4, i], 0.0)
            end.first_lo[i] = max(b.first_lo[i] + h * (out[0, i] if b.rested[i] > 0.0 else out[5, i]), 0.0)
            ends = end.first_lo[i] <= 0.0
        else:
            end.first_lo[i] = min(b.first_lo[i] + h * out[7, i], 0.0)
            end.first_hi[i] = min(b.first_hi[i] + h * (out[3, i] if b.rested[i] > 0.0 else out[6, i]), 0.0)
            ends = end.first_hi[i] >= 0.0
        if ends and b.rested[i] == 0.0:
            end.rested[i] = 1.0
            end.later_hi[i], end.later_lo[i] = start_up, start_down
        if end.first_lo[i] == end.first_hi[i] == 0.0:
            end.alive[i] = 0.0


@njit(cache=True)
def _expand(plant: Plant, q: Array, E: Expansion, scratch: Scratch) -> None:
    """The expansion at ``q``, the rotors' half intervals beside the payload's: both are constant during a stop."""
    expand_into(plant.chain, plant.pi, plant.pi_half, plant.rotor, q, E, scratch)
    loaded = np.any(plant.pi_half[q.shape[0] - 1] != 0.0)
    for i in range(q.shape[0]):
        E.Mp[i, i] = (abs(E.Mp[i, i]) if loaded else 0.0) + plant.rotor_half[i]


@njit(cache=True)
def march(
    plant: Plant,
    q_lo: Array,
    q_hi: Array,
    v0_lo: Array,
    v0_hi: Array,
    h: float,
    steps: int,
    parts: Parts,
    energetic: bool = False,
) -> Tube:
    """The tube from the box ``[q_lo, q_hi] x [v0_lo, v0_hi]`` at the cut, in steps of ``h`` seconds, at most ``steps``.

    ``energetic``: with the kinetic energy's caps, which end the tube whenever brakes and friction surely hold the arm.
    """
    n = q_lo.shape[0]
    t = np.zeros(steps + 1)
    d_lo, d_hi = np.zeros((steps + 1, n)), np.zeros((steps + 1, n))
    v_lo, v_hi = np.zeros((steps + 1, n)), np.zeros((steps + 1, n))
    e_lo, e_hi = np.zeros((steps, n)), np.zeros((steps, n))
    rates = np.zeros((steps, 4, n))
    margin = np.full(n, -np.inf)
    v_lo[0], v_hi[0] = v0_lo, v0_hi
    claim, last = np.zeros((4, n)), np.zeros((4, n))  # forward lo, hi, backward lo, hi
    out, work, wide = np.zeros((10, n)), np.zeros((8, n)), np.zeros((20, n))
    w_lo, w_hi, x_lo, x_hi = wide[0], wide[1], wide[2], wide[3]
    s_lo, s_hi, own_up, own_down = wide[4], wide[5], wide[6], wide[7]
    plus, minus, zero, a_far = wide[8], wide[9], wide[10], wide[11]
    B_lo, B_hi, B_later, way = wide[12], wide[13], wide[14], wide[15]
    need, drop, kept, before = wide[16], wide[17], wide[18], wide[19]
    at, start = empty_local(n), empty_local(n)
    middle = 0.5 * (q_lo + q_hi)
    E, scratch = empty_expansion(n)
    _expand(plant, middle, E, scratch)
    K, gravity = plant.curvature, E.g.copy()
    box_terms(E, K, q_lo - E.q, q_hi - E.q, v0_lo, v0_hi, parts, start, work)
    b, end = start_bands(v0_lo, v0_hi), start_bands(v0_lo, v0_hi)
    momentum = start_momentum(start, v0_lo, v0_hi, b)
    energy = start_energy(start, v0_lo, v0_hi)
    rotor_lo, rotor_hi = plant.rotor - plant.rotor_half, plant.rotor + plant.rotor_half
    room, excess = np.zeros((5, n)), np.zeros(n)
    engaged = np.max(plant.delay_hi + plant.rise_hi)
    # bands that feed on each other grow without end; what the energy allows is finite, however fast an arm may fall
    fastest = np.inf if energetic else 20.0 * max(np.max(np.abs(v0_lo)), np.max(np.abs(v0_hi))) + 20.0
    here = middle.copy()
    result, made = ENDLESS, steps
    for k in range(steps):
        now = k * h
        far = 0.0
        for i in range(n):
            here[i] = middle[i] + 0.5 * (d_lo[k, i] + d_hi[k, i])
            far += abs(here[i] - E.q[i])
        if far > RECENTRE:
            _expand(plant, here + 0.5 * (here - E.q), E, scratch)
            if parts.gravity_slope == 0.0:
                E.g[:] = gravity
        early, late = (now, now + h) if parts.whole_step > 0.0 else (now + h, now)
        for i in range(n):
            B_lo[i] = plant.coulomb_lo[i] + plant.brake_lo[i] * _ramp(early, plant.delay_hi[i], plant.rise_hi[i])
            B_hi[i] = plant.coulomb_hi[i] + plant.brake_hi[i] * _ramp(late, plant.delay_lo[i], plant.rise_lo[i])
        if energetic:
            for i in range(n):
                x_lo[i], x_hi[i] = q_lo[i] + d_lo[k, i] - E.q[i], q_hi[i] + d_hi[k, i] - E.q[i]
            y = energy.y[0]
            if not step_energy(
                energy, E, K, rotor_lo, rotor_hi, x_lo, x_hi, plant.u_lo, plant.u_hi, B_lo, h, parts, at, work, room
            ):
                result, made = UNBOUNDED, k
                break
            for i in range(n):  # known before any claim: speeds at this knot
                v_lo[k, i], v_hi[k, i] = max(v_lo[k, i], -energy.cap[i]), min(v_hi[k, i], energy.cap[i])
        guess_claims(claim, out, last, k)
        # the impulse that ends first excursions during this step is known after it: taken a little less, then checked
        for i in range(n):
            need[i] = momentum.needed[i] - 2.0 * drop[i] if b.alive[i] > 0.0 else momentum.needed[i]
        for redo in range(REDOS + 1):
            _later_friction(plant, now + h, b, need, B_lo, B_hi, B_later, way)
            verified = False
            for _attempt in range(PASSES):
                claimed_speeds(h, v_lo[k], v_hi[k], claim, energy.cap, w_lo, w_hi, plus, minus, zero, a_far)
                for i in range(n):
                    x_lo[i] = q_lo[i] + d_lo[k, i] + h * min(0.0, w_lo[i]) - E.q[i]
                    x_hi[i] = q_hi[i] + d_hi[k, i] + h * max(0.0, w_hi[i]) - E.q[i]
                box_terms(E, K, x_lo, x_hi, w_lo, w_hi, parts, at, work)
                _torques(plant, at, b, claim, h, v_lo[k], v_hi[k], w_lo, w_hi, s_lo, s_hi, own_up, own_down)
                accelerations(
                    at.M, at.dM, s_lo, s_hi, own_up, own_down, B_lo, B_hi, B_later, way, plus, minus, zero, a_far, out, work
                )
                if claims_hold(out, claim, plus, minus, zero):
                    verified = True
                    break
            if not verified and not energetic:
                break
            if not verified:
                for i in range(n):
                    x_lo[i] = q_lo[i] + d_lo[k, i] - E.q[i] - h * energy.cap[i]
                    x_hi[i] = q_hi[i] + d_hi[k, i] - E.q[i] + h * energy.cap[i]
                box_terms(E, K, x_lo, x_hi, -energy.cap, energy.cap, parts, at, work)
                nothing_known(out)
            _advance(b, out, zero, h, end)
            if not verified:
                cap_bands(end, energy.cap)
            total(end, e_lo[k], e_hi[k])
            if energetic:
                cap_lines(energy.cap, v_lo[k], v_hi[k], e_lo[k], e_hi[k], not verified)
            for i in range(n):
                x_lo[i], x_hi[i] = min(v_lo[k, i], e_lo[k, i]), max(v_hi[k, i], e_hi[k, i])
            kept_impulse(
                momentum, at, start, plant.u_lo, plant.u_hi, plant.viscous_hi, plant.coulomb_hi, b, end, v0_lo, v0_hi,
                x_lo, x_hi, h, kept,
            )  # fmt: skip
            enough = True
            for i in range(n):
                if b.alive[i] > 0.0 and b.rested[i] > 0.0 and 0.0 < need[i] < np.inf and kept[i] < need[i]:
                    enough = False
                    need[i] = kept[i] - 0.01 * abs(kept[i]) if redo < REDOS - 1 else 0.0
            if enough:
                break
        if not verified and not energetic:
            result, made = UNBOUNDED, k
            break
        for i in range(n):
            hi, lo, new_hi, new_lo = v_hi[k, i], v_lo[k, i], e_hi[k, i], e_lo[k, i]
            # trapezoids: chords lie outside a bound that is convex; where it crosses zero, its larger end does
            d_hi[k + 1, i] = d_hi[k, i] + h * (max(new_hi, 0.0) if hi < 0.0 and new_hi >= 0.0 else 0.5 * (hi + new_hi))
            d_lo[k + 1, i] = d_lo[k, i] + h * (min(new_lo, 0.0) if lo > 0.0 and new_lo <= 0.0 else 0.5 * (lo + new_lo))
            if parts.whole_step == 0.0:
                d_hi[k + 1, i], d_lo[k + 1, i] = d_hi[k, i] + h * new_hi, d_lo[k, i] + h * new_lo
            for row in range(4):
                rates[k, row, i] = out[row, i]
        before[:] = momentum.needed
        carry_on(
            momentum, at, plant.u_lo, plant.u_hi, plant.viscous_lo, plant.viscous_hi, plant.coulomb_hi,
            B_lo, B_hi, B_later, b, end, kept, x_lo, x_hi, h,
        )  # fmt: skip
        for i in range(n):
            drop[i] = max(before[i] - momentum.needed[i], 0.0) if before[i] < np.inf else 0.0
        v_lo[k + 1], v_hi[k + 1] = e_lo[k], e_hi[k]
        if energetic:
            if verified:
                power_excess(energy, plant.u_lo, plant.u_hi, B_lo, x_lo, x_hi, excess)
                energy.y[0] = min(energy.y[0], by_power(y, excess, x_lo, x_hi, h))
            cap_bands(end, energy.end)
            total(end, v_lo[k + 1], v_hi[k + 1])
        tighten(end, momentum, at, start, v0_lo, v0_hi, v_lo[k + 1], v_hi[k + 1], work)
        total(end, v_lo[k + 1], v_hi[k + 1])
        if energetic:
            energy.y[0] = min(energy.y[0], largest(at, v_lo[k + 1], v_hi[k + 1]))
        b, end = end, b
        t[k + 1] = now + h
        if not np.max(v_hi[k + 1] - v_lo[k + 1]) < fastest:
            result, made = UNBOUNDED, k + 1
            break
        if now >= engaged and np.all(v_lo[k + 1] == 0.0) and np.all(v_hi[k + 1] == 0.0):
            for i in range(n):  # at rest gravity and disturbance are all there is to hold
                up, down = min(-at.h_lo[i], K.load[i]) + plant.u_hi[i], min(at.h_hi[i], K.load[i]) - plant.u_lo[i]
                margin[i] = B_lo[i] - max(up, down)
            if np.min(margin) >= 0.0:  # and so it stays: from now on nothing changes any more
                result, made = OK, k + 1
                break
    return Tube(
        result, t[: made + 1], d_lo[: made + 1], d_hi[: made + 1], v_lo[: made + 1], v_hi[: made + 1],
        e_lo[:made], e_hi[:made], rates[:made, 0], rates[:made, 1], rates[:made, 2], rates[:made, 3], margin, energetic,
    )  # fmt: skip


@njit(cache=True)
def _later_friction(plant: Plant, now: float, b: Bands, need: Array, B_lo: Array, B_hi: Array, later: Array, way: Array) -> None:
    """Least dry friction of a joint that has come to rest by now, and the direction it can move in with less.

    Its brake has given at least the impulse that ended the first excursion.  The brake's torque only grows, so it is now
    at least that impulse over the time it can have worked; a ramp has given half of its torque times the time.  ``now``: the
    end of the step, ``need``: the impulse, for rests during the step too.
    """
    for i in range(B_lo.shape[0]):
        later[i] = B_lo[i]
        way[i] = 0.0
        if b.sign[i] == 0.0:
            continue
        if b.alive[i] > 0.0:
            way[i] = b.sign[i]
        since = now - plant.delay_lo[i]
        if b.rested[i] > 0.0 and need[i] > 0.0 and need[i] < np.inf and since > 0.0:
            worked = max(0.5 * since, since - 0.5 * plant.rise_lo[i])
            later[i] = min(max(B_lo[i], plant.coulomb_lo[i] + need[i] / worked), B_hi[i])
        if b.alive[i] == 0.0:
            B_lo[i] = later[i]


@njit(cache=True)
def _torques(
    plant: Plant, at: Local, b: Bands, claim: Array, h: float, lo: Array, hi: Array, w_lo: Array, w_hi: Array,
    s_lo: Array, s_hi: Array, own_up: Array, own_down: Array,
) -> None:  # fmt: skip
    """Torques without dry friction on a step; and what viscous friction surely takes at a joint's own speed bound."""
    for i in range(lo.shape[0]):
        D_lo, D_hi = plant.viscous_lo[i], plant.viscous_hi[i]
        least, most = min(D_lo * w_lo[i], D_hi * w_lo[i]), max(D_lo * w_hi[i], D_hi * w_hi[i])
        s_lo[i] = -at.h_hi[i] - most + plant.u_lo[i]
        s_hi[i] = -at.h_lo[i] - least + plant.u_hi[i]
        fast, slow = w_lo[i], w_hi[i]
        upper = b.first_hi[i] if b.alive[i] > 0.0 and b.sign[i] > 0.0 else hi[i]
        lower = b.first_lo[i] if b.alive[i] > 0.0 and b.sign[i] < 0.0 else lo[i]
        if upper > 0.0:
            fast = max(upper + h * min(0.0, claim[0, i]), 0.0)
        elif upper < 0.0:
            fast = upper + h * min(0.0, claim[2, i])
        if lower < 0.0:
            slow = min(lower + h * max(0.0, claim[3, i]), 0.0)
        elif lower > 0.0:
            slow = lower + h * max(0.0, claim[1, i])
        own_up[i] = max(0.0, min(D_lo * fast, D_hi * fast) - least)
        own_down[i] = max(0.0, most - max(D_lo * slow, D_hi * slow))
