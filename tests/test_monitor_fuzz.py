"""A little rubbish for every parser at every run; the benchmark gives them a million inputs each."""

from __future__ import annotations

import contextlib
import itertools
import logging
import sqlite3
import sys
from pathlib import Path

import pytest

from stopset.errors import RecordingError
from stopset.monitor.bags import trials_of_bag

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import monitor_fuzz

MEMORY, FILES = 1500, 60
SLOW = (
    "MCAP", "MCAP of a violation", "BLF", "EDS", "ASC", "TRC", "candump", "candump on screen", "candump.gz", "played log", "db3", "db3.zstd",
    "model", "model, right hash", "model, stops", "RTDE", "latch",
)  # fmt: skip


@pytest.mark.parametrize("seed", [0])
def test_rubbish_is_refused_with_a_declared_error(seed: int, tmp_path: Path) -> None:
    seeds = monitor_fuzz.good_inputs(tmp_path)
    logging.disable()
    try:
        for name, parse in monitor_fuzz.parsers(tmp_path).items():
            parse(seeds[name][0])  # the good one is taken
            inputs = FILES if seeds[name][0] and name in SLOW else MEMORY
            found = monitor_fuzz.fuzz(name, parse, seeds[name], inputs, seed)
            assert not [kind for kind in found if "FOREIGN" in kind], (name, found)
            assert inputs == FILES or found["taken"], f"{name}: some changes do no harm"
    finally:
        logging.disable(logging.NOTSET)


def test_a_bag_whose_row_claims_more_than_there_is_memory_is_refused(tmp_path: Path) -> None:
    """Found by a fuzzer that looks at what was covered: SQLite answers such a length with an error of Python's own."""
    good = monitor_fuzz.good_inputs(tmp_path)["db3"][0]
    path, row, foreign = tmp_path / "claims.db3", good.index(b"\0\1\0\0", 8192), 0
    # where its length stands moves with the stamps of the writing, and only some lengths are too large and still taken for one
    for at, ones, last in itertools.product(range(row - 20, row - 4), range(3, 13), (b"`", b"d", b"n")):
        path.write_bytes(good[:at] + b"\xff" * ones + last + good[at + ones + 1 :])
        with contextlib.closing(sqlite3.connect(path)) as db:
            try:
                db.execute("select m.data from messages m join topics t on m.topic_id = t.id order by m.timestamp").fetchall()
            except MemoryError:
                foreign += 1
            except sqlite3.Error:
                continue
        with contextlib.suppress(RecordingError):
            list(trials_of_bag(path, "/joint_states", None, None, 0))
    assert foreign, "one of them is the case"
