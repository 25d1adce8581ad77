"""Rubbish for every parser of the monitor: ``python benchmarks/monitor_fuzz.py [--inputs N] [--seconds S] [--kept FILE] [--found FOLDER]``.

Each input is a good one with bytes changed, cut, doubled, spliced, or numbers and brackets put where they hurt. A parser may
take it or refuse it with an error of stopset's own; anything else, and an input that it is not done with soon, is printed with the input
that did it, and with ``--found`` written to a file. With ``--kept`` every run adds to what FILE holds, with other inputs, until each parser,
those of files too, has had ``--inputs``.
The good ones are as small as a parser takes, one drive and as few cycles as make a trial: a file's length is only paid for.
"""

from __future__ import annotations

import argparse
import bz2
import contextlib
import copy
import gzip
import io
import json
import logging
import math
import random
import re
import signal
import socket
import sqlite3
import struct
import sys
import tempfile
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, reduce
from operator import getitem
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import can
import msgspec
import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer

from monitor_arm import known_model, motion
from state_messages import pack
from stopset.artifact import Model, load_model, save_model
from stopset.artifact.polynomial import Polynomial
from stopset.artifact.store import _digest, model_text
from stopset.errors import BusError, StopsetError
from stopset.monitor.along import watch_for
from stopset.monitor.authentication import load_keys
from stopset.monitor.bags import trials_of_bag
from stopset.monitor.config import Stops, load_config
from stopset.monitor.jointstate import JointState, decode, to_cdr, to_json
from stopset.monitor.journal import Journal, blank
from stopset.monitor.latch import Latch, Record
from stopset.monitor.layout import unpack
from stopset.monitor.links.canopen_map import Encoder, frame_maps
from stopset.monitor.links.decoder import Decoder
from stopset.monitor.links.hub import HubClient
from stopset.monitor.links.rtde_client import ASK_VERSION, DATA, HEAD, OUTPUTS, START, TEXT, RtdeClient
from stopset.monitor.logs import play_log, trials_of_log
from stopset.monitor.orders import parse_reset
from stopset.monitor.profile import Profile, load_profile
from stopset.monitor.replay import signal_rows
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.source import CanSource
from stopset.monitor.stopworker import answer_for, prepare
from stopset.monitor.verdict import Conformance
from stopset.monitor.viewer import View
from stopset.recording.seen import open_seen
from stopset.sets import Box
from synthetic import arm

IN_MEMORY = ("joint_states JSON", "joint_states CDR", "reset", "state message", "CAN frames", "viewer", "hub", "latch", "counts")
SLOW, LONGEST = 2.0, 10.0  # [s] of processor time from which an input is a finding, and after which it is ended
PROFILE = load_profile("lwa4p/monitor")
DRIVES = 1  # of the logs' arm
MOTION = ("1802", "1A02", "6064", "606C")  # objects of a drive's dictionary that make the frame of its motion
OBJECTS = (*MOTION, "1803", "1A03", "200D", "6041", "6077")  # and the other one
BLF_HEAD = struct.Struct(
    "<4sHHIIH6xI4x"
)  # of an object that holds others, python-can's: LOBJ, sizes, kind; method, bytes unpacked
REHASHED = ("model, right hash", "model, stops")
STATE = np.array([0.1, 0.6]), np.array([0.11, 0.62])  # (q, dq) of a stop, from and to
SPOKEN = ("timestamp", "actual_q", "actual_qd")
SPICE = [
    b"\0", b"\xff", b"\xff\xff\xff\xff",
    b"\x7f\xff\xff\xff", b"NaN", b"1e999", b"-1", b"9" * 400, b"9" * 5000, b"[" * 2000, b"{" * 2000, b'"', b"null",
    b"inf", b"\n", b"=", b"0x", b"\xc3", b"{}", b"[]", b"true", b"-0", b"\x80" * 8, b"1_000", b"'''", b"\\u0000",
]  # fmt: skip


def spoilt(rng: random.Random, seeds: list[bytes]) -> bytes:
    """A seed with a few changes."""
    data = bytearray(rng.choice(seeds))
    for _ in range(rng.choice([1, 1, 2, 4, 16])):
        at = rng.randrange(len(data) + 1)
        kind = rng.randrange(6)
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << rng.randrange(8)
        elif kind == 1:
            data[at:at] = rng.choice(SPICE)
        elif kind == 2:
            del data[at : at + rng.choice([1, 4, 64])]
        elif kind == 3:
            other = rng.choice(seeds)
            cut = rng.randrange(len(other) + 1)
            data[at:] = other[cut : cut + 4096]
        elif kind == 4:
            data[at : at + 4] = rng.choice([2**31, 2**32 - 1, 0, 2**16, 17]).to_bytes(4, rng.choice(["little", "big"]))  # type: ignore[arg-type]
        else:
            data[at:at] = data[at : at + 16]
    return bytes(data)


TERRIBLE = [
    None, True, "", "x", "\ud800", "nan", -1, 0, 1, 2**63, 10**400, 1e308, -1e308, 5e-324, math.nan, math.inf,
    [], {}, [[]], [None], {"": 0}, "9" * 5000,
]  # fmt: skip


@cache
def places(data: bytes) -> list[tuple[str | int, ...]]:
    """The way from the root to every value of a JSON tree."""
    found: list[tuple[str | int, ...]] = []
    todo: list[tuple[object, tuple[str | int, ...]]] = [(msgspec.json.decode(data), ())]
    while todo:
        x, here = todo.pop()
        inside = list(x.items()) if isinstance(x, dict) else list(enumerate(x)) if isinstance(x, list) else []
        found += [(*here, k) for k, _ in inside]
        todo += [(v, (*here, k)) for k, v in inside]
    return found


def spoilt_tree(rng: random.Random, data: bytes) -> Any:
    """JSON, read, with some of its values gone, replaced, scaled, doubled or in each other's places."""
    tree = msgspec.json.decode(data)
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        (*to_x, k), (*to_y, m) = rng.choices(places(data), k=2)
        kind = rng.randrange(6)
        try:
            x, y = reduce(getitem, to_x, tree), reduce(getitem, to_y, tree)
            if kind == 0:
                del x[k]
            elif kind == 1:
                x[k] = copy.deepcopy(rng.choice(TERRIBLE))
            elif kind == 2 and isinstance(x[k], int | float):
                x[k] *= rng.choice([-1, 0, 1e-9, 1e9, 1.5])
            elif kind == 3 and isinstance(x, list):
                x.append(copy.deepcopy(x[k]))
            elif kind == 4 and isinstance(x, dict):
                x[rng.choice(["", "x", str(m)])] = copy.deepcopy(y[m])
            else:
                x[k] = copy.deepcopy(y[m])
        except (LookupError, TypeError, OverflowError):
            continue  # a change before has taken the way away, or put a number there that no float holds
    return tree


def rehashed(body: Any) -> bytes:
    """A model file with the hash of what it holds, so that what reads it is reached."""
    try:
        return json.dumps(body | {"sha256": _digest(body)}).encode()
    except (ValueError, TypeError, RecursionError):
        return json.dumps(body).encode()


def through_file(suffix: str, read: Callable[[Path], object], folder: Path) -> Callable[[bytes], object]:
    path = folder / f"fuzz{suffix}"
    path.touch(0o600)
    name = str(path)

    def parse(data: bytes) -> object:
        with open(name, "wb", buffering=0) as f:  # noqa: PTH123 - a million times
            f.write(data)
        return read(path)

    return parse


def small_model() -> Model:
    """Of an arm of one joint."""
    m, robot = known_model(), arm(("a",))

    def cut(box: Box) -> Box:
        ends = [0] if len(box.lo) == m.n else [0, m.n]
        return Box.of(box.lo[ends], box.hi[ends])

    s, d, b = m.powered, m.domain, m.brakes
    assert b is not None
    return replace(
        m, robot=robot, rotor=robot.rotor, abstraction=replace(m.abstraction, Minv=m.abstraction.Minv[:1, :1], viscous=m.abstraction.viscous[:1]),
        sets={"powered": replace(s, X0=cut(s.X0), U=cut(s.U), V=cut(s.V))}, domain=replace(d, q=cut(d.q), dq=cut(d.dq), u=cut(d.u)),
        brakes=replace(b, torque=cut(b.torque), delay=cut(b.delay), rise=cut(b.rise)),
    )  # fmt: skip


def nonlinear_models(m: Model) -> tuple[Model, Model]:
    """The same with damping that grows with the speed, and with a polynomial of its own."""
    a = m.abstraction
    curved = Polynomial(np.array([[1, 0, 1], [0, 1, 0]]), np.array([0.1, 0.2]))
    damped = replace(a, order=2, viscous=np.hstack([a.viscous, 0.3 * a.viscous]))
    return replace(m, abstraction=damped), replace(m, abstraction=replace(a, kind=2, coriolis=(curved,)))


def dictionary(objects: tuple[str, ...]) -> str:
    """These objects of the shipped DCF."""
    sections = re.split(r"^(?=\[)", PROFILE.dcf.read_text(), flags=re.MULTILINE)
    return "".join(x for x in sections if re.match(rf"\[(DeviceInfo|({'|'.join(objects)})(sub\d)?)\]", x))


def small_arm(folder: Path) -> Profile:
    """The first `DRIVES` of the shipped profile, with a dictionary of the objects that their frames are made of."""
    dcf = folder / "small.dcf"
    dcf.write_text(dictionary(OBJECTS))
    nodes = dict(list(PROFILE.nodes.items())[:DRIVES])
    signals = {name: replace(s, scale=s.scale[:DRIVES]) for name, s in PROFILE.signals.items()}
    return replace(PROFILE, dcf=dcf, nodes=nodes, signals=signals, axes=PROFILE.axes[:DRIVES])


def small_profile() -> str:
    """The shipped profile's text for `small_arm`, without remarks."""
    text = re.sub(r" *#.*", "", PROFILE.dcf.with_name("monitor.toml").read_text())
    text = re.sub(r"(arm_\d_joint = \d\n)+", lambda x: "".join(x[0].splitlines(keepends=True)[:DRIVES]), text)
    return re.sub(r"scale = \[([\d., ]+)\]", lambda x: f"scale = [{', '.join(x[1].split(', ')[:DRIVES])}]", text)


def frames(data: bytes) -> None:
    """CAN frames of any identifier, length and stamp."""
    d, t = Decoder(PROFILE), 0.0
    for at in range(0, len(data) - 3, 13):
        length = min(data[at + 2] % 9, 8)
        t = math.nan if data[at + 3] == 255 else at * 1e-4
        d.frame(int.from_bytes(data[at : at + 2], "little") & 0x7FF, data[at + 4 : at + 4 + length], t)
    d.nodes.bad(t)


def from_hub() -> Callable[[bytes], object]:
    """A bus over TCP, whose server says anything once it has greeted."""
    server = socket.create_server(("127.0.0.1", 0))

    def greet() -> None:
        other.append(server.accept()[0])
        for _ in range(2):
            other[0].sendall(b"< ok >")
            other[0].recv(64)
        other[0].sendall(b"< ok >")

    other: list[socket.socket] = []
    threading.Thread(target=greet, daemon=True).start()
    source = CanSource(HubClient("127.0.0.1", server.getsockname()[1]), PROFILE, PROFILE.cycle_s)

    def parse(data: bytes) -> object:
        other[0].sendall(data)
        return source.next(1e-3)

    return parse


def from_controller() -> Callable[[bytes], object]:
    """A controller that says anything to whoever calls; what it has been asked is not looked at."""
    server = socket.create_server(("127.0.0.1", 0))

    def parse(data: bytes) -> object:
        said: list[object] = []

        def serve() -> None:
            with contextlib.suppress(OSError), server.accept()[0] as s:
                s.sendall(data)
                s.shutdown(socket.SHUT_WR)
                while s.recv(4096):
                    pass

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with contextlib.closing(RtdeClient(server.getsockname(), SPOKEN, 500.0)) as client:
                said += client.rows(1.0)
        except BusError:
            if not said:
                raise
        finally:
            thread.join()
        return said

    return parse


class Slots:
    """The latch's journal on a disk that has done something to it."""

    settled = True
    interrupted = notice = ""

    def __init__(self, data: bytes, counts: bytes = b"") -> None:
        self.data, self.counts = bytearray(data), counts

    def read(self) -> bytes:
        return bytes(self.data)

    def read_counts(self) -> bytes:
        return self.counts

    def write_counts(self, data: bytes) -> None:
        self.counts = data

    def write(self, offset: int, data: bytes) -> None:
        self.data[offset : offset + len(data)] = data

    flush = close = lambda self: None


def latch(data: bytes) -> None:
    """Only a journal that was written unlatched, to the last bit, is not latched."""
    assert Latch(Journal(Slots(data))).latched or data == blank(Record()), "a violation may have been forgotten"


def counts(data: bytes) -> None:
    """Counts can only add to what the journal holds, and make nothing of a journal that is not latched but a latched one."""
    three = blank(Record(why="a measurement was outside its prediction", count=3))
    assert Latch(Journal(Slots(three, data))).count >= 3, "a count was forgotten"
    free = Latch(Journal(Slots(blank(Record()), data)))
    assert free.latched or not free.count, "counted, and not latched"


def counted() -> bytes:
    """Counts as they are written."""
    slots = Slots(blank(Record()))
    Journal(slots).count([5])
    return slots.counts


def played(path: Path, profile: Profile) -> None:
    """Onto a bus, with a clock that stands still."""

    def sleep(seconds: float) -> None:
        if not 0.0 <= seconds < 2.0**63 * 1e-9:
            raise OverflowError(f"a pause of {seconds} s")

    play_log(path, lambda c, d: None, 1.0, profile, lambda: 0.0, sleep)


def viewer(data: bytes) -> None:
    view = View()
    for take in (view.take_json, view.take_event, view.take_health, view.take_state):
        take("", data)
    view.snapshot()


def record(compression: CompressionType) -> bytes:
    """A monitor's own; not compressed, changes reach what reads the JSON in it."""
    out, r, cycles = io.BytesIO(), motion(0, 20), 4
    w = Writer(out, compression=compression)
    w.start()
    w.add_metadata("stopset", {"joints": known_model().joints[0], "cycle_s": "0.004", "robot": "a", "effort": "motor_torque"})
    channel = w.register_channel("stopset/joint_states", "json", w.register_schema("stopset.JointStates", "jsonschema", b"{}"))
    for k in range(cycles):
        row = {"k": k, "position": r.q[k, :1].tolist(), "velocity": r.dq[k, :1].tolist(), "effort": r.tau[k, :1].tolist()}
        w.add_message(channel, k, json.dumps(row).encode(), k)
    w.finish()
    return out.getvalue()


def good_inputs(folder: Path) -> dict[str, list[bytes]]:
    """What each parser is made for."""
    names = known_model().joints
    row = tuple(0.1 * i for i in range(6))
    states = [JointState(10**18 + k, names, row, row, row) for k in range(3)]
    config = (
        b'model = "a.json"\ndata_id = 7\n[bus]\nlink = "hub:1"\n[publish]\nvalid_for_ms = 30\n[stops]\ncategories = ["0", "1"]\n'
    )
    small = small_arm(folder)
    bag = [
        (t, to_cdr(JointState(t, names[:1], row[:1], row[:1], row[1:2]))) for t in range(10**18, 10**18 + 40_000_000, 4_000_000)
    ]
    rows = [r[:, :DRIVES] for r in signal_rows(motion(0, 12))]  # what is read has to be ten cycles long
    encoder = Encoder(small)
    stream = [(k * 0.004 + i * 1e-5, c, d) for k, r in enumerate(rows) for i, (c, d) in enumerate(encoder.frames(r))]
    files: dict[str, list[bytes]] = {}
    for suffix in (".log", ".asc", ".blf", ".trc"):
        path = folder / f"seed{suffix}"
        with can.Logger(str(path)) as log:
            for t, c, d in stream:
                log.on_message_received(
                    can.Message(arbitration_id=c, data=d, timestamp=1.7e9 + t, is_extended_id=False, channel="can0")
                )
        files[suffix] = [path.read_bytes()]
    db = folder / "seed.db3"
    with contextlib.closing(sqlite3.connect(db)) as x:
        x.execute("create table topics (id integer, name text, type text)")
        x.execute("create table messages (id integer primary key, topic_id integer, timestamp integer, data blob)")
        x.execute("insert into topics values (1, '/joint_states', 'sensor_msgs/msg/JointState')")
        x.executemany("insert into messages (topic_id, timestamp, data) values (1, ?, ?)", bag)
        x.commit()
    out = io.BytesIO()
    w = Writer(out)
    w.start()
    channel = w.register_channel("/joint_states", "cdr", w.register_schema("sensor_msgs/msg/JointState", "ros2msg", b""))
    for stamp, data in bag:
        w.add_message(channel, stamp, data, stamp)
    w.finish()
    save_model(small_model(), folder / "m.json")
    small_models = [model_text(m).encode() for m in (small_model(), *nonlinear_models(small_model()))]
    stop = {"time_s": 0.1, "tcp_m": None, "why": "", "joints": {}}
    twin = {
        "state": "OK", "why": "x", "data_id": 1, "joints": list(names), "violations": [{"joint": names[0], "samples": 1}],
        "gaps": 0, "room": None, "verdicts": {"CONFORMANT": 1}, "oldest_prediction_s": 0.1, "notice": "n", "stops": {"0": stop},
    }  # fmt: skip
    return {
        "joint_states JSON": [to_json(s) for s in states], "joint_states CDR": [to_cdr(s) for s in states],
        "reset": [b'{"name": "A. Person", "reason": "seen to"}'], "state message": [pack({"data_id": 7, "state": 0x2B})],
        "CAN frames": [b"".join(c.to_bytes(2, "little") + bytes([len(d), 0]) + d.ljust(9, b"\0") for _, c, d in stream[:26])],
        "viewer": [json.dumps(twin).encode(), b'{"kind": "gap", "why": "x"}', pack({"data_id": 1})],
        "configuration": [config], "profile": [small_profile().encode()], "keys": [f"1 {'11' * 32}\n".encode()],
        "EDS": [dictionary(MOTION).encode()], "model": [(folder / "m.json").read_bytes()], "model, right hash": small_models,
        "model, stops": [(folder / "m.json").read_bytes()],
        "MCAP": [out.getvalue()], "MCAP of a violation": [record(CompressionType.NONE), record(CompressionType.ZSTD)], "db3": [db.read_bytes()],
        "candump": files[".log"], "ASC": files[".asc"], "BLF": files[".blf"], "TRC": files[".trc"],
        "ROS 1 bag": [ros1_bag([decode(d) for _, d in bag], packed) for packed in (b"none", b"bz2")],
        "played log": files[".log"], "candump.gz": [gzip.compress(files[".log"][0])], "db3.zstd": [zstandard.compress(db.read_bytes())],
        "candump on screen": ["\n".join(f" ({1.7e9 + t:.6f})  can0  {c:03X}   [{len(d)}]  {bytes(d).hex(' ')}" for t, c, d in stream).encode()],
        "hub": ["".join(f"< frame {c:03X} {time.time():.6f} {bytes(d).hex()} >" for _, c, d in stream[:60]).encode()],
        "RTDE": [conversation()], "latch": [blank(Record()), blank(Record(why="a measurement was outside its prediction", count=3))],
        "counts": [counted()],
    }  # fmt: skip


def ros1_bag(states: Sequence[JointState], packed: bytes) -> bytes:
    """A bag of ROS 1 with one chunk."""

    def piece(data: bytes) -> bytes:
        return struct.pack("<I", len(data)) + data

    def record(op: int, data: bytes, **fields: bytes) -> bytes:
        head = b"".join(piece(name.encode() + b"=" + value) for name, value in {"op": bytes([op]), **fields}.items())
        return piece(head) + piece(data)

    def message(s: JointState) -> bytes:
        lists = (struct.pack(f"<I{len(x)}d", len(x), *x) for x in (s.position, s.velocity, s.effort))
        names = b"".join(piece(name.encode()) for name in s.name)
        return (
            struct.pack("<3I", 0, *divmod(s.stamp_ns, 10**9))
            + piece(b"")
            + struct.pack("<I", len(s.name))
            + names
            + b"".join(lists)
        )

    number = struct.pack("<I", 0)
    kind = piece(b"type=sensor_msgs/JointState")
    inside = record(7, kind, conn=number, topic=b"/joint_states")
    inside += b"".join(record(2, message(s), conn=number, time=struct.pack("<2I", *divmod(s.stamp_ns, 10**9))) for s in states)
    data = bz2.compress(inside) if packed == b"bz2" else inside
    return b"#ROSBAG V2.0\n" + record(5, data, compression=packed, size=struct.pack("<I", len(inside)))


def conversation() -> bytes:
    """All that a controller says to a client, to its first rows."""
    types = ",".join("VECTOR6D" if name.startswith("actual") else "DOUBLE" for name in SPOKEN).encode()
    row = b"".join(struct.pack(">6d", *[0.1] * 6) if name.startswith("actual") else struct.pack(">d", 3.0) for name in SPOKEN)
    said = [(ASK_VERSION, b"\1"), (OUTPUTS, b"\1" + types), (START, b"\1"), (TEXT, b"\5hello\3arm\1"), *[(DATA, b"\1" + row)] * 3]
    return b"".join(HEAD.pack(HEAD.size + len(payload), kind) + payload for kind, payload in said)


def parsers(folder: Path) -> dict[str, Callable[[bytes], object]]:
    """By the names of `good_inputs`."""
    small = small_arm(folder)
    moving = replace(small, signals={name: small.signals[name] for name in ("q", "dq")})
    (folder / "monitor.dcf").write_bytes(small.dcf.read_bytes())

    def bag(path: Path) -> object:
        return list(trials_of_bag(path, "/joint_states", None, None, 0))

    def seen(path: Path) -> object:
        return list(open_seen(path)[1])

    def log(path: Path) -> object:
        return list(trials_of_log(path, small, small.cycle_s))

    def profile(path: Path) -> object:
        return Decoder(load_profile(path))

    files: dict[str, tuple[str, Callable[[Path], object], Path]] = {
        "configuration": (".toml", load_config, folder), "profile": ("p.toml", profile, folder),
        "keys": (".keys", load_keys, folder), "EDS": (".dcf", lambda path: frame_maps(replace(moving, dcf=path)), folder),
        "model": (".model.json", load_model, folder), "MCAP": (".mcap", bag, folder),
        "MCAP of a violation": (".seen.mcap", seen, folder), "db3": (".db3", bag, folder), "ROS 1 bag": (".bag", bag, folder),
        "candump": (".log", log, folder), "ASC": (".asc", log, folder), "BLF": (".blf", log, folder), "TRC": (".trc", log, folder),
        "candump on screen": (".screen.log", log, folder), "candump.gz": (".log.gz", log, folder), "db3.zstd": (".db3.zstd", bag, folder),
        "played log": (".played.log", lambda path: played(path, small), folder),
    }  # fmt: skip
    memory: dict[str, Callable[[bytes], object]] = {
        "joint_states JSON": decode, "joint_states CDR": decode, "reset": parse_reset, "state message": unpack,
        "CAN frames": frames, "viewer": viewer, "hub": from_hub(), "RTDE": from_controller(), "latch": latch, "counts": counts,
    }  # fmt: skip
    found = memory | {name: through_file(*how) for name, how in files.items()}
    moves = motion(0, 4)

    def watched(path: Path) -> object:
        """Held against an arm, too: a model that lets everything pass is as bad as one that ends the daemon."""
        watch = watch_for(load_model(path), Quantum.none(1), None, (0.0, 1.0), 0.004)
        for k in range(4):
            sample = Sample(k, moves.t[k], moves.q[k, :1], moves.dq[k, :1], moves.tau[k, :1])
            verdict = watch.step(sample)
            if verdict.conformance is Conformance.CONFORMANT:
                between = watch.tube(sample)
                assert between is not None and not np.isnan(between).any(), "conformant, by a tube that is none"
        return watch

    def stopped(path: Path) -> object:
        """Its stops bounded, too, as the monitor's other process does."""
        prepared, _ = prepare(str(path), None, Stops(ramp_deceleration=5.0))
        if prepared is None:
            return None
        for category in ("0", "1"):
            numbers = answer_for(prepared, category, *STATE).numbers
            assert not numbers.why.startswith("the bound failed"), numbers.why
            assert not np.isnan([*numbers.time, *numbers.forward, *numbers.back, numbers.tcp]).any(), "a bound that is no number"
        return prepared

    found["model, right hash"] = through_file(".rehashed.model.json", watched, folder)
    found["model, stops"] = through_file(".stopped.model.json", stopped, folder)
    return found


def blf_spoilt(rng: random.Random, seeds: list[bytes]) -> bytes:
    """A BLF file with the objects in its first container changed, and packed as they should be."""
    seed = rng.choice(seeds)
    at = seed.index(b"LOBJ")
    signature, head, version, size, kind, method, _ = BLF_HEAD.unpack_from(seed, at)
    inside = spoilt(rng, [zlib.decompress(seed[at + BLF_HEAD.size : at + size])])
    packed = zlib.compress(inside, 1)
    return seed[:at] + BLF_HEAD.pack(signature, head, version, BLF_HEAD.size + len(packed), kind, method, len(inside)) + packed


PACKED: dict[str, Callable[[random.Random, list[bytes]], bytes]] = {
    "BLF": blf_spoilt,
    "candump.gz": lambda rng, seeds: gzip.compress(spoilt(rng, [gzip.decompress(s) for s in seeds]), 1),
    "db3.zstd": lambda rng, seeds: zstandard.compress(spoilt(rng, [zstandard.decompress(s) for s in seeds]), 1),
}  # what their sums would refuse before it is looked at


def changed(name: str, rng: random.Random, seeds: list[bytes]) -> bytes:
    """An input for this parser."""
    if name in PACKED and rng.randrange(4):
        return PACKED[name](rng, seeds)
    if name not in REHASHED:
        return spoilt(rng, seeds)
    if rng.randrange(8):
        return rehashed(spoilt_tree(rng, rng.choice(seeds)))
    data = spoilt(rng, seeds)
    try:
        return rehashed(json.loads(data))
    except (ValueError, RecursionError):
        return data


class Slow(Exception):
    """An input has been answered, after more processor time than any may take."""


class Stuck(BaseException):
    """An input has taken more processor time than any may; not an `Exception`, which a parser would take for damage."""


def stuck(*_: object) -> None:
    raise Stuck(f"not done after {LONGEST} s of processor time")


def outcome(parse: Callable[[bytes], object], data: bytes) -> tuple[str, BaseException | None]:
    """What has come of an input, and what was foreign in it."""
    begin, kind = time.process_time(), "taken"
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        try:
            parse(data)
        except StopsetError:
            kind = "refused"
        if (took := time.process_time() - begin) > SLOW:
            raise Slow(f"{kind} after {took:.1f} s of processor time")
    except (Exception, Stuck) as e:  # noqa: BLE001 - what is looked for
        return f"FOREIGN {type(e).__name__}", e
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return kind, None


def fuzz(
    name: str, parse: Callable[[bytes], object], seeds: list[bytes], inputs: int, seed: int, seconds: float = math.inf,
    found: Path | None = None,
) -> Counter[str]:  # fmt: skip
    """Outcomes by kind; foreign ones by the exception's name, with their inputs in the folder ``found``.

    Ends early after ``seconds`` of processor time.
    """
    rng, out, end = random.Random(f"{name} {seed}"), Counter[str](), time.process_time() + seconds
    before = signal.signal(signal.SIGPROF, stuck)
    for _ in range(inputs):
        if time.process_time() > end:
            break
        data = changed(name, rng, seeds)
        kind, e = outcome(parse, data)
        out[kind] += 1
        if e is None:
            continue
        if out[kind] == 1:
            print(f"{name}: {type(e).__name__}: {str(e)[:120]}  by  {data[:120]!r}", flush=True)
        if found is not None:
            found.mkdir(parents=True, exist_ok=True)
            (found / f"{name} {type(e).__name__} {zlib.crc32(data):08x}").write_bytes(data)
    signal.signal(signal.SIGPROF, before)
    return out


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000, help="per parser (files: a hundredth)")
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="of processor time per parser, then it ends with fewer inputs"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="one parser")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--kept", type=Path)
    parser.add_argument("--found", type=Path)
    args = parser.parse_args()
    kept: dict[str, dict[str, int]] = json.loads(args.kept.read_text()) if args.kept and args.kept.exists() else {}
    logging.disable()  # the libraries' own words on every damaged line
    can.io.player.read_entry_points = cache(can.io.player.read_entry_points)  # looked up anew for every log otherwise
    found: dict[str, dict[str, int]] = {}
    memory = Path("/dev/shm")  # a file system in memory, where there is one
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as place:
        folder = Path(place)
        tempfile.tempdir = place
        seeds = good_inputs(folder)
        # whoever has had least comes first: a run may be ended before its end
        for name, parse in sorted(parsers(folder).items(), key=lambda item: sum(kept.get(item[0], {}).values())):
            if args.only and args.only != name:
                continue
            begin, before = time.process_time(), Counter(kept.get(name, {}))
            n = args.inputs if name in IN_MEMORY or args.kept else max(1, args.inputs // 100)
            # what a parser has had so far begins another run of chance
            new = fuzz(name, parse, seeds[name], n - before.total(), args.seed + before.total(), args.seconds, args.found)
            found[name] = kept[name] = dict(before + new)
            if args.kept:
                args.kept.write_text(json.dumps(kept))
            print(
                f"{name:<19} {sum(found[name].values()):8} inputs in {time.process_time() - begin:6.1f} s CPU: {found[name]}",
                flush=True,
            )
    if args.json:
        args.json.write_text(json.dumps(found))
    return int(any("FOREIGN" in kind for counts in found.values() for kind in counts))


if __name__ == "__main__":
    sys.exit(main())
