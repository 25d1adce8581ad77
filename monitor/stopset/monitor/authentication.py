"""Who made a message: an authentication code with a key that only the daemon and its consumers have.

HMAC-SHA256, its first 128 bits (RFC 2104, section 5, allows no less than half of 256): a forger who sends a million messages a
second has a chance of 3e-33 per second. Every arm (data id) has a key file of its own; a line is a key's number and 64 hex
digits. The first key signs, consumers accept every key they hold: to change keys, add the new one to the consumers, then put
it first at the daemon, then take the old one away. No key file, no code: then only the checksums speak for the bytes.
"""

from __future__ import annotations

import hashlib
import hmac
import stat
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stopset.errors import StopsetError
from stopset.monitor.layout import MAC

KEY_BYTES = 32
BLOCK, INNER, OUTER = 64, 0x36, 0x5C  # of SHA-256, and of HMAC (RFC 2104, section 2)
MAX_KEYS = 16


class KeyFileError(StopsetError):
    """The key file cannot be used: mend it."""


def _best_sha256() -> Callable[[bytes], Any]:
    for name in ("_sha2", "_sha256"):  # since Python 3.12, and before
        if find_spec(name):
            own: Callable[[bytes], Any] = import_module(name).sha256
            return own
    return hashlib.sha256


_SHA256 = _best_sha256()


def _sha256(data: bytes = b"") -> Any:
    """The interpreter's own, where it has one: its states lie in Python's pools. OpenSSL's takes memory of the system for every message."""
    return _SHA256(data)


@dataclass(frozen=True, slots=True)
class Key:
    """One secret; ``key_id`` names it in the message."""

    key_id: int
    secret: bytes
    _inner: Any = field(init=False, compare=False, repr=False)  # have taken the secret in, once for all messages
    _outer: Any = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        secret = self.secret if len(self.secret) <= BLOCK else _sha256(self.secret).digest()
        for name, pad in (("_inner", INNER), ("_outer", OUTER)):
            object.__setattr__(self, name, _sha256(bytes(x ^ pad for x in secret.ljust(BLOCK, b"\0"))))

    def code(self, data: bytes | bytearray | memoryview) -> bytes:
        """The authentication code of ``data``: `hmac.digest`, without what that does anew for every message."""
        inner, outer = self._inner.copy(), self._outer.copy()
        inner.update(data)
        outer.update(inner.digest())
        code: bytes = outer.digest()[:MAC]
        return code

    def __repr__(self) -> str:
        return f"Key({self.key_id}, ...)"  # a secret never gets into a log


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one data id; ``first`` signs."""

    first: Key
    by_id: Mapping[int, Key]

    @classmethod
    def of(cls, *keys: Key) -> Keys:
        return cls(keys[0], {k.key_id: k for k in keys})

    def made(self, key_id: int, data: bytes, code: bytes) -> bool:
        """Whether ``code`` is that of ``data`` under a key held here."""
        key = self.by_id.get(key_id)
        return key is not None and hmac.compare_digest(key.code(data), code)


def load_keys(path: str | Path) -> Keys:
    """Read a key file; raises `KeyFileError` with one sentence for anything unusable, or readable by others."""
    p = Path(path)
    try:
        mode = p.stat().st_mode
        text = p.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError) as e:
        raise KeyFileError(f"{p}: the key file cannot be read ({e}); expected lines of a number and 64 hex digits") from e
    if mode & (stat.S_IRWXG | stat.S_IRWXO) & ~stat.S_IRGRP:
        raise KeyFileError(
            f"{p} has mode {mode & 0o777:o}: others could read or change the key; expected 600 or 640: chmod 600 it"
        )
    keys: list[Key] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        good = len(words) == 2 and words[0].isdigit() and 1 <= int(words[0][:11]) < 2**32 and len(words[1]) == 2 * KEY_BYTES
        try:
            keys.append(Key(int(words[0]), bytes.fromhex(words[1])) if good else Key(0, b""))
        except ValueError:
            good = False
        if not good:
            raise KeyFileError(
                f"{p}, line {number}: expected a number from 1 to 4294967295 and 64 hex digits (openssl rand -hex 32)"
            )
    if not 1 <= len(keys) <= MAX_KEYS or len({k.key_id for k in keys}) != len(keys):
        raise KeyFileError(f"{p} holds {len(keys)} keys; expected 1 to {MAX_KEYS} with different numbers: mend it")
    return Keys.of(*keys)
