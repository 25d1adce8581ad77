"""How long a monitor takes from its process' start to its first OK: ``python benchmarks/monitor_start.py MODEL RECORDING [--times 5]``.

Replay, monitor and listener are processes of their own on loopback; ``./run demo --out FOLDER`` leaves a model
(``second.model.json``) and a recording (``healthy.parquet``) to try it with. OK needs evidence that is 0.1 s old, a bound of
every stop category, and 0.25 s without a break, all of it in the time told.
"""

from __future__ import annotations

import argparse
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


def first_ok(model: Path, recording: Path, patience: float = 30.0) -> float:
    """[s] from the start of the monitor's process to the first OK heard, infinite if none comes."""
    bus, port = free_port(), free_port()
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "monitor.toml"
        config.write_text(CONFIG.format(model=model.resolve(), bus=bus, port=port))
        heard: list[float] = []

        def take(_key: str, data: bytes) -> None:
            if not heard and unpack(data)["state"] == State.OK:
                heard.append(time.monotonic())

        with running("replay", str(recording), "--to", f"hub:{bus}", "--wait", "1"):
            time.sleep(2.0)  # the bus is there before the monitor, as in a cell
            begin, link = time.monotonic(), None
            with running("monitor", "--config", str(config)):
                while not heard and time.monotonic() - begin < patience:
                    if link is None:
                        try:
                            link = ZenohLink("site/cell/arm/stopset", mode="client", connect=[f"tcp/127.0.0.1:{port}"])
                            link.subscribe("state", take)
                        except BusError:
                            link = None
                    time.sleep(0.005)
                if link is not None:
                    link.close()
    return heard[0] - begin if heard else float("inf")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--times", type=int, default=5)
    args = parser.parse_args()
    took = sorted(first_ok(args.model, args.recording) for _ in range(args.times))
    print(f"first OK after {', '.join(f'{x:.2f}' for x in took)} s; median {took[len(took) // 2]:.2f} s")


if __name__ == "__main__":
    main()
