"""The simulated stop against equations solved by others, and against itself with finer steps."""

from __future__ import annotations

import numpy as np
import pytest

from core_calls import mass_and_bias, solve_inclusion
from stopset.offline.description import robot_from_text
from stopset.robot import Robot
from stopset.robot.rigid import gravity_torque, mass_matrix, torque
from stopset.simulation import StoppingArm, simulate_stop, simulate_stops
from stopset.types import Array

# both sides sum some 10^3 products of order 10^2 in double precision
ROUNDING = 1e-11


def six_axis_arm() -> Robot:
    """An arm of the size of the LWA 4P with skew axes and off-axis masses, so that no term of the dynamics is zero."""
    rng = np.random.default_rng(20)
    text = ['<robot name="six"><link name="l0"/>']
    for i, (axis, lift) in enumerate(
        zip(("0 0 1", "0 1 0", "0 1 0.2", "1 0 0", "0 1 0", "0.6 0 0.8"), (0.2, 0.1, 0.35, 0.3, 0.05, 0.1), strict=True)
    ):
        mass = 4.0 - 0.5 * i
        x, y, z = [*rng.uniform(-0.03, 0.03, 2), lift / 2]
        text.append(
            f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<origin xyz="0.01 0 {lift}" rpy="0.1 0 0.2"/><axis xyz="{axis}"/>'
            f'<limit lower="-3" upper="3" effort="80" velocity="1.2"/></joint><link name="l{i + 1}"><inertial>'
            f'<origin xyz="{x} {y} {z}" rpy="0.3 0.2 0.1"/><mass value="{mass}"/>'
            '<inertia ixx="0.02" iyy="0.015" izz="0.01" ixy="0.001" ixz="0" iyz="0"/></inertial></link>'
        )
    sheet = {"joints": {f"j{i}": {"reflected_motor_inertia_kgm2": 1.3 if i < 4 else 0.3} for i in range(6)}}
    return robot_from_text("".join([*text, "</robot>"]), sheet)


ARM = six_axis_arm()
FC = np.array([7.5, 12.0, 6.6, 6.7, 4.0, 2.9])
FV = np.array([12.5, 14.0, 11.4, 8.0, 4.2, 3.8])
BRAKE = np.array([70.0, 102.0, 61.0, 36.0, 20.0, 17.0])


def stop(
    dt: float,
    q0: Array,
    v0: Array,
    u: Array,
    horizon: float = 0.2,
    fc: Array = FC,
    fv: Array = FV,
    delay: Array | None = None,
) -> tuple[Array, Array]:
    return simulate_stop(
        StoppingArm(ARM.chain, ARM.pi, ARM.rotor, fc, fv, BRAKE, np.full(6, 0.02) if delay is None else delay, np.full(6, 0.018)),
        q0, v0, dt, round(horizon / dt), u,
    )  # fmt: skip


def starts(count: int, seed: int) -> list[tuple[Array, Array, Array]]:
    rng = np.random.default_rng(seed)
    return [(rng.uniform(-3, 3, 6), rng.uniform(-1.3, 1.3, 6), rng.uniform(-2, 2, (8, 6))) for _ in range(count)]


def test_one_pass_dynamics_agree_with_the_general_functions() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        q, dq = rng.uniform(-3, 3, 6), rng.normal(0, 2, 6)
        M, bias = mass_and_bias(ARM.chain, ARM.pi, q, dq)
        assert np.abs(M - mass_matrix(ARM.chain, ARM.pi, q)).max() < ROUNDING
        assert np.abs(bias - torque(ARM.chain, ARM.pi, q, dq, np.zeros(6))).max() < ROUNDING


@pytest.mark.parametrize("n", [1, 2, 6, 12])
def test_the_inclusion_holds_whoever_sticks(n: int) -> None:
    rng = np.random.default_rng(n)
    seen = set()
    for _ in range(300):
        X = rng.normal(size=(n, n))
        A = X @ X.T + 0.1 * np.eye(n)  # strongly coupled on purpose: condition numbers of 10^3
        b, plus, minus = rng.normal(0, 2, n), rng.uniform(0, 2, n), rng.uniform(0, 2, n)
        w, mode = np.zeros(n), rng.integers(-1, 2, n)
        assert solve_inclusion(A, b.copy(), plus, minus, mode, w)
        p = b - A @ w
        tolerance = 1e-10
        assert np.all(p <= plus + tolerance) and np.all(p >= -minus - tolerance)
        assert np.all(np.abs(p - plus)[w > 0] < tolerance) and np.all(np.abs(p + minus)[w < 0] < tolerance)
        assert np.all(w[mode == 0] == 0.0)
        seen |= set(np.sign(w).tolist())
    assert seen == {-1.0, 0.0, 1.0}


def many(count: int, seed: int) -> tuple[StoppingArm, Array, Array, Array]:
    """Stops that differ in everything: arms, starts, disturbances."""
    rng = np.random.default_rng(seed)

    def near(x: Array) -> Array:
        return np.asarray(x * rng.uniform(0.7, 1.3, (count, *x.shape)))

    times = np.full(6, 0.02)
    arms = StoppingArm(ARM.chain, near(ARM.pi), near(ARM.rotor), near(FC), near(FV), near(BRAKE), near(times), near(times))
    return arms, rng.uniform(-3, 3, (count, 6)), rng.uniform(-1.3, 1.3, (count, 6)), rng.uniform(-9, 9, (count, 8, 6))


def test_stops_side_by_side_are_those_one_by_one() -> None:
    """To the bit, whatever stands beside them, some of them over long before others: no lane forgets or mixes anything."""
    arms, q0, v0, u = many(61, 8)
    v0[::5] *= 0.01
    q, v = simulate_stops(arms, q0, v0, 5e-4, 300, u)
    for k in range(61):
        one = StoppingArm(arms.chain, *(x[k] for x in arms[1:]))
        alone = simulate_stop(one, q0[k], v0[k], 5e-4, 300, u[k])
        assert alone[0].tobytes() == q[k].tobytes() and alone[1].tobytes() == v[k].tobytes()


def test_a_step_of_four_is_that_of_the_dynamics_of_one() -> None:
    """Without friction a step is one linear system, here of mass and bias as they are computed for a single arm."""
    arms, q0, v0, u = many(40, 9)
    zero, late, h = np.zeros((40, 6)), np.full((40, 6), 9.0), 5e-4
    q, v = simulate_stops(arms._replace(fc=zero, fv=zero, brake_delay=late), q0, v0, h, 1, u[:, :1])
    for k in range(40):
        M, bias = mass_and_bias(ARM.chain, arms.pi[k], q0[k] + 0.5 * h * v0[k], v0[k])
        w = v0[k] + np.linalg.solve(M + np.diag(arms.rotor[k]), h * (u[k, 0] - bias))
        assert np.abs(v[k, 1] - w).max() < ROUNDING and np.abs(q[k, 1] - q0[k] - 0.5 * h * (v0[k] + w)).max() < ROUNDING


def test_an_arm_at_rest_starts_again_when_the_disturbance_says_so() -> None:
    """All brakes closed, all joints at rest, until a piece of the disturbance is more than they hold."""
    arms, q0, v0, u = many(5, 10)
    u[:, 5:] = 0.0
    u[:, 6, 2] = 2.0 * (arms.brake_torque + arms.fc)[:, 2] + 100.0
    q, v = simulate_stops(arms, q0, v0, 5e-4, 800, u)
    assert np.all(v[:, 599] == 0.0)  # the seventh of eight pieces begins with step 600
    assert np.all(v[:, 601, 2] > 0.0) and np.all(np.diff(q[:, 600:650, 2], axis=1) > 0.0)
    assert np.all(v[:, 790, 2] < v[:, 700, 2])


def test_smooth_motion_agrees_with_an_independent_integrator() -> None:
    """No dry friction, no brake: an ordinary differential equation, solved to 1e-11 by others."""
    pin = pytest.importorskip("pinocchio")
    from scipy.integrate import solve_ivp

    model = pin.buildModelFromXML(ARM.urdf)
    model.gravity.linear = ARM.chain.gravity
    model.armature[:] = ARM.rotor
    data = model.createData()

    def f(_: float, x: Array) -> Array:
        return np.concatenate([x[6:], pin.aba(model, data, x[:6], x[6:], -FV * x[6:])])

    late = np.full(6, 1.0)
    zero = np.zeros((1, 6))
    for q0, v0, _ in starts(5, 3):
        exact = solve_ivp(f, (0, 0.5), np.concatenate([q0, v0]), method="DOP853", rtol=1e-11, atol=1e-12, t_eval=[0.5]).y[:, -1]
        errors = []
        for dt in (1e-3, 5e-4):
            q, v = stop(dt, q0, v0, zero, 0.5, fc=np.zeros(6), delay=late)
            errors.append(np.abs(np.concatenate([q[-1], v[-1]]) - exact).max())
        # second order with rates of some 20/s: (h rate)^2 / 12 per unit of motion, and at most a third at half the step
        assert errors[1] < 1e-5
        assert errors[0] / errors[1] > 3.0


def test_half_the_step_gives_the_same_stop() -> None:
    """Events (brakes, rest, reversal) included: 0.5 ms against 10 us, within the second order's promise."""
    worst_q = worst_v = 0.0
    for q0, v0, u in starts(30, 4):
        q, v = stop(5e-4, q0, v0, u)
        Q, V = stop(1e-5, q0, v0, u)
        worst_q = max(worst_q, float(np.abs(q - Q[::50]).max()))
        worst_v = max(worst_v, float(np.abs(v - V[::50]).max()))
    assert worst_q < 5e-6
    assert worst_v < 2e-4


def test_after_the_brakes_everything_rests_exactly() -> None:
    for q0, v0, u in starts(10, 5):
        q, v = stop(5e-4, q0, v0, u, 0.4)
        assert np.all(v[-1] == 0.0) and np.all(q[-1] == q[-100])


def test_a_joint_that_friction_holds_does_not_creep_and_one_it_cannot_hold_falls() -> None:
    q0 = np.array([0.0, 0.6, 0.4, 0.0, 0.3, 0.0])
    g = gravity_torque(ARM.chain, ARM.pi, q0)
    zero, never = np.zeros((1, 6)), np.full(6, 9.0)
    q, v = stop(5e-4, q0, np.zeros(6), zero, fc=np.abs(g) * 1.001 + 1e-9, delay=never)
    assert np.all(v == 0.0) and np.all(q == q0)
    weak = np.abs(g) * 1.001 + 1e-9
    heaviest = int(np.argmax(np.abs(g)))
    weak[heaviest] = 0.999 * abs(g[heaviest])
    _, v = stop(5e-4, q0, np.zeros(6), zero, fc=weak, delay=never)
    assert v[-1, heaviest] * g[heaviest] < 0.0


def test_energy_is_what_friction_and_brakes_took() -> None:
    """Kinetic and potential energy lost = work of the friction, integrated along the trace."""
    q0, v0, _ = starts(1, 6)[0]
    dt = 1e-4
    q, v = stop(dt, q0, v0, np.zeros((1, 6)))

    def energy(k: int) -> float:
        M = mass_matrix(ARM.chain, ARM.pi, q[k]) + np.diag(ARM.rotor)
        return float(0.5 * v[k] @ M @ v[k])

    t = np.arange(len(q)) * dt
    brake = BRAKE * np.clip((t[:, None] - 0.02) / 0.018, 0, 1)
    power = np.abs(v) * (FC + brake) + FV * v**2
    g = np.array([gravity_torque(ARM.chain, ARM.pi, x) for x in q])
    taken = np.trapezoid(power.sum(1), dx=dt) + np.trapezoid((g * v).sum(1), dx=dt)
    lost = energy(0) - energy(len(q) - 1)
    assert lost == pytest.approx(taken, rel=1e-3)  # the trapezoid of the brake's kinks at 0.1 ms
