"""One key of what repeats, (file, phase, suite): files read together stay apart, and the numbers in them are names only."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from nominal_cases import Truth, moving, poses
from nominal_cases import arm as three_joints
from stopset.offline.brakes.stops import divide
from stopset.offline.campaign.session import Session
from stopset.offline.campaign.survey import Tally
from stopset.offline.diagnose.rows.prepare import prepare
from stopset.offline.identify.pipeline import Settings, identify
from stopset.offline.nominal.normal_equations import accumulate, group_of
from stopset.recording import Meta, Recording, Recordings, counted, stream_recordings, suite_label, write_recordings
from synthetic import arm, names, recordings, save_trials
from test_brakes import recorded_stop1

PRODUCT = [Path(__file__).parents[1] / d for d in ("model", "offline", "monitor", "fmu")]
# who writes, reads or says the numbers that a recorder gave; everyone else asks for suite_key, repetition, begun or place
SPEAKERS = {"types.py", "writer.py", "reader.py", "signals_file.py", "sums_file.py", "cell.py", "campaign.py"}


def one_joint(suites: int, trials: int, seed: int = 1) -> list[Recording]:
    return recordings((2.0,), (4.0,), suites=suites, trials=trials, seconds=0.6, seed=seed)


def renumbered(trials: Sequence[Recording], suite: int, trial: int) -> list[Recording]:
    """Other names for suites and trials, nothing else."""
    return [dataclasses.replace(r, suite=suite * r.suite + 5, trial=trial * r.trial + 40) for r in trials]


def of_files(*files: Sequence[Recording]) -> Recordings:
    """Read together, as the reader would number them."""
    whole = [dataclasses.replace(r, file=k) for k, trials in enumerate(files) for r in trials]
    placed = (dataclasses.replace(r, place=place) for place, r in enumerate(whole))
    return Recordings(Meta(names(whole[0].q.shape[1])), tuple(counted(placed)))


def test_the_reader_counts_in_the_order_of_the_file(tmp_path: Path) -> None:
    """Rounds through all suites, as a campaign is recorded: repetitions are counted by suite, suites as they begin."""
    trials = renumbered(one_joint(3, 4), 7, 2)
    rounds = [r for k in range(4) for r in trials[k::4][::-1]]
    a = save_trials(tmp_path / "a.parquet", rounds, names(1))
    b = save_trials(tmp_path / "b.parquet", rounds[:5], names(1))
    read = list(stream_recordings([a, b]))
    assert [r.repetition for r in read] == [k for k in range(4) for _ in range(3)] + [0, 0, 0, 1, 1]
    assert [r.begun for r in read] == [0, 1, 2] * 4 + [0, 1, 2, 0, 1]
    assert [r.suite_key for r in read[12:14]] == [(1, "open_loop", 19, 0), (1, "open_loop", 12, 0)]


def test_poses_of_two_files_with_one_number_are_two_poses() -> None:
    truth = Truth(three_joints())
    here, there = poses(truth, 2, 0), poses(truth, 2, 1)
    both = of_files(here, [*there, moving(truth, 0, 3.0, 1.0, 0)])
    assert len(prepare(both).q_still) == 4
    # the last pose of one file and the first of the next have the same number: they are not the two sides of one
    separate = accumulate(truth.robot, of_files(here[2:3], [dataclasses.replace(there[1], suite=1)]))
    assert separate.poses == 0 and separate.skipped == {"static pose from one side only": 2}


def test_repetitions_are_counted_within_a_file() -> None:
    """Three of each of two files are not six, from which on warming would be counted by repetition."""
    both = of_files(one_joint(2, 3), one_joint(2, 3, seed=2))
    assert Session.of(both).repeats == 3
    warm = prepare(both).warm_fine
    assert warm[0] == 0.0 and warm[-1] == 1.0 and len(np.unique(warm)) == 12


def test_stops_of_two_files_are_held_out_by_file() -> None:
    """Every third of each suite: two stops in each of two files are all trained on, four in one are not."""
    stops = recorded_stop1(4, 3)
    assert len(divide(of_files(stops).trials)[1]) == 1
    assert len(divide(of_files(stops[:2], stops[2:]).trials)[1]) == 0


@pytest.mark.parametrize(("suite", "trial"), [(1, 2), (3, 1), (7, 6)])
def test_numbers_are_names(suite: int, trial: int, tmp_path: Path) -> None:
    """Numbered in twos, say: all trials would fall into one half, and the other half's margin would be 1."""
    plain = one_joint(3, 8)
    named = renumbered(plain, suite, trial)
    a, b = (identify(arm(names(1)), [save_trials(tmp_path / f"{k}.parquet", x, names(1))]) for k, x in enumerate((plain, named)))
    assert a.model.guarantee.text == b.model.guarantee.text
    assert a.conformance.margins.tolist() == b.conformance.margins.tolist() != [1.0]
    np.testing.assert_array_equal(a.model.powered.U.hi, b.model.powered.U.hi)
    assert a.model.errors == b.model.errors
    assert [a.survey.warm(r) for r in a.survey.sample] == [b.survey.warm(r) for r in b.survey.sample]


def test_numbers_are_names_for_the_regression_too() -> None:
    """Groups of motions are drawn by a hash: of the order, not of the number."""
    truth = Truth(three_joints())
    trials = of_files([moving(truth, s, 3.0, 1.0, 0) for s in range(6)]).trials
    a = accumulate(truth.robot, trials)
    b = accumulate(truth.robot, counted(renumbered(trials, 3, 2)))
    np.testing.assert_array_equal(a.moving, b.moving)
    assert np.count_nonzero(a.rows_moving[:, 0]) > 3


def test_a_file_cut_between_its_suites_says_the_same(tmp_path: Path) -> None:
    """And kept files go on counting where an update reads them again."""
    trials = one_joint(4, 8)
    whole = save_trials(tmp_path / "whole.parquet", trials, names(1))
    parts = [save_trials(tmp_path / f"{k}.parquet", trials[16 * k : 16 * k + 16], names(1)) for k in range(2)]
    a, b = identify(arm(names(1)), [whole], Settings()), identify(arm(names(1)), parts, Settings())
    np.testing.assert_array_equal(a.model.powered.U.hi, b.model.powered.U.hi)
    assert a.model.guarantee.text == b.model.guarantee.text


def test_a_recording_written_and_read_keeps_its_names(tmp_path: Path) -> None:
    trials = renumbered(one_joint(2, 2), 3, 2)
    write_recordings(tmp_path / "a.parquet", Meta(names(1)), trials)
    assert [(r.suite, r.trial) for r in stream_recordings(tmp_path / "a.parquet")] == [(r.suite, r.trial) for r in trials]


def lines() -> Iterator[tuple[Path, str]]:
    for path in (p for d in PRODUCT for p in d.rglob("*.py")):
        for line in path.read_text().splitlines():
            yield path, line


def test_no_module_counts_by_the_numbers_of_a_recorder() -> None:
    """``r.suite``, ``r.trial`` outside of what reads, writes or says them groups across files or takes a name for a number."""
    by_number = re.compile(r"\b(r|first|pair\[0\])\.(suite|trial)\b")
    used = [f"{path.name}: {line.strip()}" for path, line in lines() if path.name not in SPEAKERS and by_number.search(line)]
    assert not used, used


def wandering(trial: int, seed: int, *, phase: str = "open_loop", diverged: float = 0.0, worn: float = 0.0) -> Recording:
    """A trial of suite 4 on three joints: ``seed`` tells which motion, ``diverged`` [rad] how far angles went off, ``worn`` [N m] friction lost."""
    t = 0.004 * np.arange(1000)
    rng = np.random.default_rng(seed)
    w, at = rng.uniform(1.0, 6.0, (4, 3)), rng.uniform(0.0, 6.0, (4, 3))
    q = np.sin(t[:, None, None] * w + at).sum(axis=1)
    dq = (w * np.cos(t[:, None, None] * w + at)).sum(axis=1)
    noise = np.random.default_rng(100 + trial).normal(size=(2, *q.shape))
    tau = 30.0 * q + (20.0 - worn) * np.sign(dq) + 0.5 * noise[0]
    return Recording(phase, 4, trial, trial, t, q + diverged * t[:, None] + 1e-4 * noise[1], dq, tau)


@pytest.mark.parametrize("phase", ["open_loop", "closed_loop"])
def test_trials_of_one_number_that_repeat_nothing_are_motions_of_their_own(phase: str) -> None:
    """A real KUKA KR 300's three trajectories, numbered as trials of a suite, were taken for repetitions: the model's error was said to be
    theirs, and a margin was calibrated between them."""
    trials = [wandering(k, seed, phase=phase) for k, seed in enumerate([1, 2, 1, 3, 2])]
    read = list(counted(trials))
    assert [r.other for r in read] == [0, 1, 0, 2, 1]
    assert [r.repetition for r in read] == [0, 0, 1, 0, 1] and {r.begun for r in read} == {0}
    assert len({r.suite_key for r in read}) == 3 and suite_label(read[1].suite_key) == f"{phase} suite 4, motion 2"
    assert len({group_of(r) for r in read[:2]}) == 2
    found = Tally(phase)
    for r in read:
        found.add(r)
    assert len(set(found.survey().motion.values())) == 3


def test_repetitions_stay_repetitions() -> None:
    """In open loop angles go apart and torques do not; under a controller friction falls by half and angles do not."""
    assert {r.other for r in counted([wandering(k, 1, diverged=0.4 * k) for k in range(4)])} == {0}
    assert {r.other for r in counted([wandering(k, 1, phase="closed_loop", worn=10.0 * (k > 1)) for k in range(4)])} == {0}
    assert {r.other for r in counted([wandering(k, k, phase="stop0") for k in range(3)])} == {0}
