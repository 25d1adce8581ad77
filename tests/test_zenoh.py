"""zenoh and its encodings: joint states in both, and a link between two sessions on loopback."""

from __future__ import annotations

import io
import itertools
import json
import shutil
import sqlite3
import subprocess
import threading
import time
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor_arm import DT, known_model, motion
from monitor_process import free_port
from patience import rest, wait
from state_messages import pack
from stopset.cli.main import main
from stopset.errors import BusError
from stopset.monitor.consumer import SAYS, Fault
from stopset.monitor.jointstate import JointState, decode, to_cdr, to_json
from stopset.monitor.layout import State
from stopset.monitor.links import zenoh_link
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.monitor.orders import Orders
from stopset.monitor.replay import JointStateSink, play
from stopset.monitor.sample import Sample
from stopset.monitor.source import GAP, JointStateSource
from stopset.monitor.verdict import Conformance
from stopset.monitor.viewer import View, ViewerPage, terminal
from stopset.monitor.watch import Watch
from stopset.recording import read_recordings

JOINTS = tuple(f"arm_{i}_joint" for i in range(1, 7))
values = st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=6).map(tuple)


@given(st.integers(0, 2**31 * 10**9 - 1), values, values, values)
def test_both_encodings_lose_nothing(stamp: int, q: tuple[float, ...], dq: tuple[float, ...], tau: tuple[float, ...]) -> None:
    s = JointState(stamp, JOINTS, q, dq, tau)
    assert decode(to_json(s)) == s == decode(to_cdr(s))


def test_cdr_is_laid_out_as_ros_2_writes_it() -> None:
    """By hand from the CDR rules: alignment counts from the end of the 4-byte encapsulation."""
    want = bytes.fromhex(
        "00010000"  # little endian
        "01000000" "02000000"  # stamp 1 s, 2 ns
        "01000000" "00"  # frame_id ""
        "000000" "01000000"  # one name
        "02000000" "6100"  # "a"
        "0000" "01000000"  # one position
        "000000000000f03f"  # 1.0, at an offset of 32
        "00000000" "00000000"  # no velocity, no effort
    )  # fmt: skip
    assert to_cdr(JointState(1_000_000_002, ("a",), (1.0,), (), ())) == want


def test_a_replayed_stop_accuses_no_good_arm() -> None:
    """A drive that holds no torque is told by a message without one: what brakes do to the arm is no violation then."""
    r, at, model = motion(0, 300), 200, known_model()
    braked = r.dq * np.clip(1.0 - (np.arange(300) - at) / 40, 0.0, 1.0)[:, None] ** (np.arange(300) >= at)[:, None]
    q = r.q + np.cumsum(np.where((np.arange(300) >= at)[:, None], braked - r.dq, 0.0), axis=0) * DT
    stop = replace(r, phase="stop0", q=q, dq=braked, stop_trigger=np.arange(300) >= at)
    for cdr, told in itertools.product((False, True), (stop, replace(stop, stop_trigger=None))):
        source, watch = JointStateSource(model.joints, DT, backlog=300), Watch(model)
        play([told], JointStateSink(lambda data, s=source: s.take("", data), model.joints, cdr), speed=float("inf"))
        said = [watch.step(s) for _ in range(300) if (s := source.next(0.0)) is not None]
        violations = sum(v.conformance is Conformance.VIOLATION for v in said)
        if told is stop:
            assert not violations and {v.why for v in said[at:]} == {"no torque in the signals"}
        else:
            assert violations, "and a recording that does not say it looks like another arm"


@given(st.binary(max_size=80))
def test_garbage_is_refused_with_a_sentence(data: bytes) -> None:
    try:
        decode(b"\0\1\0\0" + data)
    except BusError as e:
        assert "joint_states" in str(e)


def message(k: float, names: tuple[str, ...] = JOINTS) -> bytes:
    row = tuple(float(i) for i in range(len(names)))
    return to_json(JointState(round(k * 4_000_000), names, row, row, row))


def test_samples_follow_names_and_stamps_show_gaps() -> None:
    source = JointStateSource(JOINTS, 0.004)
    shuffled = tuple(reversed((*JOINTS, "gripper")))
    for k in (1, 2, 5, 5.1, 6.1):
        source.take("", message(k, shuffled))
    source.take("", b"rubbish")
    source.take("", message(7.1))
    got = [source.next(0.0) for _ in range(7)]
    assert [s.k for s in got[:3] if s] == [1, 2, 5]
    first = got[0]
    assert first is not None and first.q.tolist() == [6, 5, 4, 3, 2, 1]
    assert got[3] is not None and got[3].k == 5 + GAP, "a stamp that belongs to no cycle is a gap"
    assert got[5] is None and source.refused == 1 and source.next(0.0) is None
    assert got[6] is not None and got[6].q.tolist() == [0, 1, 2, 3, 4, 5]


def test_what_a_busy_machine_sent_late_does_not_stay_late() -> None:
    """A replay that could not keep pace is stamped as now at its next trial: a monitor would call all that follows too old."""
    seen: list[tuple[int, int]] = []

    class Slow:
        stamped = True

        def sample(self, values: object, stamp_ns: int) -> None:
            seen.append((stamp_ns, time.time_ns()))
            time.sleep(0.012 if len(seen) <= 25 else 0.0)

        def pause(self, cycles: int) -> None: ...
        def close(self) -> None: ...

    play([motion(s, 25, s) for s in range(3)], Slow())
    behind = [(now - stamp) * 1e-9 for stamp, now in seen]
    assert behind[24] > 0.1, "within a trial stamps keep the rhythm of the recording"
    assert abs(behind[25]) < 0.05 and abs(behind[50]) < 0.05
    stamps = [stamp for stamp, _ in seen]
    assert stamps == sorted(stamps)


def test_two_sessions_on_loopback() -> None:
    port = free_port()
    daemon = ZenohLink("s/c/a/stopset", listen=[f"tcp/127.0.0.1:{port}"])
    heard: list[tuple[str, bytes]] = []
    tokens: list[bool] = []
    consumer = ZenohLink("s/c/a/stopset", mode="client", connect=[f"tcp/127.0.0.1:{port}"])
    try:
        consumer.subscribe("**", lambda k, d: heard.append((k, d)))
        consumer.watch_alive("alive", lambda _, there: tokens.append(there))
        send = daemon.fast("state")
        daemon.serve("model", lambda: b"the model")
        daemon.alive("alive")
        assert wait(lambda: tokens == [True])
        for i in range(100):
            send(bytes([i]))
            rest(0.002)  # a fast message is dropped where it would have to wait: sequence numbers tell it
        daemon.put("event", b"{}", must_arrive=True)
        wait(lambda: len(heard) >= 101, 5.0)
        states = [d[0] for k, d in heard if k == "s/c/a/stopset/state"]
        assert states == sorted(set(states)) and len(states) > 50, "none twice, none swapped"
        assert ("s/c/a/stopset/event", b"{}") in heard
        assert consumer.get("model") == [("s/c/a/stopset/model", b"the model")] and tokens == [True]
        daemon.close()
        assert wait(lambda: tokens == [True, False]), "the liveliness token goes with its session"
    finally:
        consumer.close()
    with pytest.raises(BusError, match="no zenoh session with"):
        ZenohLink(mode="client", connect=[f"tcp/127.0.0.1:{port}"])


def test_a_session_that_does_not_close_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once in some hundred ends a real one did not, with a query on its way; on demand it cannot be had, so one that waits stands for it."""

    class Stuck:
        over = threading.Event()

        def close(self) -> None:
            self.over.wait()

    link = ZenohLink("s")
    link.close()  # the real one ends
    monkeypatch.setattr(zenoh_link, "PATIENCE", 0.2)
    link._session = Stuck()  # type: ignore[assignment]
    began = time.monotonic()
    link.close()
    assert time.monotonic() - began < 5.0
    Stuck.over.set()


def test_a_message_longer_than_any_is_never_taken_over() -> None:
    """Copying 300 MB from zenoh stops every thread of Python: the loop was silent for 0.9 s."""
    port = free_port()
    daemon = ZenohLink("a", listen=[f"tcp/127.0.0.1:{port}"], longest=1000)
    sender = ZenohLink("a", mode="client", connect=[f"tcp/127.0.0.1:{port}"])
    heard: list[bytes] = []
    try:
        daemon.subscribe("challenge", lambda _, d: heard.append(d))
        rest(0.2)
        for length in (1000, 1001, 40_000_000):
            sender.put("challenge", b"x" * length, must_arrive=True)
        assert wait(lambda: len(heard) == 3), [len(d) for d in heard]
        assert [len(d) for d in heard] == [1000, 1001, 1001] and set(heard[2]) == {0}
    finally:
        daemon.close()
        sender.close()
    orders = Orders()
    orders.take("a/challenge", bytes(65537))
    orders.take("a/reset", bytes(65537))
    assert orders.dropped == 1 and orders.challenges() == [] and orders.reset() == (None,)


TWIN = {
    "state": "OK", "why": "inside every prediction", "data_id": 1, "joints": list(JOINTS), "violations": [], "gaps": 0,
    "room": dict.fromkeys(JOINTS, 0.5), "verdicts": {"CONFORMANT": 3}, "oldest_prediction_s": 0.4,
    "notice": "not a safety function",
    "stops": {"0": {"time_s": 0.1, "tcp_m": 0.02, "why": "", "certified": True, "joints": {
        j: {"time_s": 0.1, "forward_rad": 0.01, "back_rad": 0.0} for j in JOINTS}}},
}  # fmt: skip


def test_the_viewer_shows_what_holds_now_and_nothing_older() -> None:
    from rich.console import Console

    def text() -> str:
        console = Console(width=150, record=True, file=io.StringIO())
        console.print(terminal(view))
        return console.export_text()

    asked: list[bytes] = []
    view = View(watchdog_s=2.0, ask=asked.append)
    assert view.word()[0] == "NO DATA"
    view.take_json("", json.dumps(TWIN).encode())
    answer = {"data_id": 1, "boot_id": 3, "state": int(State.OK), "valid_for_ms": 1000}

    def hear(seq: int, **more: object) -> None:
        now = time.time_ns()
        view.take_state("", pack({**answer, "seq": seq, "t_meas_ns": now, "t_pub_ns": now, **more}))

    hear(1)
    assert view.word() == ("NO DATA", SAYS[Fault.UNPROVEN]), "nobody has answered a challenge: it could be an old recording"
    hear(2, nonces=(0, int.from_bytes(asked[-1], "little")))
    assert view.word()[0] == "OK" and "inside every prediction" in view.word()[1] and "not checked" in view.word()[1]
    for rubbish in (b"{", b"\xff", b"[]", b'{"state": 3}', b'{"kind": 1}', b"[" * 100_000, b'{"a":' * 50_000):
        for take in (view.take_json, view.take_event, view.take_health, view.take_state):
            take("", rubbish)
    assert view.word()[0] == "OK"
    assert "100 ms" in text() and "20 mm" in text() and "not a safety function" in text()
    page = ViewerPage(view, "127.0.0.1", 0)
    page.start()
    base = f"http://127.0.0.1:{page.server_address[1]}"
    with urllib.request.urlopen(f"{base}/now", timeout=5) as r:
        assert json.load(r)["word"] == "OK"
    with urllib.request.urlopen(base + "/", timeout=5) as r:
        html = r.read().decode()
    assert "http://" not in html and "https://" not in html, "self-contained"
    assert wait(lambda: view.word()[0] == "NO DATA")
    assert view.word()[0] == "NO DATA" and "20 mm" not in text(), "old stop distances are withdrawn"
    with urllib.request.urlopen(f"{base}/stream", timeout=5) as r:
        assert json.loads(r.readline().decode().removeprefix("data: "))["word"] == "NO DATA"
    page.shutdown()
    page.server_close()
    assert np.isfinite(view.twin_at)


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_import_of_bags_returns_the_recording(suffix: str, tmp_path: Path) -> None:
    """Two motions with a pause between them, as CDR in an MCAP file and in a ROS 2 bag."""
    trials = [motion(s, 40, s) for s in range(2)]
    messages = []
    for place, r in enumerate(trials):
        for k in range(len(r.t)):
            stamp = 10**9 * (5 + place) + round(r.t[k] * 1e9)
            messages.append((stamp, to_cdr(JointState(stamp, JOINTS, tuple(r.q[k]), tuple(r.dq[k]), tuple(r.tau[k])))))
    path, out = tmp_path / f"bag{suffix}", tmp_path / "rec.parquet"
    if suffix == ".mcap":
        writer_module = pytest.importorskip("mcap.writer")
        with path.open("wb") as f:
            w = writer_module.Writer(f)
            w.start()
            schema = w.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
            channel = w.register_channel("/joint_states", "cdr", schema)
            for stamp, data in messages:
                w.add_message(channel, stamp, data, stamp)
            w.finish()
    else:
        with sqlite3.connect(path) as db:
            db.execute("create table topics (id integer, name text, type text)")
            db.execute("create table messages (id integer primary key, topic_id integer, timestamp integer, data blob)")
            db.execute("insert into topics values (1, '/joint_states', 'sensor_msgs/msg/JointState')")
            db.executemany("insert into messages (topic_id, timestamp, data) values (1, ?, ?)", messages)
    assert main(["import", str(path), "--out", str(out)]) == 0
    back = read_recordings(out)
    assert len(back) == 2 and back.meta.joints == JOINTS and back.meta.effort == "motor_torque"
    for a, b in zip(trials, back, strict=True):
        # stamps are whole nanoseconds, signals float32
        assert np.abs(a.t - b.t).max() < 1e-9 and np.abs(a.tau - b.tau).max() <= 2.0**-24 * np.abs(a.tau).max()
    assert main(["import", str(path), "--topic", "/other", "--out", str(tmp_path / "no.parquet")]) == 2
    zstandard = pytest.importorskip("zstandard")
    folder = tmp_path / "as_ros_writes_it"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    (folder / f"bag_0{suffix}.zstd").write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()))
    assert main(["import", str(folder), "--out", str(tmp_path / "again.parquet")]) == 0
    assert len(read_recordings(tmp_path / "again.parquet")) == 2


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl to make certificates with")
def test_shipped_access_control_lets_everyone_do_their_part_only(tmp_path: Path) -> None:
    """The shipped router, daemon and PLC files with fresh certificates, on loopback: a PLC cannot forge the state."""
    deploy = Path(__file__).resolve().parents[1] / "deploy/zenoh"
    pki = tmp_path / "pki"
    names = ["stopset-daemon", "stopset-plc", "stopset-operator", "stopset-robot"]
    subprocess.run([str(deploy / "pki/make-certs.sh"), str(pki), "localhost", *names], check=True, capture_output=True)
    port = free_port()
    files = {}
    for name in ("router", "daemon", "plc"):
        text = (deploy / f"{name}.json5").read_text().replace("/etc/stopset/zenoh/pki", str(pki))
        text = text.replace("0.0.0.0:7447", f"127.0.0.1:{port}").replace("router.cell.local:7447", f"127.0.0.1:{port}")
        files[name] = tmp_path / f"{name}.json5"
        files[name].write_text(text)
    operator = tmp_path / "operator.json5"
    operator.write_text(files["plc"].read_text().replace("stopset-plc", "stopset-operator"))
    controller = tmp_path / "robot.json5"
    controller.write_text(files["plc"].read_text().replace("stopset-plc", "stopset-robot"))
    prefix = "site/cell/arm/stopset"
    links = [ZenohLink(prefix, file=f) for f in (files["router"], files["daemon"], files["plc"], operator, controller)]
    _, daemon, plc, person, robot = links
    try:
        heard: dict[str, list[str]] = {"daemon": [], "plc": [], "person": []}
        daemon.subscribe("*", lambda k, d: None)
        for name in ("challenge", "reset"):
            daemon.subscribe(name, lambda k, d: heard["daemon"].append(f"{k.rsplit('/', 1)[-1]} {d.decode()}"))
        plc.subscribe("state", lambda _, d: heard["plc"].append(d.decode()))
        person.subscribe("state", lambda _, d: heard["person"].append(d.decode()))
        daemon.serve("model", lambda: b"the model")
        moved: list[str] = []
        daemon.subscribe("/site/cell/arm/joint_states", lambda _, d: moved.append(d.decode()))
        rest(0.8)
        daemon.put("state", "true")
        for link, who in ((robot, "robot"), (plc, "plc"), (person, "person")):
            link.put("/site/cell/arm/joint_states", f"moved by the {who}")
        for name in ("state", "reset", "challenge", "model"):
            robot.put(name, "not the robot's")
        plc.put("state", "forged by the PLC")
        person.put("state", "forged by a person")
        plc.put("challenge", "nonce")
        plc.put("reset", "not the PLC's")
        person.put("reset", "by a person")
        rest(1.0)
        # a session hears itself without the router; what matters is what reaches the others
        assert sorted(heard["plc"]) == ["forged by the PLC", "true"] and sorted(heard["person"]) == ["forged by a person", "true"]
        assert sorted(heard["daemon"]) == ["challenge nonce", "reset by a person"]
        assert moved == ["moved by the robot"], "who measures the arm is who its certificate says"
        for k in range(200):
            plc.put("challenge", f"flood {k}")
        rest(0.5)
        assert sum("flood" in h for h in heard["daemon"]) < 60, "a flood ends at the router"
        assert plc.get("model") == [(f"{prefix}/model", b"the model")]
        stranger = (
            files["plc"]
            .read_text()
            .replace("connect_certificate", "// connect_certificate")
            .replace("connect_private_key", "// ")
        )
        (tmp_path / "stranger.json5").write_text(stranger)
        with pytest.raises(BusError, match="no zenoh session with"):
            ZenohLink(prefix, file=tmp_path / "stranger.json5")
    finally:
        for link in reversed(links):
            link.close()


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("tcp/127.0.0.1:99999999", "has the port '99999999'"), ("tcp/127.0.0.1:x", "has the port 'x'"),
        ("tcp/127.0.0.1:٧٧", "has the port"), ("127.0.0.1:7447", "no zenoh address"), ("", "no zenoh address"),
        ("carrier/pigeon:1", "no zenoh address"), ("tcp/127.0.0.1:9", "no zenoh session with tcp/127.0.0.1:9 comes about"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("command", ["fleet", "watch"])
def test_an_address_that_is_none_or_answers_nothing_is_told_in_our_words(
    command: str, address: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, "--connect", address, "--port", "0", "--seconds", "0.1"]) == 2
    reported = capsys.readouterr().err
    assert said in reported and "expected" in reported
    for foreign in ("Single", "Json5Err", "Unable to", "Message", "os error"):
        assert foreign not in reported, "zenoh's own words"


def test_a_zenoh_file_that_cannot_be_used_is_told_in_our_words(tmp_path: Path) -> None:
    for text, said in (
        ("{mode:", "no JSON5 at line 1, column 7"),
        ('{mode: "client", fleet: 1}', "has the unknown key fleet"),
        (None, "no such file"),
    ):
        file = tmp_path / "z.json5"
        file.unlink(missing_ok=True)
        if text is not None:
            file.write_text(text)
        with pytest.raises(BusError, match=said):
            ZenohLink(file=file)
    with pytest.raises(BusError, match="cannot be listened on"):
        ZenohLink(listen=["tcp/192.0.2.1:7447"])


def test_reset_by_command_waits_for_the_monitors_word(capsys: pytest.CaptureFixture[str]) -> None:
    """Cleared: exit 0 with the name; refused or unheard: exit 1; no name or reason: a sentence."""
    from stopset.monitor.orders import parse_reset

    port = free_port()
    daemon = ZenohLink("s/c/a/stopset", mode="peer", listen=[f"tcp/127.0.0.1:{port}"], connect=[])
    heard: list[bytes] = []
    words = ["reset", "--connect", f"tcp/127.0.0.1:{port}", "--arm", "s/c/a"]

    def take(_key: str, data: bytes) -> None:
        heard.append(data)
        order = parse_reset(data)
        assert order is not None
        if order.reason == "unheard":
            return
        kind = "reset" if order.reason != "no" else "reset_refused"
        reported = {"kind": kind, "why": "not now" if kind == "reset_refused" else "", "name": order.name, "reason": order.reason}
        daemon.put("event", json.dumps(reported).encode(), must_arrive=True)

    over = threading.Event()

    def live() -> None:
        while not over.wait(0.05):
            daemon.put("state", pack({"data_id": 1, "boot_id": 77, "seq": 5}))

    thread = threading.Thread(target=live)
    thread.start()
    try:
        daemon.subscribe("reset", take)
        assert main([*words, "--name", " A. Turner ", "--reason", "hose refitted"]) == 0
        assert "cleared, reset: by A. Turner: hose refitted" in capsys.readouterr().out
        order = parse_reset(heard[-1])
        assert order is not None and (order.boot_id, order.seq) == (77, 5), "it says which message it is about"
        assert main([*words, "--name", "A. Turner", "--reason", "no"]) == 1
        assert "refused: not now" in capsys.readouterr().out
        assert main([*words, "--name", "A. Turner", "--reason", "unheard"]) == 1
        assert "no monitor has answered" in capsys.readouterr().out
        before = len(heard)
        for name, reason in (("", "x"), ("x", "  "), ("x" * 201, "y")):
            assert main([*words, "--name", name, "--reason", reason]) == 2
            assert "expected 1 to 200 each" in capsys.readouterr().err
        over.set()
        thread.join()
        assert main([*words, "--name", "A. Turner", "--reason", "hose refitted"]) == 2
        assert "no monitor says anything here" in capsys.readouterr().err and len(heard) == before
    finally:
        over.set()
        thread.join()
        daemon.close()


def test_what_a_joint_lacks_is_no_number_in_ros_2() -> None:
    """Its broadcaster publishes NaN for a state interface that a joint has not: all of such an arm's messages were refused."""
    names, nan = (*JOINTS, "gripper"), float("nan")
    row = tuple(float(i) for i in range(len(names)))
    no_gripper, none = (*row[:-1], nan), (nan,) * len(names)

    def heard(q: tuple[float, ...], dq: tuple[float, ...], tau: tuple[float, ...]) -> tuple[Sample | None, list[str]]:
        source = JointStateSource(JOINTS, 0.004)
        source.take("", to_cdr(JointState(4_000_000, names, q, dq, tau)))
        return source.next(0.0), source.complaints()

    found, said = heard(no_gripper, no_gripper, no_gripper)
    assert found is not None and found.tau is not None and list(found.tau) == list(row[:-1]) and not said, (
        "a gripper is not the arm's"
    )
    found, said = heard(row, row, none)
    assert found is not None and found.tau is None and not said, "as a message without effort"
    for q, dq, tau, words in (
        (none, row, row, f"no position of {', '.join(JOINTS)}"), (row, (), row, f"no velocity of {', '.join(JOINTS)}"),
        (row, row, (nan, *row[1:]), f"no effort of {JOINTS[0]}; expected"),
    ):  # fmt: skip
        found, (said, *_) = heard(q, dq, tau)
        assert found is None and words in said and "look at the sender's state interfaces" in said
