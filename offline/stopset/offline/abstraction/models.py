"""Build the abstractions: model 1, 2 or 3 of any order ``p`` from a robot, its rotors and its viscous friction.

    model 1   ddq = M_m^-1(q_a) (u - T^p tau_nu(dq))                                       eq. (13)
    model 2   ddq = M_m^-1(q_a) (u - dq' T^{p-2}_C(sin q, cos q) dq - T^p tau_nu(dq))      eq. (14), (15)
    model 3   ddq = T^p_f(dq, sin q, cos q, u)                                             eq. (16)

The Taylor polynomial of f is put together from those of its factors: f = M_m^-1 (u - c - tau_nu) is linear in u and
quadratic in dq apart from tau_nu, so the part behind ``u_j`` is cut at ``p - 1``, the part behind ``dq_j dq_k`` at ``p
- 2``.

Source: Liu & Althoff (2018), Sec. IV-B.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stopset.artifact.abstraction import Abstraction
from stopset.artifact.polynomial import Polynomial, collected
from stopset.errors import StopsetError
from stopset.offline.abstraction.forms import DynamicsForms, TaylorMatrix, coriolis_degree, dynamics, inverse, terms
from stopset.ring.taylor import MEMORY_LIMIT, Taylor, TaylorError, monomials
from stopset.robot import Robot
from stopset.robot.rigid import mass_matrix
from stopset.types import Array

ORDERS = (1, 3, 5, 7)  # of the paper's Table I
# coefficients whose sum is below this fraction of the largest are rounding of the algebra and are dropped: on |sin|,
# |cos| <= 1 this moves a value by no more than that
ROUNDING = 1e-13


def build(kind: int, order: int, robot: Robot, rotor: Array, viscous: Array, q_a: Array | None = None) -> Abstraction:
    """The abstraction of ``kind`` 1, 2 or 3 and order ``p``.

    ``rotor``: (n,) reflected rotor inertia [kg m^2]; ``viscous``: (n, r) coefficients of dq, dq^2, .. [N m (s/rad)^k];
    ``q_a``: (n,) expansion point [rad], zero as in the paper if left out; velocities and torques expand about zero.

    Raises `TaylorError` before any work when the polynomials would not fit into memory.
    """
    n = robot.n
    if kind not in (1, 2, 3) or order < 1:
        raise StopsetError(f"model {kind} of order {order}: expected model 1, 2 or 3 and an order of at least 1")
    rotor, viscous = np.asarray(rotor, float), np.asarray(viscous, float).reshape(n, -1)
    at = np.zeros(n) if q_a is None else np.asarray(q_a, float)
    Minv = np.linalg.inv(mass_matrix(robot.chain, robot.pi, at) + np.diag(rotor))
    Minv = 0.5 * (Minv + Minv.T)
    tau_nu = viscous[:, :order].copy()  # T^p of a polynomial
    if kind == 1 or (kind == 2 and order < 2):
        return Abstraction(kind, order, Minv, tau_nu)
    _guard(kind, order, n, viscous.shape[1])
    forms = dynamics(robot, rotor)
    if kind == 3:
        return Abstraction(
            3, order, Minv, tau_nu, acceleration=_acceleration(forms.expanded(at, order - 1, inverse=True), tau_nu, order)
        )
    if order < coriolis_degree(forms):  # else the polynomials are exact, and written about zero they are far shorter
        forms = forms.expanded(at, order - 1, inverse=False)
    return Abstraction(2, order, Minv, tau_nu, coriolis=tuple(_quadratic(C, forms) for C in forms.C))


def predicted_bytes(kind: int, order: int, n: int, friction_degree: int = 3) -> int:
    """Memory the finished polynomials of one abstraction may take at most [bytes], from counting monomials alone."""
    d, width = 2 * (n - 1), 3 * n if kind == 2 else 4 * n

    def count(cut: int) -> int:
        full = monomials(d, cut) if cut >= 0 else 0
        return min(full, terms(n)) if kind == 2 else full

    rows = n * (n + 1) // 2 * count(order - 2)
    if kind == 3:
        rows += n * count(order - 1) + n * sum(count(order - k) for k in range(1, friction_degree + 1))
    # exponents and coefficient of each row, per joint, once while collecting and once in the result; and the compiled
    # table
    return 0 if kind == 1 else rows * n * (2 * 8 * (width + 1) + 3 * 8)


def _guard(kind: int, order: int, n: int, friction_degree: int) -> None:
    need = predicted_bytes(kind, order, n, friction_degree)
    if need > MEMORY_LIMIT:
        raise TaylorError(
            f"model {kind} of order {order} for {n} joints would take up to {need / 2**30:.1f} GiB; allowed are "
            f"{MEMORY_LIMIT / 2**30:.1f} GiB: lower the order, or take model 2 (a high order of model 3 is no better: "
            "see docs/table1.md)"
        )


class _Rows:
    """Monomials in (dq, sin q, cos q[, u]) being put together for one joint."""

    def __init__(self, forms: DynamicsForms, width: int) -> None:
        self.centre, self.width, self.n = forms.centre, width, len(forms.M)
        self.exponent: list[NDArray[np.int64]] = []
        self.coefficient: list[Array] = []

    def add(self, x: Taylor, *columns: int) -> None:
        """Add ``x`` times the variables in ``columns`` (dq_j is column j, u_j column 3n + j)."""
        if not x.value.size:
            return
        local = Polynomial(x.exponents, x.value).recentred(-self.centre)
        e = np.zeros((local.coefficient.size, self.width), np.int64)
        m = self.n - 1
        e[:, self.n + 1 : 2 * self.n] = local.exponent[:, :m]
        e[:, 2 * self.n + 1 : 3 * self.n] = local.exponent[:, m:]
        for k in columns:
            e[:, k] += 1
        self.exponent.append(e)
        self.coefficient.append(local.coefficient)

    def polynomial(self) -> Polynomial:
        if not self.exponent:
            return Polynomial(np.zeros((1, self.width), np.int64), np.zeros(1))
        e, c = collected(np.vstack(self.exponent), np.concatenate(self.coefficient))
        rank = np.argsort(np.abs(c))
        small = rank[np.cumsum(np.abs(c[rank])) <= ROUNDING * np.abs(c).max(initial=0.0)]
        keep = np.ones(c.size, bool)
        keep[small] = False
        return Polynomial(e[keep], c[keep]) if keep.any() else Polynomial(e[:1] * 0, np.zeros(1))


def _pairs(n: int) -> list[tuple[int, int]]:
    return [(j, k) for j in range(n) for k in range(j, n)]


def _quadratic(C: TaylorMatrix, forms: DynamicsForms) -> Polynomial:
    """``sum_{j<=k} C_jk dq_j dq_k`` of one joint."""
    rows = _Rows(forms, 3 * len(C))
    for j, k in _pairs(len(C)):
        rows.add(C[j][k], j, k)
    return rows.polynomial()


def _acceleration(forms: DynamicsForms, tau_nu: Array, order: int) -> tuple[Polynomial, ...]:
    """Taylor polynomials of the accelerations in (dq, sin q, cos q, u)."""
    n = len(forms.M)
    Minv = inverse(forms.M)
    out = []
    for i in range(n):
        rows = _Rows(forms, 4 * n)
        for j in range(n):
            rows.add(Minv[i][j], 3 * n + j)
            for k in range(min(order, tau_nu.shape[1])):
                rows.add(-tau_nu[j, k] * Minv[i][j].cut(order - 1 - k), *([j] * (k + 1)))
        for j, k in _pairs(n) if order >= 2 else []:
            total = Minv[i][0] * forms.C[0][j][k]
            for a in range(1, n):
                total = total + Minv[i][a] * forms.C[a][j][k]
            rows.add(-total.cut(order - 2), j, k)
        out.append(rows.polynomial())
    return tuple(out)
