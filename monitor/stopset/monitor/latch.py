"""What has been seen stays seen: violations are latched until a person with a name resets them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from stopset.monitor.watch import Conformance, Deviation, Sample, Verdict

RECENT = 10
DRIFT = 3  # this many violating samples of RECENT are a drift, fewer a spike (a sensor error is then suspected)


@dataclass(slots=True)
class Entry:
    """All violations of one joint's state on one side since the last reset."""

    first: Deviation
    worst: Deviation
    first_t: float
    last_t: float
    samples: int = 1
    recent: deque[int] = field(default_factory=lambda: deque(maxlen=DRIFT))

    def plain(self, names: bool = True) -> dict[str, Any]:
        """For people and JSON."""
        w = self.worst
        drift = len(self.recent) == DRIFT and self.recent[-1] - self.recent[0] < RECENT
        unit = "rad" if w.state == "q" else "rad/s"
        return {
            "joint": w.joint, "state": w.state, "side": w.side, "unit": unit, "samples": self.samples,
            "kind": "drift" if drift else "spike", "first_t": self.first_t, "last_t": self.last_t, "age_s": w.age,
            "excess": w.excess, "excess_fraction": w.fraction, "measured": w.measured, "bound": w.bound,
            "in_domain": self.first.in_domain,
        }  # fmt: skip


@dataclass(slots=True)
class Latch:
    """Counts and keeps violations; ``first`` is the entry that came first (first-out)."""

    count: int = 0
    entries: dict[tuple[str, str, str], Entry] = field(default_factory=dict)
    first: Entry | None = None

    def take(self, sample: Sample, verdict: Verdict) -> list[Entry]:
        """Record a verdict; returns the entries that are new with it."""
        if verdict.conformance is not Conformance.VIOLATION:
            return []
        self.count += 1
        new: list[Entry] = []
        for d in verdict.deviations:
            key = (d.joint, d.state, d.side)
            entry = self.entries.get(key)
            if entry is None:
                entry = Entry(d, d, sample.t, sample.t)
                self.entries[key] = entry
                new.append(entry)
            else:
                entry.samples += 1
                entry.last_t = sample.t
                if d.fraction > entry.worst.fraction:
                    entry.worst = d
            entry.recent.append(sample.k)
        if self.first is None and new:
            self.first = max(new, key=lambda e: e.first.fraction)
        return new

    @property
    def latched(self) -> bool:
        return self.first is not None

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that violated, in the order in which they first did."""
        order = sorted(self.entries.values(), key=lambda e: (e is not self.first, e.first_t))
        return tuple(dict.fromkeys(e.first.joint for e in order))

    def reset(self) -> None:
        """Forget; who did it and why belongs into an event."""
        self.count, self.first = 0, None
        self.entries.clear()
