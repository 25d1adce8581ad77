"""Does who knows more get no worse a stop bound? In the monitor's steps, nested ranges of payloads, and what the nearer of two proofs gains.

    python benchmarks/stops_known.py [--states 30] [--arms WORD ...]

States of the arms of `stop_arms_wide.py`, every second one a box of +-0.01 rad and +-0.05 rad/s. Prints of each step from a range to a narrower
one in it (all payloads, the upper tenth, 2 %, one mass): medians and largest of the narrower bound's angle, time and tool's way over the wider
one's, how many are larger by more than a thousandth, and the processor time over it. Then of bounds in which bands of speeds have fed on each
other: the nearer proof's numbers over those of joint speeds alone, and the processor time of all bounds with it over without.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from stop_arms_wide import arms

from stopset.reach.stops import StopBound, StopBounds, tubes
from stopset.reach.stops.tube import Plant, Tube
from stopset.types import Array

RANGES = {"any payload": (0.0, 1.0), "the upper tenth": (0.9, 1.0), "2 %": (0.98, 1.0), "one mass": (0.99, 0.99)}
WORSE = 1.001


def numbers(b: StopBound) -> Array:
    """Largest angle [rad], time [s], the tool's way [m]; not a number where there is none."""
    if b.angle is None or b.time is None or b.tcp is None:
        return np.full(3, np.nan)
    return np.array([b.angle.max(), b.time.max(), b.tcp])


def timed(bounds: StopBounds, q: Array, dq: Array, radii: Array) -> tuple[Array, float]:
    """Numbers of a STOP 0, and its processor time [s]."""
    begin = time.thread_time()
    b = bounds.bound(q, dq, "0", *radii)
    return numbers(b), time.thread_time() - begin


def speeds_alone(_march: tubes.March, _plant: Plant, tube: Tube) -> Tube:
    """In place of `stopset.reach.stops.split.nearer`."""
    return tube


def said(ratios: Array) -> str:
    """Of each column: median, largest, how many are worse."""
    known = ratios[np.isfinite(ratios).all(axis=1)]
    columns = zip(np.median(known, axis=0), known.max(axis=0), (known > WORSE).mean(axis=0), strict=True)
    return "; ".join(f"{a:.2f}, {b:.2f} ({c:.1%})" for a, b, c in columns)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=int, default=30)
    parser.add_argument("--arms", nargs="*", default=[""], help="only arms with one of these words in their name")
    args = parser.parse_args()
    asked = {k: v for k, v in arms().items() if any(word in k for word in args.arms)}
    if args.states < 1 or not asked:
        parser.error(f"{args.states} states of {len(asked)} arms; expected at least one of each: arms are {', '.join(arms())}")
    found, spent, gained, cost = [], [], [], np.zeros(2)
    nearer = tubes.nearer
    for model, top in asked.values():
        rated, n, rng = model.domain.payload[1], model.n, np.random.default_rng(7)
        every = [StopBounds.of(model, (lo * rated, hi * rated), fast=True) for lo, hi in RANGES.values()]
        for k in range(args.states):
            q = np.clip(rng.uniform(-np.pi, np.pi, n), *(0.98 * model.robot.q_limit.T))
            dq, radii = rng.uniform(-1.0, 1.0, n) * top, np.array([np.full(n, 0.01), np.full(n, 0.05)]) * (k % 2)
            row = [timed(b, q, dq, radii) for b in every]
            tubes.nearer = speeds_alone
            plain = [timed(b, q, dq, radii) for b in every]
            tubes.nearer = nearer
            found.append([x for x, _ in row])
            spent.append([t for _, t in row])
            cost += np.sum([t for _, t in row]), np.sum([t for _, t in plain])
            gained += [a / b for (a, _), (b, _) in zip(row, plain, strict=True) if not np.array_equal(a, b, equal_nan=True)]
    numbers_, times, names = np.array(found), np.sum(spent, axis=0), list(RANGES)
    for k in range(1, len(names)):
        print(
            f"{names[k]} over {names[k - 1]}, {len(found)} states: {said(numbers_[:, k] / numbers_[:, k - 1])}; {times[k] / times[k - 1]:.2f}"
        )
    which = f"the nearer proof over joint speeds alone, {len(gained)} of {len(found) * len(names)} bounds"
    print(f"{which}: {said(np.array(gained))}; {cost[0] / cost[1]:.2f}")


if __name__ == "__main__":
    main()
