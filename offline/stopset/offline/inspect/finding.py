"""What is wrong with a recording: what was seen, what was expected, and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong or strange; ``kind`` is the word for programs, the rest for people."""

    kind: str
    severity: Severity
    joint: str | None
    seen: str
    expected: str
    do: str
    value: float | None = None

    @property
    def says(self) -> str:
        where = f"{self.joint}: " if self.joint else ""
        return f"{where}{self.seen}; expected {self.expected}: {self.do}"
