"""Numbers of arms with effects in every category; the whole run, all effects and more stops, is benchmarks/stops_effects_published.py."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.reach.stops import StopBounds
from stopset.reach.stops.path import Path as Programmed
from stopset.reach.stops.path import path_stop
from stopset.robot.rigid import link_frames
from stopset.types import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like
from stops_attack import an_arm, attacked, case_of
from stops_attack_paths import one as attacked_path
from stops_effects import Laws, cases, drawn, hiding, misread_by
from stops_effects_published import Asked, held, ramps, run

CASES = cases(prbt_like().joints)
SEEN = (
    "load_coulomb",
    "hysteresis",
    "counterbalance",
    "self_heating",
    "encoder_offset",
    "spring + coupling + thermal_coulomb + hysteresis",
)
BLIND = ("counterbalance", "encoder_offset", "spring")


@pytest.mark.parametrize("name", SEEN)
def test_no_stop_of_an_arm_with_effects_contradicts_a_number(name: str) -> None:
    """STOP 0, 1, 1 guaranteed (by time, monitored, with drives that accelerate) and 2, of states and of a monitor's boxes."""
    bounded, stops, wrong = run(CASES[name], 14, 3, 11)
    assert bounded >= 12 and stops == 3 * bounded
    assert wrong == []


def test_friction_harder_one_way_than_a_joint_has_friction_drives_it_in_no_direction() -> None:
    """Neither the bound's (Lemma 2) nor that of the arms it is held against."""
    skewed = replace(CASES["asymmetric_coulomb"][0], values={"F_o": -60.0})
    bounded, _, wrong = run((skewed,), 7, 3, 11)
    assert bounded == 7 and wrong == []


@pytest.mark.parametrize("name", BLIND)
def test_numbers_that_do_not_know_an_effect_are_contradicted(name: str) -> None:
    """Of ramps that fail and in other categories than STOP 0, too."""
    _, _, wrong = run(CASES[name], 7, 4, 5, blind=True)
    assert {line.split(",")[0] for line in wrong} - {"STOP 0"}


def tool_at(bounds: StopBounds, q: Array) -> Array:
    """(N, 3) [m]."""
    R, o = link_frames(bounds.model.robot.chain, q)
    return np.asarray(o[:, -1] + R[:, -1] @ bounds.setting.payload_com)  # type: ignore[union-attr]


@pytest.mark.parametrize("name", [*SEEN, "encoder_eccentricity", "base_tilt"])
def test_along_a_path_the_arm_is_held_and_goes_no_farther_than_told(name: str) -> None:
    """1,440 true poses of arms that are led along a path as they read it: margins, the tool's way and its box."""
    model, rng, poses = hiding(CASES[name]), np.random.default_rng(3), 0
    n = model.n
    ramp = replace(ramps(n)["SS1-t"], off_after=None)  # power stays on until the arm rests
    bounds = StopBounds.of(model, (0.0, 1.0), ramp=ramp)
    assert bounds.setting is not None
    for _ in range(5):
        path = Programmed.through(np.cumsum(np.vstack([rng.uniform(-0.9, 0.9, n), rng.uniform(-0.4, 0.4, (3, n))]), axis=0))
        stop = path_stop(bounds, path, 0.1, rng.uniform(0.5, 1.2))
        b = stop.bound
        assert b.certified, b.why
        s = np.linspace(0.1, 0.1 + stop.length, 8)
        read = np.repeat(path.p(s, 0), 36, axis=0)
        batch = drawn(model, read, np.zeros_like(read), bounds.setting.payload_com, rng)
        off, _ = misread_by(model, read, rng)
        true = batch.q + off + ramp.q_error * rng.choice([-1.0, 1.0], read.shape)
        least = held(model, Asked(bounds, b, batch, rng), Laws(model, batch, rng), true)
        assert np.all(least >= b.holding_margin - 1e-6)
        led = path.p(s, 0) + off[::36]
        moved = tool_at(bounds, led) - tool_at(bounds, led[:1])
        assert np.all(np.linalg.norm(moved, axis=1) <= b.tcp + 1e-6)
        assert np.all(moved >= b.tcp_box[:, 0] - 1e-6) and np.all(moved <= b.tcp_box[:, 1] + 1e-6)
        poses += len(true)
    assert poses == 1440


def test_stops_bred_towards_a_bound_along_a_path_stay_within_it() -> None:
    """A part of benchmarks/stops_attack_paths.py: a recorded path, an arm with an eccentric code disc, drives hardly strong enough."""
    asked = argparse.Namespace(seed=6, effect=[], rounds=2, count=6)
    name, found = attacked_path(50, asked)
    assert "encoder_eccentricity" in name and "recorded" in name
    assert found is not None and found.stops == 12 and found.nearest > 0.9 and found.wrong == ()


def test_stops_bred_towards_a_bound_stay_within_it_whatever_readings_and_drives() -> None:
    """A part of benchmarks/stops_attack.py: STOP 2 of arms with sets of recorded stops, drives hardly strong enough."""
    rng = np.random.default_rng([12, 0])
    name, model = an_arm(rng, ["counterbalance"])
    case = case_of(model, name, "2", rng)
    while "readings" not in case.name or "hardly" not in case.name:
        name, model = an_arm(rng, ["counterbalance"])
        case = case_of(model, name, "2", rng)
    found = attacked(case, 2, 6, rng)
    assert found is not None and found.stops == 12 and found.nearest > 0.9 and found.wrong == ()
