"""Numbers of arms with effects in every category; the whole run, all effects and more stops, is benchmarks/stops_effects_published.py."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like
from stops_effects import cases
from stops_effects_published import run

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


@pytest.mark.parametrize("name", BLIND)
def test_numbers_that_do_not_know_an_effect_are_contradicted(name: str) -> None:
    """Of ramps that fail and in other categories than STOP 0, too."""
    _, _, wrong = run(CASES[name], 21, 4, 5, blind=True)
    assert {line.split(",")[0] for line in wrong} - {"STOP 0"}
