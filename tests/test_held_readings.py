"""A logger that writes faster than its robot answers: every reading is taken once, at the robot's pace."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.cli.main import main
from stopset.offline.description import robot_from_text
from stopset.offline.inspect import inspect_recordings
from stopset.recording import Recording, Recordings, read_recordings, write_recordings
from stopset.recording.held import each_once
from stopset.simulation import prepare
from test_hidden_effects import ARM


@pytest.fixture(scope="module")
def whole() -> Recordings:
    s = prepare(robot_from_text(ARM), ["none"], 3, "short")
    return Recordings(s.meta, tuple(r for r in s.recordings() if r.phase in ("closed_loop", "open_loop")))


def held(r: Recording, rows: float, *, of_rows: bool = False) -> Recording:
    """``r`` as a logger writes it that asks ``rows`` times a reading; ``of_rows``: with speeds taken from its rows."""
    h = float(np.median(np.diff(r.t))) / rows
    own = np.arange(int((len(r.t) - 1) * rows))
    out = replace(r.rows((own / rows + 1e-9).astype(np.intp)), t=r.t[0] + h * own)
    return replace(out, dq=np.diff(out.q, axis=0, prepend=out.q[:1]) / h) if of_rows else out


@pytest.mark.parametrize("rows", [2.0, 2.4, 3.0, 5.0])
def test_readings_are_taken_once_at_the_pace_of_the_robot(whole: Recordings, rows: float) -> None:
    for r in whole:
        h = float(np.median(np.diff(r.t)))
        out = each_once(held(r, rows))
        assert abs(out.held / rows - 1) < 0.05
        assert abs(np.median(np.diff(out.t)) / h - 1) < 0.01 and abs(len(out.t) - len(r.t)) <= 3
        at = np.array([int(np.flatnonzero((r.q == q).all(axis=1))[0]) for q in out.q[1:-1]])
        off = (out.t[1:-1] - r.t[at])[np.abs(r.dq[at]).max(axis=1) > 0.1]
        assert np.ptp(off) < 1.5 * h / rows, "every reading at its own time but for when it was written"


def test_speeds_that_were_taken_from_rows_are_derived_anew(whole: Recordings) -> None:
    for r in whole:
        out = each_once(held(r, 3.0, of_rows=True))
        slope = np.gradient(out.q, out.t, axis=0)
        assert np.abs(out.dq - slope).max() == 0.0
    measured = each_once(held(whole.trials[0], 3.0))
    assert {tuple(x) for x in measured.dq.tolist()} <= {tuple(x) for x in whole.trials[0].dq.tolist()}, "measured ones stay"


def test_what_is_not_held_stays_as_it_is(whole: Recordings) -> None:
    for r in whole:
        assert each_once(r) is r
    r = whole.trials[0]
    rest = replace(r, q=np.repeat(r.q[:1], len(r.t), axis=0), dq=np.zeros_like(r.dq), tau=np.repeat(r.tau[:1], len(r.t), axis=0))
    assert each_once(rest) is rest
    # a coarse encoder whose one joint turns evenly passes its marks evenly
    even = rest.q.copy()
    even[:, 0] = np.floor(np.arange(len(r.t)) / 4) * 1e-3
    alone = replace(rest, q=even)
    assert each_once(alone) is alone


def test_a_rest_is_kept_and_a_stop_begins_with_the_reading_it_was_asked_in(whole: Recordings) -> None:
    r = whole.trials[0]
    stands = np.r_[np.arange(300), np.full(200, 299), np.arange(300, len(r.t))]
    q = replace(r.rows(stands), t=r.t[0] + np.arange(len(stands)) * float(np.median(np.diff(r.t))))
    log = held(q, 3.0)
    asked = int(np.searchsorted(log.t, log.t[0] + 0.5 * (log.t[-1] - log.t[0]))) // 3 * 3 + 4  # the second of three rows
    out = each_once(replace(log, stop_trigger=np.arange(len(log.t)) >= asked))
    assert abs(len(out.t) - len(q.t)) <= 3
    assert out.stop_trigger is not None
    begins = out.t[np.argmax(out.stop_trigger)]
    assert log.t[asked] - 3 * (log.t[1] - log.t[0]) <= begins <= log.t[asked] + 1e-9


def test_every_command_says_it_and_names_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    s = prepare(robot_from_text(ARM), ["none"], 3, "short")
    data = Recordings(
        s.meta, tuple(held(r, 3.0, of_rows=True) if r.phase in ("closed_loop", "open_loop") else r for r in s.recordings())
    )
    record, urdf, out = tmp_path / "r.parquet", tmp_path / "robot.urdf", tmp_path / "m.model.json"
    write_recordings(record, data.meta, data)
    urdf.write_text(s.robot.urdf)
    (tmp_path / "robot.json").write_text(s.datasheet)
    assert max(r.held for r in read_recordings(record)) == pytest.approx(3.0, abs=0.05)
    findings = inspect_recordings([record])[0].findings
    assert any(f.kind == "held_readings" and "stands in 3 rows" in f.says for f in findings)
    assert not [f.says for f in findings if f.severity == "error"]
    assert main(["identify", "--robot", str(urdf), "--data", str(record), "--out", str(out)]) == 0
    assert "stands in 3 rows" in capsys.readouterr().out
    assert main(["compare", str(out), "--data", str(record), "--json", str(tmp_path / "c.json")]) == 0
    assert any("stands in 3 rows" in text for text in json.loads((tmp_path / "c.json").read_text())["left_out"])
    assert main(["diagnose", str(out), "--data", str(record), "--json", str(tmp_path / "d.json")]) == 0
    assert json.loads((tmp_path / "d.json").read_text())["ranked_effects"] == []
