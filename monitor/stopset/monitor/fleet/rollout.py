"""A signed model for many arms: one of them first, watched, then the others one by one; the first that gets worse ends it.

How a file reaches a cell is the site's business (ssh, a package, a share): a command per arm that the caller gives. What is
checked here is what the arms themselves say: that each took this model, and that none says worse than before.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stopset.errors import BusError
from stopset.monitor.fleet.fleet import GONE, Fleet
from stopset.monitor.viewer.words import plain

BAD = ("FAULT", "VIOLATION", GONE)
LOOK = 0.1  # [s]
DELIVERED = 300.0  # [s] a delivery may take
FIELDS = ("model", "signature", "site", "cell", "arm")


@dataclass(frozen=True, slots=True)
class Patience:
    """[s]: to take the model, and how long the first arm and each other is watched with it."""

    take: float = 60.0
    canary: float = 600.0
    each: float = 20.0


@dataclass(frozen=True, slots=True)
class Taken:
    """What became of one arm. ``looks``: how often it was seen in which state with the model; ``why``: what was wrong, "" if nothing."""

    arm: str
    looks: dict[str, int]
    why: str = ""


@dataclass(slots=True)
class Reloads:
    """What monitors say of reading a model anew, by arm; fed from zenoh's threads with every ``event``."""

    taken: set[str] = field(default_factory=set)
    refused: dict[str, str] = field(default_factory=dict)

    def take(self, key: str, data: bytes) -> None:
        """Of all events those that a model came with; a monitor that was begun anew has read it too."""
        try:
            event = json.loads(data)
        except (ValueError, RecursionError):
            return
        arm, kind = plain(key.partition("/stopset/")[0]), event.get("kind") if isinstance(event, dict) else None
        if kind == "reload_refused":
            self.refused[arm] = plain(str(event.get("why", "")))[:300]
        elif kind in ("reloaded", "started"):
            self.taken.add(arm)

    def forget(self, arm: str) -> None:
        """What was said before."""
        self.taken.discard(arm)
        self.refused.pop(arm, None)


def delivery(template: str, model: Path, arm: str) -> list[str]:
    """The command that brings ``model`` to ``arm`` (SITE/CELL/ARM); raises `BusError` for one that cannot be filled in."""
    site, cell, name = arm.split("/")
    values = (str(model), f"{model}.sig", site, cell, name)
    try:
        return [word.format_map(dict(zip(FIELDS, values, strict=True))) for word in shlex.split(template)]
    except (KeyError, ValueError, IndexError) as e:
        raise BusError(
            f"--deliver {template!r} cannot be filled in ({e}); expected words with {{{'}, {'.join(FIELDS)}}}: mend it"
        ) from e


@dataclass(slots=True)
class Rollout:
    """``sha256``: of the model; ``deliver``: template of a command; ``say``: progress in words."""

    fleet: Fleet
    reloads: Reloads
    model: Path
    sha256: str
    deliver: str
    patience: Patience
    say: Callable[[str], None]

    def run(self, arms: Sequence[str], canary: str) -> list[Taken]:
        """The canary, then the others in their order; ends after the first that is wrong, which is the last of the answer."""
        done: list[Taken] = []
        for arm in (canary, *(a for a in arms if a != canary)):
            watched = self.patience.canary if arm == canary else self.patience.each
            done.append(self._one(arm, watched))
            if done[-1].why:
                break
        return done

    def _one(self, arm: str, watched: float) -> Taken:
        before = self._row(arm)
        if before["word"] == GONE:
            return Taken(
                arm, {}, f"it says nothing ({before['why']}); expected an arm that can be watched: start its monitor first"
            )
        self.reloads.forget(arm)
        self.say(f"{arm}: {before['word']} with {before['model']}; the model is delivered")
        if why := self._delivered(arm):
            return Taken(arm, {}, why)
        end = time.monotonic() + self.patience.take
        while arm not in self.reloads.taken or self._row(arm)["model"] != self.sha256[:16]:
            if refused := self.reloads.refused.get(arm):
                return Taken(arm, {}, f"the monitor refuses the model: {refused}")
            if time.monotonic() > end:
                return Taken(
                    arm, {}, f"it was not taken within {self.patience.take:g} s; its monitor must be told to read it (SIGHUP)"
                )
            time.sleep(LOOK)
        return self._watched(arm, before["word"], watched)

    def _delivered(self, arm: str) -> str:
        command = delivery(self.deliver, self.model, arm)
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=DELIVERED)
        except (OSError, subprocess.TimeoutExpired) as e:
            return f"{command[0]} did not deliver the model: {e}"
        last = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        return f"{command[0]} ended with {done.returncode}: {' '.join(last)[:200]}" if done.returncode else ""

    def _watched(self, arm: str, before: str, seconds: float) -> Taken:
        looks: Counter[str] = Counter()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            row = self._row(arm)
            looks[row["word"]] += 1
            if row["word"] in BAD and row["word"] != before:
                return Taken(
                    arm, dict(looks), f"it says {row['word']} with the new model ({row['why']}), before it said {before}"
                )
            if row["model"] != self.sha256[:16] and row["word"] != GONE:
                return Taken(arm, dict(looks), f"it has another model again ({row['model']})")
            time.sleep(LOOK)
        self.say(f"{arm}: taken; in {seconds:g} s {', '.join(f'{n / looks.total():.0%} {w}' for w, n in looks.most_common())}")
        return Taken(arm, dict(looks))

    def _row(self, arm: str) -> dict[str, Any]:
        found = self.fleet.row(arm)
        return found or {"word": GONE, "why": "no monitor of that name was heard", "model": ""}
