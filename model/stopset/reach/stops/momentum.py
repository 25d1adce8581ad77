"""What the momenta ``p = M v`` know of the speeds.

    p_i' = 1/2 v' dM/dq_i v - g_i - D_i v_i + u_i - f_i

holds no accelerations, so what joint j can do to joint i is limited by how much its speed changes, not by its deceleration
times the time this may last.  A joint that started moving at the cut is in its *first excursion* until it comes to rest:
meanwhile friction points one way and its momentum is known within an interval.  After that it is *later*: usually at rest.
For every subset g of the joints that may still be in their first excursion,

    M_gg (v - v0)_g = Q_g - M_gl (v - v0)_l,    l: the others, in their later bands,

so the speeds of g follow from g's momenta at once, coupling included; subsets that contradict the bands are left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stopset.reach.stops.local import Local
from stopset.reach.stops.moving import pivot
from stopset.robot.rigid import Array


class Bands(NamedTuple):
    """Speed bounds of every joint, apart for its first excursion and for later; ``sign``: of the first, 0 if it had none.

    ``alive``: the first excursion may still last; ``rested``: it may be over. One of them is 1.0 for each joint.
    """

    sign: Array
    alive: Array
    rested: Array
    first_lo: Array
    first_hi: Array
    later_lo: Array
    later_hi: Array


class Momentum(NamedTuple):
    """Integrals since the cut: ``P``: momentum change of joints in their first excursion; ``up``: largest change while
    moving forward later, ``down``: least change while moving backward; ``restart``: the best start of such a motion."""

    P_lo: Array
    P_hi: Array
    up: Array
    down: Array
    needed: Array  # least brake impulse [N m s] that can have ended the first excursion so far; inf before it can end
    drive: Array  # least momentum, along the first excursion, that all but the brake has left to the joint
    restart_up: Array  # largest of M_ii v_i + sum_j M_ij v_j - up, over times the joint may start
    restart_down: Array


@njit(cache=True)
def start_bands(v_lo: Array, v_hi: Array) -> Bands:
    """Bands at the cut."""
    n = v_lo.shape[0]
    sign, alive, rested, zero = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    first_lo, first_hi, later_lo, later_hi = zero, zero.copy(), zero.copy(), zero.copy()
    for i in range(n):
        if v_lo[i] > 0.0 or v_hi[i] < 0.0:
            sign[i], alive[i] = (1.0 if v_lo[i] > 0.0 else -1.0), 1.0
            first_lo[i], first_hi[i] = v_lo[i], v_hi[i]
        else:
            rested[i] = 1.0
            later_lo[i], later_hi[i] = v_lo[i], v_hi[i]
    return Bands(sign, alive, rested, first_lo, first_hi, later_lo, later_hi)


@njit(cache=True)
def total(b: Bands, lo: Array, hi: Array) -> None:
    """Hull of the two bands of every joint."""
    for i in range(lo.shape[0]):
        lo[i], hi[i] = np.inf, -np.inf
        if b.alive[i] > 0.0:
            lo[i], hi[i] = b.first_lo[i], b.first_hi[i]
        if b.rested[i] > 0.0:
            lo[i], hi[i] = min(lo[i], b.later_lo[i]), max(hi[i], b.later_hi[i])


@njit(cache=True)
def _pull(i: int, at: Local, lo: Array, hi: Array) -> tuple[float, float]:
    """Interval of ``sum_{j != i} M_ij v_j``."""
    least, most = 0.0, 0.0
    for j in range(lo.shape[0]):
        if j != i:
            m, r = at.M[i, j], at.dM[i, j]
            a, b, c, d = (m - r) * lo[j], (m + r) * lo[j], (m - r) * hi[j], (m + r) * hi[j]
            least += min(min(a, b), min(c, d))
            most += max(max(a, b), max(c, d))
    return least, most


@njit(cache=True)
def start_momentum(at: Local, v_lo: Array, v_hi: Array, b: Bands) -> Momentum:
    """Integrals at the cut."""
    n = v_lo.shape[0]
    restart_up, restart_down = np.full(n, -np.inf), np.full(n, np.inf)
    for i in range(n):
        if b.sign[i] == 0.0:
            pull, most = _pull(i, at, v_lo, v_hi), at.M[i, i] + at.dM[i, i]
            restart_up[i], restart_down[i] = pull[1] + most * v_hi[i], pull[0] + most * v_lo[i]
    zero = np.zeros(n)
    return Momentum(
        zero, zero.copy(), zero.copy(), zero.copy(), np.full(n, np.inf), zero.copy(), restart_up, restart_down
    )  # fmt: skip


@njit(cache=True, inline="always")
def _fastest(i: int, before: Bands, after: Bands) -> float:
    fast = max(abs(before.first_lo[i]), abs(before.first_hi[i]))
    return float(max(fast, max(abs(after.first_lo[i]), abs(after.first_hi[i]))))


@njit(cache=True)
def _driven(i: int, at: Local, u_lo: Array, u_hi: Array, D_hi: Array, F_hi: Array, before: Bands, after: Bands) -> float:
    """Least torque along a first excursion, brake apart."""
    push = at.e_lo[i] + u_lo[i] if after.sign[i] > 0.0 else -at.e_hi[i] - u_hi[i]
    return float(push - F_hi[i] - D_hi[i] * _fastest(i, before, after))


@njit(cache=True)
def kept_impulse(
    m: Momentum, at: Local, start: Local, u_lo: Array, u_hi: Array, D_hi: Array, F_hi: Array, before: Bands, after: Bands,
    v0_lo: Array, v0_hi: Array, x_lo: Array, x_hi: Array, h: float, kept: Array,
) -> None:  # fmt: skip
    """Into ``kept`` (n,): least brake impulse that can end a first excursion during this step; inf where none can end."""
    for i in range(x_lo.shape[0]):
        kept[i] = np.inf
        if before.alive[i] > 0.0 and after.rested[i] > 0.0:
            less = min(0.0, h * _driven(i, at, u_lo, u_hi, D_hi, F_hi, before, after))
            kept[i] = m.drive[i] + less + _left(i, after.sign[i], at, start, v0_lo, v0_hi, x_lo, x_hi)


@njit(cache=True)
def carry_on(
    m: Momentum, at: Local, u_lo: Array, u_hi: Array, D_lo: Array, D_hi: Array, F_hi: Array,
    B_lo: Array, B_hi: Array, B_later: Array, before: Bands, after: Bands, kept: Array,
    x_lo: Array, x_hi: Array, h: float,
) -> None:  # fmt: skip
    """Integrate over a step of ``h`` seconds on which speeds lie in ``[x_lo, x_hi]``, bands going from before to after."""
    for i in range(x_lo.shape[0]):
        up, down = m.up[i], m.down[i]
        m.up[i] += h * (at.e_hi[i] + u_hi[i] - B_later[i])
        m.down[i] += h * (at.e_lo[i] + u_lo[i] + B_later[i])
        if after.rested[i] > 0.0:  # it may rest, and start, at any time of this step
            pull = _pull(i, at, x_lo, x_hi)
            m.restart_up[i] = max(m.restart_up[i], pull[1] - min(up, m.up[i]))
            m.restart_down[i] = min(m.restart_down[i], pull[0] - max(down, m.down[i]))
        if before.alive[i] > 0.0:
            slow = min(abs(before.first_lo[i]), abs(before.first_hi[i]))
            slow = min(slow, min(abs(after.first_lo[i]), abs(after.first_hi[i])))
            fast = max(abs(before.first_lo[i]), abs(before.first_hi[i]))
            fast = max(fast, max(abs(after.first_lo[i]), abs(after.first_hi[i])))
            least, most = B_lo[i] + D_lo[i] * slow, B_hi[i] + D_hi[i] * fast
            m.drive[i] += h * _driven(i, at, u_lo, u_hi, D_hi, F_hi, before, after)
            m.needed[i] = min(m.needed[i], kept[i])
            if b_forward(after, i):
                m.P_lo[i] += h * (at.e_lo[i] + u_lo[i] - most)
                m.P_hi[i] += h * (at.e_hi[i] + u_hi[i] - least)
            else:
                m.P_lo[i] += h * (at.e_lo[i] + u_lo[i] + least)
                m.P_hi[i] += h * (at.e_hi[i] + u_hi[i] + most)


@njit(cache=True)
def _left(i: int, sign: float, at: Local, start: Local, v0_lo: Array, v0_hi: Array, x_lo: Array, x_hi: Array) -> float:
    """Least of ``sign (M_ii v0_i - sum_{l != i} M_il (v - v0)_l - (M - M0) v0)``: what friction must take for joint i to rest."""
    lo, hi = 0.0, 0.0
    for o in range(v0_lo.shape[0]):
        change = at.M[i, o] - start.M[i, o]
        rad = at.M_rad[i, o] + start.M_rad[i, o]
        rad += abs(at.Mp[i, o] - start.Mp[i, o]) + at.Mp_rad[i, o] + start.Mp_rad[i, o]
        a = rad * max(abs(v0_lo[o]), abs(v0_hi[o]))
        lo += min(-change * v0_lo[o], -change * v0_hi[o]) - a
        hi += max(-change * v0_lo[o], -change * v0_hi[o]) + a
        y_lo, y_hi = x_lo[o] - v0_hi[o], x_hi[o] - v0_lo[o]
        if o == i:
            y_lo, y_hi = -v0_hi[o], -v0_lo[o]
        m, r = at.M[i, o], at.dM[i, o]
        p, q, s, t = -(m - r) * y_lo, -(m + r) * y_lo, -(m - r) * y_hi, -(m + r) * y_hi
        lo += min(min(p, q), min(s, t))
        hi += max(max(p, q), max(s, t))
    return lo if sign > 0.0 else -hi


@njit(cache=True, inline="always")
def b_forward(b: Bands, i: int) -> bool:
    """Whether the first excursion of joint i goes forward."""
    return bool(b.sign[i] > 0.0)


@njit(cache=True)
def tighten(
    b: Bands, m: Momentum, at: Local, start: Local, v0_lo: Array, v0_hi: Array, lo: Array, hi: Array, work: Array
) -> None:
    """Cut the bands at a knot by the momenta; ``lo, hi``: their hull before; ``work``: (8, n)."""
    n = v0_lo.shape[0]
    Q_lo, Q_hi, l_lo, l_hi = work[0], work[1], work[2], work[3]
    best_lo, best_hi, seen_in, seen_out = work[4], work[5], work[6], work[7]
    for i in range(n):
        best_lo[i], best_hi[i], seen_in[i], seen_out[i] = np.inf, -np.inf, 0.0, 0.0
        l_lo[i], l_hi[i] = b.later_lo[i] - v0_hi[i], b.later_hi[i] - v0_lo[i]
        if b.alive[i] == 0.0:
            continue
        Q_lo[i], Q_hi[i] = m.P_lo[i], m.P_hi[i]
        for o in range(n):
            change = at.M[i, o] - start.M[i, o]
            rad = at.M_rad[i, o] + start.M_rad[i, o]
            rad += abs(at.Mp[i, o] - start.Mp[i, o]) + at.Mp_rad[i, o] + start.Mp_rad[i, o]
            a = rad * max(abs(v0_lo[o]), abs(v0_hi[o]))
            a += at.dM[i, o] * max(abs(lo[o] - v0_hi[o]), abs(hi[o] - v0_lo[o]))
            Q_lo[i] += min(-change * v0_lo[o], -change * v0_hi[o]) - a
            Q_hi[i] += max(-change * v0_lo[o], -change * v0_hi[o]) + a
    A = at.M.copy()
    inside, open_ = np.zeros(n, np.bool_), np.empty(n, np.int64)
    count, members = 0, 0
    for i in range(n):
        if b.alive[i] > 0.0:
            if b.rested[i] > 0.0:
                open_[count] = i
                count += 1
            else:
                pivot(A, i, True)
                inside[i] = True
                members += 1
    if count + members > 0:
        subset = 0
        while True:
            _visit(A, inside, b, at, Q_lo, Q_hi, l_lo, l_hi, v0_lo, v0_hi, best_lo, best_hi, seen_in, seen_out)
            subset += 1
            if subset >= 1 << count:
                break
            bit = 0
            while (subset >> bit) & 1 == 0:
                bit += 1
            k = open_[bit]
            pivot(A, k, not inside[k])
            inside[k] = not inside[k]
    for i in range(n):
        if b.alive[i] > 0.0:
            if seen_in[i] == 0.0 and b.rested[i] > 0.0:
                b.alive[i] = 0.0  # no momentum fits a first excursion that still lasts
            elif seen_in[i] > 0.0:
                b.first_lo[i], b.first_hi[i] = max(b.first_lo[i], best_lo[i]), min(b.first_hi[i], best_hi[i])
                if seen_out[i] == 0.0 and b.rested[i] > 0.0:
                    b.rested[i] = 0.0  # nor one that is over
    total(b, lo, hi)
    for i in range(n):
        if b.rested[i] > 0.0:
            pull = _pull(i, at, lo, hi)
            least, most = at.M[i, i] - at.dM[i, i], at.M[i, i] + at.dM[i, i]
            if least > 0.0:
                impulse = m.restart_up[i] + m.up[i] - pull[0]
                b.later_hi[i] = min(b.later_hi[i], max(0.0, impulse / (least if impulse > 0.0 else most)))
                impulse = m.restart_down[i] + m.down[i] - pull[1]
                b.later_lo[i] = max(b.later_lo[i], min(0.0, impulse / (least if impulse < 0.0 else most)))


@njit(cache=True)
def _visit(
    A: Array, inside: NDArray[np.bool_], b: Bands, at: Local, Q_lo: Array, Q_hi: Array, l_lo: Array, l_hi: Array,
    v0_lo: Array, v0_hi: Array, best_lo: Array, best_hi: Array, seen_in: Array, seen_out: Array,
) -> None:  # fmt: skip
    """Speeds when exactly the joints ``inside`` are in their first excursion, into the hulls if that is possible."""
    n = v0_lo.shape[0]
    r_lo, r_hi, y_lo, y_hi = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for j in range(n):
        if inside[j]:
            r_lo[j], r_hi[j] = Q_lo[j], Q_hi[j]
            for o in range(n):
                if not inside[o]:
                    c = -at.M[j, o]
                    r_lo[j] += min(c * l_lo[o], c * l_hi[o])
                    r_hi[j] += max(c * l_lo[o], c * l_hi[o])
    for i in range(n):
        if inside[i]:
            lo, hi = v0_lo[i], v0_hi[i]
            for j in range(n):
                if inside[j]:
                    w = -A[i, j]
                    lo += min(w * r_lo[j], w * r_hi[j])
                    hi += max(w * r_lo[j], w * r_hi[j])
            if hi < b.first_lo[i] or lo > b.first_hi[i]:
                return
            y_lo[i], y_hi[i] = lo, hi
    for i in range(n):
        if inside[i]:
            best_lo[i], best_hi[i] = min(best_lo[i], y_lo[i]), max(best_hi[i], y_hi[i])
            seen_in[i] = 1.0
        else:
            seen_out[i] = 1.0
