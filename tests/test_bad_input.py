"""Bad input through the real command line: one clear sentence, exit code 2, nothing written, nothing changed."""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from stopset.artifact import SCHEMA_VERSION
from stopset.cli.main import main
from stopset.errors import OutputError
from stopset.files import replacing, write_bytes, write_text
from synthetic import columns, meta, names, recordings, save, urdf

JOINTS = names(2)
# every message tells what to do or what was expected in one of these words
MEND = (
    "expected", "give", "choose", "create", "convert", "identify again", "restore", "free space", "add ", "record", "copy",
    "run ", "remove", "sort", "make them agree", "change", "check ",
)  # fmt: skip


def stopset(
    arguments: Sequence[str | Path], cwd: Path, before: Callable[[], None] | None = None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "stopset.cli.main", *map(str, arguments)],
        cwd=cwd, capture_output=True, text=True, timeout=600, preexec_fn=before, check=False,
    )  # fmt: skip


def in_process(arguments: Sequence[str | Path], cwd: Path) -> subprocess.CompletedProcess[str]:
    """The same without a process of its own: for the many cases that end in the same place as one that has it."""
    out, err = io.StringIO(), io.StringIO()
    here = Path.cwd()
    os.chdir(cwd)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main([str(a) for a in arguments])
    except SystemExit as e:
        code = int(e.code or 0)
    finally:
        os.chdir(here)
    return subprocess.CompletedProcess([], code, out.getvalue(), err.getvalue())


def snapshot(folder: Path) -> dict[str, bytes | None]:
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


def refused(
    arguments: Sequence[str | Path], cwd: Path, *words: str, alone: bool = True, before: Callable[[], None] | None = None
) -> str:
    """Run (``alone``: as a process), and hold the promise of every command; returns the sentence."""
    was = snapshot(cwd)
    done = stopset(arguments, cwd, before) if alone or before else in_process(arguments, cwd)
    assert done.returncode == 2, done.stderr
    sentence = [line for line in done.stderr.splitlines() if not line.startswith("[")]  # progress is no message
    assert 1 <= len(sentence) <= 3, done.stderr
    text = " ".join(sentence)
    assert "Traceback" not in done.stderr
    assert text.startswith("stopset: ")
    assert any(word in text for word in MEND), f"says not what to do: {text}"
    for word in words:
        assert word in text, text
    assert snapshot(cwd) == was
    return text


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """A folder with a robot, a sound recording and an older model file that must survive."""
    (tmp_path / "robot.urdf").write_text(urdf(JOINTS))
    save(tmp_path / "rec.parquet", table(), meta(JOINTS))
    (tmp_path / "out.model.json").write_text("the model of yesterday")
    return tmp_path


def table() -> dict[str, np.ndarray]:
    return columns(recordings((2.0, 0.7), (9.0, 4.0), suites=2, trials=2, seconds=0.4), JOINTS)


def identify(data: str | Path, robot: str | Path = "robot.urdf", out: str | Path = "out.model.json") -> list[str | Path]:
    return ["identify", "--robot", robot, "--data", data, "--out", out]


# ---- recordings


def _without(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {k: v for k, v in t.items() if k != "dq_axis_2"}


def _backwards(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    t["t"][40], t["t"][41] = t["t"][41], t["t"][40]
    return t


def _nan(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    t["dq_axis_1"][17:30] = np.nan  # one alone would be a lost sample
    return t


def _degrees(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return t | {k: np.rad2deg(v) for k, v in t.items() if k.startswith(("q_", "dq_"))}


def _no_rows(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {k: v[:0] for k, v in t.items()}


def _torn(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    t["trial"][60:63] = 1
    return t


def _words_for_time(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return t | {"t": np.array([f"{x:.3f} s" for x in t["t"]])}


def _half_suites(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return t | {"suite": t["suite"] + 0.5}


def _words_for_angles(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return t | {"q_axis_1": np.array([f"{x:.3f}" for x in t["q_axis_1"]])}


def _unknown_phase(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return t | {"phase": np.full(len(t["t"]), "holiday")}


def _only_static(t: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return t | {"phase": np.full(len(t["t"]), "static")}


SPOILED: dict[str, tuple[Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]], tuple[str, ...]]] = {
    "missing column": (_without, ("dq_axis_2", "missing")),
    "time going backwards": (_backwards, ("time goes from", "increasing")),
    "not a number": (_nan, ("dq_axis_1", "nan", "row 17")),
    "degrees": (_degrees, ("rad", "degrees")),
    "no rows": (_no_rows, ("no rows",)),
    "a trial in two pieces": (_torn, ("two pieces",)),
    "text for time": (_words_for_time, ("column t",)),
    "text for angles": (_words_for_angles, ("column q_axis_1",)),
    "suites that are no whole numbers": (_half_suites, ("suite",)),
    "unknown phase": (_unknown_phase, ("holiday", "open_loop")),
    "nothing moves": (_only_static, ("static", "open_loop")),
}


@pytest.mark.parametrize("what", SPOILED)
def test_spoiled_recording(cell: Path, what: str) -> None:
    spoil, words = SPOILED[what]
    save(cell / "bad.parquet", spoil(table()), meta(JOINTS))
    alone = what in ("missing column", "time going backwards", "not a number", "degrees", "no rows")
    refused(identify("bad.parquet"), cell, "bad.parquet" if what != "nothing moves" else "only", *words, alone=alone)


def test_not_parquet(cell: Path) -> None:
    (cell / "bad.parquet").write_bytes(b"PK\x03\x04 this is a spreadsheet")
    refused(identify("bad.parquet"), cell, "bad.parquet", "not a readable Parquet")


def test_truncated_parquet(cell: Path) -> None:
    whole = (cell / "rec.parquet").read_bytes()
    (cell / "bad.parquet").write_bytes(whole[: len(whole) // 2])
    refused(identify("bad.parquet"), cell, "not a readable Parquet")


def test_damaged_in_the_middle(cell: Path) -> None:
    whole = bytearray((cell / "rec.parquet").read_bytes())
    for k in range(60, 4000, 7):
        whole[k] ^= 0xFF
    (cell / "bad.parquet").write_bytes(bytes(whole))
    refused(identify("bad.parquet"), cell, "bad.parquet", alone=False)


def test_empty_file(cell: Path) -> None:
    (cell / "bad.parquet").write_bytes(b"")
    refused(identify("bad.parquet"), cell, "0 bytes")


def test_no_such_recording(cell: Path) -> None:
    refused(identify("absent.parquet"), cell, "no such file", alone=False)


def test_wrong_joint_names(cell: Path) -> None:
    t = {k.replace("axis_", "achse_"): v for k, v in table().items()}
    save(cell / "bad.parquet", t, meta(("achse_1", "achse_2")))
    refused(identify("bad.parquet"), cell, "achse_1", "axis_1", "do not belong together")


def test_metadata_and_columns_disagree(cell: Path) -> None:
    save(cell / "bad.parquet", table(), meta(("a", "b")))
    refused(identify("bad.parquet"), cell, "make them agree", alone=False)


def test_robot_and_data_do_not_belong_together(cell: Path) -> None:
    refused(identify("rec.parquet", "lwa4p"), cell, "arm_1_joint", "axis_1", "do not belong together")


def test_model_and_data_do_not_belong_together(planar, tmp_path: Path) -> None:
    folder, _, _ = planar
    t = {k.replace("axis_", "achse_"): v for k, v in table().items()}
    save(tmp_path / "bad.parquet", t, meta(("achse_1", "achse_2")))
    refused(["compare", folder / "m.model.json", "--data", "bad.parquet"], tmp_path, "do not belong together")


@pytest.mark.parametrize("content", ["", "<robot", "<html/>", "<robot name='a'/>", "\x00\x01"])
def test_no_robot(cell: Path, content: str) -> None:
    (cell / "bad.urdf").write_text(content)
    refused(identify("rec.parquet", "bad.urdf"), cell, "bad.urdf", alone=False)


# ---- model files


def _flip(text: str) -> str:
    k = text.index('"Minv"') + 40
    k = next(i for i in range(k, len(text)) if text[i].isdigit())
    return text[:k] + str((int(text[k]) + 1) % 10) + text[k + 1 :]


def _newer(text: str) -> str:
    body = json.loads(text)
    body["schema"] = SCHEMA_VERSION + 1
    return json.dumps(body)


DAMAGED: dict[str, tuple[Callable[[str], str], str]] = {
    "one digit changed": (_flip, "SHA-256"),
    "cut off": (lambda t: t[: len(t) // 2], "not JSON"),
    "foreign": (lambda t: '{"openapi": "3.0"}', "not a stopset model file"),
    "a list": (lambda t: "[1, 2]", "not a stopset model file"),
    "newer": (_newer, "schema"),
    "empty": (lambda t: "", "not JSON"),
    "deep": (lambda t: "[" * 100_000, "bad.model.json"),
    "a number beyond JSON": (lambda t: t.replace(f'"schema": {SCHEMA_VERSION}', '"schema": 1e999', 1), "schema"),
}


@pytest.mark.parametrize("what", DAMAGED)
def test_damaged_model_file(planar, tmp_path: Path, what: str) -> None:
    folder, _, _ = planar
    spoil, word = DAMAGED[what]
    (tmp_path / "bad.model.json").write_text(spoil((folder / "m.model.json").read_text()))
    refused(
        ["compare", "bad.model.json", "--data", folder / "rec.parquet"],
        tmp_path,
        "bad.model.json",
        word,
        alone=what in ("one digit changed", "cut off", "foreign"),
    )


def test_a_bit_of_the_model_file_flipped_anywhere_is_noticed(planar, tmp_path: Path) -> None:
    from stopset.artifact import load_model
    from stopset.errors import ModelFileError

    folder, _, _ = planar
    whole = (folder / "m.model.json").read_bytes()
    rng = np.random.default_rng(0)
    noticed = tried = 0
    for k in rng.integers(0, len(whole), 200):
        spoiled = bytearray(whole)
        spoiled[k] ^= 1 << int(rng.integers(0, 7))
        (tmp_path / "bad.model.json").write_bytes(bytes(spoiled))
        tried += 1
        try:
            same = load_model(tmp_path / "bad.model.json")
        except ModelFileError:
            noticed += 1
        else:  # a space turned into another blank changes nothing that is said
            assert same.sha256 == json.loads(whole)["sha256"]
    assert noticed > 0.7 * tried


# ---- outputs


def test_output_is_a_directory(cell: Path) -> None:
    (cell / "here").mkdir()
    refused(identify("rec.parquet", out="here"), cell, "here is a directory")


def test_output_in_a_folder_that_is_not_there(cell: Path) -> None:
    refused(identify("rec.parquet", out="away/out.model.json"), cell, "away does not exist", alone=False)


def test_output_in_a_folder_that_must_not_be_written(cell: Path) -> None:
    closed = cell / "closed"
    closed.mkdir()
    closed.chmod(0o555)
    if os.access(closed, os.W_OK):  # the superuser may write anywhere: ask the kernel to refuse by another way
        target: Path = Path("/proc/out.model.json")
        refused(identify("rec.parquet", out=target), cell, "/proc")
    else:
        refused(identify("rec.parquet", out="closed/out.model.json"), cell, "not writable")


@pytest.mark.parametrize("option", ["--json", "--report"])
def test_the_other_outputs_are_checked_before_the_work(cell: Path, option: str) -> None:
    refused([*identify("rec.parquet"), option, "away/x"], cell, "away does not exist", alone=False)


def _small_files_only() -> None:
    """No file may grow beyond 4 KiB: to the program a disk that is full; the signal becomes an error number."""
    import signal

    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


def test_no_room_for_the_model_file(cell: Path) -> None:
    text = refused(identify("rec.parquet"), cell, "nothing was written", before=_small_files_only)
    assert "out.model.json" in text


def test_full_disk(cell: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """A real full file system, where one may be mounted; the small-file limit above stands for it elsewhere."""
    disk = tmp_path_factory.mktemp("disk")
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4k", "tmpfs", disk], capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip("mounting a small file system is not allowed here; test_no_room_for_the_model_file stands for it")
    try:
        (disk / "out.model.json").write_text("the model of yesterday")
        text = refused(identify("rec.parquet", out=disk / "out.model.json"), cell, "disk is full", "nothing was written")
        assert "out.model.json" in text
        assert snapshot(disk) == {"out.model.json": b"the model of yesterday"}
    finally:
        subprocess.run(["umount", disk], check=True)


def test_an_interrupted_write_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "m.json"
    target.write_text("old")
    with pytest.raises(KeyboardInterrupt), replacing(target) as part:
        part.write_text("half of the n")
        raise KeyboardInterrupt
    assert snapshot(tmp_path) == {"m.json": b"old"}


def test_no_room_at_the_last_moment_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "m.json").write_text("old")

    def full(self: Path, target: Path) -> None:
        raise OSError(errno.EDQUOT, "Disk quota exceeded")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OutputError, match="nothing was written"):
        write_text(tmp_path / "m.json", "new")
    assert snapshot(tmp_path) == {"m.json": b"old"}


def test_a_killed_writer_leaves_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text("old")
    code = (
        "import os, signal\nfrom stopset.files import replacing\n"
        "with replacing('m.json') as part:\n part.write_text('half')\n os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=False)
    assert done.returncode == -9
    assert (tmp_path / "m.json").read_text() == "old"


def test_a_file_that_cannot_be_written_is_an_output_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(OutputError, match="is a directory"):
        write_text(tmp_path / "a", "x")
    with pytest.raises(OutputError, match="does not exist"):
        write_bytes(tmp_path / "b" / "c", b"x")
    long = tmp_path / ("n" * 300)
    with pytest.raises(OutputError, match="nnn"):
        write_text(long, "x")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["identify", "--robot", "robot.urdf", "--data", "rec.parquet", "--out", "rec.parquet"], "read by this command"),
        (["identify", "--robot", "robot.urdf", "--data", "rec.parquet", "--out", "./robot.urdf"], "read by this command"),
        (["identify", "--robot", "robot.urdf", "--data", "rec.parquet", "--out", "x", "--report", "x"], "the place of --"),
        (["compare", "m.model.json", "--data", "rec.parquet", "--report", "m.model.json"], "read by this command"),
        (["diagnose", "m.model.json", "--data", "rec.parquet", "--json", "link"], "read by this command"),
        (["history", "m.model.json", "--json", "m.model.json"], "read by this command"),
        (["stops", "m.model.json", "--csv", "m.model.json"], "read by this command"),
        (["export-fmu", "m.model.json", "--out", "m.model.json"], "read by this command"),
        (["inspect", "rec.parquet", "--json", "rec.parquet"], "read by this command"),
    ],
)
def test_nothing_that_is_read_is_overwritten(cell: Path, planar, words: list[str], says: str) -> None:
    (cell / "m.model.json").write_bytes((planar[0] / "m.model.json").read_bytes())
    (cell / "link").symlink_to("rec.parquet")
    refused(words, cell, says, alone=False)


@pytest.mark.parametrize("command", ["diagnose", "stops", "workbench"])
def test_recordings_of_another_robot_are_refused_everywhere(planar, tmp_path: Path, command: str) -> None:
    t = {k.replace("axis_", "achse_"): v for k, v in table().items()}
    save(tmp_path / "bad.parquet", t, meta(("achse_1", "achse_2")))
    more = {"stops": ["--report", "x.html"], "workbench": ["--port", "0"]}.get(command, [])
    refused(
        [command, planar[0] / "m.model.json", "--data", "bad.parquet", *more], tmp_path, "do not belong together", alone=False
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["stops", "m.model.json", "--data", "rec.parquet"], "--report"),
        (["stops", "m.model.json", "--separation"], "v_h"),
        (["export-fmu", "m.model.json", "--out", "x.zip"], ".fmu"),
        (["plan", "--robot", "robot.urdf", "--out", "x", "--floor", "99"], "lower --floor"),
        (["import", "here", "--out", "x.parquet"], "is a folder without"),
        (["watch", "--connect", "nonsense", "--port", "0"], "nonsense"),
        (["watch", "--connect", "tcp/127.0.0.1:1", "--port", "0"], "127.0.0.1:1"),
    ],
)
def test_a_question_that_cannot_be_answered_is_told_before_the_work(cell: Path, planar, words: list[str], says: str) -> None:
    (cell / "m.model.json").write_bytes((planar[0] / "m.model.json").read_bytes())
    (cell / "here").mkdir()
    text = refused(words, cell, says, alone=False)
    assert ".rs" not in text  # no library's own source


# ---- the command line itself


@pytest.mark.parametrize(
    "arguments",
    [["nonsense"], ["identify"], ["identify", "--robot", "lwa4p"], ["compare", "x", "--data"], ["identify", "--conform", "some"]],
)
def test_bad_usage(tmp_path: Path, arguments: list[str]) -> None:
    done = in_process(arguments, tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("stopset: ")
    assert len(done.stderr.splitlines()) <= 3


def test_numbers_out_of_range(cell: Path) -> None:
    for option in (("--margin", "0.5"), ("--margin", "nan"), ("--model", "7"), ("--order", "-1")):
        done = in_process([*identify("rec.parquet"), *option], cell)
        assert done.returncode == 2, (option, done.stderr)
        assert "Traceback" not in done.stderr
        assert (cell / "out.model.json").read_text() == "the model of yesterday"


def test_an_unknown_effect_is_refused(cell: Path) -> None:
    refused([*identify("rec.parquet"), "--effects", "phlogiston"], cell, "phlogiston", alone=False)


def test_csv_without_its_columns(cell: Path) -> None:
    (cell / "bad.csv").write_text("a,b\n1,2\n")
    refused(identify("bad.csv"), cell, "bad.csv", "missing", alone=False)
    (cell / "worse.csv").write_text("")
    refused(identify("worse.csv"), cell, "0 bytes", alone=False)


def test_parquet_that_holds_something_else(cell: Path) -> None:
    pq.write_table(pa.table({"q_axis_1": [[1.0, 2.0]], "suite": [{"a": 1}]}), cell / "bad.parquet")
    refused(identify("bad.parquet"), cell, "bad.parquet")
