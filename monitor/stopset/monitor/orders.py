"""What others ask of the daemon, held at the door: sizes, kinds and numbers are limited here, and nothing here can raise."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Annotated

import msgspec

from stopset.errors import BusError

MAX_NONCE = 64  # bytes of a challenge; more are cut off
MAX_RESET = 4096
CHALLENGES, RESETS = 16, 4  # that may wait; of more the oldest are dropped
A_TURN = 4  # challenges answered in one turn of the loop

_Text = Annotated[str, msgspec.Meta(min_length=1, max_length=200)]


class Reset(msgspec.Struct, frozen=True):
    """Who clears the latch, and why; ``boot_id`` and ``seq`` of the message it is about, 0 for whatever is latched when it comes;
    signed, if the monitor asks for it (`stopset.monitor.operators`)."""

    name: _Text
    reason: _Text
    boot_id: int = 0
    seq: int = 0
    key: Annotated[str, msgspec.Meta(max_length=64)] = ""
    signature: Annotated[str, msgspec.Meta(max_length=200)] = ""

    @classmethod
    def of(cls, name: str, reason: str) -> Reset:
        """An order as the monitor will take it; raises `BusError` for one that it would not."""
        order = parse_reset(msgspec.json.encode({"name": name, "reason": reason}))
        if order is None:
            raise BusError(
                f"a name of {len(name.strip())} and a reason of {len(reason.strip())} letters; expected 1 to 200 each: say who and why"
            )
        return order

    def text(self) -> bytes:
        """The order's message."""
        return msgspec.json.encode(self)


_decode = msgspec.json.Decoder(Reset).decode


def parse_reset(data: bytes) -> Reset | None:
    """The order in ``data``; None for anything that is not one."""
    try:
        r = _decode(data)
        r = msgspec.structs.replace(r, name=r.name.strip(), reason=r.reason.strip())
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return None
    return r if r.name and r.reason else None


@dataclass(slots=True)
class Orders:
    """Waiting challenges and resets; `take` is called from zenoh's threads, the rest from the loop."""

    dropped: int = 0
    _challenges: deque[bytes] = field(default_factory=lambda: deque(maxlen=CHALLENGES))
    _resets: deque[bytes] = field(default_factory=lambda: deque(maxlen=RESETS))

    def take(self, key: str, data: bytes) -> None:
        """Nothing but the queue."""
        reset = key.rsplit("/", 1)[-1] == "reset"
        if not reset and len(data) > MAX_RESET:  # no nonce, and perhaps not even what was sent
            self.dropped += 1
            return
        waiting = self._resets if reset else self._challenges
        self.dropped += len(waiting) == waiting.maxlen
        waiting.append(data[: MAX_RESET + 1 if reset else MAX_NONCE])

    def challenges(self) -> list[bytes]:
        """Some of the waiting nonces, oldest first."""
        if not self._challenges:
            return []
        return [self._challenges.popleft() for _ in range(min(A_TURN, len(self._challenges)))]

    def reset(self) -> tuple[Reset | None] | None:
        """The next order to clear the latch (None inside: one that is not to be understood); None when there is none."""
        if not self._resets:
            return None
        data = self._resets.popleft()
        return (parse_reset(data) if len(data) <= MAX_RESET else None,)
