"""How long a monitor takes from its process' start to its first OK, and what memory it has then:
``python benchmarks/monitor_start.py MODEL RECORDING [--times 5] [--lock]`` (``--lock``: in real memory alone, where this user may).

Replay, monitor and listener are processes of their own on loopback; ``./run demo --out FOLDER`` leaves a model
(``second.model.json``) and a recording (``healthy.parquet``) to try it with. OK needs evidence that is 0.1 s old, a bound of
every stop category, and 0.25 s without a break, all of it in the time told.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from monitor_process import free_port, running
from stopset.errors import BusError
from stopset.monitor.layout import State, unpack
from stopset.monitor.links.zenoh_link import ZenohLink

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


def megabytes(pid: int) -> tuple[int, int]:
    """Most real memory that a process has had, and what of it is locked [MB]."""
    found = dict(re.findall(r"(VmHWM|VmLck):\s+(\d+)", Path(f"/proc/{pid}/status").read_text()))
    return int(found["VmHWM"]) // 1000, min(int(found["VmLck"]), int(found["VmHWM"])) // 1000


def first_ok(model: Path, recording: Path, *, lock: bool, patience: float = 30.0) -> tuple[float, tuple[int, int]]:
    """[s] from the start of the monitor's process to the first OK heard, infinite if none comes; its memory then [MB]."""
    bus, port = free_port(), free_port()
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "monitor.toml"
        config.write_text(CONFIG.format(model=model.resolve(), lock=str(lock).lower(), bus=bus, port=port))
        heard: list[float] = []

        def take(_key: str, data: bytes) -> None:
            if not heard and unpack(data)["state"] == State.OK:
                heard.append(time.monotonic())

        with running("replay", str(recording), "--to", f"hub:{bus}", "--wait", "1"):
            time.sleep(2.0)  # the bus is there before the monitor, as in a cell
            begin, link = time.monotonic(), None
            with running("monitor", "--config", str(config)) as monitor:
                while not heard and time.monotonic() - begin < patience:
                    if link is None:
                        try:
                            link = ZenohLink("site/cell/arm/stopset", mode="client", connect=[f"tcp/127.0.0.1:{port}"])
                            link.subscribe("state", take)
                        except BusError:
                            link = None
                    time.sleep(0.005)
                memory = megabytes(monitor.pid)
                if link is not None:
                    link.close()
    return heard[0] - begin if heard else float("inf"), memory


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--lock", action="store_true", help="realtime = true")
    args = parser.parse_args()
    found = sorted(first_ok(args.model, args.recording, lock=args.lock) for _ in range(args.times))
    took = [seconds for seconds, _ in found]
    most, locked = max(memory for _, memory in found)
    print(f"memory {most} MB at most, {locked} MB of it locked")
    print(f"first OK after {', '.join(f'{x:.2f}' for x in took)} s; median {took[len(took) // 2]:.2f} s")


if __name__ == "__main__":
    main()
