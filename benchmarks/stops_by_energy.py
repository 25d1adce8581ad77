"""Are the states that the kinetic energy bounds a fall-back nobody can use? Bound over worst sampled, of these states alone.

    python benchmarks/stops_by_energy.py [--states 8] [--arms WORD ...] [--json FILE]

The cases and states of `stops_soundness.py`; of each case the first states. Where the energy's tube is the answer, its angle and its
tool's way over the worst of 200 sampled stops (half bred from the farthest), and beside it what joint speeds alone, without the energy,
give in at most 64 pieces, where they close. One line per case that has such states, the last of all. Exit code 1: a stop escaped.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from stops_soundness import Case, cases

from stop_sampling import sample_stops, tool_travel
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import tubes_of
from stopset.types import Array

PIECES, STOPS, SHARE = 64, 200, 0.2  # joints faster than this share of full speed are compared


class Compared(NamedTuple):
    """Of one state: angles and tool's way over the worst sampled, by the energy and by joint speeds (empty where they do not close)."""

    angle: list[float]
    tcp: list[float]
    alone: list[float]
    tcp_alone: list[float]
    escapes: int


def far(tubes: list[Tube]) -> Array:
    """(n,) [rad]."""
    return np.max([np.maximum(t.d_hi.max(axis=0), -t.d_lo.min(axis=0)) for t in tubes], axis=0)


def one_state(name: str, case: Case, state: int) -> Compared | None:
    """None where joint speeds are the answer."""
    rng, n = np.random.default_rng([zlib.crc32(name.encode()), state]), case.model.n
    s = case.setting(rng)
    q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * case.top
    start = Start(q, dq, s.noise.radius[:n], s.noise.radius[n:])
    tube = tubes_of(s, start, 1)[-1]
    if tube.end != OK or not tube.energetic:
        return None

    def tool(tubes: list[Tube]) -> float:
        return max(tool_travel(s, q, start.q_radius, t) for t in tubes)

    x = sample_stops(s.plant, q, dq, start.q_radius, start.dq_radius, s.payload_com, tube, STOPS // 2, state, STOPS // 2)
    worst, fast = np.maximum(np.maximum(x.forward, x.back), 1e-9), np.abs(dq) > SHARE * case.top
    own = tool([tube])
    alone = tubes_of(s, start, PIECES, last_resort=False)
    closed = alone[-1].end == OK
    return Compared(
        (far([tube]) / worst)[fast].tolist(), [own / x.tcp], (far(alone) / worst)[fast].tolist() if closed else [],
        [tool(alone) / x.tcp] if closed else [], x.escaped + int(x.tcp > own),
    )  # fmt: skip


def told(states: int, found: list[Compared]) -> dict[str, Any]:
    """Medians and 95 % points; of the states that joint speeds close too, both side by side."""
    both = [x for x in found if x.tcp_alone]

    def points(rows: list[Compared], key: str) -> list[float]:
        values = [v for x in rows for v in getattr(x, key)]
        return [round(float(p), 2) for p in np.percentile(values, [50, 95])] if values else []

    of_all = {"states": states, "by the energy": len(found), "escapes": sum(x.escapes for x in found)}
    shown = {key: points(found, key) for key in ("angle", "tcp")}
    beside = {f"{key}, there": points(both, key) for key in ("angle", "tcp", "alone", "tcp_alone")}
    return of_all | shown | {"joint speeds in 64 pieces close": len(both)} | beside


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=int, default=8, help="of each case")
    parser.add_argument("--arms", nargs="*", default=[""])
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    wanted = cases(args.arms)
    if args.states < 1 or not wanted:
        parser.error(
            f"{args.states} states of {len(wanted)} cases; expected at least one of each: give --states and words of names of arms"
        )
    every: list[Compared] = []
    count, shown = 0, {}
    for name, case in wanted.items():
        found = [x for k in range(args.states) if (x := one_state(name, case, k + 1)) is not None]
        every, count = every + found, count + args.states
        if found:
            shown[name] = told(args.states, found)
            print(f"{name}: {shown[name]}", flush=True)
    shown["all"] = told(count, every)
    print(f"all: {shown['all']}")
    if args.json:
        args.json.write_text(json.dumps(shown, indent=1) + "\n")
    return 1 if sum(x.escapes for x in every) else 0


if __name__ == "__main__":
    sys.exit(main())
