"""Sets of a single recording: what parts of it ask for that were left out of fit and sets, and whether the rest then stays inside."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nominal_cases import F_C, F_V, JOINTS, Truth, arm, moving
from stopset.offline.campaign.hold_out import BLOCK, GUARD, blocks
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.survey import survey
from stopset.offline.compare.compare import compare
from stopset.offline.conform import guarantee as g
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Identification, Settings, identify
from stopset.offline.identify.unseen import FEWEST, RISK, STRETCHES, factor_expected, stretches
from stopset.recording import Meta, Recording, read_recordings, write_recordings
from stopset.robot import Robot
from synthetic import arm as planar
from synthetic import names, recordings, save_trials

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
META = Meta(joints=JOINTS, robot="three", rate_hz=125.0)


def halves(folder: Path, robot: Robot, meta: Meta, r: Recording, share: float = 0.5) -> tuple[Identification, int, int]:
    """A recording identified from its beginning; how many blocks there are of the rest, and how many leave the sets."""
    cut = round(share * len(r.t))
    rest = [replace(b, suite=k, trial=0, phase="closed_loop") for k, b in enumerate(blocks(r.cut(cut, len(r.t)), 0.0))]
    write_recordings(folder / "begin.parquet", meta, [r.cut(0, cut)])
    write_recordings(folder / "rest.parquet", meta, rest)
    found = identify(robot, [folder / "begin.parquet"])
    return found, len(rest), len(compare(found.model, [folder / "rest.parquet"]).violations)


def drifting(seed: int) -> Truth:
    """An arm whose friction wanders by a tenth, within some two seconds: no law of the catalogue is that."""

    def friction(dq: np.ndarray, load: np.ndarray) -> np.ndarray:
        rng, keeps = np.random.default_rng(seed), np.exp(-1 / (125 * 2.0))
        level = np.zeros_like(dq)
        for k, e in enumerate(rng.normal(size=dq.shape)[1:]):
            level[k + 1] = keeps * level[k] + np.sqrt(1 - keeps**2) * e
        return np.asarray((F_C * np.sign(dq) + F_V * dq) * (1 + 0.1 * level))

    return Truth(arm(), friction)


def test_the_rest_of_a_motion_stays_in_the_sets_of_its_beginning(tmp_path: Path) -> None:
    """Two arms, a minute each: without the margin 13 of 24 blocks of the second half leave the sets of the first."""
    left, tried = 0, 0
    for seed in (1, 2):
        r = moving(drifting(seed), 0, 60.0, 1.0, seed=seed, rate=125.0)
        found, count, out = halves(tmp_path, arm(), META, r)
        left, tried = left + out, tried + count
        assert found.tightness.median < 3.0
        assert found.model.powered.margin > 1.0 and g.SAME_MOTION in found.model.guarantee.text
        assert any("blocks of 2.5 s" in note and "says nothing" in note for note in found.model.notes)
    assert tried == 24 and left <= RISK * tried


@pytest.mark.shared
@pytest.mark.skipif(not (DATA / "ur10e").exists(), reason="../shared/data is not here")
def test_one_real_recording_foretells_its_rest(tmp_path: Path) -> None:
    """31 s of a UR10e under load: three of five blocks left the sets of its first 60 %."""
    robot = load_robot(DATA / "ur10e" / "robot.urdf")
    read = read_recordings(DATA / "ur10e" / "payload_b.parquet", robot)
    found, count, out = halves(tmp_path, robot, replace(read.meta, joints=robot.joints), read.trials[0], 0.6)
    assert count == 5 and out <= 1
    assert found.tightness.median < 3.0


def test_what_is_left_out_is_apart_from_what_is_fitted() -> None:
    """Every sample judges once, a guard away from all that is fitted; a short recording leaves nothing out."""
    r = moving(Truth(arm()), 0, 30.0, 1.0, seed=5, rate=125.0)
    found = survey(lambda: [r])
    run = Run(arm(), META, lambda: [r], found, Settings())
    parts = stretches(run)
    assert len(parts) == STRETCHES and sum(len(b.t) for s in parts for b in s.out) == len(r.t)
    assert sum(len(s.out) for s in parts) == round(30.0 / BLOCK) >= FEWEST
    for s in parts:
        judged, fitted = (np.concatenate([x.t for x in some]) for some in (s.out, s.rest))
        assert np.abs(judged[:, None] - fitted[None, :]).min() >= GUARD - 1e-9
    short = r.cut(0, 400)
    assert stretches(replace(run, trials=lambda: [short], survey=survey(lambda: [short]))) == []


def test_what_is_foretold_of_another_block() -> None:
    rng = np.random.default_rng(0)
    assert factor_expected(np.full(8, 0.5)) == 1.0, "sets never shrink"
    assert factor_expected(np.array([1.0, 1.1, 0.9, 3.0])) >= 3.0, "no less than what was seen, where that is little"
    assert factor_expected(np.exp(rng.normal(0, 0.6, 8))) > factor_expected(np.exp(rng.normal(0, 0.1, 8)))
    for count in (5, 8, 12, 30):
        held = [x[-1] <= factor_expected(x[:-1]) for x in np.exp(rng.normal(0.2, 0.3, (2000, count + 1)))]
        assert np.mean(held) >= 1 - RISK - 0.02, count


def test_repeated_motions_are_calibrated_as_before(tmp_path: Path) -> None:
    """Where something is repeated, or given, nothing is left out in time."""
    path = save_trials(tmp_path / "r.parquet", recordings((1.0, 0.5), (4.0, 2.0), suites=1, trials=4, seconds=6.0), names(2))
    said = identify(planar(names(2)), [path], Settings(horizon=0.5)).model.guarantee.text
    assert g.REPETITIONS in said
    one = save_trials(tmp_path / "one.parquet", recordings((1.0, 0.5), (4.0, 2.0), suites=1, trials=1, seconds=6.0), names(2))
    assert g.SAME_MOTION in identify(planar(names(2)), [one], Settings(horizon=0.5)).model.guarantee.text
    assert g.GIVEN in identify(planar(names(2)), [one], Settings(horizon=0.5, margin=1.2)).model.guarantee.text
