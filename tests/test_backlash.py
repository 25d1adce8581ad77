"""Play in a gear: told by an angle that is read behind it, and never by another name without one."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nominal_cases import JOINTS, Truth, moving
from nominal_cases import arm as heavy
from stopset.artifact import load_model
from stopset.cli.main import main
from stopset.offline.description import load_robot, robot_from_text
from stopset.offline.diagnose import diagnose
from stopset.offline.diagnose.evidence.uncertainty import TWO_SIDES
from stopset.offline.diagnose.examination import examine
from stopset.offline.diagnose.plays import plays
from stopset.recording import Meta, Recordings, read_recordings, write_recordings
from stopset.robot.rigid import gravity_torques, torques
from stopset.simulation import Scenario, prepare
from stopset.types import Array
from test_hidden_effects import ARM

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from as_found import ARCMIN, ONE, PROGRAM, Trouble, geared, recorded
from bends import mounted

ENCODER = 2 * np.pi / 2**19  # [rad] of the encoders behind the gears
STIFF, SOFT = 1e5, 1e4  # [N m/rad] an industrial arm's gear, and a small one's


def arm(
    stiffness: float, gap: float, seed: int, behind: float = ENCODER, lengths: tuple[float, ...] = PROGRAM
) -> tuple[Scenario, Recordings]:
    """The arm of three joints, its lift's gear with play of ``gap`` [arcmin], along a program at 100 Hz, against a wrong description."""
    s = prepare(robot_from_text(ARM), ["none"], seed, "short", cad="wrong")
    return s, recorded(s, lengths, 100.0, Trouble(change=geared(1, stiffness, gap * ARCMIN), behind=behind), seed + 100)


@pytest.mark.parametrize(("stiffness", "gap", "seed"), [(STIFF, 3, 5), (STIFF, 1, 6), (SOFT, 5, 5), (SOFT, 1, 6)])
def test_play_is_told_with_its_width(stiffness: float, gap: float, seed: int) -> None:
    s, data = arm(stiffness, gap, seed)
    found = diagnose(s.robot, data)
    assert found.verdict == "missing" and "backlash:lift" in [r.label for r in found.ranked]
    (play,) = (r for r in found.ranked if r.effect == "backlash")
    p = play.parameters["gap"]
    assert p.std is not None and abs(p.value - gap * ARCMIN) < 1.96 * p.std < 0.2 * gap * ARCMIN
    assert play.unit == "rad" and play.error_after < 0.6 * play.error_before


@pytest.mark.parametrize(("stiffness", "seed"), [(STIFF, 5), (SOFT, 5), (SOFT, 6), (2e3, 5), (2e3, 7)])
def test_a_gear_that_only_bends_has_no_play(stiffness: float, seed: int) -> None:
    s, data = arm(stiffness, 0, seed)
    found = plays(s.robot, data)
    assert not found.ranked and not found.blind


def test_a_gear_that_is_soft_about_zero_has_no_play() -> None:
    """Its bend levels off beyond a third of the link's torque, 3 arcmin in all, as harmonic drives' do."""
    s, data = arm(STIFF, 0, 5)
    model = s.robot

    def soft(q: Array) -> Array:
        load = gravity_torques(model.chain, model.pi, q)[:, 1]
        return -1.5 * ARCMIN * np.tanh(load / (0.3 * np.sqrt(np.mean(load**2))))

    bent = []
    for r in data:
        assert r.q_link is not None
        behind = r.q_link.copy()
        behind[:, 1] += soft(r.q)
        bent.append(replace(r, q_link=behind))
    assert not plays(model, replace(data, trials=tuple(bent))).ranked


@pytest.mark.parametrize(("stiffness", "gap"), [(STIFF, 3), (STIFF, 1), (SOFT, 3)])
def test_without_a_second_encoder_it_has_no_other_name_and_is_told_as_out_of_reach(stiffness: float, gap: float) -> None:
    s, data = arm(stiffness, gap, 5, behind=0.0)
    found = diagnose(s.robot, data)
    assert not found.ranked and found.verdict in ("none", "unknown")
    (blind,) = (b for b in found.not_identifiable if b.effect == "backlash")
    assert blind.joints == s.robot.joints and "q_link_<joint>" in blind.why


def test_a_link_that_stays_on_one_flank_says_nothing_of_the_gap() -> None:
    s, data = arm(STIFF, 3, 5, lengths=ONE)
    found = plays(s.robot, data)
    assert not found.ranked and [(b.joints, "changes its side" in b.why) for b in found.blind] == [(("lift",), True)]


def test_a_second_encoder_s_column_is_read_and_is_no_joint_of_its_own(tmp_path: Path) -> None:
    """A file with the documented column was refused: it was taken for a joint without torque."""
    _, data = arm(STIFF, 3, 5)
    first = data.trials[0]
    assert first.q_link is not None
    one = first.q_link.copy()
    one[:, [0, 2]] = np.nan
    write_recordings(tmp_path / "r.parquet", data.meta, [replace(first, q_link=one)])
    again = read_recordings(tmp_path / "r.parquet")
    (read,) = again
    assert again.meta.joints == data.meta.joints and read.q_link is not None
    assert np.allclose(read.q_link[:, 1], one[:, 1], atol=1e-6) and np.isnan(read.q_link[:, [0, 2]]).all()
    part = read.cut(3, 9).q_link
    assert part is not None and np.array_equal(part, read.q_link[3:9], equal_nan=True)


def test_what_is_named_is_added_with_its_numbers(tmp_path: Path) -> None:
    _, data = arm(SOFT, 3, 5)
    (tmp_path / "robot.urdf").write_text(ARM)
    record, first, more = (str(tmp_path / x) for x in ("r.parquet", "m.model.json", "m2.model.json"))
    write_recordings(record, data.meta, data)
    assert main(["identify", "--robot", str(tmp_path / "robot.urdf"), "--data", record, "--out", first]) == 0
    assert main(["add", first, "backlash:lift", "--data", record, "--out", more]) == 0
    model = load_model(more)
    (play,) = (f for f in model.effects if f.effect == "backlash")
    assert play.joint == "lift" and abs(play.values["gap"] - 3 * ARCMIN) < 0.1 * 3 * ARCMIN and play.std["gap"] > 0
    assert not any(f.effect == "backlash" for f in model.input.effects), "no torque is taken off for it"


@pytest.mark.parametrize(("stiffness", "gap", "seed"), [(SOFT, 0, 5), (2e3, 0, 7), (SOFT, 5, 5)])
def test_a_gear_s_stiffness_is_told_by_its_bend(stiffness: float, gap: float, seed: int) -> None:
    """Both encoders show the bend itself; motor torque alone names a gear of this stiffness with a number twice too wide, or not at all."""
    s, data = arm(stiffness, gap, seed)
    found = plays(s.robot, mounted(data, seed))
    (bend,) = found.bends
    p = bend.parameters["K"]
    assert bend.label == "elasticity:lift" and bend.unit == "rad" and bend.error_after < 0.7 * bend.error_before
    assert p.std is not None and abs(p.value - stiffness) < TWO_SIDES * p.std < 0.15 * stiffness
    assert bool(found.ranked) == bool(gap)
    assert found.beside(["elasticity:lift"]) == found.ranked, "what torque tells of it has numbers already"


@pytest.mark.parametrize("seed", [5, 6])
def test_encoders_that_err_are_no_soft_gears(seed: int) -> None:
    """Off zero, of 19 bit, and 20 arcsec wrong once per turn, behind rigid gears."""
    s = prepare(robot_from_text(ARM), ["none"], seed, "short", cad="wrong")
    data = mounted(recorded(s, PROGRAM, 100.0, Trouble(behind=ENCODER), seed + 100), seed)
    found = plays(s.robot, data)
    assert not found.bends and not found.ranked
    answer = diagnose(s.robot, data)
    assert answer.verdict == "none" and not answer.ranked


def test_a_simulated_cell_has_second_encoders_on_request(tmp_path: Path) -> None:
    """And all else is the same with and without them."""
    (tmp_path / "arm.urdf").write_text(ARM)
    words = [
        "simulate",
        "--robot",
        str(tmp_path / "arm.urdf"),
        "--hide",
        "elasticity:lift",
        "--plan",
        "short",
        "--seed",
        "4",
        "--quiet",
    ]
    assert main([*words, "--out", str(tmp_path / "plain")]) == 0
    assert main([*words, "--link-encoder", "--out", str(tmp_path / "both")]) == 0
    plain, both = (read_recordings(tmp_path / x / "recording.parquet") for x in ("plain", "both"))
    assert all(np.array_equal(a.q, b.q) and np.array_equal(a.tau, b.tau) for a, b in zip(plain, both, strict=True))
    assert all(r.q_link is None for r in plain) and all(r.q_link is not None for r in both)
    hidden = json.loads((tmp_path / "both" / "truth.json").read_text())["effects"][0]["params"]["stiffness_Nm_per_rad"]
    (bend,) = plays(load_robot(tmp_path / "both" / "robot.urdf"), both).bends
    p = bend.parameters["K"]
    assert bend.joints == ("lift",) and p.std is not None and abs(p.value - hidden) < TWO_SIDES * p.std


def test_a_heavy_arms_gears_bend_too_and_by_the_arm_as_it_is() -> None:
    """A KR 300's gears have millions of N m/rad: beyond what could be named; and its description lacked what the arm carried."""
    described, stiffness = heavy(mass=150.0), 3e6
    true = described.with_parameters(2.0 * described.pi)
    trials = []
    for k, seconds in enumerate((12.0, 12.0, 12.0)):
        r = moving(Truth(true, noise=np.full(3, 5.0)), k, seconds, 0.8, 7, phase="open_loop")
        acceleration = np.gradient(r.dq, r.t, axis=0)
        link = torques(true.chain, true.pi, r.q, r.dq, acceleration)
        bent = r.q - link / stiffness + 2e-6 * np.random.default_rng(k).normal(size=r.q.shape)
        trials.append(replace(r, q_link=np.column_stack([np.full(len(r.t), np.nan), bent[:, 1], np.full(len(r.t), np.nan)])))
    found = examine(described, Recordings(Meta(joints=JOINTS), tuple(trials)))
    (gear,) = found.plays.bends
    K = gear.parameters["K"]
    assert gear.joints == ("shoulder",) and K.std is not None
    assert abs(K.value - stiffness) < TWO_SIDES * K.std < 0.3 * stiffness, K
