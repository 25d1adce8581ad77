"""The simulated arm in motion: accuracy by step halving and against others' equations, and each hidden law by itself."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from stopset.core import build
from stopset.robot.rigid import gravity_torque, mass_matrix, torque
from stopset.simulation import StoppingArm, simulate_stop
from stopset.simulation import plant as plant_module
from stopset.simulation.arm import ArmState, Script, run, start
from stopset.simulation.plant import SimulatedPlant, healthy_plant
from stopset.types import Array
from test_simulation_stop import ARM

N = 6
PERIOD = 0.004
WARM = np.full(N, 45.0)


def plant(**changes: float | Array) -> SimulatedPlant:
    """The healthy arm with some joint arrays changed."""
    p = healthy_plant(ARM, np.random.default_rng(0))
    return p._replace(**{k: np.broadcast_to(np.asarray(v, float), (N,)).copy() for k, v in changes.items()})


def script(ticks: int, speed: float = 1.0, kp: float = 300.0, kd: float = 60.0) -> Script:
    """All joints swing, each at its own pace; no noise at all."""
    t = np.arange(ticks) * PERIOD
    w = speed * np.array([1.1, 0.9, 1.3, 0.8, 1.2, 1.5])
    q = 0.7 * np.sin(np.outer(t, w) + np.arange(N))
    dq = 0.7 * w * np.cos(np.outer(t, w) + np.arange(N))
    zero = np.zeros((ticks, N))
    return Script(PERIOD, zero, q, dq, np.full(N, kp), np.full(N, kd), ticks, ticks, zero, zero, 0.0, zero)


def play(p: SimulatedPlant, s: Script, steps: int = 8, x: ArmState | None = None) -> tuple[Array, ...]:
    state = start(p, s.q[0], s.dq[0], WARM) if x is None else x
    return run(p, s, state, np.zeros(N), 30.0, 0.0, steps)


LAWS = {
    "healthy": {},
    "thermal": {"fv_slope": 0.03, "fc_slope": 0.02},
    "stribeck": {"breakaway": 3.0, "stribeck_speed": 0.06},
    "tooth load": {"tooth": 0.1},
    "skew": {"skew": 0.2},
    "thinning": {"thinning_speed": 0.4},
    "ripple": {"ripple": 2.0, "ripple_order": 80.0},
    "elastic": {"stiffness": 2000.0, "twist_damping": 5.0},
    "presliding": {"presliding": 2e-3},
    "film": {"film_heat": 0.05, "film_time": 0.5},
    "slow drive": {"lag": 0.015},
    "spring and bump": {"spring": 4.0, "bump": 3.0, "bump_width": 0.15},
    "drag": {"drag": 2.0, "partner": np.array([1, 2, 3, 4, 5, 0])},
    "outside": {"resonance": 4.0, "resonance_speed": 0.4, "weave": 3.0, "partner": np.array([1, 2, 3, 4, 5, 0])},
}


@pytest.mark.parametrize("law", LAWS)
def test_half_the_step_gives_the_same_motion(law: str) -> None:
    """Two seconds with reversals of all joints at 0.5 ms against 0.03 ms, each law of the plant."""
    p, s = plant(**LAWS[law]), script(500)
    coarse, fine = play(p, s, 8), play(p, s, 128)
    # An encoder resolves 6e-5 rad, a velocity measurement 3e-3 rad/s: a tenth is invisible. The tooth load alone is
    # taken from the step before, which makes it first order, and still a third of that.
    late = law == "tooth load"
    assert np.abs(coarse[4] - fine[4]).max() < (2e-5 if late else 6e-6)
    assert np.abs(coarse[5] - fine[5]).max() < (1e-3 if late else 3e-4)
    if law != "healthy":
        assert np.abs(coarse[2] - play(plant(), s, 8)[2]).max() > 0.3  # [N m]: the law does something


def test_a_drive_s_own_losses_warm_it_and_its_friction_falls_with_that() -> None:
    """The film after two seconds against its differential equation along the speeds that were reached."""
    from scipy.integrate import solve_ivp

    p, s = plant(film_heat=0.05, film_time=0.5), script(500)
    state = start(p, s.q[0], s.dq[0], WARM)
    speed = np.abs(play(p, s, 8, state)[5])
    t = np.arange(len(speed)) * PERIOD

    def flow(now: float, film: Array) -> Array:
        v = np.array([np.interp(now, t, c) for c in speed.T])
        return (p.film_heat * v * (p.fc + p.fv * v) / (1 + film) - film) / p.film_time

    want = solve_ivp(flow, (0, t[-1]), np.zeros(N), rtol=1e-6, max_step=PERIOD).y[:, -1]
    assert want.min() > 0.05, "it warms"
    assert state.film == pytest.approx(want, rel=0.02)  # its own step is a control tick, 0.8 % of its time constant


def test_elastic_gears_agree_with_an_independent_integrator() -> None:
    """Two masses and a spring per joint, no dry friction: an ordinary differential equation solved to 1e-9."""
    from scipy.integrate import solve_ivp

    p = plant(fc=0.0, stiffness=3000.0, twist_damping=8.0)
    q0 = np.array([0.3, -0.5, 0.4, 0.2, 0.6, -0.3])
    K, D = p.stiffness, p.twist_damping

    def f(_: float, y: Array) -> Array:
        q, m, v, u = np.split(y, 4)
        gear = K * (m - q) + D * (u - v)
        a = np.linalg.solve(mass_matrix(p.chain, p.pi, q), gear - torque(p.chain, p.pi, q, v, np.zeros(N)))
        return np.concatenate([v, u, a, (-p.fv * u - gear) / p.rotor])

    ticks = 51
    free = script(ticks, kp=0.0, kd=0.0)
    state = start(p, q0, np.zeros(N), WARM)
    state.x[:N] = q0  # let go with untwisted gears: the springs swing
    got = play(p, free, 8, state)
    y0 = np.concatenate([q0, q0, np.zeros(2 * N)])
    want = solve_ivp(f, (0, (ticks - 1) * PERIOD), y0, rtol=1e-9, atol=1e-10, method="DOP853").y[:, -1]
    # springs of some 100 rad/s: (h w)^2 / 12 of twists of some 20 mrad per radian of phase, 20 rad long
    assert np.abs(got[4][-1] - want[:N]).max() < 2e-4
    better = play(p, free, 16, _fresh(p, q0))
    assert np.abs(better[4][-1] - want[:N]).max() < np.abs(got[4][-1] - want[:N]).max() / 3


def _fresh(p: SimulatedPlant, q0: Array) -> ArmState:
    state = start(p, q0, np.zeros(N), WARM)
    state.x[:N] = q0
    return state


def test_a_slow_drive_gives_what_it_is_told_through_a_lag() -> None:
    """A joint alone without friction, told a step of torque: its speed against the integral of 1 - exp(-t / T)."""
    T, told, ticks = 0.02, 4.0, 40
    p = plant(fc=0.0, fv=0.0, lag=T, rotor=1e9)  # the other joints do not move
    p.rotor[0] = 2.0
    p = p._replace(pi=0.0 * p.pi)
    feedforward = np.zeros((ticks, N))
    feedforward[2:, 0] = told
    s = script(ticks, kp=0.0, kd=0.0)._replace(feedforward=feedforward)
    got = play(p, s, 2, _fresh(p, np.zeros(N)))
    t = np.maximum(np.arange(ticks) - 2, 0) * PERIOD
    want = told / 2.0 * (t - T * -np.expm1(-t / T))
    assert np.abs(got[5][:, 0] - want).max() < 1e-12
    assert np.array_equal(got[2], feedforward), "what is recorded is what it was told"


def test_the_arm_and_the_bare_stop_are_one_physics() -> None:
    """A power cut on the full arm is the stop that the bounds are tested on."""
    p = plant()
    ticks = 60
    q0, v0 = np.array([0.3, -0.5, 0.4, 0.2, 0.6, -0.3]), np.array([1.0, -0.8, 0.7, 0.5, -1.0, 0.9])
    s = script(ticks)._replace(brake_at=0, cut_at=0)
    got = play(p, s, 8, start(p, q0, v0, WARM))
    q, v = simulate_stop(
        StoppingArm(p.chain, p.pi, p.rotor, p.fc, p.fv, p.brake_torque, p.brake_delay, p.brake_rise),
        q0, v0, PERIOD / 8, 8 * ticks, np.zeros((1, N)),
    )  # fmt: skip
    assert np.abs(got[4] - q[:-1:8]).max() < 1e-12
    assert np.abs(got[5] - v[:-1:8]).max() < 1e-11


def test_the_table_the_loops_see_is_the_plant() -> None:
    """The core's columns have the names of the plant's fields, in their order."""
    text = (Path(build.__file__).parent / "c" / "simulation" / "arm.c").read_text()
    columns = re.search(r"enum \{\s*(ROTOR,.*?)\};", text, re.DOTALL)
    assert columns is not None
    assert [x.strip().lower() for x in columns.group(1).split(",")] == [*SimulatedPlant._fields[2:], "columns"]
    assert len(SimulatedPlant._fields) - 2 == plant_module.COLUMNS
    assert plant_module.table(plant(tooth=0.25))[:, SimulatedPlant._fields[2:].index("tooth")] == pytest.approx(0.25)


def creeping(p: SimulatedPlant) -> tuple[Array, Array]:
    """Mean motor torque [N m] and pose [rad], (N,) each, of slow steady runs there and back: friction cancels."""
    ticks, torques, poses = 400, [], []
    pose = np.array([0.3, -0.5, 0.4, 0.2, 0.6, -0.3])
    for side in (1.0, -1.0):
        rate = 0.02 * side
        t = (np.arange(ticks) - ticks + 1)[:, None] * PERIOD
        s = script(ticks, kp=3000.0, kd=100.0)._replace(q=pose + rate * t, dq=np.full((ticks, N), rate))
        log = play(p, s)
        torques.append(log[2][-20:].mean(axis=0))
        poses.append(log[4][-20:].mean(axis=0))
    return np.mean(torques, axis=0), np.mean(poses, axis=0)


def test_slow_runs_show_gravity_springs_and_gain() -> None:
    def gravity(q: Array) -> Array:
        return gravity_torque(ARM.chain, ARM.pi, q)

    # the two ways end some 6 mrad apart, which bends gravity of 40 N m by 40 * 0.003^2 / 2; PD oscillations are gone
    tolerance = 0.01
    tau, q = creeping(plant())
    assert np.abs(tau - gravity(q)).max() < tolerance
    tau, q = creeping(plant(spring=5.0, spring_centre=0.1))
    x = q - 0.1
    assert np.abs(tau - gravity(q) - 5.0 * x * (1 + 0.05 * x * x)).max() < tolerance
    tau, q = creeping(plant(gain=1.25))
    assert np.abs(tau - gravity(q) / 1.25).max() < tolerance
    skewed = plant(skew=0.1)
    tau, q = creeping(skewed)
    assert np.abs(tau - gravity(q) - 0.1 * skewed.fc).max() < tolerance


def test_friction_in_steady_sliding_is_what_the_laws_say() -> None:
    """At constant speed the torque is gravity plus friction; each law checked by hand at that speed."""
    rate, ticks = 0.3, 300
    start_at = np.full(N, -0.4)
    t = np.arange(ticks)[:, None] * PERIOD

    def friction(p: SimulatedPlant, temp: float = 30.0) -> Array:
        s = script(ticks, kp=3000.0, kd=100.0)._replace(q=start_at + rate * t, dq=np.full((ticks, N), rate))
        state = start(p, s.q[0], s.dq[0], np.full(N, temp))
        log = run(p, s, state, np.zeros(N), temp, 0.0, 8)
        rigid = np.array([torque(p.chain, p.pi, log[4][k], log[5][k], np.zeros(N)) for k in range(150, 250)])
        return np.asarray((log[2][150:250] - rigid).mean(axis=0))

    p = plant()
    base = p.fc + p.fv * rate
    tolerance = 0.1  # [N m]: accelerations left over from the PD loop, averaged; the laws change the torque by more
    assert np.abs(friction(p) - base).max() < tolerance
    assert np.abs(friction(plant(breakaway=2.0, stribeck_speed=0.3)) - base - 2.0 / 2.0).max() < tolerance
    thin = plant(thinning_speed=0.15)
    assert np.abs(friction(thin) - p.fc - p.fv * 0.15 * np.arcsinh(2.0)).max() < tolerance
    # ten kelvin at 2 %/K, curved: exp(0.02 * 125^2 * (1/135 - 1/125))
    hot = friction(plant(fv_slope=0.02), 40.0)
    assert np.abs(hot - p.fc - p.fv * rate * np.exp(0.02 * 125**2 * (1 / 135 - 1 / 125))).max() < tolerance
    cooled = friction(plant(fc_slope=0.01), 40.0)
    assert np.abs(cooled - p.fv * rate - p.fc * (0.4 + 0.6 * np.exp(-0.1 / 0.6))).max() < tolerance
    assert np.abs(friction(plant(drag=2.0, partner=np.array([1, 0, 3, 2, 5, 4]))) - base - 2 * 2.0 * rate).max() < tolerance


def test_presliding_friction_depends_on_the_way_since_the_reversal() -> None:
    """Pushed by a tenth of its friction a joint gives way elastically and comes back: the slope is that of the elements."""
    p = plant(presliding=2e-3)
    slope = p.fc * (0.4 / 0.4 + 0.3 / 1.0 + 0.2 / 2.0 + 0.1 / 4.0) / 2e-3
    q0 = np.array([0.3, -0.5, 0.4, 0.2, 0.6, -0.3])
    ticks = 5000  # the light damping of such contacts takes seconds
    hold = gravity_torque(p.chain, p.pi, q0)
    zero = np.zeros((ticks, N))
    push = np.tile(hold, (ticks, 1))
    push[: ticks // 2] += 0.1 * p.fc
    s = Script(PERIOD, push, zero, zero, np.zeros(N), np.zeros(N), ticks, ticks, zero, zero, 0.0, zero)
    q = play(p, s, 8, start(p, q0, np.zeros(N), WARM))[4]
    given = q[ticks // 2 - 1] - q0
    assert given == pytest.approx(0.1 * p.fc / slope, rel=0.15)  # gravity changes a little on the way
    assert np.abs(q[-1] - q0).max() < 0.1 * np.abs(given).max()
