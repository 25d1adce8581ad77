"""Two builds of the core beside each other: what a change makes of STOP 0 bounds and of their processor time, state by state.

    python benchmarks/stops_beside.py LIBRARY [--states 16] [--arms WORD ...] [--least 0.98]

LIBRARY: the core before, a copy of its file. Measured states and boxes of +-0.01 rad and +-0.05 rad/s in turn, of the arms of
`stop_arms_wide.py`, loads from `--least` of the rated one to all of it. Both answer the same question one after the other, each in a
process of its own, in changing order. Prints of each arm the processor time of this core over that of the other, and the ratios of the
largest angle, the largest time, the tool's way and its speed: median, least, largest.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from stop_arms_wide import arms

from stopset.reach.stops import StopBounds
from stopset.reach.stops.compiled import CompiledStops
from stopset.types import Array

BOX = 0.01, 0.05  # [rad], [rad/s]


def answer(least: float) -> None:
    """One bound for each line of the standard input: how long it took [ms] and its numbers, nothing where there are none."""
    cores: dict[str, CompiledStops] = {}
    for line in sys.stdin:
        name, q, dq, boxed = json.loads(line)
        if name not in cores:
            model = arms()[name][0]
            rated = model.domain.payload[1]
            setting = StopBounds.of(model, (least * rated, rated)).setting
            assert setting is not None
            cores[name] = CompiledStops.of(setting)
        radii = [np.full(len(q), x) for x in BOX] if boxed else [None, None]
        begin = time.thread_time_ns()
        found = cores[name].bound(np.array(q), np.array(dq), "0", *radii)
        took = (time.thread_time_ns() - begin) / 1e6
        said = None if found is None else [max(found.forward.max(), found.back.max()), found.time.max(), *found.tool]
        sys.stdout.write(json.dumps([took, said]) + "\n")
        sys.stdout.flush()


class Asked:
    """A process that answers with one build of the core, this one's where none is named."""

    def __init__(self, library: Path | None, least: float) -> None:
        where = {**os.environ, **({} if library is None else {"STOPSET_CORE": str(library.resolve())})}
        command = [sys.executable, __file__, "--answer", "--least", str(least)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=where)

    def bound(self, question: str) -> tuple[float, list[float] | None]:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(question + "\n")
        self.process.stdin.flush()
        took, said = json.loads(self.process.stdout.readline())
        return took, said


def spread(ratios: Array) -> str:
    return "; ".join(f"{np.median(x):.3f}, {x.min():.2f}, {x.max():.2f}" for x in ratios.T)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("library", type=Path, nargs="?")
    parser.add_argument("--states", type=int, default=16)
    parser.add_argument("--arms", nargs="*", default=[""], help="only arms with one of these words in their name")
    parser.add_argument("--least", type=float, default=0.98, help="least load, of the rated one")
    parser.add_argument("--answer", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.answer:
        answer(args.least)
        return
    asked = [k for k in arms() if any(word in k for word in args.arms)]
    if args.library is None or not args.library.is_file() or args.states < 1 or not asked:
        parser.error(
            f"{args.library}, {args.states} states of {len(asked)} arms; expected a library of the core and at least one of each"
        )
    pair, every = [Asked(None, args.least), Asked(args.library, args.least)], []
    print(
        "over the library before: processor time; angle; time; tool's way; its speed: median, least, largest; bounds that one of both lacks"
    )
    for name in asked:
        model, top = arms()[name]
        rng, took, ratios, lacks = np.random.default_rng(5), np.zeros(2), [], 0
        for k in range(args.states):
            q, dq = rng.uniform(-np.pi, np.pi, model.n), rng.uniform(-1.0, 1.0, model.n) * top
            question = json.dumps([name, q.tolist(), dq.tolist(), k % 2])
            found: list[list[float] | None] = [None, None]
            for which in (0, 1) if k % 4 < 2 else (1, 0):
                ms, found[which] = pair[which].bound(question)
                took[which] += ms if k else 0.0  # the first prepares the arm
            lacks += found.count(None) == 1
            if found[0] and found[1]:
                ratios.append(np.array(found[0]) / np.array(found[1]))
        every += ratios
        print(f"  {name}: {took[0] / took[1]:.2f}; {spread(np.array(ratios))}; {lacks}", flush=True)
    print(f"  all, {len(every)}: {spread(np.array(every))}")
    for x in pair:
        assert x.process.stdin is not None
        x.process.stdin.close()
        x.process.wait()


if __name__ == "__main__":
    main()
