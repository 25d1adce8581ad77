"""What a cycle of the monitor takes from memory's allocators: ``python benchmarks/monitor_allocations.py [--json FILE]``.

A library that counts is put before the system's (needs a C compiler, ``cc``), and the loop of `monitor` runs twice: as it is, which counts
what Python's own allocator does not serve from its pools; and with those pools off, which counts every object. Net growth is that of
Python's blocks over 10,000 cycles. Nothing is collected meanwhile.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import os
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import monitor
import numpy as np

from allocation_counter import COUNTER

CYCLES, WARM = 14_000, 4_000


class Counted:
    """A call whose allocations are summed."""

    def __init__(self, call: object) -> None:
        self.call, self.taken = call, 0

    def __call__(self, *args: object) -> object:
        before = allocations()
        found = self.call(*args)  # type: ignore[operator]
        self.taken += allocations() - before
        return found


@cache
def library() -> ctypes.CDLL:
    """This process, the counter in it."""
    return ctypes.CDLL(None)


def allocations() -> int:
    """Calls of the system's allocator by this thread so far."""
    return int(library().allocations_of_this_thread())


def loop() -> dict[str, float]:
    """Per cycle: most and median number of calls, those of the authentication code, and growth of Python's blocks."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "torque.model.json"
        model = monitor.save_model(monitor.torque_input(), path)
        monitor.CYCLES = CYCLES
        daemon, bus, clock = monitor.prepared(model, path, monitor.motion(0, 1500))
        signer = Counted(monitor.KEY.code)
        daemon.publisher._packer.key = monitor.SimpleNamespace(key_id=1, code=signer)
        taken = np.zeros(CYCLES, int)
        gc.collect()
        gc.disable()
        for k, frames in enumerate(bus.cycles):
            if k == WARM:
                blocks, signer.taken = sys.getallocatedblocks(), 0
            bus.ready = frames
            clock.now += daemon.cycle_s
            before = allocations()
            daemon.cycle()
            taken[k] = allocations() - before
        grown = sys.getallocatedblocks() - blocks
        idle = -allocations() + allocations()  # of the look itself, of which a cycle has two in it for the code
    warm = taken[WARM:] - 3 * idle
    return {
        "median": float(np.median(warm)), "most": int(warm.max()), "grown_blocks": grown,
        "code": signer.taken / len(warm) - idle, "cycles": len(warm),
    }  # fmt: skip


def counted(counter: Path, allocator: str) -> dict[str, float]:
    """`loop` in a process of its own, before whose allocator the counting one is."""
    env = {**os.environ, "LD_PRELOAD": str(counter), "PYTHONMALLOC": allocator}
    answer = subprocess.run([sys.executable, __file__, "--counted"], env=env, capture_output=True, text=True, check=True)
    found: dict[str, float] = json.loads(answer.stdout.splitlines()[-1])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--counted", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.counted:
        print(json.dumps(loop()))
        return
    if (compiler := shutil.which("cc")) is None:
        print("allocations of a cycle: not counted, there is no C compiler here")
        return
    with tempfile.TemporaryDirectory() as folder:
        source, counter = Path(folder) / "counter.c", Path(folder) / "counter.so"
        source.write_text(COUNTER)
        subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-ftls-model=initial-exec", "-o", counter, source], check=True)
        system, every = counted(counter, "pymalloc"), counted(counter, "malloc")
    print(f"allocations of a cycle, over {system['cycles']:.0f}: {system['median']:.0f} calls of the system's allocator (at most "
          f"{system['most']:.0f}), {system['code']:.0f} of them for the authentication code; {every['median']:.0f} with Python's pools off; "
          f"{system['grown_blocks']:.0f} blocks more in use after them than before")  # fmt: skip
    if args.json:
        args.json.write_text(json.dumps({"system": system, "every_object": every}))


if __name__ == "__main__":
    main()
