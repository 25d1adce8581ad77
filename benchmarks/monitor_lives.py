"""Many lives of the monitor in a world where things go wrong: ``python benchmarks/monitor_lives.py [--seeds N] [--first S]``.

Prints every broken promise with its seed; ``--first SEED --seeds 1`` lives that life again, byte by byte. With ``--kept FILE`` it
goes on where that file ends, for ``--seconds``, on so many ``--processes``: 100,000 lives take hours.
"""

from __future__ import annotations

import argparse
import gc
import json
import multiprocessing
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from monitor_arm import known_model
from monitor_invariants import broken
from monitor_world import World
from stopset.artifact import load_model, save_model
from stopset.monitor.layout import State

EACH = 50  # lives of a job


def lives(job: tuple[Path, range]) -> tuple[list[str], Counter[str]]:
    """What was broken in the lives of these seeds, and how often which state was said."""
    path, seeds = job
    model = load_model(path)
    gc.collect()  # else the worlds of the job before are frozen, too, and 10,000 lives hold 14 GB
    gc.freeze()  # what was loaded is not looked through again at every collection
    found: list[str] = []
    states: Counter[str] = Counter()
    for seed in seeds:
        world = World(seed, path, model).live()
        found += broken(world)
        states.update(State(t.m["state"]).name for t in world.published)
    return found, states


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kept", type=Path, help="go on with what this file holds, and keep there what is added")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--processes", type=int)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    path = Path(tempfile.mkdtemp()) / "arm.model.json"
    save_model(known_model(horizon=0.1), path)
    out = {"first": args.first, "lives": 0, "states": {}, "broken": []}
    if args.kept and args.kept.exists():
        out = json.loads(args.kept.read_text())
    found, states, last = list(out["broken"]), Counter(out["states"]), out["first"] + args.seeds
    jobs = [(path, range(k, min(k + EACH, last))) for k in range(out["first"] + out["lives"], last, EACH)]
    begin = time.monotonic()
    with multiprocessing.get_context("spawn").Pool(args.processes) as pool:
        for (_, seeds), (words, counted) in zip(jobs, pool.imap(lives, jobs), strict=True):
            found += words
            states += counted
            for line in words:
                print(line, flush=True)
            out = {"first": out["first"], "lives": out["lives"] + len(seeds), "states": states, "broken": found}
            for file in filter(None, (args.kept, args.json)):
                file.write_text(json.dumps(out) + "\n")
            if time.monotonic() - begin > args.seconds:
                break
    print(f"{out['lives']} lives, {sum(states.values())} messages {dict(states)}, {len(found)} broken promises")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
