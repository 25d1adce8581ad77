"""When samples were taken: even clocks with scattering stamps, uneven clocks with true ones, gaps."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
import pytest

from stopset.errors import RecordingError
from stopset.offline.diagnose.rows.prepare import prepare
from stopset.offline.diagnose.rows.sampling import in_words, sampled
from stopset.offline.nominal import preprocess
from stopset.offline.nominal.stamps import even_clock
from stopset.recording import Meta, Recording, Recordings

DT, N, NOISE = 0.008, 1500, 2e-5


def motion(t: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(1.3 * t), 0.8 * np.sin(2.1 * t + 0.4)], axis=1)


def recorded(stamps: np.ndarray, taken: np.ndarray) -> Recording:
    q = motion(taken) + np.random.default_rng(2).normal(0, NOISE, (len(taken), 2))
    return Recording("closed_loop", 0, 0, 0, stamps, q, np.gradient(q, taken, axis=0), 5.0 * q)


def test_stamps_that_scatter_about_a_clock_are_read_as_that_clock() -> None:
    clock = DT * np.arange(N)
    stamps = np.sort(clock + np.random.default_rng(1).normal(0, 1e-3, N))
    got = sampled(recorded(stamps, clock), DT)
    assert got.scatter == pytest.approx(1e-3, rel=0.1) and not got.torn.any() and got.lost == 0
    off = got.q - motion(got.t)
    assert np.std(off - off.mean(axis=0)) < 5 * NOISE  # read as stamped: a millisecond at 1.7 rad/s, 1e-3
    assert "scatter by 1 ms" in in_words([got])[0]


def test_a_stamp_more_than_half_a_period_late_is_no_lost_sample() -> None:
    """One that is rounded to the next place would move all after it; two that share a place would leave no clock at all."""
    clock = DT * np.arange(N)
    stamps = clock + np.random.default_rng(1).normal(0, 5e-4, N)
    stamps[[300, 700, 1100]] += [0.62 * DT, -0.58 * DT, 0.55 * DT]
    got = sampled(recorded(np.sort(stamps), clock), DT)
    assert got.lost == 0 and not got.torn.any() and 0 < got.scatter < 1e-3


def test_stamps_that_scatter_by_a_fifth_of_a_period_are_read_as_that_clock() -> None:
    """Of some thousand stamps two or three beside each other are half a period off: they shared a place, and there was no clock at all."""
    clock = DT * np.arange(4000)
    for seed in range(5):
        stamps = clock + np.random.default_rng(seed).normal(0, 0.18 * DT, len(clock))
        read, lost = even_clock(np.maximum.accumulate(stamps) + 1e-9 * np.arange(len(clock)), DT)
        assert read is not None and lost == 0
        assert np.abs(read - clock).max() < 0.02 * DT


def test_stamps_of_a_clock_that_is_uneven_are_believed() -> None:
    taken = np.cumsum(DT * np.random.default_rng(1).uniform(0.7, 1.3, N))
    got = sampled(recorded(taken, taken), DT)
    assert got.scatter == 0.0 and not in_words([got])
    assert (
        np.abs(got.q - motion(got.t))[5:-5].max() < 8 * NOISE
    )  # a straight line between samples would be 3e-5 off, at its middle


@pytest.mark.parametrize("scatter", [0.0, 1e-3])
def test_what_lies_beside_a_lost_sample_is_asked_for_nothing(scatter: float) -> None:
    rng = np.random.default_rng(3)
    received = rng.random(N) > 0.03
    received[[0, -1]] = True
    clock = DT * np.arange(N)[received]
    stamps = np.sort(clock + rng.normal(0, 1.0, len(clock)) * scatter)
    r = recorded(stamps, clock)
    got = sampled(r, DT)
    assert got.lost == N - received.sum() and f"{got.lost} samples are lost" in in_words([got])[-1]
    middles = 0.5 * (clock[1:] + clock[:-1])[np.diff(clock) > 1.5 * DT]
    assert all(got.torn[np.argmin(np.abs(got.t - t))] for t in middles)
    data = prepare(Recordings(Meta(("a", "b")), (r,)))
    rows = data.t[data.ok.any(axis=1)]
    away = np.abs(rows[:, None] - middles).min(axis=1)
    assert (
        len(rows) > 50 and away.min() > data.kernel.half * data.kernel.dt - 2 * DT and len(data.sampling) == len(in_words([got]))
    )


def test_even_stamps_are_left_as_they_are() -> None:
    t = DT * np.arange(N)
    r = recorded(t, t)
    got = sampled(r, DT)
    assert got.q is r.q and got.tau is r.tau and not in_words([got])


def test_a_trial_too_short_to_tell_its_noise_does_not_count() -> None:
    """Its rows would be held against a noise that is no number."""
    clock = DT * np.arange(18)
    short = recorded(clock, clock)
    with pytest.raises(RecordingError, match="no moving trial of more than 20 samples"):
        prepare(Recordings(Meta(joints=("a", "b"), robot="two", rate_hz=1 / DT), [short]))
    whole = recorded(DT * np.arange(N), DT * np.arange(N))
    made = prepare(Recordings(Meta(joints=("a", "b"), robot="two", rate_hz=1 / DT), [whole, replace(short, trial=1)]))
    assert len(made.trials) == 1 and np.isfinite(made.torque_noise).all()


def test_uneven_stamps_are_read_once_for_all_passes_over_the_same_positions() -> None:
    """Another torque of the same positions is read on the same grid; written over they are read anew; of what is gone nothing is kept."""
    rng = np.random.default_rng(4)
    t = np.sort(0.01 * np.arange(400) + rng.normal(0.0, 1e-3, 400))
    r = Recording("closed_loop", 0, 0, 0, t, np.sin(t)[:, None], np.cos(t)[:, None], np.sin(3 * t)[:, None])
    before = len(preprocess._resampled_of._known)
    ((grid, q, tau, _),) = preprocess.even_pieces(r)
    ((again, same, other, _),) = preprocess.even_pieces(replace(r, tau=2.0 * r.tau))
    assert again is grid and same is q and np.allclose(other, 2.0 * tau)
    assert np.allclose(q[:, 0], np.sin(grid), atol=2e-3)
    r.q[:] = np.cos(t)[:, None]
    ((_, moved, _, _),) = preprocess.even_pieces(r)
    assert np.allclose(moved[:, 0], np.cos(grid), atol=2e-3)
    assert len(preprocess._resampled_of._known) == before + 1
    del r
    gc.collect()
    assert len(preprocess._resampled_of._known) == before
