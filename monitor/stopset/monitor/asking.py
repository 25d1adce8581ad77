"""What one category of stops asks the other process for, when, and what that may cost.

Proofs take processor time. It is earned: a share of a core, saved up to `FULL`. Who has saved asks for boxes that are left soon and
give tight numbers, who has spent what was earned for boxes that live as long as the next one takes to earn.
"""

from __future__ import annotations

from dataclasses import dataclass

from stopset.monitor.ahead import LONG, NARROW, WIDE, Heading, Size
from stopset.monitor.certificates import Certificate, Shelf
from stopset.types import Array

SLOWER = 2.0  # an answer is expected to take no longer than so many times what the last ones took
FIRST = 0.02  # [s] an answer takes that was never measured
LONGEST = 0.3  # [s] a slower answer finds the arm outside its box
WIDE_CAPACITY = 256  # certificates of wide boxes, per category
PATIENCE = 6  # narrow boxes asked for after a wide one had no bound
SHRINKS, GROWS, LEAST = 0.6, 1.1, 0.1  # of `Counter.reach`, after a refusal and after a bound
# [s] of processor time that is saved at most, and at the start: a motion never seen is bounded tightly at once, and five seconds of it cost
# no more than the share; six times as much bounds no more states, and after the first round none more tightly
FULL, BEGIN = 0.5, 0.2
RECENT = 0.2  # part that the newest answer has in what a box is said to cost
FARTHEST = 0.4  # [s] a long box reaches ahead at most: a longer one hardly says more than a wide one


@dataclass(slots=True)
class Budget:
    """Processor time of the other process; ``share``: of a core it may take in the long run."""

    share: float
    saved: float = BEGIN  # [s] below zero after an answer that cost more
    total: float = 0.0  # [s] spent so far
    _when: float | None = None

    def at(self, now: float) -> None:
        """It is ``now`` [s]."""
        if self._when is not None:
            self.saved = min(FULL, self.saved + self.share * max(0.0, now - self._when))
        self._when = now

    def spend(self, seconds: float) -> None:
        """An answer has cost so much."""
        self.saved -= seconds
        self.total += seconds

    @property
    def spent(self) -> bool:
        """Nothing more may be asked for now."""
        return self.saved <= 0.0

    def ahead(self, cost: float) -> float:
        """How far [s] a box shall reach where one costs ``cost`` [s]: with half of `FULL` saved they are earned as fast as spent."""
        short = 2.0 * (1.0 - max(0.0, self.saved) / FULL)
        return min(max(NARROW.ahead, short * cost / self.share), FARTHEST)


def _part(part: float, *, proven: bool) -> float:
    """What part of a box is asked for after an answer."""
    return min(1.0, GROWS * part) if proven else max(SHRINKS * part, LEAST)


@dataclass(slots=True)
class Counter:
    """What one category has asked for and got; ``rivals``: so many categories live on the same budget."""

    narrow: Shelf
    long: Shelf
    wide: Shelf
    budget: Budget
    rivals: int
    answer: Certificate | None = None  # the one in use
    refused: Certificate | None = None  # the newest that has no number
    waiting: Size | None = None  # asked for
    only_narrow: int = 0  # so many answers, as a wide box could not be proved
    reach: float = 1.0  # part of a wide box's time ahead that is asked for: less where more could not be proved
    stretch: float = 1.0  # likewise of what a long box reaches beyond a narrow one
    took: float = (
        FIRST  # [s] narrow and long boxes of late; a wide one may take a hundred times as much and says nothing of theirs
    )
    took_wide: float = FIRST
    cost: float = 0.0  # [s] of processor time a narrow or long box of late
    least_cost: float = 0.0  # [s] the least that this was

    @classmethod
    def of(cls, n: int, budget: Budget, rivals: int) -> Counter:
        return cls(Shelf(n), Shelf(n), Shelf(n, WIDE_CAPACITY), budget, rivals)

    @property
    def dearer(self) -> float:
        """How many times as much processor time as once a box takes: on a busy machine, or where the motion is harder to bound."""
        return self.cost / self.least_cost if self.least_cost else 1.0

    @property
    def certificates(self) -> int:
        """Certificates on the shelves."""
        return len(self.narrow.answers) + len(self.long.answers) + len(self.wide.answers)

    def best(self, x: Array, slack: Array) -> Certificate | None:
        """The tightest certificate kept for a reading."""
        return self.narrow.best(x, slack) or self.long.best(x, slack) or self.wide.best(x, slack)

    def holds(self, x: Array, slack: Array) -> Certificate | None:
        """The certificate in use as long as it holds, else the tightest kept."""
        if self.answer is None or not self.answer.covers(x, slack):
            self.answer = self.best(x, slack)
        return self.answer

    def take(self, answer: Certificate) -> None:
        """An answer has come."""
        size, self.waiting = self.waiting, None
        self.budget.spend(answer.cpu)
        if size is WIDE:
            self.took_wide = min(max(answer.took, 0.7 * self.took_wide), LONGEST)
        else:
            self.took = min(max(answer.took, 0.7 * self.took), LONGEST)
            self.took_wide = max(0.7 * self.took_wide, self.took)  # where one failed a smaller one, which takes less, is next
            self.cost += RECENT * (answer.cpu - self.cost) if self.cost else answer.cpu
            self.least_cost = min(self.least_cost or self.cost, self.cost)
        proven = answer.numbers.proven
        if proven:
            (self.narrow if size is NARROW else self.long if size is LONG else self.wide).put(answer)
        else:
            self.refused = answer
        if size is WIDE:
            self.reach, self.only_narrow = _part(self.reach, proven=proven), self.only_narrow if proven else PATIENCE
        elif size is LONG:
            self.stretch = _part(self.stretch, proven=proven)

    def lacks(self, motion: Heading, slack: Array, period: float) -> tuple[float, Size] | None:
        """What to ask for next, if anything: how far ahead [s] and which size, with ``period`` [s] until it is asked again.

        A wide box where none holds the state now or will when an answer could be there; a narrow one likewise, or a long one where
        narrow ones cost more than is earned.
        """
        lead, lead_wide = SLOWER * self.took + period, SLOWER * self.took_wide + period
        here, soon, later = motion.at(0.0), motion.at(lead), motion.at(2.0 * lead_wide)
        self.answer = self.best(here, slack)  # a tighter one may have come
        if self.budget.spent:
            return None
        if not self.only_narrow and (self.wide.best(here, slack) is None or self.wide.best(later, slack) is None):
            return lead_wide + self.reach * (lead_wide + WIDE.ahead), WIDE
        ahead = NARROW.ahead + self.stretch * (self.budget.ahead(self.rivals * self.cost) - NARROW.ahead)
        size = NARROW if ahead <= NARROW.ahead else LONG
        if self.narrow.best(soon, slack) or (size is LONG and self.long.best(soon, slack)):
            return None
        self.only_narrow = max(0, self.only_narrow - 1)
        return lead + ahead, size
