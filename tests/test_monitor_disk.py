"""The disk of the journal hangs, or is lost: the monitor speaks on, says so, and no restart forgets what it has seen."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
import shutil
import time
from pathlib import Path

import pytest

from hung_disk import HungDisk
from monitor_arm import known_model, meta, motion, with_torque_scaled
from monitor_process import Ear, free_port, running, write_config
from patience import Granted, rest
from stopset.artifact import save_model
from stopset.monitor import journal_file
from stopset.monitor.layout import Flag, State, unpack
from stopset.recording import write_recordings

PUBLISH = "valid_for_ms = 300\nstale_ms = 600\nrecover_s = 0.05"
LONGEST = 0.4  # [s] that were ours, between two messages: the watchdog of the consumers in the tests of this machine


def flagged_by(ear: Ear, last: int = 5) -> set[bool]:
    """Whether the last messages said that a violation is latched."""
    return {bool(unpack(d)["flags"] & Flag.VIOLATION_LATCHED) for d in list(ear.raw)[-last:]}


class Cell:
    """A monitor with its journal on a disk of its own, and an altered arm."""

    def __init__(self, folder: Path, more: str = "") -> None:
        self.state = folder / "state"
        self.state.mkdir()
        save_model(known_model(), folder / "arm.model.json")
        self.recording, self.bus, self.port = folder / "altered.parquet", free_port(), free_port()
        write_recordings(self.recording, meta(), [with_torque_scaled(motion(0, 250), 3, 1.5)])
        link = f'journal = "state/arm.latch"\n{more}[bus]\nlink = "hub:{self.bus}"\n[stops]\ncategories = ["0"]'
        self.config = write_config(folder, folder / "arm.model.json", link, self.port, "", PUBLISH)

    def latched(self) -> tuple[str, set[bool]]:
        """Of a start: why it is latched, and whether its messages said that it is."""
        with running("monitor", "--config", str(self.config)), Ear(self.port) as ear:
            assert ear.wait(lambda: len(ear.twins) > 1 and len(ear.raw) > 5)
            return ear.twins[-1]["violation_why"], flagged_by(ear, 10**6)

    def violate(self, ear: Ear) -> None:
        with running("replay", str(self.recording), "--to", f"hub:{self.bus}", "--wait", "1") as replay:
            replay.wait(timeout=600)


@pytest.mark.parametrize("killed", ["while it hangs", "when it answers again", "when it answers again, without files in memory"])
def test_a_disk_that_hangs_silences_no_monitor_and_hides_no_violation(tmp_path: Path, killed: str) -> None:
    """It was silent for as long as the disk; and what the disk never got was forgotten by a restart."""
    cell = Cell(tmp_path)
    disk = HungDisk(tmp_path, cell.state)
    if "without" in killed:
        disk.environ["NO_MEMORY_FILES"] = "1"
    with running("monitor", "--config", str(cell.config), **disk.environ) as monitor, Ear(cell.port) as ear, Granted() as granted:
        at: list[float] = []
        ear.link.subscribe("state", lambda _, d: at.append(time.monotonic()))
        assert ear.wait(lambda: len(ear.raw) > 5)
        rest(1.0)
        disk.hang()
        cell.violate(ear)
        assert ear.wait(lambda: flagged_by(ear) == {True}), "it is told though it is on no disk"
        assert ear.wait(lambda: any(e["kind"] == "journal" and "does not answer" in e["why"] for e in list(ear.events)))
        rest(1.0)
        if "without" in killed:
            assert any("no room in the system's memory" in e["why"] for e in list(ear.events) if e["kind"] == "journal"), (
                "it is said"
            )
        gaps = [granted.between(a, b) for a, b in itertools.pairwise([*at, time.monotonic()])]
        assert max(gaps) < LONGEST
        if killed == "while it hangs":
            monitor.kill()
            monitor.wait(timeout=600)
            disk.answer()
        else:
            disk.answer()
            rest(3.0)
            assert not any("refused" in e["why"] for e in list(ear.events) if e["kind"] == "journal")
            monitor.kill()
    why, flagged = cell.latched()
    assert flagged == {True}
    assert ("never got" if killed == "while it hangs" else "outside its prediction") in why


def test_a_hung_disk_does_not_hold_up_the_end(tmp_path: Path) -> None:
    cell = Cell(tmp_path)
    disk = HungDisk(tmp_path, cell.state)
    with running("monitor", "--config", str(cell.config), **disk.environ) as monitor, Ear(cell.port) as ear:
        disk.hang()
        cell.violate(ear)
        assert ear.wait(lambda: flagged_by(ear) == {True})
        with Granted() as granted:
            begin = time.monotonic()
            monitor.terminate()
            monitor.wait(timeout=120)
            assert granted.between(begin, time.monotonic()) < 20.0
        assert ear.states[-1] is State.SHUTDOWN
    disk.answer()
    assert cell.latched()[1] == {True}


@pytest.mark.parametrize("known", ["beside the configuration", "by the configuration"])
def test_a_lost_folder_of_the_journal_is_no_first_start(tmp_path: Path, known: str) -> None:
    """It was one, and a latched violation was forgotten."""
    cell = Cell(tmp_path, "" if known == "beside the configuration" else "must_remember = true\n")
    if known == "beside the configuration":
        assert cell.latched() == ("", {False}), "the first start is one"
    with running("monitor", "--config", str(cell.config)) as monitor, Ear(cell.port) as ear:
        cell.violate(ear)
        assert ear.wait(lambda: flagged_by(ear) == {True})
        monitor.terminate()
        monitor.wait(timeout=600)
    shutil.rmtree(cell.state)
    cell.state.mkdir()
    if known == "by the configuration":  # as on a machine that is new, or whose configuration nobody may write
        cell.config.with_name(f".{cell.config.name}.begun").unlink()
    why, flagged = cell.latched()
    assert flagged == {True} and "taken away" in why
    with running("monitor", "--config", str(cell.config)), Ear(cell.port) as ear:
        assert ear.wait(lambda: ear.twins)
        ear.link.put("reset", b'{"name": "A. Person", "reason": "the disk was changed"}')
        assert ear.wait(lambda: not ear.twins[-1]["violation_latched"])
    assert cell.latched() == ("", {False})


def powered_off(cell: Cell) -> None:
    """As after a loss of power: what was in the machine's memory is not there."""
    name = re.search("^name ([0-9a-f]{32})$", (cell.state / ".arm.latch.begun").read_text(), re.MULTILINE)
    assert name is not None
    digest = hashlib.sha256(f"{name[1]} {(cell.state / 'arm.latch').resolve()}".encode()).hexdigest()
    (journal_file.MEMORY / f"stopset-{digest[:32]}").unlink()


@pytest.mark.parametrize("must", [True, False])
def test_power_lost_while_the_disk_hangs_is_not_forgotten(tmp_path: Path, must: bool) -> None:
    """A violation had been told, and the start after it said OK of that arm as if nothing had been. Whoever asks for it (`must_remember`) gets it
    latched, others are told."""
    cell = Cell(tmp_path, "must_remember = true\n" if must else "")
    disk = HungDisk(tmp_path, cell.state)
    with running("monitor", "--config", str(cell.config), **disk.environ) as monitor, Ear(cell.port) as ear:
        if must:
            assert ear.wait(lambda: ear.twins)
            ear.link.put("reset", b'{"name": "A. Person", "reason": "the first start"}')
            assert ear.wait(lambda: not ear.twins[-1]["violation_latched"])
            rest(1.0)
        disk.hang()
        cell.violate(ear)
        assert ear.wait(lambda: flagged_by(ear) == {True})
        monitor.kill()
        monitor.wait(timeout=600)
    disk.answer()
    powered_off(cell)
    with running("monitor", "--config", str(cell.config)) as monitor, Ear(cell.port) as ear:
        assert ear.wait(lambda: len(ear.twins) > 1 and len(ear.raw) > 5)
        assert ear.twins[-1]["violation_latched"] == must
        if must:
            assert "lost its power" in ear.twins[-1]["violation_why"]
            ear.link.put("reset", b'{"name": "A. Person", "reason": "looked at the arm"}')
            assert ear.wait(lambda: not ear.twins[-1]["violation_latched"])
        else:
            assert "lost its power" in first_word(ear)
        monitor.terminate()
        monitor.wait(timeout=600)
    assert cell.latched() == ("", {False}), "a life that ended in order is none that was cut off"


def first_word(ear: Ear) -> str:
    """Of the journal, from the events that a monitor keeps for those who come later."""

    def said() -> list[str]:
        kept = [e for _, answer in ear.link.get("event") for e in json.loads(answer)]
        return [e["why"] for e in kept if e["kind"] == "journal"]

    assert ear.wait(said)
    return said()[0]
