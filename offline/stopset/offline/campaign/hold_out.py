"""What is fitted and what judges: the one rule by which recordings are divided, for every command.

Whole motions where there are enough of them, else repetitions of one motion, else blocks of time with a guard interval between
them, because neighbouring samples share their friction and their noise.  Errors on blocks of a motion speak of that motion only,
and the answer says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from stopset.offline.campaign.independence import Ends, goes_on
from stopset.offline.campaign.survey import Survey
from stopset.offline.campaign.trials import Source
from stopset.recording import Recording

FOLDS = 6  # parts that are left out in turn where an error is judged
FEWEST_MOTIONS = 4  # from which on every other motion judges
BLOCK = 2.5  # [s] about, of one trial
GUARD = 0.3  # [s] at each end of a block that judges: longer than the filters, and than friction takes to settle after a reversal
SHORTEST = 1.5  # [s] of a block

Pieces = Callable[[Recording], Iterator[Recording]]
OTHER_MOTIONS, OTHER_REPETITIONS = "every other motion", "every other repetition"


@dataclass(frozen=True, slots=True)
class HoldOut:
    """``fitted``, ``judged``: the parts of a trial for either side; ``words``: what judges, for people."""

    words: str
    fitted: Pieces
    judged: Pieces

    def to_fit(self, source: Source) -> Source:
        """What is fitted, poses at rest included: they belong to no motion."""
        return lambda: (x for r in source() for x in ([r] if r.phase == "static" else self.fitted(r)))

    def to_judge(self, source: Source) -> Source:
        """What judges."""
        return lambda: (x for r in source() if r.phase != "static" for x in self.judged(r))


def hold_out(found: Survey) -> HoldOut:
    """The division of the recordings that were surveyed."""
    if len(set(found.motion.values())) >= FEWEST_MOTIONS:
        return _whole(OTHER_MOTIONS, lambda r: found.motion.get(r.suite_key, r.begun) % 2 == 1)
    if found.session.repeats > 1 and not _cut(found.sample):
        return _whole(OTHER_REPETITIONS, lambda r: r.repetition % 2 == 1)
    return in_time()


def in_time() -> HoldOut:
    """Every other block of each trial judges, less a guard interval at its ends."""
    words = f"every other block of about {BLOCK:g} s, {GUARD:g} s away from what was fitted: this speaks of the same motion only"
    return HoldOut(words, lambda r: _blocks(r, 0, 0.0), lambda r: _blocks(r, 1, GUARD))


def _whole(words: str, judges: Callable[[Recording], bool]) -> HoldOut:
    return HoldOut(words, lambda r: iter(() if judges(r) else (r,)), lambda r: iter((r,) if judges(r) else ()))


def blocks(r: Recording, guard: float = GUARD) -> list[Recording]:
    """A trial in blocks of about `BLOCK`, each ``guard`` [s] shorter at both ends; one that is too short stays whole."""
    seconds = float(r.t[-1] - r.t[0])
    if seconds < 2 * SHORTEST:
        return [r]
    count = max(2, round(seconds / BLOCK))
    edges = [round(k * len(r.t) / count) for k in range(count + 1)]
    # another trial's clock and state begin anew: no guard is needed at a trial's own ends, but cut trials have no own ends
    off = round(guard * (len(r.t) - 1) / seconds)
    return [r.cut(lo + off, hi - off) for lo, hi in pairwise(edges)]


def _blocks(r: Recording, which: int, guard: float) -> Iterator[Recording]:
    """Blocks 0, 2, ... (``which`` 0) or 1, 3, ... of a trial; short trials go alternately."""
    parts = blocks(r, guard)
    yield from parts[which::2] if len(parts) > 1 else parts * (r.place % 2 == which)


def _cut(trials: Sequence[Recording]) -> bool:
    """Whether a trial goes on where another one ended."""
    ends = [Ends.of(r) for r in trials]
    return any(goes_on(a, b) for a, b in pairwise(ends))
