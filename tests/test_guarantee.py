"""The words of the guarantee: true for two motions and for three hundred, never rounded to the pleasant side."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import Guarantee
from stopset.offline.conform import guarantee as g
from stopset.offline.identify.pipeline import Settings, identify
from synthetic import arm, names, recordings, save_trials

SCOPE = "in position and velocity up to 5.00 s ahead of every sample"


def said(held: int, violated: int, motions: int, how: str = g.OTHER_MOTIONS, scenario: float | None = None) -> str:
    bound = g.clopper_pearson(violated, held)
    return g.words(
        Guarantee(held, violated, bound, g.CONFIDENCE, "", motions - held, scenario), 10 * motions, motions, 1.27, how, SCOPE
    )


def test_two_motions_promise_nothing_and_say_what_the_margin_rests_on() -> None:
    text = said(0, 0, 2, g.REPETITIONS)
    assert "All 20 recorded trials of 2 independent motions are enclosed in position and velocity" in text
    assert "calibrated on repetitions of the same motions only" in text
    assert "nothing statistical is promised" in text and "%" not in text


@pytest.mark.parametrize("held", [1, 2, 38, 75, 299])
def test_the_printed_probability_is_never_less_than_the_bound(held: int) -> None:
    """Rounding to the nearest would print 7.5 % for a bound of 7.58 %."""
    for violated in range(min(held, 6) + 1):
        text = said(held, violated, 4 * held, scenario=0.12345)
        bound = g.clopper_pearson(violated, held)
        if violated == held:
            assert "nothing statistical can be promised" in text and "%" not in text
            continue
        printed = [float(x) / 100 for x in re.findall(r"([\d.]+)%", text)]
        assert printed[0] == g.CONFIDENCE
        assert bound <= printed[1] <= bound + 0.001 and printed[2] == pytest.approx(0.124)
        assert f"Of {held} held-out motion{'s' if held > 1 else ''} {violated} left the sets" in text


def test_a_margin_that_was_given_is_not_called_calibrated() -> None:
    for motions, held in ((2, 0), (300, 75)):
        text = said(held, 0, motions, g.GIVEN)
        assert "margin up to 1.27, as given" in text and "calibrat" not in text


def test_one_recording_is_spoken_of_as_one() -> None:
    text = g.words(Guarantee(0, 0, 1.0, g.CONFIDENCE, "", 1, None), 1, 1, 1.98, g.SAME_MOTION, SCOPE)
    assert text.startswith(f"The one recorded trial is enclosed {SCOPE}") and "With only 1 independent motion none" in text


def test_three_hundred_motions_from_recordings_to_the_sentence(tmp_path: Path) -> None:
    path = save_trials(tmp_path / "r.parquet", recordings((1.0, 0.5), (4.0, 2.0), suites=300, trials=1, seconds=0.4), names(2))
    found = identify(arm(names(2)), [path], Settings(horizon=0.2))
    promise, text = found.model.guarantee, found.model.guarantee.text
    assert "All 300 recorded trials of 300 independent motions are enclosed" in text
    assert f"Of 75 held-out motions {promise.violated} left the sets with this margin" in text
    assert g.OTHER_MOTIONS in text and "scenario bound" in text
    assert promise.calibration_motions == 225 and promise.scenario_bound is not None
    # 75 motions cannot promise less than 3.9 %, whatever they do
    assert promise.upper_bound >= 1 - 0.05 ** (1 / 75) - 1e-12
    assert not found.conformance.influence, "one line per motion is no summary of 225"


def test_the_sentence_is_true_for_motions_never_seen() -> None:
    """Fifty campaigns of forty motions whose disturbance has heavy tails: the bound is broken in fewer than one of ten.

    One in twenty is what 95 % confidence allows.
    """
    rng = np.random.default_rng(4)
    broken = 0
    for _ in range(50):
        size = rng.lognormal(0.0, 0.6, 40)
        held = size[3::4]
        sets = np.delete(size, np.arange(3, 40, 4)).max()
        true = 1.0 - _below(sets)
        broken += true > g.clopper_pearson(int((held > sets).sum()), len(held))
    assert broken <= 5


def _below(x: float) -> float:
    from scipy.stats import lognorm

    return float(lognorm.cdf(x, 0.6))
