"""Least squares under limits, against a slow and simple reference."""

from __future__ import annotations

import numpy as np
import pytest

from stopset.offline.nominal import qp
from stopset.offline.nominal.qp import solve_qp


def by_projection(H: np.ndarray, b: np.ndarray, A: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """Hildreth's dual coordinate ascent, 20,000 sweeps at most: no step sizes, no tolerances to tune."""
    inverse = np.linalg.inv(H)
    S = A @ inverse @ A.T
    r = A @ inverse @ b
    up, down = np.zeros(len(A)), np.zeros(len(A))
    for _ in range(20_000):
        before = down - up
        for k in range(len(A)):
            v = r[k] + S[k] @ (down - up)
            for own, bound, sign in ((down, lo, 1.0), (up, hi, -1.0)):
                if np.isfinite(bound[k]):
                    v = r[k] + S[k] @ (down - up)
                    own[k] = max(0.0, own[k] + sign * (bound[k] - v) / S[k, k])
        if np.abs(down - up - before).max() < 1e-13:
            break
    return inverse @ (b + A.T @ (down - up))


@pytest.mark.parametrize("seed", range(12))
def test_matches_the_reference_and_meets_every_limit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = 7, 9
    X = rng.normal(size=(30, n))
    H, b = X.T @ X, 5 * rng.normal(size=n)
    A = rng.normal(size=(m, n))
    lo = np.where(rng.random(m) < 0.5, rng.uniform(-0.3, 0.0, m), -np.inf)
    hi = np.where(rng.random(m) < 0.5, rng.uniform(0.0, 0.3, m), np.inf)
    x, active = solve_qp(H, b, A, lo, hi)
    np.testing.assert_allclose(x, by_projection(H, b, A, lo, hi), atol=1e-7)
    assert np.all(A @ x >= lo - 1e-8) and np.all(A @ x <= hi + 1e-8)
    free = np.linalg.solve(H, b)
    outside = bool(np.any(A @ free < lo - 1e-9) or np.any(A @ free > hi + 1e-9))
    assert active.any() == outside  # limits are named exactly when they hold something back


def test_limits_far_away_do_not_disturb() -> None:
    H, b = np.diag([1e10, 1.0]), np.array([1e10, -1.0])
    x, _ = solve_qp(H, b, np.eye(2), np.array([0.0, 0.0]), np.array([1e4, 1e9]))
    np.testing.assert_allclose(x, [1.0, 0.0], atol=1e-9)


def test_a_side_that_is_open_holds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an arm that creeps, whose rows are badly scaled, the solver said that the open side of a range was met: all came out as no number."""
    monkeypatch.setattr(qp, "_active", lambda *_: {0: -1.0})
    x, active = solve_qp(np.eye(2), np.array([-1.0, 2.0]), np.eye(2), np.zeros(2), np.array([np.inf, 5.0]))
    assert x == pytest.approx([0.0, 2.0]) and active.tolist() == [True, False]
