"""Mass matrix, its inverse and the Coriolis matrices of an arm as Taylor polynomials in the sines and cosines of its
angles.

Nothing depends on the first joint's angle (gravity is in the input), so an arm of ``n`` joints needs ``2 (n - 1)``
variables, and the velocities and torques, in which the dynamics are quadratic and linear, need none at all.

M and C are polynomials that end by themselves, so they are composed exactly, and expanded about ``q_a`` and cut
afterwards. In between, ``cos^2`` is replaced by ``1 - sin^2``.  With sine and cosine as free variables (property A) one
function has many polynomials, and what an algorithm happens to write down as ``sin^2 + cos^2`` is no longer 1 after the
cut (trap P20); of all the ways to write it, this one is unique, and its error at a given order was the smallest
(docs/table1.md).

Source: Liu & Althoff (2018), Sec. IV-B, eq. (12) and property A.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.artifact.polynomial import Polynomial, collected
from stopset.ring.taylor import Algebra, Taylor
from stopset.robot import Robot
from stopset.robot.generic import mass_matrix
from stopset.types import Array

TaylorMatrix = list[list[Taylor]]
# relative size of what is left where terms cancel exactly in real numbers
ROUNDING = 1e-14


@dataclass(frozen=True, slots=True)
class DynamicsForms:
    """``M_m`` (n x n) and ``C[i][j][k]``, j <= k, the coefficient of ``dq_j dq_k`` in the Coriolis torque of joint i.

    Taylor forms in ``2 (n - 1)`` variables: deviations of the sines, then of the cosines, of joints 2 .. n from
    ``centre``.
    """

    M: TaylorMatrix
    C: list[TaylorMatrix]
    centre: Array

    @property
    def algebra(self) -> Algebra:
        return self.M[0][0].algebra

    def expanded(self, q_a: Array, order: int, *, inverse: bool) -> DynamicsForms:
        """Taylor polynomials about ``q_a`` (n,): M to ``order``, C to one less; ``inverse``: are quotients to follow?"""
        n = len(self.M)
        centre = np.concatenate([np.sin(q_a[1:]), np.cos(q_a[1:])])
        algebra = Algebra(2 * (n - 1), order, live=n**3, sparse=None if inverse else terms(n))

        def about(x: Taylor, cut: int) -> Taylor:
            local = Polynomial(x.exponents, x.value).recentred(centre - self.centre, cut)
            return algebra.from_exponents(local.exponent, local.coefficient)

        M = [[about(self.M[i][j], order) if j <= i else self.M[i][j] for j in range(n)] for i in range(n)]
        M = [[M[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]
        return DynamicsForms(M, [[[about(x, order - 1) for x in row] for row in C] for C in self.C], centre)


def terms(n: int) -> int:
    """Most terms of an entry of M or C: they are quadratic in (sin q_k, cos q_k) of each joint behind the first."""
    return int(6 ** (n - 1))


def dynamics(robot: Robot, rotor: Array, *, as_composed: bool = False) -> DynamicsForms:
    """The exact polynomials of an arm, about ``sin = cos = 0``, by operator overloading through the recursive
    algorithm.

    ``as_composed``: leave ``sin^2 + cos^2`` where the algorithm writes it (the paper's way).

    Source: Liu & Althoff (2018), after eq. (12): ``c_ijk = dM_ij/dq_k - 1/2 dM_jk/dq_i``.
    """
    n = robot.n
    algebra = Algebra(2 * (n - 1), max(1, 2 * (n - 1)), live=n**3, sparse=terms(n))
    zero = algebra.constant(0.0)
    s = [zero, *(algebra.variable(i) for i in range(n - 1))]
    c = [algebra.constant(1.0), *(algebra.variable(n - 1 + i) for i in range(n - 1))]  # any angle does for the first joint

    def reduced(x: Taylor) -> Taylor:
        return x if as_composed else _reduced(x, n - 1)

    raw = mass_matrix(robot.chain, robot.pi, s, c)
    # exact zeros of the geometry come as plain numbers; both halves are computed and one is kept: symmetric to the bit
    half = [[reduced(zero + raw[i][j]) for j in range(i + 1)] for i in range(n)]
    M = [[half[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]

    def by_angle(x: Taylor, k: int) -> Taylor:
        """``dx / dq_k``: the angle moves its sine by its cosine and back."""
        return c[k] * x.derivative(k - 1) - s[k] * x.derivative(n - 2 + k) if k > 0 else zero

    slope = [[[by_angle(M[i][j], k) for k in range(n)] for j in range(n)] for i in range(n)]

    def coriolis(i: int, j: int, k: int) -> Taylor:
        if j > k:
            return zero
        if j == k:
            return reduced(slope[i][j][j] - 0.5 * slope[j][j][i])
        return reduced(slope[i][j][k] + slope[i][k][j] - slope[j][k][i])

    C = [[[coriolis(i, j, k) for k in range(n)] for j in range(n)] for i in range(n)]
    with_rotor = [[M[i][j] + (float(rotor[i]) if i == j else 0.0) for j in range(n)] for i in range(n)]
    return DynamicsForms(with_rotor, C, np.zeros(2 * (n - 1)))


def _reduced(x: Taylor, m: int) -> Taylor:
    """The same function with ``cos^2`` written as ``1 - sin^2``; ``m``: number of sines, the first half of the variables."""
    e, c = x.exponents, x.value
    for k in range(m):
        hit = e[:, m + k] >= 2
        if hit.any():
            one = e[hit].copy()
            one[:, m + k] -= 2
            squared = one.copy()
            squared[:, k] += 2
            e, c = collected(np.vstack([e[~hit], one, squared]), np.concatenate([c[~hit], c[hit], -c[hit]]))
    keep = np.abs(c) > ROUNDING * np.abs(x.value).max(initial=0.0)
    return x.algebra.from_exponents(e[keep], c[keep])


def inverse(M: TaylorMatrix) -> TaylorMatrix:
    """Inverse of a symmetric positive definite matrix of Taylor forms, by ``M = L D L'``."""
    n = len(M)
    algebra = M[0][0].algebra
    one, zero = algebra.constant(1.0), algebra.constant(0.0)
    L = [[one if i == j else zero for j in range(n)] for i in range(n)]
    raw: list[Taylor] = []  # D
    pivot: list[Taylor] = []  # 1 / D
    for j in range(n):
        column = [M[i][j] for i in range(n)]
        for k in range(j):
            scaled = L[j][k] * raw[k]
            for i in range(j, n):
                column[i] = column[i] - L[i][k] * scaled
        pivot.append(column[j].reciprocal())
        raw.append(column[j])
        for i in range(j + 1, n):
            L[i][j] = column[i] * pivot[j]
    W = [[zero] * n for _ in range(n)]  # L^-1, row by row
    for i in range(n):
        W[i][i] = one
        for j in range(i):
            total = L[i][j]
            for k in range(j + 1, i):
                total = total + L[i][k] * W[k][j]
            W[i][j] = -total
    half = [[pivot[k] * W[k][j] for j in range(n)] for k in range(n)]
    out = [[zero] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            total = zero
            for k in range(i, n):
                total = total + W[k][i] * half[k][j]
            out[i][j] = out[j][i] = total
    return out


def coriolis_degree(exact: DynamicsForms) -> int:
    """Highest total degree of the Coriolis torques in velocities, sines and cosines (12 for a general arm of six joints)."""
    forms = [x for C in exact.C for row in C for x in row]
    largest = max(float(np.abs(x.value).max(initial=0.0)) for x in forms)
    return 2 + max(int(x.degrees[np.abs(x.value) > 1e-12 * largest].max(initial=-2)) for x in forms)
