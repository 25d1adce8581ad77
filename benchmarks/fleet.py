"""What one more arm costs whoever looks at a fleet: simulated arms over a real zenoh router on one machine, in processor time.

    python benchmarks/fleet.py [--arms 10,30,100] [--seconds 10]

Each arm is a zenoh session of its own with a liveliness token; it sends the binary message `state` every 10 ms and its words five times a
second, as a monitor does. Measured are the overview (`stopset fleet`), the router, and how long a killed group takes to go grey.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing as mp
import time
from typing import Any

from stopset.monitor.fleet import Fleet
from stopset.monitor.layout import State
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.monitor.packer import Packer

JOINTS = tuple(f"arm_{k}_joint" for k in range(1, 7))
GROUP = 25  # arms per process
RATE = 0.01  # [s] between two binary messages
WORDS = {
    "state": "OK", "why": "inside every prediction", "data_id": 1, "joints": list(JOINTS), "violations": [], "gaps": 0,
    "room": dict.fromkeys(JOINTS, 0.5), "verdicts": {"CONFORMANT": 3}, "oldest_prediction_s": 0.4, "notice": "not a safety function",
    "stops": {c: {"time_s": 0.1, "tcp_m": 0.02, "why": "", "joints": {
        j: {"time_s": 0.1, "forward_rad": 0.01, "back_rad": 0.0} for j in JOINTS}} for c in ("0", "1", "1 guaranteed")},
}  # fmt: skip


def arms(port: int, first: int, count: int, ready: Any, state: State = State.OK, why: str = WORDS["why"]) -> None:
    """``count`` arms in one process, all in one state."""
    links = [
        ZenohLink(f"hall/cell{k}/arm/stopset", mode="client", connect=[f"tcp/127.0.0.1:{port}"])
        for k in range(first, first + count)
    ]
    for link in links:
        link.alive("alive")
    send = [link.fast("state") for link in links]
    stops = (
        {}
        if state == State.OK
        else {"stops": {c: {"time_s": None, "tcp_m": None, "why": why, "joints": {}} for c in WORDS["stops"]}}
    )
    text, seq = json.dumps(WORDS | {"state": state.name, "why": why} | stops), 0
    ready.set()
    while True:
        begin = time.monotonic()
        now = time.time_ns()
        data = Packer().pack(
            {
                "data_id": 1,
                "boot_id": 3,
                "state": int(state),
                "valid_for_ms": 100,
                "seq": seq,
                "t_meas_ns": now,
                "t_pub_ns": now,
            }
        )
        for put in send:
            put(data)
        if seq % round(0.2 / RATE) == 0:
            for link in links:
                link.put("state/json", text)
        seq += 1
        time.sleep(max(0.0, RATE - (time.monotonic() - begin)))


def router(port: int, used: Any) -> None:
    """A router; tells its processor time."""
    _link = ZenohLink(mode="router", listen=[f"tcp/127.0.0.1:{port}"])
    while True:
        used.value = time.process_time()
        time.sleep(0.05)


def measured(count: int, seconds: float, port: int) -> dict[str, float]:
    """Processor seconds per second of overview and router with so many arms, and the delay until a killed group is grey."""
    context = mp.get_context("spawn")
    used = context.Value("d", 0.0)
    processes = [context.Process(target=router, args=(port, used), daemon=True)]
    processes[0].start()
    time.sleep(1.5)
    for first in range(0, count, GROUP):
        ready = context.Event()
        p = context.Process(target=arms, args=(port, first, min(GROUP, count - first), ready), daemon=True)
        p.start()
        processes.append(p)
        ready.wait(60)
    fleet, link = Fleet(), ZenohLink(mode="client", connect=[f"tcp/127.0.0.1:{port}"])
    try:
        link.watch_alive("*/*/*/stopset/alive", fleet.take_alive)
        link.subscribe("*/*/*/stopset/state/json", fleet.take_json)
        time.sleep(2.0)
        own, there, begin = time.process_time(), used.value, time.monotonic()
        while time.monotonic() - begin < seconds:
            fleet.snapshot()
            time.sleep(0.2)
        took = time.monotonic() - begin
        own, there = time.process_time() - own, used.value - there
        ok = sum(r["word"] == "OK" for r in fleet.rows())
        processes[-1].kill()
        killed, gone = time.monotonic(), count % GROUP or GROUP
        while sum(r["word"] == "NO DATA" for r in fleet.rows()) < gone and time.monotonic() - killed < 10:
            time.sleep(0.01)
        return {"arms": count, "ok": ok, "overview": own / took, "router": there / took, "grey_s": time.monotonic() - killed}
    finally:
        link.close()
        for p in processes:
            p.kill()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", default="10,30,100")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--port", type=int, default=17555)
    args = parser.parse_args()
    for k, count in enumerate(int(n) for n in args.arms.split(",")):
        m = measured(count, args.seconds, args.port + k)
        share = {who: f"{100 * m[who]:5.1f} % of a core ({1e3 * m[who] / count:.2f} ms an arm)" for who in ("overview", "router")}
        print(f"{count:4d} arms, {m['ok']:.0f} seen OK: overview {share['overview']}, router {share['router']};", end=" ")
        print(f"a killed group grey after {m['grey_s']:.2f} s")


if __name__ == "__main__":
    main()
