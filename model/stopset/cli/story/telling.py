"""Commands one after another and beside each other, each shown as it would be typed, and the sentences that must hold of them."""

from __future__ import annotations

import contextlib
import io
import json
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Self

from stopset.cli.common import say
from stopset.errors import StopsetError

Lines = Callable[[str], bool]  # of the lines that a command printed, those to show
PATIENCE = 60.0  # [s] for what should come at once, on a machine that is busy with everything else


class FailedError(StopsetError):
    """A sentence of the story that did not hold."""


def hold(holds: object, sentence: str) -> None:
    """The story goes on only while this is true; raises `FailedError`."""
    if not holds:
        raise FailedError(sentence)


def until(holds: Callable[[], Any], sentence: str, seconds: float = PATIENCE) -> Any:
    """Wait for it, and give it; raises `FailedError`."""
    end = time.monotonic() + seconds
    while not (found := holds()):
        hold(time.monotonic() < end, sentence)
        time.sleep(0.02)
    return found


def command(*words: str) -> list[str]:
    """A command of ours for a process of its own."""
    return [sys.executable, "-m", "stopset.cli.main", *words]


@contextlib.contextmanager
def process(*words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A command until the block ends, killed without a chance to say goodbye."""
    say("    $ stopset " + shlex.join(words))
    begun = subprocess.Popen(command(*words), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield begun
    finally:
        begun.kill()
        begun.wait()


class Story:
    """Runs commands in ``out``, saying which and when, and remembers each step with its time."""

    def __init__(self, out: Path) -> None:
        self.out, self.start, self.chapters = out, time.monotonic(), 0
        self.steps: list[dict[str, Any]] = []

    def chapter(self, text: str) -> None:
        """A new part of the story."""
        self.chapters += 1
        say(f"\n[{time.monotonic() - self.start:5.1f} s] {self.chapters}. {text}")

    def step(self, text: str) -> None:
        """Something that was found to be true."""
        say(f"      {text}")
        self.steps.append({"kind": "step", "t_ns": time.time_ns(), "why": text})

    def do(self, *words: str, keep: Lines = lambda _: False, good: tuple[int, ...] = (0,)) -> None:
        """Run one command in this process, its chatter hidden except the lines that ``keep`` wants."""
        from stopset.cli.main import main

        say("    $ stopset " + shlex.join(words))
        printed, reported = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(reported):
            code = main(list(words))
        _ended(words[0], code, good, reported.getvalue())
        show(printed.getvalue(), keep)

    def ask(self, name: str, *words: str, good: tuple[int, ...] = (0, 1), keep: Lines = lambda _: False) -> Any:
        """A command's answer for machines, kept as ``name``.json."""
        file = self.out / f"{name}.json"
        self.do(*words, "--json", str(file), good=good, keep=keep)
        return json.loads(file.read_text())


class Asides:
    """Commands that run in processes of their own, two at a time, behind whatever else the machine has to do."""

    def __init__(self) -> None:
        self._line = ThreadPoolExecutor(2)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._line.shutdown(cancel_futures=kind is not None)

    def begin(self, *words: str, good: tuple[int, ...] = (0,)) -> Future[str]:
        """Run this as soon as it is its turn; gives what it printed."""
        say("    $ stopset " + shlex.join(words) + " &")
        return self._line.submit(_aside, words, good)


def _aside(words: tuple[str, ...], good: tuple[int, ...]) -> str:
    behind = ["nice"] if shutil.which("nice") else []
    done = subprocess.run([*behind, *command(*words)], capture_output=True, text=True, check=False)
    _ended(words[0], done.returncode, good, done.stderr)
    return done.stdout


def _ended(name: str, code: int, good: tuple[int, ...], reported: str) -> None:
    if code not in good:
        kind = StopsetError if code in (1, 2) else RuntimeError  # a defect of a step is one of the whole
        raise kind(f"`stopset {name}` ended with {code}: {reported.strip().splitlines()[-1:]}")


def show(printed: str, keep: Lines) -> None:
    """The lines of what a command printed that ``keep`` wants."""
    for line in printed.splitlines():
        if keep(line):
            say("      " + line)
