"""What one cycle of the monitor costs, part by part, and how late it publishes when fed over a bus by another process.

``python benchmarks/monitor.py [MODEL RECORDING]``; without arguments a known arm with a horizon of 0.4 s is used.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from monitor_arm import known_model, meta, motion
from monitor_process import Ear, free_port, running, stopset, write_config
from stopset.artifact import load_model, save_model
from stopset.monitor.layout import pack, unpack
from stopset.monitor.links.canopen_map import Decoder, Encoder
from stopset.monitor.profile import load_profile
from stopset.monitor.replay import signal_rows
from stopset.monitor.source import sample_of
from stopset.monitor.watch import Quantum, Watch
from stopset.recording import Recording, read_recordings, write_recordings


def timed(what: str, work: Callable[[], None], repeat: int) -> None:
    """Median and 99.9th percentile of ``work`` in microseconds."""
    t = np.empty(repeat)
    for i in range(repeat):
        begin = time.perf_counter()
        work()
        t[i] = time.perf_counter() - begin
    print(f"{what:<44} {1e6 * np.median(t):8.1f} us   p99.9 {1e6 * np.quantile(t, 0.999):8.1f} us")


def parts(model_path: Path, trial: Recording) -> None:
    model, p = load_model(model_path), load_profile("lwa4p/monitor")
    encoder, decoder = Encoder(p), Decoder(p)
    rows = signal_rows(trial)
    frames = list(encoder.frames(rows[0]))
    cycle = next(c for c in (decoder.frame(i, d, 0.0) for i, d in frames) if c is not None)

    def decode() -> None:
        for cob_id, data in frames:
            decoder.frame(cob_id, data, 0.0)

    timed("decode 13 frames of a cycle", decode, 5000)
    watch = Watch(model, Quantum(p.quantum("q"), p.quantum("dq"), p.quantum("tau")))
    k = iter(range(10**9))
    for _ in range(len(watch.ages)):
        watch.step(sample_of(cycle, next(k)))
    timed(f"step against {watch.stride and len(watch.ages) - 1} ages", lambda: void(watch.step(sample_of(cycle, next(k)))), 3000)
    values = {"data_id": 1, "stop0_time": np.full(6, 0.1)}
    timed("pack a message", lambda: void(pack(values)), 5000)


def void(_: object) -> None:
    """A result that is not needed."""


def live(model_path: Path, recording: Path, trials: int, speed: float) -> None:
    """SYNC to publication, replay, monitor and listener in processes of their own."""
    bus, port = free_port(), free_port()
    with tempfile.TemporaryDirectory() as folder:
        config = write_config(Path(folder), model_path, f'[bus]\nlink = "hub:{bus}"', port)
        with running("monitor", "--config", str(config)), Ear(port) as ear:
            _, err = stopset(
                "replay", str(recording), "--to", f"hub:{bus}", "--wait", "1", "--trials", str(trials), "--speed", str(speed)
            ).communicate(timeout=120)
            if err:
                print(err)
            time.sleep(0.5)
            rows = [unpack(d) for d in ear.raw]
    rows = [r for r in rows if r["t_meas_ns"]]
    new = [b for a, b in pairwise(rows) if a["t_meas_ns"] != b["t_meas_ns"]]
    late = np.array([r["t_pub_ns"] - r["t_meas_ns"] for r in new]) * 1e-6
    print(f"SYNC to publication at {250 * speed:.0f} Hz: {len(late)} messages, median {np.median(late):.2f} ms, "
          f"p99 {np.quantile(late, 0.99):.2f} ms, max {late.max():.1f} ms")  # fmt: skip
    print("  " + json.dumps({k: ear.twins[-1][k] for k in ("samples", "gaps", "violation_count")}))


def main() -> None:
    if len(sys.argv) > 2:
        model_path, recording = Path(sys.argv[1]), Path(sys.argv[2])
    else:
        folder = Path(tempfile.mkdtemp())
        model_path, recording = folder / "known.model.json", folder / "known.parquet"
        save_model(known_model(), model_path)
        write_recordings(recording, meta(), [motion(s, 1000, s) for s in range(3)])
    parts(model_path, next(iter(read_recordings(recording))))
    for speed in (1.0, 4.0):
        live(model_path, recording, 3, speed)


if __name__ == "__main__":
    main()
