"""The monitor as it is used: daemon, replay and listener are three processes with real CAN framing and real zenoh between."""

from __future__ import annotations

import contextlib
import itertools
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from monitor_arm import known_model, meta, motion, with_torque_scaled
from monitor_process import PREFIX, Ear, PythonReading, environment, expected, free_port, listens, running, stopset, write_config
from patience import Granted, rest, wait
from stopset.artifact import Model, save_model
from stopset.errors import BusError
from stopset.monitor.clearing import REACTION
from stopset.monitor.config import load_config
from stopset.monitor.consumer import Fault
from stopset.monitor.layout import State, unpack
from stopset.monitor.links.hub import HubClient
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.monitor.profile import load_profile
from stopset.monitor.source import CanSource
from stopset.recording import write_recordings

TRIALS, SAMPLES = 2, 200
Place = Callable[[int | None], tuple[Path, Path, Model]]


@pytest.fixture
def place(tmp_path: Path) -> Place:
    def make(scaled: int | None) -> tuple[Path, Path, Model]:
        model = save_model(known_model(), tmp_path / "arm.model.json")
        trials = [motion(s, SAMPLES, s) for s in range(TRIALS)]
        if scaled is not None:
            trials = [with_torque_scaled(r, scaled, 1.5) for r in trials]
        write_recordings(tmp_path / "rec.parquet", meta(), trials)
        return tmp_path / "arm.model.json", tmp_path / "rec.parquet", model

    return make


class Witness:
    """Another listener on the bus, with the monitor's decoder: ``k`` are the numbers of the cycles that are whole and beyond doubt.

    Which these are is for the wire to say: one that a busy machine's sender takes longer than a period for, at the beginning or the
    end of all, leaves a doubt, and whoever listens gets a cycle less.
    """

    def __init__(self, port: int, config: Path) -> None:
        assert wait(lambda: listens(port))
        profile = load_profile(load_config(config).bus.profile)
        self._source = CanSource(HubClient("127.0.0.1", port), profile, profile.cycle_s)
        self.k: list[int] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        with contextlib.suppress(BusError), contextlib.closing(self._source):  # the hub closes after the last frame
            while True:
                if sample := self._source.next(0.1):
                    self.k.append(sample.k)

    def end(self) -> tuple[int, int]:
        """How many cycles there were, and gaps between them."""
        self._thread.join()
        return len(self.k), sum(b != a + 1 for a, b in itertools.pairwise(self.k))


@pytest.mark.parametrize("scaled", [None, 3])
def test_replay_over_can_is_judged_and_published(place: Place, scaled: int | None, tmp_path: Path) -> None:
    model_path, recording, model = place(scaled)
    bus, port = free_port(), free_port()
    config = write_config(tmp_path, model_path, f'[bus]\nlink = "hub:{bus}"', port)
    with (
        running("monitor", "--config", str(config)),
        Ear(port) as ear,
        running("replay", str(recording), "--to", f"hub:{bus}", "--wait", "2") as replay,
    ):
        witness = Witness(bus, config)
        out, err = replay.communicate(timeout=600)
        assert replay.returncode == 0, err
        cycles, gaps = witness.end()
        assert TRIALS * (SAMPLES - 3) <= cycles < TRIALS * SAMPLES, (
            "a running bus gives no first sample; doubt takes one at each end"
        )
        assert "the other nodes sent 0 frames" in out, "the monitor must not send on the bus"

        def dropped() -> int:
            return int(unpack(ear.raw[-1])["dropped"])

        # a machine that stood still for a second has dropped what had become older than it is valid for, and counted it
        assert ear.wait(lambda: ear.twins and ear.twins[-1]["samples"] + dropped() == cycles), (
            ear.twins and (ear.twins[-1]["samples"], ear.twins[-1]["gaps"], ear.twins[-1]["verdicts"]), dropped(), ear.events[-4:],
        )  # fmt: skip
        twin = ear.twins[-1]
        if dropped():
            pytest.skip(f"this machine stood still: {dropped()} samples dropped")
        (reply,) = ear.link.get("model")
        assert reply[1] == model_path.read_bytes()
    assert twin["model_sha256"] == model.sha256 and twin["gaps"] == gaps >= TRIALS - 1
    if scaled is None:
        assert twin["verdicts"]["VIOLATION"] == 0 == twin["violation_count"] and not twin["violating_joints"]
        # the first, and that after each gap, has nothing to be compared with; all others have
        assert twin["verdicts"]["CONFORMANT"] == cycles - 1 - gaps
        assert State.VIOLATION not in ear.states
    else:
        assert twin["violating_joints"] == [model.joints[scaled]], "and no other joint"
        assert State.VIOLATION in ear.states
        (event, *_) = [e for e in ear.events if e["kind"] == "violation"]
        assert event["violations"][0]["joint"] == model.joints[scaled] and len(event["evidence"]) > 1
        last = unpack(ear.raw[-1])
        assert last["first_joint"] == scaled + 1 and last["violation_count"] == twin["violation_count"] > 0
        assert last["stop0_time_max"] == float("inf") and last["stop0_provable"] == 0, "stop numbers are withdrawn"


def test_a_foreign_sniffer_sees_canopen_frames(place: Place) -> None:
    """Read with python-can alone, decoded by hand: what any other tool on the bus would see."""
    _, recording, model = place(None)
    port = free_port()
    with running("replay", str(recording), "--to", f"hub:{port}", "--wait", "1"):
        assert wait(lambda: listens(port))
        bus = can.Bus(interface="socketcand", host="127.0.0.1", port=port, channel="can0")
        frames = []
        while len(frames) < 13 * 20 and (m := bus.recv(5.0)) is not None:
            frames.append(m)
        bus.shutdown()
    assert len(frames) == 13 * 20
    assert [m.arbitration_id for m in frames[:13]] == [0x080, *(x for i in range(3, 9) for x in (0x380 + i, 0x480 + i))]
    assert [m.data[0] for m in frames[::13]] == list(range(1, 21)), "the SYNC counter"
    first = motion(0, SAMPLES, 0)
    for k in range(20):
        for i in range(6):
            data = bytes(frames[13 * k + 1 + 2 * i].data)
            mdeg = int.from_bytes(data[:4], "little", signed=True)
            assert abs(mdeg * 3.141592653589793 / 180e3 - first.q[k, i]) < 1e-5  # half a millidegree, and float32
            torque = int.from_bytes(bytes(frames[13 * k + 2 + 2 * i].data)[:2], "little", signed=True)
            rated = model.robot.torque_limit[i] / 4  # the profile's prior
            assert abs(torque * 1e-3 * rated - first.tau[k, i]) < 0.51e-3 * rated + 1e-5


def test_killed_or_frozen_monitor_is_noticed(place: Place, tmp_path: Path) -> None:
    model_path, recording, _ = place(None)
    bus, port = free_port(), free_port()
    config = write_config(tmp_path, model_path, f'[bus]\nlink = "hub:{bus}"', port)
    with (
        running("replay", str(recording), "--to", f"hub:{bus}", "--loop"),
        running("monitor", "--config", str(config)) as monitor,
        Ear(port) as ear,
        contextlib.closing(PythonReading(lambda n: ear.link.put("challenge", n), expected(config), 500)) as consumer,
    ):
        ear.link.subscribe("state", lambda _, d: consumer.take(d))
        good = (State.OK, State.DEGRADED, State.UNKNOWN)
        assert ear.wait(lambda: consumer.now in good)
        ear.link.put("challenge", b"\1\2\3")
        assert ear.wait(lambda: any(e["nonce"] == "010203" for e in ear.echoes))
        monitor.send_signal(signal.SIGSTOP)
        # a machine that stood still before may have ended the proof first: what is asked is that the silence is told
        assert ear.wait(lambda: (consumer.now, consumer.consumer.why) == (State.FAULT, Fault.SILENT), 3.0)
        ear.link.put("challenge", b"\4\5\6")
        time.sleep(0.3)
        assert not any(e["nonce"] == "040506" for e in ear.echoes), "a frozen monitor answers no nonce"
        monitor.send_signal(signal.SIGCONT)
        assert ear.wait(lambda: consumer.now in good, 10.0)
        monitor.kill()
        assert ear.wait(lambda: consumer.now is State.FAULT, 3.0)


def test_joint_states_over_zenoh(place: Place, tmp_path: Path) -> None:
    model_path, recording, model = place(2)
    port = free_port()
    config = write_config(tmp_path, model_path, '[joint_states]\nkey = "ros/joint_states"\ncycle_s = 0.004', port)
    with running("monitor", "--config", str(config)), Ear(port) as ear:
        replay = stopset(
            "replay", str(recording), "--to", f"zenoh:tcp/127.0.0.1:{port}", "--key", "ros/joint_states", "--encoding", "cdr"
        )
        _, err = replay.communicate(timeout=600)
        assert replay.returncode == 0, err
        assert ear.wait(lambda: ear.twins and ear.twins[-1]["samples"] > 0.9 * TRIALS * SAMPLES)
        assert ear.wait(lambda: ear.twins[-1]["violating_joints"] == [model.joints[2]])
        time.sleep(2.0 * REACTION)  # the last of it is told: who orders sooner cannot have seen it
        ear.link.put("reset", b'{"name": "", "reason": "no name"}')
        assert ear.wait(lambda: any(e["kind"] == "reset_refused" for e in ear.events))
        assert ear.twins[-1]["violation_latched"]
        ear.link.put("reset", b'{"name": "A. Person", "reason": "wrong torque constant found"}')
        assert ear.wait(lambda: not ear.twins[-1]["violation_latched"])
        assert ear.wait(lambda: any(e["kind"] == "reset" for e in list(ear.events)))
        (event,) = [e for e in ear.events if e["kind"] == "reset"]
        assert event["name"] == "A. Person" and event["joints"] == [model.joints[2]]


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_what_runs_until_it_is_ended_ends_in_order(place: Place, how: signal.Signals) -> None:
    """As a service manager ends it, and by Ctrl-C: what was opened is closed, and nothing is complained of."""
    # a background job of a shell, as these tests may be, hands on that the signal is ignored
    signal.signal(signal.SIGINT, signal.default_int_handler)
    _, recording, _ = place(None)
    port, bus = free_port(), free_port()
    with (
        contextlib.closing(ZenohLink(PREFIX, listen=[f"tcp/127.0.0.1:{port}"])),
        running("watch", "--connect", f"tcp/127.0.0.1:{port}", "--port", "0") as watch,
        running("replay", str(recording), "--to", f"hub:{bus}", "--loop") as replay,
    ):
        assert watch.stdout is not None
        assert watch.stdout.readline(), "it shows something"
        assert wait(lambda: listens(bus))
        for process in (watch, replay):
            process.send_signal(how)
        (_, err), (out, complaint) = watch.communicate(timeout=60), replay.communicate(timeout=60)
    assert (watch.returncode, err) == (0, "")
    assert (replay.returncode, out, complaint) == (0, "ended\n", "")


@pytest.mark.parametrize(
    "shell", ["exec {} >&- 2>&-", "exec {} <&- >&- 2>&-", "exec {} >/dev/full 2>/dev/full", "exec {} > >(true) 2> >(true)"]
)
def test_a_monitor_whose_words_nobody_takes_watches_on(place: Place, tmp_path: Path, shell: str) -> None:
    """Standard output and error closed, on a full disk, or read by a journal that died: it watches, accuses, records, and ends in order."""
    model_path, recording, _ = place(3)
    bus, port = free_port(), free_port()
    config = write_config(tmp_path, model_path, f'[bus]\nlink = "hub:{bus}"', port)
    words = shell.format(shlex.join([sys.executable, "-m", "stopset.cli.main", "monitor", "--config", str(config)]))
    with running("replay", str(recording), "--to", f"hub:{bus}", "--loop"):
        monitor = subprocess.Popen(["bash", "-c", words], env=environment())
        try:
            with Ear(port) as ear:
                assert ear.wait(lambda: State.VIOLATION in ear.states[-5:])
                assert ear.wait(lambda: any(e["kind"] == "bundle" for e in list(ear.events))), "its record is on the disk"
                (bundle,) = [e for e in ear.events if e["kind"] == "bundle"]
                assert bundle["file"] and not bundle["why"]
                monitor.send_signal(signal.SIGTERM)
                assert monitor.wait(60) == 0 and ear.states[-1] is State.SHUTDOWN
        finally:
            if monitor.poll() is None:
                monitor.kill()
                monitor.wait()


def test_a_bus_that_takes_its_time_to_open_holds_up_no_heartbeat(place: Place, tmp_path: Path) -> None:
    """Somebody listens where the bus was, and says nothing: the try to open it took 5 s, and nothing was published meanwhile."""
    model_path, recording, _ = place(None)
    bus, port = free_port(), free_port()
    config = write_config(tmp_path, model_path, f'[bus]\nlink = "hub:{bus}"', port)
    words, good = ("replay", str(recording), "--to", f"hub:{bus}", "--loop"), {State.OK, State.DEGRADED}
    with running("monitor", "--config", str(config)) as monitor, Ear(port) as ear, Granted() as granted:
        with running(*words):
            assert ear.wait(lambda: good & set(ear.states[-5:]))
        with socket.create_server(("127.0.0.1", bus)):
            assert ear.wait(lambda: ear.states[-1] is State.FAULT)
            begun = len(ear.raw)
            rest(2.0)
            apart = time.time() - time.monotonic()
            made = [unpack(d)["t_pub_ns"] * 1e-9 - apart for d in ear.raw[begun:]]
            assert max(granted.between(a, b) for a, b in itertools.pairwise([*made, time.monotonic()])) < 0.5
            assert monitor.poll() is None and {State.FAULT} == set(ear.states[begun:])
        with running(*words):
            assert ear.wait(lambda: good & set(ear.states[-5:])), "and when it is there again it is used"
