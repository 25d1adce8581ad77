"""How a consumer must read the state: every doubt is FAULT. The PLC examples in ``deploy/plc`` do the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stopset.errors import BusError
from stopset.monitor.layout import State, unpack


@dataclass(slots=True)
class Consumer:
    """Takes messages, answers what may be believed now. ``watchdog_s``: longest silence; at least two cycles and jitter.

    A common clock is not needed: silence is measured with the consumer's own clock, and a message that was delayed on the
    way is found by its nonce (see `stopset.monitor.daemon`) or by the sequence number of the next one.
    """

    data_id: int
    watchdog_s: float = 0.05
    last: dict[str, Any] | None = None
    arrived: float = float("-inf")
    rejected: int = 0
    lost: int = 0
    why: str = "no message yet"

    def take(self, data: bytes, now: float) -> None:
        """A message arrived at ``now`` [s, own monotonic clock]; a bad one counts as silence."""
        try:
            m = unpack(data)
        except BusError as e:
            return self._reject(str(e))
        if m["data_id"] != self.data_id:
            return self._reject(f"message of source {m['data_id']}, expected {self.data_id}")
        if self.last is not None and m["boot_id"] == self.last["boot_id"]:
            step = (m["seq"] - self.last["seq"]) & 0xFFFFFFFF
            if not 0 < step < 1 << 31:
                return self._reject(f"sequence number {m['seq']} after {self.last['seq']}: repeated or old")
            self.lost += step - 1
        self.last, self.arrived = m, now
        return None

    def _reject(self, why: str) -> None:
        self.rejected += 1
        self.why = why

    def state(self, now: float) -> State:
        """What holds at ``now``: the sender's state, or FAULT if it is silent, stale or unintelligible."""
        if self.last is None or now - self.arrived > self.watchdog_s:
            if self.last is not None:
                self.why = f"silent for {(now - self.arrived) * 1e3:.0f} ms"
            return State.FAULT
        try:
            state = State(self.last["state"])
        except ValueError:
            self.why = f"unknown state code {self.last['state']:#x}"
            return State.FAULT
        return State.FAULT if state is State.NEVER_SENT else state
