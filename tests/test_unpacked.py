"""Small files that would unpack to more than a machine holds: refused in a sentence, with little memory."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import sqlite3
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer

from monitor_arm import known_model
from stopset.errors import ModelFileError, RecordingError
from stopset.monitor.bags import trials_of_bag
from stopset.monitor.jointstate import JointState, to_cdr
from stopset.offline.update.sums_file import load_sums
from stopset.recording import read_recordings
from stopset.unpacked import PIECE, Allowance, TooLargeError, chunk_data

SIZE = 640 * 2**20  # bytes that the bombs make
MEMORY = 420 * 2**10  # [KiB] that a whole command may take, 150 to 250 of it Python and libraries
ZEROS = bytes(2**24)
# its own peak: getrusage also counts that of the process which it was forked from
RUN = (
    "import sys; from pathlib import Path; from stopset.cli.main import main; code = main(sys.argv[1:]);"
    "print('KiB', *(x.split()[1] for x in Path('/proc/self/status').read_text().splitlines() if x.startswith('VmHWM'))); sys.exit(code)"
)


here = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="a process's own peak of memory is read from /proc")


def deflated(size: int) -> bytes:
    """A zlib stream of so many zeros."""
    stream = zlib.compressobj(1)
    return b"".join(stream.compress(ZEROS) for _ in range(size // len(ZEROS))) + stream.flush()


def zipped(path: Path, member: str) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open(member, "w") as f:
        for _ in range(SIZE // len(ZEROS)):
            f.write(ZEROS)


def zeros_by_zstd() -> bytes:
    out = io.BytesIO()
    with zstandard.ZstdCompressor(level=1).stream_writer(out, closefd=False) as f:
        for _ in range(SIZE // len(ZEROS)):
            f.write(ZEROS)
    return out.getvalue()


def blf(path: Path, declared: int) -> None:
    """A log of one container, of zeros."""
    data = deflated(SIZE)
    head = b"LOGG" + (144).to_bytes(4, "little") + bytes(136)
    body = (2).to_bytes(2, "little") + bytes(6) + declared.to_bytes(4, "little") + bytes(4) + data
    kind = b"LOBJ" + (16).to_bytes(2, "little") + (1).to_bytes(2, "little") + (16 + len(body)).to_bytes(4, "little")
    path.write_bytes(head + kind + (10).to_bytes(4, "little") + body + bytes(4))


def mcap(path: Path, compression: str, declared: int, data: bytes) -> None:
    """A bag whose only chunk is ``data``."""
    out = io.BytesIO()
    w = Writer(out, compression=CompressionType.NONE)
    w.start()
    w.register_channel("/joint_states", "cdr", w.register_schema("sensor_msgs/msg/JointState", "ros2msg", b""))
    w.finish()
    good = out.getvalue()  # the magic bytes, the header's kind and length, the header
    at = 8 + 9 + int.from_bytes(good[9:17], "little")
    chunk = b"".join(
        [bytes(16), declared.to_bytes(8, "little"), bytes(4), len(compression).to_bytes(4, "little"), compression.encode(),
         len(data).to_bytes(8, "little"), data]
    )  # fmt: skip
    path.write_bytes(good[:at] + b"\x06" + len(chunk).to_bytes(8, "little") + chunk + good[at:])


def computed_rows(path: Path) -> None:
    """A bag whose messages are computed as they are read: 2,000 of 60 kB in a file of 200 kB."""
    with contextlib.closing(sqlite3.connect(path)) as db:
        db.execute("create table topics (id integer, name text, type text)")
        db.execute("insert into topics values (1, '/joint_states', 'sensor_msgs/msg/JointState')")
        long = (message() + bytes(60_000)).hex()
        stamped = "id integer primary key, topic_id integer, timestamp integer"
        db.execute(f"create table messages ({stamped}, data blob generated always as (x'{long}'))")
        db.executemany("insert into messages (topic_id, timestamp) values (1, ?)", [(k,) for k in range(2000)])
        db.commit()


def message() -> bytes:
    row = (0.1,) * 6
    return to_cdr(JointState(10**18, known_model().joints, row, row, row))


def columns_that_repeat(path: Path) -> None:
    """A recording of 40 million rows, all alike."""
    rows, names = 4_000_000, ("t", "q_a", "dq_a", "tau_a")
    same = pa.table({name: pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int8)), pa.array([0.0])) for name in names})
    about = {"recording": json.dumps({"joints": ["a"], "effort": "motor_torque"})}
    with pq.ParquetWriter(path, same.replace_schema_metadata(about).schema) as f:
        for _ in range(10):
            f.write_table(same.replace_schema_metadata(about))


BOMBS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "bus.log.gz": ("unpacks to more", lambda p: p.write_bytes(gzip.compress(ZEROS) * (SIZE // len(ZEROS))) and None),
    "bus.asc.gz": ("unpacks to more", lambda p: p.write_bytes(gzip.compress(ZEROS) * (SIZE // len(ZEROS))) and None),
    "claims.blf": ("a piece of 671088640 bytes", lambda p: blf(p, SIZE)),
    "hides.blf": ("declares 1000 bytes and holds more", lambda p: blf(p, 1000)),
    "hides.blf.gz": ("declares 1000 bytes and holds more", lambda p: blf(p, 1000) or (p.write_bytes(gzip.compress(p.read_bytes())) and None)),
    "bag.db3.zstd": ("unpacks to more", lambda p: p.write_bytes(zeros_by_zstd()) and None),
    "zstd.mcap": ("a piece of 671088640 bytes", lambda p: mcap(p, "zstd", SIZE, zeros_by_zstd())),
    "hides.mcap": ("declares 1000 bytes and holds more", lambda p: mcap(p, "zstd", 1000, zeros_by_zstd())),
    "lz4.mcap": ("declares 1000 bytes and holds more", lambda p: mcap(p, "lz4", 1000, lz4.frame.compress(bytes(SIZE)))),
}  # fmt: skip


@here
@pytest.mark.parametrize("name", BOMBS)
def test_a_log_that_would_fill_the_memory_is_refused(name: str, tmp_path: Path) -> None:
    words, write = BOMBS[name]
    path, out = tmp_path / name, tmp_path / "rec.parquet"
    write(path)
    assert path.stat().st_size < 5e6
    done = subprocess.run(
        [sys.executable, "-c", RUN, "import", str(path), "--out", str(out), "--quiet"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 2 and words in done.stderr, done.stderr
    assert str(path) in done.stderr and done.stderr.count("\n") == 1 and not out.exists()
    assert int(done.stdout.split()[-1]) < MEMORY, done.stdout


def test_rows_that_a_bag_computes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bag.db3"
    computed_rows(path)
    with pytest.raises(RecordingError, match="unpacks to more"):
        list(trials_of_bag(path, "/joint_states", None, None, 0))
    with contextlib.closing(sqlite3.connect(path)) as db:
        db.execute("drop table messages")
        endless = "with recursive n(i) as (select 1 union all select i + 1 from n) select i as timestamp, 1 as topic_id, zeroblob(0) as data from n"
        db.execute(f"create view messages as {endless}")
        db.commit()
    with pytest.raises(RecordingError, match="has no table messages"):
        list(trials_of_bag(path, "/joint_states", None, None, 0))


def test_a_recording_whose_rows_repeat_without_an_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "same.parquet"
    columns_that_repeat(path)
    assert path.stat().st_size < 1e6
    with pytest.raises(RecordingError, match=r"same\.parquet unpacks to more"):
        read_recordings(path)


def test_state_whose_arrays_are_too_large_is_refused(tmp_path: Path) -> None:
    model, path = known_model(), tmp_path / "kept.sums"
    zipped(path, "head.npy")
    with pytest.raises(ModelFileError, match="TooLargeError"):
        load_sums(path, model)
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (2**50,)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("head.npy", head.getvalue())
    with pytest.raises(ModelFileError, match="MemoryError"):
        load_sums(path, model)


def test_what_is_declared_comes_out_and_a_large_file_may_give_much() -> None:
    data = bytes(range(256)) * 40
    for name, packed in (("zstd", zstandard.compress(data)), ("lz4", lz4.frame.compress(data)), ("", data)):
        chunk = Chunk(name, packed, 0, 0, 0, len(data))
        assert chunk_data(chunk) == data
        chunk.uncompressed_size += 1
        with pytest.raises(ValueError, match=f"declares {len(data) + 1} bytes and holds {len(data)}"):
            chunk_data(chunk)
    with pytest.raises(ValueError, match="compression 'brotli'"):
        chunk_data(Chunk("brotli", data, 0, 0, 0, len(data)))
    small, large = Allowance.of(10), Allowance.of(10 * PIECE)
    assert PIECE <= small.most < large.most
    small.take(small.most)
    with pytest.raises(TooLargeError):
        small.take(1)
