"""``sensor_msgs/JointState`` out of MCAP files and bags of ROS 2 (sqlite3) and ROS 1, read with what the formats are made of."""

from __future__ import annotations

import math
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, suppress
from itertools import pairwise
from operator import itemgetter
from pathlib import Path

import numpy as np

from stopset.errors import BusError, RecordingError
from stopset.monitor import ros1_bag
from stopset.monitor.jointstate import JointState, decode
from stopset.recording import Meta, Recording
from stopset.types import Array
from stopset.unpacked import MESSAGE, PIECE, Allowance, TooLargeError, Unpacking, mcap_records

ROS1 = ".bag"
BAG_SUFFIXES = frozenset({".mcap", ".db3", ROS1})
SHORTEST = 10
SHOWN = 80  # characters of a topic's name
GAP = 2.5  # periods without a message that end a trial


def is_bag(path: Path) -> bool:
    """An MCAP file, a ``.db3``, either compressed (``.zstd``), the folder that ROS 2 writes them into, or a ``.bag`` of ROS 1."""
    name = path.name.removesuffix(".zstd") if path.suffix == ".zstd" else path.name
    return Path(name).suffix.lower() in BAG_SUFFIXES or (path / "metadata.yaml").is_file()


def _parts(path: Path) -> list[Path]:
    """The files of a bag, in the order in which they were written (ROS 2 numbers them)."""
    if not path.is_dir():
        return [path]

    def number(p: Path) -> tuple[int, str]:
        digits = re.search(r"_(\d+)\.", p.name)
        return (int(digits[1]) if digits else 0, p.name)

    parts = sorted((p for p in path.iterdir() if p.is_file() and is_bag(p)), key=number)
    if not parts:
        raise RecordingError(
            f"{path} holds no .db3 or .mcap; expected the folder of a ROS 2 bag: give the folder with metadata.yaml"
        )
    return parts


def _unpacked_parts(path: Path) -> Iterator[Path]:
    """The files of a bag as they were before they were packed; what was unpacked is there until the next one is asked for."""
    for part in _parts(path):
        if part.suffix != ".zstd":
            yield part
            continue
        with tempfile.TemporaryDirectory() as folder:
            whole = Path(folder) / part.name.removesuffix(".zstd")
            _unpack(part, whole)
            yield whole


def _all_states(path: Path, topic: str) -> Iterator[JointState]:
    for part in _unpacked_parts(path):
        if part.suffix.lower() == ROS1 and part.is_file():
            yield from ros1_bag.joint_states(part, topic)
            continue
        for data in _messages(part, topic):
            try:
                yield decode(data)
            except BusError as e:
                raise RecordingError(f"{path}: {e}") from e


def _topics(part: Path) -> dict[str, str]:
    """Name and type of what a readable file of a bag holds."""
    if part.suffix.lower() == ROS1:
        return {name[:SHOWN]: kind[:SHOWN] for name, kind in ros1_bag.topics(part).items()}
    if part.suffix.lower() != ".mcap":
        with closing(sqlite3.connect(f"file:{part}?mode=ro", uri=True)) as db:
            return {str(name)[:SHOWN]: str(kind)[:SHOWN] for name, kind in db.execute("select name, type from topics limit 100")}
    from mcap.records import Channel, Schema

    with part.open("rb") as f:
        records = [r for r in mcap_records(f) if isinstance(r, (Channel, Schema))]
    kinds = {r.id: r.name for r in records if isinstance(r, Schema)}
    return {r.topic[:SHOWN]: kinds.get(r.schema_id, "")[:SHOWN] for r in records if isinstance(r, Channel)}


def _too_few(path: Path, topic: str, count: int) -> RecordingError:
    """That there are hardly joint states on a topic, and where else some are."""
    held: dict[str, str] = {}
    with suppress(Exception):  # its messages could be read; where its list of topics cannot, only these are told of
        for part in _unpacked_parts(path):
            held |= _topics(part)
    others = sorted(name for name, kind in held.items() if kind.endswith("/JointState") and name != topic)
    what = ", ".join(f"{name} ({kind})" for name, kind in sorted(held.items())[:4]) or "no topic"
    do = f"give --topic {others[0]}" if others else "record sensor_msgs/JointState with the torque of the joints"
    return RecordingError(f"{path} holds {count} messages on {topic}, and {what}; expected at least {SHORTEST}: {do}")


def _unpack(part: Path, whole: Path) -> None:
    """A bag that was packed with zstd, onto the disk. Raises `RecordingError`."""
    import zstandard

    try:
        free = shutil.disk_usage(whole.parent).free
        with part.open("rb") as packed, whole.open("wb") as f:
            stream = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            shutil.copyfileobj(Unpacking(stream, Allowance.of(part.stat().st_size, most=free // 2)), f)
    except TooLargeError as e:
        raise RecordingError(f"{part} {e}") from e
    except (zstandard.ZstdError, OSError) as e:
        raise RecordingError(f"{part} cannot be unpacked ({e}); copy it again, or unpack it with zstd -d") from e


def _messages(path: Path, topic: str) -> Iterator[bytes]:
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; expected an MCAP file, the .db3 of a ROS 2 bag or the .bag of a ROS 1 bag")
    if path.suffix.lower() == ".mcap":
        try:
            yield from _mcap_messages(path, topic)
        except TooLargeError as e:
            raise RecordingError(f"{path} {e}") from e
        except Exception as e:
            why = f"{type(e).__name__}: {str(e)[:200]}"
            raise RecordingError(f"{path} is not a readable MCAP file ({why}); record or copy it again") from e
        return
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as db:
            yield from _db3_messages(path, db, topic)
    except TooLargeError as e:
        raise RecordingError(f"{path} {e}") from e
    except (sqlite3.Error, UnicodeDecodeError, OverflowError, MemoryError) as e:  # a damaged length asks for more than there is
        why = f"{type(e).__name__}: {e}"
        raise RecordingError(f"{path} is not a readable ROS 2 bag ({why}); give the .db3 file") from e


def _db3_messages(path: Path, db: sqlite3.Connection, topic: str) -> Iterator[bytes]:
    """By the time at which they were recorded. A table may be a view, or a column computed, without an end."""
    db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, PIECE)
    tables = {name for (name,) in db.execute("select name from sqlite_master where type = 'table'")}
    if lacking := {"messages", "topics"} - tables:
        raise RecordingError(f"{path} has no table {', '.join(sorted(lacking))}; expected a ROS 2 bag: record or copy it again")
    allowance = Allowance.of(path.stat().st_size)
    query = "select m.data from messages m join topics t on m.topic_id = t.id where t.name = ? order by m.timestamp"
    for (data,) in db.execute(query, (topic,)):
        if not isinstance(data, bytes):
            raise RecordingError(f"{path} holds a message that is no bytes; expected a ROS 2 bag: record or copy it again")
        allowance.take(len(data))
        yield data


def _mcap_messages(path: Path, topic: str) -> Iterator[bytes]:
    """By the time at which they were recorded."""
    from mcap.records import Channel, Message

    allowance, channels, found = Allowance.of(path.stat().st_size), set[int](), list[tuple[int, bytes]]()
    with path.open("rb") as f:
        for record in mcap_records(f):
            if isinstance(record, Channel) and record.topic == topic:
                channels.add(record.id)
            elif isinstance(record, Message) and record.channel_id in channels:
                allowance.take(MESSAGE + len(record.data))
                found.append((record.log_time, record.data))
    found.sort(key=itemgetter(0))
    for _, data in found:
        yield data


def trials_of_bag(
    path: Path, topic: str, joints: tuple[str, ...] | None, cycle_s: float | None, suite: int
) -> Iterator[tuple[Recording, tuple[str, ...]]]:
    """Unbroken runs of messages as trials, with the joints' names; time is the header stamp."""
    states = list(_all_states(path, topic))
    if len(states) < SHORTEST:
        raise _too_few(path, topic, len(states))
    names = joints or states[0].name
    # several nodes may publish on one topic (a gripper's, say), and one may publish a message twice
    mine = [s for s in states if any(j in s.name for j in names)]
    states = mine[:1] + [b for a, b in pairwise(mine) if b.stamp_ns != a.stamp_ns]
    if len(states) < SHORTEST:
        raise RecordingError(
            f"{path} holds {len(states)} messages of {', '.join(names)} on {topic}; expected at least {SHORTEST}: name the --joints"
        )
    _efforts(path, states, names)
    t = np.array([s.stamp_ns for s in states], dtype=np.int64)
    period = cycle_s or float(np.median(np.diff(t))) * 1e-9
    if not (math.isfinite(period) and period > 0):
        raise RecordingError(f"{path}: the header stamps on {topic} do not advance; expected stamped messages")
    step = np.diff(t) * 1e-9
    edges = [0, *(np.flatnonzero((step > GAP * period) | (step <= 0)) + 1).tolist(), len(t)]
    trial = 0
    for lo, hi in pairwise(edges):
        if hi - lo >= SHORTEST:
            yield _recording(path, states[lo:hi], names, suite, trial), names
            trial += 1


def _efforts(path: Path, states: list[JointState], names: tuple[str, ...]) -> None:
    """Refuse a bag in which nobody published a torque."""
    efforts = [x for s in states for x in s.effort]
    if not any(math.isfinite(x) and x != 0.0 for x in efforts):
        what = "no effort" if not efforts else "an effort that is zero or not a number throughout"
        raise RecordingError(
            f"{path}: its joint states hold {what}; expected the torque of {', '.join(names[:3])}{' ...' if len(names) > 3 else ''}: let the "
            "controller publish effort, for motion alone tells nothing of inertia and friction"
        )


def _recording(path: Path, run: list[JointState], names: tuple[str, ...], suite: int, trial: int) -> Recording:
    tables: list[Array] = []
    t = np.array([s.stamp_ns - run[0].stamp_ns for s in run]) * 1e-9
    for kind in ("position", "velocity", "effort"):
        if kind == "velocity" and not any(s.velocity for s in run):
            tables.append(np.gradient(tables[0], t, axis=0))
            continue
        rows = []
        for s in run:
            values = dict(zip(s.name, getattr(s, kind), strict=False))
            if lacking := [j for j in names if j not in values]:
                raise RecordingError(
                    f"{path}: {kind} of {', '.join(lacking)} is missing in a message; "
                    "expected position and effort of every joint, velocity of all or none"
                )
            rows.append([values[j] for j in names])
        tables.append(np.array(rows))
    q, dq, tau = tables
    return Recording("closed_loop", suite, trial, trial, t, q, dq, tau)


def meta_of_bag(found: list[tuple[Recording, tuple[str, ...]]], effort: str) -> Meta:
    """Metadata of recordings made from a bag; where nobody published speeds they were derived from positions."""
    recording, names = found[0]
    derived = np.array_equal(recording.dq, np.gradient(recording.q, recording.t, axis=0))
    rate = 1.0 / float(np.median(np.diff(recording.t)))
    return Meta(joints=names, effort=effort, velocity="derived" if derived else "measured", clock="recorded", rate_hz=rate)
