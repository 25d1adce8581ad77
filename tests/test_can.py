"""CAN from end to end with real parts: every pair of links, the profile's frames, damaged cycles, log files."""

from __future__ import annotations

import contextlib
import gzip
import os
import struct
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path

import can
import numpy as np
import pytest

from monitor_arm import DT, meta, motion
from monitor_process import environment, free_port
from stopset.cli.main import main
from stopset.errors import BusError, RecordingError
from stopset.monitor.jointstate import decode
from stopset.monitor.links.batch import Batch, Frame
from stopset.monitor.links.bus import Talker, listen, parse, talk
from stopset.monitor.links.canopen_map import Encoder
from stopset.monitor.links.decoder import Cycle, Decoder
from stopset.monitor.links.hub import Hub, HubClient
from stopset.monitor.logs import play_log
from stopset.monitor.profile import SIGNALS, SYNC_ID, load_profile, shipped_profiles
from stopset.monitor.replay import PAUSE_CYCLES, CanSink, JointStateSink, play, signal_rows
from stopset.monitor.source import CanSource, CycleCount
from stopset.recording import Recording, read_recordings, write_recordings

PROFILE = load_profile("lwa4p/monitor")


# ---- links ----------------------------------------------------------------------------------------------------------


@pytest.fixture(params=["virtual", "serial", "udp_multicast", "hub"])
def link(request: pytest.FixtureRequest) -> Iterator[tuple[str, str]]:
    """(where to send, where to listen), on this machine only."""
    if request.param == "serial":
        a, b = os.openpty()
        c, d = os.openpty()
        for fd in (a, b, c, d):
            tty.setraw(fd)
        stop = threading.Event()

        def wire() -> None:  # a cable between two serial adapters
            while not stop.is_set():
                data = os.read(a, 4096)
                if not data:
                    return
                os.write(c, data)

        threading.Thread(target=wire, daemon=True).start()
        yield f"serial:{os.ttyname(b)}", f"serial:{os.ttyname(d)}"
        stop.set()
        return
    # a port of its own: another worker may run the same test
    name = {
        "virtual": "virtual:stopset-test", "udp_multicast": f"udp_multicast:239.74.163.99?port={free_port()}",
        "hub": f"hub:{free_port()}",
    }  # fmt: skip
    yield name[request.param], name[request.param]


def test_every_link_carries_every_frame_in_order(link: tuple[str, str]) -> None:
    try:
        sender = talk(link[0])
    except BusError as e:
        if "udp" in link[0]:
            pytest.skip(f"no multicast on this machine: {e}")
        raise
    hears = listen(link[1], wait_s=5.0)
    try:
        if isinstance(sender, Hub):
            while not sender.clients:
                time.sleep(0.01)
        else:
            time.sleep(0.1)
        sent = [(SYNC_ID, b"\x01"), (0x383, bytes(range(8))), (0x001, b""), (0x7FF, b"\xff" * 8)] * 25
        for cob_id, data in sent:
            sender.send(cob_id, data)
            time.sleep(0.0005)
        heard, decoder = list[tuple[int, bytes]](), Decoder(PROFILE)
        while len(heard) < len(sent) and (frame := hears.recv(2.0)) is not None:
            heard.append((frame.cob_id, bytes(frame.data)))
            assert abs(stamped(decoder, frame.t, time.time()) - time.time()) < 5.0, "stamps are seconds since the epoch"
        assert heard == sent
    finally:
        hears.close()
        sender.close()


def stamped(decoder: Decoder, t: float, now: float) -> float:
    """What the monitor takes for the time of a frame with the stamp ``t``, received at ``now``."""
    batch = Batch()
    batch.put(Frame(0x7FF, b"", t))
    decoder.take(batch, now)
    return decoder.heard()[-1][0]


def test_stamps_of_another_clock_do_not_make_old_frames_young() -> None:
    ours, theirs = partial(stamped, Decoder(PROFILE)), partial(stamped, Decoder(PROFILE))
    assert ours(1e9, 1e9 + 0.01) == 1e9
    assert ours(1e9, 1e9 + 70.0) == 1e9, "after standing still for long, what waited is old"
    assert ours(float("nan"), 1e9) == 0.0 and ours(float("inf"), 1e9) == 0.0
    assert theirs(5.0, 1e9) == 1e9
    assert theirs(6.0, 1e9 + 1.3) == pytest.approx(1e9 + 1.0, abs=2e-3), "0.3 s late"
    assert theirs(7.0, 1e9 + 70.0) == pytest.approx(1e9 + 2.0, abs=0.1)
    assert theirs(70.0, 1e9 + 65.0 + 0.01) == pytest.approx(1e9 + 65.0, abs=0.02)


def test_the_frames_of_a_time_are_found_in_the_ring_of_all() -> None:
    decoder = Decoder(load_profile("lwa4p/monitor"), room=50)
    sent = [(10.0 + 0.1 * k, 0x123, bytes(range(k % 9))) for k in range(120)]
    for k, (t, x, data) in enumerate(sent):
        decoder.frame(x, data, t)
        if k == 19:
            assert decoder.heard() == sent[:20], "not yet round"
    assert decoder.heard() == sent[-50:] and decoder.heard(20.45, 20.65) == sent[105:107] and not decoder.heard(1.0, 2.0)
    decoder.frame(0x123, b"", float("nan"))
    assert len(decoder.heard(1.0, 1e9)) == 49, "what has no time belongs to none"


def test_a_listener_has_nothing_to_send_with() -> None:
    assert not hasattr(HubClient, "send")
    hears = listen("virtual:stopset-passive")
    assert not hasattr(hears, "send")
    hears.close()


def test_the_hub_counts_what_others_send_and_its_end_is_noticed() -> None:
    port = free_port()
    hub = talk(f"hub:{port}")
    assert isinstance(hub, Hub)
    hears = listen(f"hub:{port}")
    other = can.Bus(interface="socketcand", host="127.0.0.1", port=port, channel="can0")
    while hub.clients < 2:
        time.sleep(0.01)
    assert hub.client_frames == 0
    other.send(can.Message(arbitration_id=0x603, data=b"\x40", is_extended_id=False))
    frame = hears.recv(2.0)
    assert frame is not None and (frame.cob_id, bytes(frame.data)) == (0x603, b"\x40") and hub.client_frames == 1
    other.shutdown()
    hub.close()
    with pytest.raises(BusError, match="closed"):
        hears.recv(2.0)


@pytest.mark.parametrize(
    ("spec", "word"),
    [
        ("nonsense", "expected INTERFACE"),
        ("martian:1", "expected INTERFACE"),
        ("hub:x", "PORT"),
        ("socketcan:nope0", "cannot be opened"),
    ],
)
def test_bad_bus_names_get_one_sentence(spec: str, word: str) -> None:
    with pytest.raises(BusError, match=word):
        listen(spec)


def test_options_of_a_bus_name() -> None:
    assert parse("slcan:/dev/ttyACM0?bitrate=500000&name=a") == ("slcan", "/dev/ttyACM0", {"bitrate": 500000, "name": "a"})


# ---- profile and frames ---------------------------------------------------------------------------------------------


def cycles(frames: list[tuple[int, bytes]]) -> list[Cycle]:
    d = Decoder(PROFILE)
    return [c for i, (cob, data) in enumerate(frames) if (c := d.frame(cob, data, i * 1e-4)) is not None]


def one_cycle(k: int = 0) -> tuple[np.ndarray, list[tuple[int, bytes]]]:
    values = signal_rows(motion(0, 5))[k]
    values[SIGNALS.index("temp")] = 31.5
    encoder = Encoder(PROFILE)
    encoder.skip(k)
    return values, list(encoder.frames(values))


def test_decoding_returns_what_was_encoded_to_half_a_count() -> None:
    values, frames = one_cycle(3)
    (cycle,) = cycles(frames)
    for i, name in enumerate(SIGNALS):
        error = np.abs(cycle.values[i] - values[i])
        assert np.all(error <= PROFILE.quantum(name) * (1 + 1e-9) + 1e-15) or name in ("temp", "status")
    assert cycle.values[SIGNALS.index("temp")].tolist() == [31.5] * 6
    assert cycle.counter == 4 and cycle.t == 0.0, "the sampling instant is SYNC, the first frame"


def test_identical_to_what_canopen_decodes() -> None:
    """The struct table against the library it was made from."""
    import canopen

    values, frames = one_cycle(2)
    network = canopen.Network()
    for joint, node_id in enumerate(PROFILE.nodes.values()):
        node = network.add_node(canopen.RemoteNode(node_id, str(PROFILE.dcf)))
        node.tpdo.read(from_od=True)
        for cob, data in frames:
            network.notify(cob, bytearray(data), 0.0)
        mdeg = node.tpdo["position actual value [mdeg]"].raw
        assert mdeg == round(float(np.rad2deg(values[0, joint])) * 1e3)
        torque = node.tpdo["torque actual value [per mille of rated]"].raw
        assert torque == round(values[2, joint] / PROFILE.signals["tau"].scale[joint])


def test_a_lost_frame_costs_its_cycle_and_the_next() -> None:
    """The next may hold the lost one's late arrival, which nothing in a PDO tells apart."""
    _, a = one_cycle(0)
    _, b = one_cycle(1)
    _, c = one_cycle(2)
    whole = cycles(a + b + c)
    assert [x.counter for x in whole] == [1, 2, 3]
    assert [x.counter for x in cycles(a + b[:-1] + c)] == [1]
    late = a + b[:-1] + [c[0], b[-1]] + c[1:]
    assert [x.counter for x in cycles(late)] == [1], "the doubled frame is seen"
    assert [x.counter for x in cycles(a[3:] + b + c)] == [3], "a cycle joined in the middle is not believed"


def test_a_lost_sync_does_not_mix_two_cycles() -> None:
    """The first PDO of a cycle is lost, and the SYNC after it: the next cycle's first PDO would complete this one."""
    five = [one_cycle(k)[1] for k in range(5)]
    stream = [(DT * k + 1e-5 * i, cob, data) for k, frames in enumerate(five) for i, (cob, data) in enumerate(frames)]
    mixed = [f for f in stream if f not in (stream[1], stream[13])]
    d = Decoder(PROFILE)
    assert [c.counter for t, cob, data in mixed if (c := d.frame(cob, data, t)) is not None] == [4]
    # a cycle that merely comes late, its sender having been held up, is given out with the next SYNC
    d = Decoder(PROFILE)
    late = [(t + (1.5 * DT if i else 0.0), cob, data) for i, (t, cob, data) in enumerate(stream[:14])]
    assert [c.counter for t, cob, data in late if (c := d.frame(cob, data, t)) is not None] == [1]
    # without a counter the clock tells that a SYNC is missing
    d = Decoder(replace(PROFILE, sync_overflow=0))
    bare = [(t, cob, b"" if cob == SYNC_ID else data) for t, cob, data in late[:13]]
    assert not [c for t, cob, data in bare if d.frame(cob, data, t) is not None]
    assert d.frame(SYNC_ID, b"", 2.0 * DT) is None and d.incomplete == 1
    d = Decoder(replace(PROFILE, sync_overflow=0))
    assert not [c for t, cob, data in bare if d.frame(cob, data, max(0.0, t - 0.3 * DT)) is not None]
    assert d.frame(SYNC_ID, b"", 1.4 * DT) is not None, "held up, and then in time again"


@pytest.mark.parametrize("heard", [True, False])
def test_an_error_that_is_gone_is_no_all_clear_while_others_are_left(heard: bool) -> None:
    """Drives with several errors say for each that it is gone (code 0), and what is left in the error register: CiA 301."""
    d, first, one_left = Decoder(replace(PROFILE, heartbeat_s=0.0)), b"\x10\x23\x03\0\0\0\0\0", b"\0\0\x01\0\0\0\0\0"
    for data in ([first] if heard else []) + [one_left]:
        d.frame(0x085, data, 1.0)
        assert d.nodes.bad(1.0)[0] == 0b100
    assert f"the emergency {'0x2310' if heard else '0xFFFF'}" in d.nodes.bad(1.0)[1]
    for unread in (b"", b"\0", b"\0\0"):
        d.frame(0x085, unread, 1.1)
        assert d.nodes.bad(1.1)[0] == 0b100, "a message without its register is no all-clear"
    d.frame(0x085, bytes(8), 1.2)
    assert d.nodes.bad(1.2) == (0, "")


@pytest.mark.parametrize("command", [b"\x81\x05", b"\x82\x05", b"\x81\x00"])
def test_an_emergency_ends_with_the_drive_s_own_start_and_not_with_an_order_to_start(command: bytes) -> None:
    """A drive that has not heard the master's reset goes on as it was, with its error."""
    d, error, alive = Decoder(PROFILE), b"\x10\x23\x03\0\0\0\0\0", [(0x700 + i, b"\x05") for i in PROFILE.nodes.values()]
    for cob, data in [*alive, (0x085, error), (0x000, command), *alive, (0x000, b"\x01\x00"), *alive, (0x705, b"\x7f"), *alive]:
        d.frame(cob, data, 1.0)
    assert d.nodes.bad(1.0)[0] == 0b100 and d.nodes.in_force == {"arm_3_joint": 0x2310}
    other = Decoder(PROFILE)  # who comes later is told by who was there
    for cob, data in alive:
        other.frame(cob, data, 1.0)
    other.nodes.recall({**d.nodes.in_force, "no such joint": 1})
    assert other.nodes.bad(1.0) == d.nodes.bad(1.0) and other.nodes.standing[5] != other.nodes.standing[4]
    for cob, data in [(0x705, b"\x00"), (0x705, b"\x05")]:
        d.frame(cob, data, 1.0)
    other.nodes.dismiss()
    for nodes in (d.nodes, other.nodes):
        assert nodes.bad(1.0) == (0, "") and nodes.in_force == {} and nodes.standing[5] == nodes.standing[4]


def test_other_nodes_and_emergencies_are_told_apart() -> None:
    d = Decoder(PROFILE)
    _, frames = one_cycle()
    noise = [(0x703, b"\x05"), (0x203, bytes(8)), (0x085, b"\x50\x23\x01\xdf\0\0\0\0"), (0x000, b"\1\0")]
    out = [d.frame(cob, data, 0.0) for cob, data in [frames[0], *noise, *frames[1:]]]
    assert out[-1] is not None and d.unknown == 4 and d.nodes.emergencies == [(5, b"\x50\x23\x01\xdf\0\0\0\0")]


def test_numbers_that_do_not_fit_are_refused_not_clipped() -> None:
    values, _ = one_cycle()
    values[2, 0] = 4000.0
    with pytest.raises(BusError, match=r"tau of arm_1_joint.*16 bits"):
        list(Encoder(PROFILE).frames(values))


def test_profiles_ship_and_bad_ones_are_refused(tmp_path: Path) -> None:
    assert shipped_profiles() == ["lwa4p/monitor", "lwa4p/passive-ros_canopen"]
    passive = load_profile("lwa4p/passive-ros_canopen")
    assert "tau" not in passive.signals and len(Decoder(passive).maps) == 18
    text = PROFILE.dcf.with_name("monitor.toml").read_text()
    (tmp_path / "monitor.dcf").write_text(PROFILE.dcf.read_text())
    for old, new, word in (
        ("0x6077", "0x6078", "in no synchronous TPDO"),
        ("[signals.temp]", "[signals.warmth]", "unknown key warmth"),
        ("arm_2_joint = 4", "arm_2_joint = 3", "not distinct"),
        ('dcf = "monitor.dcf"', 'dcf = "other.dcf"', "not beside it"),
    ):
        path = tmp_path / "p.toml"
        path.write_text(text.replace(old, new))
        with pytest.raises(BusError, match=word):
            Decoder(load_profile(path))
    (tmp_path / "monitor.dcf").write_text("nonsense")
    path.write_text(text)
    with pytest.raises(BusError, match="not a usable EDS or DCF"):
        Decoder(load_profile(path))


# ---- replay and logs ------------------------------------------------------------------------------------------------


class Tape:
    """A bus that only remembers."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.t = 0.0

    def send(self, cob_id: int, data: bytes) -> None:
        self.frames.append(Frame(cob_id, data, self.t))

    def close(self) -> None:
        pass

    def recv(self, timeout: float) -> Frame | None:
        return self.frames.pop(0) if self.frames else None


def recorded(trials: list[Recording], speed: float = 1.0) -> Tape:
    tape = Tape()
    talker: Talker = tape

    def sleep(seconds: float) -> None:
        tape.t += seconds

    play(trials, CanSink.of(talker, PROFILE), speed, clock=lambda: tape.t, sleep=sleep)
    return tape


def test_replay_keeps_time_and_shows_the_jump_between_trials() -> None:
    trials = [motion(s, 30, s) for s in range(2)]
    tape = recorded(trials, speed=2.0)
    stamps = np.array([f.t for f in tape.frames if f.cob_id == SYNC_ID])
    steps = np.diff(stamps) / (DT / 2)
    assert len(stamps) == 60 and np.allclose(np.delete(steps, 29), 1) and steps[29] == pytest.approx(1 + PAUSE_CYCLES)
    source = CanSource(tape, PROFILE, DT / 2)
    got = [s for _ in range(60) if (s := source.next(0.0)) is not None]
    ks = [s.k + 1 for s in got]  # the first cycle may hold what came late of one before it
    assert ks == [*range(1, 30), *range(30 + PAUSE_CYCLES, 60 + PAUSE_CYCLES)]
    assert all(s.powered and s.tau is not None and s.temp is None for s in got)


# each as (number of a cycle, how much of a cycle after its SYNC its frames came)
HELD_UP = {
    "the first": [(0, 0.95)],
    "some": [(20, 0.95), (21, 0.95)],
    "the last": [(59, 0.95)],
    "none": [],
    "all": [(k, 0.95) for k in range(60)],
}


class Still:
    """A clock that only a test moves: a machine that stands still for a second would make every frame old."""

    def __init__(self) -> None:
        self.now = 1.7e9

    def monotonic(self) -> float:
        return self.now

    def time_ns(self) -> int:
        return round(self.now * 1e9)

    def sleep(self, seconds: float) -> None:
        """Nobody sleeps."""


@pytest.mark.parametrize("which", HELD_UP)
def test_no_cycle_of_a_bus_that_is_held_up_is_missing_from_the_counters(which: str) -> None:
    """One was neither a sample nor counted where its frames came so late that they could be of another."""
    clock = Still()
    tape, cycle, begin = recorded([motion(0, 60)]), -1, clock.now - 1.0
    late = dict(HELD_UP[which])
    for place, f in enumerate(tape.frames):
        cycle += f.cob_id == SYNC_ID
        tape.frames[place] = f._replace(t=begin + f.t + (f.cob_id != SYNC_ID) * DT * late.get(cycle, 0.01))
    source = CanSource(tape, PROFILE, DT, clock=clock)
    got = [s for _ in range(70) if (s := source.next(0.0)) is not None]
    c = source.counters()
    assert c["cycles"] == 60 == len(got) + c["dropped"] + c["incomplete_cycles"] + c["doubtful_cycles"] + c["cycles_underway"]
    assert c["doubtful_cycles"] == {"the first": 2, "all": 60}.get(which, 1), "the first alone, unless it ends late"
    assert c["cycles_underway"] == (which == "the last"), "no SYNC came that would have told whose its frames are"


class Ending(Tape):
    """A bus that fails behind its last frame."""

    def recv(self, timeout: float) -> Frame | None:
        if not self.frames:
            raise BusError("cable out")
        return super().recv(timeout)


def test_the_sample_in_hand_when_a_bus_fails_is_given_out() -> None:
    """It was thrown away, and counted nowhere, where it was older than samples should be and a newer one was looked for."""
    tape, clock = Ending(), Still()
    tape.frames = [f._replace(t=clock.now - 1.0 + f.t) for f in recorded([motion(0, 10)]).frames]
    source = CanSource(tape, PROFILE, DT, oldest_s=1e-3, clock=clock)
    sample = source.next(0.0)
    assert sample is not None and sample.k == 8 and source.dropped == 8
    with pytest.raises(BusError, match="cable out"):
        source.next(0.0)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc"])
def test_import_of_a_log_returns_the_recording(suffix: str, tmp_path: Path) -> None:
    trials = [motion(s, 40, s) for s in range(2)]
    path, out = tmp_path / f"bus{suffix}", tmp_path / "rec.parquet"
    with can.Logger(str(path)) as log:
        for f in recorded(trials).frames:
            log.on_message_received(
                can.Message(arbitration_id=f.cob_id, data=f.data, timestamp=1.7e9 + f.t, is_extended_id=False, channel="can0")
            )
    assert main(["import", str(path), "--out", str(out), "--effort", "compensated_torque"]) == 0
    back = read_recordings(out)
    assert back.meta.effort == "compensated_torque" and back.meta.rate_hz == pytest.approx(1 / DT) and len(back) == 2
    for a, b in zip(trials, back, strict=True):
        assert np.allclose(a.t, b.t, atol=1e-12)
        for name in ("q", "dq", "tau"):
            # half a count, and the float32 of the file
            error = np.abs(getattr(a, name) - getattr(b, name)) - 2.0**-24 * np.abs(getattr(a, name))
            assert np.all(error <= PROFILE.quantum(name) * (1 + 1e-6) + 1e-9)


@pytest.mark.parametrize("kind", ["screen", "screen.gz", "log.gz"])
def test_other_ways_to_keep_a_log(kind: str, tmp_path: Path) -> None:
    trial, out = motion(0, 40), tmp_path / "rec.parquet"
    frames = [(1.7e9 + f.t, f.cob_id, f.data) for f in recorded([trial]).frames]
    if "screen" in kind:
        lines = [f" ({t:.6f})  can0  {c:03X}   [{len(d)}]  {bytes(d).hex(' ').upper()}" for t, c, d in frames]
    else:
        lines = [f"({t:.6f}) can0 {c:03X}#{bytes(d).hex().upper()}" for t, c, d in frames]
    path = tmp_path / ("bus.log.gz" if kind.endswith("gz") else "bus.log")
    path.write_bytes(gzip.compress("\n".join(lines).encode()) if kind.endswith("gz") else "\n".join(lines).encode())
    assert main(["import", str(path), "--out", str(out)]) == 0
    (back,) = read_recordings(out)
    assert np.abs(back.q - trial.q).max() < 1e-5


def shown(frames: list[tuple[float, int, bytes]], how: str) -> str:
    """What candump shows on the screen with the option ``how``."""
    lines, last = [], frames[0][0]
    for t, c, d in frames:
        stamp = {
            "tA": f"{datetime.fromtimestamp(t):%Y-%m-%d %H:%M:%S.%f}", "tz": f"{t - frames[0][0]:010.6f}", "td": f"{t - last:010.6f}",
        }.get(how, f"{t:.6f}")  # fmt: skip
        last, text = t, "".join(chr(b) if 32 <= b < 127 else "." for b in d)
        lines.append(f" ({stamp})  can0  {'RX - -  ' if how == 'x' else ''}{c:03X}   [{len(d)}]  {bytes(d).hex(' ').upper()}"
                     + (f"   '{text}'" if how == "a" else ""))  # fmt: skip
    if how == "others":  # an error, a frame of CAN FD, a request: on the same bus, and none of ours
        lines[3:3] = [
            " (1700000000.000100)  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME",
            " (1700000000.000100)  can0  123  [12]  11 22 33 44 55 66 77 88 99 AA BB CC",
            " (1700000000.000100)  can0  123   [0]  remote request",
        ]
    return "\n".join(["robot@cell:~$ candump can0 -ta", *lines] if how == "prompt" else lines)


@pytest.mark.parametrize(
    ("how", "refused"),
    [
        ("a", ""),
        ("x", ""),
        ("tA", ""),
        ("tz", ""),
        ("others", ""),
        ("bom", ""),
        ("td", "pauses between frames"),
        ("prompt", "its first line"),
    ],
)
def test_what_candump_shows_is_read_whatever_it_was_asked_for(
    how: str, refused: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trial, path, out = motion(0, 40), tmp_path / "bus.log", tmp_path / "rec.parquet"
    text = shown([(1.7e9 + f.t, f.cob_id, f.data) for f in recorded([trial]).frames], how)
    path.write_text(text, encoding="utf-8-sig" if how == "bom" else "utf-8")
    assert main(["import", str(path), "--out", str(out)]) == (2 if refused else 0)
    if refused:
        assert refused in capsys.readouterr().err and not out.exists()
    else:
        (back,) = read_recordings(out)
        assert np.abs(back.q - trial.q).max() < 1e-5


def test_replay_sends_what_drives_say_and_not_to_a_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = recorded([motion(0, 5)]).frames
    commands = [(0x000, b"\1\0"), (0x603, bytes(8)), (0x583, bytes(8)), (0x203, bytes(8)), (0x701, b"\5"), (0x2A5, b"")]
    said = [(0x703, b"\5"), (0x085, bytes(8))]
    path = tmp_path / "bus.log"
    lines = [
        f"(1700000000.000000) can0 {c:03X}#{bytes(d).hex()}" for c, d in [*commands, *said, *((f.cob_id, f.data) for f in frames)]
    ]
    path.write_text("\n".join(lines))
    tape = Tape()
    assert play_log(path, tape.send, 1e6, PROFILE) == (len(frames) + 2, len(commands))
    assert [f.cob_id for f in tape.frames] == [0x703, 0x085, *(f.cob_id for f in frames)]
    assert main(["replay", str(path), "--to", "socketcan:can0"]) == 2
    assert "--yes-this-bus-is-not-a-robot" in capsys.readouterr().err
    assert main(["replay", str(path), "--to", "socketcan:nope0", "--yes-this-bus-is-not-a-robot"]) == 2
    assert "cannot be opened" in capsys.readouterr().err


@pytest.mark.parametrize(("stamp", "word"), [("inf", "stamped inf"), ("nan", "stamped nan"), ("1e12", "such a pause")])
def test_a_log_whose_time_stands_still_or_is_none_is_refused(stamp: str, word: str, tmp_path: Path) -> None:
    """One damaged stamp, and the replay would be silent for ever, or end in an error of Python's own."""
    path, tape = tmp_path / "bus.log", Tape()
    lines = [
        f"({t}) can0 {f.cob_id:03X}#{bytes(f.data).hex()}"
        for t, f in zip(("1.5", stamp), recorded([motion(0, 5)]).frames, strict=False)
    ]
    path.write_text("\n".join(lines))
    with pytest.raises(RecordingError, match=word):
        play_log(path, tape.send, 1.0, PROFILE, lambda: 0.0, lambda seconds: None)
    assert len(tape.frames) == 1


@pytest.mark.parametrize("version", [1, 9])
def test_an_object_without_length_does_not_hold_a_reader_for_ever(version: int, tmp_path: Path) -> None:
    """Found by a fuzzer: python-can reads it again and again, whether it knows its kind or not."""
    path = tmp_path / "bus.blf"
    with can.Logger(str(path), compression_level=0) as log:
        for f in recorded([motion(0, 40)]).frames:
            log.on_message_received(
                can.Message(arbitration_id=f.cob_id, data=f.data, timestamp=1.7e9 + f.t, is_extended_id=False)
            )
    data = bytearray(path.read_bytes())
    at = data.index(b"LOBJ", data.index(b"LOBJ", data.index(b"LOBJ") + 4) + 4)  # the second frame in the first container
    struct.pack_into("<HI", data, at + 6, version, 0)
    path.write_bytes(data)
    words = [sys.executable, "-m", "stopset.cli.main", "import", str(path), "--out", str(tmp_path / "rec.parquet")]
    done = subprocess.run(words, env=environment(), capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2 and "an object of 0 bytes" in done.stderr


def test_bad_logs_and_recordings_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty, odd = tmp_path / "a.log", tmp_path / "b.blf"
    empty.write_text("")
    odd.write_bytes(b"not a BLF file at all")
    for path, word in ((empty, "expected SYNC"), (odd, "not a readable .blf"), (tmp_path / "none.asc", "no such file")):
        assert main(["import", str(path), "--out", str(tmp_path / "out.parquet")]) == 2
        assert word in capsys.readouterr().err
    assert not (tmp_path / "out.parquet").exists(), "nothing is written"
    r = motion(0, 20)
    uneven = Recording(r.phase, r.suite, r.trial, 0, r.t + 0.002 * (np.arange(20) % 2), r.q, r.dq, r.tau)
    with pytest.raises(RecordingError, match=r"even cycle.*--to zenoh:"):
        recorded([uneven])
    said: list[bytes] = []
    assert play([uneven], JointStateSink(said.append, PROFILE.joints), speed=float("inf")) == (20, 0.0)
    stamps = np.array([decode(m).stamp_ns for m in said])
    assert np.abs((stamps - stamps[0]) * 1e-9 - (uneven.t - uneven.t[0])).max() < 1e-7, "they carry the recording's own stamps"
    write_recordings(tmp_path / "r.parquet", meta(), [r])
    assert main(["replay", str(tmp_path / "r.parquet"), "--to", "nowhere"]) == 2


def test_a_heartbeat_stamped_ahead_does_not_hide_a_silence() -> None:
    """It counted until its stamp was past: 40 s of a drive that had fallen silent were OK."""
    d = Decoder(PROFILE)
    for node in PROFILE.nodes.values():
        d.frame(0x700 + node, b"\x05", 1e3)
    assert d.nodes.bad(1e3) == (0, "")
    d.frame(0x705, b"\x05", 1e3 + 40.0)
    for now in (1e3 + 0.1, 1e3 + 1.0, 1e3 + 39.0):
        for node in set(PROFILE.nodes.values()) - {5}:
            d.frame(0x700 + node, b"\x05", now)
        assert d.nodes.bad(now) == (0b100, "the drive of arm_3_joint (node 5) has sent no heartbeat for 0.3 s")


def test_an_error_frame_is_one_however_long_its_identifier_is_said_to_be() -> None:
    """Some adapters of python-can give one as an extended frame, which is what a message is unless somebody says otherwise."""
    sender, hears = can.Bus(interface="virtual", channel="errors"), listen("virtual:errors")
    with contextlib.closing(hears):
        for extended in (True, False):
            sender.send(can.Message(arbitration_id=0, is_error_frame=True, is_extended_id=extended, dlc=0))
            with pytest.raises(BusError, match="error frame on the bus"):
                hears.recv(2.0)
    sender.shutdown()


def test_a_can_fd_frame_is_no_drives() -> None:
    """Its first eight bytes were taken for the process data that stand under its identifier."""
    sender, hears = can.Bus(interface="virtual", channel="fd"), listen("virtual:fd")
    with contextlib.closing(hears):
        for data, fd in ((bytes(64), True), (b"\x01", False)):
            sender.send(can.Message(arbitration_id=0x182, data=data, is_fd=fd, is_extended_id=False))
        assert hears.recv(2.0) is None
        frame = hears.recv(2.0)
        assert frame is not None and bytes(frame.data) == b"\x01"
    sender.shutdown()


class Fed:
    """A bus that gives what is put into ``frames``."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []

    def recv(self, timeout: float) -> Frame | None:
        return self.frames.pop(0) if self.frames else None

    def close(self) -> None:
        """Nothing is open."""


def test_why_no_cycle_is_whole_is_said_once() -> None:
    """It was "no signal from the arm", whether the bus was dead or one drive of six had lost its mapping."""
    bus, clock = Fed(), Still()
    source, (_, frames) = CanSource(bus, PROFILE, DT, clock=clock), one_cycle()

    def heard(without: set[int]) -> list[str]:
        encoder, (values, _) = Encoder(PROFILE), one_cycle()
        for _ in range(20):
            clock.now += DT
            bus.frames += [Frame(cob, data, clock.now) for cob, data in encoder.frames(values) if cob not in without]
        while bus.frames:
            source.next(0.0)
        return source.complaints()

    assert heard(set()) == [] == heard(set())
    (said,) = heard({0x383, 0x484})
    assert said.startswith(
        "no cycle is whole, for these PDOs do not come: 0x383 of arm_1_joint; 0x484 of arm_2_joint; look at these drives"
    )
    assert heard({0x383, 0x484}) == [], "as before"
    assert heard({SYNC_ID}) == ["no SYNC (0x080) on the bus; look at the master, cable, power and bit rate"]
    assert heard({cob for cob, _ in frames}) == [], "nor on a dead bus: as before"
    assert heard(set()) == []
    assert len(heard({cob for cob, _ in frames})) == 1
    source, slow = CanSource(bus, replace(PROFILE, cycle_s=0.5), 0.5, clock=clock), {cob for cob, _ in frames}
    assert heard(set()) == [] == heard(slow), "of slow cycles a look may see none"


@pytest.mark.parametrize(("pause", "gap"), [(0.0, False), (0.05, False), (0.3, True)])
def test_a_master_that_stood_still_has_not_counted(pause: float, gap: bool) -> None:
    """Its counter goes on by one, and the arm has moved for all the time: what was predicted for one cycle accused it."""
    count = CycleCount(DT, PROFILE.sync_overflow)
    numbers = [count(Cycle(k + 1, 100.0 + k * DT + (pause if k >= 10 else 0.0), np.zeros((5, 6)), 0, True)) for k in range(20)]
    steps = np.diff(numbers)
    assert (steps[9] > 1) == gap and set(np.delete(steps, 9)) == {1}
