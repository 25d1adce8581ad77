"""Stops of one joint: the exact solution is the simulation's, no stop leaves its bound, and a bound a hundredth shorter is left."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from stopset.simulation.stop import StoppingArm, simulate_stop

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stops_one_joint import CHUNK, drawn, exact, joint, nothing, run

ARMS = 12


def test_the_exact_solution_is_what_the_simulation_comes_to() -> None:
    rng = np.random.default_rng(2)
    for number in range(ARMS):
        bounds, speed = joint(np.random.default_rng(number))
        p = bounds.setting.plant
        cases = drawn(p, speed, 0.01, 3, rng)
        angle, time = exact(*cases)
        v, inertia, ahead, brake, delay, rise = (x[:, None] for x in cases)
        for k in range(3):
            # the whole inertia as a rotor's, disturbance and dry friction as one
            light = np.zeros((1, 10))
            arm = StoppingArm(p.chain, light, inertia[k], -ahead[k], np.zeros(1), brake[k], delay[k], rise[k])
            dt = 1e-5 if time[k] < 1.0 else 1e-4
            q, w = simulate_stop(arm, np.zeros(1), v[k], dt, int(1.1 * time[k] / dt) + 3, np.zeros((1, 1)))
            assert abs(q[-1, 0] - angle[k]) < 1e-5 * max(1.0, angle[k])
            assert abs(int(np.argmax(w[:, 0] <= 0.0)) * dt - time[k]) <= 2 * dt


def test_no_stop_of_one_joint_leaves_its_bound() -> None:
    seen = nothing()
    for number in range(ARMS):
        run(number, seen, 5 * CHUNK)
    assert seen["bounded"] == ARMS and seen["stops"] == ARMS * 5 * CHUNK
    assert seen["escapes"] == 0 and seen["weakened"] > 0
    assert max(seen["angle"]) < 1.02 and max(seen["time"]) < 1.05
