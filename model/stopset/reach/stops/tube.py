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

Source: stop notes of the project, comparison system with zero crossing; Moreau (1988) for the inclusion;
Goodnight (1979) for the sweep operator.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from stopset.reach.stops.expansion import Curvature, Expansion, expand
from stopset.robot.rigid import Array, Chain

OK, ENDLESS, UNBOUNDED = 0, 1, 2  # how a tube ends: at rest; still moving at the last step; claims not verifiable
PASSES = 40  # of claims per step; each grows them, an arm with bounded coupling needs one or two
RECENTRE = 0.06  # [rad] sum of angles from the pose of expansion after which a new one is worth its cost
ROUNDING = 1e-9  # relative outward widening of accelerations; the arithmetic itself errs by some 1e-13


class Plant(NamedTuple):
    """What bounds a power-off stop: parameters as intervals, SI, (n,) arrays unless said."""

    chain: Chain
    pi: Array  # (n, 10) at the middle of the payload's range
    pi_half: Array  # (n, 10) half the payload's range
    rotor: Array
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


class Parts(NamedTuple):
    """How much of each part of the bound is taken. All ones; the tests set them lower to show that each part is needed."""

    coupling: float = 1.0  # off-diagonal inertia
    christoffel: float = 1.0
    gravity_slope: float = 1.0
    whole_step: float = 1.0  # 0: brakes and speeds taken at the end of each step only


ALL_PARTS = Parts()


class Tube(NamedTuple):
    """Bounds at the knots ``t`` (K + 1,); displacement since the cut [rad] and speed [rad/s], (K + 1, n) each.

    Between knots: speeds lie between the straight lines joining the knots' bounds, hence displacements do too up to the
    trapezoid of those (`state_bounds`).  ``forward_hi`` etc. (K, n): acceleration bounds while moving, ``end``: see OK.
    """

    end: int
    t: Array
    d_lo: Array
    d_hi: Array
    v_lo: Array
    v_hi: Array
    forward_lo: Array
    forward_hi: Array
    backward_lo: Array
    backward_hi: Array
    margin: Array  # (n,) brake and Coulomb torque left when holding the arm where it ends [N m]


@njit(cache=True)
def _ramp(t: float, delay: float, rise: float) -> float:
    if t <= delay:
        return 0.0
    if t >= delay + rise:
        return 1.0
    return (t - delay) / rise


@njit(cache=True)
def _pivot(A: Array, k: int, into: bool) -> None:
    """Sweep joint k into (or out of) the moving set: A_ff = -M_ff^-1, A_sf = M_sf M_ff^-1, A_ss = Schur complement."""
    n = A.shape[0]
    d = 1.0 / A[k, k]
    for i in range(n):
        if i != k:
            c = A[i, k] * d
            for j in range(n):
                if j != k:
                    A[i, j] -= c * A[k, j]
    s = d if into else -d
    for i in range(n):
        if i != k:
            A[i, k] *= s
            A[k, i] *= s
    A[k, k] = -d


class Local(NamedTuple):
    """Inertia and torques over a box of angles and speeds: ``M +- M_rad`` for the middle payload, ``Mp +- Mp_rad`` for half
    its range; ``h``: Coriolis and gravity torque; ``e``: ``1/2 v' dM/dq_i v - g_i``, the momentum's rate without input."""

    M: Array
    M_rad: Array
    Mp: Array
    Mp_rad: Array
    dM: Array  # all uncertainty of M: M_rad + |Mp| + Mp_rad
    h_lo: Array
    h_hi: Array
    e_lo: Array
    e_hi: Array


@njit(cache=True)
def _local(n: int) -> Local:
    return Local(
        np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)),
        np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n),
    )  # fmt: skip


@njit(cache=True)
def _box_terms(
    E: Expansion, K: Curvature, x_lo: Array, x_hi: Array, w_lo: Array, w_hi: Array, parts: Parts, out: Local, turn: Array
) -> None:
    """Fill ``out`` for angles ``E.q + [x_lo, x_hi]`` and speeds ``[w_lo, w_hi]``; ``turn`` (n, n, n) is workspace."""
    n = x_lo.shape[0]
    mid, rad, far = np.empty(n), np.empty(n), np.empty(n)
    vc, vr, va = np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        mid[k], rad[k] = 0.5 * (x_lo[k] + x_hi[k]), 0.5 * (x_hi[k] - x_lo[k])
        far[k] = max(abs(x_lo[k]), abs(x_hi[k]))
        vc[k], vr[k] = 0.5 * (w_lo[k] + w_hi[k]), 0.5 * (w_hi[k] - w_lo[k])
        va[k] = abs(vc[k]) + vr[k]
    for i in range(n):
        for j in range(i, n):
            m, r, p, pr = E.M[i, j], 0.0, E.Mp[i, j], 0.0
            for k in range(i + 1, n):
                m += E.dM[i, j, k] * mid[k]
                r += abs(E.dM[i, j, k]) * rad[k]
                p += E.dMp[i, j, k] * mid[k]
                pr += abs(E.dMp[i, j, k]) * rad[k]
                second = 0.0
                for o in range(i + 1, n):
                    second += K.M[i, j, k, o] * far[o]
                # how much dM_ij/dq_k itself can differ from its value at E.q, payload included
                turn[i, j, k] = second
                turn[j, i, k] = second
                r += 0.5 * second * far[k]
            scale = parts.coupling if i != j else 1.0
            out.M[i, j], out.M_rad[i, j], out.Mp[i, j], out.Mp_rad[i, j] = scale * m, scale * r, scale * p, scale * pr
            out.dM[i, j] = scale * (r + abs(p) + pr)
            out.M[j, i], out.M_rad[j, i], out.Mp[j, i] = out.M[i, j], out.M_rad[i, j], out.Mp[i, j]
            out.Mp_rad[j, i], out.dM[j, i] = out.Mp_rad[i, j], out.dM[i, j]
    for i in range(n):
        g, r = E.g[i], abs(E.gp[i])
        for k in range(n):
            g += parts.gravity_slope * E.dg[i, k] * mid[k]
            r += parts.gravity_slope * (abs(E.dg[i, k]) * rad[k] + abs(E.dgp[i, k]) * far[k])
            second = 0.0
            for o in range(n):
                second += K.g[i, k, o] * far[o]
            r += 0.5 * parts.gravity_slope * second * far[k]
        c, cr, e, er = 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            for o in range(k, n):
                twice = 1.0 if k == o else 2.0
                product = twice * vc[k] * vc[o]
                spread = twice * (abs(vc[k]) * vr[o] + vr[k] * abs(vc[o]) + vr[k] * vr[o])
                largest = twice * va[k] * va[o]
                G = E.Gamma[i, k, o]
                beyond = abs(E.Gammap[i, k, o]) + 0.5 * (turn[i, k, o] + turn[i, o, k] + turn[k, o, i])
                c += G * product
                cr += abs(G) * spread + beyond * largest
                if k < i:
                    d = 0.5 * E.dM[k, o, i]
                    e += d * product
                    er += abs(d) * spread + 0.5 * (abs(E.dMp[k, o, i]) + turn[k, o, i]) * largest
        c, cr, e, er = parts.christoffel * c, parts.christoffel * cr, parts.christoffel * e, parts.christoffel * er
        out.h_lo[i], out.h_hi[i] = g + c - r - cr, g + c + r + cr
        out.e_lo[i], out.e_hi[i] = e - g - r - er, e - g + r + er


@njit(cache=True)
def _accelerations(
    M: Array, dM: Array, s_lo: Array, s_hi: Array, own_up: Array, own_down: Array, B_lo: Array, B_hi: Array,
    plus: Array, minus: Array, zero: Array, a_far: Array,
    out: Array, work: Array,
) -> None:  # fmt: skip
    """Hull over all moving sets of each joint's acceleration; rows of ``out`` (6, n): see below.

    ``s``: torque without dry friction; ``own_up``: by how much the viscous torque of the joint itself exceeds its
    smallest value when it moves at the upper speed bound (``own_down``: at the lower bound, below its largest value).
    ``plus, minus, zero``: which signs are possible (1.0 or 0.0).  Rows 0-3: forward lo, hi, backward lo, hi;
    row 4: forward hi at the upper speed bound, row 5: forward lo at the lower; rows 6, 7 the same backward.
    """
    n = M.shape[0]
    r_lo, r_hi = work[0], work[1]  # any sign that is possible
    f_lo, f_hi, b_lo, b_hi = work[2], work[3], work[4], work[5]  # forward, backward
    for i in range(n):
        push = 0.0
        for j in range(n):
            push += dM[i, j] * a_far[j]
        f_lo[i], f_hi[i] = s_lo[i] - push - B_hi[i], s_hi[i] + push - B_lo[i]
        b_lo[i], b_hi[i] = s_lo[i] - push + B_lo[i], s_hi[i] + push + B_hi[i]
        if plus[i] > 0.0 and minus[i] > 0.0:
            r_lo[i], r_hi[i] = f_lo[i], b_hi[i]
        elif minus[i] > 0.0:
            r_lo[i], r_hi[i] = b_lo[i], b_hi[i]
        else:
            r_lo[i], r_hi[i] = f_lo[i], f_hi[i]
    for i in range(n):
        for row in (0, 2, 5, 7):
            out[row, i] = np.inf
        for row in (1, 3, 4, 6):
            out[row, i] = -np.inf
    A = M.copy()
    inside = np.zeros(n, np.bool_)
    open_ = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        if zero[i] == 0.0:
            _pivot(A, i, True)
            inside[i] = True
        elif plus[i] > 0.0 or minus[i] > 0.0:
            open_[count] = i
            count += 1
    subset = 0
    while True:
        for i in range(n):
            if not inside[i] and (plus[i] > 0.0 or minus[i] > 0.0):
                continue  # visited with i moving instead: the same equation
            lo, hi = 0.0, 0.0
            for j in range(n):
                if j == i or not inside[j]:
                    continue
                w = -A[i, j]
                if w > 0.0:
                    lo += w * r_lo[j]
                    hi += w * r_hi[j]
                else:
                    lo += w * r_hi[j]
                    hi += w * r_lo[j]
            # a resting joint would start with this acceleration, were it to start
            w = -A[i, i] if inside[i] else 1.0 / A[i, i]
            if not inside[i]:
                lo *= w
                hi *= w
            if zero[i] > 0.0 or plus[i] > 0.0:
                out[0, i] = min(out[0, i], lo + w * f_lo[i])
                out[1, i] = max(out[1, i], hi + w * f_hi[i])
                out[4, i] = max(out[4, i], hi + w * (f_hi[i] - own_up[i]))
                out[5, i] = min(out[5, i], lo + w * (f_lo[i] + own_down[i]))
            if zero[i] > 0.0 or minus[i] > 0.0:
                out[2, i] = min(out[2, i], lo + w * b_lo[i])
                out[3, i] = max(out[3, i], hi + w * b_hi[i])
                out[6, i] = max(out[6, i], hi + w * (b_hi[i] - own_up[i]))
                out[7, i] = min(out[7, i], lo + w * (b_lo[i] + own_down[i]))
        subset += 1
        if subset >= 1 << count:
            break
        bit = 0
        while (subset >> bit) & 1 == 0:
            bit += 1
        k = open_[bit]
        _pivot(A, k, not inside[k])
        inside[k] = not inside[k]
    for row in range(8):
        for i in range(n):
            slack = ROUNDING * (abs(out[row, i]) + 1.0)
            if row in (0, 2, 5, 7):
                out[row, i] -= slack
            else:
                out[row, i] += slack


class Momentum(NamedTuple):
    """What the momenta ``p = M v`` know since the cut: their rates integrated, for joints moving forward or backward.

    ``p_i' = 1/2 v' dM/dq_i v - g_i - D v_i + u_i - f_i`` holds no accelerations, so what joint j can do to joint i is
    limited by how much its speed can change, not by its deceleration times the time it may last.
    """

    forward_lo: Array  # (n,) integral of the least rate while moving forward
    forward_hi: Array
    backward_lo: Array
    backward_hi: Array
    restart_up: Array  # (n,) largest of (sum_j M_ij v_j - forward_hi) at times the joint may rest
    restart_down: Array
    sure: Array  # (n,) +1, -1: moved that way all the time since the cut, surely; 0 otherwise


@njit(cache=True)
def _pull(i: int, at: Local, y_lo: Array, y_hi: Array) -> tuple[float, float]:
    """Interval of ``sum_{j != i} M_ij y_j``."""
    lo, hi = 0.0, 0.0
    for j in range(y_lo.shape[0]):
        if j != i:
            m, r = at.M[i, j], at.dM[i, j]
            a, b = (m - r) * y_lo[j], (m + r) * y_lo[j]
            c, d = (m - r) * y_hi[j], (m + r) * y_hi[j]
            lo += min(min(a, b), min(c, d))
            hi += max(max(a, b), max(c, d))
    return lo, hi


@njit(cache=True)
def _since_cut(
    i: int, A: Array, group: Array, at: Local, start: Local, v0_lo: Array, v0_hi: Array, y_lo: Array, y_hi: Array,
    P_lo: Array, P_hi: Array,
) -> tuple[float, float]:  # fmt: skip
    """Change of joint i's speed since the cut, from the momenta of a ``group`` that contains it (1.0 members).

    ``A``: inertia swept by the group; ``P``: change of each member's momentum; ``y``: change of every joint's speed.
    With ``c = M_gg^-1 e_i``:  ``y_i = c'P - sum_{l not in g} (c'M)_l y_l - c' (M - M0) v0``, uncertainty of M apart.
    """
    n = v0_lo.shape[0]
    lo, hi = 0.0, 0.0
    for j in range(n):
        if group[j] > 0.0:
            c = -A[i, j]
            lo += min(c * P_lo[j], c * P_hi[j])
            hi += max(c * P_lo[j], c * P_hi[j])
    for o in range(n):
        change, change_rad, unsure = 0.0, 0.0, 0.0
        for j in range(n):
            if group[j] > 0.0:
                c = -A[i, j]
                change += c * (at.M[j, o] - start.M[j, o])
                change_rad += abs(c) * (
                    at.M_rad[j, o] + start.M_rad[j, o] + abs(at.Mp[j, o] - start.Mp[j, o]) + at.Mp_rad[j, o] + start.Mp_rad[j, o]
                )
                unsure += abs(c) * at.dM[j, o]
        a = unsure * max(abs(y_lo[o]), abs(y_hi[o])) + change_rad * max(abs(v0_lo[o]), abs(v0_hi[o]))
        lo += min(-change * v0_lo[o], -change * v0_hi[o]) - a
        hi += max(-change * v0_lo[o], -change * v0_hi[o]) + a
        if group[o] == 0.0:
            c = A[o, i]
            lo += min(-c * y_lo[o], -c * y_hi[o])
            hi += max(-c * y_lo[o], -c * y_hi[o])
    return lo, hi


@njit(cache=True)
def _cut_by_momentum(
    plant: Plant, at: Local, start: Local, s_u: tuple[Array, Array], B_lo: Array, B_hi: Array, w_lo: Array, w_hi: Array,
    v0_lo: Array, v0_hi: Array, lo: Array, hi: Array, new_lo: Array, new_hi: Array, h: float, m: Momentum, work: Array,
) -> None:  # fmt: skip
    """Tighten ``new_lo, new_hi`` (speeds at the end of a step) by the momenta, and carry these on over the step.

    A cut is taken only where it lies inside the bound at the step's beginning: then it holds on the whole step and the
    straight line between knots stays outside.
    """
    n = v0_lo.shape[0]
    y_lo, y_hi, P_lo, P_hi, group = work[0], work[1], work[2], work[3], work[4]
    x_lo, x_hi = work[5], work[6]
    for i in range(n):
        x_lo[i], x_hi[i] = min(lo[i], new_lo[i]), max(hi[i], new_hi[i])
        if m.sure[i] > 0.0 and not w_lo[i] > 0.0:
            m.sure[i] = 0.0
        if m.sure[i] < 0.0 and not w_hi[i] < 0.0:
            m.sure[i] = 0.0
    for i in range(n):
        D_lo, D_hi = plant.viscous_lo[i], plant.viscous_hi[i]
        f_lo, f_hi = max(x_lo[i], 0.0), max(x_hi[i], 0.0)
        b_lo, b_hi = min(x_lo[i], 0.0), min(x_hi[i], 0.0)
        before = (m.forward_lo[i], m.forward_hi[i], m.backward_lo[i], m.backward_hi[i])
        m.forward_lo[i] += h * (at.e_lo[i] + s_u[0][i] - D_hi * f_hi - B_hi[i])
        m.forward_hi[i] += h * (at.e_hi[i] + s_u[1][i] - D_lo * f_lo - B_lo[i])
        m.backward_lo[i] += h * (at.e_lo[i] + s_u[0][i] - D_lo * b_hi + B_lo[i])
        m.backward_hi[i] += h * (at.e_hi[i] + s_u[1][i] - D_hi * b_lo + B_hi[i])
        if m.sure[i] > 0.0:
            P_lo[i], P_hi[i] = min(before[0], m.forward_lo[i]), max(before[1], m.forward_hi[i])
        elif m.sure[i] < 0.0:
            P_lo[i], P_hi[i] = min(before[2], m.backward_lo[i]), max(before[3], m.backward_hi[i])
        if x_lo[i] <= 0.0 <= x_hi[i]:
            pull = _pull(i, at, x_lo, x_hi)
            m.restart_up[i] = max(m.restart_up[i], pull[1] - min(before[1], m.forward_hi[i]))
            m.restart_down[i] = min(m.restart_down[i], pull[0] - max(before[2], m.backward_lo[i]))
        work[7, i], work[8, i] = max(before[1], m.forward_hi[i]), min(before[2], m.backward_lo[i])
    A = at.M.copy()
    for i in range(n):
        group[i] = 1.0 if m.sure[i] != 0.0 else 0.0
        if group[i] > 0.0:
            _pivot(A, i, True)
    alone = np.zeros(n)
    for i in range(n):
        for j in range(n):
            y_lo[j], y_hi[j] = x_lo[j] - v0_hi[j], x_hi[j] - v0_lo[j]
        if m.sure[i] != 0.0:
            change = _since_cut(i, A, group, at, start, v0_lo, v0_hi, y_lo, y_hi, P_lo, P_hi)
            up, down = v0_hi[i] + change[1], v0_lo[i] + change[0]
            if up < hi[i]:
                new_hi[i] = max(min(new_hi[i], up), new_lo[i])
            if down > lo[i]:
                new_lo[i] = min(max(new_lo[i], down), new_hi[i])
            x_lo[i], x_hi[i] = min(lo[i], new_lo[i]), max(hi[i], new_hi[i])
            continue
        pull = _pull(i, at, x_lo, x_hi)
        least, most = at.M[i, i] - at.dM[i, i], at.M[i, i] + at.dM[i, i]
        if least <= 0.0:
            continue
        if x_hi[i] > 0.0:
            up = -np.inf
            if v0_hi[i] > 0.0:
                P_lo[i], P_hi[i] = min(0.0, m.forward_lo[i]), work[7, i]
                group[i] = 1.0
                _pivot(A, i, True)
                up = v0_hi[i] + _since_cut(i, A, group, at, start, v0_lo, v0_hi, y_lo, y_hi, P_lo, P_hi)[1]
                _pivot(A, i, False)
                group[i] = 0.0
            impulse = m.restart_up[i] + work[7, i] - pull[0]
            up = max(up, impulse / (least if impulse > 0.0 else most))
            if up < hi[i]:
                new_hi[i] = min(new_hi[i], max(up, 0.0))
        if x_lo[i] < 0.0:
            down = np.inf
            if v0_lo[i] < 0.0:
                P_lo[i], P_hi[i] = work[8, i], max(0.0, m.backward_hi[i])
                group[i] = 1.0
                _pivot(A, i, True)
                down = v0_lo[i] + _since_cut(i, A, group, at, start, v0_lo, v0_hi, y_lo, y_hi, P_lo, P_hi)[0]
                _pivot(A, i, False)
                group[i] = 0.0
            impulse = m.restart_down[i] + work[8, i] - pull[1]
            down = min(down, impulse / (least if impulse < 0.0 else most))
            if down > lo[i]:
                new_lo[i] = max(new_lo[i], min(down, 0.0))
        x_lo[i], x_hi[i] = min(lo[i], new_lo[i]), max(hi[i], new_hi[i])


@njit(cache=True)
def march(
    plant: Plant, q_lo: Array, q_hi: Array, v0_lo: Array, v0_hi: Array, h: float, steps: int, parts: Parts
) -> Tube:
    """The tube from the box ``[q_lo, q_hi] x [v0_lo, v0_hi]`` at the cut, in steps of ``h`` seconds, at most ``steps``."""
    n = q_lo.shape[0]
    t = np.zeros(steps + 1)
    d_lo, d_hi = np.zeros((steps + 1, n)), np.zeros((steps + 1, n))
    v_lo, v_hi = np.zeros((steps + 1, n)), np.zeros((steps + 1, n))
    rates = np.zeros((steps, 4, n))
    margin = np.full(n, -np.inf)
    v_lo[0], v_hi[0] = v0_lo, v0_hi
    claim = np.zeros((4, n))  # forward lo, hi, backward lo, hi
    last = np.zeros((4, n))
    out, work = np.zeros((8, n)), np.zeros((6, n))
    w_lo, w_hi = np.zeros(n), np.zeros(n)
    x_lo, x_hi = np.zeros(n), np.zeros(n)
    at, start, turn = _local(n), _local(n), np.zeros((n, n, n))
    work9 = np.zeros((9, n))
    inf = np.full(n, np.inf)
    momentum = Momentum(
        np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), -inf, inf.copy(),
        np.where(v0_lo > 0.0, 1.0, np.where(v0_hi < 0.0, -1.0, 0.0)),
    )  # fmt: skip
    s_lo, s_hi, own_up, own_down = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    plus, minus, zero, a_far = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    B_lo, B_hi = np.zeros(n), np.zeros(n)
    middle = 0.5 * (q_lo + q_hi)
    E = expand(plant.chain, plant.pi, plant.pi_half, plant.rotor, middle)
    K = plant.curvature
    _box_terms(E, K, q_lo - E.q, q_hi - E.q, v0_lo, v0_hi, parts, start, turn)
    engaged = np.max(plant.delay_hi + plant.rise_hi)
    for k in range(steps):
        now = k * h
        far = 0.0
        for i in range(n):
            here = middle[i] + 0.5 * (d_lo[k, i] + d_hi[k, i])
            far += abs(here - E.q[i])
        if far > RECENTRE:
            ahead = np.empty(n)
            for i in range(n):
                ahead[i] = middle[i] + 0.5 * (d_lo[k, i] + d_hi[k, i])
                ahead[i] += 0.5 * (ahead[i] - E.q[i])
            E = expand(plant.chain, plant.pi, plant.pi_half, plant.rotor, ahead)
        early, late = now, now + h
        if parts.whole_step == 0.0:
            early, late = now + h, now
        for i in range(n):
            B_lo[i] = plant.coulomb_lo[i] + plant.brake_lo[i] * _ramp(early, plant.delay_hi[i], plant.rise_hi[i])
            B_hi[i] = plant.coulomb_hi[i] + plant.brake_hi[i] * _ramp(late, plant.delay_lo[i], plant.rise_lo[i])
        # claims: the last step's rates, carried on as they changed, and a little more
        for i in range(n):
            for row in range(4):
                guess = out[row, i] if k > 0 and np.isfinite(out[row, i]) else 0.0
                step = guess - last[row, i] if k > 1 else 0.0
                grow = 0.02 * abs(guess) + 1e-3 + abs(step)
                lower = row == 0 or row == 2
                claim[row, i] = guess + min(step, 0.0) - grow if lower else guess + max(step, 0.0) + grow
                last[row, i] = guess
            # a joint that could not start from rest is first taken not to start
            if k > 0 and out[1, i] <= 0.0:
                claim[1, i] = min(claim[1, i], 0.0)
            if k > 0 and out[2, i] >= 0.0:
                claim[2, i] = max(claim[2, i], 0.0)
        verified = False
        for attempt in range(PASSES):
            for i in range(n):
                lo, hi = v_lo[k, i], v_hi[k, i]
                z = lo + h * min(0.0, claim[0, i] if lo > 0.0 else claim[2, i])
                if lo > 0.0 and z <= 0.0:
                    z = h * min(0.0, claim[2, i])
                w_lo[i] = z
                z = hi + h * max(0.0, claim[3, i] if hi < 0.0 else claim[1, i])
                if hi < 0.0 and z >= 0.0:
                    z = h * max(0.0, claim[1, i])
                w_hi[i] = z
                x_lo[i] = q_lo[i] + d_lo[k, i] + h * min(0.0, w_lo[i]) - E.q[i]
                x_hi[i] = q_hi[i] + d_hi[k, i] + h * max(0.0, w_hi[i]) - E.q[i]
                plus[i] = 1.0 if w_hi[i] > 0.0 else 0.0
                minus[i] = 1.0 if w_lo[i] < 0.0 else 0.0
                zero[i] = 1.0 if w_lo[i] <= 0.0 and w_hi[i] >= 0.0 else 0.0
                a_far[i] = 0.0
                if plus[i] > 0.0:
                    a_far[i] = max(a_far[i], max(abs(claim[0, i]), abs(claim[1, i])))
                if minus[i] > 0.0:
                    a_far[i] = max(a_far[i], max(abs(claim[2, i]), abs(claim[3, i])))
            _box_terms(E, K, x_lo, x_hi, w_lo, w_hi, parts, at, turn)
            for i in range(n):
                D_lo, D_hi = plant.viscous_lo[i], plant.viscous_hi[i]
                least = min(D_lo * w_lo[i], D_hi * w_lo[i])
                most = max(D_lo * w_hi[i], D_hi * w_hi[i])
                s_lo[i] = -at.h_hi[i] - most + plant.u_lo[i]
                s_hi[i] = -at.h_lo[i] - least + plant.u_hi[i]
                # the bound's own rate needs the viscous torque only where the speed is at the bound
                fast, slow = w_lo[i], w_hi[i]
                if v_hi[k, i] > 0.0:
                    fast = max(v_hi[k, i] + h * min(0.0, claim[0, i]), 0.0)
                elif v_hi[k, i] < 0.0:
                    fast = v_hi[k, i] + h * min(0.0, claim[2, i])
                if v_lo[k, i] < 0.0:
                    slow = min(v_lo[k, i] + h * max(0.0, claim[3, i]), 0.0)
                elif v_lo[k, i] > 0.0:
                    slow = v_lo[k, i] + h * max(0.0, claim[1, i])
                own_up[i] = max(0.0, min(D_lo * fast, D_hi * fast) - least)
                own_down[i] = max(0.0, most - max(D_lo * slow, D_hi * slow))
            _accelerations(at.M, at.dM, s_lo, s_hi, own_up, own_down, B_lo, B_hi, plus, minus, zero, a_far, out, work)
            verified = True
            for i in range(n):
                for row in range(4):
                    if (row < 2 and plus[i] == 0.0 and zero[i] == 0.0) or (
                        row >= 2 and minus[i] == 0.0 and zero[i] == 0.0
                    ):
                        continue
                    # a joint resting for sure on this step only has to be kept from starting
                    if row == 0 and plus[i] == 0.0 or row == 3 and minus[i] == 0.0:
                        continue
                    if row == 0 or row == 2:
                        if out[row, i] < claim[row, i] and not (row == 2 and minus[i] == 0.0 and out[row, i] >= 0.0):
                            verified = False
                            claim[row, i] = out[row, i] - 0.05 * abs(out[row, i]) - 1e-3
                    elif out[row, i] > claim[row, i] and not (row == 1 and plus[i] == 0.0 and out[row, i] <= 0.0):
                        verified = False
                        claim[row, i] = out[row, i] + 0.05 * abs(out[row, i]) + 1e-3
            if verified:
                break
        if not verified:
            return Tube(
                UNBOUNDED, t[: k + 1], d_lo[: k + 1], d_hi[: k + 1], v_lo[: k + 1], v_hi[: k + 1],
                rates[:k, 0], rates[:k, 1], rates[:k, 2], rates[:k, 3], margin,
            )  # fmt: skip
        moving = False
        for i in range(n):
            lo, hi = v_lo[k, i], v_hi[k, i]
            up = max(0.0, out[4, i]) if zero[i] > 0.0 else 0.0
            down = min(0.0, out[7, i]) if zero[i] > 0.0 else 0.0
            if hi > 0.0:
                new_hi = hi + h * out[4, i]
                if new_hi < 0.0 and zero[i] > 0.0:
                    new_hi = 0.0
            elif hi == 0.0:
                new_hi = h * up
            else:
                new_hi = hi + h * out[6, i]
                if new_hi >= 0.0:
                    new_hi = h * up
            if lo < 0.0:
                new_lo = lo + h * out[7, i]
                if new_lo > 0.0 and zero[i] > 0.0:
                    new_lo = 0.0
            elif lo == 0.0:
                new_lo = h * down
            else:
                new_lo = lo + h * out[5, i]
                if new_lo <= 0.0:
                    new_lo = h * down
            v_hi[k + 1, i], v_lo[k + 1, i] = new_hi, new_lo
            for row in range(4):
                rates[k, row, i] = out[row, i]
        _cut_by_momentum(
            plant, at, start, (plant.u_lo, plant.u_hi), B_lo, B_hi, w_lo, w_hi, v0_lo, v0_hi,
            v_lo[k], v_hi[k], v_lo[k + 1], v_hi[k + 1], h, momentum, work9,
        )  # fmt: skip
        for i in range(n):
            lo, hi, new_lo, new_hi = v_lo[k, i], v_hi[k, i], v_lo[k + 1, i], v_hi[k + 1, i]
            if parts.whole_step == 0.0:
                d_hi[k + 1, i], d_lo[k + 1, i] = d_hi[k, i] + h * new_hi, d_lo[k, i] + h * new_lo
            else:
                # chords: outside the speed's bound where that is convex; where it crosses zero, its larger end
                d_hi[k + 1, i] = d_hi[k, i] + h * (max(new_hi, 0.0) if hi < 0.0 and new_hi >= 0.0 else 0.5 * (hi + new_hi))
                d_lo[k + 1, i] = d_lo[k, i] + h * (min(new_lo, 0.0) if lo > 0.0 and new_lo <= 0.0 else 0.5 * (lo + new_lo))
            moving = moving or new_hi != 0.0 or new_lo != 0.0
        t[k + 1] = now + h
        if not moving and now >= engaged:
            for i in range(n):
                margin[i] = B_lo[i] - max(abs(s_lo[i]), abs(s_hi[i]))
            return Tube(
                OK, t[: k + 2], d_lo[: k + 2], d_hi[: k + 2], v_lo[: k + 2], v_hi[: k + 2],
                rates[: k + 1, 0], rates[: k + 1, 1], rates[: k + 1, 2], rates[: k + 1, 3], margin,
            )  # fmt: skip
    return Tube(ENDLESS, t, d_lo, d_hi, v_lo, v_hi, rates[:, 0], rates[:, 1], rates[:, 2], rates[:, 3], margin)
