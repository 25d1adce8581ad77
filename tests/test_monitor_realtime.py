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
from stopset.monitor.realtime import GOT, SHARE, claim

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


CROWDED = """
import os, subprocess, sys, threading, time
from stopset.monitor.realtime import Waits
core = min(os.sched_getaffinity(0))
os.sched_setaffinity(0, {core})
def works():
    while True:
        os.getpid()
def loop():
    waits.since()
    time.sleep(2.0)
    said.append(waits.since())
waits, said = Waits(), []
others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
threading.Thread(target=works, daemon=True).start()
thread = threading.Thread(target=loop)
thread.start()
thread.join()
for other in others:
    other.kill()
print(said[0])
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


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="the kernel does not count")
def test_it_is_said_who_waits_for_a_processor() -> None:
    """A loop that is first in line was late by what its own threads waited behind others on their core, and nothing told that from a slow loop."""
    out = subprocess.run([sys.executable, "-c", CROWDED], capture_output=True, text=True, check=True, timeout=600).stdout
    said = eval(out)
    assert said["threads_waited_ms"] > 500.0 > said["loop_waited_ms"] >= 0.0
    runtime = int((SHARE / "sched_rt_runtime_us").read_text())
    assert said["fifo_share"] == (1.0 if runtime < 0 else runtime / int((SHARE / "sched_rt_period_us").read_text()))


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
