"""Events as a person reads them: the same one again is counted, not told again."""

from __future__ import annotations

import re
from typing import Any

import msgspec

NAMED_BY_WHY = {"gap"}  # kinds of event whose sentence names them
GROUPS = 40  # kept; the one that was quiet longest goes first


class Event(msgspec.Struct):
    """What the displays need of an ``event``; the evidence of a violation stays with who asked for it."""

    kind: str
    why: str = ""
    t_ns: int = 0
    signals: list[str] = []
    name: str = ""
    reason: str = ""
    proven: bool = True
    key: str = ""
    model_sha256: str = ""

    def line(self) -> str:
        """The event in a line."""
        kind = self.kind.replace("_", " ")
        by = f"by {self.name}{'' if self.proven else ' (as they call themselves)'}: {self.reason}" if self.name else ""
        why = self.why or by or ", ".join(self.signals) or (f"model {self.model_sha256[:16]}" if self.model_sha256 else "")
        return why if self.kind in NAMED_BY_WHY else f"{kind}: {why}" if why else kind


class Grouped:
    """Counts events that differ in their numbers only, in the order in which they were heard last."""

    def __init__(self) -> None:
        self._groups: dict[str, dict[str, Any]] = {}

    def take(self, event: Event) -> None:
        """One more."""
        key = f"{event.kind} {re.sub(r'[0-9.]+', '#', event.why)} {event.signals} {event.name} {event.reason}"
        known = self._groups.pop(key, {"count": 0})
        self._groups[key] = {
            "kind": event.kind, "told": event.line(), "why": event.why, "t_ns": event.t_ns, "count": known["count"] + 1,
        }  # fmt: skip
        if len(self._groups) > GROUPS:
            del self._groups[next(iter(self._groups))]

    def last(self, count: int) -> list[dict[str, Any]]:
        """The groups heard last, newest at the end."""
        return list(self._groups.values())[-count:]
