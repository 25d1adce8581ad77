"""The daemon's loop with a scripted arm: whatever goes wrong is on the wire as FAULT before anything else happens."""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from monitor_arm import DT, known_model, motion
from monitor_process import free_port, running, write_config
from patience import wait
from stopset.artifact import Model, save_model
from stopset.errors import BusError, NotCovered
from stopset.monitor import clearing
from stopset.monitor.config import LEAST_RECOVER, Bus, Config, Fallback, Publish, Stops
from stopset.monitor.daemon import MAX_FAULTS, Daemon
from stopset.monitor.layout import Flag, State, unpack
from stopset.monitor.profile import load_profile
from stopset.monitor.reloading import Reloading
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.source import CanSource, NoSource, SampleSource

Script = list[Sample | Exception | None]


class Arm:
    """Gives what the script says; an exception in it is raised, None is silence; at the end the daemon is asked to stop."""

    def __init__(self, script: Script) -> None:
        self.script, self.quantum = script, Quantum.none(6)
        self.daemon: Daemon | None = None
        self.closed = self.dropped = 0
        self.begun, self.given, self.pace = time.time() - 2.0, 0, DT  # of the samples' stamps, however fast the script runs

    def next(self, timeout: float) -> Sample | None:
        if not self.script:
            assert self.daemon is not None
            self.daemon.stopping = True
            return None
        step = self.script.pop(0)
        if isinstance(step, Exception):
            raise step
        if step is None:
            time.sleep(timeout)
            return None
        self.given += 1
        return structs.replace(step, t=self.begun + self.pace * self.given)

    def counters(self) -> dict[str, int]:
        return {}

    def complaints(self) -> list[str]:
        return ["arm_1_joint: EMCY 0x2310"]

    def close(self) -> None:
        self.closed += 1


class Wire:
    """Remembers what is published."""

    def __init__(self) -> None:
        self.raw: list[bytes] = []
        self.slow: dict[str, list[Any]] = {}
        self.handlers: dict[str, Callable[[str, bytes], None]] = {}
        self.ears: dict[str, Callable[[str, bytes], None]] = {}  # others who hear what is published, by key

    def fast(self, name: str) -> Callable[[bytes], None]:
        def publish(data: bytes) -> None:
            self.raw.append(data)
            self.ears.get(name, lambda *_: None)(name, data)

        return publish

    def put(self, name: str, data: bytes | str, *, must_arrive: bool = False) -> None:
        self.slow.setdefault(name, []).append(json.loads(data))
        self.ears.get(name, lambda *_: None)(name, bytes(data))  # type: ignore[arg-type]

    def subscribe(self, name: str, handler: Callable[[str, bytes], None]) -> None:
        self.handlers[name] = handler

    def serve(self, name: str, answer: Callable[[], bytes]) -> None:
        assert answer()

    def alive(self, name: str) -> None:
        pass

    @property
    def states(self) -> list[dict[str, Any]]:
        return [unpack(data) for data in self.raw]

    @property
    def words(self) -> list[State]:
        """The states in order, repetitions left out."""
        out: list[State] = []
        for s in self.states:
            if not out or out[-1] is not State(s["state"]):
                out.append(State(s["state"]))
        return out


Made = tuple[Daemon, Arm, Wire]


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Callable[..., Made]]:
    made: list[Daemon] = []

    def build(script: Script, *, publish: dict[str, Any] | None = None, **more: Any) -> Made:
        model = save_model(known_model(), tmp_path / "arm.model.json")
        config = Config(
            str(tmp_path / "arm.model.json"), Bus("hub:1"), data_id=7, stops=Stops(("0",)),
            # json at every cycle: how fast the script runs must not decide what the slow channel shows
            publish=Publish(**{"valid_for_ms": 5000, "stale_ms": 100, "json_hz": 1e9, **(publish or {})}), sha256="ab" * 32, **more,
        )  # fmt: skip
        arm, wire = Arm(script), Wire()
        daemon = Daemon(config, model, arm, wire, DT)
        arm.daemon = daemon
        made.append(daemon)
        return daemon, arm, wire

    yield build
    for d in made:
        d.desk.close()


def samples(count: int = 20, k0: int = 0) -> list[Sample]:
    r = motion(0, count)
    return [Sample(k0 + k, 0.0, r.q[k], r.dq[k], r.tau[k]) for k in range(count)]


def never() -> SampleSource:
    raise AssertionError("the bus was not lost")


def test_states_of_a_quiet_life(make: Callable[..., Made]) -> None:
    daemon, _, wire = make([None, *samples(60), *[None] * 15], publish={"recover_s": 0.0, "evidence_min_s": 0.0})
    assert daemon.run(never) == 0
    daemon.close()
    words = [w for w in wire.words if w is not State.OK]
    # DEGRADED: right after the start no stop bound has been certified yet
    assert words == [State.INIT, State.UNKNOWN, State.DEGRADED, State.FAULT, State.SHUTDOWN]
    stale = next(s for s in wire.states if s["state"] == State.FAULT)
    assert stale["flags"] & Flag.BUS_STALE and stale["stop0_provable"] == 0
    seqs = [s["seq"] for s in wire.states]
    assert seqs == list(range(len(seqs))) and len({s["boot_id"] for s in wire.states}) == 1
    assert len(wire.states) >= 1 + 60 + 15, "a heartbeat goes out when no sample comes"
    assert wire.slow["state/json"][-1]["state"] == "SHUTDOWN"
    kinds = [e["kind"] for e in wire.slow["event"]]
    assert kinds[0] == "bus" and "started" in kinds and kinds[-1] == "stopped", kinds


def test_an_error_in_the_loop_is_published_as_fault_and_survived(make: Callable[..., Made]) -> None:
    daemon, _, wire = make([*samples(5), ValueError("something nobody thought of"), *samples(5, k0=5)])
    assert daemon.run(never) == 0
    assert State.FAULT in wire.words
    assert any("something nobody thought of" in e.get("why", "") for e in wire.slow["event"] if e["kind"] == "fault")
    assert State(wire.states[-2]["state"]) is not State.FAULT, "and the next samples are judged again"


def test_errors_in_a_row_end_the_daemon_for_its_supervisor(make: Callable[..., Made], capsys: pytest.CaptureFixture[str]) -> None:
    daemon, _, wire = make([*samples(3), *[RuntimeError("broken")] * (MAX_FAULTS + 5)])
    assert daemon.run(never) == 3
    assert sum(s["state"] == State.FAULT for s in wire.states) == MAX_FAULTS and "broken" in capsys.readouterr().err


def test_an_error_inside_the_check_is_fault(make: Callable[..., Made]) -> None:
    bad = structs.replace(samples(6)[5], q=np.zeros(7))
    daemon, _, wire = make([*samples(5), bad])
    daemon.run(never)
    assert wire.words[-1] is State.FAULT and wire.states[-1]["conformance"] in (0, 3)


def test_a_lost_bus_is_fault_until_it_is_back(make: Callable[..., Made]) -> None:
    daemon, first, wire = make([*samples(5), BusError("cable out")])
    second = Arm([*samples(5)])
    second.daemon = daemon
    tries = iter([BusError("still out"), second])

    def reopen() -> SampleSource:
        step = next(tries)
        if isinstance(step, Exception):
            raise step
        return step

    begin = time.monotonic()
    assert daemon.run(reopen) == 0
    assert first.closed == 1 and time.monotonic() - begin > 0.9, "it does not hammer the bus"
    fault = [s for s in wire.states if s["state"] == State.FAULT]
    assert len(fault) > 30, "and it keeps saying so"
    assert wire.slow["state/json"][-1]["samples"] == 10 or wire.words[-1] is not State.FAULT


def test_what_a_lost_bus_had_dropped_is_dropped_since_the_start(make: Callable[..., Made]) -> None:
    """Every bus that was opened anew began at none again."""
    daemon, first, wire = make([*samples(2), BusError("cable out")])
    second = Arm([*samples(2)])
    second.daemon, first.dropped, second.dropped = daemon, 3, 2
    assert daemon.run(lambda: second) == 0
    counts = [s["dropped"] for s in wire.states]
    assert counts == sorted(counts) and set(counts) == {3, 5}


class Silent:
    """A bus on which nobody says anything."""

    def recv(self, timeout: float) -> None:
        return None

    def close(self) -> None:
        """Nothing is open."""


def test_a_reset_of_a_violation_clears_no_emergency_behind_it(make: Callable[..., Made], monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody says of a drive what they have not seen, not with an order that comes twice either; and what is cleared may come anew."""
    monkeypatch.setattr(clearing, "HIDDEN", 0.2)
    daemon, _, wire = make([])
    source = daemon.source = CanSource(Silent(), load_profile("lwa4p/monitor"), DT)
    emergency, order = (0x085, b"\x10\x23\x03\0\0\0\0\0", time.time()), b'{"name": "A. Person", "reason": "seen"}'
    source.decoder.frame(*emergency)
    daemon.latch.record.why, daemon.latch.record.count = "a measurement was outside its prediction", 3

    def ordered() -> tuple[bool, dict[str, int]]:
        wire.handlers["reset"]("x/reset", order)
        daemon.cycle()
        daemon.publisher._said.clear()
        return daemon.latch.latched, daemon.latch.record.emergencies

    both = {"arm_3_joint": 0x2310}
    time.sleep(0.3)
    assert ordered() == (False, both)
    assert ordered() == (False, both) and "come to light" in wire.slow["event"][-1]["why"]
    time.sleep(0.3)
    assert ordered() == (False, {}) and source.decoder.nodes.in_force == {}
    cleared, refused, dismissed = [e for e in wire.slow["event"] if "reset" in e["kind"]]
    assert (cleared["cleared"], cleared["emergencies"], refused["kind"]) == (3, {}, "reset_refused")
    assert (dismissed["cleared"], dismissed["emergencies"]) == (0, {"arm_3_joint": "0x2310"})
    source.decoder.frame(*emergency)
    assert ordered() == (False, both), "an order that was under way when it came is not about it"
    time.sleep(0.3)
    source.decoder.frame(0x085, b"\x10\x43\x03\0\0\0\0\0", time.time())
    assert ordered() == (False, {"arm_3_joint": 0x4310}), "nor about another emergency of the same drive"
    both = {"arm_3_joint": 0x4310}
    # another bus in its place has not heard it, and is told
    opened = CanSource(Silent(), load_profile("lwa4p/monitor"), DT)
    daemon.source = NoSource(load_profile("lwa4p/monitor"), time.monotonic() + 60)
    daemon._lost_bus("the bus is gone", lambda: opened)
    assert daemon.source is opened and opened.decoder.nodes.in_force == both


def test_refuted_model_withdraws_its_numbers_for_the_stated_fallback(make: Callable[..., Made]) -> None:
    r = motion(1, 60)
    tau = r.tau.copy()
    tau[:, 4] *= 1.5
    script: Script = [Sample(k, 0.0, r.q[k], r.dq[k], tau[k]) for k in range(60)]
    daemon, _, wire = make(script, fallback=Fallback(time_s=1.5, angle_rad=0.7, tcp_m=0.9))
    daemon.run(never)
    last = wire.states[-2]
    assert State(last["state"]) is State.VIOLATION and last["first_joint"] == 5
    assert last["stop0_time_max"] == 1.5 and last["stop0_provable"] == 0 and last["flags"] & Flag.FALLBACK_IN_FORCE
    assert last["stop0_angle_forward"][0] >= 0.7 and last["stop0_tcp"] >= 0.9
    event = next(e for e in wire.slow["event"] if e["kind"] == "violation")
    assert event["violations"][0]["joint"] == "arm_5_joint"
    k, _, q, dq, u = event["evidence"][-1]
    assert np.allclose(q, r.q[k]) and np.allclose(dq, r.dq[k]) and np.allclose(u, tau[k]), "the evidence is the measurement"


def test_systemd_hears_ready_watchdog_and_stopping(make: Callable[..., Made], tmp_path: Path, monkeypatch: Any) -> None:
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as s:
        s.bind(str(path))
        s.setblocking(False)
        monkeypatch.setitem(os.environ, "NOTIFY_SOCKET", str(path))
        daemon, _, wire = make(samples(8))
        heard: list[str] = []
        wire.put = lambda *a, **k: heard.extend(drain(s))  # type: ignore[method-assign]
        daemon.run(never)
        daemon.close()
        heard += drain(s)
    assert heard[0].startswith("READY=1") and heard.count("WATCHDOG=1") >= 3 and "STOPPING=1" in heard
    assert len(wire.states) >= 8


def drain(s: socket.socket) -> list[str]:
    out = []
    try:
        while True:
            out.append(s.recv(4096).decode())
    except BlockingIOError:
        return out


def test_evidence_is_asked_for_as_the_model_of_now_allows(make: Callable[..., Made]) -> None:
    """A model of longer predictions had been held against those of half the first one's horizon only: OK too soon."""
    daemon, _, wire = make([], publish={"evidence_min_s": 0.15})
    assert daemon.limits.evidence == 0.15
    horizons = [0.04, 0.4]
    daemon.reloading.load = lambda: known_model(horizon=horizons.pop(0))
    for k, evidence in enumerate((0.5 * 0.04, 0.15)):
        daemon.reloading.asked = True
        assert wait(lambda n=k: daemon.cycle() or [e["kind"] for e in wire.slow["event"]].count("reloaded") > n)  # type: ignore[misc]
        assert daemon.limits.evidence == pytest.approx(evidence) and daemon.verdict is None
    daemon.close()


def test_a_reload_asked_for_while_one_is_under_way_comes_after_it() -> None:
    """The file may have become another since it was read."""
    begun, go = [0], threading.Event()

    def load() -> Model:
        begun[0] += 1
        go.wait(60.0)
        raise NotCovered(f"model {begun[0]}")

    reloading, answers = Reloading(load, lambda model: pytest.fail("none is loaded")), list[Any]()

    def turn() -> int:
        answers.extend(filter(None, [reloading.turn(("a",))]))
        return len(answers)

    reloading.asked = True
    assert wait(lambda: turn() == 0 and begun[0] == 1)
    reloading.asked = True
    turn()
    go.set()
    assert wait(lambda: turn() == 2) and answers == ["model 1", "model 2"]


def test_a_model_of_another_cycle_is_refused_at_the_start(tmp_path: Path) -> None:
    model = save_model(known_model(), tmp_path / "m.json")
    with pytest.raises(NotCovered, match="cycle"):
        Daemon(Config(str(tmp_path / "m.json"), Bus("hub:1"), data_id=7), model, Arm([]), Wire(), 0.010)


def test_a_bus_that_never_appears_ends_with_a_sentence(tmp_path: Path) -> None:
    save_model(known_model(), tmp_path / "m.json")
    bus = f'[bus]\nlink = "hub:{free_port()}"\nwait_s = 0.3'
    with running("monitor", "--config", str(write_config(tmp_path, tmp_path / "m.json", bus, free_port()))) as p:
        _, err = p.communicate(timeout=600)
    assert p.returncode == 2 and "no hub at" in err and "Traceback" not in err


def test_a_violation_on_the_live_page(make: Callable[..., Made], browser: Any) -> None:
    """What the daemon publishes, through the viewer, in a real browser: readable on a telephone too."""
    from selenium.webdriver.support.ui import WebDriverWait

    from stopset.monitor.viewer import View, ViewerPage

    r = motion(1, 60)
    tau = r.tau.copy()
    tau[:, 4] *= 1.5
    judged: Script = [Sample(k, 0.0, r.q[k], r.dq[k], tau[k]) for k in range(60)]
    daemon, arm, wire = make([*judged, *[None] * 10_000], publish={"json_hz": 20.0})
    view = View()
    view.ask = lambda nonce: wire.handlers["challenge"]("challenge", nonce)
    wire.ears = {"state": view.take_state, "state/json": view.take_json, "event": view.take_event}
    loop = threading.Thread(target=daemon.run, args=(never,))
    loop.start()
    page = ViewerPage(view, "127.0.0.1", 0)
    page.start()
    try:
        for width in (420, 1250):
            size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            browser.get(f"http://127.0.0.1:{page.server_address[1]}/")
            WebDriverWait(browser, 10).until(lambda b: b.find_element("id", "word").text == "VIOLATION")
            beyond = browser.execute_script("return document.documentElement.scrollWidth - document.documentElement.clientWidth")
            assert beyond <= 0, f"{beyond} px beyond a screen of {width} px"
        rows = browser.execute_script("return Array.from(document.querySelectorAll('#joints tr')).map(r => r.innerText)")
        assert ["violation" in r for r in rows[1:]] == [False, False, False, False, True, False]
        assert [e for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        browser.get("about:blank")
        arm.script.clear()
        loop.join()
        page.shutdown()
        page.server_close()


@pytest.mark.parametrize(("pace", "good"), [(1.0, True), (1.05, False)])
def test_there_is_no_ok_before_it_is_known_how_fast_samples_come(make: Callable[..., Made], pace: float, good: bool) -> None:
    """Of a bus of another cycle than the model's the first ones were OK, until enough had come to tell."""
    daemon, arm, wire = make(samples(60), publish={"recover_s": 0.0, "evidence_min_s": 0.0})
    arm.pace = pace * DT
    daemon.run(never)
    assert bool({State.OK, State.DEGRADED} & set(wire.words)) == good
    assert any("whether samples come at the model's steps" in t["why"] for t in wire.slow["state/json"])


@pytest.mark.skipif(sys.platform != "linux", reason="processes of Linux")
def test_a_violation_is_latched_whatever_fails_in_its_cycle(make: Callable[..., Made]) -> None:
    """What bounds stops had ended, and the machine had no descriptor for another one: the sample's violation went with the error."""
    import resource

    good = samples(60)
    good[50] = structs.replace(good[50], q=good[50].q + 0.5)
    daemon, arm, wire = make([])
    arm.script = [*good[:50], None]
    while arm.script:
        daemon.cycle()
    assert not daemon.latch.latched and wait(lambda: daemon.desk._ready or daemon.desk._inbox)
    daemon.desk._process.kill()
    assert wait(lambda: "ended" in daemon.desk._inbox)
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    arm.script, seen = good[50:52], daemon.desk.restarts
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (3, before[1]))
        daemon.run(never)
        assert wait(lambda: daemon.desk.offer(time.time(), good[52].q, good[52].dq) or "cannot be begun" in daemon.desk.why)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
    assert daemon.latch.latched and daemon.latch.count == 1 and State(wire.states[-1]["state"]) is State.VIOLATION
    assert daemon.tally.faults == 0 and daemon.desk.restarts == seen + 1
    # as soon as the machine has one, it goes on
    assert wait(lambda: daemon.desk.offer(time.time(), good[52].q, good[52].dq) or daemon.desk._ready)


def test_an_order_that_names_no_message_clears_no_violation_that_nobody_can_have_seen(make: Callable[..., Made]) -> None:
    """It was under way when the arm left its model, and cleared that before it was told."""
    good = samples(62)
    good[50] = structs.replace(good[50], q=good[50].q + 0.5)
    daemon, arm, wire = make([])
    arm.script = good[:51]
    for _ in range(50):
        daemon.cycle()
    assert not daemon.latch.latched
    order = b'{"name": "A. Person", "reason": "seen"}'
    wire.handlers["reset"]("x/reset", order)
    daemon.cycle()
    assert daemon.latch.latched and State(wire.states[-1]["state"]) is State.VIOLATION
    assert "only now" in wire.slow["event"][-1]["why"] and wire.slow["event"][-1]["kind"] == "reset_refused"
    time.sleep(clearing.REACTION + 0.05)
    arm.script = [None]
    wire.handlers["reset"]("x/reset", order)
    daemon.cycle()
    assert not daemon.latch.latched


def test_a_message_is_stamped_with_the_instant_it_was_judged_for(make: Callable[..., Made]) -> None:
    """A daemon stopped after it had judged, and stamping when it was woken two seconds later, said OK of a moment nobody had looked at."""
    daemon, _, wire = make(samples(60), publish={"recover_s": 0.0, "evidence_min_s": 0.0})
    judged: list[int] = []
    packed = daemon._message.changing

    def stopped_here(*turn: Any) -> Any:
        judged.append(time.time_ns())
        time.sleep(1e-3)
        return packed(*turn)

    daemon._message.changing = stopped_here  # type: ignore[method-assign]
    daemon.run(never)
    assert {State.OK, State.DEGRADED} & set(wire.words) and len(judged) == len(wire.states)
    assert all(s["t_pub_ns"] <= at for s, at in zip(wire.states, judged, strict=True))


@pytest.mark.parametrize(("recover", "flaps"), [(0.0, True), (LEAST_RECOVER, False)])
def test_good_cycles_between_bad_ones_are_no_ok(make: Callable[..., Made], recover: float, flaps: bool) -> None:
    """Of drives that leave out the torque of every fourth cycle: why a configuration with no time to recover is refused."""
    script = [s if k < 40 or k % 4 else structs.replace(s, tau=None) for k, s in enumerate(samples(90))]
    daemon, _, wire = make(script, publish={"recover_s": recover, "evidence_min_s": 0.0})
    daemon.run(never)
    later = [s["state"] for s in wire.states if s["t_meas_ns"] > wire.states[-1]["t_meas_ns"] - 40 * DT * 1e9]
    assert State.UNKNOWN in later and bool({State.OK, State.DEGRADED} & set(later)) == flaps


def test_a_model_whose_file_became_another_while_it_was_read_is_not_taken(make: Callable[..., Made], tmp_path: Path) -> None:
    """Who asks the monitor for its model gets the one that is watched with."""
    daemon, _, wire = make([])
    read = save_model(known_model(horizon=0.2), tmp_path / "as_it_was.json")
    daemon.reloading.load = lambda: read
    daemon.reloading.asked = True
    assert wait(lambda: daemon.cycle() or [e for e in wire.slow["event"] if e["kind"].startswith("reload")], 10.0)  # type: ignore[func-returns-value]
    (told,) = [e["why"] for e in wire.slow["event"] if e["kind"].startswith("reload")]
    assert "became another file while it was read" in told
