"""A wrong OK is impossible to get by these means: daemons that are killed, stopped, hung, restarted, fed with rubbish, and ways
that repeat, lose, swap, delay, forge. Real processes, real zenoh, both consumers."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import shutil
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from monitor_arm import known_model, meta, motion, with_torque_scaled
from monitor_process import (
    PREFIX,
    CReading,
    Ear,
    PythonReading,
    Reading,
    compiled,
    expected,
    free_port,
    running,
    stopset,
    write_config,
)
from patience import Granted, rest, wait
from state_messages import pack
from stopset.artifact import save_model
from stopset.monitor.authentication import Key, load_keys
from stopset.monitor.clearing import HIDDEN
from stopset.monitor.config import load_config
from stopset.monitor.consumer import Fault
from stopset.monitor.jointstate import JointState, to_json
from stopset.monitor.journal import SLOT
from stopset.monitor.layout import LENGTH, Flag, State, unpack
from stopset.monitor.links.hub import Hub
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.monitor.profile import load_profile
from stopset.recording import Recording, write_recordings

WATCHDOG = 400  # [ms] a machine shared with everything else
GOOD = {State.OK, State.DEGRADED}
RECOVER = 0.05  # [s]
VALID_MS = 300
PUBLISH = f"valid_for_ms = {VALID_MS}\nstale_ms = 600\nrecover_s = {RECOVER}"
STOPS = '[stops]\ncategories = ["0"]'


@dataclass(frozen=True)
class Cell:
    """A model, a recording of a healthy arm and one of an altered one, keys, a configuration and where it is heard."""

    folder: Path
    config: Path
    bus: int
    port: int

    def daemon(self, **more: str) -> contextlib.AbstractContextManager[Any]:
        return running("monitor", "--config", str(self.config), **more)

    def replay(self, which: str = "healthy", *more: str, **environ: str) -> contextlib.AbstractContextManager[Any]:
        words = "--to", f"hub:{self.bus}", *(more or ("--loop",))
        return running("replay", str(self.folder / f"{which}.parquet"), *words, **environ)


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    save_model(known_model(), tmp_path / "arm.model.json")
    trials = [motion(s, 1500, s) for s in range(3)]
    write_recordings(tmp_path / "healthy.parquet", meta(), trials)
    write_recordings(tmp_path / "altered.parquet", meta(), [with_torque_scaled(motion(0, 250), 3, 1.5)])
    (tmp_path / "arm.keys").write_text(f"5 {'5a' * 32}\n")
    (tmp_path / "arm.keys").chmod(0o600)
    bus, port = free_port(), free_port()
    link = f'[bus]\nlink = "hub:{bus}"\n{STOPS}'
    config = write_config(tmp_path, tmp_path / "arm.model.json", link, port, 'keys = "arm.keys"', PUBLISH)
    return Cell(tmp_path, config, bus, port)


@pytest.fixture(scope="session")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = Path(__file__).resolve().parents[1] / "deploy/plc/reader.c"
    return compiled(tmp_path_factory.mktemp("plc"), source)


@contextlib.contextmanager
def consumers(cell: Cell, reader: Path, link: ZenohLink, name: str = "state") -> Iterator[list[Reading]]:
    """Both, hearing ``name`` on an open session."""
    keys = load_keys(cell.folder / "arm.keys")
    expect = expected(cell.config, keys)

    def ask(nonce: bytes) -> None:
        link.put("challenge", nonce)

    both: list[Reading] = [PythonReading(ask, expect, WATCHDOG), CReading(ask, expect, WATCHDOG, reader)]
    link.subscribe(name, lambda _, d: [c.take(d) for c in both])
    try:
        yield both
    finally:
        for c in both:
            c.close()


def all_in(both: list[Reading], states: set[State]) -> Callable[[], bool]:
    return lambda: all(c.now in states for c in both)


# ---- the latch ------------------------------------------------------------------------------------------------------


def test_a_violation_outlives_every_restart_until_a_person_resets_it(cell: Cell) -> None:
    def heard(damage: str) -> tuple[dict[str, Any], set[bool]]:
        """What the daemon says after a start: the last words, and whether its messages had the latch's flag."""
        with cell.daemon() as monitor, Ear(cell.port) as ear:
            assert ear.wait(lambda: len(ear.twins) > 1 and len(ear.raw) > 5)
            if damage == "hangup":
                monitor.send_signal(signal.SIGHUP)
                assert ear.wait(lambda: any(e["kind"] == "reloaded" for e in ear.events)), "the model is read anew"
                assert monitor.poll() is None
            if damage == "reset":
                ear.link.put("reset", b'{"name": "A. Person", "reason": "seen to"}')
                assert ear.wait(lambda: not ear.twins[-1]["violation_latched"])
            twin = ear.twins[-1]
            monitor.kill()
            return twin, {bool(unpack(d)["flags"] & Flag.VIOLATION_LATCHED) for d in ear.raw}

    with cell.daemon() as monitor, Ear(cell.port) as ear:
        with cell.replay("altered", "--wait", "1") as replay:
            replay.wait(timeout=600)
        assert ear.wait(lambda: ear.twins and ear.twins[-1]["samples"] > 150), ear.twins[-1]
        assert ear.wait(lambda: ear.twins[-1]["violation_latched"])
        monitor.kill()  # with a second's violations that no disk has seen yet
        first, counted = ear.twins[-1], unpack(ear.raw[-1])["violation_count"]
    twin, flagged = heard("")
    assert flagged == {True} and twin["violation_count"] >= counted > 0
    first |= {name: twin[name] for name in ("violation_count", "violations")}
    for damage in ("", "hangup"):
        twin, flagged = heard(damage)
        assert flagged == {True}, "from the first message on"
        for name in ("violation_count", "violating_joints", "violation_why", "violations"):
            assert twin[name] == first[name]
    journal = cell.folder / "monitor.latch"
    whole = journal.read_bytes()
    for torn in (whole[: SLOT + 100], whole[:200] + b"\0" * 100 + whole[300:]):
        journal.write_bytes(torn)
        twin, flagged = heard("")
        assert flagged == {True} and "journal" in twin["violation_why"]
        assert (
            twin["violation_why"].startswith(first["violation_why"]) and 0 < twin["violation_count"] <= first["violation_count"]
        )
    journal.unlink()  # who would clear it so is no operator
    twin, flagged = heard("")
    assert flagged == {True} and "taken away" in twin["violation_why"]
    heard("reset")
    twin, flagged = heard("")
    assert not twin["violation_latched"] and flagged == {False}


def said_on(bus: int, *frames: tuple[int, bytes]) -> None:
    """What another node says on the hub."""
    with socket.create_connection(("127.0.0.1", bus), timeout=10) as s:
        s.recv(64)
        for cob_id, data in frames:
            s.sendall(f"< send {cob_id:X} {len(data)} {data.hex(' ')} >".encode())
        time.sleep(0.2)


def test_an_emergency_outlives_a_restart_until_it_is_over(cell: Cell) -> None:
    """A drive says it once: a daemon that was killed after it must not forget it, nor take a master's order for its end."""
    node = load_profile("lwa4p/monitor").nodes["arm_3_joint"]

    def names_it(ear: Ear) -> bool:
        return any("arm_3_joint" in t["why"] and "0x2310" in t["why"] for t in ear.twins[-1:])

    with cell.replay():
        with cell.daemon() as monitor, Ear(cell.port) as ear:
            assert ear.wait(lambda: GOOD & set(ear.states[-5:]), 40.0)
            said_on(cell.bus, (0x080 + node, b"\x10\x23\x03" + bytes(5)))
            assert ear.wait(lambda: names_it(ear))
            said_on(cell.bus, (0x000, b"\x81\x00"))  # which the replay's drives do not obey
            rest(0.5)
            assert not GOOD & set(ear.states[-50:])
            monitor.kill()
        with cell.daemon() as monitor, Ear(cell.port) as ear:
            assert ear.wait(lambda: names_it(ear), 40.0), {t["why"] for t in ear.twins}
            rest(HIDDEN + 0.5)
            assert not GOOD & set(ear.states), "told once, and still in force"
            ear.link.put("reset", b'{"name": "A. Person", "reason": "drive looked at"}')
            assert ear.wait(lambda: GOOD & set(ear.states[-5:])), {t["why"] for t in ear.twins}
            (event,) = [e for e in ear.events if e["kind"] == "reset"]
            assert event["emergencies"] == {"arm_3_joint": "0x2310"} and event["name"] == "A. Person"
            monitor.kill()
        with cell.daemon(), Ear(cell.port) as ear:
            assert ear.wait(lambda: GOOD & set(ear.states[-5:]), 40.0), "over for good"


def test_a_second_daemon_does_not_get_the_journal(cell: Cell) -> None:
    with cell.daemon(), Ear(cell.port):
        second = stopset("monitor", "--config", str(cell.config))
        _, err = second.communicate(timeout=600)
    assert second.returncode == 2 and "another monitor holds the journal" in err and "Traceback" not in err


# ---- the door -------------------------------------------------------------------------------------------------------

RUBBISH = [
    b'{"stamp": 1e999, "name": []}', b'{"stamp": 1e12, "name": [], "position": []}', b'{"stamp": ' + b"9" * 400 + b', "name": []}',
    b'{"a": ' * 20_000 + b"1" + b"}" * 20_000, b"[" * 60_000, b'{"stamp_ns": NaN}', b'{"stamp": -1, "name": ["\xff"]}', b"\0\1\0\0" + b"\xff" * 64,
    b"", b"{" * 70_000, b'{"stamp": 1.0, "name": ["a"], "position": [1e309]}', b"\xff" * 1000,
]  # fmt: skip


SHORT = motion(0, 1500)


def joint_state(k: int, stamp_ns: int, run: Recording = SHORT) -> bytes:
    r, k = run, k % len(run.t)
    return to_json(JointState(stamp_ns, JOINTS, tuple(r.q[k]), tuple(r.dq[k]), tuple(r.tau[k])))


JOINTS = known_model().joints


def test_no_input_ends_or_hangs_the_daemon(tmp_path: Path) -> None:
    save_model(known_model(), tmp_path / "arm.model.json")
    port = free_port()
    source = f'[joint_states]\nkey = "ros/joint_states"\ncycle_s = 0.004\n{STOPS}'
    config = write_config(tmp_path, tmp_path / "arm.model.json", source, port, publish=PUBLISH)
    with running("monitor", "--config", str(config)) as monitor, Ear(port) as ear, Granted() as granted:
        arrivals: list[float] = []
        ear.link.subscribe("state", lambda _, d: arrivals.append(time.monotonic()))
        send = ear.link.fast("/ros/joint_states")
        assert ear.wait(lambda: len(ear.raw) > 50)
        begin, start = time.monotonic(), time.time_ns()
        for _ in range(20):
            for rubbish in RUBBISH:
                send(rubbish)
                ear.link.put("reset", rubbish)
                ear.link.put("reset", b'{"name": "\xff", "reason": "\xff"}')
            for k in range(250):
                ear.link.put("challenge", k.to_bytes(3, "little"))
            time.sleep(0.02)
        # a healthy arm whose sender's clock is 20 s ahead; when it is set right, that is more than messages swapped on the way
        for k in range(300):
            due = begin + 2.0 + 0.004 * k
            time.sleep(max(0.0, due - time.monotonic()))
            send(joint_state(k, start + 20_000_000_000 + 4_000_000 * k))
        time.sleep(0.5)
        assert monitor.poll() is None, "it lives"
        gaps = [granted.between(a, b) for a, b in itertools.pairwise(arrivals) if a > begin]
        assert max(gaps) < 0.5, f"silent for {max(gaps):.2f} s"
        assert not GOOD & set(ear.states), "nothing of this is OK"
        assert any("in the future" in t["why"] for t in ear.twins), {t["why"] for t in ear.twins}
        begun = len(ear.raw)

        def healthy() -> bool:
            """Two seconds of it, as of now: a machine that keeps the sender back makes its stamps old."""
            start = time.time_ns() - 4_000_000
            for k in range(500):
                time.sleep(max(0.0, (start + 4_000_000 * k - time.time_ns()) * 1e-9))
                send(joint_state(k, start + 4_000_000 * k))
            return bool(GOOD & set(ear.states[begun:]))

        assert ear.wait(healthy), {t["why"] for t in ear.twins}
        (health,) = [json.loads(d) for d in [hear_once(ear, "health")]]
        assert health["orders_dropped"] > 1000 and health["send_errors"] == 0


@pytest.mark.parametrize("through", ["bus", "joint_states"])
def test_a_bus_of_another_cycle_than_the_model_s_is_no_ok_and_said(cell: Cell, through: str) -> None:
    """Five per cent slower: its SYNC counter goes on by one all the same, and stamps look like lost ones."""

    def says_so(ear: Ear) -> bool:
        seen = re.search(r"samples come every (\S+) ms.*identified at steps of 4 ms", ear.twins[-1]["why"])
        return seen is not None and abs(float(seen[1]) - 4.2) < 0.05  # as a busy machine lets it be seen

    if through == "joint_states":
        text, source = cell.config.read_text(), f'[bus]\nlink = "hub:{cell.bus}"'
        cell.config.write_text(text.replace(source, '[joint_states]\nkey = "js"\ncycle_s = 0.004'))
    with cell.daemon(), Ear(cell.port) as ear, contextlib.ExitStack() as stack:
        if through == "bus":
            stack.enter_context(cell.replay("healthy", "--loop", "--speed", str(4.0 / 4.2)))
        else:
            send, sending = ear.link.fast("/js"), threading.Event()

            def sender() -> None:
                begin, k = time.time_ns(), 0
                while not sending.wait(max(0.0, (begin + 4_200_000 * k - time.time_ns()) * 1e-9)):
                    send(joint_state(k, begin + 4_200_000 * k))
                    k += 1

            thread = threading.Thread(target=sender)
            stack.callback(thread.join)
            stack.callback(sending.set)
            thread.start()
        assert ear.wait(lambda: ear.twins and says_so(ear), 40.0), {t["why"] for t in ear.twins}
        rest(1.0)
        begun = len(ear.raw)
        rest(2.0)
        assert ear.wait(lambda: says_so(ear)), {t["why"] for t in ear.twins[-10:]}
        assert any(e["kind"] == "pace" for e in ear.events)
        assert not GOOD & set(ear.states[begun:]), "no OK on it"


def test_of_two_senders_of_joint_states_none_is_believed(tmp_path: Path) -> None:
    """A simulation left running beside the arm, or two arms on one key: the one whose stamps are a little older was left out, message
    by message, and OK was said of the other."""
    save_model(known_model(), tmp_path / "arm.model.json")
    port = free_port()
    source = f'[joint_states]\nkey = "js"\ncycle_s = 0.004\n{STOPS}'
    config = write_config(tmp_path, tmp_path / "arm.model.json", source, port, publish=PUBLISH)
    with running("monitor", "--config", str(config)), Ear(port) as ear, contextlib.ExitStack() as stack:
        other = ZenohLink(PREFIX, mode="client", connect=[f"tcp/127.0.0.1:{port}"])
        stack.callback(other.close)
        simulation, arm, run = ear.link.fast("/js"), other.fast("/js"), motion(0, 60_000)
        both, sending = threading.Event(), threading.Event()

        def sender() -> None:
            begin, k = time.time_ns(), 0
            while not sending.wait(max(0.0, (begin + 4_000_000 * k - time.time_ns()) * 1e-9)):
                simulation(joint_state(k, begin + 4_000_000 * k, run))
                if both.is_set():
                    time.sleep(0.001)
                    arm(joint_state(k, begin + 4_000_000 * k - 2_000_000, run))  # where it moves otherwise nobody gets to see
                k += 1

        thread = threading.Thread(target=sender)
        stack.callback(thread.join)
        stack.callback(sending.set)
        thread.start()
        assert ear.wait(lambda: GOOD & set(ear.states[-5:]), 40.0), {t["why"] for t in ear.twins}
        both.set()
        assert ear.wait(lambda: "two senders" in ear.twins[-1]["why"], 20.0), {t["why"] for t in ear.twins[-20:]}
        begun = len(ear.raw)
        rest(2.0)
        assert not GOOD & set(ear.states[begun:]), "which arm is OK nobody can tell"
        both.clear()
        assert ear.wait(lambda: GOOD & set(ear.states[-5:]), 40.0), "one of them has ended"


def hear_once(ear: Ear, name: str) -> bytes:
    got: list[bytes] = []
    ear.link.subscribe(name, lambda _, d: got.append(d))
    assert ear.wait(lambda: got)
    return got[0]


def test_a_flooded_bus_and_stamps_that_are_no_numbers_are_no_ok_and_no_silence(cell: Cell) -> None:
    hub = Hub("127.0.0.1", cell.bus)
    with cell.daemon() as monitor, Ear(cell.port) as ear, Granted() as granted:
        assert wait(lambda: hub.clients == 1)
        flooding = True

        def flood() -> None:
            while flooding:
                hub._broadcast(
                    b"< frame 2A5 1.0 00 >" * 500 + b"< frame 080 nan 01 >< frame zz 1 0 >< frame 383 inf 0011 >", None
                )

        thread = threading.Thread(target=flood)
        thread.start()
        time.sleep(0.5)
        before = len(ear.raw)
        assert wait(lambda: len(ear.raw) > before + 60, 20.0), "messages go out at their own pace"
        flooding = False
        thread.join()
        apart = time.time() - time.monotonic()
        made = [unpack(d)["t_pub_ns"] * 1e-9 - apart for d in ear.raw[before:]]
        assert max(granted.between(a, b) for a, b in itertools.pairwise(made)) < 1.0
        assert monitor.poll() is None and not GOOD & set(ear.states)
    hub.close()


@pytest.mark.skipif(sys.platform != "linux", reason="limits of a running process")
@pytest.mark.parametrize("lacking", ["file descriptors", "memory"])
def test_a_machine_that_gives_nothing_more_does_not_end_the_monitor(cell: Cell, lacking: str) -> None:
    """Whoever filled its shared memory, or left it no descriptor, ended it: zenoh's Rust panics then, which is no `Exception`."""
    import resource

    with cell.replay(), cell.daemon() as monitor, Ear(cell.port) as ear:
        proc = Path(f"/proc/{monitor.pid}")
        assert ear.wait(lambda: GOOD & set(ear.states[-5:]), 40.0)
        if lacking == "memory":
            (words,) = [w.split() for w in (proc / "status").read_text().splitlines() if w.startswith("VmSize")]
            resource.prlimit(monitor.pid, resource.RLIMIT_AS, (1024 * int(words[1]) + 100_000, resource.RLIM_INFINITY))
        else:
            resource.prlimit(monitor.pid, resource.RLIMIT_NOFILE, (len(list((proc / "fd").iterdir())), 4096))
        begun = len(ear.raw)
        monitor.send_signal(signal.SIGHUP)  # which a thread is to see to
        for child in (proc / f"task/{monitor.pid}/children").read_text().split():
            os.kill(int(child), signal.SIGKILL)  # what bounds stops, to be begun anew
        assert ear.wait(lambda: len(ear.raw) > begun + 500, 40.0) and monitor.poll() is None, "it goes on"
        said = {e["kind"] for e in ear.events}
        assert said & {"fault", "reload_refused"}, "and says what it lacks"
        resource.prlimit(monitor.pid, resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        resource.prlimit(monitor.pid, resource.RLIMIT_NOFILE, (4096, 4096))
        monitor.send_signal(signal.SIGHUP)
        assert ear.wait(lambda: "reloaded" in {e["kind"] for e in ear.events}), "as soon as the machine has what it needs"
        assert ear.wait(lambda: GOOD & set(ear.states[-5:]), 40.0)


# ---- what the consumers believe ---------------------------------------------------------------------------------------


def test_killed_stopped_hung_and_restarted_daemons_are_noticed_by_both_consumers(
    cell: Cell, reader: Path, tmp_path: Path
) -> None:
    shim, order = (
        compiled(tmp_path, Path(__file__).with_name("time_shim.c"), words=("-shared", "-fPIC", "-ldl")),
        tmp_path / "order",
    )
    order.write_text("0")
    preload = {"LD_PRELOAD": str(shim), "SHIM": str(order)}
    router = ZenohLink(PREFIX, mode="router", listen=[f"tcp/127.0.0.1:{(relay := free_port())}"])
    text = cell.config.read_text()
    cell.config.write_text(text.replace("listen = [", f'mode = "client"\nconnect = ["tcp/127.0.0.1:{relay}"]\nlisten = ['))
    heard: list[tuple[int, dict[str, Any]]] = []
    router.subscribe("state", lambda _, d: heard.append((time.time_ns(), unpack(d))))
    with contextlib.closing(router), cell.replay(), consumers(cell, reader, router) as both, Granted() as granted:
        with cell.daemon(**preload) as monitor:
            assert wait(all_in(both, GOOD), 40.0), [c.said[-3:] for c in both]
            monitor.send_signal(signal.SIGSTOP)
            assert wait(all_in(both, {State.FAULT}), 1.0)
            at = time.monotonic()
            time.sleep(1.0)
            on = time.monotonic()
            assert not any(c.since(at) & GOOD for c in both)
            woken = time.time_ns()
            monitor.send_signal(signal.SIGCONT)
            time.sleep(0.1)
            early = [s for c in both for t, s, _ in c.said if on <= t < on + RECOVER]
            assert not GOOD & set(early), "two seconds old data are not OK when it goes on"
            assert wait(all_in(both, GOOD), 10.0), [c.said[-3:] for c in both]
            # what was on its way when it was stopped may be heard now, by a machine that has much to do
            good = [(at, m) for at, m in list(heard) if m["t_pub_ns"] >= woken and State(m["state"]) in GOOD]
            assert good and min(m["t_pub_ns"] for _, m in good) >= woken + RECOVER * 1e9
            for at, m in good:
                # the drives' side stamps the SYNC when it sends it: so old the data truly are. What was sent shortly before it was woken may
                # be looked at once it has recovered, on a machine that has much to do: as long as it is valid, whenever it came
                assert m["t_pub_ns"] - m["t_meas_ns"] <= VALID_MS * 1e6, (
                    "of what waited while it stood only what is still valid is OK"
                )
                apart = time.time() - time.monotonic()
                assert granted.between(m["t_pub_ns"] * 1e-9 - apart, at * 1e-9 - apart) <= WATCHDOG * 1e-3
            for jump in (3_600_000, 0):
                at = time.monotonic()
                order.write_text(str(jump))  # its clock is an hour ahead of its samples, and back
                assert wait(lambda at=at: all(State.UNKNOWN in c.since(at) or State.FAULT in c.since(at) for c in both), 3.0)
                if jump:
                    time.sleep(0.5)
                    assert not any(c.now in GOOD for c in both)
            assert wait(all_in(both, GOOD), 10.0), [c.said[-3:] for c in both]
            order.write_text("hang")
            assert wait(all_in(both, {State.FAULT}), 3.0), "it holds its session, but says nothing"
            monitor.kill()
            order.write_text("0")  # for its child, which ends with it
        at = time.monotonic()
        with cell.daemon(**preload) as monitor:
            assert wait(all_in(both, GOOD), 40.0), [c.said[-3:] for c in both]
            monitor.kill()
            assert wait(all_in(both, {State.FAULT}), 3.0)
            assert wait(lambda: all(Fault.SILENT in c.faults(at) for c in both), 3.0)


@dataclass
class SlowWay:
    """Passes messages on ``late`` seconds after they came."""

    send: Callable[[bytes], None]
    late: float
    on: bool = True

    def __post_init__(self) -> None:
        self._underway: deque[tuple[float, bytes]] = deque()
        self.thread = threading.Thread(target=self._work, daemon=True)
        self.thread.start()

    def take(self, _key: str, data: bytes) -> None:
        self._underway.append((time.monotonic(), data))

    def _work(self) -> None:
        while self.on:
            while self._underway and time.monotonic() - self._underway[0][0] >= self.late:
                self.send(self._underway.popleft()[1])
            time.sleep(0.001)

    def close(self) -> None:
        self.on = False
        self.thread.join(timeout=5)


def test_a_clock_set_by_less_than_messages_are_under_way_is_noticed_by_both_consumers(
    cell: Cell, reader: Path, tmp_path: Path
) -> None:
    """A slow way, and the clock that stamps samples and messages set forward: they are as old as before, and look younger."""
    shim = compiled(tmp_path, Path(__file__).with_name("time_shim.c"), words=("-shared", "-fPIC", "-ldl"))
    (order := tmp_path / "order").write_text("0")
    machine = {"LD_PRELOAD": str(shim), "SHIM": str(order)}
    with cell.daemon(**machine), cell.replay(**machine), Ear(cell.port) as ear, contextlib.ExitStack() as stack:
        way = SlowWay(ear.link.fast("late"), 0.1)
        stack.callback(way.close)
        ear.link.subscribe("state", way.take)
        both = stack.enter_context(consumers(cell, reader, ear.link, "late"))
        assert wait(all_in(both, GOOD), 40.0), [c.said[-3:] for c in both]
        way.late = 0.001 * VALID_MS + 0.02
        assert wait(all_in(both, {State.FAULT}), 10.0), "too late to be believed"
        rest(1.0)
        at = time.monotonic()
        assert not any(c.now in GOOD for c in both)
        order.write_text("250")
        assert wait(lambda: GOOD & {State(unpack(d)["state"]) for d in ear.raw[-3:]}, 10.0)
        rest(2.0)
        assert not any(c.since(at) & GOOD for c in both), [c.said[-3:] for c in both]
        way.late = 0.1
        assert wait(all_in(both, GOOD), 40.0), [c.said[-3:] for c in both]


def test_ways_that_spoil_messages_are_noticed_by_both_consumers(cell: Cell, reader: Path) -> None:
    """A relay between daemon and consumers does what IEC 61784-3 lists, one fault after another."""
    forger = Key(5, b"\0" * 32)
    store: list[bytes] = []

    def changed(data: bytes, signer: Key | None, **more: Any) -> bytes:
        return pack({**{k: v for k, v in unpack(data).items() if k not in ("mac", "key_id")}, **more}, signer)

    true = load_keys(cell.folder / "arm.keys").first
    spoilers: dict[str, Callable[[bytes], list[bytes]]] = {
        "corruption": lambda d: [d[:200] + bytes([d[200] ^ 1]) + d[201:]],
        "unintended repetition": lambda d: [store[0]],
        "incorrect sequence": lambda d: [changed(d, true, seq=unpack(d)["seq"] - 1_000_000 & 0xFFFFFFFF)],
        "loss": lambda d: [],
        "unacceptable delay": lambda d: [store[-min(len(store), 200)]],
        "insertion": lambda d: [changed(d, true, boot_id=unpack(d)["boot_id"] ^ 1, nonces=(0,))],
        "masquerade": lambda d: [changed(d, forger)],
        "masquerade without a code": lambda d: [changed(d, None)],
        "addressing": lambda d: [changed(d, true, data_id=2)],
        "another model": lambda d: [changed(d, true, model_hash=1)],
        "another configuration": lambda d: [changed(d, true, config_hash=1)],
    }
    transport: list[Callable[[bytes], list[bytes]]] = [lambda d: [d]]
    with cell.daemon(), cell.replay(), Ear(cell.port) as ear:
        send = ear.link.fast("spoilt")

        def relay(_: str, data: bytes) -> None:
            store.append(data)
            for d in transport[0](data):
                send(d)

        ear.link.subscribe("state", relay)
        with consumers(cell, reader, ear.link, "spoilt") as both:
            assert wait(all_in(both, GOOD), 40.0), [c.said[-3:] for c in both]
            for name, spoil in spoilers.items():
                refused, lost = [c.refused for c in both], [c.lost for c in both]
                transport[0] = spoil
                assert wait(all_in(both, {State.FAULT}), 3.0), name
                at = time.monotonic()
                time.sleep(0.2)
                assert not any(c.since(at) & GOOD for c in both), name
                transport[0] = lambda d: [d]
                assert wait(all_in(both, GOOD), 10.0), (name, [c.said[-3:] for c in both])
                assert wait(
                    lambda r=refused, o=lost: all(c.refused > a or c.lost > b for c, a, b in zip(both, r, o, strict=True))
                ), name
    # all that was recorded, played to consumers who are there now: as it was, an hour late, after the daemon was killed
    port = free_port()
    listener = ZenohLink(PREFIX, listen=[f"tcp/127.0.0.1:{port}"])
    speaker = ZenohLink(PREFIX, mode="client", connect=[f"tcp/127.0.0.1:{port}"])
    with consumers(cell, reader, listener, "spoilt") as both:
        time.sleep(0.3)
        send = speaker.fast("spoilt")

        def refused() -> bool:
            for data in store[-600:]:
                send(data)
                time.sleep(0.002)
            return both[0].refused > 300

        assert wait(refused)
        assert not any(c.since(0.0) & GOOD for c in both), "recorded messages say nothing of now"
    speaker.close()
    listener.close()


def test_two_monitors_of_one_data_id_are_believed_by_no_consumer(cell: Cell, reader: Path) -> None:
    """A configuration that was copied to another arm's machine: the same keys, hashes and data id. Which arm is OK, nobody can tell."""
    router = ZenohLink(PREFIX, mode="router", listen=[f"tcp/127.0.0.1:{(relay := free_port())}"])
    text = cell.config.read_text()
    cell.config.write_text(text.replace("listen = [", 'mode = "client"\nconnect = [').replace(str(cell.port), str(relay)))
    copied = cell.folder / "copied"
    copied.mkdir()
    for name in ("arm.keys", cell.config.name):
        shutil.copy2(cell.folder / name, copied / name)
    assert load_config(copied / cell.config.name).sha256 == load_config(cell.config).sha256
    with contextlib.closing(router), cell.replay(), consumers(cell, reader, router) as both, cell.daemon():
        assert wait(all_in(both, GOOD), 40.0), [c.said[-3:] for c in both]
        with running("monitor", "--config", str(copied / cell.config.name)):
            assert wait(all_in(both, {State.FAULT}), 40.0)
            rest(0.5)
            at = time.monotonic()
            rest(1.0)
            assert not any(c.since(at) & GOOD for c in both), [c.said[-5:] for c in both]
            assert all(Fault.UNPROVEN in c.faults(0.0) for c in both)
        assert wait(all_in(both, GOOD), 40.0), "it was switched off"


def test_keys_change_while_consumers_go_on(cell: Cell, reader: Path) -> None:
    """The order of deploy/README.md: consumers first, the monitor, the old one away. A SIGHUP between changes no key, and nothing is OK that a
    key signed which consumers no longer hold."""
    old, new = f"5 {'5a' * 32}\n", f"6 {'6b' * 32}\n"
    keys = cell.folder / "arm.keys"
    router = ZenohLink(PREFIX, mode="router", listen=[f"tcp/127.0.0.1:{(relay := free_port())}"])
    text = cell.config.read_text()
    cell.config.write_text(text.replace("listen = [", 'mode = "client"\nconnect = [').replace(str(cell.port), str(relay)))
    keys.write_text(old + new)
    signed: list[int] = []
    router.subscribe("state", lambda _, d: signed.append(unpack(d)["key_id"]))
    with contextlib.closing(router), cell.replay(), consumers(cell, reader, router) as both:
        with cell.daemon() as monitor:
            assert wait(all_in(both, GOOD), 40.0), [c.said[-3:] for c in both]
            keys.write_text(new + old)
            monitor.send_signal(signal.SIGHUP)
            rest(1.0)
            assert all_in(both, GOOD)() and signed[-1] == 5
            monitor.terminate()
            monitor.wait(timeout=600)
        assert wait(all_in(both, {State.FAULT}))
        with cell.daemon():
            assert wait(all_in(both, GOOD), 40.0), [c.said[-3:] for c in both]
            assert signed[-1] == 6 and not any(Fault.FORGED in c.faults(0.0) for c in both)
        keys.write_text(new)
        with consumers(cell, reader, router) as later:
            keys.write_text(old)
            with cell.daemon():
                signed.clear()
                assert wait(lambda: len(signed) > 100), "a monitor that was given the old key again"
                rest(1.0)
                assert not any(c.since(0.0) & GOOD for c in later) and all(Fault.FORGED in c.faults(0.0) for c in later)


def test_a_model_read_anew_by_one_monitor_is_no_matter_of_its_neighbours(cell: Cell, tmp_path: Path) -> None:
    """Two arms, one router, the same model file; it is replaced, and one of the monitors told."""
    router = ZenohLink(mode="router", listen=[f"tcp/127.0.0.1:{(relay := free_port())}"])
    text = cell.config.read_text().replace("listen = [", 'mode = "client"\nconnect = [').replace(str(cell.port), str(relay))
    cell.config.write_text(text)
    second = cell.config.with_name("second.toml")
    second.write_text('arm = "second"\n' + text.replace("data_id = 1001", "data_id = 1002"))
    expect = expected(second, load_keys(cell.folder / "arm.keys"))
    key = "/site/cell/second/stopset"
    with contextlib.closing(router), cell.replay(), cell.daemon() as monitor, running("monitor", "--config", str(second)):
        there = PythonReading(lambda nonce: router.put(f"{key}/challenge", nonce), expect, WATCHDOG)
        events: dict[str, list[dict[str, Any]]] = {"arm": [], "second": []}
        models: dict[str, list[int]] = {"arm": [], "second": []}
        for arm in events:
            router.subscribe(f"/site/cell/{arm}/stopset/event", lambda _, d, a=arm: events[a].append(json.loads(d)))
            router.subscribe(f"/site/cell/{arm}/stopset/state", lambda _, d, a=arm: models[a].append(unpack(d)["model_hash"]))
        router.subscribe(f"{key}/state", lambda _, d: there.take(d))
        with contextlib.closing(there):
            assert wait(lambda: there.now in GOOD and models["arm"], 40.0), there.said[-3:]
            rest(1.0)
            before = expect.model_hash
            save_model(known_model(horizon=0.3), cell.folder / "arm.model.json")
            monitor.send_signal(signal.SIGHUP)
            assert wait(lambda: any(e["kind"] == "reloaded" for e in events["arm"])), events
            at = time.monotonic()
            assert wait(lambda: models["arm"][-1] != before)
            rest(1.0)
            assert set(models["second"]) == {before} and not any(e["kind"].startswith("reload") for e in events["second"])
            assert there.now in GOOD and not {State.VIOLATION, State.INIT} & there.since(at)


def test_another_tool_is_another_configuration_and_the_latch_goes_with_it(cell: Cell, reader: Path) -> None:
    """As docs/how-to/deploy.md has it: one file per tool, one journal; who expects one tool believes no monitor of the other."""
    empty, loaded = cell.config, cell.config.with_name("loaded.toml")
    text = f'journal = "{cell.folder / "arm.latch"}"\n' + empty.read_text()
    empty.write_text("payload_kg = [0.0, 0.0]\n" + text)
    loaded.write_text("payload_kg = 0.0\n" + text)
    with running("monitor", "--config", str(empty)) as monitor, Ear(cell.port) as ear:
        with cell.replay("altered", "--wait", "1") as replay:
            replay.wait(timeout=600)
        assert ear.wait(lambda: ear.twins and ear.twins[-1]["violation_latched"])
        monitor.terminate()
        monitor.wait(timeout=600)
    with running("monitor", "--config", str(loaded)), cell.replay(), Ear(cell.port) as ear:
        assert ear.wait(lambda: len(ear.twins) > 1) and ear.twins[-1]["violation_latched"], "another file, the same arm"
        ear.link.put("reset", b'{"name": "A. Person", "reason": "seen to"}')
        with consumers(cell, reader, ear.link) as both:
            assert ear.wait(lambda: GOOD & set(ear.states[-5:]), 40.0), {t["why"] for t in ear.twins}
            rest(1.0)
            assert not any(c.since(0.0) & GOOD for c in both) and all(Fault.OTHER_CONFIG in c.faults(0.0) for c in both)


def test_the_health_check_is_green_for_a_fresh_valid_message_only(cell: Cell) -> None:
    def green(seconds: int) -> bool:
        p = stopset("watch", "--config", str(cell.config), "--check", "--seconds", str(seconds))
        _out, err = p.communicate(timeout=600)
        assert "Traceback" not in err
        return p.returncode == 0

    assert not green(2), "nobody is there"
    with cell.replay(), cell.daemon() as monitor, Ear(cell.port) as ear:
        assert ear.wait(lambda: GOOD & set(ear.states[-50:]), 40.0)
        assert green(20)
        (cell.folder / "arm.keys").write_text(f"5 {'5b' * 32}\n")
        assert not green(2), "another key"
        (cell.folder / "arm.keys").write_text(f"5 {'5a' * 32}\n")
        assert green(20)
        monitor.send_signal(signal.SIGSTOP)
        assert not green(2), "it stands still"
        monitor.send_signal(signal.SIGCONT)
    assert LENGTH == 616
