"""How accurate and how fast the simulated arm is: `python benchmarks/simulation.py`, a minute on one core.

Accuracy: every step size against a forty times finer one (step halving with events: sticking, reversal, brakes), and,
where no dry friction acts, against an eighth-order Runge-Kutta on pinocchio's forward dynamics.  Speed: robot seconds
per second, and stops per second.
"""

from __future__ import annotations

import time

import numpy as np

from stopset.offline.description import load_robot
from stopset.robot import Robot
from stopset.simulation import PLANS, prepare, simulate_stop
from stopset.simulation.arm import Script, run, start
from stopset.simulation.plant import Plant, healthy_plant
from stopset.types import Array

STEPS = (2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4)
FINE = 6.25e-6


def stops(robot: Robot, plant: Plant, count: int, horizon: float = 0.24) -> None:
    rng = np.random.default_rng(1)
    n = robot.n
    cases = [
        (rng.uniform(-3, 3, n), rng.uniform(-1.26, 1.26, n), rng.uniform(-2, 2, (6, n)), rng.uniform(0.9, 1.1, (3, n)))
        for _ in range(count)
    ]

    def go(dt: float) -> list[tuple[Array, Array]]:
        return [
            simulate_stop(
                plant.chain, plant.pi, plant.rotor, plant.fc * s[0], plant.fv * s[1], plant.brake_torque * s[2],
                plant.brake_delay, plant.brake_rise, q0, v0, dt, round(horizon / dt), u,
            )
            for q0, v0, u, s in cases
        ]  # fmt: skip

    exact = go(FINE)
    print(f"STOP 0 with disturbances, {count} random states, {robot.name}: error against steps of {FINE * 1e6:.3g} us")
    print("   step [ms]  angle max [rad]  median     speed max [rad/s]  median     us/step  stops/s")
    for dt in STEPS:
        go(dt)
        clock = time.perf_counter()
        got = go(dt)
        took = time.perf_counter() - clock
        k = round(dt / FINE)
        eq = [np.abs(a[0] - b[0][::k]).max() for a, b in zip(got, exact, strict=True)]
        ev = [np.abs(a[1] - b[1][::k]).max() for a, b in zip(got, exact, strict=True)]
        print(
            f"   {dt * 1e3:<9.4g}  {max(eq):<15.1e}  {np.median(eq):<9.1e}  {max(ev):<17.1e}  {np.median(ev):<9.1e}  "
            f"{took / count / (horizon / dt) * 1e6:<7.2f}  {count / took:.0f}"
        )


def smooth(robot: Robot, plant: Plant) -> None:
    import pinocchio as pin
    from scipy.integrate import solve_ivp

    model = pin.buildModelFromXML(robot.urdf)
    model.gravity.linear = robot.chain.gravity
    model.armature[:] = plant.rotor
    data, n = model.createData(), robot.n

    def f(_: float, x: Array) -> Array:
        return np.concatenate([x[n:], pin.aba(model, data, x[:n], x[n:], -plant.fv * x[n:])])

    rng = np.random.default_rng(2)
    never, zero = np.full(n, 1e3), np.zeros(n)
    print("free fall with viscous friction, 1 s: error against Runge-Kutta 8 (1e-11) on pinocchio's forward dynamics")
    cases = [(rng.uniform(-3, 3, n), rng.uniform(-1.2, 1.2, n)) for _ in range(5)]
    for dt in STEPS[1:]:
        worst = 0.0
        for q0, v0 in cases:
            x0 = np.concatenate([q0, v0])
            want = solve_ivp(f, (0, 1), x0, method="DOP853", rtol=1e-11, atol=1e-12, t_eval=[1.0]).y[:, -1]
            q, v = simulate_stop(
                plant.chain, plant.pi, plant.rotor, zero, plant.fv, zero, never, never, q0, v0, dt, round(1 / dt),
                np.zeros((1, n)),
            )  # fmt: skip
            worst = max(worst, float(np.abs(np.concatenate([q[-1], v[-1]]) - want).max()))
        print(f"   {dt * 1e3:<6.4g} ms  {worst:.1e} rad, rad/s")


def long_run(robot: Robot, plant: Plant) -> None:
    n, period, seconds = robot.n, 0.004, 120.0
    t = np.arange(round(seconds / period)) * period
    w = np.array([1.1, 0.9, 1.3, 0.8, 1.2, 1.5, 1.0])[:n]
    q = 0.7 * np.sin(np.outer(t, w) + np.arange(n))
    dq = 0.7 * w * np.cos(np.outer(t, w) + np.arange(n))
    zero = np.zeros_like(q)
    script = Script(period, zero, q, dq, np.full(n, 800.0), np.full(n, 80.0), len(t), len(t), zero, zero, 0.0, zero)
    everything = plant._replace(
        fv_slope=np.full(n, 0.02), breakaway=0.2 * plant.fc, stribeck_speed=np.full(n, 0.08), tooth=np.full(n, 0.05),
        stiffness=np.full(n, 3000.0), twist_damping=np.full(n, 5.0), ripple=np.full(n, 0.5), ripple_order=np.full(n, 60.0),
    )  # fmt: skip
    print(f"{seconds:.0f} s of closed-loop motion, {n} joints")
    for name, p in (("healthy", plant), ("elastic gears, Stribeck, load, ripple, heat", everything)):
        for steps in (8, 16):
            state = start(p, q[0], dq[0], np.full(n, 25.0))
            clock = time.perf_counter()
            run(p, script, state, np.full(n, 1e-3), 23.0, 1e-3, steps)
            took = time.perf_counter() - clock
            print(f"   {period / steps * 1e3:.2f} ms steps, {name}: {took:.2f} s, {seconds / took:.0f} x real time")


def campaign(robot: Robot) -> None:
    for plan in PLANS:
        clock = time.perf_counter()
        scenario = prepare(robot, ["stribeck", "payload"], plan=plan)
        sized = time.perf_counter() - clock
        rows = sum(len(r.t) for r in scenario.recordings())
        took = time.perf_counter() - clock
        print(f"campaign {plan}: {rows} rows, two effects sized in {sized:.1f} s, all in {took:.1f} s")


def main() -> None:
    robot = load_robot("lwa4p")
    plant = healthy_plant(robot, np.random.default_rng(1))
    zero = np.zeros(robot.n)  # compile before the clock runs
    simulate_stop(
        plant.chain, plant.pi, plant.rotor, plant.fc, plant.fv, plant.brake_torque, plant.brake_delay, plant.brake_rise,
        zero, zero, 1e-3, 1, np.zeros((1, robot.n)),
    )  # fmt: skip
    stops(robot, plant, 200)
    smooth(robot, plant)
    prepare(robot)
    long_run(robot, plant)
    campaign(robot)


if __name__ == "__main__":
    main()
