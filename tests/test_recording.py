"""Recordings: one format in, whatever the file's shape; nothing read differs from what was written."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest

import stopset.recording.files as files
from stopset.errors import RecordingError
from stopset.offline.campaign.source import campaign_of
from stopset.recording import Meta, Recording, read_meta, read_recordings, stream_recordings, write_recordings
from synthetic import arm, columns, meta, names, recordings, save, save_trials

JOINTS = names(3)
J, V = (2.0, 0.7, 0.3), (9.0, 4.0, 1.0)


@pytest.fixture(scope="module")
def trials() -> list[Recording]:
    out = recordings(J, V, suites=2, trials=3, seconds=0.4)
    return [
        dataclasses.replace(r.cut(0, len(r.t) - 7 * k), temp=np.full((len(r.t) - 7 * k, 3), 20.0 + k)) for k, r in enumerate(out)
    ]


def same(a: Recording, b: Recording, tolerance: float = 0.0) -> None:
    assert a.key == b.key
    assert a.place == b.place
    for name in ("t", "q", "dq", "tau", "temp", "current", "stop_trigger"):
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None), name
        if x is not None:
            np.testing.assert_allclose(x, y, rtol=0, atol=tolerance, err_msg=name)


# the writer keeps float32 of angles, speeds and torques below 32
FLOAT32 = 32 * 2.0**-24


def test_what_is_written_is_read(trials: list[Recording], tmp_path: Path) -> None:
    head = Meta(JOINTS, "planar", "compensated_torque", "derived", "assumed", 250.0)
    stopped = [dataclasses.replace(r, stop_trigger=r.t > 0.1, current=2 * r.tau) for r in trials]
    write_recordings(tmp_path / "a.parquet", head, stopped)
    got = read_recordings(tmp_path / "a.parquet")
    assert (got.meta.effort, got.meta.velocity, got.meta.clock, got.meta.rate_hz) == (
        "compensated_torque",
        "derived",
        "assumed",
        250.0,
    )
    assert got.meta.joints == JOINTS
    for a, b in zip(got, stopped, strict=True):
        same(a, b, FLOAT32)


def test_streaming_is_reading(trials: list[Recording], tmp_path: Path) -> None:
    path = save_trials(tmp_path / "a.parquet", trials, JOINTS)
    whole = read_recordings(path)
    for a, b in zip(stream_recordings(path), whole, strict=True):
        same(a, b)


@pytest.mark.parametrize("rows", [1, 7, 94, 101, 10_000])
def test_borders_of_batches_fall_anywhere(
    trials: list[Recording], tmp_path: Path, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(tmp_path / "a.parquet", columns(trials, JOINTS), meta(JOINTS), row_group_size=max(rows, 2))
    expected = read_recordings(path)
    monkeypatch.setattr(files, "BATCH_ROWS", rows)
    got = read_recordings(path)
    assert len(got) == len(trials)
    for a, b in zip(got, expected, strict=True):
        same(a, b)


def test_csv_with_its_metadata_beside_it_is_the_same_as_parquet(trials: list[Recording], tmp_path: Path) -> None:
    table = columns(trials, JOINTS)
    path = save(tmp_path / "a.parquet", table, meta(JOINTS))
    pacsv.write_csv(pa.table(table), tmp_path / "b.csv")
    (tmp_path / "b.json").write_text(json.dumps(meta(JOINTS)))
    a, b = read_recordings(path), read_recordings(tmp_path / "b.csv")
    assert dataclasses.replace(a.meta, sources=()) == dataclasses.replace(b.meta, sources=())
    for x, y in zip(a, b, strict=True):
        same(x, y, 1e-15)


def test_csv_without_metadata_is_taken_as_motor_torque_with_a_warning(trials: list[Recording], tmp_path: Path) -> None:
    pacsv.write_csv(pa.table(columns(trials, JOINTS)), tmp_path / "b.csv")
    got = read_meta(tmp_path / "b.csv")
    assert got.effort == "motor_torque"
    assert "taken as motor torque" in got.warnings[0]


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_times_of_day_are_seconds(trials: list[Recording], tmp_path: Path, unit: str) -> None:
    """As a table of dates writes them, into Parquet and as text."""
    table = pa.table(columns(trials, JOINTS))
    t = np.round(np.asarray(table["t"]) * 1e9).astype(np.int64) + 1_767_225_600 * 10**9  # the year 2026
    dated = table.set_column(
        table.column_names.index("t"), "t", pa.array(t.astype("datetime64[ns]")).cast(pa.timestamp(unit), safe=False)
    )
    pq.write_table(dated, tmp_path / "a.parquet")
    pacsv.write_csv(dated, tmp_path / "a.csv")
    for path in (tmp_path / "a.parquet", tmp_path / "a.csv"):
        for x, y in zip(read_recordings(path), trials, strict=True):
            np.testing.assert_allclose(
                x.t - 1_767_225_600, y.t, rtol=0, atol=1e-6
            )  # a double of seconds since 1970 holds 0.24 us
            assert np.array_equal(x.q, y.q)


def test_a_recording_given_twice_is_no_second_motion(trials: list[Recording], tmp_path: Path) -> None:
    a = save_trials(tmp_path / "a.parquet", trials, JOINTS)
    (tmp_path / "copy.parquet").write_bytes(a.read_bytes())
    for paths in ([a, a], [a, tmp_path / "copy.parquet"]):
        with pytest.raises(RecordingError, match="the same recording, byte for byte"):
            read_recordings(paths)
        with pytest.raises(RecordingError, match="the same recording, byte for byte"):
            campaign_of(arm(JOINTS), paths)


def test_currents_without_their_constants_are_refused_with_what_to_write(trials: list[Recording], tmp_path: Path) -> None:
    table = pa.table(columns(trials, JOINTS))
    pacsv.write_csv(
        table.rename_columns([f"i_{c[4:]}" if c.startswith("tau_") else c for c in table.column_names]), tmp_path / "a.csv"
    )
    with pytest.raises(RecordingError, match=r"has currents, i_.* beside it in a.json: .*motor_current.*torque_constant"):
        read_recordings(tmp_path / "a.csv")


def test_two_files_are_one_campaign(trials: list[Recording], tmp_path: Path) -> None:
    a = save_trials(tmp_path / "a.parquet", trials[:4], JOINTS)
    b = save_trials(tmp_path / "b.parquet", trials[4:], JOINTS)
    got = read_recordings([a, b])
    assert [r.place for r in got] == list(range(len(trials)))
    assert [name for name, _ in got.meta.sources] == ["a.parquet", "b.parquet"]
    for x, y in zip(got, trials, strict=True):
        assert np.array_equal(x.q, y.q)


def test_signals_come_in_the_robots_order_and_without_strangers(trials: list[Recording], tmp_path: Path) -> None:
    order = (JOINTS[2], "gripper", JOINTS[0], JOINTS[1])
    table = columns(trials, JOINTS)
    for name in ("q", "dq", "tau"):
        table[f"{name}_gripper"] = np.full(len(table["t"]), 0.01)
    path = save(tmp_path / "a.parquet", dict(reversed(table.items())), meta(order))
    got = read_recordings(path, arm(JOINTS))
    assert got.meta.joints == JOINTS
    for x, y in zip(got, trials, strict=True):
        for name in ("q", "dq", "tau"):
            assert np.array_equal(getattr(x, name), getattr(y, name))
    assert read_recordings(path).trials[0].q.shape[1] == 4


def test_torque_constants_follow_their_joints(trials: list[Recording], tmp_path: Path) -> None:
    """The metadata's order of joints need not be the robot's."""
    constants = {JOINTS[0]: 2.0, JOINTS[1]: 3.0, JOINTS[2]: 5.0}
    table = columns(trials, JOINTS)
    for j in JOINTS:
        table[f"i_{j}"] = table.pop(f"tau_{j}") / constants[j]
    order = tuple(reversed(JOINTS))
    path = save(tmp_path / "a.parquet", table, meta(order, "motor_current", torque_constant=[constants[j] for j in order]))
    for x, y in zip(read_recordings(path, arm(JOINTS)), trials, strict=True):
        np.testing.assert_allclose(x.tau, y.tau, rtol=1e-15)


def test_phases_stored_as_categories(trials: list[Recording], tmp_path: Path) -> None:
    table = {k: pa.array(v) for k, v in columns(trials, JOINTS).items()}
    table["phase"] = table["phase"].dictionary_encode()
    pq.write_table(pa.table(table).replace_schema_metadata({"recording": json.dumps(meta(JOINTS))}), tmp_path / "a.parquet")
    assert len(read_recordings(tmp_path / "a.parquet")) == len(trials)


def test_one_trial_at_a_time_in_memory(tmp_path: Path) -> None:
    """Peak memory of streaming does not grow with the file."""
    import tracemalloc

    r = recordings((2.0,), (4.0,), suites=1, trials=1, seconds=2.0)[0]

    def peak(count: int) -> int:
        path = tmp_path / f"{count}.parquet"
        write_recordings(path, Meta(names(1)), (dataclasses.replace(r, trial=k, tau=r.tau + k) for k in range(count)))
        tracemalloc.start()
        assert sum(1 for _ in stream_recordings(path)) == count
        top = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return top

    peak(2)
    assert peak(400) < 1.5 * peak(200) + 1_000_000


def test_a_robot_with_a_joint_the_file_lacks(trials: list[Recording], tmp_path: Path) -> None:
    path = save_trials(tmp_path / "a.parquet", trials, JOINTS)
    with pytest.raises(RecordingError, match="do not belong together"):
        read_recordings(path, arm(names(4)))


def test_cut_and_grouping(trials: list[Recording], tmp_path: Path) -> None:
    got = read_recordings(save_trials(tmp_path / "a.parquet", trials, JOINTS))
    assert set(got.suites) == {(0, "open_loop", 0, 0), (0, "open_loop", 1, 0)}
    assert got.phases == ("open_loop",)
    assert len(got.phase("stop0")) == 0
    assert got.samples == sum(len(r.t) for r in trials)
    r = got.trials[0].cut(3, 9)
    assert len(r.t) == 6
    assert np.array_equal(r.dq, trials[0].dq[3:9])


def as_found(trials: list[Recording], path: Path, without: tuple[str, ...] = ()) -> str:
    """A table of numbers as a tool exports it, as CSV text, and so written to ``path``."""
    table = {k: v for k, v in columns(trials, JOINTS).items() if k not in without and not k.startswith("temp")}
    pacsv.write_csv(pa.table(table), path, pacsv.WriteOptions(quoting_style="none"))
    return path.read_text()


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", ","), ("\t", ".")])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_csv_is_read_as_tools_write_it(
    trials: list[Recording], tmp_path: Path, separator: str, decimal: str, encoding: str
) -> None:
    text = as_found(trials, tmp_path / "a.csv")
    header, rows = text.split("\n", 1)
    other = "# made by hand\n" + header.replace(",", f"{separator} ") + "\n" + rows.replace(",", separator).replace(".", decimal)
    (tmp_path / "b.csv").write_bytes(other.replace("\n", "\r\n").encode(encoding))
    for a, b in zip(read_recordings(tmp_path / "a.csv"), read_recordings(tmp_path / "b.csv"), strict=True):
        same(a, b)


def test_text_that_is_not_unicode_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes("t,q_Grünarm\n0,0\n".encode("latin-1"))
    with pytest.raises(RecordingError, match=r"a\.csv is no text in UTF-8 .*; expected a CSV table: export it as UTF-8"):
        read_meta(tmp_path / "a.csv")


def test_an_arm_that_stands_still_at_first_is_read_though_its_numbers_are_whole(tmp_path: Path) -> None:
    """Types of a CSV table are read off its first megabyte: speeds of 0 there are no whole numbers."""
    rows, still = 120_000, 80_000
    lines = ["t,q_a,dq_a,tau_a,temp_a"]
    for k in range(rows):
        lines.append(f"{k}e-3,0,0,0," if k < still else f"{k}e-3,{1e-6 * (k - still)},0.001,0.25,")
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines) + "\n")
    assert path.stat().st_size > 1 << 20
    (r,) = read_recordings(path)
    assert len(r.t) == rows and r.temp is None and r.tau[still - 1, 0] == 0 and r.tau[still, 0] == 0.25 and r.dq[-1, 0] == 0.001


@pytest.mark.parametrize("rows", [7, 94, 10_000])
def test_where_no_column_says_so_the_clock_tells_trials(
    trials: list[Recording], tmp_path: Path, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each trial's clock begins anew; in a second file it goes on, after a pause."""
    monkeypatch.setattr(files, "BATCH_ROWS", rows)
    for name, begin in (("anew", np.zeros(len(trials))), ("on", 5.0 * np.arange(len(trials)))):
        shifted = [dataclasses.replace(r, t=r.t + b, temp=None) for r, b in zip(trials, begin, strict=True)]
        table = {k: v for k, v in columns(shifted, JOINTS).items() if k not in ("phase", "suite", "trial")}
        got = read_recordings(save(tmp_path / f"{name}.parquet", table, meta(JOINTS)))
        assert [(r.phase, r.suite, r.trial) for r in got] == [("closed_loop", 0, k) for k in range(len(trials))]
        for a, b in zip(got, shifted, strict=True):
            assert np.array_equal(a.t, b.t) and np.array_equal(a.q, b.q)
        assert "a trial wherever t goes back or rests for 1 s" in " ".join(got.meta.warnings)


def test_speeds_that_nobody_recorded_are_differences_of_angles(trials: list[Recording], tmp_path: Path) -> None:
    as_found(trials, tmp_path / "a.csv", tuple(f"dq_{j}" for j in JOINTS))
    got = read_recordings(tmp_path / "a.csv")
    assert (
        got.meta.velocity == "derived" and "a.csv has no dq_: speeds are differences of neighbouring angles" in got.meta.warnings
    )
    for a, b in zip(got, trials, strict=True):
        assert np.array_equal(a.dq, np.gradient(a.q, a.t, axis=0)) and np.abs(a.dq - b.dq).max() < 0.05 * np.abs(b.dq).max()
    as_found(trials, tmp_path / "b.csv", (f"dq_{JOINTS[1]}",))
    with pytest.raises(RecordingError, match=f"column dq_{JOINTS[1]} missing"):
        read_meta(tmp_path / "b.csv")


def test_the_torque_that_is_missing_is_named(trials: list[Recording], tmp_path: Path) -> None:
    as_found(trials, tmp_path / "a.csv", (f"tau_{JOINTS[2]}",))
    with pytest.raises(RecordingError, match=f"no tau_{JOINTS[2]}, and no metadata"):
        read_meta(tmp_path / "a.csv")
