"""A sender whose cycle is not the model's: how often it is believed, where stamps scatter and the sender is held up now and then.

    python benchmarks/monitor_pace.py [--samples 8000] [--seeds 10]

Steps of 4 ms. A stamp is late by the size of a normally distributed number; once a second, in the mean, the sender stands still for up to
twice the time told, and then sends what waited at once. A share of 1 is right for the model's own cycle, of 0 for all others; none is believed
before the first 32 intervals. Beside it, of other seeds, after how many samples one of 4.1 ms is told for good, and how many of those of good
buses, whose clocks are 500 ppm off and which lose none, 3 or 10 % of them, are said to be of another cycle.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from stopset.monitor.pace import Pace

PERIOD, PERIODS, SCATTER, HELD_UP = 0.004, (0.004, 0.0041, 0.0042, 0.005), (0.0, 3e-4, 1e-3, 2e-3), (0.0, 0.03)
AT_ONCE = 1e-4  # [s] between samples that waited
CLOCK, LOST = 5e-4, (0.0, 0.03, 0.1)


def stamps(period: float, scatter: float, held_up: float, samples: int, seed: int = 0) -> np.ndarray:
    """(samples,) [s]"""
    rng, due = np.random.default_rng(seed), np.arange(samples) * period
    late = due + np.abs(rng.normal(0.0, scatter, samples))
    begin = rng.exponential(1.0) if held_up else np.inf
    while begin < due[-1]:
        end = begin + 2.0 * held_up * rng.random()
        waited = (due >= begin) & (late < end)
        late[waited] = end + AT_ONCE * np.arange(waited.sum())
        begin = end + rng.exponential(1.0)
    return np.maximum.accumulate(late)


def said(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(samples,) whether nothing is said against the pace, and whether it is said to be another one."""
    pace, rows = Pace(PERIOD), []
    for x in t.tolist():
        pace.take(x)
        rows.append((not pace.fault, bool(pace.why)))
    good, other = np.array(rows).T
    return good, other


def told_after(samples: int, seeds: int, scatter: float, held_up: float) -> str:
    """Of a sender of 4.1 ms: how many samples until it is told for good, at most, and in the middle."""
    last = [int(np.flatnonzero(~said(stamps(PERIODS[1], scatter, held_up, samples, 1 + k))[1])[-1]) + 1 for k in range(seeds)]
    return (
        f"told for good after {int(np.median(last))} samples, {max(last)} at most"
        if max(last) < samples
        else f"not told in {samples} by all"
    )


def accused(samples: int, seeds: int, scatter: float, held_up: float) -> tuple[int, int]:
    """Samples of good buses that are said to be of another cycle, of how many."""
    count = total = 0
    for k in range(seeds):
        clock = CLOCK if k % 2 else -CLOCK
        t = stamps(PERIOD * (1.0 + clock), scatter, held_up, samples, 1 + k)
        for lost in LOST:
            other = said(t[np.random.default_rng(k).random(samples) >= lost])[1]
            count, total = count + int(other.sum()), total + len(other)
    return count, total


def cost(samples: int) -> str:
    """Of a sample of a bus that loses a tenth of them, so that its mean is no proof."""
    pace, t, took = Pace(PERIOD), stamps(PERIOD, 1e-3, 0.0, samples), []
    for x in t[np.random.default_rng(0).random(samples) >= LOST[-1]].tolist():
        begin = time.thread_time_ns()
        pace.take(x)
        took.append(time.thread_time_ns() - begin)
    middle, seldom = np.quantile(took, (0.5, 0.99)) * 1e-3
    return f"a sample of a bus that loses a tenth of them costs {middle:.0f} us CPU, one in 64 {seldom:.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=8000)
    parser.add_argument("--seeds", type=int, default=10)
    args = parser.parse_args()
    if args.samples < 200:
        parser.error(f"{args.samples} samples; expected at least 200, the pace is found from up to 128 intervals")
    print(cost(args.samples))
    for held_up in HELD_UP:
        for scatter in SCATTER:
            shares = ", ".join(f"{1e3 * p:g} ms {said(stamps(p, scatter, held_up, args.samples))[0].mean():.0%}" for p in PERIODS)
            print(f"scatter {1e3 * scatter:g} ms, held up by {1e3 * held_up:g} ms: believed at cycles of {shares}", flush=True)
            count, total = accused(args.samples, args.seeds, scatter, held_up)
            late = told_after(args.samples, args.seeds, scatter, held_up)
            print(f"  4.1 ms {late}; {count} of {total} samples of good buses accused", flush=True)


if __name__ == "__main__":
    main()
