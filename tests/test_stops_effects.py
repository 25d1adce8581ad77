"""Effects in a stop: each by its own law, ours and others'; who cannot be bounded is refused by name, nobody is forgotten."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import stopset.effects.registry as registry
from acting_reference import Sight
from acting_reference import acting as reference
from slopes import Slope
from stop_tubes import tube_of
from stopset.artifact import Model, save_model
from stopset.cli.main import main
from stopset.effects import Effect, Signals, Term, catalogue, check, get
from stopset.effects.base import Fitted, Number
from stopset.effects.bound import ACTING, SIGMAS, parameter
from stopset.errors import EffectError, NotCovered
from stopset.fmu.sources import sources
from stopset.fmu.stops import bounds_of, stop_data, stop_refusal
from stopset.fmu.variables import variables
from stopset.monitor.config import Stops
from stopset.monitor.sample import Quantum
from stopset.monitor.stopdesk import StopDesk
from stopset.offline.nominal.known_effects import described
from stopset.offline.revise.revise import stop_figures
from stopset.reach.stops import StopBounds, tubes
from stopset.reach.stops.friction import acted, torques_of
from stopset.reach.stops.laws import acting_law
from stopset.reach.stops.payload import per_kg, weighed
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Tube
from stopset.reach.stops.tubes import Region, fastest, tubes_of
from stopset.ring import Interval, absolute, cos, exp, maximum, minimum, sign, sin, sqrt, square, tanh
from stopset.robot.rigid import gravity_torque
from stopset.sets import Box
from test_fmu import friction
from test_fmu_stops import braked, core_stop
from test_hidden_effects import ARM

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like
from stops_effects import cases, hiding, identified, run, stopped

JOINTS = prbt_like().joints
CASES = cases(JOINTS)
REFUSED = {
    "elasticity": (CASES["elasticity"], "elasticity:arm_2_joint: it swings"),
    "backlash": (CASES["backlash"], "backlash:arm_2_joint: its link is loose within a gap"),
    "coupled_wrist": (CASES["coupled_wrist"], f"coupled_wrist:{JOINTS[4]}.{JOINTS[5]}: it looks at ddq_other"),
    "opposed_wrist": (CASES["opposed_wrist"], f"opposed_wrist:{JOINTS[4]}.{JOINTS[5]}: it looks at ddq_other"),
    "of_acceleration": ((Fitted("of_acceleration", JOINTS[0], {"k0": 1.0}),), "of_acceleration:arm_1_joint: it looks at ddq"),
    "jumping": ((Fitted("jumping", JOINTS[0], {"k0": 1.0}),), "jumping:arm_1_joint: its law cannot be evaluated"),
    "gone": ((Fitted("gone", JOINTS[0], {"k0": 1.0}),), "gone:arm_1_joint: it is in no catalogue"),
    "unbounded": ((Fitted("wrapped", JOINTS[0], {"k0": np.inf, "k1": 0.0}),), "wrapped:arm_1_joint: its k0 has no bound"),
}
SEEN = Box.symmetric(np.repeat([3.0, 2.0], 6))
Q = np.array([0.1, 0.5, 0.3, -0.4, 0.2, 0.1])
DQ = np.array([1.0, 0.8, -0.7, 0.3, 0.5, -1.0])


def wrapped(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """A hose that is wound up by the joint and rubs where it is bent: of no form that the catalogue has."""
    return (sin(s.q * 2.0) + 0.3 * s.q * s.dq, (1.0 + s.q**2) * s.direction + 0.2 * s.dq * s.load)


def of_acceleration(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """What no stop bounds."""
    return (s.ddq,)


def jumping(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """A law that intervals cannot follow."""
    return (s.q if s.q > 0 else 0.0,)


def outside(name: str, law: object, count: int = 1) -> Effect:
    terms = tuple(Term(f"k{i}", "N m", "size", -50.0, 50.0) for i in range(count))
    return Effect(name, "Somebody else's.", "q", terms, law, "compensation", "khalil2007", ("q", "dq", "load"))  # type: ignore[arg-type]


def driving(s: Signals, shape: Mapping[str, Number]) -> Sequence[Number]:
    """Damping of the wrong sign, if its size is below zero."""
    return (s.dq,)


OTHERS = (
    outside("wrapped", wrapped, 2),
    outside("driving", driving),
    outside("of_acceleration", of_acceleration),
    outside("jumping", jumping),
)
WRAPPED = (Fitted("wrapped", JOINTS[4], {"k0": 4.0, "k1": 0.5}, {"k0": 0.1, "k1": 0.01}),)


@pytest.fixture
def others(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Effects that an installed package registers."""
    entries = [SimpleNamespace(name=e.name, value=f"theirs:{e.name}", load=lambda e=e: e) for e in OTHERS]
    monkeypatch.setattr(registry, "entry_points", lambda group: entries)
    registry.catalogue.cache_clear()
    yield
    monkeypatch.undo()
    registry.catalogue.cache_clear()


def test_a_number_beyond_its_range_keeps_its_uncertainty() -> None:
    """Springs of older models may push; cut at their own value, their stops were bounded as if that were exact on one side."""
    k = get("spring").terms[0]
    inside, beyond = (parameter([Fitted("spring", "a", {"k": v, "c": 0.0}, {"k": 0.1, "c": 0.0})], k) for v in (0.2, -0.3))
    assert (float(inside.lo[0]), float(beyond.lo[0]), float(beyond.hi[0])) == pytest.approx(
        (0.0, -0.3 - SIGMAS * 0.1, -0.3 + SIGMAS * 0.1)
    )


def test_a_slope_holds_every_value_and_how_fast_it_grows() -> None:
    """``f(x)`` in ``all``, ``f(0)`` in ``start``, and ``f(x) - f(0)`` in ``rate x``, for every number in the intervals."""

    def f(x: Number, y: Number, z: Number) -> list[Number]:
        wave, bell = sin(x * 2.0 + y), exp(-square(x * (1.0 / z)))
        return [
            x**3 - y * x, wave * bell, absolute(x - 0.3) + maximum(x * y, z), minimum(x, 0.5) / (z + x), tanh(x * 3.0) - cos(x * y),
            sqrt(z + x) * y, sign(y) * x, (1.0 - x) / (2.0 - y), absolute(-x) * z, -(2.0 - x) * square(x - 1.0),
        ]  # fmt: skip

    rng = np.random.default_rng(0)
    y, z = Interval(np.array(-0.8), np.array(0.4)), Interval(np.array(0.5), np.array(1.5))
    for direction in (1.0, -1.0):
        bounds = f(Slope.variable(0.45, direction), Slope.constant(y), Slope.constant(z))
        for _ in range(300):
            x, fixed = rng.uniform(0.0, 0.45), (rng.uniform(-0.8, 0.4), rng.uniform(0.5, 1.5))
            for b, value, start in zip(bounds, f(direction * x, *fixed), f(0.0, *fixed), strict=True):
                assert value in b.all and start in b.start
                assert b.rate is None or b.rate.lo * x - 1e-12 <= value - start <= b.rate.hi * x + 1e-12


def test_no_module_beyond_the_effects_asks_an_effect_for_its_name() -> None:
    """What an effect does in a stop is in the effect: nobody compares its name."""
    root = Path(__file__).resolve().parents[1]
    names = "|".join(catalogue())
    asks = re.compile(rf"""\.(?:effect|name)\s*(?:==|!=|in|not in)\s*\(?\s*["'](?:{names})["']""")
    for folder in (
        "model/stopset/reach",
        "model/stopset/artifact",
        "fmu/stopset",
        "monitor/stopset",
        "offline/stopset/offline/stops",
    ):
        for path in (root / folder).rglob("*.py"):
            assert not asks.search(path.read_text()), path


def test_every_effect_of_the_catalogue_is_hidden_in_a_stop() -> None:
    assert {f.effect for effects in CASES.values() for f in effects} | {"coulomb", "viscous"} == set(catalogue())


@pytest.mark.parametrize("name", [n for n in CASES if n not in REFUSED])
def test_no_stop_leaves_its_tube_with_the_effect_in_the_arm(name: str) -> None:
    found = run(CASES[name], states=4, stops=12, seed=3)
    assert found["certified"] >= 3 and found["escapes"] == 0, found


def test_no_stop_leaves_its_tube_with_an_effect_from_outside(others: None) -> None:
    found = run(WRAPPED, states=4, stops=12, seed=4)
    assert found["certified"] == 4 and found["escapes"] == 0, found
    assert run(WRAPPED, states=4, stops=12, seed=4, blind=True)["escapes"] > 0


@pytest.mark.parametrize("name", ["base_tilt", "residual_gravity", "coupling", "spring", "encoder_offset", "hysteresis"])
def test_a_bound_that_forgets_the_effect_is_left(name: str) -> None:
    """The same stops find it out: so the tests above would, too."""
    assert run(CASES[name], states=6, stops=12, seed=5, blind=True)["escapes"] > 0


@pytest.mark.parametrize(
    "effect", [*(e for e in catalogue().values() if e.role in ACTING and e.name not in REFUSED), OTHERS[0]], ids=lambda e: e.name
)
def test_a_laws_torque_lies_within_what_it_is_bounded_by(effect: Effect) -> None:
    """``direction (dry + viscous |dq|) + push`` holds the law at every state, in both directions, for every parameter within 3 sigma."""
    rng = np.random.default_rng(0)
    values = {t.symbol: 0.7 * min(t.hi, 3.0) if t.hi > 0 else 0.7 * max(t.lo, -3.0) for t in effect.terms}
    values |= {p.symbol: p.grid[len(p.grid) // 2] for p in effect.shapes}
    f = Fitted(effect.name, "j", values, {t.symbol: 0.05 * abs(values[t.symbol]) for t in effect.terms})
    ranges = {
        "q": (-0.4, 1.1),
        "load": (-12.0, 30.0),
        "temp": (-9.0, 15.0),
        "stiff": (-5.0, 9.0),
        "inertia": (0.2, 2.0),
        "coriolis": (-3.0, 3.0),
    }
    sight = {"speed": 1.3, "past": 1.3, "gear": 30.0, "other": 0.8, "tilt": [(-4.0, 9.0), (-2.0, 3.0)], **ranges}
    law = acting_law(effect, f, 0, 1 if effect.scope == "pair" else -1, 1.3, warm=True)
    dry, viscous, push = acted(law, sight, [])
    least = np.inf
    for _ in range(400):
        corner = rng.random() < 0.5

        def draw(lo: float, hi: float, corner: bool = corner) -> float:
            return float(rng.choice([lo, hi])) if corner else float(rng.uniform(lo, hi))

        direction = float(rng.choice([-1.0, 1.0]))
        speed = draw(0.0, 1.3)
        s = Signals(
            **{k: draw(*r) for k, r in ranges.items()}, dq=direction * speed, given_direction=direction, warm=draw(0.0, 1.0),
            dq_other=draw(-0.8, 0.8), tilt=(draw(-4.0, 9.0), draw(-2.0, 3.0)),
            memory=tuple(draw(max(x.lo, -1.0), min(x.hi, 1.3)) for x in effect.states),
        )  # fmt: skip
        drawn = {k: v + SIGMAS * f.std.get(k, 0.0) * draw(-1.0, 1.0) for k, v in values.items()}
        for t in effect.terms:
            drawn[t.symbol] = float(np.clip(drawn[t.symbol], min(t.lo, values[t.symbol]), max(t.hi, values[t.symbol])))
        torque = float(effect.torque(s, drawn))
        size = [np.sort(direction * (dry + viscous * speed))[k] + push[k] for k in (0, 1)]
        assert size[0] - 1e-9 <= torque <= size[1] + 1e-9
        least = min(least, size[1] - torque, torque - size[0])
    if (
        effect.role != "arm or drive" and not effect.states and effect.name != "torque_ripple"
    ):  # its two waves never crest together
        assert least < 0.05 * (size[1] - size[0] + 1.0)  # and is no wider than it must be


@pytest.mark.parametrize(
    "effect",
    [*(e for e in catalogue().values() if e.role in ACTING and e.name not in REFUSED), *OTHERS[:2]],
    ids=lambda e: e.name,
)
def test_the_core_bounds_a_law_as_the_reference_in_numpy_does(effect: Effect) -> None:
    """Never wider, and what is narrower is a sum of constants that the reference takes for a slope; parameters with and without doubt."""
    rng = np.random.default_rng(2)
    alike = 0
    for trial in range(30):
        values = {p.symbol: float(rng.uniform(max(p.lo, -3.0), min(p.hi, 3.0))) for p in effect.terms}
        values |= {p.symbol: p.grid[len(p.grid) // 2] for p in effect.shapes}
        std = {k: 0.02 * abs(v) for k, v in values.items()} if trial % 2 else {}
        f, fast = Fitted(effect.name, "j", values, std), rng.uniform(0.1, 2.0)
        ranges = {k: np.sort(rng.uniform(-3.0, 3.0, 2)) for k in ("q", "load", "temp", "stiff", "coriolis")} | {
            "inertia": np.array([0.2, 2.0])
        }
        tilt, past, gear, other = np.sort(rng.uniform(-5.0, 5.0, (2, 2))), 1.3, rng.uniform(1.0, 40.0), rng.uniform(0.0, 2.0)
        law = acting_law(effect, f, 0, 1 if effect.scope == "pair" else -1, past, warm=True)
        sight = {
            "speed": fast,
            "past": past,
            "gear": gear,
            "other": other,
            "tilt": tilt.tolist(),
            **{k: v.tolist() for k, v in ranges.items()},
        }
        got, one = acted(law, sight, []), np.ones(1)
        ends = {k: Interval(v[:1], v[1:]) for k, v in ranges.items()}
        pair = (Interval(tilt[0, :1], tilt[0, 1:]), Interval(tilt[1, :1], tilt[1, 1:]))
        a = reference(effect, [f], Sight(fast * one, past * one, gear * one, other=other * one, tilt=pair, **ends))
        want = np.stack([a.dry[0], a.viscous[0], a.push[0]])
        size = 1e-9 * (1.0 + np.abs(want).max())
        assert np.all(got[:, 0] >= want[:, 0] - size) and np.all(got[:, 1] <= want[:, 1] + size), (trial, got, want)
        alike += bool(np.allclose(got, want, rtol=0.0, atol=size))
    assert alike >= 25


@pytest.mark.parametrize("name", REFUSED)
def test_an_effect_without_a_bound_is_a_refusal_with_its_label(name: str, others: None) -> None:
    effects, says = REFUSED[name]
    model = hiding(effects)
    with pytest.raises(NotCovered, match=says):
        StopBounds.of(model)
    assert re.search(says, stop_refusal(model))
    assert stop_refusal(hiding(())) == ""
    assert stop_figures(model, model) == {}


def test_the_refusal_reaches_who_runs_an_fmu_a_command_or_a_monitor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = hiding(CASES["elasticity"])
    text = sources(model, variables(model))[0]["model_data.c"]
    assert ".has_brakes = 0," in text and "no stop is bounded with elasticity:arm_2_joint" in text
    path = tmp_path / "m.model.json"
    save_model(model, path)
    assert main(["stops", str(path)]) == 2
    assert "no stop is bounded with elasticity:arm_2_joint" in capsys.readouterr().err
    desk = StopDesk(str(path), SEEN, Stops(("0",)), None, Quantum.none(6))
    try:
        until, numbers, fresh = time.monotonic() + 120.0, {}, False
        while not fresh and time.monotonic() < until:
            desk.offer(time.monotonic(), Q, 0.0 * DQ)
            numbers, fresh = desk.now(Q, 0.0 * DQ)
            time.sleep(0.01)
        assert fresh and not numbers["0"].provable.any() and np.all(np.isinf(numbers["0"].time))
        assert "no stop is bounded with elasticity:arm_2_joint" in numbers["0"].why
    finally:
        desk.close()


def test_an_fmu_counts_misread_positions_into_the_start() -> None:
    plain, misread = (stop_data(hiding(effects)) for effects in ((), CASES["encoder_offset"]))
    assert plain.refusal == misread.refusal == ""
    moved = np.abs(misread.numbers["stop_centre"] - plain.numbers["stop_centre"])
    wider = misread.numbers["stop_radius"] - plain.numbers["stop_radius"]
    assert moved[1] + wider[1] > 1e-3 and np.all(np.delete(moved + wider, [1, 7]) == 0.0)


def test_friction_must_be_silent_where_the_joint_stands() -> None:
    for effect in catalogue().values():
        check(effect, effect.name)
    with pytest.raises(EffectError, match="pulls at a joint that stands"):
        check(replace(get("spring"), role="friction"), "theirs")
    with pytest.raises(EffectError, match="does not say by how much"):
        check(replace(get("encoder_offset"), reading=None), "theirs")


def test_a_tube_lies_inside_the_region_its_effects_were_evaluated_for(monkeypatch: pytest.MonkeyPatch) -> None:
    s = StopBounds.of(hiding(CASES["spring"]), (0.0, 0.25)).setting
    assert s is not None
    asked: list[tuple[Box, np.ndarray]] = []
    over = type(s.torques).over
    monkeypatch.setattr(type(s.torques), "over", lambda self, q, v: asked.append((q, v)) or over(self, q, v))
    r = np.full(6, 1e-3)
    for dq in (DQ, 0.05 * DQ, 4.0 * DQ):
        tube = tube_of(s, Q, dq, r, r)
        q, v = asked[-1]
        assert np.all(Q - r + tube.d_lo.min(axis=0) > q.lo) and np.all(Q + r + tube.d_hi.max(axis=0) < q.hi)
        assert np.all(fastest(tube) < v)


def test_no_tube_is_made_twice_with_the_same_friction(monkeypatch: pytest.MonkeyPatch) -> None:
    """A joint without effects that leaves the region moves nothing that a law looks at: the tube is that of the larger region."""
    s = StopBounds.of(hiding(CASES["spring"]), (0.0, 0.25)).setting
    assert s is not None
    made: list[Tube] = []
    march = tubes.march
    monkeypatch.setattr(tubes, "march", lambda *args, **how: made.append(march(*args, **how)) or made[-1])
    start, r = Start(Q, 0.05 * DQ, np.full(6, 1e-3), np.full(6, 1e-3)), Region(np.full(6, 1e-9), np.full(6, 10.0))
    r.travel[[f.joint for f in s.torques.laws if f.roams]] = 0.3
    found = tubes.march_box(s, s.plant, start, energetic=False, region=r)
    assert len(made) == 1 and found.end == OK and r.known and np.all(r.travel > 1e-9)
    again = tubes.march_box(s, s.plant, start, energetic=False, region=Region(r.travel, r.speed, known=True))
    assert all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in zip(found[:-1], again[:-1], strict=True))


def test_an_added_payload_counts_once_for_everyone() -> None:
    """What an identified payload adds stands in the model's body, and nobody adds it again."""
    plain, payload = hiding(()), tuple(replace(f, std={}) for f in CASES["payload"])
    carried = np.array([payload[0].values[t.symbol] for t in get("payload").terms])
    aware = hiding(payload)
    once = plain.robot.pi[-1] + carried
    assert np.array_equal(aware.robot.pi[-1], once)
    assert np.array_equal(described(plain.robot, payload).pi[-1], once)  # what identification starts from
    same = replace(aware, effects=plain.effects)  # the same arm, described with what it carries
    for load in ((0.0, 0.0), (0.2, 1.0)):
        a, b = (StopBounds.of(m, load, payload_com=aware.robot.tip).setting for m in (aware, same))
        assert a is not None and b is not None
        for name in (f for f in a.plant._fields if f not in ("chain", "curvature")):
            assert np.array_equal(getattr(a.plant, name), getattr(b.plant, name)), name
        assert np.allclose(a.plant.pi[-1, 0], once[0] + 0.5 * sum(load)) and np.array_equal(a.torques.gear, b.torques.gear)
    rows = np.array([Q, -Q]), np.array([DQ, 0.0 * DQ]), np.array([3.0 * DQ, DQ])
    assert np.array_equal(aware.input(*rows), same.input(*rows))
    assert not np.allclose(aware.input(*rows), plain.input(*rows))
    doubtful = StopBounds.of(hiding(CASES["payload"]), (0.0, 0.0)).setting  # what it was weighed wrongly by, beside it
    assert doubtful is not None and np.isclose(doubtful.plant.pi_half[-1, 0], SIGMAS * 0.04)
    assert aware.domain.payload == plain.domain.payload
    texts = [sources(m, variables(m))[0]["model_data.c"] for m in (aware, same)]
    pi = [next(line for line in t.splitlines() if line.startswith("    .pi = ")) for t in texts]
    assert pi[0] == pi[1]
    numbers, others_numbers = stop_data(aware).numbers, stop_data(same).numbers
    # a further kilogram is taken to sit where what was weighed does; of an arm of which nothing was weighed, at the flange
    assert np.array_equal(numbers["stop_per_kg"][1:4], carried[1:4] / carried[0])
    assert np.array_equal(others_numbers["stop_per_kg"][1:4], same.robot.tip)
    for name in numbers.keys() - {"stop_per_kg"}:
        assert np.array_equal(numbers[name], others_numbers[name]), name


def test_what_was_weighed_wrongly_is_where_it_was_weighed_whatever_else_is_carried() -> None:
    """An identified tool of 2 +- 0.12 kg at 0.2 m, known payloads at the flange: gravity of every mass it may have is in the plant's range."""
    model, q = hiding(CASES["payload"]), np.array([0.1, 0.9, 0.6, 0.2, 1.2, 0.3])
    own = weighed(model, None)[1]
    for payload, com in (((0.0, 0.0), model.robot.tip - own), ((0.5, 0.5), np.array([0.0, 0.1, 0.3]))):
        plant = StopBounds.of(model, payload, com).setting.plant  # type: ignore[union-attr]
        edges = np.array([gravity_torque(plant.chain, plant.pi + s * plant.pi_half, q) for s in (-1.0, 1.0)])
        for off in (-3 * 0.04, 3 * 0.04):
            true = model.robot.pi.copy()
            true[-1] += payload[0] * per_kg(com) + off * per_kg(own)
            g = gravity_torque(plant.chain, true, q)
            assert np.all(g >= edges.min(axis=0) - 1e-9) and np.all(g <= edges.max(axis=0) + 1e-9)
    with pytest.raises(NotCovered, match="beside one weighed by its torque to"):
        StopBounds.of(model, (0.0, 0.5), np.array([0.0, 0.1, 0.3]))
    assert StopBounds.of(model, (0.0, 0.5)).setting is not None


def test_a_law_that_drives_the_faster_the_joint_goes_holds_for_the_speeds_it_was_asked_for(others: None) -> None:
    model = hiding((Fitted("driving", JOINTS[0], {"k0": -9.0}),))
    torques = torques_of(model)
    assert not torques.settled and torques.speed[0] == pytest.approx(1.26)
    q = Box.point(np.zeros(6))
    push = [torques.over(q, np.full(6, v)).push.hi[0] for v in (1.0, 2.0)]
    assert push[1] == pytest.approx(2.0 * push[0]) and push[0] >= 4.0


def test_a_stop_that_leaves_every_region_it_is_tried_in_is_not_provable(others: None) -> None:
    """Driven by its own speed a joint is faster than any region's largest: core and Python stop trying, and give no number."""
    q, dq, r = np.array([0.3, 0.4, -0.4]), np.full(3, 0.01), np.full(3, 1e-4)
    for drives, provable in ((50.0, True), (170.0, False)):
        bounds = bounds_of(braked(8.0, 3, effort="motor_torque", effects=[friction("driving", "axis_3", k0=-drives)]))
        tube = tubes_of(bounds.setting, Start(q, dq, r, r), 1, last_resort=False, fast=True)[-1]
        assert (tube.end == OK) == provable == (core_stop(bounds)(q, dq, "0", r, r) is not None)
        assert np.all(np.isfinite(tube.d_hi))  # the tube itself comes to an end, in too small a region


def test_what_the_abstraction_damps_by_is_friction_where_no_effect_says_better() -> None:
    model: Model = hiding(())
    bare = replace(model, effects=tuple(f for f in model.effects if f.effect != "viscous"))
    assert np.allclose(torques_of(bare).everywhere.viscous.centre, model.abstraction.viscous[:, 0])


@pytest.mark.parametrize("hide", ["base_tilt", "payload"])
def test_an_effect_hidden_in_the_simulated_arm_is_identified_and_its_stops_stay_inside(hide: str, tmp_path: Path) -> None:
    """The simulator's laws are not the catalogue's, and its stops share no code with the bounds."""
    (tmp_path / "three.urdf").write_text(ARM)
    model, scenario = identified((hide,), tmp_path / "three.urdf", tmp_path)
    assert any(f.effect == hide for f in model.effects)
    found = stopped(model, scenario, states=60, seed=2)
    assert found["certified"] >= 55 and found["escapes"] == 0, found
    if hide == "payload":  # in the model's body once: as heavy as the arm that was recorded, not heavier
        added = next(f.values["m"] for f in model.effects if f.effect == hide)
        truth = scenario.cell.truth.plant.pi
        assert added > 0.1 and np.allclose(model.robot.pi[:, 0], truth[:, 0], atol=0.3 * added)
