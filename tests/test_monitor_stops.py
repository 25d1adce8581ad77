"""The monitor's stop bounds hold for every state of the box they are given for, also those that brake worst."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stop_sampling import sample_stops
from stop_tubes import tube_of
from stopset.artifact import save_model
from stopset.monitor.config import Stops
from stopset.monitor.sample import Quantum
from stopset.monitor.stopdesk import StopDesk
from stopset.monitor.stopworker import answer_for
from stopset.reach.stops import Ramp, StopBounds
from stopset.reach.stops.start import Start
from stopset.reach.stops.tubes import FAST_ENERGY_KNOTS, march_box
from stopset.sets import Box

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like, ur5_like
from stop_arms_wide import ur10e_like

SEEN = Box.symmetric(np.repeat([3.0, 2.0], 6))
Q = np.array([0.1, 0.5, 0.3, -0.4, 0.2, 0.1])
DQ = np.array([1.0, 0.8, -0.7, 0.3, 0.5, -1.0])
BOX = np.full(6, 0.02), np.full(6, 0.08)


@pytest.fixture(scope="module")
def prepared() -> StopBounds:
    return StopBounds.of(prbt_like(), (0.0, 0.25), ramp=Ramp.stated(6, time=0.3).failing(off_after=0.1), fast=True)


def test_an_answer_holds_for_every_state_of_its_box(prepared: StopBounds) -> None:
    s = prepared.setting
    assert s is not None
    x, r = np.concatenate([Q, DQ]), np.concatenate(BOX)
    assert prepared.ramp is not None
    works = replace(prepared, ramp=replace(prepared.ramp, off_after=None))  # power stays on until it has stopped the arm
    asked = {"0": prepared, "1": works, "1 guaranteed": prepared, "2": prepared}
    reported = {c: answer_for(b, c, x - r, x + r).numbers for c, b in asked.items()}
    assert "power is taken 0.1 s after" in answer_for(prepared, "1", x - r, x + r).numbers.why
    assert all(x.provable.all() for x in reported.values())
    narrow = prepared.bound(Q, DQ, "0")
    assert narrow.forward is not None and narrow.time is not None
    longer = 0
    rng = np.random.default_rng(5)
    for k in range(12):
        q, dq = Q + BOX[0] * rng.choice([-1.0, 1.0], 6), DQ + BOX[1] * (np.sign(DQ) if k % 2 else rng.uniform(-1, 1, 6))
        r, v = s.noise.radius[:6], s.noise.radius[6:]
        x = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube_of(s, q, dq, r, v), 60, k)
        assert np.all(x.forward <= reported["0"].forward + 2e-6) and np.all(x.back <= reported["0"].back + 2e-6)
        assert np.all(x.time <= reported["0"].time + 5e-4) and x.tcp <= reported["0"].tcp
        longer += bool(np.any(x.forward > narrow.forward + 1e-3))
        for category in ("1", "1 guaranteed", "2"):
            # bounds of a state of the box lie in those of the box, to within the steps of time they are made with
            alone = asked[category].bound(q, dq, category)
            assert alone.forward is not None and alone.back is not None
            assert np.all(alone.forward <= reported[category].forward + 2e-3) and np.all(
                alone.back <= reported[category].back + 2e-3
            )
    assert longer > 0, "the box asks for more than its middle: a bound of the middle alone would have been exceeded"


def test_a_range_of_payloads_on_a_light_arm_is_bounded_by_its_parts_for_every_mass_of_it() -> None:
    """With the whole range at once the kinetic energy bounds the heaviest and the lightest arm together, several times too far."""
    prepared, state = StopBounds.of(ur10e_like(), fast=True), np.concatenate([Q, 0.5 * DQ])
    lo, hi = state - 0.01, state + 0.01
    said, whole = (answer_for(p, "0", lo, hi).numbers for p in (prepared, replace(prepared, parts=())))
    assert said.proven and said.tcp < 0.8 * whole.tcp, "the parts say more than the whole"
    rng = np.random.default_rng(3)
    for k, mass in enumerate(np.linspace(*ur10e_like().domain.payload, 7)):
        s = StopBounds.of(ur10e_like(), (mass, mass), fast=True).setting
        assert s is not None
        q, dq = np.split(state + rng.choice([-0.01, 0.01], 12), 2)
        r, v = s.noise.radius[:6], s.noise.radius[6:]
        found = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube_of(s, q, dq, r, v), 60, k)
        assert np.all(found.forward <= said.forward + 2e-6) and np.all(found.back <= said.back + 2e-6)
        assert np.all(found.time <= said.time + 5e-4) and found.tcp <= said.tcp
    heavier, lighter = (answer_for(replace(prepared, setting=p, parts=()), "0", lo, hi).numbers for p in prepared.parts)
    assert min(heavier.tcp, lighter.tcp) < max(heavier.tcp, lighter.tcp) == said.tcp, "one part alone would promise too much"
    assert np.all(said.forward == np.maximum(heavier.forward, lighter.forward)) and np.all(
        said.time == np.maximum(heavier.time, lighter.time)
    )
    (a, b), (c, d) = (
        (x.plant.pi[-1, 0] - x.plant.pi_half[-1, 0], x.plant.pi[-1, 0] + x.plant.pi_half[-1, 0]) for x in prepared.parts
    )
    assert c <= 0.615 and b >= 0.615 + 12.5 and a <= d, "no mass outside, none between them"
    assert not StopBounds.of(ur10e_like(), (2.0, 2.0), fast=True).parts


def test_strong_coupling_costs_the_worker_little_and_the_loop_nothing(tmp_path: Path) -> None:
    strong = StopBounds.of(ur5_like(), (5.0, 5.0), fast=True)
    thorough = StopBounds.of(ur5_like(), (5.0, 5.0))
    rng, spent, layers = np.random.default_rng(77), {True: [], False: []}, []
    for _ in range(8):
        q, dq = rng.uniform(-2.3, 2.3, 6), rng.uniform(-2.3, 2.3, 6)
        for prepared in (strong, thorough):
            begin = time.process_time()
            bound = prepared.bound(q, dq, "0", *BOX)
            spent[prepared.fast].append(time.process_time() - begin)
            assert bound.certified
        layers.append(bound.layer)
    s = strong.setting
    assert s is not None
    r, v = s.noise.radius[:6], s.noise.radius[6:]
    coarse = march_box(s, s.plant, Start(q, dq, r, v), energetic=True, knots=FAST_ENERGY_KNOTS)
    assert sample_stops(s.plant, q, dq, r, v, s.payload_com, coarse, 60, 3).escaped == 0
    assert layers.count("energy") >= 4, "these states need the kinetic energy"
    assert np.median(spent[True]) < 0.5 * np.median(spent[False])
    save_model(ur5_like(), tmp_path / "m.model.json")
    desk = StopDesk(str(tmp_path / "m.model.json"), SEEN, Stops(("0",)), None, Quantum.none(6))
    try:
        until, busy, reported = time.monotonic() + 60.0, [], 0
        while reported < 20 and time.monotonic() < until:
            begin = time.thread_time()
            desk.offer(time.monotonic(), Q, 0.5 * DQ)
            reported += desk.now(Q, 0.5 * DQ)[1]
            busy.append(time.thread_time() - begin)
            time.sleep(0.004)
        assert reported == 20, "the worker has answered"
        assert np.quantile(busy, 0.99) < 1e-3, "and the loop never computed a bound itself"
    finally:
        desk.close()


def test_a_payload_the_model_does_not_cover_has_no_bound_and_one_sentence(tmp_path: Path) -> None:
    save_model(prbt_like((0.0, 0.25)), tmp_path / "m.model.json")
    desk = StopDesk(str(tmp_path / "m.model.json"), SEEN, Stops(("0",)), (3.0, 3.0), Quantum.none(6))
    try:
        until, numbers, fresh = time.monotonic() + 60.0, {}, False
        while not fresh and time.monotonic() < until:
            desk.offer(time.monotonic(), Q, 0.0 * DQ)
            numbers, fresh = desk.now(Q, 0.0 * DQ)
            time.sleep(0.004)
        assert fresh and not numbers["0"].provable.any() and np.all(np.isinf(numbers["0"].time))
        assert "a payload of 3 kg lies outside the model's domain" in numbers["0"].why and desk.restarts == 0
    finally:
        desk.close()
