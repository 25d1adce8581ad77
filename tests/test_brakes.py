"""Brakes and ramps from recorded stops: the true values are found, held-out stops are enclosed, too narrow intervals are not."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import Brakes, Model, load_model, save_model
from stopset.errors import RecordingError
from stopset.offline.brakes import divide, identify_stops, violations, with_stops
from stopset.reach.stops import StopBounds, ramp_of
from stopset.recording import Recording, read_recordings
from stopset.robot import load_robot
from stopset.sets import Box
from stopset.simulation.stop import simulate_stop

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data" / "hidden_effect"
PERIOD = 0.004
DELAY, RISE = (0.040, 0.055), 0.012  # [s] true values of the recorded arm
NOISE_Q, NOISE_DQ = 5e-5, 3e-3


def arm() -> Model:
    """The arm before any stop was recorded: brakes known as a data sheet knows them."""
    model = prbt_like((0.0, 0.0))
    torque = model.brakes.torque.centre
    wide = Brakes(
        Box.of(0.7 * torque, 1.3 * torque),
        Box.of(np.full(6, 0.005), np.full(6, 0.1)),
        Box.of(np.full(6, 0.002), np.full(6, 0.03)),
    )
    return replace(model, brakes=wide)


def recorded_stop0(model: Model, count: int, seed: int) -> list[Recording]:
    rng, robot = np.random.default_rng(seed), model.robot
    torque = model.brakes.torque.centre
    F, D = np.array([15.0, 15, 10, 8, 3, 2]), np.array([5.0, 5, 3, 3, 1, 1])
    out = []
    for k in range(count):
        q, dq = rng.uniform(-1.5, 1.5, 6), rng.uniform(-1.2, 1.2, 6)
        delay = np.full(6, rng.uniform(*DELAY))
        fine = 8
        qs, vs = simulate_stop(
            robot.chain, robot.pi, model.rotor, F, D, torque * rng.uniform(0.95, 1.05, 6), delay, np.full(6, RISE), q, dq,
            PERIOD / fine, 80 * fine, np.zeros((1, 6)),
        )  # fmt: skip
        qs, vs = qs[::fine], vs[::fine]
        out.append(_recording("stop0", k, qs, vs, rng))
    return out


def _recording(phase: str, k: int, q: np.ndarray, v: np.ndarray, rng: np.random.Generator) -> Recording:
    before = 10
    t = np.arange(before + len(q)) * PERIOD
    q = np.vstack([q[0] + v[0] * PERIOD * np.arange(-before, 0)[:, None], q]) + rng.uniform(-NOISE_Q, NOISE_Q, (len(t), 6))
    v = np.vstack([np.tile(v[0], (before, 1)), v]) + rng.normal(0.0, NOISE_DQ, (len(t), 6))
    trigger = np.arange(len(t)) >= before
    return Recording(phase, 0, k, k, t, q, v, np.zeros_like(q), stop_trigger=trigger)


def recorded_stop1(count: int, seed: int) -> list[Recording]:
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        dq, lasts, control = rng.uniform(-1.2, 1.2, 6), rng.uniform(0.28, 0.32), rng.uniform(0.004, 0.012)
        t = np.arange(140) * PERIOD
        s = np.clip((t[:, None] - control) / lasts, 0.0, 1.0)
        v = dq * (1.0 - s)
        q = dq * (np.minimum(t[:, None], control) + lasts * (s - 0.5 * s * s)) + 2e-4 * np.sin(30 * t)[:, None]
        out.append(_recording("stop1", k, q, v + 6e-3 * np.cos(30 * t)[:, None], rng))
    return out


def test_true_brakes_are_found_and_held_out_stops_enclosed(tmp_path: Path) -> None:
    model = arm()
    stops = recorded_stop0(model, 24, 4)
    fit = identify_stops(model, [*stops, *recorded_stop1(16, 5)])
    b = fit.brakes
    assert b is not None and fit.stop0 is not None and fit.noise is not None
    truth = model.brakes.torque.centre
    for i in (0, 1, 2):  # the big joints slide long enough to tell
        assert b.torque.lo[i] <= truth[i] <= b.torque.hi[i]
        # the cut lies within a sample of the trigger, so the delay is known no better than that
        assert b.delay.lo[i] - PERIOD <= DELAY[0] and DELAY[1] <= b.delay.hi[i] + PERIOD
        assert b.delay.hi[i] - b.delay.lo[i] < 0.06
    assert fit.stop0.violated == 0 and fit.stop0.motions >= 8
    assert 0 < fit.stop0.upper_bound < 0.35 and "held-out" in fit.stop0.text
    assert fit.stop1 is not None and fit.stop1.violated == 0
    known = with_stops(model, fit)
    back = load_model(_saved(known, tmp_path))
    ramp = ramp_of(back)
    assert ramp is not None and ramp.kind == "time" and ramp.value.lo[0] <= 0.28 and ramp.value.hi[0] >= 0.32
    told = StopBounds.of(back).bound(np.zeros(6) + 0.3, np.full(6, 0.8), "1")
    assert told.certified and told.forward.max() >= 0.8 * 0.5 * 0.32
    # the test has teeth: other brakes are refuted by the same held-out stops
    held = divide(stops)[1]
    fast = replace(b, delay=Box.of(np.full(6, 0.002), np.full(6, 0.004)))
    assert violations(replace(known, brakes=fast), held)[0]


def _saved(model: Model, folder: Path) -> Path:
    path = folder / "m.model.json"
    save_model(model, path)
    return path


def test_few_stops_identify_nothing_and_say_so() -> None:
    fit = identify_stops(arm(), recorded_stop0(arm(), 3, 1))
    assert fit.brakes is None and any("too few" in n for n in fit.notes)


def test_a_stop_without_trigger_is_refused() -> None:
    r = replace(recorded_stop0(arm(), 1, 1)[0], stop_trigger=None)
    with pytest.raises(RecordingError, match="stop_trigger"):
        identify_stops(arm(), [r])


@pytest.mark.shared
@pytest.mark.parametrize("name", ["d01"])
def test_simulated_cells_of_the_shared_data(name: str) -> None:
    if not SHARED.is_dir():
        pytest.skip("../shared/data is not here")
    from stopset.offline.identify import identify

    data = SHARED / name / "recording.parquet"
    robot = load_robot(SHARED / name / "robot.urdf")
    model = identify(robot, [data]).model
    fit = identify_stops(model, read_recordings([data], robot))
    assert fit.brakes is not None and fit.stop0 is not None and fit.stop0.violated == 0 and fit.stop0.motions > 0
    assert fit.stop1 is not None and fit.stop1.violated == 0
