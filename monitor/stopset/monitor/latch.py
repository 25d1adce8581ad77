"""What has been seen stays seen, restarts or not: violations are latched until a person with a name resets them, and a drive's
emergency, which is told once, until it is over."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import msgspec

from stopset.monitor.evidence.cause import Cause, Kind
from stopset.monitor.journal import Journal, Unreadable, has_room
from stopset.monitor.sample import Sample
from stopset.monitor.verdict import VIOLATION, Deviation, Verdict

SCHEMA = 1
_NONE, _UNCLASSED = Kind.NONE, Kind.UNCLASSED  # as in `stopset.monitor.verdict`
SAVE_EVERY = 1.0  # [s] the disk gets a growing count this often, a new entry at once; the system's memory gets every count


@dataclass(slots=True)
class LatchEntry:
    """All violations of one joint's state on one side since the last reset."""

    first: Deviation
    worst: Deviation
    first_t: float
    last_t: float
    samples: int = 1
    kind: str = Kind.UNCLASSED.value

    def plain(self) -> dict[str, Any]:
        """For people and JSON."""
        w = self.worst
        unit = "rad" if w.state == "q" else "rad/s"
        return {
            "joint": w.joint, "state": w.state, "side": w.side, "unit": unit, "samples": self.samples,
            "kind": self.kind, "first_t": self.first_t, "last_t": self.last_t, "age_s": w.age,
            "excess": w.excess, "excess_fraction": w.fraction, "measured": w.measured, "bound": w.bound,
            "in_domain": self.first.in_domain,
        }  # fmt: skip


@dataclass(slots=True)
class Record:
    """What is remembered: ``why`` it is latched (empty: it is not), samples counted, entries in the order they came first."""

    schema: int = SCHEMA
    why: str = ""
    count: int = 0
    entries: list[LatchEntry] = field(default_factory=list)
    reset: dict[str, str] = field(default_factory=dict)  # who cleared it last, and why
    cause: dict[str, Any] = field(default_factory=dict)  # of the first violation, by the evidence; empty: not classed yet
    emergencies: dict[str, int] = field(default_factory=dict)  # of drives, in force, by joint


class Latch:
    """Counts and keeps violations; what the ``journal`` holds is latched from the start."""

    def __init__(self, journal: Journal | None = None) -> None:
        self._journal, self._saved_at, self._saved = journal, float("-inf"), 0
        self.record = Record()
        if journal is None:
            return
        try:
            self.record = _understood(journal.read())
            self._saved = self.record.count
            self._go_on(journal.counted())
        except Unreadable as e:
            self.record = _survivor(e)
            self._go_on(journal.counted())
            journal.renew(self.record)
            self._saved = self.record.count

    def _go_on(self, counts: list[int]) -> None:
        """From what was counted since the record was written, or since a later one that the disk did not take."""
        r, total = self.record, counts[0] if counts else 0
        if total <= r.count:
            return
        r.count = total
        r.why = r.why or "violations were counted that the journal of the latch does not hold"
        if len(counts) > len(r.entries):  # those that came last may be on no disk
            for entry, samples in zip(r.entries, counts[1:], strict=False):
                entry.samples = samples

    def take(self, sample: Sample, verdict: Verdict, now: float = 0.0) -> list[LatchEntry]:
        """Record a verdict at ``now`` [s]; returns the entries that are new with it."""
        if verdict.conformance is not VIOLATION:
            return []
        r = self.record
        r.count += 1
        new: list[LatchEntry] = []
        known = self.entries
        for d in verdict.deviations:
            entry = known.get((d.joint, d.state, d.side))
            if entry is None:
                entry = LatchEntry(d, d, float(sample.t), float(sample.t))
                new.append(entry)
            else:
                entry.samples += 1
                entry.last_t = float(sample.t)
                if d.fraction > entry.worst.fraction:
                    entry.worst = d
        r.entries += sorted(new, key=lambda e: -e.first.fraction)
        if not r.why:
            r.why = f"a measurement was outside its prediction ({verdict.why})"
        if new:
            self.save(now)
        elif self._journal is not None:
            self._journal.count(self._counts)
        return new

    def classed(self, cause: Cause, now: float) -> None:
        """The evidence has spoken: what came since the last time is of this class; the first violation's stays the record's."""
        for entry in self.record.entries:
            if entry.kind == Kind.UNCLASSED:
                entry.kind = cause.kind.value
        self.record.cause = self.record.cause or cause.plain()
        self.save(now)

    @property
    def kind(self) -> Kind:
        """Class of the first violation."""
        if not self.record.cause:
            return _UNCLASSED if self.record.entries else _NONE
        return Kind(self.record.cause["kind"])

    def hear(self, emergencies: dict[str, int]) -> None:
        """The emergencies that are in force from now on, by joint."""
        if emergencies != self.record.emergencies:
            self.record.emergencies = dict(emergencies)
            if self._journal is not None:
                self._journal.write(self._stored(), self._counts)

    def save(self, now: float) -> None:
        """Put what is known on disk."""
        if self._journal is not None:
            self._saved_at, self._saved = now, self.record.count
            self._journal.write(self._stored(), self._counts)

    @property
    def _counts(self) -> list[int]:
        """What changes in every cycle that violates."""
        return [self.record.count, *(e.samples for e in self.record.entries)]

    def _stored(self) -> Record:
        """The record, without the last entries if a slot has no room for so many: what comes later, an emergency, must not be refused."""
        stored = self.record
        while stored.entries and not has_room(stored):
            stored = replace(stored, entries=stored.entries[:-1])
        return stored

    def keep(self, now: float) -> str:
        """Save a count that has grown, or what the disk has refused; returns the disk's complaint, empty if none."""
        if self._journal is None:
            return ""
        if now - self._saved_at >= SAVE_EVERY and (self.record.count != self._saved or self._journal.trouble):
            self.save(now)
        self._journal.look()
        if self._journal.trouble:
            return self._journal.trouble
        notice, self._journal.notice = self._journal.notice, ""  # once
        return notice

    @property
    def latched(self) -> bool:
        return bool(self.record.why)

    @property
    def count(self) -> int:
        """Samples outside their prediction since the last reset."""
        return self.record.count

    @property
    def entries(self) -> dict[tuple[str, str, str], LatchEntry]:
        """By joint, state and side, in the order in which they came first."""
        return {(e.first.joint, e.first.state, e.first.side): e for e in self.record.entries}

    @property
    def first(self) -> LatchEntry | None:
        """The entry that came first (first-out)."""
        return self.record.entries[0] if self.record.entries else None

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that violated, in the order in which they first did."""
        return tuple(dict.fromkeys(e.first.joint for e in self.record.entries))

    def reset(self, who: str = "", why: str = "", now: float = 0.0) -> None:
        """Forget the violations; who did it and why is kept."""
        self.record = Record(reset={"name": who, "reason": why}, emergencies=self.record.emergencies)
        if self._journal is not None:
            self._saved_at, self._saved = now, 0
            self._journal.renew(self.record)

    def close(self) -> None:
        """Save the last count."""
        if self._journal is not None:
            if self.record.count != self._saved or self._journal.trouble:
                self._journal.write(self._stored(), self._counts)
            self._journal.close()


def _understood(record: Any) -> Record:
    try:
        r = msgspec.convert(record, Record)
    except msgspec.ValidationError as e:
        raise Unreadable(f"the journal of the latch holds something else ({e})") from e
    if r.schema != SCHEMA:
        raise Unreadable(f"the journal of the latch has schema {r.schema}, this version reads {SCHEMA}")
    return r


def _survivor(damage: Unreadable) -> Record:
    """Latched: with the reason and the count that are whole, if any are."""
    words = f"{damage}: a violation may have been forgotten"
    try:
        r = _understood(damage.record)
    except Unreadable:
        return Record(why=words)
    r.why = f"{r.why}; {words}" if r.why else words
    return r
