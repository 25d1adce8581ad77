"""What the loop asks of the operating system: what it gets, and that a refusal is said and not fatal."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest

from monitor_arm import motion
from stopset.artifact import save_model
from stopset.monitor.realtime import GOT, claim

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import monitor

ASK = """
import os, resource, threading
from stopset.monitor.realtime import claim
if {limited}:
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0)); resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    os.setgroups([]); os.setgid(65534); os.setuid(65534)
c = claim(lock=True, priority=7, cores=({core},))
found = []
thread = threading.Thread(target=lambda: found.append(os.sched_getscheduler(0))); thread.start(); thread.join()
print(c.said, [os.sched_getscheduler(0) & 0xFF, *found], os.sched_getaffinity(0), sep="|")
"""


def asked(limited: bool, core: int) -> tuple[dict[str, str], list[int], set[int]]:
    code = ASK.format(limited=limited, core=core)
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=600).stdout
    said, policies, cores = map(eval, out.strip().split("|"))
    return said, policies, cores


def test_it_gets_what_it_may_have_and_its_threads_stay_behind() -> None:
    core = min(os.sched_getaffinity(0))
    said, policies, cores = asked(False, core)
    if said["FIFO priority 7"] == GOT:
        assert policies == [os.SCHED_FIFO, os.SCHED_OTHER]
    assert said[f"cores {core}"] == GOT and cores == {core} and "memory lock" in said


def test_a_refusal_is_said() -> None:
    if os.getuid():
        said, policies, _ = asked(False, 4095)
    else:
        said, policies, _ = asked(True, 4095)
    assert policies[1] == os.SCHED_OTHER and said["cores 4095"].startswith("refused (Invalid argument)")
    if not os.getuid():
        assert policies[0] == os.SCHED_OTHER and "deploy/systemd" in said["FIFO priority 7"] and said["memory lock"] != GOT


def test_nothing_is_asked_for_unless_told() -> None:
    assert claim().said == {} and claim().lacking == ""


def test_a_cycle_keeps_nothing_of_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing collects in the loop, and nothing needs to: neither lists that a later message empties, nor what a violation leaves."""
    monkeypatch.setattr(monitor, "CYCLES", 3000)
    path = tmp_path / "arm.model.json"
    daemon, bus, clock = monitor.prepared(save_model(monitor.torque_input(0.4), path), path, motion(0, 1500))
    gc.collect()
    gc.disable()
    try:
        for k, frames in enumerate(bus.cycles):
            if k == 1000:
                before = sys.getallocatedblocks()
            bus.ready = frames
            clock.now += daemon.cycle_s
            daemon.cycle()
        grown = sys.getallocatedblocks() - before
    finally:
        gc.enable()
    assert daemon.tally.samples > 2900 and grown < 300, f"{grown} blocks in 2000 cycles"
