"""The campaign and the hidden effects: shapes, determinism, sizes, and what the command says and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from stopset.cli.main import main
from stopset.errors import EffectError, RobotError
from stopset.offline.description import load_robot, robot_from_text
from stopset.recording import read_recordings
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torque
from stopset.simulation import Schedule, kinds, prepare
from stopset.simulation.campaign import make
from stopset.simulation.cell import EVERY, TICK, Cell, build_cell, wrong_cad
from stopset.simulation.hidden import Hidden, healthy, parse_hidden
from stopset.simulation.plant import healthy_plant
from stopset.simulation.scenario import complete_robot
from stopset.simulation.sizing import RATIOS, closed_loop, inject, residual_rms, size_effect
from synthetic import with_payload

URDF = """<robot name="two"><link name="base"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
<limit lower="-2.5" upper="2.5" effort="70" velocity="1.2"/></joint>
<link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>
<inertia ixx="0.03" iyy="0.03" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
<limit lower="-2.5" upper="2.5" effort="40" velocity="1.2"/></joint>
<link name="fore"><inertial><origin xyz="0.02 0 0.15"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.02" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
SMALL = Schedule(poses=4, closed_loop=1, closed_loop_time=3.0, suites=2, repeats=2, stops=(2, 1))


def two_joints(seed: int = 1) -> Robot:
    return complete_robot(robot_from_text(URDF), seed)


def cell(seed: int = 1) -> Cell:
    robot = two_joints(seed)
    return build_cell(robot, healthy(healthy_plant(robot, np.random.default_rng([seed, 1]))), seed)


@pytest.fixture(scope="module")
def sound() -> Cell:
    return cell()


def test_a_campaign_holds_every_phase_from_cold_to_warm(sound: Cell) -> None:
    trials = list(make(sound, SMALL))
    count = {p: sum(r.phase == p for r in trials) for p in ("static", "closed_loop", "open_loop", "stop0", "stop1")}
    assert count == {"static": 8, "closed_loop": 4, "open_loop": 4, "stop0": 3, "stop1": 3}
    assert [r.place for r in trials] == list(range(len(trials)))
    temps = np.array([r.temp.mean() for r in trials if r.temp is not None])
    assert temps[-1] - temps[0] > 10.0 and np.corrcoef(temps, np.arange(len(temps)))[0, 1] > 0.9
    static = [r for r in trials if r.phase == "static"]
    for up, down in zip(static[::2], static[1::2], strict=True):
        assert np.abs(up.dq).max() < 6 * 0.003 and np.abs(down.dq).max() < 6 * 0.003
        # the same pose within the controllers' error, held from both sides by nearly all the friction
        assert np.abs(up.q[0] - down.q[0]).max() < 0.03
        g = [gravity_torque(sound.cad.chain, sound.cad.pi, r.q[0]) for r in (up, down)]
        held = np.abs((up.tau.mean(0) - g[0]) - (down.tau.mean(0) - g[1])) / (2 * sound.truth.plant.fc)
        assert np.all((held > 0.85) & (held < 1.15))
    for r in trials:
        if r.phase in ("stop0", "stop1"):
            assert r.stop_trigger is not None and not r.stop_trigger[0] and r.stop_trigger[-1]
            assert np.abs(r.dq[-10:]).max() < 6 * 0.003
            assert np.abs(r.tau[-5:]).max() < 6 * sound.torque_noise.max()  # power is off at the end
        if r.phase == "stop0":
            k = int(np.argmax(r.stop_trigger))
            assert np.abs(r.tau[k:]).max() < 6 * sound.torque_noise.max()


def test_open_loop_trials_replay_equal_torques_and_drift_apart(sound: Cell) -> None:
    trials = [r for r in make(sound, SMALL) if r.phase == "open_loop" and r.suite == 0]
    n = min(len(r.t) for r in trials)
    first, second = trials
    noise = np.abs(first.tau[:n] - second.tau[:n]).max()
    assert noise < 6 * np.sqrt(2) * sound.torque_noise.max()
    assert np.abs(first.q[0] - second.q[0]).max() < 0.005
    assert np.abs(first.q[n - 1] - second.q[n - 1]).max() > 0.005


def test_the_same_seed_gives_the_same_recordings_and_another_does_not() -> None:
    once, again, other = (list(make(cell(seed), SMALL)) for seed in (1, 1, 2))
    assert all(np.array_equal(a.q, b.q) and np.array_equal(a.tau, b.tau) for a, b in zip(once, again, strict=True))
    assert not np.array_equal(once[-1].tau, other[-1].tau)


def test_hiding_nothing_leaves_the_recordings_as_they_are(sound: Cell) -> None:
    """Everything random has its own stream, so an effect of size nearly zero changes nothing else."""
    base = np.vstack([r.tau for r in closed_loop(sound, SMALL)])
    for effect in kinds():
        joint = None if kinds()[effect].scope == "arm" else 0
        changed, _ = inject(sound, [Hidden(effect, joint, 1e-7)])
        tau = np.vstack([r.tau for r in closed_loop(changed, SMALL)])
        if effect == "hysteresis":  # a gear of any presliding at all is another mechanism than dry friction
            assert np.median(np.abs(tau - base)) < 0.1
        else:
            assert np.quantile(np.abs(tau - base), 0.99) < 0.05, effect


@pytest.mark.parametrize("effect", [name for name, kind in kinds().items() if kind.fixed])
def test_what_raises_no_residual_has_a_fixed_size_and_says_why(sound: Cell, effect: str) -> None:
    sized = size_effect(sound, SMALL, [], effect, 0, RATIOS["hard"])
    assert sized.hidden.size == kinds()[effect].guess > 0
    assert kinds()[effect].fixed in sized.note
    changed, said = inject(sound, [sized.hidden])
    assert changed.truth is not sound.truth and said[0]


@pytest.mark.parametrize("effect", [name for name, kind in kinds().items() if not kind.fixed])
def test_every_effect_reaches_its_size_and_only_there(sound: Cell, effect: str) -> None:
    joint = None if kinds()[effect].scope == "arm" else 0
    healthy_trials = closed_loop(sound, SMALL)
    sized = size_effect(sound, SMALL, healthy_trials, effect, joint, RATIOS["hard"])
    if (
        effect in ("coriolis", "encoder_eccentricity") and sized.note
    ):  # slow arms hardly have any; encoders err by 0.02 rad at most
        assert sized.hidden.size == kinds()[effect].most
        return
    assert sized.ratio == pytest.approx(RATIOS["hard"], rel=0.05), sized.note
    assert 0 < sized.hidden.size <= kinds()[effect].most
    changed, said = inject(sound, [sized.hidden])
    again = residual_rms(sound, closed_loop(changed, SMALL), kinds()[effect].top)
    assert again / residual_rms(sound, healthy_trials, kinds()[effect].top) == pytest.approx(sized.ratios)
    assert said and all(isinstance(v, (float, int, str, np.floating)) for v in said[0].values())


def test_easy_is_larger_than_hard(sound: Cell) -> None:
    trials = closed_loop(sound, SMALL)
    hard, easy = (size_effect(sound, SMALL, trials, "spring", 1, RATIOS[s]) for s in ("hard", "easy"))
    assert easy.hidden.size > 2 * hard.hidden.size
    assert easy.ratio == pytest.approx(np.sqrt(10), rel=0.05)


def test_instruments_report_what_they_should(sound: Cell) -> None:
    """Payload, gain, delay, tilt, encoder: what the recordings show of them, by hand."""
    static = Schedule(poses=6, closed_loop=1, closed_loop_time=1.0, suites=1, repeats=1, stops=(1, 1))

    def mean_static(c: Cell) -> tuple[np.ndarray, np.ndarray]:
        trials = [r for r in make(c, static) if r.phase == "static"]
        tau = np.array([r.tau.mean(0) for r in trials]).reshape(-1, 2, 2).mean(1)
        q = np.array([r.q.mean(0) for r in trials]).reshape(-1, 2, 2).mean(1)
        return tau, q

    robot = sound.cad
    loaded, said = inject(sound, [Hidden("payload", None, 1.5)])
    tau, q = mean_static(loaded)
    com = np.array([said[0][f"com_{a}_m"] for a in "xyz"], float)
    heavy = with_payload(robot, 1.5, com)
    want = np.array([gravity_torque(heavy.chain, heavy.pi, x) for x in q])
    # friction differs by 2 % between the two sides of a pose, and up to 5 % of it may not be in hold
    tolerance = 0.08 * sound.truth.plant.fc.max()
    assert np.abs(tau - want).max() < tolerance
    assert np.abs(tau - [gravity_torque(robot.chain, robot.pi, x) for x in q]).max() > 2 * tolerance

    tilted, said = inject(sound, [Hidden("base_tilt", None, 0.2)])
    g = tilted.truth.plant.chain.gravity
    assert np.linalg.norm(g) == pytest.approx(9.81)
    assert np.arccos(-g[2] / 9.81) == pytest.approx(0.2)

    late, _ = inject(sound, [Hidden("delay", 0, 0.02)])
    a, b = (closed_loop(c, static)[0].tau[:, 0] for c in (sound, late))
    shift = [np.mean((b[10:] - np.roll(a, k)[10:]) ** 2) for k in range(10)]
    assert int(np.argmin(shift)) == round(0.02 / (EVERY * TICK))


def test_wrong_cad_is_wrong_by_a_few_percent_and_still_a_body() -> None:
    robot = two_joints()
    pi = wrong_cad(robot, np.random.default_rng(3))
    off = np.abs(pi[:, 0] / robot.pi[:, 0] - 1)
    assert np.all((off >= 0.02) & (off <= 0.05))
    for P in pi:
        m, c = P[0], P[1:4] / P[0]
        about = np.array([[P[4], P[5], P[7]], [P[5], P[6], P[8]], [P[7], P[8], P[9]]])
        inertia = about - m * ((c @ c) * np.eye(3) - np.outer(c, c))
        principal = np.linalg.eigvalsh(inertia)
        assert principal[0] > 0 and principal[2] <= principal[0] + principal[1]


@pytest.mark.parametrize(
    ("words", "seen"),
    [
        (["creep"], "no effect 'creep'"),
        (["stribeck:hip"], "no joint 'hip'"),
        (["payload:elbow"], "whole arm"),
        (["spring:elbow", "spring:elbow"], "already hidden"),
    ],
)
def test_what_cannot_be_hidden_is_refused(words: list[str], seen: str) -> None:
    with pytest.raises(EffectError, match=seen):
        parse_hidden(words, two_joints(), np.random.default_rng(0))


def test_an_arm_its_drives_cannot_hold_is_refused() -> None:
    weak = robot_from_text(URDF.replace('effort="70"', 'effort="3"'))
    with pytest.raises(RobotError, match="torque limit"):
        prepare(weak)


def test_the_command_writes_a_campaign_that_can_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    urdf = tmp_path / "two.urdf"
    urdf.write_text(URDF)
    out = tmp_path / "set"
    words = ["simulate", "--robot", str(urdf), "--hide", "spring:elbow", "--hide", "payload", "--out", str(out), "--seed", "4"]
    assert main(words) == 0
    robot = load_robot(out / "robot.urdf")
    data = read_recordings(out / "recording.parquet", robot)
    truth = json.loads((out / "truth.json").read_text())
    assert data.samples == truth["rows"] and 45_000 < data.samples < 55_000
    assert data.meta.rate_hz == pytest.approx(250.0) and data.meta.effort == "motor_torque"
    assert truth["verdict"] == "missing"
    assert [(e["effect"], e["joint"]) for e in truth["effects"]] == [("spring", "elbow"), ("payload", None)]
    assert all(abs(e["ratio_achieved"] / np.sqrt(10) - 1) < 0.05 for e in truth["effects"])
    assert np.all(robot.rotor > 0) and np.isfinite([d.brake_torque for d in robot.drives]).all()
    assert "truth.json" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [
        ["--hide", "creep", "--out", "{}/new"],
        ["--hide", "none", "--robot", "nowhere.urdf", "--out", "{}/new"],
        ["--hide", "none", "--out", "{}/file"],
        ["--hide", "none", "--out", "{}/no/such/place"],
        ["--hide", "none", "--seed", "-1", "--out", "{}/new"],
    ],
)
def test_bad_orders_get_one_sentence_and_write_nothing(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("here")
    assert main(["simulate", *(w.format(tmp_path) for w in words)]) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("stopset:") and "\n" not in said
    assert [p.name for p in tmp_path.iterdir()] == ["file"] and (tmp_path / "file").read_text() == "here"
