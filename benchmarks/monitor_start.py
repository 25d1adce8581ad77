"""How long a monitor takes from its process' start to its first OK, and what memory it has then:
``python benchmarks/monitor_start.py MODEL RECORDING [--times 5] [--together N] [--lock] [--cold]`` (``--together``: so many monitors, each of its
own arm, started at the same moment, as when a hall's machine comes back; ``--lock``: in real memory alone, where this user may;
``--cold``: from a fresh copy of all packages that the system holds nothing of in memory, so that each is read from the disk; Python itself
and its own library are shared with whoever else runs and stay where they are).

Replay, monitor and listener are processes of their own on loopback; ``./run demo --out FOLDER`` leaves a model
(``first.model.json``) and a recording (``healthy.parquet``) to try it with. OK needs evidence that is 0.1 s old, a bound of
every stop category, and 0.25 s without a break, all of it in the time told.
"""

from __future__ import annotations

import argparse
import compileall
import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from monitor_bounds import cpu_of

from monitor_process import environment, free_port, running
from stopset.errors import BusError
from stopset.monitor.layout import State, unpack
from stopset.monitor.links.zenoh_link import ZenohLink

PATIENCE = 30.0  # [s]
CONFIG = """model = "{model}"
data_id = 1
realtime = {lock}
[bus]
link = "hub:{bus}"
[zenoh]
listen = ["tcp/127.0.0.1:{port}"]
[publish]
valid_for_ms = 200
[stops]
ramp_time_s = 0.35
ramp_off_after_s = 0.5
"""


IMPORTED = """
import json, sys
import can, zenoh, stopset.cli.main, stopset.monitor.service, stopset.monitor.stopworker
print(json.dumps([m.__file__ for m in sys.modules.values() if getattr(m, "__file__", None)]))
"""


def copied(folder: Path) -> Path:
    """All that a monitor imports beside Python's own library, copied into ``folder`` (whole packages: they hold data, too)."""
    said = subprocess.run([sys.executable, "-c", IMPORTED], env=environment(), capture_output=True, text=True, check=True)
    roots = {Path(root) for root in environment()["PYTHONPATH"].split(os.pathsep)}
    folder.mkdir()
    for file in map(Path, json.loads(said.stdout)):
        site = next((p for p in file.parents if p in roots or p.name == "site-packages"), None)
        if site is None:
            continue
        top = file.relative_to(site).parts[0]
        if (site / top).is_file():
            shutil.copy2(site / top, folder)
        elif not (folder / file.relative_to(site)).exists():
            for source in filter(Path.is_dir, (site / top, site / f"{top}.libs")):
                shutil.copytree(source, folder / source.name, dirs_exist_ok=True)
    return folder


def forgotten(folder: Path) -> int:
    """The system holds nothing of these files in memory any more; their size [MB]."""
    os.sync()
    size = 0
    for path in folder.rglob("*"):
        if path.is_file():
            fd = os.open(path, os.O_RDONLY)
            os.posix_fadvise(fd, 0, 0, os.POSIX_FADV_DONTNEED)
            size += os.fstat(fd).st_size
            os.close(fd)
    return size // 1_000_000


def from_disk(pid: int) -> float:
    """What a process has had to read from the disk so far [MB]; 0 where the system does not tell."""
    with contextlib.suppress(OSError):
        return int(dict(line.split(": ") for line in Path(f"/proc/{pid}/io").read_text().splitlines())["read_bytes"]) / 1e6
    return 0.0


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def megabytes(pid: int) -> tuple[int, int]:
    """Most real memory that a process has had, and what of it is locked [MB]."""
    found = dict(re.findall(r"(VmHWM|VmLck):\s+(\d+)", Path(f"/proc/{pid}/status").read_text()))
    return int(found["VmHWM"]) // 1000, min(int(found["VmLck"]), int(found["VmHWM"])) // 1000


Found = tuple[float, tuple[int, int], float, float, float, float]


def first_ok(model: Path, recording: Path, ready: Callable[[], object], *, lock: bool, cold: bool) -> Found:
    """[s] from the start of the monitor's process, when ``ready`` comes back, to the first OK heard, infinite if none comes; its memory
    then, what it read from the disk [MB], its processor time [s], that of the process it has bound stops [s],
    and meanwhile of the replay [s]."""
    bus, port = free_port(), free_port()
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "monitor.toml"
        config.write_text(CONFIG.format(model=model.resolve(), lock=str(lock).lower(), bus=bus, port=port))
        heard: list[float] = []

        def take(_key: str, data: bytes) -> None:
            if not heard and unpack(data)["state"] == State.OK:
                heard.append(time.monotonic())

        with running("replay", str(recording), "--to", f"hub:{bus}", "--wait", "1") as replay:
            time.sleep(2.0)  # the bus is there before the monitor, as in a cell
            more = {}
            if cold:
                packages = copied(Path(folder) / "packages")
                forgotten(packages)
                more = {"PYTHONPATH": str(packages)}
            ready()
            begin, link, before = time.monotonic(), None, cpu_of(replay.pid)
            with running("monitor", "--config", str(config), **more) as monitor:
                while not heard and time.monotonic() - begin < PATIENCE:
                    if link is None:
                        try:
                            link = ZenohLink("site/cell/arm/stopset", mode="client", connect=[f"tcp/127.0.0.1:{port}"])
                            link.subscribe("state", take)
                        except BusError:
                            link = None
                    time.sleep(0.005)
                memory, read, cpu = megabytes(monitor.pid), from_disk(monitor.pid), cpu_of(monitor.pid)
                bounding, playing = sum(map(cpu_of, children(monitor.pid))), cpu_of(replay.pid) - before
                if link is not None:
                    link.close()
    return heard[0] - begin if heard else float("inf"), memory, read, cpu, bounding, playing


def together(n: int, model: Path, recording: Path, *, lock: bool, cold: bool) -> list[Found]:
    """The same of ``n`` monitors that begin at one moment."""
    ready = Barrier(n).wait
    with ThreadPoolExecutor(n) as pool:
        jobs = [pool.submit(first_ok, model, recording, ready, lock=lock, cold=cold) for _ in range(n)]
        return [job.result() for job in jobs]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--together", type=int, default=1, metavar="N", help="monitors started at the same moment")
    parser.add_argument("--lock", action="store_true", help="realtime = true")
    parser.add_argument("--cold", action="store_true", help="every package is read from the disk")
    args = parser.parse_args()
    for root in environment()["PYTHONPATH"].split(os.pathsep):
        compileall.compile_dir(root, quiet=2)  # as an install leaves it
    started = (together(args.together, args.model, args.recording, lock=args.lock, cold=args.cold) for _ in range(args.times))
    found = sorted(each for several in started for each in several)
    took = [seconds for seconds, *_ in found]
    most, locked = max(memory for _, memory, *_ in found)
    reads, cpu, bounding, playing = ([each[k] for each in found] for k in (2, 3, 4, 5))
    print(f"memory {most} MB at most, {locked} MB of it locked")
    print(
        f"the process read {min(reads):.0f} to {max(reads):.0f} MB from the disk and took {min(cpu):.2f} to {max(cpu):.2f} s of processor time, "
        f"what bounds stops {min(bounding):.2f} to {max(bounding):.2f} s, "
        f"meanwhile its replay {min(playing):.2f} to {max(playing):.2f} s"
    )
    print(f"load {os.getloadavg()[0]:.1f}; first OK after {', '.join(f'{x:.2f}' for x in took)} s")
    print(f"median {took[len(took) // 2]:.2f} s, worst {took[-1]:.2f} s of {len(took)}")


if __name__ == "__main__":
    main()
