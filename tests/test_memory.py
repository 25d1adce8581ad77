"""Laws with memory: one rule steps their states everywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stopset.artifact.inputs import effect_torques, memories_along
from stopset.effects import Effect, Fitted, Signals, Term, catalogue, get
from stopset.effects.memory import affine, along, coefficients, stepped
from stopset.effects.signals import Samples
from stopset.errors import EffectError
from stopset.offline.description import robot_from_text
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.search.wanted import wanted
from stopset.offline.nominal.open_loop import DIRECTION_WIDTH, EffectTerm, JointBatch, roll_out
from stopset.recording import Recordings
from stopset.simulation import prepare
from stopset.types import Array
from test_diagnose import ARM

LASTING = ("hysteresis", "self_heating")
DT = 0.004


def swinging(rng: np.random.Generator, rows: int = 400) -> Signals:
    """Speeds that turn round many times and rest now and then."""
    t = np.arange(rows) * DT
    dq = sum(a * np.sin(w * t + p) for a, w, p in rng.uniform([0.1, 3.0, 0.0], [0.6, 40.0, 6.0], (3, 3)))
    return Signals(dq=np.where(rng.random(rows) < 0.05, 0.0, dq))


@pytest.mark.parametrize("name", LASTING)
def test_states_follow_their_flow(name: str) -> None:
    """Against an integrator of differential equations, the speed held over each step."""
    effect, s = get(name), swinging(np.random.default_rng(1))
    shapes = effect.shape_values(None)
    first = np.arange(len(s.dq)) == 0
    (z,) = along(effect, s, shapes, first, np.full(len(s.dq), DT))
    x = np.array(effect.at_start)
    for k in range(len(s.dq)):
        assert z[k] == pytest.approx(x[0], abs=1e-8)
        now = Signals(dq=float(s.dq[k]))
        flow = lambda _, y, now=now: np.array(effect.rates(replace(now, memory=tuple(y)), shapes))  # noqa: E731
        x = solve_ivp(flow, (0.0, DT), x, rtol=1e-10, atol=1e-13).y[:, -1]


def test_every_trial_begins_at_the_effect_s_own_start() -> None:
    effect, s = get("self_heating"), Signals(dq=np.full(60, 0.5))
    first = np.isin(np.arange(60), [0, 20, 50])
    (w,) = along(effect, s, effect.shape_values(None), first, np.full(60, DT))
    assert np.array_equal(w == 0.0, first) and w[49] > w[30] > w[21] > 0


@pytest.mark.parametrize("name", LASTING)
def test_the_ends_of_an_interval_enclose_every_state_and_the_middle_stays_the_middle(name: str) -> None:
    effect, rng = get(name), np.random.default_rng(2)
    assert affine(effect)
    s, lo, hi = swinging(rng), effect.states[0].lo, effect.states[0].hi
    b, a = coefficients(effect, s, effect.shape_values(None))
    z = np.concatenate([[lo, hi, 0.5 * (lo + hi)], rng.uniform(lo, hi, 200)])
    for k in range(len(s.dq)):
        z = stepped(z, b[k], a[k], DT)
        assert np.all((z >= z[0] - 1e-12) & (z <= z[1] + 1e-12)) and z[2] == pytest.approx(0.5 * (z[0] + z[1]))
    assert z[1] - z[0] < hi - lo, "the ends come together"


def squares(s: Signals, shape: object) -> tuple[object, ...]:
    return (s.memory[0] * (s.dq - s.memory[0]),)


def test_a_flow_of_another_kind_is_told_apart_and_integrated_all_the_same() -> None:
    effect: Effect = replace(get("self_heating"), name="curved", flow=squares, states=(Term("w", "1", "a share", 0.0, 9.0, 0.5),))
    assert not affine(effect) and not affine(get("elasticity"))
    first = np.arange(400) == 0
    (w,) = along(effect, Signals(dq=np.ones(400)), {}, first, np.full(400, 0.01))
    t = 0.01 * np.arange(400)
    assert w == pytest.approx(1.0 / (1.0 + np.exp(-t)), abs=1e-5)  # the logistic curve; Heun's error is of third order


def test_torque_at_rest_knows_what_the_way_there_left_behind() -> None:
    """At standstill the friction is between the torques of both directions, each with the state that the motion left."""
    robot = robot_from_text(ARM)
    fitted = (Fitted("hysteresis", "a", {"F_h": 2.0, "delta": 0.01}),)
    t = np.arange(200) * DT
    dq = np.zeros((200, 2))
    dq[:100, 0] = 0.4  # sixteen ways to build up, then rest
    q = np.cumsum(dq, axis=0) * DT
    memories = memories_along(robot, fitted, Samples(q, dq, t=t))
    back = effect_torques(robot, fitted, Samples(q, np.zeros_like(dq)), direction=-1.0, memories=memories)
    assert memories[0][0][-1] == pytest.approx(1.0, abs=1e-6)
    assert back[-1, 0] == pytest.approx(4.0, abs=1e-5), "F_h (z - way): wound up all the way against the new direction"
    with pytest.raises(EffectError, match="hysteresis:a has a memory"):
        effect_torques(robot, fitted, Samples(q, dq))


@pytest.fixture(scope="module")
def healthy() -> tuple[object, Recordings]:
    scenario = prepare(robot_from_text(ARM), ["none"], 1, "short")
    return scenario.robot, Recordings(replace(scenario.meta, sources=()), tuple(scenario.recordings()))


def test_self_heating_is_looked_for_only_where_no_temperature_is_recorded(healthy: tuple[object, Recordings]) -> None:
    robot, recordings = healthy
    bare = replace(recordings, trials=tuple(replace(r, temp=None) for r in recordings))
    for data, offered in ((recordings, False), (bare, True)):
        names = {effect.name for effect, _, _ in wanted(Engine.build(robot, data))}  # type: ignore[arg-type]
        assert ({"self_heating", "warm_up"} <= names) == offered
        assert ({"thermal_viscous", "thermal_coulomb"} <= names) != offered


def test_effects_with_one_state_can_be_carried_by_monitor_and_fmu() -> None:
    ours = [e for e in catalogue().values() if e.states and e.name != "elasticity" and e.law.__module__.startswith("stopset.")]
    assert {e.name for e in ours} == set(LASTING) and all(affine(e) for e in ours)


def test_the_open_loop_simulation_of_compensated_torque_carries_the_state_too() -> None:
    """Against an integrator of others; its steps hold the effect's torque, so halving them halves the error."""
    terms, values = [EffectTerm(get("self_heating"), {"tau_w": 0.5})], np.array([[0.0, -2.0, -4.0]])
    J, v = 1.5, 9.0

    def u(t: float) -> float:
        return 12.0 * np.sin(5.0 * t)

    def flow(t: float, y: Array, dt: float) -> list[float]:
        _q, dq, w = y
        heated = w * (-2.0 * dq - 4.0 * np.tanh(dq / DIRECTION_WIDTH))
        return [dq, (u(dt * np.floor(t / dt + 1e-9)) - v * dq - heated) / J, (abs(dq) - w) / 0.5]

    errors = []
    for dt in (0.004, 0.002):
        t = dt * np.arange(round(1.6 / dt) + 1)
        z, one = np.zeros((len(t), 1)), np.ones((len(t), 1), bool)
        batch = JointBatch(dt, z, z, np.array([[u(x)] for x in t]), z, z, np.zeros(1), one)
        _, dq = roll_out(batch, np.array([J]), np.array([v]), values, terms)
        want = np.zeros((len(t), 3))
        for k in range(len(t) - 1):
            span = (t[k], t[k] + 0.999999 * dt)
            want[k + 1] = solve_ivp(flow, span, want[k], rtol=1e-8, atol=1e-10, args=(dt,)).y[:, -1]
        errors.append(float(np.abs(dq[0, :, 0] - want[:, 1]).max()))
        cold = roll_out(batch, np.array([J]), np.array([v]), values[:, :1], [])[1]
        assert np.abs(cold - dq).max() > 0.1, "the warmth shows"
    assert errors[0] < 0.01 and errors[1] < 0.6 * errors[0]
    with pytest.raises(EffectError, match="elasticity remembers x, dx"):
        EffectTerm(get("elasticity"), {}).begun((1, 1))
