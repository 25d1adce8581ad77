"""Inspection: every detector on data broken on purpose, and silent on sound data."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nominal_cases import F_C, JOINTS, RATE, Truth, arm, campaign, moving, shaken
from stopset.cli.main import main
from stopset.effects.selection import usual_friction
from stopset.errors import RecordingError
from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose
from stopset.offline.inspect import Inspection, inspect_recordings
from stopset.offline.inspect.findings_clock import clock
from stopset.offline.inspect.findings_signals import readings, velocity
from stopset.offline.inspect.gate import check_signals
from stopset.offline.inspect.mounting import mounting
from stopset.offline.inspect.tally import SignalSums
from stopset.offline.nominal.nominal import solve_nominal
from stopset.offline.nominal.normal_equations import accumulate
from stopset.recording import Meta, Recording, Recordings, write_recordings
from stopset.robot.rigid import torques

META = Meta(joints=JOINTS, robot="three", rate_hz=RATE)
Break = Callable[[Recording], Recording]


@pytest.fixture(scope="module")
def trials() -> tuple[Recording, ...]:
    """Poses from both sides and motions slow and fast of a sound arm."""
    return campaign(Truth(arm()), seconds=8.0).trials


def look(folder: Path, trials: Sequence[Recording], meta: Meta = META, robot: bool = True) -> Inspection:
    path = folder / "rec.parquet"
    write_recordings(path, meta, trials)
    return inspect_recordings([path], arm() if robot else None)[0]


def broken(trials: Sequence[Recording], how: Break) -> list[Recording]:
    return [r if r.phase == "static" else how(r) for r in trials]


def kinds(i: Inspection, joint: str | None = None, severity: Sequence[str] = ("error", "warning")) -> set[str]:
    return {f.kind for f in i.findings if f.severity in severity and (joint is None or f.joint == joint)}


def test_sound_data_raise_no_finding(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    for robot in (True, False):
        i = look(tmp_path, trials, robot=robot)
        assert kinds(i) == set(), [f.says for f in i.findings]
        assert not i.wrong
    assert i.offers["phases"]["static"] == {"trials": 80, "motions": 40, "most_trials_per_motion": 2, "seconds": 0.96}
    assert i.offers["rate_hz"] == pytest.approx(250)
    assert i.offers["joints"]["elbow"]["tau"][1] > 5


def test_clock_jitter(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    i = look(tmp_path, broken(trials, lambda r: shaken(r, 0.3)))
    assert "clock_jitter" in kinds(i)
    assert not i.wrong  # resampling deals with it
    assert "clock_jitter" not in kinds(look(tmp_path, broken(trials, lambda r: shaken(r, 0.01))))


def test_late_stamps_are_no_lost_samples(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    i = look(tmp_path, broken(trials, lambda r: shaken(r, 0.3)))
    assert "dropped_samples" not in kinds(i), [f.says for f in i.findings]


def drop(r: Recording, keep_stamps: bool) -> Recording:
    keep = np.random.default_rng(r.suite).random(len(r.t)) > 0.03
    keep[:2] = True
    t = r.t[keep] if keep_stamps else r.t[: int(keep.sum())]
    return replace(r, t=t, q=r.q[keep], dq=r.dq[keep], tau=r.tau[keep])


@pytest.mark.parametrize("keep_stamps", [True, False], ids=["gaps in the stamps", "stamps made up"])
def test_dropped_samples(tmp_path: Path, trials: tuple[Recording, ...], keep_stamps: bool) -> None:
    i = look(tmp_path, broken(trials, lambda r: drop(r, keep_stamps)))
    assert "dropped_samples" in kinds(i, severity=("error",))
    found = next(f for f in i.findings if f.kind == "dropped_samples")
    if keep_stamps:  # 3 % were taken out; two in a row count as one gap of two
        assert found.value == pytest.approx(0.03, rel=0.15)


def test_repeated_samples(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    def hold(r: Recording) -> Recording:
        source = np.arange(len(r.t))
        lost = np.random.default_rng(r.suite).random(len(r.t)) < 0.05
        lost[0] = False
        source[lost] -= 1
        return replace(r, q=r.q[source], dq=r.dq[source], tau=r.tau[source])

    assert "repeated_samples" in kinds(look(tmp_path, broken(trials, hold)), severity=("error",))


def test_what_a_joint_that_stands_gives_way_says_nothing_of_its_speed(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    """0.2 mrad, by an encoder fine enough to see it, while the others move: its drive's speed read 0.003 rad/s of something else."""

    def standing(r: Recording) -> Recording:
        q, dq = r.q.copy(), r.dq.copy()
        q[:, 2] = 0.4 + 1e-4 * np.sin(0.9 * r.t)
        dq[:, 2] = 2e-3 * np.sin(3.0 * r.t)
        return replace(r, q=q, dq=dq)

    assert not kinds(look(tmp_path, broken(trials, standing), robot=False), "elbow") & {"dq_not_derivative", "dq_scale"}


def test_what_came_after_readings_that_were_filled_in_is_no_jump_of_an_encoder(
    tmp_path: Path, trials: tuple[Recording, ...]
) -> None:
    """A bus that was silent for a tenth of a second, in which the logger wrote its last message again."""

    def stalled(r: Recording) -> Recording:
        source = np.arange(len(r.t))
        at = len(r.t) // 3 + int(np.argmax(np.abs(r.dq[len(r.t) // 3 :, 1])))
        silence = min(round(0.1 * RATE), len(r.t) - at - 2)
        source[at : at + silence] = at
        source[at + silence] = at + 1  # a message that had waited
        return replace(shaken(r, 0.3), q=r.q[source], dq=r.dq[source], tau=r.tau[source])

    found = look(tmp_path, broken(trials, stalled)).findings
    assert "repeated_samples" in {f.kind for f in found} and not [f.says for f in found if "jumps by" in f.says]


@pytest.mark.parametrize(("jumps", "severity"), [(4, "warning"), (200, "error")])
def test_a_few_steps_over_lost_samples_are_no_reason_to_refuse(trials: tuple[Recording, ...], jumps: int, severity: str) -> None:
    """As few samples that are missing by their stamps are none."""
    tally = SignalSums(3)
    tally.add(next(r for r in trials if r.phase != "static"))
    tally.jumps, tally.samples = jumps, 6500
    assert [f.severity for f in clock(tally, META, dq_sound=True) if "whole multiples" in f.says] == [severity]


@pytest.mark.parametrize(("signal", "level"), [("tau", 15.0), ("dq", 0.9)])
def test_saturation(tmp_path: Path, trials: tuple[Recording, ...], signal: str, level: float) -> None:
    def clip(r: Recording) -> Recording:
        x = getattr(r, signal).copy()
        x[:, 1] = np.clip(x[:, 1], -level, level)
        return replace(r, **{signal: x})

    i = look(tmp_path, broken(trials, clip))
    assert "saturated" in kinds(i, "shoulder", ("error",))
    found = next(f for f in i.findings if f.kind == "saturated")
    assert found.value == pytest.approx(level, rel=1e-3)
    assert "saturated" not in kinds(i, "base")


@pytest.mark.parametrize("digits", [2, 3])
def test_a_smooth_maximum_of_few_digits_clips_nothing(digits: int, tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    """A torque that was filtered before it was written rests at its largest reading for a few samples, and leaves it as gently as it came."""

    def slow(r: Recording, edge: float = 30.0) -> Recording:
        tau = r.tau.copy()
        tau[:, 1] = np.clip(np.round(16.0 * np.sin(2 * np.pi * 0.3 * (r.t + 0.1 * r.suite)), digits), -edge, edge)
        return replace(r, tau=tau)

    assert "saturated" not in kinds(look(tmp_path, broken(trials, slow)))
    assert "saturated" in kinds(look(tmp_path, broken(trials, lambda r: slow(r, 15.0))), "shoulder", ("error",))


def test_a_derived_speed_that_stays_clips_nothing(tmp_path: Path) -> None:
    """A joint that moves evenly, as programs make them: its differences of angles are one number."""
    q = np.cumsum(np.repeat([0.0, 0.9, 0.0, -0.9, 0.0], 60)) / 100.0
    table = np.column_stack([np.arange(len(q)) / 100.0, q, np.sin(np.arange(len(q)))])
    np.savetxt(tmp_path / "even.csv", table, "%.17g", ",", header="t,q_a,tau_a", comments="")
    found = inspect_recordings([tmp_path / "even.csv"], None)[0]
    assert "derived" in str(found.offers) and "saturated" not in {f.kind for f in found.findings}


@pytest.mark.parametrize(
    ("factor", "kind", "word"),
    [
        (180 / np.pi, "wrong_unit", "deg/s"),
        (-1.0, "dq_not_derivative", "sign"),
        (60 / (2 * np.pi), "wrong_unit", "rpm"),
        (0.0, "dq_not_derivative", "zero"),
    ],
)
def test_dq_in_another_unit_or_sign(tmp_path: Path, trials: tuple[Recording, ...], factor: float, kind: str, word: str) -> None:
    slow = [r for r in trials if r.phase != "static"][-3:]  # at most 0.5 rad/s: deg/s passes the reader's door

    def scale(r: Recording) -> Recording:
        dq = r.dq.copy()
        dq[:, 2] *= factor
        return replace(r, dq=dq)

    i = look(tmp_path, [scale(r) for r in slow])
    found = [f for f in i.findings if f.kind == kind and f.joint == "elbow"]
    assert found and word in found[0].seen, [f.says for f in i.findings]


def test_dq_of_another_joint_is_no_derivative(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    i = look(tmp_path, broken(trials, lambda r: replace(r, dq=r.dq[:, [0, 2, 1]])))
    assert {f.joint for f in i.findings if f.kind == "dq_not_derivative"} == {"shoulder", "elbow"}


def test_dq_filtered_late(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    def late(r: Recording) -> Recording:
        return replace(r, dq=np.column_stack([np.interp(r.t - 0.012, r.t, x) for x in r.dq.T]))

    i = look(tmp_path, broken(trials, late))
    lags = [f.value for f in i.findings if f.kind == "dq_lags"]
    assert lags and lags == pytest.approx([0.012] * len(lags), abs=0.002)


def test_p26_derived_velocity_called_measured(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    def derive(r: Recording) -> Recording:
        return replace(r, dq=np.vstack([np.zeros((1, 3)), np.diff(r.q, axis=0) / np.diff(r.t)[:, None]]))

    data = broken(trials, derive)
    assert "velocity_derived" in kinds(look(tmp_path, data))
    assert "velocity_derived" not in kinds(look(tmp_path, data, replace(META, velocity="derived")))


def test_torque_delay_of_all_and_of_one(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    def late(r: Recording, joints: Sequence[int]) -> Recording:
        tau = r.tau.copy()
        for j in joints:
            tau[:, j] = np.interp(r.t - 0.015, r.t, tau[:, j])
        return replace(r, tau=tau)

    i = look(tmp_path, broken(trials, lambda r: late(r, (0, 1, 2))))
    found = [f for f in i.findings if f.kind == "torque_delay"]
    assert [f.joint for f in found] == [None]
    assert found[0].value == pytest.approx(-0.015, abs=0.002)
    i = look(tmp_path, broken(trials, lambda r: late(r, (2,))))
    assert [f.joint for f in i.findings if f.kind == "torque_delay"] == ["elbow"]


@pytest.mark.parametrize("robot", [True, False], ids=["against the model", "by energy alone"])
def test_wrong_sign_of_torque(tmp_path: Path, trials: tuple[Recording, ...], robot: bool) -> None:
    def turn(r: Recording) -> Recording:
        tau = r.tau.copy()
        tau[:, 1] *= -1
        return replace(r, tau=tau)

    i = look(tmp_path, [turn(r) for r in trials], robot=robot)
    assert [f.joint for f in i.findings if f.kind == "wrong_sign"] == ["shoulder"]
    assert i.wrong


def circling(turned: tuple[int, ...] = ()) -> Recording:
    """Shoulder and elbow out of phase: gravity puts energy in at the one and takes it out at the other in every round."""
    robot, truth = arm(), Truth(arm())
    t = np.arange(0.0, 24.0, 1 / RATE)
    phase, w = np.array([0.3, 0.0, -2.5]), 2 * np.pi / 4
    amplitude = np.array([0.4, 0.5, 0.7])
    q = amplitude * np.sin(w * t[:, None] + phase)
    dq, ddq = amplitude * w * np.cos(w * t[:, None] + phase), -(w**2) * q
    tau = torques(robot.chain, robot.pi, q, dq, ddq) + 0.05 * truth.friction(dq, q)
    tau += 0.02 * np.random.default_rng(3).normal(size=tau.shape)
    tau[:, list(turned)] *= -1
    return Recording("closed_loop", 0, 0, 0, t, q, dq, tau)


@pytest.mark.parametrize("robot", [True, False], ids=["against the model", "alone"])
def test_a_joint_that_gravity_takes_energy_from_has_no_wrong_sign(tmp_path: Path, robot: bool) -> None:
    r = circling()
    power = (r.tau * r.dq).sum(axis=0) / np.abs(r.tau * r.dq).sum(axis=0)
    assert power.min() < -0.5, power  # as a real KUKA LWR's third joint: -98 %
    assert "wrong_sign" not in kinds(look(tmp_path, [r], robot=robot))
    for turned in ((1,), (2,)):
        found = look(tmp_path, [circling(turned)], robot=robot).findings
        assert [f.joint for f in found if f.kind == "wrong_sign"] == [JOINTS[j] for j in turned]


def test_torque_of_the_other_sign_at_all_joints_is_told_of_all(tmp_path: Path) -> None:
    found = [f for f in look(tmp_path, [circling((0, 1, 2))], robot=False).findings if f.kind == "wrong_sign"]
    assert [f.joint for f in found] == list(JOINTS)
    assert all("of all joints" in f.do for f in found)


@pytest.mark.parametrize("gravity", [(9.81, 0.0, 0.0), (0.0, 0.0, 9.81), (0.0, -6.9, -6.9)], ids=["wall", "ceiling", "ramp"])
def test_an_arm_that_is_mounted_otherwise_is_told_so(tmp_path: Path, gravity: tuple[float, float, float]) -> None:
    """As a real AR5 on a wall beside its URDF on the floor: a model of that was identified, with a note on its masses."""
    true = replace(arm(1.05, 0.003), chain=arm().chain._replace(gravity=np.array(gravity)))
    r = moving(Truth(true), 0, 30.0, 1.2, seed=2)
    found = look(tmp_path, [r]).findings
    (f,) = (f for f in found if f.severity == "error")
    assert f.kind == "mounting"
    said = np.array(json.loads(f.do[f.do.index("[") : f.do.index("]") + 1]))
    cos = said @ np.array(gravity) / np.linalg.norm(said) / np.linalg.norm(gravity)
    assert np.degrees(np.arccos(min(cos, 1.0))) < 3.0
    model = tmp_path / "m.json"
    (tmp_path / "robot.urdf").write_text(arm().urdf)
    ask = ["identify", "--robot", str(tmp_path / "robot.urdf"), "--data", str(tmp_path / "rec.parquet"), "--out", str(model)]
    assert main(ask) == 2 and not model.exists()
    (tmp_path / "robot.json").write_text(json.dumps({"gravity": list(said)}))
    robot = load_robot(tmp_path / "robot.urdf")
    assert mounting(robot, [r]) is None
    sound = moving(Truth(arm(1.05, 0.003)), 0, 30.0, 1.2, seed=2)
    for other in (arm(), arm(0.7, 0.02)):
        assert mounting(other, [sound]) is None, "a description that is off is no other mounting"


@pytest.mark.parametrize(
    ("factor", "word"), [(1000.0, "mN m"), (0.01, "gear ratio"), (0.001, "kN m")], ids=["mN m", "motor side", "kN m"]
)
def test_wrong_unit_of_torque(tmp_path: Path, trials: tuple[Recording, ...], factor: float, word: str) -> None:
    i = look(tmp_path, [replace(r, tau=r.tau * factor) for r in trials])
    found = [f for f in i.findings if f.kind == "wrong_unit" and "rigid body" in f.seen]
    assert "shoulder" in {f.joint for f in found}  # the joint that carries the arm; friction alone tells no unit
    assert all(word in f.seen for f in found), [f.seen for f in found]


def test_current_mistaken_for_torque(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    meta = replace(META, torque_constant=(14.0, 14.0, 14.0))
    i = look(tmp_path, [replace(r, tau=r.tau / 14.0) for r in trials], meta)
    found = [f for f in i.findings if f.kind == "wrong_unit"]
    assert found and all("ampere" in f.seen for f in found)


def test_degrees_are_refused_and_reported(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    i = look(tmp_path, [replace(r, q=np.degrees(r.q), dq=np.degrees(r.dq)) for r in trials])
    assert i.wrong
    assert "degrees" in (i.refused or "")


def test_degrees_of_a_small_motion_are_told_by_gravity(tmp_path: Path) -> None:
    """Within the limits and consistent with each other: only the torque says that 6 is not a bit less than a turn."""
    true = arm()
    small = []
    for r in campaign(Truth(true), seconds=6.0):
        if r.phase == "static":
            continue
        q = 0.04 * (r.q - r.q[:1]) + np.array([0.0, 0.04, 0.03])
        tau = torques(true.chain, true.pi, q, 0.04 * r.dq, 0 * q) + Truth(true).friction(0.04 * r.dq, 0 * q)
        small.append(replace(r, q=q, dq=0.04 * r.dq, tau=tau))
    assert "wrong_unit" not in kinds(look(tmp_path, small))
    i = look(tmp_path, [replace(r, q=np.degrees(r.q), dq=np.degrees(r.dq)) for r in small])
    assert i.refused is None  # no limit is left: the reader has no reason to doubt it
    assert [f.seen for f in i.findings if f.kind == "wrong_unit" and "degrees" in f.seen]
    assert i.wrong


def test_a_clock_that_runs_five_percent_fast_is_told(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    fast = [replace(r, t=0.96 * r.t) for r in trials]
    assert "rate" in kinds(look(tmp_path, fast))
    two = [replace(r, t=(0.98 if k % 2 else 1.0) * r.t) for k, r in enumerate(trials)]
    found = look(tmp_path, two)
    assert "clock_drift" in kinds(found)
    assert kinds(look(tmp_path, [replace(r, t=1.002 * r.t) for r in trials])) == set()


def test_stamps_in_milliseconds(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    i = look(tmp_path, [replace(r, t=r.t * 1000) for r in trials])
    assert "rate" in kinds(i)
    assert any("t in ms" in f.seen or "t is in ms" in f.seen for f in i.findings)


def test_what_is_missing_is_said(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    lacking = {m.part for m in look(tmp_path, [r for r in trials if r.phase != "static"][:1]).missing}
    assert {"gravity", "uncertainty sets X0, U", "thermal friction", "sets of STOP 1"} <= lacking
    assert any("STOP 0" in p for p in lacking)
    slow = [moving(Truth(arm()), 0, 8.0, 0.3, 1)]
    assert any(m.part == "friction over speed" for m in look(tmp_path, slow).missing)
    assert "gravity" not in {m.part for m in look(tmp_path, trials).missing}


def test_command_answers_and_exit_codes(
    tmp_path: Path, trials: tuple[Recording, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad = tmp_path / "good.parquet", tmp_path / "bad.parquet"
    write_recordings(good, META, trials)
    write_recordings(bad, META, [replace(r, tau=-r.tau) for r in trials])
    answer = tmp_path / "answer.json"
    assert main(["inspect", str(good)]) == 0
    told = capsys.readouterr().err
    assert "good.parquet: trials read" in told and "good.parquet: signals, stamps and torque" in told
    assert main(["inspect", str(good), "--quiet"]) == 0 and capsys.readouterr().err == ""
    assert main(["inspect", str(good), str(bad), "--json", str(answer), "--report", str(tmp_path / "look.html")]) == 1
    html = (tmp_path / "look.html").read_text()
    assert "wrong_sign" in html and "missing for identification" in html and "http" not in html.split("</script>")[-1]
    data = json.loads(answer.read_text())
    assert [f["usable"] for f in data["files"]] == [True, False]
    assert {f["kind"] for f in data["files"][1]["findings"]} >= {"wrong_sign"}
    assert data["files"][0]["phases"]["static"]["trials"] == 80
    (tmp_path / "none.parquet").write_bytes(b"")
    assert main(["inspect", str(tmp_path / "none.parquet")]) == 2
    assert main(["inspect", str(tmp_path / "absent.parquet")]) == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.shared
def test_shared_recordings_are_sound(shared_data: Callable[[str], Path]) -> None:
    for name in ("hidden_effect/d06", "hidden_effect/p05", "hidden_effect/p01"):
        folder = shared_data(name)
        (i,) = inspect_recordings([folder / "recording.parquet"], load_robot(folder / "robot.urdf"))
        assert kinds(i) == set(), [f.says for f in i.findings]
    folder = shared_data("ur10e")
    (i,) = inspect_recordings([folder / "identification.parquet"], load_robot(folder / "robot.urdf"))
    assert kinds(i) == {"clock_jitter", "rate"}, [f.says for f in i.findings]  # 94 Hz on average, called 100
    folder = shared_data("hidden_effect/p15")  # two drives whose torque is 40 ms late
    (i,) = inspect_recordings([folder / "recording.parquet"], load_robot(folder / "robot.urdf"))
    late = {f.joint: f.value for f in i.findings if f.kind == "torque_delay"}
    assert late == pytest.approx({"arm_joint_2": -0.04, "arm_joint_3": -0.04}, abs=0.002)


def test_one_fault_is_not_told_as_another(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    """A late dq loses no samples, lost samples delay no torque, and an arm at rest has no sign."""
    late = look(tmp_path, broken(trials, lambda r: replace(r, dq=np.vstack([r.dq[:1].repeat(12, axis=0), r.dq[:-12]]))))
    assert {"dq_lags", "dq_not_derivative"} & kinds(late) and "dropped_samples" not in kinds(late)
    lost = look(tmp_path, broken(trials, lambda r: drop(r, keep_stamps=False)))
    assert "dropped_samples" in kinds(lost) and "torque_delay" not in kinds(lost)
    rng = np.random.default_rng(0)
    rest = next(r for r in trials if r.phase != "static")
    q = rest.q[:1] + 1e-4 * (rng.random(rest.q.shape) < 0.1)
    still = replace(rest, q=q, dq=np.gradient(q, rest.t, axis=0), tau=np.where(rng.random(q.shape) < 0.5, -5.0, 5.0))
    for seed in range(5):
        tau = np.where(np.random.default_rng(seed).random(q.shape) < 0.5, -5.0, 5.0)
        assert "wrong_sign" not in kinds(look(tmp_path, [replace(still, tau=tau)]))
    against = replace(still, tau=-5.0 * np.sign(still.dq))  # each step of the encoder seems to take energy out
    assert "wrong_sign" not in kinds(look(tmp_path, [against]))


def test_a_late_torque_is_told_of_compensated_torque_too(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    meta = replace(META, effort="compensated_torque")
    robot = arm()

    def compensated(r: Recording, late: float) -> Recording:
        rest = np.zeros_like(r.q)
        u = r.tau - torques(robot.chain, robot.pi, r.q, rest, rest) - F_C * np.sign(r.dq)
        return replace(r, tau=np.column_stack([np.interp(r.t - late, r.t, x) for x in u.T]))

    moving_ones = [r for r in trials if r.phase != "static"]
    for late, expected in ((0.0, False), (0.03, True)):
        i = look(tmp_path, [compensated(r, late) for r in moving_ones], meta)
        assert ("torque_delay" in kinds(i)) == expected, [f.says for f in i.findings]


@pytest.mark.parametrize("factor", [1.05, 0.95, 1.015, 1.3])
def test_a_clock_that_runs_fast_or_slow_is_told_without_a_stated_rate(
    tmp_path: Path, trials: tuple[Recording, ...], factor: float
) -> None:
    unstated = replace(META, rate_hz=float("nan"))
    i = look(tmp_path, [replace(r, t=factor * r.t) for r in trials], unstated)
    (found,) = [f for f in i.findings if f.kind == "clock_scale"]
    assert found.severity == "error" and found.value == pytest.approx(factor, rel=2e-3)
    assert f"{'fast' if factor > 1 else 'slow'}" in found.seen and i.wrong
    # a calibration of one joint's speed is no clock
    scaled = look(tmp_path, [replace(r, dq=r.dq * [1.0, factor, 1.0]) for r in trials], unstated)
    assert [f.joint for f in scaled.findings if f.kind == "dq_scale"] == [JOINTS[1]] and "clock_scale" not in kinds(scaled)


def test_the_guarantee_counts_motions_not_suites_and_what_identification_holds_out(tmp_path: Path) -> None:
    """Two suites that start at two places of one motion are one independent motion, as for `identify`."""
    truth = Truth(arm())

    def suites(number: int) -> list[Recording]:
        out = []
        for k in range(number):
            long = moving(truth, k, 8.0, 0.8, seed=10 + k)
            out += [
                replace(long.cut(lo, lo + 1400), phase="open_loop", suite=2 * k + i, t=long.t[:1400], place=2 * k + i)
                for i, lo in enumerate((0, 400))
            ]
        return out

    def said(number: int) -> str:
        (need,) = [n for n in look(tmp_path, suites(number)).missing if n.part == "guarantee"]
        return need.says

    assert "2 independent open-loop motions, too few to hold any out" in said(2)
    assert "9 independent open-loop motions, of which 2 are held out: if none violates the sets, at most 77.6 % may" in said(9)


def test_a_joint_at_rest_is_no_swapped_column_however_long_it_rests(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    """Noise at standstill adds up over a campaign to more than a motion: its dq follows nothing and need not."""
    rng = np.random.default_rng(8)
    step = 2.0**-14

    def rested(r: Recording) -> Recording:
        q, dq = r.q.copy(), r.dq.copy()
        q[:, 2] = step * np.round(0.3 / step + rng.normal(0, 0.5, len(q)))
        dq[:, 2] = rng.normal(0, 1e-3, len(q))
        return replace(r, q=q, dq=dq)

    moving = [r for r in trials if r.phase != "static"]
    long = [replace(rested(r), trial=100 * k + r.trial) for k in range(10) for r in moving]
    assert "dq_not_derivative" not in kinds(look(tmp_path, long, robot=False))


def jumped(r: Recording, size: float, samples: int) -> Recording:
    q = r.q.copy()
    q[800 : 800 + samples, 1] += size
    return replace(r, q=q)


@pytest.mark.parametrize(
    ("size", "samples", "words"),
    [
        (1.0, 1, "2 times in all"),
        (0.3, 5, "2 times in all"),
        (0.2, 10_000, "an encoder was set anew"),
        (-2 * np.pi, 400, "unwrap"),
    ],
    ids=["one reading", "a few", "homed anew", "a turn"],
)
def test_a_reading_that_jumps_is_not_taken_for_swapped_columns(
    tmp_path: Path, trials: tuple[Recording, ...], size: float, samples: int, words: str
) -> None:
    moving_ones = [k for k, r in enumerate(trials) if r.phase != "static"]
    one = [jumped(r, size, samples) if k == moving_ones[0] else r for k, r in enumerate(trials)]
    i = look(tmp_path, one, robot=False)
    assert kinds(i) == {"jump"}, [f.says for f in i.findings]
    (f,) = [f for f in i.findings if f.kind == "jump"]
    assert f.joint == "shoulder" and f.value == pytest.approx(size, rel=0.02) and words in f.says
    assert f.seen.split(" at ")[1].startswith(f"{trials[moving_ones[0]].t[800]:.4g} s of ")
    with pytest.raises(RecordingError, match="make no model of this arm: shoulder: q jumps by"):
        check_signals(arm(), META, one)
    with pytest.raises(RecordingError, match="nothing is named from these recordings: shoulder: q jumps by"):
        diagnose(arm(), Recordings(META, tuple(one)))


@pytest.mark.parametrize("name", ["tau", "q"])
def test_a_channel_that_nobody_recorded(tmp_path: Path, trials: tuple[Recording, ...], name: str) -> None:
    def dead(r: Recording) -> Recording:
        x = getattr(r, name).copy()
        x[:, 1] = 0.0
        return replace(r, **{name: x})

    i = look(tmp_path, [dead(r) for r in trials], robot=False)
    assert "frozen" in kinds(i, "shoulder", ("error",)) and "frozen" not in kinds(i, "elbow"), [f.says for f in i.findings]


def test_a_pause_is_no_lost_samples_and_no_swapped_columns(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    def paused(r: Recording) -> Recording:
        keep = np.r_[0:500, 900 : len(r.t)]  # 1.6 s of motion that nobody recorded
        return replace(r, t=r.t[keep], q=r.q[keep], dq=r.dq[keep], tau=r.tau[keep])

    i = look(tmp_path, broken(trials, paused), robot=False)
    assert kinds(i) == {"pauses"}, [f.says for f in i.findings]
    with pytest.raises(RecordingError, match=r"nothing was recorded for 1.6.* s at most, .* times; .*: make two trials of it"):
        check_signals(arm(), META, broken(trials, paused))


def test_stamps_in_milliseconds_are_seen_though_nothing_moves(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    still = [replace(r, phase="closed_loop", t=1e3 * r.t, q=0 * r.q, dq=0 * r.dq) for r in trials if r.phase != "static"]
    i = look(tmp_path, still)
    assert "slow_rate" in kinds(i, severity=("error",)), [f.says for f in i.findings]
    with pytest.raises(RecordingError, match="is t in ms"):
        check_signals(arm(), META, still)


def test_a_motion_that_two_files_hold_is_named(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    moving = [r for r in trials if r.phase != "static"]
    for name, some in (("a", moving[:2]), ("b", [replace(moving[1], suite=40), *moving[2:]])):
        write_recordings(tmp_path / f"{name}.parquet", META, some)
    a, b = inspect_recordings([tmp_path / "a.parquet", tmp_path / "b.parquet"], arm())
    assert not a.wrong
    (found,) = [f for f in b.findings if f.kind == "copy"]
    assert b.wrong
    assert "suite 40" in found.seen
    assert "a.parquet" in found.seen


def test_a_description_that_is_not_this_arms_is_said_as_identify_says_it(tmp_path: Path, trials: tuple[Recording, ...]) -> None:
    """The first joint's zero a right angle off: no mass explains that."""
    write_recordings(tmp_path / "a.parquet", META, trials)
    assert "description" not in kinds(inspect_recordings([tmp_path / "a.parquet"], arm())[0], severity=("warning", "note"))
    turned = [replace(r, q=r.q + np.array([0.0, np.pi / 2, 0.0])) for r in trials]
    write_recordings(tmp_path / "b.parquet", META, turned)
    found = inspect_recordings([tmp_path / "b.parquet"], arm())[0].findings
    (said,) = [f for f in found if f.kind == "description"]
    (note,) = [x for x in solve_nominal(arm(), accumulate(arm(), turned, usual_friction())).notes if "CAD is contradicted" in x]
    assert f"{said.value:.1f} times" in said.seen
    assert f"{said.value:.1f} times" in note
    assert said.severity == "warning"
    assert "zeros and axes" in said.do


def test_a_joint_that_stands_in_other_trials_has_no_wrong_speed() -> None:
    """Its speed reads 0.004 rad/s beside zero there: of a real arm moved joint by joint `identify` said that columns were swapped."""
    t = np.arange(0.0, 60.0, 0.03)
    rng = np.random.default_rng(1)

    def trial(k: int, size: float) -> Recording:
        q = np.column_stack([size * np.sin(t), (0.5 - size) * np.sin(t)])
        dq = np.column_stack([size * np.cos(t), (0.5 - size) * np.cos(t)]) - 0.004 + 0.005 * rng.standard_normal((len(t), 2))
        return Recording("closed_loop", k, 0, k, t, np.round(q / 2e-5) * 2e-5, dq, np.ones_like(q))

    tally = SignalSums(2)
    for k in range(40):
        tally.add(trial(k, 0.02 if k == 20 else 0.0))
    assert not [f for f in velocity(tally, ("a", "b"), Meta(joints=("a", "b"))) if f.kind == "dq_not_derivative"]
    alone = SignalSums(2)
    alone.add(trial(0, 0.0))
    assert not [f for f in readings(alone, ("a", "b")) if f.joint == "a"], "an angle that stands is no frozen reading"
