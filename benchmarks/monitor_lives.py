"""Many lives of the monitor in a world where things go wrong: ``python benchmarks/monitor_lives.py [--seeds N] [--first S]``.

Prints every broken promise with its seed; ``World(seed)`` of tests/monitor_world.py lives that life again.
"""

from __future__ import annotations

import argparse
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


def lives(job: tuple[Path, range]) -> tuple[list[str], Counter[str]]:
    """What was broken in the lives of these seeds, and how often which state was said."""
    path, seeds = job
    model = load_model(path)
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
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    path = Path(tempfile.mkdtemp()) / "arm.model.json"
    save_model(known_model(horizon=0.1), path)
    last = args.first + args.seeds
    jobs = [(path, range(k, min(k + 50, last))) for k in range(args.first, last, 50)]
    found: list[str] = []
    states: Counter[str] = Counter()
    begin = time.monotonic()
    with multiprocessing.get_context("spawn").Pool() as pool:
        for words, counted in pool.imap_unordered(lives, jobs):
            found += words
            states += counted
            for line in words:
                print(line, flush=True)
    print(
        f"{args.seeds} lives in {time.monotonic() - begin:.0f} s, {sum(states.values())} messages {dict(states)}, {len(found)} broken promises"
    )
    if args.json:
        args.json.write_text(
            json.dumps({"lives": args.seeds, "messages": sum(states.values()), "states": states, "broken": found})
        )
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
