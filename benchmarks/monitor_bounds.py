"""What stop bounds beside the loop cost, and how much of the time they hold, while an arm moves:
``python benchmarks/monitor_bounds.py MODEL [RECORDING] [--rounds 3] [--seconds 30] [--payload KG [KG]] [--share 0.1]
[--categories 0 1] [--alone [--price MS]] [--arms 12]``.

``./run demo --out FOLDER`` leaves a model and recordings; the model "ur10e" is the UR10e-like arm of stop_arms_wide.py, its payload
0 to 12.5 kg where none is declared. Without a recording the arm goes from one random pose to the next and comes by no state twice in
a round. Per round: processor time of the bounding process as a part of a core, states with a certified bound of every category, and
the median flange travel of STOP 0, a state without a bound taken as infinite.

It runs in real time, so other work on the machine counts against it; ``--alone``: an answer comes when a core of its own would have
given it, by the processor time that its proof took.  That is more on a busy machine (caches and cores are shared), and what a share of a core
buys is less: so boxes reach farther ahead and say less. ``--price``: every proof costs as much, whatever it took: then the figures are those of the
code and the same on any machine, and two prices tell what load does.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from stop_arms_wide import ur10e_like

from stopset.artifact import Model, load_model, save_model
from stopset.monitor.certificates import Certificate
from stopset.monitor.config import Stops
from stopset.monitor.sample import Quantum
from stopset.monitor.stopdesk import StopDesk, seen_by
from stopset.monitor.stopworker import answer_for, prepare
from stopset.reach.stops import StopBounds
from stopset.recording import read_recordings
from stopset.types import Array

REACH, TOP = 0.8, 0.6  # of the angles and speeds identification has seen
SHORTEST = 0.4  # [s] a motion takes
FIRST_SEED = 3  # of the motions


class Standing:
    """A clock that stands until it is set."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now

    def time_ns(self) -> int:
        return round(self.now * 1e9)

    def sleep(self, _: float) -> None:
        """Nobody sleeps."""


class Alone(StopDesk):
    """The desk with the proofs in this process: an answer comes when it would have come from a core of its own."""

    prepared: StopBounds
    fixed: float | None = None  # [s] that every proof costs

    def _start(self) -> None:
        self._ready, self._pipe, self.free, self.due = True, self, 0.0, deque()  # type: ignore[assignment]

    def price(self, answer: Certificate) -> float:
        """[s] of processor time."""
        return answer.cpu if self.fixed is None else self.fixed

    def send(self, request: Any) -> None:
        """As the pipe's."""
        if request is None:
            return
        answer = answer_for(self.prepared, *request)
        now, cost = self.clock.monotonic(), self.price(answer)
        self.free = max(self.free, now) + cost
        self.due.append((self.free, replace(answer, cpu=cost, took=self.free - now)))

    def arrive(self) -> None:
        """Take in what is due by now."""
        while self.due and self.due[0][0] <= self.clock.monotonic():
            self._inbox.append(self.due.popleft()[1])


def cpu_of(pid: int) -> float:
    """[s] user and system time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def never_twice(model: Model, seconds: float, seed: int) -> tuple[Array, Array]:
    """Angles and speeds (N, n) of fifth-order motions between random poses, one after another."""
    rng, seen, n, dt = np.random.default_rng(seed), seen_by(model), model.n, model.powered.dt
    lo, hi = np.maximum(seen.lo[:n], -np.pi), np.minimum(seen.hi[:n], np.pi)
    middle, half = 0.5 * (lo + hi), 0.5 * REACH * (hi - lo)
    top = TOP * np.minimum(-seen.lo[n:], seen.hi[n:])
    at, q, dq = middle, [middle[None]], [np.zeros((1, n))]
    while sum(len(x) for x in q) * dt < seconds:
        displacement = middle + half * rng.uniform(-1.0, 1.0, n) - at
        takes = max(SHORTEST, float(np.max(1.875 * np.abs(displacement) / top)))
        z = np.arange(dt, takes, dt)[:, None] / takes
        q.append(at + displacement * (10 * z**3 - 15 * z**4 + 6 * z**5))
        dq.append(displacement * (30 * z**2 - 60 * z**3 + 30 * z**4) / takes)
        at = at + displacement
    return np.concatenate(q)[: round(seconds / dt)], np.concatenate(dq)[: round(seconds / dt)]


def made(args: argparse.Namespace, path: str, model: Model) -> tuple[StopDesk, Any]:
    """The desk, and what gives the processor time that its proofs have taken so far [s]."""
    payload = None if args.payload is None else (args.payload[0], args.payload[-1])
    stops = Stops(tuple(args.categories), ramp_time_s=0.35, ramp_off_after_s=0.5, core_share=args.share)
    if args.alone:
        desk = Alone(path, seen_by(model), stops, payload, Quantum.none(model.n), clock=Standing())
        prepared, why = prepare(path, payload, stops)
        if prepared is None:
            raise SystemExit(why)
        desk.prepared, desk.fixed = prepared, None if args.price is None else 1e-3 * args.price
        return desk, lambda: desk.budget.total
    beside = StopDesk(path, seen_by(model), stops, payload, Quantum.none(model.n))
    while not beside._ready:
        beside.offer(0.0, np.zeros(model.n), np.zeros(model.n))
        time.sleep(0.01)
    return beside, lambda: cpu_of(beside._process.pid)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("recording", type=Path, nargs="?")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=30.0, help="of a round without a recording")
    parser.add_argument(
        "--payload", type=float, nargs="+", metavar="KG", help="declared: a mass, or least and most; 0 = surely nothing"
    )
    parser.add_argument("--share", type=float, default=Stops().core_share)
    parser.add_argument("--categories", nargs="+", default=["0", "1"], choices=["0", "1", "2"])
    parser.add_argument("--alone", action="store_true", help="on a core of its own, by the proofs' processor time")
    parser.add_argument("--price", type=float, metavar="MS", help="with --alone: of a proof, whatever it took")
    parser.add_argument(
        "--arms", type=int, default=1, help="so many, one after another, each with motions and certificates of its own"
    )
    args = parser.parse_args()
    if args.price is not None and not (args.alone and args.price > 0.0):
        parser.error(
            f"a price of {args.price:g} ms; expected more than none, and --alone: in real time proofs cost what they cost"
        )
    path = args.model
    if path == "ur10e":
        path = f"{tempfile.mkdtemp()}/ur10e.model.json"
        save_model(ur10e_like(), path)
    model = load_model(path)
    arms = [watched(args, path, model, FIRST_SEED + k) for k in range(args.arms)]
    for turn in range(args.rounds if args.arms > 1 else 0):
        shares, held = zip(*(rounds[turn] for rounds in arms), strict=True)
        print(f"round {turn + 1}, {args.arms} arms, each with motions of its own: {100 * np.mean(shares):.1f} % of a core an arm, "
              f"{100 * min(shares):.1f} to {100 * max(shares):.1f}; bounds for {100 * min(held):.1f} % of the states at least")  # fmt: skip


def watched(args: argparse.Namespace, path: str, model: Model, seed: int) -> list[tuple[float, float]]:
    """Of every round of one arm: part of a core, part of the states with a bound."""
    if args.recording:
        trials = list(read_recordings(args.recording))
        q, dq = np.concatenate([r.q for r in trials]), np.concatenate([r.dq for r in trials])
    else:
        q, dq = never_twice(model, args.seconds, seed)
    dt, (desk, spent) = model.powered.dt, made(args, path, model)
    found = []
    try:
        begin, k = time.monotonic(), 0
        for turn in range(args.rounds):
            before, held, travel = spent(), 0, {c: [] for c in desk.categories}
            for i in range(len(q)):
                if isinstance(desk, Alone):
                    desk.clock.now = k * dt  # type: ignore[attr-defined]
                    desk.arrive()
                else:
                    time.sleep(max(0.0, begin + k * dt - time.monotonic()))
                desk.offer(k * dt, q[i], dq[i])
                numbers, fresh = desk.now(q[i], dq[i])
                held += fresh and all(x.proven for x in numbers.values())
                for c, x in numbers.items():
                    travel[c].append(x.tcp)
                k += 1
            share = (spent() - before) / (len(q) * dt)
            medians = ", ".join(f"STOP {c} {1e3 * np.median(x):.0f} mm" for c, x in travel.items())
            print(f"round {turn + 1}: {100 * share:.1f} % of a core, bounds for {100 * held / len(q):.1f} % of the states, "
                  f"median at the flange {medians}", flush=True)  # fmt: skip
            found.append((share, held / len(q)))
    finally:
        desk.close()
    return found


if __name__ == "__main__":
    main()
