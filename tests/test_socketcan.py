"""Frames of a raw socket taken many at a time, on real sockets of the system.

A machine without CAN has none of that family; a datagram socket gives frames, times of arrival and losses by the same calls.
"""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Iterator
from typing import Any

import can
import numpy as np
import pytest
from can.interfaces.socketcan.socketcan import capture_message

from monitor_arm import DT, motion
from stopset.core.library import ffi
from stopset.errors import BusError
from stopset.monitor.links.batch import PLACE, SIZE, Batch, Frame
from stopset.monitor.links.bus import listen
from stopset.monitor.links.canopen_map import Encoder
from stopset.monitor.links.socketcan import ERROR, EXTENDED, REMOTE, SO_TIMESTAMPNS, SocketCanListener, usable
from stopset.monitor.profile import load_profile
from stopset.monitor.replay import signal_rows
from stopset.monitor.source import CanSource

pytestmark = pytest.mark.skipif(not usable(), reason="this system has no recvmmsg: python-can takes the frames")


class Wire:
    """Who sends into a socket as the drives do, and what python-can would have opened at its other end."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._out.connect(self.socket.getsockname())

    def send(self, identifier: int, data: bytes) -> None:
        self._out.send(struct.pack("=IB3x8s", identifier, len(data), data))

    def shutdown(self) -> None:
        self.socket.close()
        self._out.close()


@pytest.fixture
def wire() -> Iterator[Wire]:
    w = Wire()
    yield w
    w.shutdown()


def heard(batch: Batch) -> list[tuple[int, bytes]]:
    return [(f.id, bytes(f.data)[: f.length]) for f in batch.frames[0 : batch.count]]


SENT = [(0x080, b"\x01"), (0x383, bytes(range(8))), (0x001, b""), (0x7FF, b"\xff" * 8), (0x181, b"abc")]


def test_a_frame_lies_in_memory_as_the_core_reads_it() -> None:
    assert PLACE.size == ffi.sizeof("StopsetFrame")
    batch = Batch()
    for data in (b"", bytearray(b"abc"), bytes(range(12))):
        batch.put(Frame(0x1_0000_0181, data, 1.5))
    assert [(f.id, f.length, bytes(f.data), f.t) for f in batch.frames[0:3]] == [
        (0x181, n, data, 1.5) for n, data in ((0, bytes(8)), (3, b"abc" + bytes(5)), (12, bytes(range(8))))
    ]


@pytest.mark.parametrize("rounds", [1, 20, 100])
def test_all_that_waits_is_taken_as_python_can_takes_it(wire: Wire, rounds: int) -> None:
    listener, batch, mine = SocketCanListener(wire), Batch(), list[tuple[int, bytes, float]]()
    for theirs in (False, True):
        for identifier, data in SENT[: 5 if rounds < 100 else 1] * rounds:
            wire.send(identifier, data)
        if not theirs:
            while listener.fill(batch, 0.05) or batch.count:
                assert batch.count <= SIZE
                mine += [(*x, f.t) for x, f in zip(heard(batch), batch.frames[0 : batch.count], strict=True)]
    for identifier, data, t in mine:
        m = capture_message(wire.socket)
        assert (m.arbitration_id, bytes(m.data)) == (identifier, data) and 0.0 < m.timestamp - t < 60.0
        assert abs(time.time() - t) < 60.0
    assert len(mine) == rounds * (5 if rounds < 100 else 1)


def test_the_first_frame_is_waited_for_so_long_and_no_longer(wire: Wire) -> None:
    listener, batch = SocketCanListener(wire), Batch()
    begin = time.monotonic()
    listener.fill(batch, 0.05)
    assert batch.count == 0 and time.monotonic() - begin >= 0.049
    wire.send(0x181, b"\x07")
    assert listener.recv(60.0) == Frame(0x181, b"\x07", pytest.approx(time.time(), abs=60.0)) and listener.recv(0.0) is None


def test_what_is_no_classic_frame_is_left_out_and_an_error_frame_is_said(wire: Wire) -> None:
    listener, batch = SocketCanListener(wire), Batch()
    for identifier in (0x181, 0x181 | EXTENDED, 0x182 | REMOTE, 0x183):
        wire.send(identifier, b"\x01")
    wire._out.send(b"short")
    wire._out.send(struct.pack("=IBBxx64s", 0x182, 64, 1, bytes(64)))  # CAN FD, which a socket that was asked for it gives whole
    listener.fill(batch, 60.0)
    assert [i for i, _ in heard(batch)] == [0x181, 0x183]
    for also in (0, EXTENDED):
        wire.send(0x020 | ERROR | also, b"\x01")
        with pytest.raises(BusError, match="error frame on the bus"):
            listener.fill(batch, 60.0)
    wire.send(0x184, b"\x02")
    listener.fill(batch, 60.0)
    assert heard(batch) == [(0x184, b"\x02")], "and it goes on"


@pytest.mark.parametrize("first", ["emergency", "error frame"])
def test_an_emergency_beside_an_error_frame_is_not_lost(wire: Wire, first: str) -> None:
    """What a drive says in the moment in which its bus fails is heard before the failure is."""
    profile = load_profile("lwa4p/monitor")
    node = next(iter(profile.nodes.values()))
    source = CanSource(SocketCanListener(wire), profile, profile.cycle_s)
    frames = [(0x080 + node, b"\x20\x31\x01" + bytes(5)), (0x020 | ERROR, b"\x01")]
    for frame in frames if first == "emergency" else frames[::-1]:
        wire.send(*frame)
    with pytest.raises(BusError, match="error frame on the bus"):
        for _ in range(3):
            source.next(0.05)
    assert "reports the emergency 0x3120" in source.decoder.nodes.bad(time.time())[1]


def test_a_frame_without_a_time_is_as_old_as_can_be(wire: Wire) -> None:
    """Mutant: with the stamp of who came before in its place."""
    listener, batch = SocketCanListener(wire), Batch()
    wire.send(0x181, b"\x01")
    listener.fill(batch, 60.0)
    wire.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 0)
    wire.send(0x181, b"\x02")
    listener.fill(batch, 60.0)
    assert math.isnan(batch.frames[0].t)


def test_what_found_no_room_is_counted(wire: Wire) -> None:
    listener, batch, taken = SocketCanListener(wire), Batch(), 0
    for _ in range(20_000):
        wire.send(0x181, b"\x01")
    while listener.fill(batch, 0.0) or batch.count:
        taken += batch.count
    assert taken < 20_000 and listener.lost == 0
    wire.send(0x182, b"\x02")  # the system says it with the next frame that does
    listener.fill(batch, 60.0)
    assert heard(batch) == [(0x182, b"\x02")] and listener.lost == 20_000 - taken
    assert CanSource(listener, load_profile("lwa4p/monitor"), DT).counters()["lost_frames"] == listener.lost


def test_a_bus_that_is_gone_is_one_sentence(wire: Wire) -> None:
    listener = SocketCanListener(wire)
    listener.close()
    with pytest.raises(BusError, match=r"the bus failed .*; check cable, power and termination"):
        listener.fill(Batch(), 0.0)


class Standing:
    """A clock whose time of day stands at ``at`` [s]: how fast the machine is decides nothing."""

    monotonic, sleep = staticmethod(time.monotonic), staticmethod(time.sleep)

    def __init__(self, at: float) -> None:
        self.at = at

    def time_ns(self) -> int:
        return round(self.at * 1e9)


def test_a_backlog_is_dropped_the_oldest_first_and_never_worked_off(wire: Wire) -> None:
    """The daemon stood still for longer than data are good for: what waits is of before, and the first sample it gives out is not."""
    profile, valid = load_profile("lwa4p/monitor"), 0.03
    encoder, rows = Encoder(profile), signal_rows(motion(0, 60))
    listener = SocketCanListener(wire)

    def cycles(first: int, last: int) -> None:
        for k in range(first, last):
            for identifier, data in encoder.frames(rows[k]):
                wire.send(identifier, data)
            time.sleep(0.001)

    cycles(0, 11)
    time.sleep(2 * valid)
    now = time.time()
    cycles(11, 14)
    # a cycle of a second: that a busy machine sends one slowly spoils none of them
    source = CanSource(listener, profile, 1.0, valid, clock=Standing(now))
    sample = source.next(10.0)
    assert sample is not None and np.allclose(sample.q, rows[11][0], atol=1e-3), "the first that is not too old"
    assert source.dropped == source.counters()["dropped"] == 10, (
        "all of before it, counted, but the first, which is never given out"
    )


def test_a_bus_of_that_name_is_taken_from_so(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    def opened(**how: Any) -> Wire:
        assert how == {"interface": "socketcan", "channel": "can7"}
        return wire

    monkeypatch.setattr(can, "Bus", opened)
    listener = listen("socketcan:can7")
    assert isinstance(listener, SocketCanListener) and not hasattr(listener, "send")
    monkeypatch.setattr("stopset.monitor.links.bus.usable", lambda: False)
    assert not isinstance(listen("socketcan:can7"), SocketCanListener), "elsewhere by python-can"
