"""What one cycle of the monitor costs, part by part, and how late it publishes when fed over a bus by another process.

``python benchmarks/monitor.py [MODEL RECORDING] [--json FILE] [--before FILE] [--no-live] [--horizon S]``; without arguments an arm with torque
input, friction, gravity and 650 ages is used, alone and as twelve arms in one thread. ``--before``: the JSON of another commit, to
which every part is set in ratio. ``--json`` writes ``{"cycle_cpu_us": {"median", "p99"}, "wall_us": {"p999"}, "parts_us"}``:
thread CPU from the frames of a cycle in memory to packed bytes, laws evaluated, stop box tested. It is taken first in line (FIFO), as
the daemon runs with ``priority``, where that is allowed, and once more among all others: a processor that was given to somebody
else in between has forgotten code and data, and the same cycle takes several times as long.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import os
import resource
import select
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from can.interfaces.socketcan.socketcan import capture_message

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from monitor_arm import known_model, meta, motion
from monitor_process import Ear, free_port, running, stopset, write_config
from stopset.artifact import Model, load_model, save_model
from stopset.core.library import ffi
from stopset.effects import Fitted
from stopset.monitor.authentication import Key
from stopset.monitor.certificates import Certificate, Numbers
from stopset.monitor.config import Bus, Config, Publish
from stopset.monitor.daemon import Beside, Daemon
from stopset.monitor.evidence.overheard import Overheard
from stopset.monitor.evidence.recorder import Recorder
from stopset.monitor.layout import unpack
from stopset.monitor.links.batch import Batch, Frame
from stopset.monitor.links.canopen_map import Encoder
from stopset.monitor.links.socketcan import FRAME, SocketCanListener, usable
from stopset.monitor.profile import load_profile
from stopset.monitor.realtime import claim
from stopset.monitor.replay import signal_rows
from stopset.monitor.source import CanSource
from stopset.monitor.stopdesk import StopDesk, seen_by
from stopset.recording import Recording, read_recordings, write_recordings
from stopset.sets import Box

CYCLES = 4000
HORIZON = 2.6  # [s]
ARM_TICKS = 2000
MOST_FRAMES = 32  # of a cycle
DRIVES_FRAMES = 13  # SYNC and two of each drive
PRIORITY = 10
SWEPT, SWEPT_EVERY = 64 << 20, 10  # bytes, more than the largest cache here; cycles
KEY = Key(1, bytes(32))


class Clock:
    """Each sample has just come."""

    def __init__(self) -> None:
        self.now = 1_700_000_000.0

    def monotonic(self) -> float:
        return self.now

    def time_ns(self) -> int:
        return round(self.now * 1e9)

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Frames:
    """A bus whose frames are in memory, as a socket would give them: all of a cycle at once."""

    def __init__(self, trial: Recording, clock: Clock, cycles: int) -> None:
        p = load_profile("lwa4p/monitor")
        encoder, rows, dt = Encoder(p), signal_rows(trial), p.cycle_s
        self.ready: Batch | None = None
        back_and_forth = np.abs((np.arange(cycles) + len(rows) - 1) % (2 * len(rows) - 2) - (len(rows) - 1))
        self.cycles = []
        for k, i in enumerate(back_and_forth):
            self.cycles.append(Batch(ffi.new("StopsetFrame[]", MOST_FRAMES)))
            for cob_id, data in encoder.frames(rows[i]):
                self.cycles[-1].put(Frame(cob_id, data, clock.now + k * dt))

    def fill(self, batch: Batch, timeout: float) -> None:
        """What has come."""
        if self.ready is not None:
            ffi.memmove(batch.frames, self.ready.frames, self.ready.count * ffi.sizeof("StopsetFrame"))
            batch.count, self.ready = self.ready.count, None

    def close(self) -> None:
        """Nothing is open."""


class Outlet:
    """Takes the bytes."""

    def fast(self, name: str) -> Callable[[bytes], None]:
        return len  # type: ignore[return-value]

    def put(self, name: str, data: bytes | str, *, must_arrive: bool = False) -> None:
        """Slow messages are another matter."""

    subscribe = serve = alive = lambda *_: None


class Desk(StopDesk):
    """The desk as it is, with certificates that came long ago and no process behind it."""

    def _start(self) -> None:
        n, a = self.n, np.full(self.n, 0.1)
        for category, c in self.counters.items():
            for k in range(c.narrow.capacity):  # a full shelf, of which the last holds the arm
                wide = np.full(2 * n, 10.0 if k == c.narrow.capacity - 1 else 1e-6)
                c.narrow.put(Certificate(category, -wide, wide, Numbers(a, a, a, 0.02, np.full(n, True)), 0.001, 0.001))
            c.wide.put(c.narrow.answers[-1])
        self._ready = True


def prepared(
    model: Model, model_path: Path, trial: Recording, clock: Clock | None = None, recorder: Recorder | None = None
) -> tuple[Daemon, Frames, Clock]:
    """A daemon that hears a recording from memory and speaks into nothing."""
    clock, profile = clock or Clock(), load_profile("lwa4p/monitor")
    bus = Frames(trial, clock, CYCLES)
    source = CanSource(bus, profile, profile.cycle_s, clock=clock)
    config = Config(str(model_path), Bus("hub:1"), data_id=7, sha256="ab" * 32, publish=Publish(json_hz=1e-9))
    desk = Desk(str(model_path), seen_by(model), config.stops, 0.0, source.quantum, clock=clock)
    outlet = Outlet() if recorder is None else Overheard(Outlet(), recorder)
    daemon = Daemon(config, model, source, outlet, profile.cycle_s, Beside(key=KEY, clock=clock, desk=desk, recorder=recorder))
    daemon._next_json = daemon._next_health = 1e18
    clock.now, bus.ready = clock.now + profile.cycle_s, bus.cycles.pop(0)
    source.next(0.0)  # the first cycle of a bus that is running already is not given out
    return daemon, bus, clock


@contextlib.contextmanager
def first_in_line() -> Iterator[str]:
    """As the daemon runs with ``priority`` in its configuration, where that is allowed; gives what was granted."""
    before = os.sched_getscheduler(0)
    granted = claim(priority=PRIORITY)
    yield granted.lacking or f"FIFO, priority {PRIORITY}"
    if not granted.lacking:
        os.sched_setscheduler(0, before, os.sched_param(0))


def run(daemon: Daemon, bus: Frames, clock: Clock, swept: np.ndarray | None = None) -> np.ndarray:
    """(3, cycles) thread CPU [us], wall [us] and how often somebody else got the processor in it, once the oldest prediction has its
    full age. ``swept``: memory that is gone through before every tenth cycle, and then these alone."""
    took, usage = np.empty((3, len(bus.cycles))), resource.getrusage
    gc.collect()
    gc.disable()
    for k, frames in enumerate(bus.cycles):
        bus.ready = frames
        clock.now += daemon.cycle_s
        if swept is not None and k % SWEPT_EVERY == 0 and k >= len(daemon.watch.ages):
            swept += 1.0
        before = usage(resource.RUSAGE_THREAD).ru_nivcsw
        begin, begin_cpu = time.perf_counter_ns(), time.thread_time_ns()
        daemon.cycle()
        took[:2, k] = time.thread_time_ns() - begin_cpu, time.perf_counter_ns() - begin
        took[2, k] = 1e3 * (usage(resource.RUSAGE_THREAD).ru_nivcsw - before)
    gc.enable()
    warm = -(-len(daemon.watch.ages) // SWEPT_EVERY) * SWEPT_EVERY
    return took[:, warm :: 1 if swept is None else SWEPT_EVERY] * 1e-3


def median(x: np.ndarray) -> float:
    """0 where there is none."""
    return float(np.median(x)) if len(x) else 0.0


def many_arms(model_path: Path, trial: Recording, arms: int) -> dict[str, object]:
    """Thread CPU [ms] of a tick in which every one of ``arms`` has its cycle, and how many ticks took longer than one lasts."""
    model = load_model(model_path)
    cells = [prepared(model, model_path, trial) for _ in range(arms)]
    took = np.empty(ARM_TICKS)
    gc.collect()
    gc.disable()
    with first_in_line():
        for k in range(ARM_TICKS):
            begin = time.thread_time_ns()
            for daemon, bus, clock in cells:
                bus.ready = bus.cycles[k]
                clock.now += daemon.cycle_s
                daemon.cycle()
            took[k] = time.thread_time_ns() - begin
    gc.enable()
    took = took[len(cells[0][0].watch.ages) :] * 1e-6
    missed = int(np.count_nonzero(took > 1e3 * cells[0][0].cycle_s))
    print(f"{arms} arms in one thread: {np.median(took):.2f} ms CPU a tick, p99 {np.quantile(took, 0.99):.2f}, max {took.max():.2f}; "
          f"{missed} of {len(took)} ticks longer than {1e3 * cells[0][0].cycle_s:g} ms")  # fmt: skip
    return {"arms": arms, "tick_cpu_ms": {"median": float(np.median(took)), "max": float(took.max())}, "missed": missed}


def cycle_cost(model_path: Path, trial: Recording, before: dict[str, float]) -> dict[str, object]:
    """CPU and wall of a whole cycle; then, in a run of its own as clocks cost too, of its parts. ``before``: these, as they were."""
    model = load_model(model_path)
    others, _, lost = run(*prepared(model, model_path, trial))
    cold = run(*prepared(model, model_path, trial), swept=np.zeros(SWEPT // 8))[0]
    daemon, *rest = prepared(model, model_path, trial)
    with first_in_line() as scheduling:
        cpu, wall, _ = run(daemon, *rest)
    state = daemon._situation()
    print(f"state {state.state.name}: {state.why}")
    print(f"{len(daemon.watch.ages) - 1} ages, {model.effort}, {len(model.effects)} effects, {len(cpu)} cycles: "
          f"{daemon.tally.verdicts}")  # fmt: skip
    daemon, *rest = prepared(model, model_path, trial)
    desk, watch = daemon.desk, daemon.watch
    owners = {"next": daemon.source, "step": watch, "offer": desk, "now": desk, "state": daemon.publisher}
    parts = {name: Part(owner, name) for name, owner in owners.items()}
    daemon.source = replace_calls(daemon.source, next=parts["next"])
    daemon.watch = replace_calls(watch, step=parts["step"])
    daemon.desk = replace_calls(desk, offer=parts["offer"], now=parts["now"])
    daemon.publisher.state = parts["state"]  # type: ignore[method-assign]
    with first_in_line():
        timed = float(np.median(run(daemon, *rest)[0]))
    warm = slice(len(watch.ages), None)
    said = {n: float(np.median(np.array(p.took[warm])) * 1e-3) for n, p in parts.items()}
    for name, us in (*said.items(), ("the rest", timed - sum(said.values()))):
        was = f", {before[name] / us:.1f} times less than it was" if name in before else ""
        print(f"  {name:<10} {us:8.1f} us CPU{was}")
    print(f"  {np.count_nonzero(cpu > 1e3)} of {len(cpu)} cycles longer than 1 ms, which 1 kHz leaves")
    said_of = {
        name: {"median": float(np.median(x)), "p99": float(np.quantile(x, 0.99))}
        for name, x in (("mine", cpu), ("others", others))
    }
    print(
        f"  cycle      {np.median(cpu):8.1f} us CPU, p99 {np.quantile(cpu, 0.99):.1f}; wall p99.9 {np.quantile(wall, 0.999):.1f} us ({scheduling})"
    )
    print(f"  among all others, load {os.getloadavg()[0]:.1f}: {np.median(others):.1f} us CPU, p99 {np.quantile(others, 0.99):.1f}, "
          f"{np.quantile(others, 0.99) / np.quantile(cpu, 0.99):.1f} times the p99 above; the {np.count_nonzero(lost)} of {len(lost)} cycles in "
          f"which somebody else got the processor {median(others[lost > 0]):.1f}, p99 of the rest {np.quantile(others[lost == 0], 0.99):.1f}; "
          f"a cycle after {SWEPT >> 20} MiB of other memory {np.median(cold):.1f}")  # fmt: skip
    return {
        "cycle_cpu_us": said_of["mine"], "among_others_cpu_us": said_of["others"], "scheduling": scheduling, "load": os.getloadavg()[0],
        "wall_us": {"p999": float(np.quantile(wall, 0.999))}, "parts_us": said, "swept_cpu_us": float(np.median(cold)),
        "ages": len(watch.ages) - 1, "joints": model.n, "effort": model.effort,
    }  # fmt: skip


def taking(rounds: int = 500) -> dict[str, float]:
    """CPU [us] that a cycle's 13 frames cost to take from a raw socket, all at once and as python-can does it; a datagram socket here."""
    with socket.socket(type=socket.SOCK_DGRAM) as end, socket.socket(type=socket.SOCK_DGRAM) as out:
        end.bind(("127.0.0.1", 0))
        out.connect(end.getsockname())
        listener, batch = SocketCanListener(SimpleNamespace(socket=end)), Batch()

        def one_by_one() -> None:
            batch.clear()
            while batch.count < DRIVES_FRAMES and select.select([end], [], [], 0.0)[0]:
                m = capture_message(end)
                batch.put(Frame(m.arbitration_id, m.data, m.timestamp))

        took: dict[str, list[int]] = {"at_once": [], "one_by_one": []}
        for _ in range(rounds):
            for name, take in (("at_once", lambda: listener.fill(batch, 0.0)), ("one_by_one", one_by_one)):
                for k in range(DRIVES_FRAMES):
                    out.send(FRAME.pack(0x181 + k, 8, bytes(8)))
                begin = time.thread_time_ns()
                take()
                took[name].append(time.thread_time_ns() - begin)
                assert batch.count == DRIVES_FRAMES
    cost = {name: float(np.median(x)) * 1e-3 for name, x in took.items()}
    print(f"a cycle's {DRIVES_FRAMES} frames from a socket: {cost['at_once']:.1f} us CPU at once, {cost['one_by_one']:.1f} one by one, "
          f"{cost['one_by_one'] / cost['at_once']:.1f} times as much")  # fmt: skip
    return cost


class Part:
    """A call whose thread CPU [ns] is written down."""

    def __init__(self, owner: object, name: str) -> None:
        self.call, self.took = getattr(owner, name), []

    def __call__(self, *args: object) -> object:
        begin = time.thread_time_ns()
        try:
            return self.call(*args)
        finally:
            self.took.append(time.thread_time_ns() - begin)


class replace_calls:  # noqa: N801 - reads as the verb it is
    """An object with some calls replaced."""

    def __init__(self, owner: object, **calls: object) -> None:
        self.__dict__.update(calls, _owner=owner)

    def __getattr__(self, name: str) -> object:
        return getattr(self._owner, name)


def torque_input(horizon: float = HORIZON) -> Model:
    """The known arm with measured motor torque: gravity, friction and their rounding are evaluated at every sample."""
    m = known_model(horizon=horizon)
    effects = tuple(Fitted("coulomb", j, {"F_c": 3.0}, {}) for j in m.joints)
    wide = Box.symmetric(np.full(m.n, 500.0))
    sets = replace(m.powered, U=wide)
    return replace(m, effort="motor_torque", effects=effects, sets={"powered": sets}, domain=replace(m.domain, u=wide))


def live(model_path: Path, recording: Path, trials: int, speed: float) -> None:
    """SYNC until it is heard, replay, monitor and listener in processes of their own."""
    bus, port = free_port(), free_port()
    with tempfile.TemporaryDirectory() as folder:
        config = write_config(Path(folder), model_path, f'[bus]\nlink = "hub:{bus}"', port)
        heard: list[tuple[int, bytes]] = []
        with running("monitor", "--config", str(config)), Ear(port) as ear:
            ear.link.subscribe("state", lambda _, d: heard.append((time.time_ns(), d)))
            _, err = stopset(
                "replay", str(recording), "--to", f"hub:{bus}", "--wait", "1", "--trials", str(trials), "--speed", str(speed)
            ).communicate(timeout=120)
            if err:
                print(err)
            time.sleep(0.5)
            rows = [(at, unpack(d)["t_meas_ns"]) for at, d in heard]
    rows = [r for r in rows if r[1]]
    late = np.array([at - t for (_, before), (at, t) in pairwise(rows) if t != before]) * 1e-6
    print(f"SYNC until it is heard, at {250 * speed:.0f} Hz: {len(late)} messages, median {np.median(late):.2f} ms, "
          f"p99 {np.quantile(late, 0.99):.2f} ms, max {late.max():.1f} ms")  # fmt: skip
    print("  " + json.dumps({k: ear.twins[-1][k] for k in ("samples", "gaps", "violation_count")}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", type=Path, metavar="MODEL RECORDING")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--before", type=Path, help="the JSON of another commit")
    parser.add_argument("--no-live", action="store_true", help="only the cost of a cycle")
    parser.add_argument("--horizon", type=float, default=HORIZON, help="[s] of predictions, one age for every 4 ms of it")
    args = parser.parse_args()
    before = json.loads(args.before.read_text())["parts_us"] if args.before else {}
    folder = Path(tempfile.mkdtemp())
    model_path, recording = args.files or (folder / "known.model.json", folder / "known.parquet")
    torque_path = model_path
    if not args.files:
        save_model(known_model(), model_path)
        write_recordings(recording, meta(), [motion(s, 1000, s) for s in range(3)])
        torque_path = folder / "torque.model.json"
        save_model(torque_input(args.horizon), torque_path)
        results = cycle_cost(torque_path, motion(0, CYCLES), before)
        results["many"] = many_arms(torque_path, motion(0, CYCLES), 12)
    else:
        results = cycle_cost(model_path, next(iter(read_recordings(recording))), before)
    if usable():
        results["taking_frames_cpu_us"] = taking()
    subprocess.run([sys.executable, Path(__file__).with_name("monitor_allocations.py")], check=True)
    if args.json:
        args.json.write_text(json.dumps(results))
    for speed in () if args.no_live else (1.0, 4.0):
        live(model_path, recording, 3, speed)


if __name__ == "__main__":
    main()
