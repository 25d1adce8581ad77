"""What a monitor does before its first OK is begun in time, and nothing is loaded for it that it does not use."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from monitor_arm import known_model
from monitor_process import environment
from patience import wait
from stopset.artifact import save_model
from stopset.monitor import stopdesk
from stopset.monitor.config import Stops
from stopset.monitor.realtime import GOT, claim
from stopset.monitor.sample import Quantum
from stopset.monitor.spawned import Spawned
from stopset.monitor.stopdesk import StopDesk, seen_by
from stopset.monitor.stopworker import prepare

BEGUN = """
import os, sys
from stopset.monitor.spawned import Spawned

def begin(cls, load, name, *, copied):
    threads = len(os.listdir("/proc/self/task")) if os.path.exists("/proc/self/task") else 1
    print(name, copied, threads, sorted({"stopset.monitor.stopworker", "zenoh", "stopset.monitor.service"} & set(sys.modules)))
    raise SystemExit(0)

Spawned.begin = classmethod(begin)
from stopset.cli.main import main
main(["monitor", "--config", sys.argv[1]])
"""
LOADED = "import sys, stopset.cli.main, stopset.monitor.service; print(sorted({'pyarrow', 'scipy'} & set(sys.modules)))"


REFUSED = """
import resource, time
from pathlib import Path
from stopset.monitor.opening import Opening

opening, size = Opening(lambda: "a source"), int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + 500_000, resource.RLIM_INFINITY))
try:
    print(opening.turn())
except RuntimeError as e:
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    print(e)
end = time.monotonic() + 5.0
while (source := opening.turn()) is None and time.monotonic() < end:
    time.sleep(0.01)
print(source)
"""


def said_by(code: str, *words: str) -> str:
    """What a process of its own prints."""
    return subprocess.run(
        [sys.executable, "-c", code, *words], env=environment(), capture_output=True, text=True, check=True
    ).stdout


def test_what_bounds_stops_is_copied_with_what_it_needs_before_there_are_threads(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text('model = "m.json"\ndata_id = 7\n[bus]\nlink = "hub:1"\n')
    assert said_by(BEGUN, str(tmp_path / "c.toml")).split("\n")[-2] == "stop-bounds True 1 ['stopset.monitor.stopworker']"


def test_the_daemon_loads_nothing_that_only_recordings_need() -> None:
    assert said_by(LOADED).strip() == "[]"


def test_a_desk_takes_the_process_that_was_begun_and_another_when_that_ends(tmp_path: Path) -> None:
    model = save_model(known_model(), tmp_path / "m.model.json")
    begun, still = Spawned.bounding_stops(), np.zeros(6)
    desk = StopDesk(str(tmp_path / "m.model.json"), seen_by(model), Stops(("0",)), None, Quantum.none(6), begun=begun)

    def bounded() -> bool:
        desk.offer(time.monotonic(), still, still)
        return desk.now(still, still)[1]

    try:
        assert desk._process is begun.process and wait(bounded, 60.0)
        begun.process.kill()
        assert wait(lambda: bounded() and desk.restarts == 1 and desk._ready, 60.0)
        assert desk._process is not begun.process and desk._process.is_alive()
    finally:
        desk.close()


def test_a_model_file_that_was_cut_is_told_as_that(tmp_path: Path) -> None:
    """By whom bounds stops and was begun anew meanwhile: it ended over it, and after five times for good."""
    path = tmp_path / "m.model.json"
    save_model(known_model(), path)
    path.write_bytes(path.read_bytes()[:5000])
    prepared, why = prepare(str(path), None, Stops(("0",)), "ab" * 32)
    assert prepared is None and "is damaged" in why


def test_a_process_that_hangs_is_ended_and_begun_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was waited for for ever: no stop was bounded again."""
    model = save_model(known_model(), tmp_path / "m.model.json")
    begun, x = Spawned.bounding_stops(), np.zeros(6)
    desk = StopDesk(str(tmp_path / "m.model.json"), seen_by(model), Stops(("0",)), None, Quantum.none(6), begun=begun)

    def bounded() -> bool:
        desk.offer(time.monotonic(), x, 0.0 * x)
        return desk.now(x, 0.0 * x)[1]

    try:
        assert wait(bounded, 60.0)
        os.kill(begun.process.pid, signal.SIGSTOP)
        monkeypatch.setattr(stopdesk, "HUNG", 3.0)
        x = x + 0.7  # where nothing that is kept holds
        assert wait(lambda: bounded() and desk.restarts >= 1, 60.0)
        assert desk._process is not begun.process
    finally:
        desk.close()


def test_whatever_it_takes_to_begin_it_anew_the_loop_does_not_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It took some 70 ms of silence, longer than data are valid for."""
    model, threads = save_model(known_model(), tmp_path / "m.model.json"), []
    begun, still, begin = Spawned.bounding_stops(), np.zeros(6), Spawned.bounding_stops
    desk = StopDesk(str(tmp_path / "m.model.json"), seen_by(model), Stops(("0",)), None, Quantum.none(6), begun=begun)

    def slow() -> Spawned:
        threads.append(threading.get_ident())
        return begin()

    try:
        desk.offer(0.0, still, still)
        monkeypatch.setattr(Spawned, "bounding_stops", staticmethod(slow))
        begun.process.kill()
        assert wait(lambda: desk.offer(time.time(), still, still) or (desk._ready and desk.restarts == 1))
        assert threads and threading.get_ident() not in threads
    finally:
        desk.close()


def test_a_process_that_has_ended_before_it_is_assigned_is_begun_anew(tmp_path: Path) -> None:
    model = save_model(known_model(), tmp_path / "m.model.json")
    begun, still = Spawned.bounding_stops(), np.zeros(6)
    begun.process.kill()
    begun.process.join()
    desk = StopDesk(str(tmp_path / "m.model.json"), seen_by(model), Stops(("0",)), None, Quantum.none(6), begun=begun)

    def bounded() -> bool:
        desk.offer(time.monotonic(), still, still)
        return desk.now(still, still)[1]

    try:
        assert wait(bounded, 60.0) and desk.restarts == 1
    finally:
        desk.close()


def test_a_process_nobody_assigns_ends_with_who_began_it() -> None:
    begun = Spawned.bounding_stops()
    begun.pipe.close()
    begun.process.join(60.0)
    assert begun.process.exitcode == 0


SHORT = """
import os, sys
import numpy as np
from stopset.monitor.config import Stops
from stopset.monitor.spawned import Spawned

begun = Spawned.bounding_stops(copied=sys.argv[2] == "copied")
if sys.argv[3] == "assigned":
    begun.assign(sys.argv[1], "", None, Stops(("0",)), ("0",))
print(begun.process.pid, flush=True)
os._exit(0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="processes of Linux")
@pytest.mark.parametrize("how", ["copied", "begun"])
@pytest.mark.parametrize("what", ["assigned", "not yet"])
def test_a_process_ends_with_a_monitor_that_lived_for_no_second(tmp_path: Path, how: str, what: str) -> None:
    """Killed that early a monitor left its copy behind, for ever: it held the pipe's other end too, and took who adopted it for who began it."""
    save_model(known_model(), tmp_path / "m.model.json")
    words = [sys.executable, "-c", SHORT, str(tmp_path / "m.model.json"), how, what]
    with subprocess.Popen(words, env=environment(), stdout=subprocess.PIPE, text=True) as short:
        assert short.stdout is not None
        pid = int(short.stdout.readline())
        place = Path(f"/proc/{pid}/stat")
        ended = wait(lambda: not place.exists() or place.read_text().rpartition(")")[2].split()[0] == "Z", 10.0)
        if not ended:
            os.kill(pid, signal.SIGKILL)
    assert ended


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core is all there is")
def test_it_goes_to_the_cores_that_the_loop_is_given() -> None:
    all_cores, begun = os.sched_getaffinity(0), Spawned.bounding_stops()
    core = min(all_cores)
    try:
        granted = claim(cores=(core,), begun=(begun.process.pid,))
        assert granted.said[f"cores {core}"] == GOT and os.sched_getaffinity(begun.process.pid) == {core}
    finally:
        os.sched_setaffinity(0, all_cores)
        begun.process.kill()
        begun.process.join()


@pytest.mark.skipif(sys.platform != "linux", reason="limits of a running process")
def test_a_bus_is_opened_again_though_the_machine_refused_a_thread() -> None:
    """It was waited for the thread that had never begun, for ever."""
    assert said_by(REFUSED).split("\n")[:2] == ["can't start new thread", "a source"]
