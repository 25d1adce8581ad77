"""The latch's journal: what a kill leaves is exact, what a loss of power leaves is latched, with reason and count."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from monitor_process import environment
from patience import wait
from stopset.errors import OutputError
from stopset.monitor import journal_file
from stopset.monitor.journal import SLOT, Journal, blank
from stopset.monitor.journal_file import FileStore
from stopset.monitor.latch import Latch, Record
from stopset.monitor.sample import Sample
from stopset.monitor.verdict import Conformance, Deviation, Verdict

SECTOR = 512
NEVER_ENDS = """
import sys
import numpy as np
from pathlib import Path
from stopset.monitor.journal import Journal
from stopset.monitor.journal_file import FileStore
from stopset.monitor.latch import Latch, Record
from test_journal import bad, sample

latch = Latch(Journal(FileStore(Path(sys.argv[1]), Record())))
for k in range(10**9):
    latch.take(sample(k), bad(k), k * 0.004)
    latch.keep(k * 0.004)
    sys.stdout.write(f"{latch.count}\\n")
    sys.stdout.flush()
"""


def sample(k: int) -> Sample:
    return Sample(k, k * 0.004, np.zeros(2), np.zeros(2), np.zeros(2))


def bad(k: int) -> Verdict:
    """Another joint violates from the 300th sample on."""
    joints = ("a", "b") if k >= 300 else ("a",)
    found = tuple(Deviation(j, "q", "above", 0.1, 0.01, 1.0, 1.0, 0.9, True) for j in joints)
    return Verdict(Conformance.VIOLATION, "a: q above its prediction", 1, 0.1, found)


class Disk:
    """Takes what it is given into its memory, and on to its plates when it is asked and has the time."""

    def __init__(self) -> None:
        self.memory, self.plates, self.counts, self.settled = bytearray(blank(Record())), bytearray(blank(Record())), b"", True

    def read(self) -> bytes:
        return bytes(self.memory)

    def write(self, offset: int, data: bytes) -> None:
        self.memory[offset : offset + len(data)] = data

    def flush(self) -> None:
        self.settled = False

    def sync(self) -> None:
        self.plates[:], self.settled = self.memory, True

    def read_counts(self) -> bytes:
        return self.counts

    def write_counts(self, data: bytes) -> None:
        self.counts = data

    astray = interrupted = notice = ""

    def close(self) -> None:
        """Nothing is open."""

    def after_loss_of_power(self, rng: np.random.Generator) -> Disk:
        """Of what was on its way some sectors have come through, some half; the system's memory is empty."""
        after = Disk()
        after.memory[:] = self.plates
        for at in range(0, len(self.plates), SECTOR):
            if rng.random() < 0.5:
                end = at + int(rng.choice([SECTOR, SECTOR, 200]))
                after.memory[at:end] = self.memory[at:end]
        after.plates[:] = after.memory
        return after


@pytest.mark.parametrize("attempt", range(5))
def test_a_kill_in_the_midst_loses_no_count(tmp_path: Path, attempt: int) -> None:
    """What had been counted before the last word is there; at most one sample more, of which there was no time to speak."""
    path = tmp_path / "arm.latch"
    env = environment()
    env["PYTHONPATH"] += ":" + str(Path(__file__).parent)
    with subprocess.Popen([sys.executable, "-c", NEVER_ENDS, str(path)], env=env, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        heard = [int(process.stdout.readline()) for _ in range(200 + 150 * attempt)]
        while b"a: q above" not in path.read_bytes():  # until the disk has had the time for a record at all
            heard.append(int(process.stdout.readline()))
        time.sleep(0.001 * attempt)
        process.kill()
        heard += [int(line) for line in process.stdout.read().split("\n")[:-1]]
    taken = b'"joint":"b"' in path.read_bytes()
    latch = Latch(Journal(FileStore(path, Record())))
    assert latch.latched and heard[-1] <= latch.count <= heard[-1] + 1
    a = latch.record.entries[0]
    assert a.samples == latch.count and "a: q above" in latch.record.why
    if heard[-1] > 302:
        assert taken or "never got" in latch.record.why
    if taken:
        assert [e.samples for e in latch.record.entries] == [latch.count, latch.count - 300]
    latch.close()


def test_a_count_goes_on_though_the_entry_that_came_last_is_on_no_disk() -> None:
    """The count of what the disk does hold was that of the moment in which it was written."""
    disk = Disk()
    latch = Latch(Journal(disk))
    for k in range(290):
        latch.take(sample(k), bad(k), 0.0)
    disk.sync()
    for k in range(290, 400):
        latch.take(sample(k), bad(k), 0.0)
    after = Disk()
    after.memory[:], after.counts = disk.plates, disk.counts
    again = Latch(Journal(after))
    assert again.count == 400 and [e.samples for e in again.record.entries] == [400]


def test_power_lost_at_any_moment_leaves_latch_reason_and_count() -> None:
    """However slow the disk and whichever sectors of a write it took: latched as soon as a sync came after the first violation,
    with the reason and at least what was counted when the disk last had everything."""
    rng = np.random.default_rng(0)
    for _ in range(300):
        disk, sure = Disk(), 0
        latch = Latch(Journal(disk))
        for k in range(int(rng.integers(1, 400))):
            latch.take(sample(k), bad(k), k * 0.004)
            if rng.random() < 0.05:
                latch.save(k * 0.004)
            if rng.random() < 0.02:
                disk.sync()
                sure = latch.record.entries[0].samples if latch._saved == latch.count else max(sure, latch._saved)
        again = Latch(Journal(disk.after_loss_of_power(rng)))
        if sure:
            assert again.latched and again.count >= sure and "a: q above" in again.record.why
            assert again.record.entries[0].first.joint == "a"
        else:
            assert again.latched or again.count == 0


def test_of_more_counts_than_there_is_room_for_the_sum_is_kept(tmp_path: Path) -> None:
    """Sixteen joints on both sides are 64 and their sum; none was written, and a kill took the last second's."""
    journal = Journal(FileStore(tmp_path / "latch", Record()))
    journal.read()
    journal.count([7000, *range(64)])
    assert not journal.trouble
    journal.close()
    again = Journal(FileStore(tmp_path / "latch", Record()))
    again.read()
    assert again.counted()[0] == 7000
    again.close()


def test_a_reset_forgets_the_counts_too(tmp_path: Path) -> None:
    path = tmp_path / "arm.latch"
    latch = Latch(Journal(FileStore(path, Record())))
    for k in range(10):
        latch.take(sample(k), bad(k), 0.0)
    latch.reset("A. Person", "seen to", 0.0)
    latch.close()
    again = Latch(Journal(FileStore(path, Record())))
    assert not again.latched and again.count == 0
    again.close()


def test_counts_of_a_journal_that_is_gone_are_not_of_the_next_one(tmp_path: Path) -> None:
    path = tmp_path / "arm.latch"
    latch = Latch(Journal(FileStore(path, Record())))
    for k in range(100):
        latch.take(sample(k), bad(k), 0.0)
        latch.save(0.0)
    latch.take(sample(100), bad(100), 0.0)
    latch.close()
    path.unlink()
    latch = Latch(Journal(FileStore(path, Record())))
    assert latch.latched and "taken away" in latch.record.why
    latch.reset("A. Person", "seen to", 0.0)
    latch.close()
    latch = Latch(Journal(FileStore(path, Record())))
    assert not latch.latched
    latch.close()


def test_a_count_says_what_the_disk_refused(tmp_path: Path) -> None:
    """The disk was full when the violation came, and the process was killed: there were violations, so it is latched."""
    disk = Disk()
    journal = Journal(disk)
    write, disk.write = disk.write, lambda offset, data: (_ for _ in ()).throw(OSError(28, "No space left on device"))  # type: ignore[method-assign]
    latch = Latch(journal)
    for k in range(3):
        latch.take(sample(k), bad(k), 0.0)
    assert journal.trouble
    disk.write = write  # type: ignore[method-assign]
    again = Latch(Journal(disk))
    assert again.latched and again.count == 3


def test_the_slot_that_the_disk_holds_is_not_touched() -> None:
    disk = Disk()
    journal = Journal(disk)
    journal.read()
    held = bytes(disk.plates)
    for k in range(5):
        journal.write(Record(why="x", count=k))
    changed = {at // SLOT for at in range(len(held)) if disk.memory[at] != held[at]}
    assert len(changed) == 1
    disk.sync()
    held = bytes(disk.plates)
    journal.write(Record(why="x", count=9))
    assert {at // SLOT for at in range(len(held)) if disk.memory[at] != held[at]} == {0, 1} - changed


CROWDED = """
import resource, sys
from pathlib import Path
from stopset.errors import OutputError
from stopset.monitor.journal_file import FileStore
from stopset.monitor.latch import Record

resource.setrlimit(resource.RLIMIT_FSIZE, (20480, 20480))
try:
    FileStore(Path(sys.argv[1]), Record())
except OutputError as e:
    print(e)
"""


def test_a_disk_with_room_for_half_a_journal_gets_none(tmp_path: Path) -> None:
    """What fitted was kept, and the next start found a damaged journal: a violation that never was."""
    path = tmp_path / "arm.latch"
    out = subprocess.run(
        [sys.executable, "-c", CROWDED, str(path)], env=environment(), stdout=subprocess.PIPE, text=True, check=True
    )
    assert "cannot be written" in out.stdout and not list(tmp_path.iterdir())
    latch = Latch(Journal(FileStore(path, Record())))
    assert not latch.latched
    latch.close()


@pytest.mark.parametrize("memory", [True, False])
def test_room_for_counts_is_there_from_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, memory: bool) -> None:
    """On a disk that is full when the first violation comes they could not be written. Where the system has no place in memory it is beside."""
    place = tmp_path / "memory"
    monkeypatch.setattr(journal_file, "MEMORY", place)
    if memory:
        place.mkdir()
    latch = Latch(Journal(FileStore(tmp_path / "arm.latch", Record())))
    (counts,) = place.iterdir() if memory else tmp_path.glob(".*.counts")
    before = counts.stat().st_size
    for k in range(3):
        latch.take(sample(k), bad(k), 0.0)
    assert counts.stat().st_size == before > 0
    latch.close()


def test_a_full_memory_gets_nothing_and_takes_up_what_was_counted_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was left an empty file; and what a life had counted on the disk meanwhile was not looked for when there was room again."""
    place, written, full = tmp_path / "memory", os.pwrite, threading.Event()
    place.mkdir()
    full.set()
    monkeypatch.setattr(journal_file, "MEMORY", place)

    def crowded(fd: int, data: bytes, at: int) -> int:
        if full.is_set() and Path(f"/proc/self/fd/{fd}").readlink().is_relative_to(place):
            raise OSError(28, "No space left on device")
        return written(fd, data, at)

    monkeypatch.setattr(os, "pwrite", crowded)
    path = tmp_path / "arm.latch"
    journal = Journal(FileStore(path, Record()))
    journal.read()
    journal.count([7, 5])
    assert not list(place.iterdir()) and list(tmp_path.glob(".*.counts"))
    journal.close()
    full.clear()
    again = Journal(FileStore(path, Record()))
    again.read()
    assert again.counted() == [7, 5] and len(list(place.iterdir())) == 1 and not list(tmp_path.glob(".*.counts"))
    again.close()


def test_a_place_in_memory_that_is_somebody_else_s_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever could write there could have a violation forgotten, or lead the monitor's writes elsewhere."""
    place, victim = tmp_path / "memory", tmp_path / "victim"
    place.mkdir()
    monkeypatch.setattr(journal_file, "MEMORY", place)
    path = tmp_path / "arm.latch"
    store = FileStore(path, Record())
    (counts,) = place.iterdir()
    store.close()
    assert not list(place.iterdir()), "what the disk holds need not stay there"
    victim.write_text("something")
    counts.symlink_to(victim)
    FileStore(path, Record()).close()
    assert victim.read_text() == "something" and list(tmp_path.glob(".*.counts"))
    counts.unlink()
    counts.touch(0o644)
    FileStore(path, Record()).close()
    assert not counts.stat().st_size


def test_a_copy_of_the_folder_is_another_arm_s_journal(tmp_path: Path) -> None:
    first = tmp_path / "first"
    first.mkdir()
    a = Journal(FileStore(first / "arm.latch", Record()))
    shutil.copytree(first, tmp_path / "second")
    b = Journal(FileStore(tmp_path / "second" / "arm.latch", Record()))
    for journal in (a, b):
        journal.read()
    a.count([7])
    assert b.counted() == []
    a.close()
    b.close()


def test_what_the_disk_has_refused_is_tried_again_and_said_until_then(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also if it is told only after the loop has gone on."""
    latch, disk = Latch(Journal(FileStore(tmp_path / "arm.latch", Record()))), threading.Event()
    written = os.pwrite

    def refuse(fd: int, data: bytes, at: int) -> int:
        if len(data) == SLOT and not disk.is_set():
            time.sleep(0.1)
            raise OSError(5, "Input/output error")
        return written(fd, data, at)

    monkeypatch.setattr(os, "pwrite", refuse)
    begin = time.monotonic()
    latch.take(sample(0), bad(0), 0.0)
    assert time.monotonic() - begin < 0.09
    assert wait(lambda: "Input/output error" in latch.keep(0.1))
    disk.set()
    assert wait(lambda: latch.keep(time.monotonic()) == "")
    latch.close()


def test_an_emergency_finds_room_behind_whatever_was_violated(tmp_path: Path) -> None:
    """Eight joints, both states, both sides: the slot was full, and an emergency after it was forgotten by a restart."""
    found = tuple(
        Deviation(f"robot_left_shoulder_pan_joint_{j}", state, side, *np.random.default_rng(j).uniform(size=3), -1 / 3, 1 / 3, True)
        for j in range(8) for state in ("q", "dq") for side in ("above", "below")
    )  # fmt: skip
    latch = Latch(Journal(FileStore(tmp_path / "arm.latch", Record())))
    for k in range(5):
        latch.take(sample(k), Verdict(Conformance.VIOLATION, "x", 1, 0.1, found), 0.0)
    latch.hear({"robot_left_shoulder_pan_joint_3": 0x2310})
    assert not latch.keep(10.0) and len(latch.record.entries) == 32
    latch.close()
    again = Latch(Journal(FileStore(tmp_path / "arm.latch", Record())))
    assert again.latched and again.count == 5 and again.record.emergencies == {"robot_left_shoulder_pan_joint_3": 0x2310}
    assert 20 < len(again.record.entries) < 32
    again.close()


def test_what_was_put_behind_a_journal_is_damage_once(tmp_path: Path) -> None:
    """It made every later start latched, whatever a person had cleared."""
    path = tmp_path / "arm.latch"
    Latch(Journal(FileStore(path, Record()))).close()
    path.write_bytes(path.read_bytes() + b"\n")
    latch = Latch(Journal(FileStore(path, Record())))
    assert latch.latched and "damaged" in latch.record.why
    latch.reset("A. Person", "an editor's line end", 0.0)
    latch.close()
    again = Latch(Journal(FileStore(path, Record())))
    assert not again.latched
    again.close()


@pytest.mark.parametrize("how", ["gone", "another", "folder"])
def test_a_journal_that_a_restart_would_not_find_is_said(tmp_path: Path, how: str) -> None:
    path = tmp_path / "state" / "arm.latch"
    path.parent.mkdir()
    latch = Latch(Journal(FileStore(path, Record())))
    assert latch.keep(0.0) == ""
    if how == "folder":
        path.parent.rename(tmp_path / "elsewhere")
    else:
        path.rename(path.with_name("kept"))
    if how == "another":
        path.write_bytes(blank(Record()))
    assert wait(lambda: "no longer at" in latch.keep(1.0)) and latch.keep(2.0), "as long as it is so"
    latch.close()


def test_a_journal_on_what_keeps_nothing_is_refused(tmp_path: Path) -> None:
    """A pipe took every write and gave nothing back."""
    os.mkfifo(tmp_path / "arm.latch")
    with pytest.raises(OutputError, match="no file that lasts"):
        FileStore(tmp_path / "arm.latch", Record())
