"""How a consumer must read the state: every doubt is FAULT. ``deploy/plc/stopset_consumer.h`` is the same in C.

No common clock is needed. The consumer sends a random nonce on ``challenge``; the first message that carries it was made after
it was sent and before it was heard, which bounds how far the daemon's clock is from the consumer's, and proves that this
daemon, in this life (``boot_id``), is there now. From then on the age of every message's data is known to within that bound,
as long as the daemon goes on to be believed: one whose clock was set says so by not being OK for a while, and whoever then went on
with the bound from before would take data for younger than they are, by as much as messages are under way.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from stopset.errors import BusError
from stopset.monitor.authentication import Keys
from stopset.monitor.layout import State, offsets, unpack

MS = 1_000_000
DRIFT_PPM = 1000  # two clocks part by no more than this: each is brought nearer to the time by at most 500, as Linux does it
CHALLENGE_EVERY = 200 * MS  # [ns]
PROOF_LIFE = 1000 * MS  # [ns] an answered challenge is believed for this long
_MAC_AT = offsets()["mac"]
_BELIEVED = (State.OK, State.DEGRADED)


class Fault(IntEnum):
    """Why a message was refused or a state is FAULT; the same numbers in C."""

    NONE = 0
    NO_MESSAGE = 1
    UNREADABLE = 2
    FOREIGN = 3
    FORGED = 4
    OTHER_MODEL = 5
    OTHER_CONFIG = 6
    REPEATED = 7
    UNPROVEN = 8
    SILENT = 9
    STALE = 10
    AHEAD = 11
    NO_SUCH_STATE = 12


SAYS = {
    Fault.NONE: "", Fault.NO_MESSAGE: "no message yet", Fault.UNREADABLE: "a message was damaged or of another version",
    Fault.FOREIGN: "a message of another data id", Fault.FORGED: "a message whose authentication code is not of a key held here",
    Fault.OTHER_MODEL: "a message of another model than is expected",
    Fault.OTHER_CONFIG: "a message of another configuration than is expected: a monitor keeps the one it was started with",
    Fault.REPEATED: "a message repeated or out of order", Fault.UNPROVEN: "no answer to my challenge by this daemon",
    Fault.SILENT: "silent", Fault.STALE: "the data may be older than they are valid for",
    Fault.AHEAD: "the data are stamped later than now", Fault.NO_SUCH_STATE: "unknown state code",
}  # fmt: skip


def _drift_of(span: int) -> int:
    """By how much [ns] two clocks part in ``span`` [ns], at most."""
    return max(0, span) * DRIFT_PPM // 1_000_000 + 1


@dataclass(frozen=True, slots=True)
class Expected:
    """Whose messages are wanted; nothing has a default. ``model_hash``, ``config_hash``: None = taken as they come, which a
    display may do and a controller must not. ``keys``: None = no authentication code is asked for."""

    data_id: int
    model_hash: int | None
    config_hash: int | None
    keys: Keys | None

    @classmethod
    def of(cls, data_id: int, model_sha256: str, config_sha256: str, keys: Keys | None) -> Expected:
        """From the full hashes of the model file and the configuration."""
        return cls(data_id, int(model_sha256[:16], 16), int(config_sha256[:16], 16), keys)


@dataclass(slots=True)
class Consumer:
    """Takes messages, answers what may be believed now; times in ns of the consumer's own clock, see `stopset.monitor.clock.own_ns`.

    ``watchdog``: longest silence; at least two cycles and jitter. Send what `challenge` gives.
    """

    expected: Expected
    watchdog: int = 50 * MS
    last: dict[str, Any] | None = None
    arrived: int = 0
    lost: int = 0
    refused: Counter[Fault] = field(default_factory=Counter)
    why: Fault = Fault.NO_MESSAGE
    _refusal: Fault = Fault.NO_MESSAGE  # of the message refused last, and when
    _refused_at: int | None = None
    _nonce: int = 0  # the one that waits for its answer, 0 none
    _asked: int = 0
    _answered: int = 0  # the one before it
    _beside: int | None = None  # when another living sender was heard beside the one that is believed
    _boot: int | None = None  # the life that has answered last
    _proved: int = 0
    _lo: int = 0  # daemon's clock minus mine, at _proved: not less than _lo, not more than _hi
    _hi: int = 0
    _settled: bool = False  # OK or DEGRADED has come without a break since the last answer: its clock was not set meanwhile

    def challenge(self, now: int, random: int) -> bytes | None:
        """The nonce to send now, made of ``random`` (64 fresh bits); None when it is not time."""
        due = PROOF_LIFE // 2 if self._nonce else CHALLENGE_EVERY
        if self._asked and now - self._asked < due:
            return None
        self._nonce, self._asked = random or 1, now
        return self._nonce.to_bytes(8, "little")

    def take(self, data: bytes, now: int) -> Fault:
        """A message arrived at ``now``; a doubtful one counts as silence. Returns the doubt."""
        try:
            m = unpack(data)
        except BusError:
            return self._refuse(Fault.UNREADABLE, now)
        if fault := self._stranger(m, data):
            return self._refuse(fault, now)
        alive = self.last is not None and now - self.arrived <= self.watchdog
        answer = self._nonce != 0 and self._nonce in m["nonces"]
        if m["boot_id"] != self._boot and alive:  # another sender beside the one that is there
            if answer or (self._answered and self._answered in m["nonces"]):
                self._beside = now  # which lives too: two monitors have this data id, and one of them may watch another arm
            return self._refuse(Fault.UNPROVEN, now)
        if m["boot_id"] != self._boot and not answer:
            return self._refuse(Fault.UNPROVEN, now)
        if self.last is not None and m["boot_id"] == self.last["boot_id"]:
            step = (m["seq"] - self.last["seq"]) & 0xFFFFFFFF
            if not 0 < step < 1 << 31:
                return self._refuse(Fault.REPEATED, now)
            self.lost += step - 1
        believed = m["state"] in _BELIEVED
        self._settled = self._settled and believed and alive
        if answer:
            self._prove(m, now)
            self._settled = believed
        elif now + self._hi + self._drift(now) < m["t_pub_ns"]:  # made later than now: its clock has been set forward
            self._proved = now - PROOF_LIFE - 1
        self.last, self.arrived = m, now
        return Fault.NONE

    def _stranger(self, m: dict[str, Any], data: bytes) -> Fault:
        e = self.expected
        if m["data_id"] != e.data_id:
            return Fault.FOREIGN
        if e.keys is not None and not e.keys.made(m["key_id"], data[:_MAC_AT], bytes(m["mac"])):
            return Fault.FORGED
        if e.model_hash is not None and m["model_hash"] != e.model_hash:
            return Fault.OTHER_MODEL
        if e.config_hash is not None and m["config_hash"] != e.config_hash:
            return Fault.OTHER_CONFIG
        return Fault.NONE

    def _prove(self, m: dict[str, Any], now: int) -> None:
        since = _drift_of(now - self._asked)  # it was made between the two, and the clocks have parted further since
        lo, hi = m["t_pub_ns"] - now - since, m["t_pub_ns"] - self._asked + since
        if m["boot_id"] == self._boot and self._settled:  # what was known before still holds, but for the drift since
            drift = self._drift(now)
            before = max(lo, self._lo - drift), min(hi, self._hi + drift)
            if before[0] <= before[1]:
                lo, hi = before
        self._boot, self._proved, self._lo, self._hi = m["boot_id"], now, lo, hi
        self._answered, self._nonce = self._nonce, 0

    def _drift(self, now: int) -> int:
        return _drift_of(now - self._proved)

    def _refuse(self, fault: Fault, now: int) -> Fault:
        self.refused[fault] += 1
        self._refusal, self._refused_at = fault, now
        return fault

    def state(self, now: int) -> State:
        """What holds at ``now``: the daemon's state, or FAULT if there is any doubt, which is then in ``why``."""
        self.why = self._fault(now)
        return State.FAULT if self.why else State(self.last["state"])  # type: ignore[index]

    def _fault(self, now: int) -> Fault:
        m = self.last
        if m is None or now - self.arrived > self.watchdog:
            if self._refused_at is not None and now - self._refused_at <= self.watchdog:
                return self._refusal  # somebody speaks, but not as is expected
            return Fault.NO_MESSAGE if m is None else Fault.SILENT
        if now - self._proved > PROOF_LIFE or (self._beside is not None and now - self._beside <= PROOF_LIFE):
            return Fault.UNPROVEN
        if m["state"] not in tuple(State) or m["state"] == State.NEVER_SENT:
            return Fault.NO_SUCH_STATE
        if m["state"] not in _BELIEVED:  # nothing in it is to be used
            return Fault.NONE
        if not self._settled:
            return Fault.UNPROVEN
        oldest = now + self._hi + self._drift(now) - m["t_meas_ns"]
        if oldest < 0:
            return Fault.AHEAD
        return Fault.STALE if oldest > m["valid_for_ms"] * MS else Fault.NONE

    @property
    def rejected(self) -> int:
        """Messages refused so far."""
        return sum(self.refused.values())
