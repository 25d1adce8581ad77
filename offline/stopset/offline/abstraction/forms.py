"""Mass matrix, its inverse and the Coriolis matrices of an arm as Taylor polynomials in the sines and cosines of its
angles.

Nothing depends on the first joint's angle (gravity is in the input), so an arm of ``n`` joints needs ``2 (n - 1)``
variables, and the velocities and torques, in which the dynamics are quadratic and linear, need none at all.

Source: Liu & Althoff (2018), Sec. IV-B, eq. (12) and property A.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.ring.taylor import Algebra, Taylor
from stopset.robot import Robot
from stopset.robot.generic import mass_matrix
from stopset.robot.rigid import Array

Matrix = list[list[Taylor]]


@dataclass(frozen=True, slots=True)
class Angles:
    """The variables: sine and cosine of joints 2 .. n about their values at the expansion point ``q_a`` (n,) [rad]."""

    algebra: Algebra
    sine: tuple[Taylor, ...]
    cosine: tuple[Taylor, ...]
    centre: Array  # (2 (n - 1),) values of the variables at the expansion point: sines, then cosines

    @classmethod
    def at(cls, sine: Array, cosine: Array, order: int, inverse: bool = True) -> Angles:
        """Variables about ``sine, cosine`` (n,); ``inverse``: are quotients needed too (for the memory guard)?"""
        n = sine.size
        algebra = Algebra(2 * (n - 1), order, live=n**3, sparse=None if inverse else terms(n))
        first = (algebra.constant(0.0),), (algebra.constant(1.0),)  # any angle does for the first joint
        s = (algebra.variable(i, float(sine[i + 1])) for i in range(n - 1))
        c = (algebra.variable(n - 1 + i, float(cosine[i + 1])) for i in range(n - 1))
        return cls(algebra, (*first[0], *s), (*first[1], *c), np.concatenate([sine[1:], cosine[1:]]))

    def by_angle(self, x: Taylor, k: int) -> Taylor:
        """``dx / dq_k``, exact to one order less than ``x``: the angle moves its sine by its cosine and back."""
        if k == 0:
            return self.algebra.constant(0.0)
        n = len(self.sine)
        return self.cosine[k] * x.derivative(k - 1) - self.sine[k] * x.derivative(n - 2 + k)


def terms(n: int) -> int:
    """Most terms of an entry of M or C: they are quadratic in (sin q_k, cos q_k) of each joint behind the first."""
    return int(6 ** (n - 1))


def inertia(robot: Robot, rotor: Array, angles: Angles) -> Matrix:
    """``M_m = M(q) + diag(rotor)`` [kg m^2]."""
    n, zero = robot.n, angles.algebra.constant(0.0)
    M = mass_matrix(robot.chain, robot.pi, angles.sine, angles.cosine)
    # exact zeros of the geometry come as plain numbers; both halves are computed and one is kept, so M is symmetric to
    # the bit
    return [[zero + M[max(i, j)][min(i, j)] + (float(rotor[i]) if i == j else 0.0) for j in range(n)] for i in range(n)]


def coriolis(M: Matrix, angles: Angles, order: int) -> list[list[list[Taylor]]]:
    """``C[i][j][k]`` for j <= k: the coefficient of ``dq_j dq_k`` in the Coriolis torque of joint i, cut at ``order``.

    Source: Liu & Althoff (2018), after eq. (12): ``c_ijk = dM_ij/dq_k - 1/2 dM_jk/dq_i``.
    """
    n = len(M)
    slope = [[[angles.by_angle(M[i][j], k) for k in range(n)] for j in range(i + 1)] for i in range(n)]

    def d(i: int, j: int, k: int) -> Taylor:
        return slope[max(i, j)][min(i, j)][k]

    return [
        [
            [
                ((d(i, j, k) + d(i, k, j) - d(j, k, i)) if k > j else (d(i, j, j) - 0.5 * d(j, j, i))).cut(order)
                if k >= j
                else angles.algebra.constant(0.0)
                for k in range(n)
            ]
            for j in range(n)
        ]
        for i in range(n)
    ]


def inverse(M: Matrix) -> Matrix:
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


def coriolis_degree(robot: Robot) -> int:
    """Highest total degree of the Coriolis torques as polynomials in velocities, sines and cosines (12 for six generic
    joints).

    Exact: with the variables themselves instead of deviations the polynomials end by themselves, at twice per moving
    angle.
    """
    angles = Angles.at(np.zeros(robot.n), np.zeros(robot.n), max(1, 2 * (robot.n - 1)), inverse=False)
    M = inertia(robot, np.zeros(robot.n), angles)
    terms = [x for rows in coriolis(M, angles, angles.algebra.order) for row in rows for x in row]
    largest = max(float(np.abs(x.value).max(initial=0.0)) for x in terms)
    degrees = [int(x.degrees[np.abs(x.value) > 1e-12 * largest].max(initial=-2)) for x in terms]
    return max(degrees) + 2
