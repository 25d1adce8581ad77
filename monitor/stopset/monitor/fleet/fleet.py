"""Which arms there are, and what each monitor said last: found by their liveliness tokens, grey when they fall silent.

An overview reads the slow words of every monitor, not the message of every cycle: a hundred arms cost a few per cent of a core. It
proves nothing about their age beyond that words keep coming; whom it matters to looks at one arm with `stopset watch`, which does.
"""

from __future__ import annotations

import re
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec

from stopset.monitor.layout import State
from stopset.monitor.viewer.words import plain

SILENT_S = 1.0  # without words: five that should have come
LARGEST = 1 << 20  # bytes of a message
MOST = 20_000  # arms; tokens of strangers do not fill the memory
GONE = "NO DATA"
ORDER = ("FAULT", "VIOLATION", GONE, "SHUTDOWN", "INIT", "UNKNOWN", "DEGRADED", "OK")  # what needs somebody first

PLACE = {word: k for k, word in enumerate(ORDER)}

SENT = {s.name for s in State} - {State.NEVER_SENT.name}


class _StopRow(msgspec.Struct):
    time_s: float | None = None
    tcp_m: float | None = None


class _Words(msgspec.Struct):
    """What of ``state/json`` an overview shows."""

    state: str
    why: str
    stops: dict[str, _StopRow] = {}
    violation_class: str = ""
    model_sha256: str = ""


_decode = msgspec.json.Decoder(_Words).decode


@dataclass(slots=True)
class _Arm:
    alive: bool = False
    words: _Words | None = None
    heard: float = float("-inf")
    since: float = 0.0  # when its word changed last
    place: list[tuple[int, str]] = field(default_factory=list)  # among arms of one word


class Fleet:
    """Fed from zenoh's threads, read by the displays; ``clock`` gives seconds that never go back.

    ``notice``: what somebody should know besides, "" for nothing; ``most``: arms that are shown, the first that were heard.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, notice: Callable[[], str] = str, most: int = MOST) -> None:
        self._arms: dict[str, _Arm] = {}
        self._beyond: set[int] = set()  # hashes of the names that found no place, as many as of those that did
        self._clock, self._lock, self.garbled, self._notice, self._most = clock, threading.Lock(), 0, notice, most

    def take_alive(self, key: str, *, there: bool) -> None:
        """A token appeared or went."""
        with self._lock:
            if (arm := self._arm(key)) is not None:
                if arm.alive != there:
                    arm.since = self._clock()
                arm.alive = there

    def take_json(self, key: str, data: bytes) -> None:
        """``state/json`` of an arm."""
        try:
            words = _decode(data) if len(data) <= LARGEST else None
        except (msgspec.MsgspecError, ValueError, RecursionError):
            words = None
        with self._lock:
            if words is None or words.state not in SENT:
                self.garbled += 1
                return
            if (arm := self._arm(key)) is not None:
                now = self._clock()
                if arm.words is None or arm.words.state != words.state or now - arm.heard > SILENT_S:
                    arm.since = now
                arm.words, arm.heard, arm.alive = words, now, True

    def _arm(self, key: str) -> _Arm | None:
        name = plain(key.partition("/stopset/")[0])
        if name not in self._arms:
            if len(self._arms) < self._most:
                self._arms[name] = _Arm(since=self._clock(), place=_counted(name))
            elif len(self._beyond) < self._most:
                self._beyond.add(hash(name))
        return self._arms.get(name)

    def _not_shown(self) -> str:
        """That there are more arms than have a place; "" where there are none."""
        n = len(self._beyond)
        return (
            f"{n}{' or more' if n == self._most else ''} arms beyond the {self._most} that are shown were heard and are watched by nobody here: "
            "look at one hall at a time (--arms hall3/*/*)"
            if n
            else ""
        )

    def rows(self) -> list[dict[str, Any]]:
        """One per arm, what needs somebody first; numbers only of an arm that speaks."""
        return self._shown(None)[0]

    def _shown(self, most: int | None) -> tuple[list[dict[str, Any]], Counter[str]]:
        """The first ``most`` rows, and how many arms are in which state: a look at ten thousand arms makes the rows it shows only."""
        with self._lock:
            now = self._clock()
            placed = [(_word(arm, now), arm, name) for name, arm in self._arms.items()]
            placed.sort(key=lambda p: (PLACE[p[0]], p[1].place))
            return [_row(name, arm, now) for _, arm, name in placed[:most]], Counter(word for word, _, _ in placed)

    def row(self, name: str) -> dict[str, Any] | None:
        """Of one arm; None where nobody of that name was heard."""
        with self._lock:
            arm = self._arms.get(name)
            return None if arm is None else _row(name, arm, self._clock())

    def snapshot(self, most: int = 400) -> dict[str, Any]:
        """What the displays show: how many arms are in which state, and the first ``most`` of them."""
        rows, found = self._shown(most)
        counts = {word: found[word] for word in ORDER if found[word]}
        notice = "; ".join(filter(None, (self._not_shown(), self._notice())))
        return {
            "arms": found.total(), "counts": counts, "rows": rows, "garbled": self.garbled, "beyond": len(self._beyond), "notice": notice,
        }  # fmt: skip


def _counted(name: str) -> list[tuple[int, str]]:
    """To sort cell2 before cell10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name)]


def _word(arm: _Arm, now: float) -> str:
    """The state it may be believed to be in."""
    return GONE if not arm.alive or arm.words is None or now - arm.heard > SILENT_S else arm.words.state


def _row(name: str, arm: _Arm, now: float) -> dict[str, Any]:
    w, quiet = arm.words, now - arm.heard
    row: dict[str, Any] = {"arm": name, "since_s": round(now - arm.since, 1), "model": "", "class": "", "stops": {}}
    if (word := _word(arm, now)) == GONE or w is None:
        why = (
            "its monitor is gone"
            if not arm.alive
            else "alive, but nothing was said yet"
            if w is None
            else f"silent for {quiet:.1f} s"
        )
        return row | {"word": GONE, "why": why}
    stops = {plain(k): {"time_s": s.time_s, "tcp_m": s.tcp_m} for k, s in list(w.stops.items())[:4]}
    return row | {
        "word": word, "why": plain(w.why)[:200], "class": plain(w.violation_class)[:60], "model": plain(w.model_sha256)[:16], "stops": stops,
    }  # fmt: skip
