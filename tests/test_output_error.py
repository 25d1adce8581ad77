"""Inertia and damping by output error: the minimum is that of all trials, however few of them showed the way to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

from stopset.effects import get
from stopset.offline.diagnose.lacking import lacking, rises
from stopset.offline.nominal.open_loop import SPEED_LIMIT, EffectTerm, JointBatch, roll_out
from stopset.offline.nominal.output_error import FEW, STARTS, _lag_misfit, fit_joint, fit_lag

DT, N = 0.01, 200


def batch(J: float, v: float, moving: int, still: int, seed: int) -> JointBatch:
    """Trials of one joint with disturbed torques, of different lengths; ``still`` ones, first, hardly move."""
    rng = np.random.default_rng(seed)
    B = moving + still
    size = np.r_[np.full(still, 1e-4), np.ones(moving)]
    u = size * v * np.sin(rng.uniform(0.5, 4, B) * DT * np.arange(N)[:, None] + rng.uniform(0, 6, B))
    push = size * 0.3 * v * lfilter([0.05], [1, -0.95], rng.normal(size=(N, B)), axis=0)
    decay = np.exp(-v * DT / J)
    dq = lfilter([1.0], [1.0, -decay], np.vstack([np.zeros((1, B)), (1 - decay) / v * (u + push - 0.1 * size)[:-1]]), axis=0)
    q = np.vstack([np.zeros((1, B)), np.cumsum(0.5 * DT * (dq[1:] + dq[:-1]), axis=0)])
    inside = np.arange(N)[:, None] < rng.integers(N // 2, N + 1, B)
    none = np.zeros((N, B))
    return JointBatch(
        DT, q + rng.normal(0, 1e-5, q.shape), dq + rng.normal(0, 1e-3, dq.shape), u, none, none, np.zeros(B), inside
    )


@pytest.mark.parametrize(("J", "v", "moving", "still"), [(1.9, 12.6, 80, 0), (0.43, 4.0, 30, 120), (12.0, 27.0, 6, 100)])
def test_the_fit_is_the_best_that_any_start_leads_to_on_all_trials(J: float, v: float, moving: int, still: int) -> None:
    data = batch(J, v, moving, still, seed=int(10 * J))
    assert moving + still > FEW
    misfit = _lag_misfit(data)
    every = [least_squares(misfit, [np.log(a), np.log(b), 0.0], method="lm") for a, b in STARTS]
    best = min(every, key=lambda r: float(r.cost))
    found = fit_lag(data)
    assert 0.5 * np.sum(misfit(found) ** 2) <= best.cost * (1 + 1e-7)
    np.testing.assert_allclose(found, best.x, rtol=0, atol=1e-4)
    assert np.exp(found[:2]) == pytest.approx([J, v], rel=0.1)


def test_a_simulation_that_runs_away_goes_on_at_the_limit_instead_of_overflowing() -> None:
    """A spring that pushes: its torque grows with the position, which went on growing although the speed was held at the limit."""
    data = batch(1.0, 5.0, moving=4, still=0, seed=1)
    q, dq = roll_out(data, np.ones(1), np.full(1, 5.0), np.array([[0.0, -1e4, 0.0]]), [EffectTerm(get("spring"), {})])
    assert np.max(np.abs(dq)) == pytest.approx(SPEED_LIMIT)
    assert np.max(np.abs(np.diff(q, axis=1))) <= SPEED_LIMIT * DT * (1 + 1e-9)


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize(
    ("J", "v", "k", "v_3", "seed"),
    [(1.81, 10.15, 15.2, -1.83, 498), (2.11, 14.22, 27.6, -1.72, 292), (1.05, 6.64, 9.19, -1.33, 247)],
)
def test_a_strong_effect_does_not_lead_the_fit_to_no_inertia(
    J: float, v: float, k: float, v_3: float, seed: int, given: bool
) -> None:
    """The lag found without the spring was the start, and from there the inertia went to zero; so with the effects' numbers known."""
    moved = batch(J, v, moving=10, still=0, seed=seed)
    laws, values = (get("spring"), get("cubic_viscous")), ((k, 0.0), (v_3,))
    terms = [EffectTerm(law, {}) for law in laws]
    q, dq = roll_out(moved, np.array([J]), np.array([v]), np.array([[0.3, k, 0.0, v_3]]), terms)
    rng = np.random.default_rng(seed)
    data = replace(moved, q=q[0] + rng.normal(0, 1e-4, q[0].shape), dq=dq[0] + rng.normal(0, 1e-3, q[0].shape))
    if given:
        terms = [EffectTerm(law, {}, x) for law, x in zip(laws, values, strict=True)]
    found = fit_joint(data, "a", terms)
    assert found.inertia == pytest.approx(J, rel=0.02) and found.damping == pytest.approx(v, rel=0.02)
    assert found.effects[0].values["k"] == pytest.approx(k, rel=0.02)


def test_the_torque_that_a_lag_lacks_is_what_was_put_on_it() -> None:
    """Known inertia, damping and spring; half the trials carry 1.5 N m more than the parameters know, whatever the speed."""
    moved = batch(1.8, 10.0, moving=6, still=0, seed=3)
    terms = [EffectTerm(get("spring"), {}), EffectTerm(get("hysteresis"), {"delta": 0.02})]
    theta = np.array([0.3, 12.0, 0.4, 0.8])
    q, dq = roll_out(moved, np.array([1.8]), np.array([10.0]), theta[None, :], terms)
    data = replace(moved, q=q[0], dq=dq[0])
    p = np.r_[np.log([1.8, 10.0]), theta]
    np.testing.assert_allclose(lacking(data, terms, p), 0.0, atol=2e-3)
    push = np.where(np.arange(6) < 3, 1.5, 0.0)
    np.testing.assert_allclose(lacking(replace(data, u=data.u + push), terms, p), push**2, rtol=0.05, atol=2e-3)


def test_a_rise_counts_where_it_is_more_than_the_scatter_between_trials() -> None:
    rng = np.random.default_rng(4)
    before = rng.uniform(0.8, 1.2, 30)
    assert rises(before, 1.2 * before) and not rises(before, 0.9 * before)
    assert not rises(before, before + rng.normal(0.05, 1.0, 30)), "chance among the trials"
    assert not rises(before, 1.01 * before), "less than counts, however sure"
