"""Every number that a stop bound publishes is held against simulated stops, in every category, along paths and from the corners
of the monitor's boxes; each made too small is contradicted."""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from pathlib import Path as File

import numpy as np
import pytest

from stop_published import (
    ASKED_BY,
    CHECKED,
    NOT_ALONG_A_PATH,
    WORDS,
    Stopped,
    beyond,
    failed_ramp,
    power_off,
    ramp_motion,
    weakened,
    working_ramp,
)  # fmt: skip
from stopset.reach.stops import CATEGORIES, Category, Ramp, StopBound, StopBounds
from stopset.sets import Box

sys.path.insert(0, str(File(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like
from stop_arms_wide import arms

N, STATES, STOPS = 6, 3, 10
RAMP = replace(
    Ramp.stated(N, time=0.3), value=Box.of(np.full(N, 0.28), np.full(N, 0.32)), control=Box.of(np.full(N, 0.01), np.full(N, 0.024)),
    q_error=np.full(N, 2e-3), dq_error=np.full(N, 0.04), settle=0.1, pace=(-0.4, 0.4), off_after=0.15,
)  # fmt: skip
BOUNDS = StopBounds.of(prbt_like(), (0.0, 0.25), ramp=RAMP, pieces=8)
WORKING = replace(BOUNDS, ramp=replace(RAMP, off_after=None))  # power stays on until it has stopped the arm
WATCHED = replace(BOUNDS, ramp=replace(RAMP, monitored=True, off_after=None))
BRAKED = replace(
    WATCHED,
    ramp=replace(RAMP, kind="deceleration", value=Box.of(np.full(N, 2.0), np.full(N, 2.2)), monitored=True, off_after=None),
)
POINT = (np.zeros(N), np.zeros(N))
BOX = (np.full(N, 0.01), np.full(N, 0.05))


def states() -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(71)
    return [(rng.uniform(-2.0, 2.0, N), rng.uniform(-1.1, 1.1, N)) for _ in range(STATES)]


def stops_of(bounds: StopBounds, b: StopBound, q: np.ndarray, dq: np.ndarray, radii=POINT) -> list[Stopped]:  # type: ignore[no-untyped-def]
    assert b.time is not None
    lasts = float(b.time.max())
    if b.category == "0":
        return list(power_off(bounds, q, dq, radii, lasts, STOPS, 5))
    if b.category == "1 guaranteed":
        return list(failed_ramp(bounds, q, dq, radii, lasts, STOPS, 6))
    return list(working_ramp(bounds, q, dq, radii, bounds.ramp.window if b.category == "2" else 0.0, STOPS, 7))


def test_every_number_has_a_check() -> None:
    """A field, property or method of `StopBound` that is neither checked nor named as words is a number nobody holds."""
    methods = {name for name in vars(StopBound) if not name.startswith("_")} - {f.name for f in fields(StopBound)}
    numbers = {f.name for f in fields(StopBound)} | methods
    assert numbers == set(CHECKED) | WORDS | set(ASKED_BY)
    assert all(set(names) <= set(CHECKED) for names in ASKED_BY.values())


@pytest.mark.parametrize("category", CATEGORIES)
@pytest.mark.parametrize("radii", [POINT, BOX], ids=["a state", "a monitor's box"])
def test_no_stop_contradicts_a_number(category: Category, radii: tuple[np.ndarray, np.ndarray]) -> None:
    for q, dq in states():
        for bounds in (BOUNDS, WATCHED, BRAKED) if category == "1 guaranteed" else (WORKING,):
            bound = bounds.bound(q, dq, category, *radii)
            assert bound.certified, bound.why
            for x in stops_of(bounds, bound, q, dq, radii):
                assert beyond(bounds, bound, x) == set()


ARMS = (
    "random arm of 2 joints, 0",
    "random arm of 4 joints, 0",
    "random arm of 7 joints, 1",
    "UR10e-like",
    "cobot of seven joints",
)


@pytest.mark.parametrize("kind", ["time", "deceleration"])
@pytest.mark.parametrize("name", ARMS)
def test_no_stop_of_other_arms_contradicts_a_number(name: str, kind: str) -> None:
    """Every category from the corners of a monitor's box, half the rated payload off the flange, joints with delays of their own."""
    (model, top), rng = arms()[name], np.random.default_rng(ARMS.index(name))
    n, rated = model.n, model.domain.payload[1]
    value = (0.28, 0.32) if kind == "time" else (2.5, 3.2)
    ramp = replace(
        Ramp.stated(n, time=0.3), kind=kind, value=Box.of(*np.tile(value, (n, 1)).T), control=Box.of(np.full(n, 0.01), rng.uniform(0.015, 0.05, n)),
        q_error=np.full(n, 2e-3), dq_error=np.full(n, 0.04), settle=0.1, pace=(-0.6, 0.6), off_after=0.1,
    )  # fmt: skip
    bounds = StopBounds.of(model, (0.4 * rated, 0.6 * rated), model.robot.tip + rng.uniform(-0.1, 0.1, 3), ramp=ramp, fast=True)
    watched, working = (replace(bounds, ramp=replace(ramp, monitored=m, off_after=None)) for m in (True, False))
    radii, told = (np.full(n, 0.01), np.full(n, 0.05)), 0
    for category, b in (("0", bounds), ("1", working), ("2", bounds), ("1 guaranteed", bounds), ("1 guaranteed", watched)):
        q, dq = rng.uniform(-2.5, 2.5, n), 0.5 * rng.uniform(-1.0, 1.0, n) * top * (rng.random(n) < 0.8)
        bound = b.bound(q, dq, category, *radii)
        if bound.certified:
            told += 1
            for x in stops_of(b, bound, q, dq, radii):
                assert beyond(b, bound, x) == set()
    assert told >= 3


@pytest.mark.parametrize("category", CATEGORIES)
def test_each_number_made_too_small_is_contradicted(category: Category) -> None:
    found = set()
    for q, dq in states():
        bounds = BOUNDS if category == "1 guaranteed" else WORKING
        bound = bounds.bound(q, dq, category)
        stops = stops_of(bounds, bound, q, dq)
        for name in CHECKED:
            if name in found or (name == "fallback" and bound.fallback is None):
                continue
            weak = weakened(bound, name)
            found |= {name for x in stops[: STOPS // 2] if name in beyond(bounds, weak, x)}
    assert found == set(CHECKED) - (set() if category == "2" else {"fallback"})


@pytest.mark.parametrize("kind", ["time", "deceleration"])
def test_a_motion_that_gets_faster_is_fastest_when_its_ramp_begins(kind: str) -> None:
    """That moment lies between the steps of a grid: at 24 ms, the rest of the ramp being some hundred."""
    about = {"time": Ramp.stated(N, time=0.5, control=0.05), "deceleration": Ramp.stated(N, deceleration=3.0, control=0.05)}[kind]
    bounds = replace(BOUNDS, ramp=replace(about, pace=(-2.0, 2.0)))
    q, dq = np.array([0.3, 0.6, -0.8, 0.2, 0.4, 0.0]), np.full(N, 1.1)
    bound = bounds.bound(q, dq, "1")
    assert bound.certified, bound.why
    speed = (dq + bounds.setting.noise.radius[N:]) * (1.0 + 2.0 * 0.05)
    assert np.all(speed <= bound.speed + 1e-12)
    assert np.all(bound.speed < 1.01 * speed)


def test_no_stop_along_a_path_contradicts_a_number() -> None:
    pytest.importorskip("toppra")
    from stopset.reach.stops.path import Path, path_stop

    points = np.array([[0.0, 0.3, 0.4, 0.0, 0.5, 0.0], [0.5, 0.6, 0.1, 0.2, 0.3, 0.2], [1.0, 0.5, -0.4, 0.5, 0.2, 0.6]])
    path, rng = Path.through(points), np.random.default_rng(4)
    bounds = replace(BOUNDS, ramp=replace(RAMP, pace=(0.0, 0.0)))
    stop = path_stop(bounds, path, 0.2, 1.2)
    assert stop.bound.certified
    s = 0.2 + np.linspace(0.0, 1.0, 400) ** 0.5 * stop.length  # denser where it is slow; time is of no matter here
    for _ in range(STOPS):
        start = bounds.setting.noise.radius[:N] * rng.choice([-1.0, 1.0], N)
        t, off, ring = ramp_motion(bounds.ramp, np.zeros(N), rng)
        at = np.minimum(np.arange(400) * len(t) // 400, len(t) - 1)
        # the whole rate until the last pose: faster than the stop itself is anywhere
        q, v = path.p(s, 0) + start + off[at], 1.2 * path.p(s, 1) * (s < s[-1])[:, None] + ring[at]
        x = Stopped(t[at], q, v, np.full(N, stop.time), np.full(N, np.inf))
        assert beyond(bounds, stop.bound, x, NOT_ALONG_A_PATH) == set()
