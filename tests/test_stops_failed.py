"""STOP 1 guaranteed: however the ramp fails until power is taken, the arm stays inside, in angle, time, speed and space."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from stop_failing import sample_failed_ramps
from stopset.reach.stops import Ramp, StopBounds
from stopset.reach.stops.compiled import CompiledStops
from stopset.reach.stops.failed import FAST_SLICES, SLICES, Cover, StatesAtCut, cover, failed_cells
from stopset.reach.stops.path import Path as ArmPath
from stopset.reach.stops.path import path_stop
from stopset.reach.stops.tube import OK
from stopset.simulation.stop import StoppingArm, simulate_stop

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like

RAMPS = {
    "SS1-t": Ramp.stated(6, time=0.3).failing(off_after=0.15),
    "SS1-t, drives accelerate": Ramp.stated(6, time=0.3).failing(off_after=0.1, share=1.3),
    "SS1-r": Ramp.stated(6, time=0.3).failing(monitored=True),
    "SS1-r, deceleration, drives accelerate": Ramp.stated(6, deceleration=5.0).failing(monitored=True, share=1.2),
    "SS1-t, together": Ramp.stated(6, time=0.3).failing(off_after=0.3, together=True),
}


@pytest.mark.parametrize("fast", [False, True])
@pytest.mark.parametrize("name", RAMPS)
def test_failures_of_every_joint_on_its_own_stay_inside(name: str, fast: bool) -> None:
    bounds, rng = StopBounds.of(prbt_like(), (0.0, 0.25), ramp=RAMPS[name], fast=fast), np.random.default_rng(9)
    for k in range(3):
        q, dq = rng.uniform(-2.3, 2.3, 6), rng.uniform(-1.26, 1.26, 6)
        bound = bounds.bound(q, dq, "1 guaranteed")
        assert bound.certified
        found = sample_failed_ramps(bounds, bound, q, dq, 25, k)
        assert found.escaped == 0
        assert np.median(bound.angle / found.angle) < 3.0  # and it is not loose beyond use


@pytest.mark.parametrize(
    "weaker",
    [
        {"off_after": 0.05},  # power taken sooner than it is
        {"share": 0.5},  # failed drives slower than they are
        {"together": True},  # all joints alike
    ],
)
def test_bounds_of_milder_failures_are_escaped(weaker: dict) -> None:  # type: ignore[type-arg]
    ramp = Ramp.stated(6, time=0.3).failing(off_after=0.4)
    bounds = StopBounds.of(prbt_like(), (0.0, 0.25), ramp=ramp, pieces=8)
    # folded, and power taken late: which joint goes on alone matters
    q, dq = np.array([0.41, -0.69, -1.38, -1.45, 0.94, 1.24]), np.full(6, 1.2)
    mild = replace(bounds, ramp=replace(ramp, **weaker)).bound(q, dq, "1 guaranteed")
    assert mild.certified
    assert sample_failed_ramps(bounds, mild, q, dq, 200, 2).escaped > 0


@pytest.mark.parametrize("fast", [False, True])
@pytest.mark.parametrize("monitored", [False, True])
def test_a_failed_ramp_goes_on_with_a_motion_that_gets_faster(monitored: bool, fast: bool) -> None:
    """300 failures of motions that gain half of their speed in a second; and a ramp that works is one of those that fail."""
    ramp = replace(Ramp.stated(6, time=0.3, control=0.1), pace=(-0.5, 0.5)).failing(
        None if monitored else 0.45, monitored=monitored
    )
    bounds, rng = StopBounds.of(prbt_like(), (0.0, 0.25), ramp=ramp, fast=fast), np.random.default_rng(9)
    core = CompiledStops.of(bounds.setting, ramp)
    for k in range(3):
        q, dq = rng.uniform(-2.0, 2.0, 6), rng.uniform(0.3, 0.9, 6) * rng.choice([-1.0, 1.0], 6)
        failed, works = bounds.bound(q, dq, "1 guaranteed"), bounds.bound(q, dq, "1")
        assert failed.certified and works.certified
        assert sample_failed_ramps(bounds, failed, q, dq, 50, k).escaped == 0
        assert np.all(works.angle <= failed.angle) and np.all(works.speed <= failed.speed + 1e-9)
        if fast:
            compiled = core.bound(q, dq, "1 guaranteed")
            assert (
                compiled is not None
                and np.allclose(compiled.speed, failed.speed)
                and np.allclose(compiled.forward, failed.forward)
            )


@pytest.mark.parametrize("slices", [SLICES, FAST_SLICES])
def test_monitored_ramps_allow_what_the_monitor_allows(slices: int) -> None:
    """Every cell's travel and speed against the integral of the monitored line, to the last of the cells."""
    ramp, dq = Ramp.stated(6, time=0.4, control=0.02).failing(monitored=True), np.full(6, 1.0)
    cells = failed_cells(ramp, dq, slices)
    for left in np.linspace(0.0, 0.42, 200):
        t = np.linspace(0.0, left, 2001)
        line = 1.0 - np.clip((t - 0.02) / 0.4, 0.0, 1.0) + ramp.tolerance
        line = np.minimum(line, 1.0)
        travel = np.trapezoid(line, t) + ramp.reaction * line[-1]
        inside = [
            c for c in cells
            if c.travel[0, 1] >= travel - 1e-6 and c.share[0, 1] >= line[-1] - 1e-9 and c.time >= left + ramp.reaction - 1e-9
        ]  # fmt: skip
        assert inside


def test_in_a_loop_joint_speeds_bound_a_monitored_ramp_where_they_come_to_rest() -> None:
    """In four boxes; where one does not, as in a box of many speeds, the energy bounds all eight, and says so."""
    bounds = StopBounds.of(prbt_like(), (0.0, 0.25), ramp=RAMPS["SS1-r"], fast=True)
    q, dq = np.array([0.3, -0.4, 0.9, 0.2, 1.1, 0.0]), np.array([0.6, -0.4, 0.5, 0.0, 0.3, -0.6])
    near, far = (bounds.bound(q, dq, "1 guaranteed", np.full(6, 1e-3), np.full(6, more)) for more in (1e-3, 1.3))
    assert near.certified and near.layer != "energy" and not near.why
    assert far.certified and far.layer == "energy" and far.why.startswith("fall-back: 8 of 8 boxes")
    assert sample_failed_ramps(bounds, near, q, dq, 25, 7).escaped == 0


@pytest.mark.parametrize("slices", [SLICES, FAST_SLICES])
@pytest.mark.parametrize(("share", "left"), [(1.0, 1.0), (1.2, 0.0)])
def test_no_cell_lies_in_another(share: float, left: float, slices: int) -> None:
    """What is left of the line's slices: their first box lies in the second, and with drives that may accelerate all do in the last."""
    cells = failed_cells(Ramp.stated(6, time=0.4).failing(monitored=True, share=share), np.full(6, 1.0), slices)
    assert len(cells) == max(left * slices, 1)
    for a in cells:
        assert not any(
            np.all(a.travel <= b.travel) and np.all(a.share <= b.share) and a.time <= b.time for b in cells if b is not a
        )  # fmt: skip


@pytest.mark.parametrize("together", [True, False])
def test_cut_cells_cover_the_cell(together: bool) -> None:
    rng, dq = np.random.default_rng(2), np.array([1.0, 0.5, 0.0])
    whole = StatesAtCut(np.tile([0.0, 0.3], (3, 1)), np.tile([0.0, 1.0], (3, 1)), 0.3)
    parts = [whole]
    for _ in range(5):
        parts = [x for p in parts for x in p.halves(dq, together=together)]
    for _ in range(300):
        a, s = (np.full(3, rng.random()), np.full(3, rng.random())) if together else (rng.random(3), rng.random(3))
        a = 0.3 * a
        assert any(
            np.all((p.travel[:, 0] <= a) & (a <= p.travel[:, 1]) & (p.share[:, 0] <= s) & (s <= p.share[:, 1])) for p in parts
        )  # fmt: skip


class Fake(NamedTuple):
    """A tube that ends as it is told."""

    end: int


def covered(closes: Callable[[StatesAtCut, bool], bool], budget: int) -> tuple[Cover, list[tuple[StatesAtCut, bool]]]:
    """A cover in which ``closes(cell, energetic)`` says which tubes come to rest, and all that was tried."""
    dq, tried = np.array([1.0, 0.5, 0.0]), []
    whole = StatesAtCut(np.tile([0.0, 0.3], (3, 1)), np.tile([0.0, 1.0], (3, 1)), 0.3)

    def march(cell: StatesAtCut, plant: object, *, energetic: bool) -> Fake:
        tried.append((cell, energetic))
        return Fake(OK if closes(cell, energetic) else 2)

    found = cover(
        [whole],
        object(),
        lambda c, p: [(x, p) for x in c.halves(dq, together=False)],
        march,
        lambda c: c.width(dq),
        (budget, budget),
    )  # type: ignore[arg-type]
    return found, tried


def test_a_cell_that_cannot_be_bounded_says_so() -> None:
    found, tried = covered(lambda cell, energetic: False, 9)
    assert found.parts[-1].tube.end == 2 and sum(not energetic for _, energetic in tried) <= 9


@pytest.mark.parametrize("budget", [1, 2, 7, 8, 40])
@pytest.mark.parametrize("loose", [True, False])
def test_the_budget_is_kept_and_the_boxes_still_cover_everything(budget: int, loose: bool) -> None:
    """Narrow boxes close, or only small ones do and for wide ones not even the energy: points of the whole box lie in the parts."""
    found, tried = covered(
        lambda c, energetic: (energetic and (loose or c.width(np.ones(3)) > 0.9)) or c.width(np.ones(3)) < 0.4, budget
    )
    assert all(p.tube.end == OK for p in found.parts)
    assert sum(not energetic for _, energetic in tried) <= budget and len(tried) <= 2 * budget + 2
    rng = np.random.default_rng(1)
    for _ in range(300):
        a, s = 0.3 * rng.random(3), rng.random(3)
        assert any(
            np.all((p.travel[:, 0] <= a) & (a <= p.travel[:, 1]) & (p.share[:, 0] <= s) & (s <= p.share[:, 1]))
            for p in (x.cell for x in found.parts)
        )
    assert (found.tried <= budget and found.loose == sum(energetic for _, energetic in tried)) or not loose


def test_beyond_the_budget_the_kinetic_energy_bounds_it_and_the_bound_says_so() -> None:
    model = prbt_like((0.0, 3.0))
    bounds = StopBounds.of(model, (2.94, 3.0), ramp=Ramp.stated(6, time=0.5).failing(off_after=0.9))
    q, dq = np.array([0.1, 0.9, 0.9, 0.2, 1.2, 0.0]), np.array([1.2, -1.2, 1.2, 0.0, 0.0, 0.0])
    begin = time.process_time()
    bound = bounds.bound(q, dq, "1 guaranteed")
    assert time.process_time() - begin < 5.0  # minutes and gigabytes, once
    assert bound.certified and bound.layer == "energy" and "tubes of joint speeds that there is a budget for" in bound.why
    found = sample_failed_ramps(bounds, bound, q, dq, 25, 4)
    assert found.escaped == 0


def test_without_a_time_for_power_off_there_is_no_number() -> None:
    bound = StopBounds.of(prbt_like(), (0.0, 0.25), ramp=Ramp.stated(6, time=0.3)).bound(np.zeros(6), np.ones(6), "1 guaranteed")
    assert not bound.certified and bound.time is None and "--off-after" in bound.why


def test_a_ramp_that_power_is_taken_from_is_no_stop_by_the_ramp() -> None:
    """SS1-t before the arm is at rest: brakes that have yet to close stop it, farther than the ramp would have."""
    model, rng, off = prbt_like((0.0, 3.0)), np.random.default_rng(0), 0.05
    whole = StopBounds.of(model, (3.0, 3.0), ramp=Ramp.stated(6, time=0.15), fast=True)
    cut = replace(whole, ramp=whole.ramp.failing(off))
    p, left = whole.setting.plant, 0
    late = (p.rotor, p.coulomb_lo, p.viscous_lo, p.brake_lo, p.delay_hi, p.rise_hi)
    for k in range(60):
        q, dq = rng.uniform(-2.0, 2.0, 6), rng.uniform(-1.2, 1.2, 6)
        ramp = whole.bound(q, dq, "1")
        begun = dq * (off - off * off / 0.3)
        qs, _ = simulate_stop(
            StoppingArm(p.chain, p.pi + p.pi_half, *late), q + begun, dq * (1.0 - off / 0.15), 5e-4, 600, np.zeros((1, 6))
        )
        ahead, behind = (qs - q).max(axis=0), -(qs - q).min(axis=0)
        escapes = bool(np.any(ahead > ramp.forward + 1e-4) or np.any(behind > ramp.back + 1e-4))
        left += escapes
        if k < 3 or escapes:
            told, caught = cut.bound(q, dq, "1"), cut.bound(q, dq, "1 guaranteed")
            assert ramp.certified and caught.certified and cut.bound(q, dq, "2").certified
            assert told.time is None and "power is taken 0.05 s after the request" in told.why
            assert CompiledStops.of(cut.setting, cut.ramp).bound(q, dq, "1") is None
            assert np.all(ahead <= caught.forward + 1e-5) and np.all(behind <= caught.back + 1e-5)
    assert left > 0  # or the refusal is for nothing
    at_rest = replace(whole, ramp=whole.ramp.failing(0.15 + 0.024))
    assert at_rest.bound(q, dq, "1").certified
    way = ArmPath.through(np.array([q, q + 0.2]))
    assert path_stop(whole, way, 0.0, 0.5).bound.time is not None
    sooner = replace(whole, ramp=whole.ramp.failing(0.02))
    assert "power is taken 0.02 s after" in path_stop(sooner, way, 0.0, 0.5).bound.why
