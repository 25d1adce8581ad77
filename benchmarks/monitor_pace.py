"""A sender whose cycle is not the model's: how often it is believed, where stamps scatter and the sender is held up now and then.

    python benchmarks/monitor_pace.py [--samples 8000]

Steps of 4 ms. A stamp is late by the size of a normally distributed number; once a second, in the mean, the sender stands still for up to
twice the time told, and then sends what waited at once. A share of 1 is right for the model's own cycle, of 0 for all others.
"""

from __future__ import annotations

import argparse

import numpy as np

from stopset.monitor.pace import Pace

PERIOD, PERIODS, SCATTER, HELD_UP = 0.004, (0.004, 0.0041, 0.0042, 0.005), (0.0, 3e-4, 1e-3, 2e-3), (0.0, 0.03)
AT_ONCE = 1e-4  # [s] between samples that waited


def stamps(period: float, scatter: float, held_up: float, samples: int) -> np.ndarray:
    """(samples,) [s]"""
    rng, due = np.random.default_rng(0), np.arange(samples) * period
    late = due + np.abs(rng.normal(0.0, scatter, samples))
    begin = rng.exponential(1.0) if held_up else np.inf
    while begin < due[-1]:
        end = begin + 2.0 * held_up * rng.random()
        waited = (due >= begin) & (late < end)
        late[waited] = end + AT_ONCE * np.arange(waited.sum())
        begin = end + rng.exponential(1.0)
    return np.maximum.accumulate(late)


def believed(t: np.ndarray) -> float:
    """Share of the samples at which nothing is said against the pace."""
    pace, good = Pace(PERIOD), 0
    for x in t.tolist():
        pace.take(x)
        good += not pace.fault
    return good / len(t)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=8000)
    args = parser.parse_args()
    if args.samples < 200:
        parser.error(f"{args.samples} samples; expected at least 200, the pace is found from up to 128 intervals")
    for held_up in HELD_UP:
        for scatter in SCATTER:
            shares = ", ".join(f"{1e3 * p:g} ms {believed(stamps(p, scatter, held_up, args.samples)):.0%}" for p in PERIODS)
            print(f"scatter {1e3 * scatter:g} ms, held up by {1e3 * held_up:g} ms: believed at cycles of {shares}", flush=True)


if __name__ == "__main__":
    main()
