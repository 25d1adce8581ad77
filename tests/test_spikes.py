"""A torque that stands out for one sample: left out and told where no motion answers it, told and held where one does."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import SHARED
from stopset.cli.main import main
from stopset.offline.campaign.survey import survey
from stopset.offline.description import robot_from_text
from stopset.offline.inspect import inspect_recordings
from stopset.recording import Recording, Recordings, read_recordings, stream_recordings, write_recordings
from stopset.recording.spikes import without_spikes
from stopset.simulation import prepare
from test_hidden_effects import ARM

AT = 700  # sample of the trials' middle


@pytest.fixture(scope="module")
def whole() -> Recordings:
    s = prepare(robot_from_text(ARM), ["none"], 3, "short")
    return Recordings(s.meta, tuple(r for r in s.recordings() if r.phase == "closed_loop" and len(r.t) > AT + 100))


def swift(r: Recording, joint: int) -> int:
    """A sample of the middle at which the joint moves fast."""
    return 100 + int(np.abs(r.dq[100:-100, joint]).argmax())


def spiked(data: Recordings, change: Callable[[Recording], Recording]) -> Recordings:
    first, *rest = data.trials
    return replace(data, trials=(change(first), *rest))


def off(r: Recording, k: int, joint: int, by: float, samples: int = 1) -> Recording:
    tau = r.tau.copy()
    tau[k : k + samples, joint] += by
    return replace(r, tau=tau)


def written(path: Path, data: Recordings) -> Path:
    write_recordings(path, data.meta, data)
    return path


def kinds(path: Path) -> dict[str, str]:
    return {f.kind: f.says for f in inspect_recordings([path])[0].findings}


def test_a_spike_in_mid_motion_is_a_lost_sample_and_told(tmp_path: Path, whole: Recordings) -> None:
    first = whole.trials[0]
    k = swift(first, 1)
    path = written(tmp_path / "r.parquet", spiked(whole, lambda r: off(r, k, 1, -170.0)))
    r = read_recordings(path).trials[0]
    assert len(r.t) == len(first.t) - 1 and first.t[k] not in r.t
    (spike,) = r.spikes
    assert (spike.joint, spike.t) == (1, pytest.approx(first.t[k])) and spike.size == pytest.approx(-170.0, abs=5.0)
    assert not any(x.spikes for x in read_recordings(path).trials[1:])
    assert len(next(stream_recordings(path, garbled=True)).t) == len(first.t), "a replay sends them as they were"
    said = kinds(path)["torque_spike"]
    assert f"{first.t[k]:.4g} s of {first.label}" in said and "lost" in said and "170 N m" in said


def test_what_the_motion_answers_is_no_spike(whole: Recordings) -> None:
    """A speed that steps at the torque: a blow, or a programme that is broken off."""
    r = whole.trials[0]
    k = swift(r, 1)
    dq = r.dq.copy()
    dq[k + 1 :, 0] -= 0.2
    assert without_spikes(off(r, k, 1, -170.0)).spikes and not without_spikes(replace(off(r, k, 1, -170.0), dq=dq)).spikes


def test_what_rings_is_no_spike(whole: Recordings) -> None:
    """As a Gen3's drive that catches up after samples were lost: 13 N m for one sample, then -2.4 and twice -5.7 N m."""
    r = whole.trials[0]
    k = swift(r, 1)
    first = off(r, k, 1, -170.0)
    assert without_spikes(first).spikes and not without_spikes(off(first, k + 2, 1, 70.0, 2)).spikes


@pytest.mark.parametrize("samples", [2, 5])
def test_what_lasts_is_no_spike(whole: Recordings, samples: int) -> None:
    r = whole.trials[0]
    assert not without_spikes(off(r, swift(r, 1), 1, -170.0, samples)).spikes


def test_a_torque_at_a_joint_that_stands_stays_and_is_told(tmp_path: Path, whole: Recordings) -> None:
    def standing(r: Recording) -> Recording:
        q, dq, tau = r.q.copy(), r.dq.copy(), r.tau.copy()
        q[:, 2], dq[:, 2] = q[0, 2], 0.0
        tau[AT, 2] += 90.0
        return replace(r, q=q, dq=dq, tau=tau)

    path = written(tmp_path / "r.parquet", spiked(whole, standing))
    r = read_recordings(path).trials[0]
    assert not r.spikes and len(r.t) == len(whole.trials[0].t)
    assert "torque_spike" not in kinds(path) and "one sample" in kinds(path)["torque_peak"]


def test_torque_that_often_stands_out_is_how_it_is(whole: Recordings) -> None:
    r = whole.trials[0]
    tau = r.tau.copy()
    tau[150:-150:100, 1] += 170.0
    assert not without_spikes(replace(r, tau=tau)).spikes


def test_nothing_is_left_out_of_a_healthy_arm(whole: Recordings) -> None:
    assert all(without_spikes(r) is r for r in whole)


def test_what_was_left_out_is_counted_by_the_survey(tmp_path: Path, whole: Recordings) -> None:
    """Identification and comparison read all files once more, only to tell it."""
    read = read_recordings(written(tmp_path / "r.parquet", spiked(whole, lambda r: off(r, swift(r, 1), 1, -170.0))))
    found = survey(lambda: iter(read.trials)).spikes
    assert len(found) == 1 and found == tuple((r.label, x) for r in read for x in r.spikes)


def test_every_command_says_what_it_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One garbled reading made the torque set of its joint as wide as itself, and nothing said so."""
    s = prepare(robot_from_text(ARM), ["none"], 3, "short")
    data = Recordings(s.meta, tuple(s.recordings()))
    (k, first) = next((k, r) for k, r in enumerate(data.trials) if r.phase == "open_loop")
    bad = off(first, swift(first, 1), 1, -170.0)
    record = written(tmp_path / "r.parquet", replace(data, trials=(*data.trials[:k], bad, *data.trials[k + 1 :])))
    urdf, out = tmp_path / "robot.urdf", tmp_path / "m.model.json"
    urdf.write_text(s.robot.urdf)
    (tmp_path / "robot.json").write_text(s.datasheet)
    assert main(["identify", "--robot", str(urdf), "--data", str(record), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "a torque stands out for one sample" in said
    assert main(["compare", str(out), "--data", str(record), "--json", str(tmp_path / "c.json")]) == 0
    answer = json.loads((tmp_path / "c.json").read_text())
    assert len(answer["left_out"]) == 1 and "lost ones" in answer["left_out"][0]
    lo, hi = answer["sets"][data.meta.joints[1]]["U"]
    assert hi - lo < 60.0
    assert "a torque stands out for one sample" in capsys.readouterr().out
    assert main(["diagnose", str(out), "--data", str(record)]) == 0
    assert "a torque stands out for one sample" in capsys.readouterr().out


@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not here")
def test_no_event_of_a_real_arm_is_taken_for_one() -> None:
    """A UR10e whose programme is broken off: up to 268 N m for one sample, as all joints stop within two."""
    for name in ("payload_a", "payload_b", "push", "validation"):
        path = SHARED / "ur10e" / f"{name}.parquet"
        assert not any(r.spikes for r in read_recordings(path)), name
    said = kinds(SHARED / "ur10e" / "payload_a.parquet")["torque_peak"]
    assert "53.37 s" in said and "174 N m" in said
