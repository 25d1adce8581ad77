"""A person clears what is latched, if this one may, and has seen it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from stopset.monitor.latch import Latch
from stopset.monitor.operators import Moment, Operators
from stopset.monitor.orders import Reset
from stopset.monitor.publisher import Publisher
from stopset.monitor.source import SampleSource, drives_of

if TYPE_CHECKING:
    from stopset.monitor.clock import Clock

HIDDEN = 2.0  # [s] that an emergency must have been said, not hidden by a violation, before an order can be about it
REACTION = (
    0.25  # [s] that a violation must have been told before an order that names no message can be about it: nobody is faster
)


@dataclass(slots=True)
class Clearing:
    """Orders of ``operators`` against what the ``latch`` holds; ``data_id``: of this arm. Says what came of each."""

    operators: Operators
    latch: Latch
    publisher: Publisher
    data_id: int
    clock: Clock
    violated: int = -1  # the message that told the last violation of this life
    violated_at: float = float("-inf")  # [s] when that was
    _seen: float = 0.0  # [s] until when nobody can have seen all emergencies

    def __post_init__(self) -> None:
        self._seen = self.clock.monotonic()

    def emergency(self) -> None:
        """Another one is in force."""
        self._seen = self.clock.monotonic()

    def violation(self) -> None:
        """Another one is told with the next message."""
        self.violated, self.violated_at = self.publisher.seq, self.clock.monotonic()

    def take(self, order: Reset | None, now: float, source: SampleSource) -> None:
        """Clear the latch; where nothing is latched, the emergencies, which a latch would have hidden. None: no order that is understood."""
        p = self.publisher
        emergencies = {} if self.latch.latched else self.latch.record.emergencies
        if why := self._refused(order, now, hidden=bool(emergencies)):
            p.seldom("reset_refused", why=why)
            return
        assert order is not None
        who = self.operators
        name = who.name(order)
        p.event(
            "reset", name=name, reason=order.reason, proven=bool(who.keys), key=order.key if who.keys else "",
            cleared=self.latch.count, joints=list(self.latch.joints),
            emergencies={joint: f"0x{code:04X}" for joint, code in emergencies.items()},
        )  # fmt: skip
        self._seen = now
        self.latch.reset(name, order.reason, now)
        if emergencies:
            self.latch.hear({})
            if (drives := drives_of(source)) is not None:
                drives.dismiss()

    def _refused(self, order: Reset | None, now: float, *, hidden: bool) -> str:
        """Why this order clears nothing, empty if it does; ``hidden``: there are emergencies that it would be about."""
        if order is None:
            return 'expected {"name": who, "reason": why}'
        if not order.boot_id and now - self.violated_at < REACTION:
            return "the arm left its model only now, which nobody who ordered can have seen; look at that one too, and order anew"
        if why := self.operators.refused(order, Moment(self.data_id, self.publisher.boot, self.publisher.seq), self.violated):
            return why
        if hidden and now - self._seen < HIDDEN:
            return "a drive's emergency has come, or come to light, only now; look at it, and order anew"
        return ""
