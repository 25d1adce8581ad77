"""Rows as loggers write them: a message twice, one without numbers, stamps that repeat, rows out of order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from stopset.cli.main import main
from stopset.errors import RecordingError
from stopset.offline.inspect import inspect_recordings
from stopset.recording import Meta, Recording, read_recordings, write_recordings
from stopset.recording.rows import UNREAD, sound_rows

META = Meta(joints=("a", "b"))
N = 1000


def swinging() -> Recording:
    t = np.arange(N) * 0.01
    q = np.column_stack([np.sin(t), np.cos(1.3 * t)])
    dq = np.column_stack([np.cos(t), -1.3 * np.sin(1.3 * t)])
    tau = 3.0 * np.column_stack([np.sin(2 * t), np.cos(2 * t)]) + 1.0
    return Recording("closed_loop", 0, 0, 0, t, q, dq, tau)


def written(tmp_path: Path, change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]) -> Path:
    """The recording, its columns changed."""
    path = tmp_path / "rec.parquet"
    write_recordings(path, META, [swinging()])
    table = pq.read_table(path)
    columns = change({c: table[c].to_numpy() for c in table.column_names})
    pq.write_table(pa.table(columns).replace_schema_metadata(table.schema.metadata), path)
    return path


def kinds(path: Path) -> dict[str, str]:
    return {f.kind: f.seen for f in inspect_recordings([path])[0].findings}


def test_a_message_that_was_logged_twice_counts_once(tmp_path: Path) -> None:
    rows = np.sort(np.r_[np.arange(N), np.arange(0, N, 50), 0])  # one of them three times
    path = written(tmp_path, lambda c: {k: v[rows] for k, v in c.items()})
    (r,) = read_recordings(path).trials
    once = swinging()
    assert np.array_equal(r.t, once.t) and np.array_equal(r.q, once.q.astype(np.float32)) and len(r.tau) == N
    assert r.twice == len(rows) - N and r.unread == 0
    assert kinds(path)["rows_twice"].startswith(f"{len(rows) - N} rows") and not inspect_recordings([path])[0].wrong


@pytest.mark.parametrize("column", ["t", "q_a", "dq_b", "tau_b"])
def test_a_row_without_a_number_is_a_lost_sample(tmp_path: Path, column: str) -> None:
    lost = [0, 100, 101, 500, N - 1]

    def holes(c: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        x = c[column].copy()
        x[lost] = np.nan
        x[500] = np.nan if column == "t" else np.inf
        return c | {column: x}

    path = written(tmp_path, holes)
    (r,) = read_recordings(path).trials
    assert np.array_equal(r.t, np.delete(swinging().t, lost)) and r.unread == len(lost)
    assert all(np.isfinite(x).all() for x in (r.q, r.dq, r.tau))
    found = kinds(path)
    assert found["unread_samples"].startswith("5 rows") and found["dropped_samples"].startswith("3 samples")


def test_a_channel_that_often_lacks_numbers_is_refused(tmp_path: Path) -> None:
    def holes(c: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        x = c["tau_b"].copy()
        x[7 : 8 + round(UNREAD * N)] = np.nan
        return c | {"tau_b": x}

    with pytest.raises(
        RecordingError, match="tau_b is nan at row 7 of closed_loop suite 0 trial 0, and 11 of its 1000 rows are so"
    ):
        read_recordings(written(tmp_path, holes))


def test_speeds_that_nobody_recorded_are_those_of_the_rows_that_are_kept(tmp_path: Path) -> None:
    def holes(c: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        x = c["q_a"].copy()
        x[300] = np.nan
        return {k: v for k, v in (c | {"q_a": x}).items() if not k.startswith("dq_")}

    (r,) = read_recordings(written(tmp_path, holes)).trials
    assert len(r.t) == N - 1 and np.abs(r.dq - np.delete(swinging().dq, 300, axis=0))[1:-1].max() < 1e-3


def test_one_lost_sample_of_a_clock_printed_to_its_period_is_not_made_even(tmp_path: Path) -> None:
    path = written(tmp_path, lambda c: {k: np.delete(v, 300) for k, v in c.items()})
    (r,) = read_recordings(path).trials
    assert r.rounded == 0.0 and np.array_equal(r.t, np.delete(swinging().t, 300))
    slow = 0.010015 * np.arange(N)  # no sample lost, but a print that jumps once or twice
    path = written(tmp_path, lambda c: c | {"t": np.round(slow, 2)})
    (r,) = read_recordings(path).trials
    assert r.rounded == 0.01 and np.ptp(r.t - slow) < 0.002


def test_rows_of_one_stamp_and_other_readings_are_refused_for_what_they_are(tmp_path: Path) -> None:
    def repeated(c: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        t = c["t"] + 0.002 * np.random.default_rng(1).random(N)
        t[10:40:10] = t[9:39:10]
        return c | {"t": t}

    with pytest.raises(RecordingError, match=r"two different samples are stamped 0.09.* s at row 10 .*, 3 times in all"):
        read_recordings(written(tmp_path, repeated))


def test_what_could_not_be_read_says_nothing_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def mixed(c: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return c | {"trial": np.arange(N) % 2}

    path = written(tmp_path, mixed)
    assert main(["inspect", str(path)]) == 1
    said = capsys.readouterr().out
    assert "are its rows together? sort them by phase, suite, trial and t" in said and "missing for identification" not in said


def test_torque_of_few_digits_is_no_torque_that_clips(tmp_path: Path) -> None:
    path = written(tmp_path, lambda c: c | {"tau_a": np.round(c["tau_a"] / 2) * 2})
    found = kinds(path)
    assert found["coarse_torque"] == "the torque takes 3 sizes only" and "saturated" not in found
    clipped = written(tmp_path, lambda c: c | {"tau_a": np.clip(c["tau_a"], -2.0, 2.0)})
    assert "saturated" in kinds(clipped)


def test_rows_are_compared_with_the_one_kept_before() -> None:
    t = np.r_[0.0, 1.0, np.nan, 1.0, 2.0, np.arange(3.0, 300.0)]
    x = np.arange(len(t), dtype=float)[:, None]
    x[3] = x[1]
    rows = sound_rows(t, [x])
    assert rows.twice == 1 and rows.unread == 1 and list(np.flatnonzero(~rows.rows)) == [2, 3]
    assert sound_rows(replace(swinging()).t, [swinging().q]).rows.all()
