"""A zenoh session as the daemon, the replay and the viewer use it; multicast scouting is off unless a file says otherwise."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import zenoh

from stopset.errors import BusError
from stopset.monitor.links.endpoints import check_endpoint, not_opened

PATIENCE = 5.0  # [s] with a session that closes; a tenth of a second is usual


class Alive(Protocol):
    """Hears of a token that appeared, or went."""

    def __call__(self, key: str, /, *, there: bool) -> None: ...


class ZenohLink:
    """An open session under a key prefix such as ``site/cell/arm/stopset``. Raises `BusError` when it cannot be opened.

    ``longest`` [bytes]: of what is longer, subscribers get one byte more than that, zeros, to refuse and count: taking a message over
    stops every thread of Python for as long as the copy takes, a second for some hundred megabytes.
    """

    def __init__(
        self,
        prefix: str = "",
        *,
        mode: str = "peer",
        connect: Sequence[str] = (),
        listen: Sequence[str] = (),
        file: str | Path | None = None,
        longest: int = sys.maxsize,
    ) -> None:
        self.prefix, self.longest = prefix, longest
        for endpoint in (*connect, *listen):
            check_endpoint(endpoint)
        try:
            config = zenoh.Config.from_file(str(file)) if file else zenoh.Config()
            if not file:
                config.insert_json5("mode", json.dumps(mode))
                config.insert_json5("scouting/multicast/enabled", "false")
                config.insert_json5("scouting/gossip/enabled", "false")
                # an empty list here, or a peer would listen on every interface; a client listens nowhere, whatever is asked for
                config.insert_json5("listen/endpoints", json.dumps([] if mode == "client" else list(listen)))
            # a segment that cannot be made (no room in memory, no file descriptor left) is no error there but a panic; and nobody needs it
            config.insert_json5("transport/shared_memory/enabled", "false")
            if connect:
                config.insert_json5("connect/endpoints", json.dumps(list(connect)))
            self._session = zenoh.open(config)
        except Exception as e:
            raise not_opened(str(e), connect, listen, str(file or "")) from e
        self._held: list[Any] = []

    def key(self, name: str) -> str:
        """``name`` under the prefix; with a leading slash it stands for itself."""
        return name[1:] if name.startswith("/") else f"{self.prefix}/{name}" if self.prefix else name

    def fast(self, name: str) -> Callable[[bytes], None]:
        """A publisher for the loop: real-time priority, no batching, and dropping rather than waiting."""
        p = self._session.declare_publisher(
            self.key(name),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
            reliability=zenoh.Reliability.BEST_EFFORT,
        )
        self._held.append(p)

        def put(data: bytes) -> None:
            try:
                p.put(data)
            except BaseException as e:
                raise _raised(e) from e

        return put

    def put(self, name: str, data: bytes | str, *, must_arrive: bool = False) -> None:
        """Publish on a slow key; ``must_arrive`` waits for room instead of dropping."""
        control = zenoh.CongestionControl.BLOCK if must_arrive else zenoh.CongestionControl.DROP
        try:
            self._session.put(self.key(name), data, congestion_control=control)
        except BaseException as e:
            raise _raised(e) from e

    def subscribe(self, name: str, handler: Callable[[str, bytes], None]) -> None:
        """Call ``handler(key, data)`` from zenoh's thread for every message; keep it short."""

        def take(sample: Any) -> None:
            payload = sample.payload
            data = payload.to_bytes() if len(payload) <= self.longest else bytes(self.longest + 1)
            handler(str(sample.key_expr), data)

        self._held.append(self._session.declare_subscriber(self.key(name), take))

    def serve(self, name: str, answer: Callable[[], bytes]) -> None:
        """Answer queries of a key."""
        key = self.key(name)

        def reply(query: Any) -> None:
            query.reply(key, answer())

        self._held.append(self._session.declare_queryable(key, reply, complete=True))

    def alive(self, name: str) -> None:
        """Hold a liveliness token while the session lives."""
        self._held.append(self._session.liveliness().declare_token(self.key(name)))

    def watch_alive(self, name: str, handler: Alive) -> None:
        """Call ``handler(key, there=...)`` when a token appears or goes."""

        def take(sample: Any) -> None:
            handler(str(sample.key_expr), there=sample.kind == zenoh.SampleKind.PUT)

        self._held.append(self._session.liveliness().declare_subscriber(self.key(name), take, history=True))

    def get(self, name: str, timeout: float = 2.0) -> list[tuple[str, bytes]]:
        """All answers to a query."""
        replies = self._session.get(self.key(name), timeout=timeout)
        return [(str(r.ok.key_expr), r.ok.payload.to_bytes()) for r in replies if r.ok is not None]

    def close(self) -> None:
        """End the session. One that does not come to its end in time, as happens when a query is on its way, is left to the process's
        end: whoever is told to end does."""
        closing = threading.Thread(target=self._session.close, daemon=True, name="closing")
        closing.start()
        closing.join(PATIENCE)


def _raised(e: BaseException) -> BaseException:
    """What to raise for an error of zenoh's: a panic of its Rust, no `Exception`, would pass everybody who is to go on."""
    return BusError(f"zenoh failed inside: {e}") if type(e).__name__ == "PanicException" else e
