"""CAN buses by name: ``interface:channel?option=value``, any python-can interface, and a hub for machines without CAN.

``socketcan:can0`` in production; across processes on one machine ``hub:28700`` (a TCP bus on loopback that speaks the
socketcand protocol, so any python-can program can join with ``interface="socketcand"``) or ``udp_multicast:239.74.163.2``.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Any, Protocol
from urllib.parse import parse_qsl

import can

from stopset.errors import BusError
from stopset.monitor.links.batch import Frame, Listener
from stopset.monitor.links.hub import Hub, HubClient
from stopset.monitor.links.socketcan import SocketCanListener, usable

GROUP = "stopset.links"


class Talker(Protocol):
    """A bus as the replay sees it."""

    def send(self, cob_id: int, data: bytes) -> None: ...
    def close(self) -> None: ...


class Link(Protocol):
    """A kind of bus from another package, registered under its name in the entry-point group `GROUP`; ``channel`` is what
    stands behind the colon. Both raise `BusError` when it cannot be opened."""

    def listen(self, channel: str) -> Listener: ...
    def talk(self, channel: str) -> Talker: ...


@cache
def registered() -> Mapping[str, Link]:
    """Links of installed packages by name. Raises `BusError` for one that cannot be used, or takes a name of ours."""
    found: dict[str, Link] = {}
    for entry in sorted(entry_points(group=GROUP), key=lambda e: e.name):
        try:
            link = entry.load()
        except Exception as e:
            raise BusError(
                f"link {entry.name} of {entry.value} cannot be loaded ({type(e).__name__}: {e}); mend or remove that package"
            ) from e
        if not all(callable(getattr(link, name, None)) for name in ("listen", "talk")):
            raise BusError(f"link {entry.name} of {entry.value} is no link; expected it to listen and talk: mend that package")
        if entry.name in found or entry.name in ("hub", "remote", *can.VALID_INTERFACES):
            raise BusError(f"link {entry.name} of {entry.value} has the name of another one; rename it")
        found[entry.name] = link
    return MappingProxyType(found)


def parse(spec: str) -> tuple[str, str, dict[str, Any]]:
    """``(interface, channel, options)`` of a bus's name; numbers in options become numbers."""
    head, _, query = spec.partition("?")
    interface, _, channel = head.partition(":")
    known = {"hub", "remote", *can.VALID_INTERFACES, *registered()}
    if interface not in known or not channel:
        raise BusError(
            f"bus {spec!r}: expected INTERFACE:CHANNEL such as socketcan:can0, hub:28700 or udp_multicast:239.74.163.2 "
            f"(interfaces here: {', '.join(sorted(known))})"
        )
    return interface, channel, {k: int(v) if v.lstrip("-").isdigit() else v for k, v in parse_qsl(query)}


def may_hold_a_robot(spec: str) -> bool:
    """Whether a real arm could hear what is sent there: not on buses that only programs share. (A bad name is another matter.)"""
    interface = spec.partition("?")[0].partition(":")[0]
    return (interface in can.VALID_INTERFACES or interface in registered()) and interface not in (
        "virtual",
        "udp_multicast",
        "serial",
    )


def _python_can(spec: str, **extra: Any) -> can.BusABC:
    interface, channel, options = parse(spec)
    if interface == "udp_multicast":
        options.setdefault("hop_limit", 0)  # never leaves this machine unless asked to
    if interface == "socketcand":
        place, _, name = channel.partition("/")
        host, _, port = place.partition(":")
        channel, options = name or "can0", {"host": host, "port": int(port or 29536), **options}
    try:
        return can.Bus(interface=interface, channel=channel, **{**options, **extra})
    except (can.CanError, OSError, ImportError, ValueError, TypeError, AttributeError, NotImplementedError) as e:
        raise BusError(f"bus {spec} cannot be opened ({type(e).__name__}: {e}); check wiring, name and permissions") from e


class _CanListener:
    def __init__(self, spec: str) -> None:
        interface = parse(spec)[0]
        self._bus = _python_can(spec, **({"listen_only": True} if interface == "slcan" else {}))

    def recv(self, timeout: float) -> Frame | None:
        try:
            m = self._bus.recv(timeout)
        except (can.CanError, OSError) as e:
            raise BusError(f"the bus failed ({e}); check cable, power and termination") from e
        if m is not None and m.is_error_frame:  # of any length of identifier: some adapters give it one
            raise BusError("error frame on the bus; check termination and bit rate")
        if m is None or m.is_remote_frame or m.is_extended_id or m.is_fd:
            return None
        return Frame(m.arbitration_id, m.data, m.timestamp)

    def close(self) -> None:
        self._bus.shutdown()


class _CanTalker:
    def __init__(self, spec: str) -> None:
        self._bus = _python_can(spec)
        # the serial format has 32 bits of milliseconds for the stamp, so it counts from the start
        self._zero = time.time() if parse(spec)[0] == "serial" else 0.0

    def send(self, cob_id: int, data: bytes) -> None:
        stamp = time.time() - self._zero
        try:
            self._bus.send(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False, timestamp=stamp), timeout=1.0)
        except (can.CanError, OSError) as e:
            raise BusError(f"the bus does not take frames ({e}); is another node on it?") from e

    def close(self) -> None:
        self._bus.shutdown()


def _address(channel: str) -> tuple[str, int]:
    host, _, port = channel.rpartition(":")
    try:
        return host or "127.0.0.1", int(port)
    except ValueError as e:
        raise BusError(f"hub:{channel}: expected hub:PORT or hub:HOST:PORT") from e


def listen(spec: str, wait_s: float = 0.0) -> Listener:
    """Open a bus for listening, waiting up to ``wait_s`` for it to appear; raises `BusError`."""
    interface, channel, _ = parse(spec)
    if (outside := registered().get(interface)) is not None:
        return outside.listen(channel)
    end = time.monotonic() + wait_s
    while True:
        try:
            if interface == "hub":
                return HubClient(*_address(channel))
            if interface == "socketcan" and usable():
                return SocketCanListener(_python_can(spec))
            return _CanListener(spec)
        except BusError:
            if time.monotonic() > end:
                raise
            time.sleep(0.1)


def talk(spec: str) -> Talker:
    """Open a bus for sending; ``hub:PORT`` starts the hub here. Raises `BusError`."""
    interface, channel, _ = parse(spec)
    if (outside := registered().get(interface)) is not None:
        return outside.talk(channel)
    return Hub(*_address(channel)) if interface == "hub" else _CanTalker(spec)
