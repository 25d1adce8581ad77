"""Whether one arm speaks on ``joint_states``, or two on one key: a simulation left running beside it, two arms of one configuration.

The one whose stamps are a little behind is left out message by message, and everything else fits: nobody can tell whose samples are
judged. One sender's messages come out of order or twice now and then, two senders' do in every cycle of the slower one.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

RECENT, MOST = 128, 8  # messages looked back on; so many of them may be late
COPIES = 8  # messages that a copy of one may come after


@dataclass(slots=True)
class Senders:
    """Takes every message of this arm's joints; ``fault``: words for two senders, empty as long as nothing speaks for them."""

    _late: deque[bool] = field(default_factory=lambda: deque(maxlen=RECENT))
    _seen: deque[bytes] = field(default_factory=lambda: deque(maxlen=COPIES))

    def take(self, data: bytes, *, late: bool) -> None:
        """``late``: its stamp is not later than that of a message before. A copy, as of two ways, is no other sender's."""
        if late and data in self._seen:
            return
        self._late.append(late)
        self._seen.append(data)

    @property
    def fault(self) -> str:
        late = sum(self._late)
        if late <= MOST:
            return ""
        return (
            f"{late} of the last {len(self._late)} joint_states are not later than one before: two senders on one key, or a clock that was set "
            "back; look at who sends them"
        )
