"""How far long work is, on the terminal: never silent for long, with an estimate wherever one can be made.

What a step counts gives the estimate of that step. How long the whole takes is known from the last time on this machine: seconds and
bytes of recordings, kept in the user's cache folder, and forgotten with it. Of recordings much larger or smaller than those it says
nothing: a small file's seconds are those of the start, and a large one would be told to take days by them.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import cast

from stopset.files import cache_folder, write_text
from stopset.progress import Progress, left, silent

OFTEN = 2.5  # [s] between two lines of the same step
LATER, SELDOM = 60.0, 8.0  # [s] after this long, one line in so many is enough where nobody watches
BEGINS = "loading"  # until there is a step
BLINK = 0.5  # [s] on a terminal
ALIKE = 4.0  # times as many bytes, or as few, as the last time: what took so long tells how long this takes


class Steps:
    """Writes steps to stderr; `report` is a `Progress`. On a terminal the last line is rewritten, elsewhere lines follow each other."""

    def __init__(self, expected: float | None) -> None:
        self._expected = expected
        self._start = self._begun = self._written = time.monotonic()
        self._text, self._share = BEGINS, cast("float | None", None)  # what it does, and the share of that which is done
        self._tenth = 0  # of the step that were told
        self._live, self._lock, self._over = sys.stderr.isatty(), threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True, name="steps")
        self._thread.start()

    def report(self, text: str, share: float | None = None) -> None:
        """A step; one without a share is a line of its own, once while it is the same."""
        with self._lock:
            if share is None and (text, share) == (self._text, self._share):
                return
            if share is None or self._share is None or share < self._share:
                self._begun, self._tenth = time.monotonic(), 0
            self._text, self._share = text, share
            if share is None:
                self._write(text, whole=True)
            elif not self._live and int(10 * share + 1e-9) > self._tenth:  # in a log every tenth stands on its own
                self._tenth = int(10 * share + 1e-9)
                self._write(text, whole=True)

    def _watch(self) -> None:
        """Write how far it is until it is over."""
        while not self._over.wait(BLINK):
            with self._lock:
                now = time.monotonic()
                # before the first step there is nothing new to say twice: a slow start is not a flood of lines
                again = self._text == BEGINS and self._written > self._start
                pause = BLINK if self._live else SELDOM if again or now - self._start > LATER else OFTEN
                if now - self._written >= pause:
                    self._write(self._text + self._rest(now), whole=False)

    def end(self) -> None:
        """Nothing more is written; only then the line is free."""
        self._over.set()
        self._thread.join()
        if self._live:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._start

    def _rest(self, now: float) -> str:
        step = left(now - self._begun, self._share)
        if step is not None:
            return f", about {_said(step)} more of this step"
        if self._expected is not None and self.seconds < self._expected:
            return f", about {_said(self._expected - self.seconds)} more, by the last times here"
        return "" if self._live or self._text == BEGINS else " ... goes on"

    def _write(self, text: str, *, whole: bool) -> None:
        line = f"[{self.seconds:5.1f} s] {text}"
        if self._live:
            room = shutil.get_terminal_size().columns - 1
            sys.stderr.write("\r\x1b[K" + (line if len(line) <= room else line[: room - 1] + "…") + ("\n" if whole else ""))
        else:
            sys.stderr.write(line + "\n")
        sys.stderr.flush()
        self._written = time.monotonic()


def _said(seconds: float) -> str:
    return f"{max(1, round(seconds))} s" if seconds < 90 else f"{round(seconds / 60)} min"


@contextlib.contextmanager
def steps(command: str, data: Sequence[str | Path] = (), *, quiet: bool = False) -> Iterator[Progress]:
    """What long work of ``command`` on the recordings ``data`` is to be told of its steps."""
    if quiet:
        yield silent
        return
    size = sum(Path(p).stat().st_size for p in data if Path(p).is_file()) or 1
    last = _last_times()
    seconds, bytes_then = last.get(command, (0.0, 1.0))
    alike = seconds > 0 and bytes_then / ALIKE <= size <= ALIKE * bytes_then
    found = Steps(seconds * size / bytes_then if alike else None)
    try:
        yield found.report
        _keep({**last, command: (found.seconds, float(size))})
    finally:
        found.end()


def _file() -> Path | None:
    folder = cache_folder()
    return None if folder is None else folder / "times.json"


def _last_times() -> dict[str, tuple[float, float]]:
    """Seconds and bytes of each command when it last ran; what cannot be read was never known."""
    file = _file()
    try:
        stored = json.loads(file.read_text()) if file else {}
        found = {str(k): (float(seconds), float(size)) for k, (seconds, size) in stored.items()}
        return {k: x for k, x in found.items() if min(x) > 0}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}


def _keep(times: dict[str, tuple[float, float]]) -> None:
    file = _file()
    if file is not None:
        from stopset.errors import OutputError

        with contextlib.suppress(OutputError):
            write_text(file, json.dumps(times))
