"""The terminal: long work is never silent, says how long it still takes, and lists stay folded until they are wanted."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import select
import time
from pathlib import Path

import pytest

from patience import rest
from stopset.cli import steps
from stopset.cli.common import listed, say
from stopset.cli.main import main
from stopset.progress import counted, left


@pytest.fixture
def brisk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As if time passed fifty times as fast, with no memory of other times."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(steps, "BLINK", 0.01)
    monkeypatch.setattr(steps, "OFTEN", 0.05)


def stamps(text: str) -> list[str]:
    return [line.partition("] ")[2] for line in text.splitlines()]


@pytest.mark.usefixtures("brisk")
def test_a_silent_step_is_told_again_and_a_counted_one_with_what_is_left(capsys: pytest.CaptureFixture[str]) -> None:
    with steps.steps("odd") as progress:
        progress("thinking")
        rest(0.4)
        for _ in counted(range(8), 8, "counting", progress):
            time.sleep(0.15)
    said = stamps(capsys.readouterr().err)
    assert said[0] == "thinking" and sum(s == "thinking ... goes on" for s in said) >= 3
    assert any(re.fullmatch(r"counting: [4-7] of 8, about \d+ s more of this step", s) for s in said), said


def test_a_log_is_never_silent_for_ten_seconds() -> None:
    assert max(steps.OFTEN, steps.SELDOM) + steps.BLINK < 10.0


@pytest.mark.usefixtures("brisk")
def test_a_slow_start_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever a busy machine takes to begin: an error after it is read among few lines."""
    with steps.steps("odd"):
        time.sleep(0.6)
    assert stamps(capsys.readouterr().err) == ["loading"]


@pytest.mark.usefixtures("brisk")
def test_the_last_time_tells_how_long_the_next_takes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data = tmp_path / "rec"
    data.write_bytes(b"x" * 1000)
    for size in (1000, 4000):
        data.write_bytes(b"x" * size)
        with steps.steps("odd", [data]) as progress:
            progress("thinking")
            time.sleep(0.5)
    first, second = capsys.readouterr().err.split("thinking\n")[1:3]
    assert "by the last times here" not in first
    assert re.search(r"thinking, about \d+ s more, by the last times here", second), second
    data.write_bytes(b"x" * 400_000)  # a hundred times as much: the seconds of a small file are those of the start
    with steps.steps("odd", [data]) as progress:
        progress("thinking")
        time.sleep(0.5)
    assert "by the last times here" not in capsys.readouterr().err
    (tmp_path / "cache" / "stopset" / "times.json").write_text("[no")
    with steps.steps("odd", [data]) as progress:
        progress("a broken memory is none")


def test_a_step_that_begins_anew_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    with steps.steps("odd") as progress:
        for _ in range(9):
            progress("fitting")
        progress("sets")
        progress("fitting")
    assert stamps(capsys.readouterr().err) == ["fitting", "sets", "fitting"]


def test_what_is_left_is_said_only_of_what_has_begun() -> None:
    assert left(10.0, 0.25) == 30.0 and left(10.0, None) is None and left(0.1, 0.5) is None and left(10.0, 0.001) is None


@pytest.mark.usefixtures("brisk")
def test_on_a_terminal_one_line_is_rewritten_and_none_is_longer_than_the_window(monkeypatch: pytest.MonkeyPatch) -> None:
    near, far = pty.openpty()
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setattr(steps, "BLINK", 0.05)  # a terminal nobody reads holds 4 kB
    with os.fdopen(far, "w") as terminal:
        monkeypatch.setattr("sys.stderr", terminal)
        monkeypatch.setattr("sys.stdout", terminal)
        with steps.steps("odd") as progress:
            progress("a step whose name is much longer than the window that it is shown in, and then some")
            time.sleep(0.2)
        say("  a sentence of the answer that is much longer than the window that it is shown in, and then some words more")
        terminal.flush()
    text = ""
    while "some words more" not in " ".join(text.split()) and select.select([near], [], [], 1.0)[0]:  # a read gives what is there
        text += os.read(near, 65536).decode()
    os.close(near)
    assert "\r\x1b[K" in text
    shown = [part for part in re.split(r"\r\x1b\[K|\r?\n", text) if part]
    assert max(map(len, shown)) <= 60 and "sentence of the answer" in text


@pytest.mark.parametrize(
    "words",
    [["--help"], ["stops", "--help"], ["nonsense"], ["stops", "--nonsense"], ["inspect", "no such file " * 8]],
    ids=" ".join,
)
def test_help_and_refusals_end_where_the_window_does(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    near, far = pty.openpty()
    with os.fdopen(far, "w") as terminal, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stdout", terminal)
        patch.setattr("sys.stderr", terminal)
        with contextlib.suppress(SystemExit):
            main(words)
        terminal.flush()
    text = ""
    with contextlib.suppress(OSError):  # the other side is closed: all is read
        while part := os.read(near, 65536):
            text += part.decode()
    os.close(near)
    assert len(text) > 80 and max(map(len, text.splitlines())) <= 80


def test_a_folded_list_says_how_to_unfold_it(capsys: pytest.CaptureFixture[str]) -> None:
    listed(["a", "b", "c"], "thing", whole=False)
    listed(["a", "b"], "thing", whole=True)
    listed(["a"], "thing", whole=False)
    assert capsys.readouterr().out.splitlines() == ["thing: 3, --all lists them", "thing: a", "thing: b", "thing: a"]


def test_quiet_commands_say_the_answer_alone(altered: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["diagnose", str(altered / "m.model.json"), "--data", str(altered / "altered.parquet")]
    capsys.readouterr()
    assert main([*words, "--quiet", "--json", str(tmp_path / "d.json")]) == 0
    quiet = capsys.readouterr()
    assert quiet.err == "" and quiet.out.startswith("missing") and quiet.out.count("not identifiable") == 1
    assert main([*words, "--all"]) == 0
    reported = capsys.readouterr()
    assert "so far: spring at bend" in reported.err and reported.out.count("not identifiable") > 1
    words[0] = "compare"
    assert main([*words, "--quiet"]) == 1
    few = capsys.readouterr().out.count("violation: ")
    assert main([*words, "--quiet", "--all"]) == 1
    assert capsys.readouterr().out.count("violation: ") > few == 6
