"""Zonotopes: set operations, and the torque set as a zonotope where joints are disturbed together."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from stopset.artifact import Abstraction
from stopset.errors import NotConformant
from stopset.offline.conform.cooperative import Trial
from stopset.offline.conform.zonotopes import ZonotopeFit, directions, fit_zonotope, reach, template, torque_deviations
from stopset.recording import read_recordings
from stopset.robot import load_robot
from stopset.sets import Box, Zonotope

numbers = st.floats(-10, 10, allow_subnormal=False)


@st.composite
def zonotopes(draw: st.DrawFn) -> Zonotope:
    d, m = draw(st.integers(1, 3)), draw(st.integers(1, 6))
    return Zonotope(draw(arrays.arrays(float, d, elements=numbers)), draw(arrays.arrays(float, (d, m), elements=numbers)))


def samples(Z: Zonotope, number: int = 200) -> np.ndarray:
    """Points inside, corners of the generators' cube among them."""
    b = np.random.default_rng(0).uniform(-1, 1, (number, Z.generators.shape[1]))
    return Z.centre + np.vstack([b, np.sign(b)]) @ Z.generators.T


@settings(max_examples=100, deadline=None)
@given(zonotopes(), st.integers(0, 10**6))
def test_nothing_is_lost(Z: Zonotope, seed: int) -> None:
    rng = np.random.default_rng(seed)
    L = rng.normal(size=(6, Z.dim))
    x = samples(Z)
    assert np.all(x @ L.T <= Z.support(L))
    assert Z.box.contains(x)
    E = rng.normal(size=(2, Z.dim))
    slack = 1e-12 * (1 + np.abs(Z.generators).sum() + np.abs(Z.centre).sum())  # rounding of the samples themselves
    assert np.all(x @ E.T @ np.ones(2) <= Z.mapped(E).support(np.ones(2)) + slack)
    assert np.allclose((Z + Z).width(L), 2 * Z.width(L))
    for order in (1, 2):
        small = Z.reduced(order)
        assert small.generators.shape[1] <= max(order * Z.dim, Z.generators.shape[1] * (Z.generators.shape[1] <= order * Z.dim))
        assert np.all(small.support(L) >= Z.support(L) - slack)


def test_containment_volume_and_box() -> None:
    slanted = Zonotope(np.array([1.0, 0.0]), np.array([[1.0, 0.5], [1.0, -0.5]]))  # a rectangle on its corner
    assert slanted.volume == pytest.approx(4.0)
    assert slanted.contains(samples(slanted))
    assert not slanted.contains(np.array([1.0 + 1.4, -1.4]))  # in the box around it, not in the set
    assert slanted.box.contains(np.array([1.0 + 1.4, -1.4]))
    assert not Zonotope(slanted.centre, 0.99 * slanted.generators).contains(samples(slanted))
    box = Box.of([-1, 0, 2], [1, 1, 5])
    assert Zonotope.of_box(box).volume == pytest.approx(6.0)
    assert Zonotope.of_box(box).box.encloses(box)
    assert not Zonotope(np.zeros(2), np.array([[1.0], [1.0]])).contains(np.zeros(2))  # flat: says no rather than guess
    with pytest.raises(ValueError, match="expected"):
        Zonotope(np.zeros(2), np.zeros((3, 1)))


DT, NOISE = 0.02, Box.symmetric([1e-4, 1e-4, 2e-3, 2e-3])


def arm() -> Abstraction:
    return Abstraction(1, 1, np.linalg.inv(np.array([[2.0, 0.5], [0.5, 0.8]])), np.array([[8.0], [4.0]]))


def trials(G: np.ndarray, number: int = 12, N: int = 120, seed: int = 0) -> list[Trial]:
    """Trials of the linear arm under torques ``G b`` that jump between corners of the cube of b."""
    model, rng = arm(), np.random.default_rng(seed)
    Ad, Bd = _step(model)
    out = []
    for k in range(number):
        t = np.arange(N) * DT
        u = np.column_stack([3 * np.sin(t * (1 + k % 3)), np.cos(t + k)])
        push = rng.choice([-1.0, 1.0], (N // 15 + 1, G.shape[1])).repeat(15, axis=0)[:N] @ G.T
        x = np.zeros((N, 4))
        for i in range(N - 1):
            x[i + 1] = Ad @ x[i] + Bd @ (u[i] + push[i])
        out.append((x + rng.uniform(-1, 1, x.shape) * NOISE.hi, u))
    return out


def _step(model: Abstraction) -> tuple[np.ndarray, np.ndarray]:
    """Many small Euler steps; independent of the code under test."""
    A, B, h, E, S = model.A, model.B, DT / 4000, np.eye(4), np.zeros((4, 2))
    for _ in range(4000):
        S = S + h * (E @ B)
        E = E + h * (A @ E)
    return E, S


ACROSS = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2)
TOGETHER = np.array([[1.0, 0.05], [0.6, -0.08]])  # both joints are pushed the same way


def fits(data: list[Trial], model: Abstraction) -> dict[str, ZonotopeFit]:
    l = np.vstack([np.eye(2), ACROSS])  # noqa: E741
    seen = directions(data, model, l, DT, 60, 3)
    G = template(torque_deviations(data, model, DT), model)
    return {"box": fit_zonotope(seen, model, np.eye(2), NOISE), "zonotope": fit_zonotope(seen, model, G, NOISE)}


def test_a_zonotope_is_smaller_where_joints_are_disturbed_together() -> None:
    got = fits(trials(TOGETHER), arm())
    assert got["zonotope"].cost < 0.85 * got["box"].cost
    assert got["zonotope"].U.volume < 0.5 * got["box"].U.volume
    # and it is about the set that made the data
    true = Zonotope(np.zeros(2), TOGETHER)
    assert np.all(got["zonotope"].U.width(ACROSS) < 1.25 * true.width(ACROSS) + 0.05)


def test_a_zonotope_is_never_worse_than_a_box() -> None:
    for G in (np.diag([1.0, 0.3]), TOGETHER, np.array([[0.5, 0.2, 0.1], [-0.1, 0.4, 0.3]])):
        got = fits(trials(G, 6), arm())
        assert got["zonotope"].cost <= got["box"].cost * (1 + 1e-6)


def tube(fit: ZonotopeFit, model: Abstraction, l: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # noqa: E741
    E1, middle, size = reach(model, l, fit.U.generators, DT, 60)
    rows = np.vstack([np.hstack([l, 0 * l]), np.hstack([0 * l, l])])
    spread = np.abs(E1) @ fit.V.hi + np.abs(rows) @ fit.V.hi + size.sum(axis=2)
    return middle @ fit.U.centre - spread, middle @ fit.U.centre + spread


def test_the_tube_encloses_the_data_and_new_solutions_and_shrinking_breaks_it() -> None:
    model, l = arm(), np.vstack([np.eye(2), ACROSS])  # noqa: E741
    data = trials(TOGETHER)
    fit = fits(data, model)["zonotope"]
    lo, hi = tube(fit, model, l)
    every = directions(data, model, l, DT, 60, 3)  # the deviations the fit has seen
    assert np.all(every.hi[1:] <= hi[1:]) and np.all(every.lo[1:] >= lo[1:])
    # new solutions under torques anywhere in U, from readings with any noise
    rng = np.random.default_rng(9)
    Ad, Bd = _step(model)
    project = np.vstack([np.hstack([l, 0 * l]), np.hstack([0 * l, l])])
    e = rng.uniform(-1, 1, (500, 4)) * NOISE.hi
    for h in range(1, 61):
        w = fit.U.centre + np.sign(rng.uniform(-1, 1, (500, fit.U.generators.shape[1]))) @ fit.U.generators.T
        e = e @ Ad.T + w @ Bd.T
        seen = e @ project.T
        assert np.all(seen <= hi[h]) and np.all(seen >= lo[h])
    small = replace(fit, U=Zonotope(fit.U.centre, 0.9 * fit.U.generators))
    lo, hi = tube(small, model, l)
    assert not (np.all(every.hi[1:] <= hi[1:]) and np.all(every.lo[1:] >= lo[1:]))


def test_impossible_data_are_refused() -> None:
    model = arm()
    seen = directions(trials(TOGETHER, 2), model, np.eye(2), DT, 20, 3)
    broken = replace(seen, hi=np.where(np.arange(21)[:, None] == 5, np.nan, seen.hi))
    with pytest.raises((NotConformant, ValueError)):
        fit_zonotope(broken, model, np.eye(2), NOISE)


@pytest.mark.shared
def test_on_the_real_arm_a_zonotope_is_narrower_at_the_tool() -> None:
    """Schunk LWA-4P, the paper's own recordings: per-joint model 1 with the reference inertias and damping."""
    path = Path(__file__).resolve().parents[2] / "shared" / "data" / "schunk_lwa4p" / "open_loop.parquet"
    if not path.exists():
        pytest.skip("../shared/data is not here")
    spec = importlib.util.spec_from_file_location(
        "zonotope_benchmark", Path(__file__).resolve().parents[1] / "benchmarks" / "zonotope.py"
    )
    assert spec is not None and spec.loader is not None
    benchmark = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    robot = load_robot("lwa4p")
    inertia, damping = np.array([1.89, 12.4, 1.93, 1.82, 0.55, 0.43]), np.array([12.6, 30.8, 8.5, 8.1, 3.5, 4.0])
    model = Abstraction(1, 1, np.diag(1.0 / inertia), damping[:, None])
    data = []
    for r in read_recordings(path, robot):
        steps = (len(r.t) - 1) // 5
        mean = r.tau[: steps * 5].reshape(steps, 5, -1).mean(axis=1)
        data.append((np.hstack([r.q, r.dq])[: steps * 5 + 1 : 5], np.vstack([mean, mean[-1:]])))
    tool = benchmark.tool_directions(robot, np.array([x[len(x) // 2, :6] for x, _ in data[::40]]))
    noise = Box.symmetric(np.repeat([1e-4, 5e-3], 6))  # about the encoder's resolution and the velocity's scatter
    got = benchmark.compare(data, model, noise, tool, 0.02, 1.0)
    assert got["zonotope"].cost < 0.9 * got["box"].cost
    assert got["zonotope"].U.volume < 0.5 * got["box"].U.volume
