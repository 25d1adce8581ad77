"""The paper's whole campaign, synthesised, and what it costs to identify a model from it.

2,280 trials in 152 suites of 38 motions, 5 s at 250 Hz, 6 joints (Liu & Althoff 2018, sec. V-B).  Prints wall and processor
time, memory and the cost per recording at a tenth, a third and all of it.  Run: python benchmarks/campaign.py [--trials 2280]
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from stopset.offline.description import load_robot
from stopset.recording import Meta, Recording, write_recordings

RATE, SECONDS = 250.0, 5.0
REPEATS, STARTS = 15, 4


def trials(count: int, joints: int, seed: int = 0, scatter: float = 1.0) -> Iterator[Recording]:
    """Open-loop trials of independent first-order joints with encoder noise and torque disturbances, ``scatter`` times the usual."""
    rng = np.random.default_rng(seed)
    N, dt = int(RATE * SECONDS), 1.0 / RATE
    J = np.array([1.9, 12.0, 1.9, 1.8, 0.55, 0.43])[:joints]
    v = np.array([12.6, 27.0, 9.0, 8.1, 3.5, 4.0])[:joints]
    t = dt * np.arange(N)
    place = 0
    while place < count:
        suite = place // REPEATS
        if suite % STARTS == 0 or place == 0:
            shape = np.random.default_rng(seed + 1 + suite // STARTS)
            amplitude, phase = shape.uniform(0.2, 0.6, joints) * v, shape.uniform(0, 2 * np.pi, joints)
            whole = amplitude * np.sin(2 * np.pi * np.outer(np.arange(2 * N) * dt, shape.uniform(0.1, 0.4, joints)) + phase)
        u = whole[N - (suite % STARTS) * (N // 8) :][:N]
        push = scatter * (
            lfilter([0.02], [1, -0.98], rng.normal(size=(N, joints)), axis=0) * 0.3 * v + rng.normal(size=joints) * 0.02 * v
        )
        decay = np.exp(-v * dt / J)
        drive = (1 - decay) / v * (u + push)
        dq = np.stack([lfilter([1.0], [1.0, -a], np.r_[0.0, d[:-1]]) for a, d in zip(decay, drive.T, strict=True)], axis=1)
        q = np.vstack([np.zeros(joints), np.cumsum(0.5 * dt * (dq[1:] + dq[:-1]), axis=0)])
        noisy_q = np.round((q + rng.normal(0, 2e-5, q.shape)) / 2**-14) * 2**-14
        yield Recording("open_loop", suite, place % REPEATS, place, t, noisy_q, dq + rng.normal(0, 1e-3, dq.shape), u)
        place += 1


def record(path: Path, count: int, seed: int = 0) -> Path:
    """``count`` trials in a file."""
    robot = load_robot("lwa4p")
    meta = Meta(joints=robot.joints, robot="LWA-4P, synthetic", effort="compensated_torque", rate_hz=RATE)
    write_recordings(path, meta, trials(count, robot.n, seed))
    return path


def identify(*words: str | Path) -> tuple[float, float, float]:
    """Wall and processor seconds of `stopset identify` in a process of its own, and the highest peak MiB of any such process so far."""
    start, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "stopset.cli.main", "identify", *map(str, words)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    return time.monotonic() - start, processor, used.ru_maxrss / 1024.0


def retained(folder: Path, old: Path, new: Path, how: str) -> None:
    """What keeping costs, and what an update by the trials in ``new``."""
    state, model = folder / how, folder / f"{how}.json"
    seconds, processor, memory = identify("--robot", "lwa4p", "--data", old, "--out", model, "--keep", state, "--keep-as", how)
    size = state.stat().st_size / 1e6
    print(f"keep {how}: {seconds:.1f} s, {processor:.1f} s of processor time, peak {memory:.0f} MiB")
    print(f"  state {size:.1f} MB (recordings {old.stat().st_size / 1e6:.1f} MB)")
    seconds, processor, memory = identify("--update", model, "--state", state, "--data", new, "--out", folder / "updated.json")
    print(f"  update: {seconds:.1f} s, {processor:.1f} s of processor time, peak {memory:.0f} MiB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=2280)
    parser.add_argument("--kept", dest="retained", action="store_true", help="measure --keep and --update too")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for count in (args.trials // 10, args.trials // 3, args.trials):
            data = record(folder / f"{count}.parquet", count)
            seconds, processor, memory = identify("--robot", "lwa4p", "--data", data, "--out", folder / "m.json")
            print(
                f"{count:6d} trials: {seconds:7.1f} s, {processor:.1f} s of processor time, {1e3 * seconds / count:6.1f} ms per trial, "
                f"peak {memory:6.0f} MiB",
                flush=True,
            )
        if args.retained:
            new = record(folder / "new.parquet", args.trials // 10, seed=7)
            for how in ("sums", "signals"):
                retained(folder, data, new, how)


if __name__ == "__main__":
    main()
