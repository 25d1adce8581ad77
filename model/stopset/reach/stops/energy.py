"""What the kinetic energy knows of the speeds: the layer that holds where coupling is too strong for joint-wise bands.

With ``y = sqrt(v' M(q) v)``, and since ``M' - 2 C`` is skew-symmetric, Coriolis torque does no work and coupling is inside M:

    y dy/dt = v' (u - g - D v - f)  <=  sum_i w_i |v_i|,     w_i = sup |u_i - g_i| - F_i - B_i(t),

sup over the directions joint i can move in.  Two consequences, for any configuration and any split of the joints into moving
and resting ones:

* all ``w_i < 0``:  ``1 = |x|_M <= sum_i |x_i| sqrt(M_ii)`` for ``x = v / y``, so ``dy/dt <= -min_i |w_i| / sqrt(M_ii)``;
* else ``dy/dt <= sqrt(w+' |W| w+)`` with ``W >= M^-1``, by Cauchy-Schwarz in the norm of M.

``|v_i| <= sqrt(W_ii) y`` caps every speed; while the holding margins ``-w_i`` are positive, y ends at zero in finite time.
``W`` comes from ``M >= M_c - diag(r)``: for ``|Delta_ij| <= d_ij`` and any weights, ``x' Delta x <= sum_i r_i x_i^2`` with
``r_i = M_ii sum_j d_ij / sqrt(M_ii M_jj)`` (weighted Gershgorin).

Source: stop notes of the project, energy cap; Spong, Hutchinson, Vidyasagar (2006), ch. 7, for the skew symmetry.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from stopset.reach.stops.expansion import Curvature, Expansion
from stopset.reach.stops.local import Local, Parts, box_terms
from stopset.reach.stops.momentum import Bands
from stopset.robot.rigid import Array

CLAIMS = 12
ROUNDING = 1.0 + 1e-9  # the arithmetic itself errs by some 1e-13


class Energy(NamedTuple):
    """``y``: (1,) bound of sqrt(v' M v) at the last knot; ``cap``: (n,) [rad/s] speed cap on a whole step, ``end``: at its end;
    ``W``: (n, n) bound of the inverse inertia; ``g_lo, g_hi``: (n,) gravity torque on the step [N m]."""

    y: Array
    cap: Array
    end: Array
    W: Array
    g_lo: Array
    g_hi: Array


@njit(cache=True)
def start_energy(at: Local, v_lo: Array, v_hi: Array) -> Energy:
    """At the cut, for speeds in a box."""
    n = v_lo.shape[0]
    out = Energy(np.zeros(1), np.full(n, np.inf), np.full(n, np.inf), np.zeros((n, n)), np.zeros(n), np.zeros(n))
    out.y[0] = largest(at, v_lo, v_hi)
    return out


@njit(cache=True)
def largest(at: Local, v_lo: Array, v_hi: Array) -> float:
    """Largest ``sqrt(v' M v)`` over a box of speeds: convex in v, so at a corner; inf for an unbounded box."""
    n = v_lo.shape[0]
    spread = 0.0
    for i in range(n):
        a = max(abs(v_lo[i]), abs(v_hi[i]))
        if not a < np.inf:
            return np.inf
        for j in range(n):
            spread += at.dM[i, j] * a * max(abs(v_lo[j]), abs(v_hi[j]))
    v, p = v_lo.copy(), at.M @ v_lo
    value = 0.0
    for i in range(n):
        value += v[i] * p[i]
    best = value
    for corner in range(1, 1 << n):  # Gray code: one speed changes at a time
        i = 0
        while (corner >> i) & 1 == 0:
            i += 1
        new = v_hi[i] if v[i] == v_lo[i] else v_lo[i]
        step = new - v[i]
        value += step * (2.0 * p[i] + at.M[i, i] * step)
        for j in range(n):
            p[j] += at.M[j, i] * step
        v[i] = new
        best = max(best, value)
    return float(np.sqrt(max(best + spread, 0.0)) * ROUNDING)


@njit(cache=True)
def _inverse(at: Local, out: Energy) -> bool:
    """Fill ``W >= M^-1``; False if M is not surely positive definite."""
    n = at.M.shape[0]
    least = at.M.copy()
    for i in range(n):
        relative = 0.0
        for j in range(n):
            relative += at.dM[i, j] / np.sqrt(at.M[i, i] * at.M[j, j])
        least[i, i] -= at.M[i, i] * relative
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = least[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > 1e-6 * at.M[i, i]:
                    return False
                L[i, i] = np.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    for c in range(n):  # columns of the inverse
        x = np.zeros(n)
        for i in range(n):
            s = 1.0 if i == c else 0.0
            for k in range(i):
                s -= L[i, k] * x[k]
            x[i] = s / L[i, i]
        for i in range(n - 1, -1, -1):
            s = x[i]
            for k in range(i + 1, n):
                s -= L[k, i] * x[k]
            x[i] = s / L[i, i]
        out.W[:, c] = x
    return True


@njit(cache=True)
def power_excess(out: Energy, u_lo: Array, u_hi: Array, B_lo: Array, v_lo: Array, v_hi: Array, w: Array) -> None:
    """``w_i`` [N m] of the module's head, for the directions in which speeds within ``[v_lo, v_hi]`` point."""
    for i in range(w.shape[0]):
        up, down = u_hi[i] - out.g_lo[i], out.g_hi[i] - u_lo[i]
        if v_lo[i] >= 0.0 and v_hi[i] > 0.0:
            down = up
        elif v_hi[i] <= 0.0 and v_lo[i] < 0.0:
            up = down
        w[i] = max(up, down) - B_lo[i]


@njit(cache=True)
def _try(out: Energy, y: float, at: Local, K: Curvature, rotor_lo: Array, rotor_hi: Array, w: Array, h: float) -> None:
    """Caps on a step of ``h`` seconds from ``y``, on whose box ``at`` holds and ``w`` bounds the power.

    Whatever the pose, ``M >= diag(rotor)`` and ``M_ii <= K.size_i + rotor_i``.
    """
    n = w.shape[0]
    local = _inverse(at, out)
    near, far, slowest = 0.0, 0.0, np.inf
    for i in range(n):
        most = min(at.M[i, i] + at.dM[i, i], K.size[i] + rotor_hi[i])
        slowest = min(slowest, -w[i] / np.sqrt(most))
        far += max(w[i], 0.0) ** 2 / rotor_lo[i]
        for j in range(n):
            near += max(w[i], 0.0) * abs(out.W[i, j]) * max(w[j], 0.0)
    rate = -slowest if slowest > 0.0 else np.sqrt(min(near, far) if local else far)
    after = max(y + h * rate, 0.0) * ROUNDING
    for i in range(n):
        inverse = min(max(out.W[i, i], 0.0), 1.0 / rotor_lo[i]) if local else 1.0 / rotor_lo[i]
        size = np.sqrt(inverse) * ROUNDING
        out.cap[i], out.end[i] = size * max(y, after), size * after
    out.y[0] = after


@njit(cache=True)
def step_energy(
    out: Energy, E: Expansion, K: Curvature, rotor_lo: Array, rotor_hi: Array, q_lo: Array, q_hi: Array,
    u_lo: Array, u_hi: Array, B_lo: Array, h: float,
    parts: Parts, at: Local, work: Array, wide: Array,
) -> bool:  # fmt: skip
    """Caps of the next step, from angles in ``E.q + [q_lo, q_hi]``; False if none can be verified.

    The caps decide where the arm can be, and that what M can be: they are claimed first, and claimed again while too small.
    """
    n, y = q_lo.shape[0], out.y[0]
    x_lo, x_hi, none, w, claim = wide[0], wide[1], wide[2], wide[3], wide[4]
    none[:] = 0.0
    for i in range(n):
        claim[i] = 1.02 * min(out.cap[i], np.sqrt(1.0 / rotor_lo[i]) * y) + 1e-6
    for _ in range(CLAIMS):
        for i in range(n):
            x_lo[i], x_hi[i] = q_lo[i] - h * claim[i], q_hi[i] + h * claim[i]
        box_terms(E, K, x_lo, x_hi, none, none, parts, at, work)  # at rest: h is gravity alone
        for i in range(n):
            out.g_lo[i], out.g_hi[i] = max(at.h_lo[i], -K.load[i]), min(at.h_hi[i], K.load[i])
        power_excess(out, u_lo, u_hi, B_lo, none, none, w)
        _try(out, y, at, K, rotor_lo, rotor_hi, w, h)
        enough = True
        for i in range(n):
            if out.cap[i] > claim[i]:
                enough = False
                claim[i] = 1.05 * out.cap[i]
        if enough:
            return True
    return False


@njit(cache=True)
def by_power(y: float, w: Array, x_lo: Array, x_hi: Array, h: float) -> float:
    """y after a step from ``y`` on which the speeds lie in ``[x_lo, x_hi]``: the energy balance itself."""
    power = 0.0
    for i in range(w.shape[0]):
        slow = 0.0 if x_lo[i] <= 0.0 <= x_hi[i] else min(abs(x_lo[i]), abs(x_hi[i]))
        power += w[i] * (max(abs(x_lo[i]), abs(x_hi[i])) if w[i] > 0.0 else slow)
    return float(np.sqrt(max(y * y + 2.0 * h * power, 0.0)) * ROUNDING)


@njit(cache=True)
def cap_bands(b: Bands, cap: Array) -> None:
    """Cut speed bands to ``+-cap``."""
    for i in range(cap.shape[0]):
        b.first_lo[i], b.first_hi[i] = max(b.first_lo[i], -cap[i]), min(b.first_hi[i], cap[i])
        b.later_lo[i], b.later_hi[i] = max(b.later_lo[i], -cap[i]), min(b.later_hi[i], cap[i])
        if b.first_lo[i] > b.first_hi[i]:  # the excursion cannot last; keep the end that is nearer to rest
            nearest = b.first_hi[i] if b.sign[i] > 0.0 else b.first_lo[i]
            b.first_lo[i], b.first_hi[i] = nearest, nearest


@njit(cache=True)
def cap_lines(cap: Array, v_lo: Array, v_hi: Array, e_lo: Array, e_hi: Array, alone: bool) -> None:
    """The lines that bound the speeds on a step, lowered to the caps where these are lower, or ``alone`` the caps."""
    for i in range(cap.shape[0]):
        c = cap[i]
        if alone or 0.5 * (max(v_hi[i], 0.0) + e_hi[i]) > c or (v_hi[i] < 0.0 and e_hi[i] > c):
            v_hi[i], e_hi[i] = c, c
        if alone or 0.5 * (min(v_lo[i], 0.0) + e_lo[i]) < -c or (v_lo[i] > 0.0 and e_lo[i] < -c):
            v_lo[i], e_lo[i] = -c, -c
