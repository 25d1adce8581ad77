"""What the daemon says, and that it always says something: an error on the way out is counted, never raised."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import msgspec
import numpy as np

from stopset.monitor.authentication import Key
from stopset.monitor.clock import Clock
from stopset.monitor.layout import CATEGORIES, MAX_JOINTS, NONCES, PREFIX, Flag, State
from stopset.monitor.packer import Changing, Packer

MAX_EVENTS = 100  # kept for those who ask later
U64 = 2**64 - 1


class Outlet(Protocol):
    """Where messages go; `stopset.monitor.links.zenoh_link.ZenohLink` in production."""

    def fast(self, name: str) -> Callable[[bytes], None]: ...
    def put(self, name: str, data: bytes | str, *, must_arrive: bool = False) -> None: ...
    def subscribe(self, name: str, handler: Callable[[str, bytes], None]) -> None: ...
    def serve(self, name: str, answer: Callable[[], bytes]) -> None: ...
    def alive(self, name: str) -> None: ...


class Publisher:
    """Numbers the messages of one life (``boot``), signs and sends them; ``identity``: fields that stay the same."""

    def __init__(self, outlet: Outlet, clock: Clock, identity: Mapping[str, int], key: Key | None, boot: int) -> None:
        self.outlet, self.clock, self.identity = outlet, clock, dict(identity)
        self.boot, self.seq, self.errors, self.error = boot, 0, 0, ""
        self.events: deque[dict[str, Any]] = deque(maxlen=MAX_EVENTS)
        self._nonces: deque[int] = deque([0] * NONCES, maxlen=NONCES)
        self._packer = Packer(key)
        self._send = outlet.fast("state")
        self._said: dict[str, float] = {}
        inf = np.full(MAX_JOINTS, np.inf)
        self._nothing: dict[str, Any] = {"state": int(State.FAULT), "flags": int(Flag.FALLBACK_IN_FORCE), "room_min": -np.inf}
        for c in CATEGORIES:
            for name in ("time", "angle_forward", "angle_back", "time_max", "tcp"):
                self._nothing[f"{PREFIX[c]}_{name}"] = inf if name in ("time", "angle_forward", "angle_back") else np.inf

    def state(self, now: Changing, block: Mapping[str, Any], made_ns: int) -> None:
        """The next state message; values that cannot be packed go out as FAULT without numbers.

        ``block``: fields that stay while it is the same object. ``made_ns`` [ns since the epoch]: the instant the state was judged for.
        Stamped any later, a daemon that stood still in between, or whose clock was set, would say OK of a moment nobody judged.
        """
        number = self.seq & 0xFFFFFFFF, self.boot, made_ns & U64
        try:
            data = self._packer.again(now, number, self._nonces, block)
        except Exception as e:  # noqa: BLE001 - whatever it is, the consumers must hear FAULT rather than nothing
            self._failed("a message could not be packed", e)
            data = self._bare(number)
        self._out(data)

    def nothing(self) -> None:
        """The next state message is FAULT without numbers."""
        self._out(self._bare((self.seq & 0xFFFFFFFF, self.boot, self.clock.time_ns() & U64)))

    def _bare(self, number: tuple[int, int, int]) -> bytes:
        seq, boot, t_pub = number
        now = {"seq": seq, "boot_id": boot, "t_pub_ns": t_pub, "nonces": tuple(self._nonces)}
        return self._packer.pack({**self.identity, **self._nothing, **now})

    def _out(self, data: bytes) -> None:
        self.seq += 1
        try:
            self._send(data)
        except Exception as e:  # noqa: BLE001 - the consumers' watchdogs tell them; the loop must go on
            self._failed("a message could not be sent", e)

    def words(self, name: str, content: Any, *, must_arrive: bool = False) -> None:
        """JSON on a slow key."""
        try:
            self.outlet.put(name, msgspec.json.encode(content), must_arrive=must_arrive)
        except Exception as e:  # noqa: BLE001 - as above
            self._failed(f"{name} could not be sent", e)

    def _failed(self, what: str, e: Exception) -> None:
        self.errors += 1
        self.error = f"{what} ({type(e).__name__}: {e})"

    def event(self, kind: str, **more: Any) -> None:
        """Something happened; kept for later questions, without its ``evidence``."""
        event = {"kind": kind, "t_ns": self.clock.time_ns(), "seq": self.seq, **more}
        self.events.append({k: v for k, v in event.items() if k != "evidence"})
        self.words("event", event)

    def seldom(self, kind: str, **more: Any) -> None:
        """An event at most once a second; the counts in ``health`` are complete."""
        now = self.clock.monotonic()
        if now - self._said.get(kind, float("-inf")) > 1.0:
            self._said[kind] = now
            self.event(kind, **more)

    def echo(self, nonce: bytes) -> None:
        """Answer a challenge: in JSON at once, and in the coming messages for those who read only them."""
        first = int.from_bytes(nonce[:8], "little")
        if first and first not in self._nonces:
            self._nonces.appendleft(first)
        answer = {"nonce": nonce.hex(), "seq": self.seq, "boot_id": f"{self.boot:016x}", "t_pub_ns": self.clock.time_ns()}
        self.words("echo", answer)
