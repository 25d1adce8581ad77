"""The contract every effect is held to, ours and others': sound parameters, one law whatever number goes in."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import stopset.effects.registry as registry
from stopset.artifact.inputs import entry
from stopset.artifact.taped import SIGNALS, TILT, parameters_of, recorded
from stopset.core.library import ffi, lib, view
from stopset.effects import Effect, Signals, catalogue, check, get
from stopset.effects.selection import base, of_part, usual, usual_friction
from stopset.effects.signals import Samples, arm_signals
from stopset.errors import EffectError
from stopset.offline.description import load_robot
from stopset.ring import Interval
from stopset.robot.rigid import gravity_torques, torques
from synthetic import with_payload

NAMES = [
    "thermal_viscous",
    "thermal_coulomb",
    "warm_up",
    "self_heating",
    "stribeck",
    "load_coulomb",
    "asymmetric_coulomb",
    "cubic_viscous",
    "payload",
    "rotor_inertia",
    "elasticity",
    "torque_ripple",
    "hysteresis",
    "torque_gain",
    "delay",
    "base_tilt",
    "spring",
    "coupling",
    "encoder_offset",
    "encoder_eccentricity",
    "coriolis",
    "coulomb",
    "viscous",
]
SCALARS = (
    "q", "dq", "ddq", "load", "tau", "dtau", "link", "temp", "warm", "stiff", "inertia", "coriolis", "dq_other", "ddq_other",
)  # fmt: skip
RANGE = {"inertia": (0.1, 3.0), "warm": (0.0, 1.0), "temp": (-10.0, 30.0), "load": (-30.0, 30.0)}


def drawn(effect: Effect, rng: np.random.Generator, size: int = 50) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Random signals by variable name, and random parameter values within their ranges."""
    s = {k: rng.uniform(*RANGE.get(k, (-2.0, 2.0)), size) for k in SCALARS}
    s |= {f"tip{k}": rng.uniform(-3, 3, size) for k in range(10)} | {f"tilt{k}": rng.uniform(-9, 9, size) for k in range(2)}
    s |= {f"memory{k}": rng.uniform(max(m.lo, -1), min(m.hi, 1), size) for k, m in enumerate(effect.states)}
    values = {t.symbol: float(rng.uniform(max(t.lo, -2.0), min(t.hi, 2.0))) for t in effect.terms}
    values |= {p.symbol: float(rng.choice(p.grid)) * float(rng.uniform(0.9, 1.1)) for p in effect.shapes}
    return s, values


def signals(v: dict[str, object], effect: Effect) -> Signals:
    return Signals(
        **{k: v[k] for k in SCALARS},
        tip=tuple(v[f"tip{k}"] for k in range(10)), tilt=(v["tilt0"], v["tilt1"]),
        memory=tuple(v[f"memory{k}"] for k in range(len(effect.states))),
    )  # fmt: skip


@pytest.fixture(params=list(catalogue()))
def effect(request: pytest.FixtureRequest) -> Effect:
    return get(request.param)


def test_catalogue_holds_the_names_others_rely_on() -> None:
    assert set(NAMES) <= set(catalogue())


def test_story_and_parameters_are_complete(effect: Effect) -> None:
    check(effect, effect.name)
    for p in (*effect.terms, *effect.shapes):
        assert p.symbol and p.unit and p.means and np.isfinite([p.lo, p.hi]).all(), f"{p.symbol} has no admissible range"
    assert effect.look_at and entry(effect)
    symbols = [t.symbol for t in effect.terms] + [p.symbol for p in effect.shapes]
    assert len(set(symbols)) == len(symbols)
    assert set(effect.looks_like) <= set(catalogue()) - {effect.name}
    assert effect.looks_like and effect.distinguished_by.endswith(".") and effect.says.endswith(".")
    assert bool(effect.states) == (effect.flow is not None)


def test_torque_is_linear_in_the_terms(effect: Effect) -> None:
    s, values = drawn(effect, np.random.default_rng(1))
    sig = signals(s, effect)
    columns = effect.columns(sig, values)
    direct = sum(np.asarray(c) * values[t.symbol] for c, t in zip(columns, effect.terms, strict=True))
    # rounding of a sum of k products of size <= 1e3
    assert np.allclose(effect.torque(sig, values), direct, rtol=1e-13, atol=1e-11)
    doubled = values | {t.symbol: 2 * values[t.symbol] for t in effect.terms}
    assert np.allclose(effect.torque(sig, doubled), 2 * np.asarray(direct), rtol=1e-13, atol=1e-11)


def test_law_does_nothing_without_its_signals(effect: Effect) -> None:
    """`needs` names what the law reads: with all of that at zero and all else wild, columns must not change."""
    rng = np.random.default_rng(2)
    s, values = drawn(effect, rng)
    reads = set(effect.needs)
    groups = {"tip": [f"tip{k}" for k in range(10)], "tilt": ["tilt0", "tilt1"], "memory": [k for k in s if k[:6] == "memory"]}
    used = {x for need in reads for x in groups.get(need, [need])}
    other = {k: (v if k in used else rng.permutation(v) * 3.7 + 1.0) for k, v in s.items()}
    for a, b in zip(effect.columns(signals(s, effect), values), effect.columns(signals(other, effect), values), strict=True):
        assert np.array_equal(np.broadcast_to(a, 50), np.broadcast_to(b, 50)), f"{effect.name} reads more than it says"


def test_interval_encloses_every_sample(effect: Effect) -> None:
    rng = np.random.default_rng(3)
    s, values = drawn(effect, rng)
    width = rng.uniform(0.0, 0.3, 50)
    boxes = {k: Interval(v - width, v + width) for k, v in s.items() if k != "inertia"}
    boxes["inertia"] = Interval(s["inertia"], s["inertia"] + width)
    bound = effect.torque(signals(boxes, effect), values)
    for _ in range(200):
        inside = {k: rng.uniform(b.lo, b.hi) for k, b in boxes.items()}
        torque = np.broadcast_to(effect.torque(signals(inside, effect), values), 50)
        assert np.all(torque >= np.broadcast_to(bound.lo, 50)) and np.all(torque <= np.broadcast_to(bound.hi, 50))
        for rate, range_ in zip(*(effect.rates(signals(x, effect), values) for x in (inside, boxes)), strict=True):
            assert np.all((rate >= range_.lo) & (rate <= range_.hi)), "the states' flow"


def test_c_text_computes_the_same(effect: Effect) -> None:
    """Played by the core, recorded with other numbers; to the last bits of the elementary functions."""
    rng = np.random.default_rng(4)
    s, values = drawn(effect, rng)
    other = {k: 0.5 * v + 0.1 for k, v in values.items()}
    sig = replace(signals(s, effect), ddq_other=0.0)  # no sample of the core holds it
    rows = np.zeros((lib.STOPSET_SIGNALS, 50))
    for k, name in enumerate(SIGNALS):
        rows[k] = np.broadcast_to(getattr(sig, name) if name != "given_direction" else np.sign(sig.dq), 50)
    for k, x in enumerate([*sig.tilt, *sig.tip, *sig.memory]):
        rows[TILT + k] = x
    wanted = [(-1, effect.torque(sig, values)), *enumerate(effect.rates(sig, values))]
    for which, numeric in wanted:
        tape = recorded(effect, other, which)
        assert tape.parametric and parameters_of(effect, other) == list(values)
        numbers = np.array([*values.values(), *tape.numbers[len(values) :]])
        law = ffi.new("StopsetProgram *", (len(tape.steps), ffi.from_buffer("int32_t[]", tape.steps), view(numbers)))
        out = np.empty(50)
        lib.stopset_law(law, 50, view(rows), view(out))
        # sin, cos and exp of two libraries differ by a few units in the last place; sums of ten products add as many
        assert out == pytest.approx(np.broadcast_to(numeric, 50), rel=1e-12, abs=1e-12)


def test_payload_tilt_and_offset_are_the_rigid_body_s_derivatives() -> None:
    robot = load_robot("lwa4p")
    rng = np.random.default_rng(5)
    q, dq, ddq = (rng.uniform(-1, 1, (20, robot.n)) for _ in range(3))
    sig = arm_signals(robot, Samples(q, dq, ddq))
    mass, com = 2.0, np.array([0.02, -0.03, 0.1])
    loaded = with_payload(robot, mass, com)
    more = torques(loaded.chain, loaded.pi, q, dq, ddq) - torques(robot.chain, robot.pi, q, dq, ddq)
    values = dict(zip([t.symbol for t in get("payload").terms], loaded.pi[-1] - robot.pi[-1], strict=True))
    ours = np.stack([get("payload").torque(s, values) for s in sig], axis=1)
    assert np.allclose(ours, more, atol=1e-10)

    angle = 1e-5  # small: the law is first order, its error angle^2 g
    turn = np.array([[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]])
    tilted = robot.chain._replace(gravity=turn @ robot.chain.gravity)
    change = (gravity_torques(tilted, robot.pi, q) - gravity_torques(robot.chain, robot.pi, q)) / angle
    roll = np.stack([get("base_tilt").columns(s)[0] for s in sig], axis=1)
    assert np.allclose(roll, change, atol=1e-2 * np.abs(change).max())

    step = 1e-5
    for j, s in enumerate(sig):
        shifted = q.copy()
        shifted[:, j] += step
        slope = (gravity_torques(robot.chain, robot.pi, shifted) - gravity_torques(robot.chain, robot.pi, q))[:, j] / step
        assert np.allclose(get("encoder_offset").columns(s)[0], slope, atol=1e-3)


def test_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(EffectError, match="stribeck"):
        get("phlogiston")


def test_an_own_effect_registers_by_entry_point(own_effect: Effect) -> None:
    assert get("relaxing_hose") is own_effect
    assert own_effect.name in registry.names()


@pytest.mark.parametrize(
    ("value", "says"),
    [(object(), "expected a stopset.effects.Effect"), (None, "expected a stopset.effects.Effect")],
)
def test_a_foreign_object_is_refused(monkeypatch: pytest.MonkeyPatch, value: object, says: str) -> None:
    entry = SimpleNamespace(name="x", value="mine:X", load=lambda: value)
    monkeypatch.setattr(registry, "entry_points", lambda group: [entry])
    registry.catalogue.cache_clear()
    try:
        with pytest.raises(EffectError, match=says):
            catalogue()
    finally:
        monkeypatch.undo()
        registry.catalogue.cache_clear()


@pytest.mark.parametrize(
    ("name", "change", "word"),
    [
        ("stribeck", {"usual": 4}, "tried unasked"),
        ("hysteresis", {"usual": 1}, "tried unasked"),
        ("spring", {"periodic": True}, "cycles per turn"),
        ("coulomb", {"part": "rust"}, "is the part 'rust'; expected one of"),
    ],
)
def test_what_an_effect_says_of_itself_must_be_so(name: str, change: dict[str, Any], word: str) -> None:
    with pytest.raises(EffectError, match=word):
        check(replace(catalogue()[name], **change), name)


def test_the_plain_arms_parts_and_what_is_tried_unasked() -> None:
    """Nothing else of stopset names them: these are the answers it gets."""
    parts = ("dry friction", "damping", "constant torque", "torque scale", "load")
    assert [of_part(p).name for p in parts] == ["coulomb", "viscous", "asymmetric_coulomb", "torque_gain", "payload"]
    assert base() == ("coulomb", "viscous")
    assert usual() == ("load_coulomb", "cubic_viscous", "asymmetric_coulomb")
    assert usual("pair") == ("coupled_wrist", "opposed_wrist")
    assert usual_friction() == ("coulomb", "viscous", "load_coulomb", "cubic_viscous")
