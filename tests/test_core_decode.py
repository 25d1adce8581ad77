"""Frames to readings in the core: every kind of number, clocks, heartbeats; whatever is lost or doubled, no cycle is mixed of two; and a
fuzzer that feeds anything."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from stopset.core.library import ffi, lib
from stopset.types import Array

SYNC, FIRST, CYCLE = 0x80, 0x180, 0.004
KINDS = {
    "b": lib.STOPSET_I8, "h": lib.STOPSET_I16, "i": lib.STOPSET_I32, "q": lib.STOPSET_I64, "B": lib.STOPSET_U8, "H": lib.STOPSET_U16,
    "I": lib.STOPSET_U32, "Q": lib.STOPSET_U64, "f": lib.STOPSET_F32, "d": lib.STOPSET_F64, "?": lib.STOPSET_BOOL,
}  # fmt: skip
seeds = st.integers(0, 2**32 - 1)


class Frame(NamedTuple):
    """As on the wire; ``t`` [s] as stamped."""

    id: int
    data: bytes
    t: float
    length: int = -1  # as sent, if not that of the data


@dataclass
class Table:
    """A bus of ``n`` PDOs with one number each, of kind ``code``; the last ``loose`` of them come when they like."""

    n: int = 3
    code: str = "i"
    loose: int = 0
    overflow: int = 0
    patience: float = 0.0
    nodes: dict[int, int] = field(default_factory=dict)
    held: list[Any] = field(default_factory=list)
    d: Any = None

    def __post_init__(self) -> None:
        size, place = struct.calcsize(f"<{self.code}"), np.full(lib.STOPSET_IDS, -1, np.int32)
        place[FIRST : FIRST + self.n], place[SYNC] = np.arange(self.n), lib.STOPSET_SYNC
        pdos = ffi.new("StopsetPdo[]", [(size, k < self.n - self.loose, k, 1) for k in range(self.n)])
        fields = ffi.new("StopsetField[]", [(0, KINDS[self.code], k) for k in range(self.n)])
        node = np.zeros(lib.STOPSET_NODES, np.uint8)
        node[list(self.nodes)] = list(self.nodes.values())
        self.values, self.heard = np.full(self.n, np.nan), np.zeros(lib.STOPSET_NODES)
        room = [np.zeros(self.n) for _ in range(2)], np.zeros(self.n, np.uint8), np.ones(self.n), ffi.new("StopsetFrame[]", 4)
        self.held = [place, pdos, fields, node, room]
        (raw, held), came, scale, log = room
        self.d = ffi.new("StopsetDecoder *", {
            "n": self.n, "signals": 1, "pdos": self.n, "synchronous": self.n - self.loose, "overflow": self.overflow, "cycle_s": CYCLE,
            "place": ffi.from_buffer("int32_t[]", place), "pdo": pdos, "field": fields,
            **{k: ffi.from_buffer("double[]", x) for k, x in (
                ("scale", scale), ("raw", raw), ("held", held), ("values", self.values), ("heard", self.heard))},
            "came": ffi.from_buffer("uint8_t[]", came), "node": ffi.from_buffer("uint8_t[]", node), "patience": self.patience,
            "foreign": -1, "shift": math.inf, "log": log, "room": 4, "counter": -1, "held_counter": -1, "status": -1,
        })  # fmt: skip

    def feed(self, frames: Iterable[Frame], now: float | None = None) -> list[tuple[int, int, Array]]:
        """(what it stopped at, SYNC's counter, the values) for every stop; ``now`` [s], or the frames' own stamps."""
        out = []
        for f in frames:
            one, taken = ffi.new("StopsetFrame *"), ffi.new("int64_t *", 0)
            one.id, one.length, one.t = f.id, len(f.data) if f.length < 0 else f.length, f.t
            one.data[0 : min(8, len(f.data))] = f.data[:8]
            while what := lib.stopset_decode(self.d, one, 1, f.t if now is None else now, taken):
                out.append((what, self.d.out_counter, self.values.copy()))
            assert taken[0] == 1
        return out


def cycle(k: int, code: str = "i", n: int = 3, counter: int | None = None) -> list[Frame]:
    """SYNC number ``k`` and all its PDOs, which say ``k``."""
    sync = Frame(SYNC, b"" if counter is None else bytes([counter]), 1e3 + k * CYCLE)
    return [sync, *(Frame(FIRST + i, struct.pack(f"<{code}", k), sync.t + 1e-4 * (i + 1)) for i in range(n))]


def given_out(said: list[tuple[int, int, Array]]) -> list[list[float]]:
    return [values.tolist() for what, _, values in said if what == lib.STOPSET_CYCLE]


@pytest.mark.parametrize("code", KINDS)
def test_every_kind_of_number_is_what_struct_makes_of_it(code: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        data = [rng.bytes(struct.calcsize(f"<{code}")) for _ in range(3)]
        t = Table(3, code)
        frames = [Frame(SYNC, b"", 1e3), *(Frame(FIRST + i, x, 1e3 + 1e-4) for i, x in enumerate(data))]
        want = [float(struct.unpack(f"<{code}", x)[0]) for x in data]
        assert np.array_equal(given_out(t.feed(frames)), [want], equal_nan=True)


@pytest.mark.parametrize("late", [0.0, 0.95 * CYCLE])
def test_what_a_cycle_lacks_and_whether_its_drives_are_in_operation(late: float) -> None:
    """Three signals of one joint, the last one its statusword (CiA 402), given out at once or with the next SYNC."""

    def heard(*values: float, status: int = 2) -> tuple[int, int]:
        t = Table(3, "d")
        t.d.n, t.d.signals, t.d.status = 1, 3, status
        first = [
            Frame(SYNC, b"", 1e3),
            *(Frame(FIRST + i, struct.pack("<d", x), 1e3 + 1e-4 + late) for i, x in enumerate(values)),
        ]
        assert len(given_out(t.feed([*first, Frame(SYNC, b"", 1e3 + CYCLE)]))) == 1
        return t.d.out_lacks, t.d.out_powered

    for word in (0x27, 0x637, 0x27 | 0x1210, math.nan):
        assert heard(1.0, 2.0, word)[1] == 1
    for word in (0.0, 0x23, 0x07, 0x6F, -1.0, 1e300, -math.inf):
        assert heard(1.0, 2.0, word) == (0, 0) and heard(1.0, 2.0, word, status=-1) == (0, 1)
    assert [heard(*x, 0x27)[0] for x in ((math.nan, 0.0), (0.0, math.nan), (math.nan, math.nan))] == [1, 2, 3]
    assert heard(0.0, 0.0, math.nan) == (4, 1)


@pytest.mark.parametrize("overflow", [0, 5])
def test_whole_cycles_are_given_out_and_damaged_ones_are_not(overflow: int) -> None:
    def count(k: int) -> int | None:
        return k % overflow + 1 if overflow else None

    def heard(*damaged: list[Frame]) -> list[list[float]]:
        t = Table(3, overflow=overflow)
        return given_out(t.feed([f for part in (cycle(0, counter=count(0)), *damaged, cycle(9, counter=count(9))) for f in part]))

    one, two, three = (cycle(k, counter=count(k)) for k in (1, 2, 3))
    assert heard(one, two) == [[k] * 3 for k in (0, 1, 2, 9)]
    assert heard(one[:-1], two, three)[1:2] != [[1] * 3]  # one frame is missing
    assert [1.0] * 3 not in heard([one[0], one[1], *one[1:]])  # one came twice
    assert [1.0] * 3 not in heard([*one[:-1], one[-1]._replace(data=b"\1")])  # one is too short
    # its last frame comes with the next SYNC: whose it is nobody can tell
    assert [1.0] * 3 not in heard([*one[:-1], one[-1]._replace(t=two[0].t - 1e-6)], two)
    # a cycle that comes late but whole is given out with the next SYNC
    late = [f._replace(t=one[0].t + 0.95 * CYCLE) for f in one[1:]]
    assert [1.0] * 3 in heard([one[0], *late], two)
    assert [1.0] * 3 not in heard([one[0], *late], three)  # but not where a SYNC is missing


def test_without_a_counter_a_missing_sync_is_seen_from_the_clock_alone() -> None:
    """A decoder whose SYNC has a counter does not ask the clock, unless the counter was not there before."""
    late = [f._replace(t=cycle(1)[0].t + 0.95 * CYCLE) for f in cycle(1)[1:]]
    for overflow, sync in ((0, b""), (5, b"")):
        t = Table(3, overflow=overflow)
        said = given_out(t.feed([*cycle(0), cycle(1)[0]._replace(data=sync), *late, *cycle(2)]))
        assert [1.0] * 3 in said


def test_what_drives_say_when_they_like_holds_until_they_say_it_again() -> None:
    t = Table(3, loose=1)
    status = Frame(FIRST + 2, struct.pack("<i", 77), 1e3 - 0.1)
    assert given_out(t.feed([status, *cycle(0, n=2)])) == [[0, 0, 77]]
    assert given_out(t.feed([status._replace(data=b"\1", t=1e3 + 1e-3), *cycle(1, n=2)])) == [[1, 1, 77]] and t.d.incomplete == 1
    assert given_out(t.feed([status._replace(data=struct.pack("<i", 5), t=1e3 + 5e-3), *cycle(2, n=2)])) == [[2, 2, 5]]


def test_frames_before_any_sync_make_the_first_cycle_doubtful() -> None:
    t = Table()
    assert given_out(t.feed([*cycle(0)[1:], *cycle(1), *cycle(2)])) == [[2.0] * 3]


def test_a_doubtful_cycle_that_ends_late_leaves_the_next_one_doubtful() -> None:
    """A drive is a cycle behind when the monitor begins to listen, and catches up: what ends the first cycle is of the one before."""
    zero, one, two, three = (cycle(k) for k in range(4))
    behind = [zero[3]._replace(t=one[0].t + 0.95 * CYCLE), one[3]._replace(t=two[0].t + 1e-5)]
    said = given_out(Table().feed([*zero[1:3], *one[:3], behind[0], two[0], behind[1], *two[1:], *three]))
    assert all(len(set(values)) == 1 for values in said), f"mixed of two cycles: {said}"


@pytest.mark.parametrize(("ahead", "taken"), [(-70.0, False), (70.0, False), (-1.0, True), (1.0, True)])
def test_a_stamp_an_hour_off_is_of_another_clock(ahead: float, taken: bool) -> None:
    """Before or after this machine's; a little off it is this one's and taken at its word."""
    t = Table()
    t.feed([Frame(0x7FF, b"", 1e3 + ahead)], 1e3)
    assert t.d.foreign == (not taken) and t.d.log[0].t == (1e3 + ahead if taken else 1e3)
    t.feed([Frame(0x7FF, b"", 1e3 + ahead + 1.0)], 1001.5)
    assert t.d.log[1].t == pytest.approx(1001.0 + (ahead if taken else 0.0), abs=2e-3)
    t.feed([Frame(0x7FF, b"", 1e3 + ahead + 1.0)], 999.0)  # a clock that was set back
    assert t.d.foreign == (not taken)


def test_nodes_are_good_while_their_heartbeats_come() -> None:
    good, bad, stranger = lib.STOPSET_GOOD, lib.STOPSET_BAD, lib.STOPSET_STRANGER
    operational, t = b"\x05", Table(patience=0.5, nodes={3: good, 4: good, 5: stranger})
    assert not t.feed([Frame(0x703, operational, 1e3), Frame(0x704, b"\x85", 1e3), Frame(0x705, b"\x04", 1e3)])
    assert lib.stopset_nodes_good(t.d, 1000.4) and not lib.stopset_nodes_good(t.d, 1000.6)
    assert not lib.stopset_nodes_good(t.d, math.nan), "no clock, no answer that all is well"
    assert not lib.stopset_nodes_good(t.d, 999.4), "of before the clock was set back, or stamped ahead: that says nothing of now"
    # what is no such heartbeat is the caller's: another state, another length
    for data in (b"\x04", b"\x05\x00", b""):
        assert [what for what, *_ in t.feed([Frame(0x703, data, 1e3)])] == [lib.STOPSET_SERVICE]
    t.held[3][4] = bad
    assert not lib.stopset_nodes_good(t.d, 1000.0)
    assert [what for what, *_ in t.feed([Frame(0x704, operational, 1e3)])] == [lib.STOPSET_SERVICE], "it may be well again"
    silent = Table(nodes={3: good})  # nodes that send no heartbeats are asked for none
    assert lib.stopset_nodes_good(silent.d, 1e9)


def test_services_are_told_from_strangers() -> None:
    """NMT commands and emergencies are the caller's; what has no meaning here, or no place in the table, is counted alone."""
    t, seen = Table(), []
    for x in (0, 0x80 + 1, 0xFF, 0x100, 0x7E, 0x700, 0x701, 0x77F, 0x780, 2047, 2048, 2**32 - 1):
        seen += [x for what, *_ in t.feed([Frame(x, b"\5", 1e3)]) if what == lib.STOPSET_SERVICE]
    assert seen == [0, 0x81, 0xFF] and t.d.unknown == 12 and t.d.frames == 12


@settings(max_examples=200, deadline=None)
@given(seeds, st.sampled_from([0, 5, 240]))
@example(0, 0)
def test_no_cycle_is_mixed_of_two(seed: int, overflow: int) -> None:
    """Frames lost, doubled and late, in any combination: what is given out is one SYNC's, under its own number, and in order; what is not
    given out is counted."""
    rng = np.random.default_rng(seed)
    lose, double, delay = rng.choice([0.0, 0.02, 0.2], 3)
    t, frames = Table(4, overflow=overflow), []
    for k in range(60):
        late = 0.85 * CYCLE if rng.random() < delay else 0.0
        for j, f in enumerate(cycle(k, n=4, counter=k % overflow + 1 if overflow else None)):
            if rng.random() < lose:
                continue
            f = f._replace(t=f.t + (late if j else 0.0))
            frames += [f, f] if rng.random() < double else [f]
    said, last = t.feed(frames), -1.0
    for what, counter, values in said:
        assert what == lib.STOPSET_CYCLE and np.all(values == values[0]) and values[0] > last
        assert counter == (values[0] % overflow + 1 if overflow else -1)
        last = values[0]
    # no cycle that began is missing from what was given out, was incomplete, in doubt, or is underway
    d, doubled = t.d, {f.t for f in frames if f.id == SYNC} != {f.t for f in (cycle(k)[0] for k in range(60))}
    accounted = len(said) + d.incomplete + d.doubted + (d.holds or (d.synced and d.seen < d.synchronous))
    assert d.syncs == sum(f.id == SYNC for f in frames) <= accounted
    assert double or doubled or accounted == d.syncs, "none counts twice, but one that was given out and then came again"
    if lose == double == 0.0:
        assert len(said) >= 58


@settings(max_examples=200, deadline=None)
@given(seeds)
def test_anything_on_the_bus(seed: int) -> None:
    """Identifiers, lengths, bytes and times of all kinds: nothing breaks, and all frames are counted."""
    rng = np.random.default_rng(seed)
    code = str(rng.choice(list(KINDS)))
    t = Table(
        int(rng.integers(1, 6)),
        code,
        int(rng.integers(0, 2)),
        int(rng.choice([0, 1, 240])),
        float(rng.choice([0.0, 0.1])),
        {3: 1, 9: 2},
    )
    times, frames, now = [1e3, 0.0, -1e3, math.nan, math.inf, -math.inf, 1e308], [], 1e3
    for _ in range(int(rng.integers(1, 80))):
        usual = rng.random() < 0.8
        now += rng.choice([0.0, 1e-4, 1e-3, CYCLE, 100.0], p=[0.3, 0.3, 0.3, 0.09, 0.01])
        x = int(rng.choice([SYNC, *range(FIRST, FIRST + 6), 0, 0x81, 0x703, 0x709])) if usual else int(rng.integers(2**32))
        data = rng.bytes(struct.calcsize(f"<{code}") if rng.random() < 0.9 else int(rng.integers(0, 9)))
        frames.append(Frame(x, data, now if usual else float(rng.choice(times)), -1 if usual else int(rng.integers(0, 65))))
    said = t.feed(frames, None if rng.random() < 0.8 else float(rng.choice(times)))
    assert t.d.frames == len(frames) and len(given_out(said)) <= len(frames)
