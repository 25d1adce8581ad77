"""The real arm's recording through the bus: conformant as it is, refuted and named where one joint's torque is wrong."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor_process import Ear, free_port, running, stopset, write_config
from stopset.artifact import Model, load_model
from stopset.monitor.latch import Latch
from stopset.monitor.links.canopen_map import Encoder
from stopset.monitor.links.decoder import Decoder
from stopset.monitor.profile import load_profile
from stopset.monitor.replay import PAUSE_CYCLES, signal_rows
from stopset.monitor.sample import Quantum
from stopset.monitor.source import CycleCount, sample_of
from stopset.monitor.verdict import Conformance, Verdict
from stopset.monitor.watch import Watch
from stopset.recording import Recording, read_recordings, write_recordings

REAL = Path(__file__).resolve().parents[2] / "shared/data/schunk_lwa4p/open_loop.parquet"
pytestmark = [pytest.mark.shared, pytest.mark.skipif(not REAL.exists(), reason="../shared/data is not here")]
PROFILE = load_profile("lwa4p/monitor")


def through_the_bus(model: Model, trials: Iterable[Recording]) -> tuple[list[Verdict], Latch]:
    """What the monitor would say if these trials came over CAN, frame by frame, rounding included."""
    p = PROFILE
    watch = Watch(model, Quantum(p.quantum("q"), p.quantum("dq"), p.quantum("tau")))
    encoder, decoder, count, latch = Encoder(p), Decoder(p), CycleCount(p.cycle_s, p.sync_overflow), Latch()
    out, t = [], 0.0
    for r in trials:
        for values in signal_rows(r):
            for cob_id, data in encoder.frames(values):
                cycle = decoder.frame(cob_id, data, t)
                if cycle is not None:
                    sample = sample_of(cycle, count(cycle))
                    out.append(watch.step(sample))
                    latch.take(sample, out[-1])
            t += p.cycle_s
        encoder.skip(PAUSE_CYCLES)
        t += PAUSE_CYCLES * p.cycle_s
    return out, latch


@pytest.mark.slow
def test_the_real_recording_conforms_over_can(schunk_model: Path) -> None:
    model = load_model(schunk_model)
    trials = list(read_recordings(REAL, model.robot))
    out, latch = through_the_bus(model, trials)
    assert len(out) == sum(len(r.t) for r in trials) == 67550
    assert not latch.latched and sum(v.conformance is Conformance.CONFORMANT for v in out) == 67550 - 100
    assert max(v.oldest for v in out) == pytest.approx(model.powered.horizon - model.powered.dt, abs=1.1 * model.powered.dt)


# joint 2 brakes harder than its friction at the end of some trials, which its interval U holds: wider than half its torque there, so that
# only more than twice the torque is refuted (1.8 times it is not)
@pytest.mark.parametrize(("joint", "factor"), [(0, 1.5), (1, 2.2), (2, 1.5), (3, 1.5), (4, 1.5), (5, 1.5)])
def test_a_wrong_torque_names_the_joint(schunk_model: Path, joint: int, factor: float) -> None:
    model = load_model(schunk_model)
    trials = list(read_recordings(REAL, model.robot))
    scaled = [replace(r, tau=r.tau * np.where(np.arange(6) == joint, factor, 1.0)) for r in trials[::10]]
    _, latch = through_the_bus(model, scaled)
    assert latch.joints == (model.joints[joint],)


def accounted(health: dict[str, Any]) -> int:
    """Cycles of the bus that were looked at, or of which it is counted why not."""
    names = "dropped", "incomplete_cycles", "doubtful_cycles", "cycles_underway"
    return int(health["samples"]) + sum(health["bus"].get(name, 0) for name in names)


def certified(twins: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of what was said of a moving arm, that with a certified STOP 0."""
    return [t for t in list(twins) if t["samples"] and t["stops"].get("0", {}).get("certified")]


def tight(twins: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Its stops that needed no looser fall-back."""
    return [t["stops"]["0"] for t in certified(twins) if not t["stops"]["0"]["why"]]


def test_replay_to_monitor_with_stop_bounds(schunk_model: Path, tmp_path: Path) -> None:
    """Three processes, real time: conformant, and STOP 0 is bounded for the moving arm."""
    bus, port = free_port(), free_port()
    config = write_config(tmp_path, schunk_model, f'[bus]\nlink = "hub:{bus}"', port)
    trials = list(read_recordings(REAL))
    write_recordings(tmp_path / "two.parquet", replace(read_recordings(REAL).meta, warnings=()), trials[:2])
    with running("monitor", "--config", str(config)), Ear(port) as ear:
        health: list[dict[str, Any]] = []
        ear.link.subscribe("health", lambda _, d: health.append(json.loads(d)))
        replay = stopset("replay", str(tmp_path / "two.parquet"), "--to", f"hub:{bus}", "--wait", "1")
        _, err = replay.communicate(timeout=600)
        assert replay.returncode == 0, err
        # every sample was looked at, or counted where the machine was held up
        cycles = sum(len(r.t) for r in trials[:2])
        assert ear.wait(lambda: health and accounted(health[-1]) == cycles == health[-1]["bus"]["cycles"]), (health[-1:], cycles)
        if not tight(ear.twins):  # the machine had no time for what bounds stops while the arm moved: it moves again
            with running("replay", str(tmp_path / "two.parquet"), "--to", f"hub:{bus}", "--loop"):
                assert ear.wait(lambda: tight(ear.twins)), "STOP 0 was certified at least once without the looser fall-back"
        moving, found = certified(ear.twins), tight(ear.twins)
    assert ear.twins[-1]["violation_count"] == 0
    assert all(0.0 < s["time_s"] < 1.0 and 0.0 < s["tcp_m"] < 1.0 for s in found)
    robot = load_model(schunk_model).robot
    reach = np.linalg.norm(robot.chain.p[1:], axis=1).sum() + np.linalg.norm(robot.tip)
    assert all(0.0 < t["stops"]["0"]["tcp_m"] <= 2.0 * reach for t in moving)
