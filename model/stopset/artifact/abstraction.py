"""The simple dynamics that stand for the arm: ``ddq = P(dq, sin q, cos q, u)``, a polynomial of some order.

Model 1 keeps only ``M^-1(q_a)`` and a viscous polynomial per joint; models 2 and 3 carry polynomials in
``(dq, sin q, cos q, u)`` too.  Source: Liu & Althoff (2018), eq. (13)-(16).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Polynomial:
    """``sum_k coefficient[k] * prod_i z_i^exponent[k, i]``; ``exponent``: (m, d) small integers, ``coefficient``: (m,)."""

    exponent: NDArray[np.int64]
    coefficient: Array

    def __call__(self, z: Array) -> Array:
        """Values at the rows of ``z`` (N, d) -> (N,)."""
        out = np.zeros(z.shape[0])
        for e, c in zip(self.exponent, self.coefficient, strict=True):
            term = np.full(z.shape[0], c)
            for i in np.flatnonzero(e):
                term = term * z[:, i] ** int(e[i])
            out += term
        return out


@dataclass(frozen=True, slots=True)
class Abstraction:
    """``ddq = Minv (u - viscous(dq) - coriolis(dq, s, c))`` (models 1, 2) or ``ddq = acceleration(dq, s, c, u)`` (model 3).

    ``Minv``: (n, n) [1/(kg m^2)], the inverse of ``M(q_a) + J_rotor``; ``viscous``: (n, r) coefficients of
    ``dq, dq^2, ..., dq^r`` [N m (s/rad)^k]; ``coriolis``: n polynomials in ``(dq, sin q, cos q)`` (3n variables), empty in
    model 1; ``acceleration``: n polynomials in ``(dq, sin q, cos q, u)`` (4n variables), only in model 3.
    """

    kind: int
    order: int
    Minv: Array
    viscous: Array
    coriolis: tuple[Polynomial, ...] = ()
    acceleration: tuple[Polynomial, ...] = ()

    @property
    def n(self) -> int:
        return int(self.Minv.shape[0])

    @property
    def linear(self) -> bool:
        """Whether the dynamics are ``x' = A x + B u`` exactly."""
        return self.kind == 1 and not np.any(self.viscous[:, 1:])

    @property
    def A(self) -> Array:
        """(2n, 2n) state matrix over ``x = (q, dq)``, linearised at rest."""
        n = self.n
        A = np.zeros((2 * n, 2 * n))
        A[:n, n:] = np.eye(n)
        A[n:, n:] = -self.Minv * self.viscous[:, 0]
        return A

    @property
    def B(self) -> Array:
        """(2n, n) input matrix."""
        return np.vstack([np.zeros((self.n, self.n)), self.Minv])

    @property
    def decoupled(self) -> bool:
        """Whether every joint is a system of its own (``Minv`` diagonal)."""
        return self.kind == 1 and not np.any(self.Minv - np.diag(np.diag(self.Minv)))

    def ddq(self, q: Array, dq: Array, u: Array) -> Array:
        """Accelerations at rows of ``q, dq, u`` (N, n) -> (N, n) [rad/s^2]."""
        if self.kind == 3:
            z = np.hstack([dq, np.sin(q), np.cos(q), u])
            return np.column_stack([p(z) for p in self.acceleration])
        friction = sum(self.viscous[:, k] * dq ** (k + 1) for k in range(self.viscous.shape[1]))
        if self.coriolis:
            z = np.hstack([dq, np.sin(q), np.cos(q)])
            friction = friction + np.column_stack([p(z) for p in self.coriolis])
        return (u - friction) @ self.Minv.T
