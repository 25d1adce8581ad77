"""Ten thousand arms by simulation: what an overview of all of them costs, and what flows where, from the real messages' sizes.

    python benchmarks/fleet_large.py [--arms 10000] [--halls 100]

The overview is `stopset fleet`'s own code, fed with every arm's words as a hall's router lets them up; time is simulated, processor time
and memory are measured.
"""

from __future__ import annotations

import argparse
import json
import resource
import time

from fleet import WORDS

from stopset.monitor.fleet import Fleet
from stopset.monitor.layout import LENGTH

CYCLES, WORDS_HZ, UP_HZ, LOOKS = (
    250.0,
    5.0,
    2.0,
    5.0,
)  # a second: messages of a daemon, its words, those that go up, looks at the page


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=10_000)
    parser.add_argument("--halls", type=int, default=100)
    parser.add_argument("--seconds", type=int, default=5)
    args = parser.parse_args()
    now = [0.0]
    fleet, text = Fleet(lambda: now[0]), json.dumps(WORDS).encode()
    keys = [f"hall{k % args.halls}/cell{k // args.halls}/arm/stopset/state/json" for k in range(args.arms)]
    for key in keys:
        fleet.take_alive(key, there=True)
    taken = shown = 0.0
    for _ in range(round(args.seconds * UP_HZ)):
        begin = time.process_time()
        for key in keys:
            fleet.take_json(key, text)
        taken += time.process_time() - begin
        now[0] += 1.0 / UP_HZ
    for _ in range(10):
        begin = time.process_time()
        shot = fleet.snapshot()
        shown += time.process_time() - begin
    assert shot["arms"] == args.arms and shot["counts"] == {"OK": args.arms}
    each = taken / (args.arms * args.seconds * UP_HZ)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{args.arms} arms: {each * 1e6:.1f} us a message, {shown / 10 * 1e3:.0f} ms a look, {peak:.0f} MiB in all")
    print(
        f"overview of the site: {each * UP_HZ * args.arms + shown / 10 * LOOKS:.2f} of a core at {UP_HZ:g} words a second and {LOOKS:g} looks"
    )
    per_hall = args.arms / args.halls
    print("what flows, one way, without zenoh's own bytes:")
    for where, arms, rate, size in (
        ("daemon -> hall, every cycle", 1.0, CYCLES, LENGTH), ("hall, every cycle", per_hall, CYCLES, LENGTH),
        ("hall, words", per_hall, WORDS_HZ, len(text)), ("hall -> site, words", per_hall, UP_HZ, len(text)),
        ("site, words of all", args.arms, UP_HZ, len(text)),
    ):  # fmt: skip
        print(f"  {where:<30} {arms * rate:9.0f} messages/s {arms * rate * size / 1e6:8.2f} MB/s")


if __name__ == "__main__":
    main()
