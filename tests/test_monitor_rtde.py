"""A Universal Robots controller heard over RTDE: a simulated one, whose protocol the maker's users' own client confirms."""

from __future__ import annotations

import ast
import itertools
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_arm import DT, known_model, motion, with_torque_scaled
from monitor_process import DATA_ID, Ear, free_port, running
from patience import wait
from rtde_server import Controller
from stopset.artifact import save_model
from stopset.errors import BusError
from stopset.monitor.config import ConfigError, Rtde, load_config
from stopset.monitor.layout import State
from stopset.monitor.links.rtde_client import RtdeClient
from stopset.monitor.rtde_source import WANTED, RtdeSource
from stopset.monitor.sample import Sample
from stopset.recording import Recording
from stopset.robot.rigid import gravity_torques

TORQUE = "actual_current_as_torque"


def controller_rows(r: Recording, **more: Any) -> Any:
    """What the controller says of a recording; at its end it begins anew."""

    def state(k: int) -> dict[str, Any]:
        i = k % len(r.t)
        row = {"actual_q": r.q[i], "actual_qd": r.dq[i], TORQUE: r.tau[i], "joint_temperatures": [30.0] * 6}
        return {**row, "actual_current": r.tau[i] / 10.0, "robot_mode": (7,), "safety_status": (1,), **more}

    return state


def with_gravity(r: Recording) -> Recording:
    """The known arm's torque as its motors feel it."""
    robot = known_model().robot
    return replace(r, tau=r.tau + gravity_torques(robot.chain, robot.pi, r.q))


@pytest.fixture
def controller() -> Iterator[Controller]:
    server = Controller(controller_rows(motion(0, 3000)), DT)
    yield server
    server.close()


def heard(source: RtdeSource, count: int, seconds: float = 20.0) -> list[Sample]:
    out: list[Sample] = []

    def more() -> bool:
        while len(out) < count and (s := source.next(0.1)) is not None:
            out.append(s)
        return len(out) == count

    wait(more, seconds)
    return out


THEIRS = """
import sys, rtde_receive
it = rtde_receive.RTDEReceiveInterface("127.0.0.99", 250.0, sys.argv[1].split(","), False, False)
while it.getTimestamp() < 1000.2:
    pass
print([it.getTimestamp(), it.getActualQ(), it.getActualQd(), it.getRobotMode()], flush=True)
it.disconnect()
"""


def test_another_client_understands_the_simulated_controller() -> None:
    """`ur-rtde` of SDU Robotics, which speaks to real ones; its port is fixed, so an address of its own is taken."""
    pytest.importorskip("rtde_receive", reason="ur-rtde is not installed")
    r, names = motion(0, 3000), "timestamp,actual_q,actual_qd,robot_mode,safety_status"
    server = Controller(controller_rows(r), DT, 30004, "127.0.0.99")
    try:
        done = subprocess.run([sys.executable, "-c", THEIRS, names], capture_output=True, text=True, timeout=600, check=False)
        assert done.returncode == 0, done.stderr
        stamp, q, dq, mode = ast.literal_eval(done.stdout.splitlines()[-1])
        near = range(round((stamp - 1000.0) / DT) - 3, round((stamp - 1000.0) / DT) + 50)  # it reads one output after the other
        assert any(np.array_equal(q, r.q[i]) for i in near) and any(np.array_equal(dq, r.dq[i]) for i in near)
        assert mode == 7
    finally:
        server.close()


def test_samples_are_what_the_controller_sent_cycle_after_cycle(controller: Controller) -> None:
    r = motion(0, 3000)
    source = RtdeSource(Rtde("127.0.0.1", DT, controller.port, "actual_current", (10.0,) * 6))
    samples = heard(source, 200)
    source.close()
    assert len(samples) == 200 and {b.k - a.k for a, b in itertools.pairwise(samples)} == {1}
    first = next(i for i in range(100) if np.array_equal(samples[0].q, r.q[i]))
    for i, s in enumerate(samples, start=first):
        assert np.array_equal(s.q, r.q[i]) and np.array_equal(s.dq, r.dq[i]) and s.powered and not s.fault
        assert s.tau is not None and np.allclose(s.tau, r.tau[i], rtol=1e-12)
    late = time.time() - samples[-1].t
    assert -0.01 < late < 2.0 and "hello" in " ".join(source.complaints())


def test_a_controller_that_hangs_up_or_stands_is_called_again_and_belongs_to_no_earlier_motion(controller: Controller) -> None:
    source = RtdeSource(Rtde("127.0.0.1", DT, controller.port))
    before = heard(source, 50)[-1]
    controller.hang_up()
    assert wait(lambda: source.connected == 2)
    after = [s for s in heard(source, 150) if s.k > before.k + 100]
    assert after, "a gap in the numbers: nothing is carried over"
    controller.pause = True
    time.sleep(0.2)
    controller.pause = False
    assert heard(source, 300)[-1].k > after[-1].k + 40, "what was not sent is missed, not made up"
    source.close()


def test_an_old_sample_is_dropped_while_newer_ones_wait(controller: Controller) -> None:
    source = RtdeSource(Rtde("127.0.0.1", DT, controller.port), 0.1)
    heard(source, 50)
    time.sleep(0.5)
    now, (s,) = time.time(), heard(source, 1)
    assert now - s.t < 0.15 and source.dropped > 50
    source.close()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda b: b"\xff\xff" + b[2:], "is this its RTDE port"),
        (lambda b: b[:3] + b"\0" if b[2] == ord("V") else b, "does not speak version 2"),
        (lambda b: b"\0\x0cO\1NONSENSE" if b[2] == ord("O") else b, "types NONSENSE"),
        (lambda b: b[:3] + b"\0" if b[2] == ord("S") else b, "does not start"),
        (lambda b: b[:2] + b"X" + b[3:] if b[2] == ord("V") else b, "silent"),
        (lambda b: b"\0\x05U\1\1" if b[2] == ord("U") else b, "data package of 2 bytes"),
    ],
)  # fmt: skip
def test_what_is_no_controller_is_one_sentence(
    spoil: Any, words: str, controller: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stopset.monitor.links.rtde_client.PATIENCE", 0.3)
    controller.spoil = spoil
    with pytest.raises(BusError, match=words):
        client = RtdeClient(("127.0.0.1", controller.port), (*WANTED, TORQUE), 250.0)
        list(client.rows(0.3))


def test_an_output_that_old_software_lacks_and_nobody_at_the_address_are_said(controller: Controller) -> None:
    controller.old = {TORQUE}
    source = RtdeSource(Rtde("127.0.0.1", DT, controller.port))
    assert wait(lambda: source._said) and "has no actual_current_as_torque" in source.complaints()[0]
    source.close()
    source = RtdeSource(Rtde("127.0.0.1", DT, free_port()))
    assert wait(lambda: source._said) and "no controller at" in source.complaints()[0]
    assert source.next(0.01) is None
    source.close()


def test_the_monitor_judges_what_a_controller_says(tmp_path: Path) -> None:
    """The process, over TCP and zenoh: an arm as identified, a stop of its safety, a lost connection, an altered one."""
    save_model(replace(known_model(), effort="motor_torque"), tmp_path / "arm.model.json")
    run = motion(0, 15_000)  # a minute
    good, port = with_gravity(run), free_port()
    controller = Controller(controller_rows(good), DT)
    config = tmp_path / "monitor.toml"
    config.write_text(
        f'model = "arm.model.json"\ndata_id = {DATA_ID}\n[rtde]\nhost = "127.0.0.1"\nport = {controller.port}\ncycle_s = {DT}\n'
        f'[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\n[publish]\nvalid_for_ms = 500\nrecover_s = 0.1\n[stops]\ncategories = ["0"]\n'
    )
    try:
        with running("monitor", "--config", str(config)) as monitor, Ear(port) as ear:
            judged = {State.OK, State.DEGRADED}
            assert ear.wait(lambda: ear.twins and ear.twins[-1]["verdicts"].get("CONFORMANT", 0) > 100), ear.twins[-1:]
            assert ear.wait(lambda: judged & set(ear.states[-20:])), ear.twins[-1]
            controller.state = controller_rows(good, safety_status=(3,))
            assert ear.wait(lambda: ear.states[-1] is State.UNKNOWN and "safety status is 3" in ear.twins[-1]["why"])
            controller.state = controller_rows(good)
            assert ear.wait(lambda: ear.states[-1] in judged)
            # a model that is not of such a controller is refused while it runs, as it is at the start
            watched = (tmp_path / "arm.model.json").read_bytes()
            save_model(replace(known_model(), effort="compensated_torque"), tmp_path / "arm.model.json")
            monitor.send_signal(signal.SIGHUP)
            assert ear.wait(lambda: [e for e in list(ear.events) if e["kind"] in ("reloaded", "reload_refused")])
            (event,) = [e for e in list(ear.events) if e["kind"] in ("reloaded", "reload_refused")]
            assert event["kind"] == "reload_refused" and "takes compensated_torque" in event["why"]
            (tmp_path / "arm.model.json").write_bytes(watched)
            controller.hang_up()
            assert ear.wait(lambda: judged.isdisjoint(ear.states[-1:]), 5.0)
            assert ear.wait(lambda: ear.states[-1] in judged), ear.twins[-1]
            assert not ear.twins[-1]["violation_count"], ear.twins[-1]["violation_why"]
            altered = with_gravity(with_torque_scaled(run, 3, 1.6))
            controller.state = controller_rows(altered)
            assert ear.wait(lambda: ear.states[-1] is State.VIOLATION)
            assert ear.wait(lambda: ear.twins[-1]["violating_joints"])
            assert ear.twins[-1]["violating_joints"][0] == known_model().joints[3] and monitor.poll() is None
    finally:
        controller.close()
    assert not controller.heard, "the monitor only listens"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('torque = "wish"', "rtde.torque is 'wish'"), ('torque = "actual_current"', "six numbers above 0"),
        ("torque_constant = [1.0]", "six numbers above 0"), ("cycle_s = 0.0", "rtde.cycle_s is 0.0"), ("port = 0", "rtde.port is 0"),
        ('[bus]\nlink = "hub:1"', "exactly one of"),
    ],
)  # fmt: skip
def test_a_configuration_that_no_controller_fits_is_refused(line: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(f'model = "m.json"\ndata_id = 7\n[rtde]\nhost = "10.0.0.1"\n{line}\n')
    with pytest.raises(ConfigError, match=words):
        load_config(path)
