"""Forward dynamics by another recursion than the product's, over any numbers: articulated bodies."""

from __future__ import annotations

from collections.abc import Sequence

from stopset.robot.generic import (
    Number,
    Vector,
    _apply,
    _axis,
    _cross_force,
    _cross_motion,
    _dot,
    _exact,
    _inertias,
    _minus,
    _plus,
    _sum,
    _times,
    _transforms,
    _transposed,
    _zero,
)  # fmt: skip
from stopset.robot.rigid import Chain
from stopset.types import Array


def forward_dynamics(
    chain: Chain,
    pi: Array,
    rotor: Array,
    s: Sequence[Number],
    c: Sequence[Number],
    dq: Sequence[Number],
    u: Sequence[Number],
) -> list[Number]:
    """Accelerations [rad/s^2] of ``(M + diag(rotor)) ddq + c(q, dq) = u``: Featherstone's articulated bodies, no
    gravity.

    Source: Featherstone (2008), table 7.1.
    """
    n = len(pi)
    X, inertia = _transforms(chain, s, c), _inertias(pi)
    v: Vector = [0.0] * 6
    bias, drift = [], []
    for i in range(n):
        joint = _axis(chain.axis[i], dq[i])
        v = _sum(_apply(X[i], v), joint)
        drift.append(_cross_motion(v, joint))
        bias.append(_cross_force(v, _apply(inertia[i], v)))
    U, d, rest = [[0.0]] * n, [0.0] * n, [0.0] * n
    for i in reversed(range(n)):
        S = [*(float(k) for k in _exact(chain.axis[i])), 0.0, 0.0, 0.0]
        U[i] = _apply(inertia[i], S)
        d[i] = _plus(_dot(S, U[i]), float(rotor[i]))
        rest[i] = _minus(u[i], _dot(S, bias[i]))
        if i == 0:
            break
        W = [x / d[i] if not _zero(x) else 0.0 for x in U[i]]
        Ia = [[_minus(inertia[i][r][k], _times(W[r], U[i][k])) for k in range(6)] for r in range(6)]
        pa = _sum(bias[i], _apply(Ia, drift[i]), [_times(w, rest[i]) for w in W])
        back = _transposed(X[i])
        half = [_apply(_transposed(Ia), row) for row in back]  # X^T Ia, row by row
        moved = [[_dot(row, column) for column in zip(*X[i], strict=True)] for row in half]
        inertia[i - 1] = [_sum(x, y) for x, y in zip(inertia[i - 1], moved, strict=True)]
        bias[i - 1] = _sum(bias[i - 1], _apply(back, pa))
    a: Vector = [0.0] * 6
    ddq: list[Number] = [0.0] * n
    for i in range(n):
        a = _sum(_apply(X[i], a), drift[i])
        ddq[i] = _minus(rest[i], _dot(U[i], a)) / d[i]
        a = _sum(a, _axis(chain.axis[i], ddq[i]))
    return ddq
