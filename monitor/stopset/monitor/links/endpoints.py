"""Addresses of zenoh sessions, and what is said where one cannot be opened: in our words, not in zenoh's."""

from __future__ import annotations

import re
from collections.abc import Sequence

from stopset.errors import BusError

WITH_PORT = ("tcp", "udp", "tls", "quic", "ws")
OTHERS = ("unixsock-stream", "unixpipe", "serial", "vsock")
WANTED = f"expected one like tcp/HOST:PORT ({', '.join((*WITH_PORT, *OTHERS))}; ports from 1 to 65535)"


def check_endpoint(endpoint: str) -> None:
    """Refuse what cannot be an address; raises `BusError`."""
    kind, _, rest = re.split(r"[?#]", endpoint, maxsplit=1)[0].partition("/")
    if kind in OTHERS and rest:
        return
    host, _, port = rest.rpartition(":")
    if kind not in WITH_PORT or not host:
        raise BusError(f"{endpoint!r} is no zenoh address; {WANTED}: write it so")
    if not (re.fullmatch(r"\d{1,5}", port, re.ASCII) and int(port) < 2**16):
        raise BusError(f"{endpoint!r} has the port {port[:20]!r}; {WANTED}: mend it")


def not_opened(why: str, connect: Sequence[str], listen: Sequence[str], file: str) -> BusError:
    """The sentence for a session that zenoh did not open; ``why``: its words, of which only places are taken over."""
    if key := re.search(r"unknown field `([^`]{1,60})`", why):
        return BusError(f"{file} has the unknown key {key[1]}; expected a configuration of zenoh 1: check its spelling")
    if "No such file" in why:
        return BusError(f"{file}: no such file; expected a configuration of zenoh in JSON5: name one")
    if place := re.search(r"--> (\d+):(\d+)", why):
        return BusError(f"{file} is no JSON5 at line {place[1]}, column {place[2]}; expected a configuration of zenoh: mend it")
    found = re.search(r"(?:any of \[|bound to |new \w+ )(?:Single\()?([\w-]+/[^\s)\]]+?)[:)]*(?:[\s)\]]|$)", why)
    where = found[1] if found else ", ".join([*connect, *listen]) or file or "the default address"
    if "listen" in why:
        return BusError(
            f"{where} cannot be listened on; expected a free port at an address of this machine: end what holds it, or take another"
        )
    return BusError(
        f"no zenoh session with {where} comes about; expected a router or a monitor that listens there and takes this side's "
        "certificate, if it asks for one: check that it runs, address, port and certificates"
    )
