"""A long life in little time: the daemon's loop on frames in memory, ``--cycles`` of them, with a lost stretch every 16 s of its life.

``python benchmarks/monitor_long.py [--cycles N] [--seed S] [--recording] [--kept FILE] [--json FILE]`` prints at ten marks the memory it holds
and what a cycle costs, and then every state it told; the arm is as it was identified, so nothing but OK, DEGRADED and, where it has just
lost its place, UNKNOWN may be among them. ``--recording``: with the flight recorder beside it, which writes all down and looks whether
it is plausible. ``--kept`` adds the life to those that FILE holds, and prints what they come to. It exits with 1 after a wrong state,
trouble of the recorder, or an object that only the collector, which is off in the daemon's loop, would free.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np
from monitor import CYCLES, Clock, Frames, prepared

from monitor_arm import DT, known_model, motion
from stopset.artifact import save_model
from stopset.monitor.config import Records
from stopset.monitor.daemon import Daemon
from stopset.monitor.evidence.recorder import Recorder
from stopset.monitor.evidence.trace import Trace

LOST = 10  # cycles at the end of each run: too many to be bridged
MARKS = 10
TURN = round(0.05 / DT)  # cycles between two turns of the recorder
WRONG = ("VIOLATION", "FAULT", "SHUTDOWN", "INIT", "NEVER_SENT")


def resident_kb() -> int:
    """What this process holds now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4


def stamped(bus: Frames, k: int, overflow: int) -> None:
    """Cycle ``k`` of the life is the next to come: the run's frames again, later and counted on."""
    run, at = divmod(k, len(bus.cycles))
    batch, place = bus.cycles[at], k + 1 + run * LOST  # after the one with which the bus was joined
    for i in range(batch.count):
        batch.frames[i].t = 1_700_000_000.0 + place * DT
    batch.frames[0].data[0] = place % overflow + 1
    bus.ready = batch


def lived(daemon: Daemon, bus: Frames, clock: Clock, cycles: int) -> dict[str, Any]:
    """So many cycles: at every mark memory [kB] and median and 99th percentile of a cycle's thread CPU [us]; then what was told."""
    overflow, memory, cost = 240, [], []
    took = np.ones(max(1, cycles // MARKS))
    np.quantile(took, 0.5)  # numpy imports a module when it is first asked: that one would count as the loop's
    gc.collect()
    gc.disable()
    for k in range(cycles):
        stamped(bus, k, overflow)
        clock.now = bus.ready.frames[0].t if bus.ready else clock.now
        begin = time.thread_time_ns()
        daemon.cycle()
        took[k % len(took)] = time.thread_time_ns() - begin
        if daemon.recorder is not None and k % TURN == 0:
            daemon.recorder.turn()
        if (k + 1) % len(took) == 0:
            memory.append(resident_kb())
            cost.append([round(float(np.quantile(took, p)) * 1e-3, 1) for p in (0.5, 0.99)])
            print(f"{k + 1} cycles: {memory[-1] / 1024:.1f} MiB, a cycle {cost[-1][0]} us CPU, p99 {cost[-1][1]}", flush=True)
    states = {s: n for s, n in daemon.tally.states.items() if n}
    return {
        "cycles": cycles, "resident_kb": memory, "cycle_cpu_us": cost, "states": states, "verdicts": daemon.tally.verdicts,
        "circles": gc.collect(), "trouble": daemon.recorder.trouble if daemon.recorder else "",
    }  # fmt: skip


def summed(lives: list[dict[str, Any]]) -> str:
    """What several lives come to."""
    states = sum((Counter(x["states"]) for x in lives), Counter[str]())
    grown = max(x["resident_kb"][-1] - x["resident_kb"][0] for x in lives)
    slower = max(x["cycle_cpu_us"][-1][0] / x["cycle_cpu_us"][0][0] for x in lives)
    return (
        f"{len(lives)} lives, {sum(x['cycles'] for x in lives)} cycles: {dict(states)}; at most {grown} kB more at the end of a life than "
        f"after its first tenth, and {slower:.2f} times its cycle; {max(x['circles'] for x in lives)} objects wait for the collector"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0, help="of the motion")
    parser.add_argument("--recording", action="store_true")
    parser.add_argument("--kept", type=Path)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder, clock = Path(place), Clock()
        model, path = known_model(horizon=0.4), folder / "known.model.json"
        save_model(model, path)
        recorder = None
        if args.recording:
            settings = Records(continuous=True, folder=place, file_s=10.0, keep_mb=64.0)  # these seconds are real ones
            recorder = Recorder(Trace(model.n), settings, folder, DT, clock=clock, pause=lambda: None)
        daemon, bus, _ = prepared(model, path, motion(args.seed, CYCLES), clock, recorder)
        daemon._next_health = 0.0  # the slow messages too, as their counts are kept until they are told
        life = {"seed": args.seed, "recording": args.recording, **lived(daemon, bus, clock, args.cycles)}
        daemon.close()
    print(
        f"states {life['states']}, verdicts {life['verdicts']}, {life['circles']} objects wait for the collector; {life['trouble']}"
    )
    lives = [*(json.loads(args.kept.read_text()) if args.kept and args.kept.exists() else []), life]
    if args.kept:
        args.kept.write_text(json.dumps(lives))
        print(summed(lives))
    if args.json:
        args.json.write_text(json.dumps(life))
    sys.exit(any(s in x["states"] for x in lives for s in WRONG) or bool(life["trouble"]) or life["circles"] > 0)


if __name__ == "__main__":
    main()
