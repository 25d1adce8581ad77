"""What is said of a load: numbers that a body can have, whatever a free fit asks for, and an order of claims that shows what is the cause."""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.effects import get
from stopset.offline.description import robot_from_text
from stopset.offline.diagnose.answer import Parameter
from stopset.offline.diagnose.evidence.candidate import Candidate, Scored
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hypothesis
from stopset.offline.diagnose.evidence.uncertainty import deviations, drives_scale
from stopset.offline.diagnose.load import joints_disagree, nearest_body, of_a_body, says
from stopset.offline.diagnose.search.held_out import HeldOut
from stopset.offline.diagnose.search.predicts import judged
from stopset.offline.diagnose.search.search import Claim, _foremost_first
from stopset.offline.nominal.parameter_uncertainty import along, own_columns
from stopset.offline.nominal.physical import pseudo_inertia
from stopset.offline.nominal.prior import Tolerance
from stopset.recording import Recordings
from stopset.robot.arm import standard_parameters
from stopset.robot.rigid import regressors, torques
from stopset.simulation import prepare
from stopset.simulation.hidden import Hidden
from stopset.types import Array
from test_diagnose import ARM

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
import payloads_poor

# what a real UR10e's rows asked for with 2.805 kg mounted
FREE = np.array([2.932, 0.08125, 0.4397, -0.4646, -0.001272, 0.0112, 0.04207, -0.001568, 0.06988, -0.1108])


def test_an_inertia_that_no_body_has_becomes_that_of_the_nearest() -> None:
    assert np.linalg.eigvalsh(pseudo_inertia(FREE))[0] < -0.1
    body = nearest_body(FREE)
    assert np.linalg.eigvalsh(pseudo_inertia(body))[0] > 0.0
    assert np.array_equal(body[:4], FREE[:4])  # gravity told these
    point = standard_parameters(FREE[0], FREE[1:4] / FREE[0], np.zeros((3, 3)))
    assert np.abs(body - point)[4:].max() < 0.05 * FREE[0] * 0.22**2 + 0.01  # hardly more than all of it in one place


@pytest.mark.parametrize("seed", range(20))
def test_no_body_of_the_same_mass_and_centre_is_nearer(seed: int) -> None:
    """But for the centimetre that the least body measures: among random bodies near it none lies nearer to what was asked for."""
    rng = np.random.default_rng(seed)
    free = FREE + np.concatenate([np.zeros(4), rng.normal(0, 0.1, 6)])
    m, c = free[0], free[1:4] / free[0]

    def second(x: np.ndarray) -> np.ndarray:
        return pseudo_inertia(x)[:3, :3] - m * np.outer(c, c)

    body = nearest_body(free)
    least = np.linalg.norm(second(body) - second(free))
    root = np.linalg.cholesky(second(body) + 1e-12 * np.eye(3))
    for _ in range(200):
        other = root + rng.normal(0, 0.02, (3, 3))
        assert np.linalg.norm(other @ other.T - second(free)) > least - 3 * m * 0.01**2


def test_what_a_body_can_have_stays_as_it_is() -> None:
    body = standard_parameters(1.2, np.array([0.02, -0.03, 0.1]), np.diag([0.002, 0.003, 0.0025]))
    assert nearest_body(body) is body


def test_a_load_taken_off_is_a_body_taken_off() -> None:
    """The mirror image: a tool that is missing has a negative mass, and minus the numbers of the body that would hang there."""
    assert np.array_equal(nearest_body(-FREE), -nearest_body(FREE))


def test_how_far_an_inertia_was_moved_counts_to_its_error() -> None:
    payload = get("payload")
    fitted = {t.symbol: Parameter(v, t.unit, 0.02) for t, v in zip(payload.terms, FREE.tolist(), strict=True)}
    stated = of_a_body(payload, fitted)
    assert stated["m"] == fitted["m"] and stated["mz"] == fitted["mz"]
    moved = stated["Izz"].value - fitted["Izz"].value
    assert moved > 0.15 and stated["Izz"].std == pytest.approx(np.hypot(0.02, moved))
    words = says(payload, fitted, stated, described=False, lowered=0.5)
    assert "2.93 kg (95 %: 2.89 to 2.97 kg)" in words and "is no body's" in words and "description alone" not in words
    assert "is no body's" not in says(payload, stated, stated, described=False, lowered=0.5)
    alone = says(
        payload, stated, stated, described=True, lowered=0.007
    )  # a user asked what a load is that takes nothing off the error
    assert "masses, fitted again, carry it as well" in alone and "description alone" in alone
    assert "carry it" not in says(payload, stated, stated, described=True, lowered=0.5)
    for sign, told in (
        (1.0, "2.93 kg (95 %: 0.00 to 6.85 kg)"),
        (-1.0, "-2.93 kg (95 %: -6.85 to 0.00 kg)"),
    ):  # no load weighs less than none
        vague = {k: Parameter(sign * p.value, p.unit, 2.0) for k, p in fitted.items()}
        assert told in says(payload, vague, vague, described=True, lowered=0.5)
    spring = get("spring")
    one = {"k": Parameter(3.0, "N m/rad", 0.1)}
    assert of_a_body(spring, one) is one and says(spring, one, one, described=False, lowered=0.5) == spring.says


def test_which_of_two_effects_that_masses_imitate_is_the_cause_does_not_hang_on_which_was_found_first() -> None:
    """A load is hidden; a tilt that was claimed before it is asked beside it, not the other way round."""
    scenario = prepare(robot_from_text(ARM), ["payload"], 41, "compact", "easy", "exact")
    engine = Engine.build(
        scenario.robot, Recordings(dataclasses.replace(scenario.meta, sources=()), tuple(scenario.recordings()))
    )
    tilt, load, rub = engine.add_all([(get("base_tilt"), (), {}), (get("payload"), (), {}), (get("cubic_viscous"), (1,), {})])
    now = Hypothesis(engine, (tilt, rub, load))
    hyper, _ = now.fit()
    nothing = np.zeros(10)
    claims = [Claim(Scored(c, 0.0, nothing, np.eye(10)), 0.0, (), (), ()) for c in (tilt, rub, load)]
    for given in (claims, claims[::-1]):
        assert [k.scored.candidate for k in _foremost_first(now, given, hyper)] == [load, rub, tilt]
    before = np.array([0.3, 0.1])

    def claimed(c: Candidate, share: float, earlier: Candidate, left: float) -> bool:
        after = before * (1.0 - share)
        return not judged(now, c, HeldOut(before, before), HeldOut(after, after), hyper, [earlier], (left, left)).why

    # where a joint keeps more than its noise the second one must stand out: both may be one error of the description
    assert not claimed(tilt, 0.026, load, 20.0) and not claimed(load, 0.026, tilt, 20.0) and claimed(tilt, 0.15, load, 20.0)
    assert claimed(tilt, 0.0, load, 1.0) and claimed(tilt, 0.0, rub, 20.0)


@pytest.mark.parametrize("seed", [41, 42])
@pytest.mark.parametrize("share", [-2.0, -1.0, 1.0, 2.0])
def test_a_load_weighed_against_a_description_is_known_no_better_than_its_masses(seed: int, share: float) -> None:
    """All its masses are off alike by some tolerances: links agree with each other then, next to nothing is left, and the load was told to a
    twentieth of a kilogram, 0.24 kg off."""
    scenario = prepare(robot_from_text(ARM), ["payload"], seed, "compact", "easy", "exact")
    true = float(scenario.truth["effects"][0]["params"]["mass_kg"])
    recordings = Recordings(dataclasses.replace(scenario.meta, sources=()), tuple(scenario.recordings()))
    robot = scenario.robot.with_parameters((1.0 + share * Tolerance().mass) * scenario.robot.pi)
    engine = Engine.build(robot, recordings)
    (load,) = engine.add_all([(get("payload"), (), {})])
    now = Hypothesis(engine, (load,))
    hyper, p = now.fit()
    std = deviations(now, hyper, p.theta, [load])[0]["m"]
    mass = float(p.theta[now.nuisance.tolist().index(int(load.cols[0]))]) / drives_scale(now, p.theta)
    assert max(now.excesses(p.theta, hyper)) < 1.2
    assert abs(mass - true) < 1.96 * std
    surer = replace(hyper, scale=min(engine.scales))  # what a fit that leaves less would say of its links
    assert deviations(now, surer, p.theta, [load])[0]["m"] > 0.9 * std


@pytest.mark.parametrize("seed", [5, 7])
def test_joints_whose_drives_are_off_one_by_one_do_not_make_a_mass_too_sure(seed: int) -> None:
    """What a load weighs if every joint is taken to weigh it right is sure, and wrong; all joints together, each of which may be off, hold it."""
    w = payloads_poor.weighed(*payloads_poor.pair(seed, good=False))
    assert w.said is not None and w.plain is not None
    assert payloads_poor.inside(w.mass, w.said)
    assert not payloads_poor.inside(w.mass, w.plain)  # as it was said before


def test_joints_that_agree_on_a_load_leave_its_interval_as_it_was() -> None:
    w = payloads_poor.weighed(*payloads_poor.pair(3, good=True))
    assert w.said is not None and w.plain is not None and payloads_poor.inside(w.mass, w.said)
    assert w.said[1] < 1.1 * w.plain[1]


def test_what_a_load_s_own_misfit_explains_is_no_finding_beside_it() -> None:
    """A drive that tells too much weighs the load too heavy: that its scale changed when the load came is no other cause, and was named as one."""
    w = payloads_poor.weighed(*payloads_poor.pair(29, good=False))
    assert w.said is not None and payloads_poor.inside(w.mass, w.said) and w.beside == ()


def test_what_stands_out_of_a_load_s_misfit_is_named_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    inject = payloads_poor.inject
    monkeypatch.setattr(payloads_poor, "inject", lambda cell, hidden: inject(cell, [*hidden, Hidden("spring", 0, 4.0)]))
    w = payloads_poor.weighed(*payloads_poor.pair(60, good=True))
    assert w.said is not None and payloads_poor.inside(w.mass, w.said) and w.beside == ("spring:j0",)


def test_joints_that_do_not_agree_on_a_load_are_told() -> None:
    assert joints_disagree({}) == ""
    words = joints_disagree({"lift": 0.25, "bend": -0.1})
    assert "lift 1.25, bend 0.90" in words and "torque constants" in words


@pytest.mark.parametrize("joint", range(2))
def test_what_a_model_left_open_is_one_torque_in_newton_metres_and_in_whitened_rows(joint: int) -> None:
    """`along` is what the rigid body's, the rotors' and the friction's numbers make together when they change along its directions."""
    robot, rng = robot_from_text(ARM), np.random.default_rng(joint)
    n, k = robot.n, 2
    F = rng.normal(size=(13 * n, k))
    q, dq, ddq = rng.normal(size=(3, 5, n))

    def torque(pi: Array, rotor: Array, dry: Array, wet: Array) -> Array:
        return torques(robot.chain, pi, q, dq, ddq) + rotor * ddq + dry * np.sign(dq) + wet * dq

    body = regressors(robot.chain, q, dq, ddq)[:, joint]
    own = own_columns(dq[:, joint], ddq[:, joint])
    for c in range(k):
        pi, rotor, dry, wet = np.split(F[:, c], [10 * n, 11 * n, 12 * n])
        expected = torque(pi.reshape(n, 10), rotor, dry, wet)[:, joint]
        assert np.allclose(along(F, joint, body, own)[:, c], expected, atol=1e-9)
        assert np.allclose(along(F, joint, body / 0.3, own / 0.3)[:, c], expected / 0.3, atol=1e-9)
