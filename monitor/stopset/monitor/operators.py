"""Orders to clear the latch, signed: the name in the log is that of the key, not what somebody typed.

An order is about the monitor's life and message that the person saw (``boot_id``, ``seq``): it cannot be used again, nor later, nor at
another arm.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import json
import queue
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from stopset.artifact.signature import key_id, public_key, secret_key
from stopset.errors import BusError
from stopset.monitor.config import ConfigError, Operator
from stopset.monitor.layout import unpack
from stopset.monitor.orders import Reset

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stopset.monitor.links.zenoh_link import ZenohLink

CONTEXT = b"stopset reset order, schema 1\n"  # no signature of anything else is one of an order
LIVES = 5000  # messages: 20 s at 250 Hz; whoever takes longer looks again
WRAP = 1 << 32  # of ``seq`` in a message


@dataclass(frozen=True, slots=True)
class Moment:
    """The message that a person had before the eyes when clearing."""

    data_id: int
    boot_id: int
    seq: int


def look(link: ZenohLink, seconds: float = 3.0) -> Moment:
    """The monitor's present message. Raises `BusError` where none comes."""
    heard: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    link.subscribe("state", lambda _, data: heard.put(data))
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        with contextlib.suppress(queue.Empty, BusError):
            reported = unpack(heard.get(timeout=left))
            return Moment(reported["data_id"], reported["boot_id"], reported["seq"])
    raise BusError(
        f"no monitor says anything here within {seconds:g} s; expected its state, for an order is signed for the message it is about: "
        "look with `stopset watch` whether it lives"
    )


def _text(order: Reset, seen: Moment) -> bytes:
    signed = [order.name, order.reason, seen.data_id, seen.boot_id, seen.seq]
    return CONTEXT + json.dumps(signed, separators=(",", ":"), ensure_ascii=True).encode()


def about(order: Reset, seen: Moment) -> Reset:
    """The order with the message that it is about: a violation after that one is not cleared."""
    return msgspec.structs.replace(order, boot_id=seen.boot_id, seq=seen.seq)


def signed(order: Reset, seen: Moment, key: str | Path, passphrase: str = "") -> Reset:
    """The order, about ``seen``, with the signature of a secret key. Raises `SigningKeyError`."""
    secret = secret_key(key, passphrase)
    signature = base64.b64encode(secret.sign(_text(order, seen))).decode()
    return msgspec.structs.replace(about(order, seen), key=key_id(secret.public_key()), signature=signature)


@dataclass(slots=True)
class Operators:
    """Who may clear the latch, by key; without any, every order that reached the monitor does, under the name it gives."""

    keys: dict[str, tuple[str, Any]] = field(default_factory=dict)
    _last: int = -1  # message at which the last order was taken

    @classmethod
    def of(cls, people: Sequence[Operator]) -> Operators:
        """The people of a configuration. Raises `SigningKeyError`, and `ConfigError` where two share a key."""
        keys: dict[str, tuple[str, Any]] = {}
        for p in people:
            key = public_key(p.key)
            other, _ = keys.setdefault(key_id(key), (p.name, key))
            if other != p.name:
                raise ConfigError(
                    f"operators {other!r} and {p.name!r} have one key, {Path(p.key).name}; expected a key for each, for the log holds the "
                    "name that belongs to it: make one with `stopset sign --new-key`"
                )
        return cls(keys)

    def refused(self, order: Reset, now: Moment, violated: int = -1) -> str:
        """Why this order does not clear the latch, empty if it does.

        ``now``: the message the monitor is at; ``violated``: the one of the last violation in this life, -1 if there was none.
        """
        if self.keys:
            if why := self._unproven(order, now.data_id):
                return why
        elif not order.boot_id:
            return ""  # an order that names no message is about all that is latched when it comes
        name, age = self.name(order), (now.seq - order.seq) % WRAP
        if order.boot_id != now.boot_id or age > LIVES:
            return f"{name}'s order is about a message of long ago, or of an earlier life of this monitor: look again, and order anew"
        if self._last >= 0 and age >= (now.seq - self._last) % WRAP:
            return f"{name}'s order was obeyed already, or another after it: look again, and order anew"
        if violated > now.seq - age:
            return f"a violation has come after the message that {name}'s order is about: look at that one too, and order anew"
        self._last = now.seq
        return ""

    def _unproven(self, order: Reset, data_id: int) -> str:
        """Why this is not what one of these people has signed, empty if it is."""
        from cryptography.exceptions import InvalidSignature  # there since the keys were read: the loop imports nothing

        if not order.key:
            return "the order is not signed; expected one by an operator's key: stopset reset --key"
        if order.key not in self.keys:
            return f"the order is signed by the key {order.key[:16]}, which is no operator's of this monitor"
        name, key = self.keys[order.key]
        try:
            key.verify(base64.b64decode(order.signature, validate=True), _text(order, Moment(data_id, order.boot_id, order.seq)))
        except (InvalidSignature, binascii.Error, ValueError):
            return f"the order is not what {name} signed, or is about another arm"
        return ""

    def name(self, order: Reset) -> str:
        """Who ordered it: the key's name where orders are signed."""
        return self.keys[order.key][0] if order.key in self.keys else order.name
