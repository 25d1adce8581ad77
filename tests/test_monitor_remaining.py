"""Margins are those of the true pose: what effects set right in a reading is not left out of them."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor_arm import NOISE, known_model
from patience import wait
from stopset.artifact import Model, save_model
from stopset.effects.base import Fitted
from stopset.monitor.config import Bus, Config, Plane, StopLimits
from stopset.monitor.margins import ends
from stopset.monitor.remaining import Remaining
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.stopworker import numbers_of
from stopset.reach.stops import StopBounds
from stopset.sets import Box
from stopset.types import Array

OFF, STD = 0.1, 0.002  # [rad] the reading of a joint, and how well that is known
FLOOR = Plane("floor", (0.0, 0.0, 1.0), 0.0)


def misreading(joint: int) -> Model:
    model = known_model()
    return replace(model, effects=(Fitted("encoder_offset", model.joints[joint], {"e": OFF}, {"e": STD}),))


def begun_elsewhere() -> Model:
    """Recorded stops begin up to 0.05 rad from where the arm was read."""
    model = known_model()
    n, powered = model.n, model.powered
    return replace(
        model, sets={"powered": powered, "stop0": replace(powered, X0=Box.symmetric(np.r_[np.full(n, 0.05), np.full(n, 0.01)]))}
    )


CASES = {"shoulder": misreading(1), "elbow": misreading(2), "stops begin elsewhere": begun_elsewhere()}


def true_poses(model: Model, q: Array, count: int, rng: np.random.Generator) -> list[Array]:
    out = []
    for _ in range(count):
        x = q + (0.05 if "stop0" in model.sets else NOISE) * rng.choice([-1.0, 1.0], model.n)
        for f in model.effects:
            x[model.joints.index(str(f.joint))] += OFF + 3.0 * STD * rng.choice([-1.0, 1.0])
        out.append(x)
    return out


def test_advice_of_a_process_that_hangs_is_none(tmp_path: Path) -> None:
    """The last one was told for ever, as if it were of now."""
    model = save_model(known_model(), tmp_path / "arm.model.json")
    limits = StopLimits("0", override=True, override_every_s=0.2)
    config = Config(str(tmp_path / "arm.model.json"), Bus("hub:1"), data_id=7, limits=limits)
    still, remaining = np.zeros(6), Remaining.of(config, model)
    stops = {"0": numbers_of(StopBounds.of(model, fast=True).bound(still, still), 6)}

    def advice() -> object:
        remaining.measure(time.monotonic(), Sample(0, time.time(), still, still), stops, Quantum.none(6))
        return remaining.override

    try:
        assert wait(lambda: advice() is not None, 60.0)
        assert remaining.advisor is not None
        os.kill(remaining.advisor._process.pid, signal.SIGSTOP)
        assert wait(lambda: advice() is None, 20.0)
    finally:
        remaining.close()


@pytest.mark.parametrize("name", CASES)
def test_margins_hold_for_every_true_pose_behind_a_reading(name: str) -> None:
    """1,500 poses of a still arm and the joints' worst travel: nothing comes nearer to the floor and the joints' limits than was told."""
    model, rng = CASES[name], np.random.default_rng(3)
    robot, n, limits = model.robot, model.n, StopLimits("0", planes=(FLOOR,))
    stops, remaining = StopBounds.of(model, fast=True), Remaining(model, limits, None)
    for k in range(30):
        q, still = rng.uniform(-1.5, 1.5, n), np.zeros(n)
        numbers = numbers_of(stops.bound(q, still, "0", still, still), n)
        assert numbers.proven, numbers.why
        sample = Sample(k, 0.01 * k, q, still, still)
        remaining.measure(0.0, sample, {"0": numbers}, Quantum.none(n))
        told = remaining.margins
        assert told is not None
        room = np.array([told["joint_limits_rad"][j] for j in robot.joints])
        for x in true_poses(model, q, 50, rng):
            way = rng.uniform(-1.0, 1.0, n)
            ended = x + way * np.where(way > 0.0, numbers.forward, numbers.back)
            assert told["planes_m"]["floor"] <= min(float(ends(robot, p)[0][:, 2].min()) for p in (x, ended)) + 1e-9
            up, down = robot.q_limit[:, 1] - x - numbers.forward, x - numbers.back - robot.q_limit[:, 0]
            assert np.all(room <= np.minimum(up, down) + 1e-9)
