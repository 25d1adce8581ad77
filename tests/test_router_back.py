"""The router between a daemon and its consumers is killed and begun anew while all others go on: stale meanwhile, then back, never a wrong OK."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from monitor_arm import known_model, meta, motion, with_torque_scaled
from monitor_process import (
    DATA_ID,
    PREFIX,
    PythonReading,
    environment,
    expected,
    free_port,
    listens,
    running,
)
from patience import wait
from stopset.artifact import save_model
from stopset.cli.main import main
from stopset.monitor.consumer import Fault
from stopset.monitor.fleet import Fleet
from stopset.monitor.layout import State
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.recording import write_recordings

WATCHDOG_MS = 1000
ROUTER = """
import sys, time
from stopset.monitor.links.zenoh_link import ZenohLink
link = ZenohLink(mode="router", listen=[sys.argv[1]])
time.sleep(3600)
"""
GOOD = {State.OK, State.DEGRADED}


def begun(port: int) -> subprocess.Popen[str]:
    """A router as a process of its own: zenoh's own code in mode router, the one that `zenohd` runs."""
    process = subprocess.Popen([sys.executable, "-c", ROUTER, f"tcp/127.0.0.1:{port}"], env=environment(), text=True)
    assert wait(lambda: listens(port)), "the router never listened"
    return process


@pytest.mark.parametrize("through", ["bus", "router"])
def test_a_router_that_is_killed_makes_everything_stale_and_comes_back(tmp_path: Path, through: str) -> None:
    """The arm's readings come by a bus beside the router, or through it as well."""
    save_model(known_model(), tmp_path / "arm.model.json")
    write_recordings(tmp_path / "rec.parquet", meta(), [motion(s, 500, s) for s in range(2)])
    port, bus = free_port(), free_port()
    to, source = f"tcp/127.0.0.1:{port}", f'[bus]\nlink = "hub:{bus}"'
    words = ["replay", str(tmp_path / "rec.parquet"), "--to", f"hub:{bus}", "--loop", "--wait", "1"]
    if through == "router":
        source = '[joint_states]\nkey = "js"\ncycle_s = 0.004'
        words = ["replay", str(tmp_path / "rec.parquet"), "--to", f"zenoh:{to}", "--key", "js", "--loop"]
    config = tmp_path / "arm.toml"
    config.write_text(
        f'model = "arm.model.json"\ndata_id = {DATA_ID}\n{source}\n[zenoh]\nmode = "client"\nconnect = ["{to}"]\n'
        "[publish]\nvalid_for_ms = 1000\nstale_ms = 2000\n"
    )
    router = begun(port)
    link, fleet = ZenohLink(PREFIX, mode="client", connect=[to]), Fleet()
    reader = PythonReading(lambda nonce: link.put("challenge", nonce), expected(config), WATCHDOG_MS)
    events: list[bytes] = []
    try:
        link.subscribe("state", lambda _, data: reader.take(data))
        link.subscribe("event", lambda _, data: events.append(data))
        link.subscribe("/*/*/*/stopset/state/json", fleet.take_json)
        link.watch_alive("/*/*/*/stopset/alive", fleet.take_alive)
        with running("monitor", "--config", str(config)) as monitor, running(*words) as replay:
            assert wait(lambda: reader.now in GOOD), reader.said[-3:]
            for _ in range(2):
                router.kill()
                router.wait()
                down = time.monotonic()
                assert wait(lambda: reader.now is State.FAULT), "who hears nothing says so"
                silent = time.monotonic()
                assert silent - down < 60
                assert wait(lambda: [r["word"] for r in fleet.rows()] == ["NO DATA"])
                time.sleep(2.0)
                assert not GOOD & reader.since(silent), "nothing is OK while the router is gone"
                assert Fault.SILENT in reader.faults(down) or Fault.STALE in reader.faults(down)
                router = begun(port)
                assert wait(lambda: reader.now in GOOD, 120.0), (reader.said[-3:], events[-3:])
                assert wait(lambda: [r["word"] for r in fleet.rows()] != ["NO DATA"])
            assert monitor.poll() is None and replay.poll() is None, "all others went on by themselves"
    finally:
        reader.close()
        link.close()
        router.kill()
        router.wait()


def test_a_router_that_is_begun_anew_hides_no_latched_violation(tmp_path: Path) -> None:
    """Consumers that go on believe nothing while it is gone, and the violation behind it; an order by the new one clears it."""
    save_model(known_model(), tmp_path / "arm.model.json")
    write_recordings(tmp_path / "altered.parquet", meta(), [with_torque_scaled(motion(0, 250), 3, 1.5)])
    write_recordings(tmp_path / "good.parquet", meta(), [motion(s, 500, s) for s in range(2)])
    port, bus = free_port(), free_port()
    to = f"tcp/127.0.0.1:{port}"
    config = tmp_path / "arm.toml"
    config.write_text(
        f'model = "arm.model.json"\ndata_id = {DATA_ID}\n[bus]\nlink = "hub:{bus}"\n[zenoh]\nmode = "client"\nconnect = ["{to}"]\n'
        "[publish]\nvalid_for_ms = 1000\nstale_ms = 2000\n"
    )
    router = begun(port)
    link = ZenohLink(PREFIX, mode="client", connect=[to])
    reader = PythonReading(lambda nonce: link.put("challenge", nonce), expected(config), WATCHDOG_MS)
    try:
        link.subscribe("state", lambda _, data: reader.take(data))
        with running("monitor", "--config", str(config)) as monitor:
            assert wait(lambda: reader.consumer.last is not None), "it is there"
            with running("replay", str(tmp_path / "altered.parquet"), "--to", f"hub:{bus}", "--wait", "1") as replay:
                replay.wait(timeout=600)
            # the replay has ended, and on a busy machine its last sample is stale by now
            assert wait(lambda: State.VIOLATION in reader.since(0.0)), reader.said[-3:]
            told = time.monotonic()
            router.kill()
            router.wait()
            assert wait(lambda: reader.now is State.FAULT)
            with running("replay", str(tmp_path / "good.parquet"), "--to", f"hub:{bus}", "--loop", "--wait", "1"):
                router = begun(port)
                assert wait(lambda: reader.now is State.VIOLATION, 120.0), reader.said[-3:]
                assert not GOOD & reader.since(told)
                link.put("reset", b'{"name": "A. Person", "reason": "seen to"}')
                assert wait(lambda: reader.now in GOOD, 120.0), reader.said[-3:]
            assert monitor.poll() is None
    finally:
        reader.close()
        link.close()
        router.kill()
        router.wait()


def test_a_monitor_that_finds_no_router_ends_with_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Systemd starts it again; and it does not claim to listen itself."""
    save_model(known_model(), tmp_path / "arm.model.json")
    config = tmp_path / "arm.toml"
    to = f"tcp/127.0.0.1:{free_port()}"
    config.write_text(
        f'model = "arm.model.json"\ndata_id = 1\n[bus]\nlink = "hub:1"\n[zenoh]\nmode = "client"\nconnect = ["{to}"]\n'
    )
    assert main(["monitor", "--config", str(config)]) == 2
    out, err = capsys.readouterr()
    assert f"no zenoh session with {to} comes about" in err and f"/** on {to};" in out
