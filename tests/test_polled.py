"""A logger that asks at its own pace: readings written again and passed over are told and put back on the robot's clock."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import SHARED
from stopset.cli.main import main
from stopset.offline.description import robot_from_text
from stopset.offline.inspect import inspect_recordings
from stopset.recording import Recording, Recordings, read_recordings, stream_recordings, write_recordings
from stopset.recording.polled import on_its_clock
from stopset.simulation import prepare
from test_hidden_effects import ARM

FASTER = 1.004  # times the logger's pace, of the arm that is asked


@pytest.fixture(scope="module")
def whole() -> Recordings:
    s = prepare(robot_from_text(ARM), ["none"], 3, "short")
    return Recordings(s.meta, tuple(r for r in s.recordings() if r.phase in ("closed_loop", "open_loop")))


def asked(r: Recording, seed: int, pace: float = FASTER) -> Recording:
    """What a logger holds that asks every period of its own for the last reading, now and then a little late."""
    h = float(np.median(np.diff(r.t)))
    own = 0.5 + np.arange(int((len(r.t) - 1) / pace)) * pace
    late = np.random.default_rng(seed).normal(0.0, 0.03, len(own))
    return replace(r.rows(np.clip((own + late).astype(np.intp), 0, len(r.t) - 1)), t=r.t[0] + h * np.arange(len(own)))


def missed(r: Recording) -> float:
    """[rad] by which steps of the angles miss those of the speeds, root mean square."""
    dt = np.diff(r.t)[:, None]
    return float(np.sqrt(np.mean((np.diff(r.q, axis=0) - 0.5 * (r.dq[1:] + r.dq[:-1]) * dt) ** 2)))


@pytest.mark.parametrize("derived", [False, True])
@pytest.mark.parametrize("pace", [FASTER, 1.0, 1.0 / FASTER])
def test_steps_tell_the_clock_of_the_robot(whole: Recordings, pace: float, derived: bool) -> None:
    for seed, r in enumerate(whole):
        made = asked(r, seed, pace)
        if derived:
            made = replace(made, dq=np.gradient(made.q, made.t, axis=0))
        out = on_its_clock(made, derived=derived)
        if out is made:
            continue
        # which readings of the arm those left are
        at = np.searchsorted(r.q[:, 0], [])
        at = np.array([int(np.flatnonzero((r.q == q).all(axis=1))[0]) for q in out.q])
        moving = np.abs(r.dq[at]).max(axis=1) > 0.1
        told, true = np.diff(out.t) / np.median(np.diff(out.t)), np.diff(at)
        wrong = (np.abs(told - true) > 0.1) & moving[1:] & moving[:-1]
        assert wrong.sum() <= (0.05 if derived else 0.01) * len(true), (pace, int(wrong.sum()))
        if not derived:
            assert missed(out) < 0.5 * missed(made)


@pytest.mark.parametrize(("stamped", "kind"), [(True, "uneven_readings"), (False, "dropped_samples")])
def test_a_slower_logger_that_stamps_what_it_reads_has_lost_no_time(
    whole: Recordings, tmp_path: Path, stamped: bool, kind: str
) -> None:
    """R-1548: of a small arm, read at 195 Hz while it told its state at some 230, samples were "lost and the stamps made up": an error."""
    pace = 1.15
    trials = [asked(r, k, pace) for k, r in enumerate(whole)]
    if stamped:
        trials = [replace(r, t=r.t[0] + pace * (r.t - r.t[0])) for r in trials]
    write_recordings(tmp_path / "slow.parquet", whole.meta, trials)
    found = inspect_recordings([tmp_path / "slow.parquet"])[0].findings
    told = {f.kind: f.severity for f in found if f.kind in ("uneven_readings", "dropped_samples")}
    assert told == {kind: "warning" if stamped else "error"}


def test_most_trials_are_told(whole: Recordings) -> None:
    found = [on_its_clock(asked(r, k)) for k, r in enumerate(whole)]
    assert sum(r.again > 0 and r.skipped > 0 for r in found) > 0.8 * len(found)


def test_a_sound_recording_stays_as_it_is(whole: Recordings) -> None:
    for r in whole:
        assert on_its_clock(r) is r
        derived = replace(r, dq=np.gradient(r.q, r.t, axis=0))
        assert on_its_clock(derived, derived=True) is derived


def test_an_arm_that_stands_or_is_stopped_repeats_nothing(whole: Recordings) -> None:
    """Rests repeat readings, too; a joint that hits something makes one step of another length."""
    r = whole.trials[0]
    rest = replace(r, q=np.repeat(r.q[:1], len(r.t), axis=0), dq=np.zeros_like(r.dq), tau=np.repeat(r.tau[:1], len(r.t), axis=0))
    assert on_its_clock(rest) is rest
    q = r.q.copy()
    for k in range(100, len(q), 150):  # one joint alone
        q[k:, 1] += r.dq[k, 1] * float(np.median(np.diff(r.t)))
    assert on_its_clock(replace(r, q=q)).skipped == 0


def test_every_command_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    s = prepare(robot_from_text(ARM), ["none"], 3, "short")
    data = Recordings(s.meta, tuple(asked(r, r.place) if r.phase in ("closed_loop", "open_loop") else r for r in s.recordings()))
    record, urdf, out = tmp_path / "r.parquet", tmp_path / "robot.urdf", tmp_path / "m.model.json"
    write_recordings(record, data.meta, data)
    urdf.write_text(s.robot.urdf)
    (tmp_path / "robot.json").write_text(s.datasheet)
    raw, read = list(stream_recordings(record, garbled=True)), read_recordings(record).trials
    assert sum(len(r.t) for r in raw) > sum(len(r.t) for r in read), "a replay sends them as they were"
    findings = inspect_recordings([record])[0].findings
    said = next(f.says for f in findings if f.kind == "repeated_samples")
    assert f"{sum(r.again for r in read)} samples repeat" in said and "its own pace" in said
    # in its slowest motions a few steps stay as they were
    wrong = [f.says for f in findings if f.severity == "error"]
    assert all("steps of q" in text and int(text.split()[0]) <= 5 for text in wrong), wrong
    assert main(["identify", "--robot", str(urdf), "--data", str(record), "--out", str(out)]) == 0
    assert "its own pace" in capsys.readouterr().out
    assert main(["compare", str(out), "--data", str(record), "--json", str(tmp_path / "c.json")]) == 0
    assert any("its own pace" in text for text in json.loads((tmp_path / "c.json").read_text())["left_out"])
    capsys.readouterr()
    assert main(["diagnose", str(out), "--data", str(record), "--json", str(tmp_path / "d.json")]) == 0
    assert "its own pace" in capsys.readouterr().out
    assert json.loads((tmp_path / "d.json").read_text())["ranked_effects"] == []


@pytest.mark.skipif(not SHARED.exists(), reason="the shared recordings are not here")
def test_real_recordings_on_a_clock_of_their_own_stay_as_they_are() -> None:
    for path in (
        SHARED / "ur10e" / "identification.parquet",
        SHARED / "ur10e" / "push.parquet",
        SHARED / "ur10" / "exciting.parquet",
    ):
        assert not any(r.again or r.skipped for r in read_recordings(path)), path
    path = SHARED / "panda_30hz.parquet"
    (panda,) = read_recordings(path)
    assert panda.again > 0
    # its stamps come at 30 Hz, as it says, though the robot answers at 29.4 Hz
    assert "rate" not in {f.kind for f in inspect_recordings([path])[0].findings}
