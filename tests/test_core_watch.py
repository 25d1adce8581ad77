"""The core's part of the monitor's cycle against the same written plainly: input, unknown states, predictions, message."""

from __future__ import annotations

import math
import zlib
from dataclasses import replace

import numpy as np
import pytest

from stopset.artifact.inputs import InputMap, effect_torques, law_signals, memories_along
from stopset.artifact.taped import SIGNALS
from stopset.core.library import ffi, lib, view
from stopset.effects import Fitted
from stopset.effects.memory import coefficients, stepped
from stopset.effects.registry import catalogue, get
from stopset.errors import EffectError
from stopset.monitor.layout import outward
from stopset.ring import Tape
from stopset.robot import load_robot
from stopset.robot.rigid import gravity_torques, torques
from stopset.types import Array

ARM = load_robot("lwa4p")
N = 37
RNG = np.random.default_rng(0)
Q, DQ, TAU = RNG.normal(size=(3, N, ARM.n))
TEMP, T = 20.0 + 20.0 * RNG.random((N, ARM.n)), np.arange(N) * 0.01


def plainly(m: InputMap, q: Array, dq: Array, tau: Array, temp: Array, warm: float, t: Array) -> Array:
    """Eq. (11) with numpy, effect by effect."""
    u = tau / m.gain - m.offset
    if m.effort != "compensated_torque":
        c, pi = m.robot.chain, m.robot.pi
        u = u - (torques(c, pi, q, dq, np.zeros_like(q)) if m.swift else gravity_torques(c, pi, q))
    memories = memories_along(m.robot, m.effects, q, dq, temp=temp, warm=warm, t=t)
    moving = u - effect_torques(m.robot, m.effects, q, dq, temp=temp, warm=warm, t=t, memories=memories)
    if m.effort == "compensated_torque":
        return moving
    ahead, back = (
        effect_torques(m.robot, m.effects, q, np.zeros_like(dq), way=way, temp=temp, warm=warm, memories=memories)
        for way in (1.0, -1.0)
    )
    held = np.clip(u, np.minimum(ahead, back), np.maximum(ahead, back))
    return np.where(np.abs(dq) <= m.standstill, u - held, moving)


def with_effect(name: str, effort: str, swift: bool = False) -> InputMap:
    e = catalogue()[name]
    values = {x.symbol: RNG.uniform(max(x.lo, -2.0), min(x.hi, 2.0)) for x in e.terms} | {x.symbol: x.grid[0] for x in e.shapes}
    at = [None] if e.scope == "arm" else ["+".join(ARM.joints[1:3])] if e.scope == "pair" else ARM.joints[:4:2]
    return InputMap(
        ARM,
        tuple(Fitted(name, j, values) for j in at),
        effort,
        np.full(ARM.n, 1.1),
        RNG.normal(size=ARM.n),
        np.full(ARM.n, 0.3),
        swift,
    )


@pytest.mark.parametrize(("effort", "swift"), [("motor_torque", False), ("motor_torque", True), ("compensated_torque", False)])
@pytest.mark.parametrize("name", catalogue())
def test_the_input_is_that_of_the_laws(name: str, effort: str, swift: bool) -> None:
    """Rows beyond one block of the core, and joints at rest among them."""
    m = with_effect(name, effort, swift)
    got, want = m(Q, DQ, TAU, TEMP, 0.3, T), plainly(m, Q, DQ, TAU, TEMP, 0.3, T)
    if "dtau" in get(name).needs:  # at rest no torque changes, whatever the recording did before and after
        got, want = (np.where(np.abs(DQ) <= m.standstill, 0.0, x) for x in (got, want))
    assert np.abs(got - want).max() < 1e-12 * max(1.0, np.abs(want).max())


def test_rows_by_themselves_are_the_rows_together() -> None:
    m = with_effect("load_coulomb", "motor_torque")
    assert np.array_equal(m(Q, DQ, TAU), np.vstack([m(Q[k : k + 1], DQ[k : k + 1], TAU[k : k + 1]) for k in range(N)]))


def test_every_step_of_a_tape_does_what_it_says() -> None:
    tape = Tape()
    x, y = tape.signal(SIGNALS.index("q")), tape.signal(SIGNALS.index("dq"))
    signals = np.zeros((lib.STOPSET_SIGNALS, 40))
    a, b = signals[0], signals[1]
    a[:], b[:] = RNG.normal(size=(2, 40))
    a[:4], b[:4] = [math.nan, 1.0, 0.0, -0.0], [1.0, math.nan, 0.0, 2.0]
    for number, want in (
        (x + y, a + b), (x - 2.0, a - 2.0), (2.0 - x, 2.0 - a), (x * y, a * b), (x / y, a / np.where(b == 0.0, np.nan, b)),
        (1.0 / y, 1.0 / np.where(b == 0.0, np.nan, b)), (-x, -a), (x**3, a * a * a), (x**0, np.ones(40)), (x.absolute(), np.abs(a)),
        (x.sign(), np.sign(a)), (x.square(), a * a), (x.absolute().sqrt(), np.sqrt(np.abs(a))), (x.minimum(y), np.minimum(a, b)),
        (x.maximum(0.5), np.maximum(a, 0.5)),
    ):  # fmt: skip
        steps, numbers = replace(tape, steps=list(tape.steps), numbers=list(tape.numbers), _place=dict(tape._place)).finished(
            replace(number, tape=tape)
        )
        law = ffi.new("StopsetProgram *", (number.at + 1, ffi.cast("int32_t *", ffi.from_buffer(steps)), view(numbers)))
        out = np.empty(40)
        lib.stopset_law(law, 40, view(signals), view(out))
        fine = ~np.isnan(want) | np.isnan(a) | np.isnan(b)
        assert np.array_equal(out[fine], want[fine], equal_nan=True), (steps[number.at], out, want)
    for name in ("sin", "cos", "exp", "tanh"):
        number = getattr(x, name)()
        steps, numbers = tape.finished(number)
        law = ffi.new("StopsetProgram *", (number.at + 1, ffi.cast("int32_t *", ffi.from_buffer(steps)), view(numbers)))
        lib.stopset_law(law, 40, view(signals), view(out))
        assert np.allclose(out, getattr(np, name)(a), rtol=1e-15, equal_nan=True)


def test_a_step_is_written_once_and_a_long_law_is_refused() -> None:
    tape = Tape()
    x = tape.signal(0)
    assert (x * x).at == (x * x).at and (x + 1.0).at == (x + 1.0).at
    with pytest.raises(ValueError, match="256 elementary steps"):
        for k in range(300):
            x = x * x + float(k)
    with pytest.raises(ValueError, match="not a number"):
        Tape().constant(math.nan)


def test_a_law_that_is_no_sum_of_steps_is_refused_with_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    m = with_effect("viscous", "motor_torque")
    broken = replace(get("viscous"), law=lambda s, shape: (s.dq if s.dq > 0 else 0.0,))
    monkeypatch.setattr("stopset.artifact.taped.get", lambda name: broken)
    with pytest.raises(EffectError, match="taken apart into elementary steps"):
        m(Q, DQ, TAU)


def test_a_states_interval_goes_on_as_its_flow_says() -> None:
    """The core's step of one state's two ends against `stopset.effects.memory`."""
    from monitor_arm import DT, known_model
    from stopset.monitor.inputs import Inputs
    from stopset.monitor.watch import Quantum

    model = known_model()
    f = Fitted("hysteresis", model.joints[0], {"F_h": 12.0, "delta": 0.02}, {})
    model = replace(model, effects=(f,))
    inputs = Inputs.of(model, Quantum.none(model.n), (0.0, 0.0))
    z = inputs.carried.ends.copy()[0]
    for k in range(20):
        q, dq = Q[k, : model.n], DQ[k, : model.n]
        b, a = coefficients(get("hysteresis"), law_signals(model.robot, [(f, get("hysteresis"))], q[None], dq[None])[0], f.values)
        _, du = inputs(q, dq, TAU[k, : model.n], None)
        assert du[0] == pytest.approx(0.5 * 12.0 * (z[1] - z[0]), rel=1e-12, abs=1e-15) and not du[1:].any()
        z = np.array([stepped(z, b, a, DT).min(), stepped(z, b, a, DT).max()])
        assert np.allclose(inputs.carried.ends[0], z, rtol=1e-13, atol=1e-15)


def test_checksums_and_rounding() -> None:
    for data in (b"", b"\0", b"123456789", bytes(range(256)) * 3):
        here = ffi.from_buffer("uint8_t[]", data)
        assert lib.stopset_crc32(len(data), here) == zlib.crc32(data)
    assert lib.stopset_crc32c(9, ffi.from_buffer("uint8_t[]", b"123456789")) == 0xE3069283
    x = np.array([0.1, -0.1, 1e-60, -1e-60, 1e300, -1e300, math.inf, -math.inf, 0.0, -0.0, 0.5, math.nan, 1.4e-45, 3.0e38])
    for side in (1, -1):
        bits = np.empty(len(x), np.uint32)
        lib.stopset_outward(
            len(x), view(x), ffi.from_buffer("int8_t[]", np.full(len(x), side, np.int8)), ffi.from_buffer("uint32_t[]", bits)
        )
        assert np.array_equal(bits.view(np.float32).astype(float), [outward(v, "up" if side > 0 else "down") for v in x])
