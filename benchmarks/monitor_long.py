"""A long life in little time: the daemon's loop on frames in memory, ``--cycles`` of them, with a lost stretch every 16 s of its life.

``python benchmarks/monitor_long.py [--cycles N] [--json FILE]`` prints the memory it holds at ten marks and every state it told;
the arm is as it was identified, so nothing but OK, DEGRADED and, where it has just lost its place, UNKNOWN may be among them.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from monitor import CYCLES, Frames, prepared

from monitor_arm import DT, known_model, motion
from stopset.artifact import save_model

LOST = 10  # cycles at the end of each run: too many to be bridged
WRONG = ("VIOLATION", "FAULT", "SHUTDOWN", "INIT", "NEVER_SENT")


def resident_kb() -> int:
    """What this process holds now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4


def stamped(bus: Frames, k: int, overflow: int) -> None:
    """Cycle ``k`` of the life is the next to come: the run's frames again, later and counted on."""
    run, at = divmod(k, CYCLES)
    batch, place = bus.cycles[at], k + run * LOST
    for i in range(batch.count):
        batch.frames[i].t = 1_700_000_000.0 + place * DT
    batch.frames[0].data[0] = place % overflow + 1
    bus.ready = batch


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=1_000_000)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    path = Path(tempfile.mkdtemp()) / "known.model.json"
    save_model(known_model(horizon=0.4), path)
    daemon, bus, clock = prepared(known_model(horizon=0.4), path, motion(0, CYCLES))
    daemon._next_health = 0.0  # the slow messages too, as their counts are kept until they are told
    overflow, memory = 240, []
    gc.collect()
    gc.disable()
    for k in range(args.cycles):
        stamped(bus, k, overflow)
        clock.now = bus.ready.frames[0].t
        daemon.cycle()
        if (k + 1) % max(1, args.cycles // 10) == 0:
            memory.append(resident_kb())
            print(f"{k + 1} cycles: {memory[-1] / 1024:.1f} MiB", flush=True)
    states = {s: n for s, n in daemon.tally.states.items() if n}
    print(f"states {states}, verdicts {daemon.tally.verdicts}, objects that wait for the collector: {gc.collect()}")
    if args.json:
        args.json.write_text(json.dumps({"cycles": args.cycles, "resident_kb": memory, "states": states}))
    sys.exit(any(s in states for s in WRONG))


if __name__ == "__main__":
    main()
