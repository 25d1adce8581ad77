"""Rigid-body dynamics in plain Python over any numbers: floats, arrays, intervals, Taylor forms.

The same recursions as the compiled ones, in spatial vectors (angular over linear part, six numbers), written once with
``+ - * /``; which numbers come in decides what comes out.  Angles enter as their sine and cosine (property A), so with
Taylor forms for these the dynamics are composed into polynomials by operator overloading.  Exact zeros of the geometry
are skipped, which keeps the polynomials as sparse as the arm is.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 5 and 7; Liu & Althoff (2018), Sec. IV-B, property A.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stopset.robot.rigid import Chain
from stopset.types import Array

Number = Any
Vector = list[Number]
Matrix = list[list[Number]]
_SNAP = 1e-12  # entries of a unit vector or rotation closer than this to 0 or +-1 are meant to be it


def _exact(x: Array) -> Array:
    """Geometry without the 1e-17 that cosines of quarter turns leave behind."""
    out = np.where(np.abs(x) < _SNAP, 0.0, x)
    return np.where(np.abs(np.abs(out) - 1.0) < _SNAP, np.sign(out), out)


def _zero(x: Number) -> bool:
    return isinstance(x, float) and x == 0.0


def _times(a: Number, b: Number) -> Number:
    if _zero(a) or _zero(b):
        return 0.0
    if isinstance(a, float) and a == 1.0:
        return b
    return a * b


def _plus(a: Number, b: Number) -> Number:
    if _zero(a):
        return b
    return a if _zero(b) else a + b


def _minus(a: Number, b: Number) -> Number:
    return a if _zero(b) else a - b


def _dot(a: Sequence[Number], b: Sequence[Number]) -> Number:
    out: Number = 0.0
    for x, y in zip(a, b, strict=True):
        out = _plus(out, _times(x, y))
    return out


def _cross(a: Vector, b: Vector) -> Vector:
    (a0, a1, a2), (b0, b1, b2) = a, b
    return [
        _minus(_times(a1, b2), _times(a2, b1)),
        _minus(_times(a2, b0), _times(a0, b2)),
        _minus(_times(a0, b1), _times(a1, b0)),
    ]


def _sum(*vectors: Vector) -> Vector:
    out = list(vectors[0])
    for v in vectors[1:]:
        out = [_plus(x, y) for x, y in zip(out, v, strict=True)]
    return out


def _apply(A: Matrix, v: Vector) -> Vector:
    return [_dot(row, v) for row in A]


def _transposed(A: Matrix) -> Matrix:
    return [list(column) for column in zip(*A, strict=True)]


def _floats(A: Array) -> Any:
    return A.tolist()


def _transforms(chain: Chain, s: Sequence[Number], c: Sequence[Number]) -> list[Matrix]:
    """Motion transforms parent -> link, 6 x 6: ``v_i = X_i v_parent``; forces go back by the transpose."""
    out = []
    for R, p, axis, si, ci in zip(_exact(chain.R), chain.p, _exact(chain.axis), s, c, strict=True):
        x, y, z = (float(a) for a in axis)
        fixed = R @ np.outer(axis, axis)
        with_c = _exact(R @ (np.eye(3) - np.outer(axis, axis)))
        with_s = _exact(R @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
        rotation = [
            [_plus(_plus(float(fixed[r, k]), _times(float(with_c[r, k]), ci)), _times(float(with_s[r, k]), si)) for k in range(3)]
            for r in range(3)
        ]
        E = _transposed(rotation)
        u, v, w = (float(a) for a in p)
        px = [[0.0, -w, v], [w, 0.0, -u], [-v, u, 0.0]]
        lower = [[_minus(0.0, _dot(row, column)) for column in zip(*px, strict=True)] for row in E]
        out.append([[*E[r], 0.0, 0.0, 0.0] for r in range(3)] + [[*lower[r], *E[r]] for r in range(3)])
    return out


def _inertias(pi: Array) -> list[Matrix]:
    """Spatial inertia of every link about its frame's origin, 6 x 6, from the ten standard parameters."""
    out = []
    for m, hx, hy, hz, xx, xy, yy, xz, yz, zz in pi:
        h = np.array([[0.0, -hz, hy], [hz, 0.0, -hx], [-hy, hx, 0.0]])
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        out.append(_floats(np.block([[tensor, h], [h.T, m * np.eye(3)]])))
    return out


def _cross_motion(v: Vector, m: Vector) -> Vector:
    return _cross(v[:3], m[:3]) + _sum(_cross(v[:3], m[3:]), _cross(v[3:], m[:3]))


def _cross_force(v: Vector, f: Vector) -> Vector:
    return _sum(_cross(v[:3], f[:3]), _cross(v[3:], f[3:])) + _cross(v[:3], f[3:])


def _axis(a: Array, x: Number) -> Vector:
    return [_times(float(k), x) for k in _exact(a)] + [0.0, 0.0, 0.0]


def inverse_dynamics(
    chain: Chain,
    pi: Array,
    s: Sequence[Number],
    c: Sequence[Number],
    dq: Sequence[Number],
    ddq: Sequence[Number],
    gravity: Sequence[Number] = (0.0, 0.0, 0.0),
) -> list[Number]:
    """Joint torques ``M ddq + c + g`` [N m] (recursive Newton-Euler), links only; without ``gravity`` [m/s^2]: ``M ddq
    + c``.

    ``s, c``: sine and cosine of the joint angles.  Source: Featherstone (2008), table 5.1; Liu & Althoff (2018), eq.
    (3).
    """
    X, inertia = _transforms(chain, s, c), _inertias(pi)
    v: Vector = [0.0] * 6
    a: Vector = [0.0, 0.0, 0.0, *(-g if not _zero(g) else 0.0 for g in gravity)]
    forces = []
    for i, axis in enumerate(chain.axis):
        joint = _axis(axis, dq[i])
        v = _sum(_apply(X[i], v), joint)
        a = _sum(_apply(X[i], a), _axis(axis, ddq[i]), _cross_motion(v, joint))
        forces.append(_sum(_apply(inertia[i], a), _cross_force(v, _apply(inertia[i], v))))
    tau: list[Number] = [0.0] * len(forces)
    f: Vector = [0.0] * 6
    for i in reversed(range(len(forces))):
        f = _sum(f, forces[i])
        tau[i] = _dot([float(k) for k in _exact(chain.axis[i])], f[:3])
        f = _apply(_transposed(X[i]), f)
    return tau


def mass_matrix(chain: Chain, pi: Array, s: Sequence[Number], c: Sequence[Number]) -> Matrix:
    """``M`` [kg m^2], (n, n) nested lists, links only: its columns are the torques of unit accelerations at rest."""
    n = len(pi)
    rest = [0.0] * n
    columns = [inverse_dynamics(chain, pi, s, c, rest, [float(i == k) for i in range(n)]) for k in range(n)]
    return _transposed(columns)
