"""What a velocity reading may be wrong by comes from the readings; an error of the model has no room in it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from stopset.offline.campaign.noise import TELLING, NoiseEstimate
from stopset.offline.campaign.reading_error import SMOOTH, reading_residual
from stopset.offline.identify.pipeline import identify
from stopset.recording import Recording
from synthetic import arm, lag, names, recordings, save_trials

DT = 0.004
T = DT * np.arange(1501)
RNG = np.random.default_rng(5)


def swing(f: float = 0.4, size: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
    """Angle and speed of a smooth motion."""
    w = 2 * np.pi * f
    return size * np.sin(w * T), size * w * np.cos(w * T)


def error(q: np.ndarray, dq: np.ndarray) -> tuple[float, float, float]:
    """Least and most error of a speed, and how late it is."""
    e = NoiseEstimate()
    e.add(Recording("open_loop", 0, 0, 0, DT * np.arange(len(q)), q[:, None], dq[:, None], np.zeros((len(q), 1))), DT)
    bounds = e.error()
    return float(bounds.least.hi[1]), float(bounds.most.hi[1]), float(e.late()[0])


def test_a_smooth_speed_is_read_to_within_its_noise() -> None:
    q, dq = swing()
    least, most, late = error(q + 2e-5 * RNG.normal(size=len(q)), dq + 1e-3 * RNG.normal(size=len(q)))
    assert 3e-3 < least < 5e-3
    assert least <= most < 8e-3
    assert abs(late) < 1e-3


def test_a_late_speed_is_wrong_by_its_lag_times_the_acceleration() -> None:
    q, dq = swing()
    tau = 0.03
    slow = np.array(dq)
    for k in range(1, len(dq)):
        slow[k] = slow[k - 1] + DT / tau * (dq[k - 1] - slow[k - 1])
    _, most, late = error(q, slow)
    a_max = 0.6 * (2 * np.pi * 0.4) ** 2
    assert late == pytest.approx(tau, rel=0.15)
    assert most >= 0.95 * tau * a_max


@pytest.mark.parametrize("hertz", [15.0, 19.0, 25.0])
def test_a_vibration_that_a_rigid_arm_cannot_follow_is_part_of_the_error(hertz: float) -> None:
    q, dq = swing()
    w = 2 * np.pi * hertz
    least, most, _ = error(q + 0.05 / w * np.sin(w * T), dq + 0.05 * np.cos(w * T))
    assert least < 0.04
    assert 0.045 < most < 0.07


def test_samples_that_come_too_slowly_still_have_a_slope() -> None:
    step = 1.0 / 30.0
    t = step * np.arange(200)
    seen = reading_residual(np.sin(t)[:, None], np.cos(t)[:, None], step)
    assert step * 4 < SMOOTH < step * 6
    assert seen.reach.max() < 1e-4
    assert not len(reading_residual(np.zeros((4, 1)), np.zeros((4, 1)), step).error)


def test_a_standing_joints_noise_never_tells_a_direction() -> None:
    """At four deviations one sample in 16 000 turned a standing joint's friction round, and U held twice its size for it."""
    rng = np.random.default_rng(8)
    e = NoiseEstimate()
    dq = 0.0025 * rng.normal(size=(60_000, 1))
    e.add(Recording("open_loop", 0, 0, 0, DT * np.arange(len(dq)), np.zeros_like(dq), dq, np.zeros_like(dq)), DT)
    least = e.error().least.hi[1]
    assert np.sum(np.abs(dq) > least) > 0
    assert np.abs(dq).max() < TELLING * least < 0.02


def test_what_the_model_lacks_goes_to_the_torque_not_to_the_reading(tmp_path: Path) -> None:
    """A push of 3 N m for a tenth of a second, again and again: a free V took it for reading error and left 0.3 N m to U."""
    trials = []
    for r in recordings((2.0,), (4.0,), suites=2, trials=6, seconds=2.0, noise=(1e-6, 1e-4)):
        push = 3.0 * ((np.arange(len(r.t)) // 25) % 4 == 0)
        q, dq = lag(2.0, 4.0, float(r.t[1] - r.t[0]), float(r.q[0, 0]), float(r.dq[0, 0]), r.tau[:, 0] + push)
        trials.append(dataclasses.replace(r, q=q[:, None], dq=dq[:, None]))
    found = identify(arm(names(1)), [save_trials(tmp_path / "rec.parquet", trials, names(1))])
    sets, most = found.model.powered, found.survey.readings.most
    room = sets.margin * np.maximum(most.hi, 1e-9) * (1 + 1e-6)
    assert np.all(sets.V.hi <= room) and np.all(sets.V.lo >= -room)
    assert sets.V.hi[1] < 0.05
    assert sets.U.width[0] > 2.5
