"""Abstractions 1 to 3: their Taylor coefficients against closed forms and against the exact dynamics in the complex plane."""

from __future__ import annotations

import importlib.util
import json
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from articulated import forward_dynamics
from stopset.artifact import Abstraction
from stopset.artifact.polynomial import Polynomial, collected, compiled, evaluate
from stopset.errors import StopsetError
from stopset.offline.abstraction import ORDERS, build, identified, predicted_bytes
from stopset.offline.abstraction.forms import dynamics, inverse
from stopset.offline.description import load_robot, robot_from_text
from stopset.robot import Robot
from stopset.robot.arm import standard_parameters
from stopset.robot.rigid import mass_matrix, torque
from test_taylor import CIRCLE, RADIUS

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from table1 import degrees

ROTOR, VISCOUS = np.array([0.7, 0.4]), np.array([[3.0, 0.2, -0.3], [2.0, -0.1, -0.2]])


def two_link() -> Robot:
    """A planar arm, joint axes parallel: links of 0.5 m with a point mass of 3 and 2 kg at their ends."""
    link = '<link name="{0}"/><joint name="j{1}" type="revolute"><parent link="{0}"/><child link="{2}"/>'
    link += '<origin xyz="{3} 0 0"/><axis xyz="0 0 1"/></joint>'
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
    text = '<robot name="planar">' + link.format("base", 1, "a", 0)
    text += f'<link name="a">{body}</link>' + link.format("a", 2, "b", 0.5).replace('<link name="a"/>', "")
    robot = robot_from_text(text + f'<link name="b">{body}</link></robot>')
    tip = np.array([0.5, 0.0, 0.0])
    return robot.with_parameters(np.array([standard_parameters(m, tip, np.zeros((3, 3))) for m in (3.0, 2.0)]))


def closed_form(dq, s2, c2, u):
    """Accelerations of `two_link`, textbook formula, for any numbers; gravity is inside u."""
    l2 = 0.25
    a, b, d = 3 * l2 + 2 * 2 * l2 + ROTOR[0], 2 * l2, 2 * l2 + ROTOR[1]
    m11, m12 = a + 2 * b * c2, 2 * l2 + b * c2
    coriolis_torque = (-b * s2 * (2 * dq[0] * dq[1] + dq[1] ** 2), b * s2 * dq[0] ** 2)
    r = [u[i] - coriolis_torque[i] - sum(VISCOUS[i, k] * dq[i] ** (k + 1) for k in range(3)) for i in range(2)]
    det = m11 * d - m12 * m12
    return np.array([(d * r[0] - m12 * r[1]) / det, (m11 * r[1] - m12 * r[0]) / det])


def by_degree(p: Polynomial, centre: np.ndarray, direction: np.ndarray, degree: int) -> np.ndarray:
    """Coefficients of ``lambda -> p(centre + lambda direction)`` up to ``degree``."""
    local = p.recentred(centre)
    terms = local.coefficient * np.prod(direction**local.exponent, axis=1)
    return np.bincount(local.exponent.sum(axis=1), weights=terms, minlength=degree + 1)[: degree + 1]


@pytest.mark.parametrize("cut", [0, 1, 2, 3])
def test_a_polynomial_cut_as_it_is_recentred_is_the_whole_one_cut_afterwards(cut: int) -> None:
    """To the bit, though most of its monomials are never made; one variable stays where it is."""
    rng = np.random.default_rng(cut)
    p = Polynomial(rng.integers(0, 3, (60, 5)), rng.normal(size=60))
    centre = np.array([0.3, -1.2, 0.0, 0.7, 2.0])
    whole, short = p.recentred(centre), p.recentred(centre, cut)
    low = whole.exponent.sum(axis=1) <= cut
    assert 0 < low.sum() < len(low)
    assert np.array_equal(short.exponent, whole.exponent[low])
    assert np.array_equal(short.coefficient, whole.coefficient[low])


@pytest.mark.parametrize("order", ORDERS)
def test_model_3_has_the_taylor_coefficients_of_the_closed_form(order: int) -> None:
    model = build(3, order, two_link(), ROTOR, VISCOUS)
    centre = np.array([0, 0, 0, 0, 1, 1, 0, 0.0])
    rng = np.random.default_rng(order)
    for _ in range(8):
        direction = rng.uniform(-1, 1, 8)

        def along(x: complex, d: np.ndarray = direction) -> np.ndarray:
            z = centre + x * d
            return closed_form(z[:2], z[3], z[5], z[6:])

        want = _line(along, order)
        for i, p in enumerate(model.acceleration):
            assert p.exponent.sum(axis=1).max(initial=0) <= order
            got = by_degree(p, centre, direction, order)
            # values of order 10 with rounding 1e-16 over RADIUS^order, some hundred operations
            assert np.abs(got - want[:, i]).max() < 1e-13 / RADIUS**order


def _line(f, degree: int) -> np.ndarray:
    z = RADIUS * np.exp(2j * np.pi * np.arange(CIRCLE) / CIRCLE)
    values = np.array([f(x) for x in z])
    return (np.fft.fft(values, axis=0) / CIRCLE)[: degree + 1].real / RADIUS ** np.arange(degree + 1)[:, None]


def arm(name: str) -> tuple[Robot, np.ndarray, np.ndarray]:
    robot = load_robot(name)
    v1 = np.linspace(20.0, 4.0, robot.n)
    return robot, robot.rotor, np.column_stack([v1, 0.05 * v1, -0.1 * v1])


def exact(robot: Robot, rotor: np.ndarray, viscous: np.ndarray, q, dq, u) -> np.ndarray:
    """Accelerations at one point by the compiled dynamics (held to pinocchio by the tests there); gravity inside u."""
    chain = robot.chain._replace(gravity=np.zeros(3))
    friction = sum(viscous[:, k] * dq ** (k + 1) for k in range(3))
    rest = u - torque(chain, robot.pi, q, dq, np.zeros(robot.n)) - friction
    return np.linalg.solve(mass_matrix(chain, robot.pi, q) + np.diag(rotor), rest)


@pytest.mark.parametrize("order", [1, 3, 5])
def test_along_a_motion_model_3_agrees_with_the_arm_to_its_order(order: int) -> None:
    """Series of the six-joint arm's acceleration along ``q, dq, u = lambda * (..)``, exact side from complex arithmetic."""
    robot, rotor, viscous = arm("lwa4p")
    n = robot.n
    model = build(3, order, robot, rotor, viscous)
    rng = np.random.default_rng(3)
    dir_q, dir_dq = rng.uniform(-0.5, 0.5, (2, n))
    dir_u = rng.uniform(-10, 10, n)

    def truth(x: complex) -> np.ndarray:
        s, c = np.sin(x * dir_q), np.cos(x * dir_q)
        dq = x * dir_dq
        u = x * dir_u - sum(viscous[:, k] * dq ** (k + 1) for k in range(3))
        return np.array(forward_dynamics(robot.chain, robot.pi, rotor, list(s), list(c), list(dq), list(u)))

    def abstract(x: complex) -> np.ndarray:
        z = np.concatenate([x * dir_dq, np.sin(x * dir_q), np.cos(x * dir_q), x * dir_u])
        return np.array([np.prod(z**p.exponent, axis=1) @ p.coefficient for p in model.acceleration])

    want, got = _line(truth, order + 1), _line(abstract, order + 1)
    scale = np.abs(want).max()
    assert np.abs(got - want)[: order + 1].max() < 1e-11 * scale / RADIUS**order
    assert np.abs(got - want)[order + 1].max() > 1e-6 * scale  # and no further: the order is what it says


def test_overloaded_articulated_bodies_give_the_same_polynomial_behind_u() -> None:
    """All 4n variables through Featherstone's algorithm, without any of the structure `build` uses."""
    robot, rotor, _ = arm("lwa4p")
    robot = replace(
        robot, joints=robot.joints[:3], pi=robot.pi[:3], drives=robot.drives[:3],
        chain=robot.chain._replace(R=robot.chain.R[:3], p=robot.chain.p[:3], axis=robot.chain.axis[:3]),
    )  # fmt: skip
    rotor, n, order = rotor[:3], 3, 3
    model = build(3, order, robot, rotor, np.zeros((3, 1)))
    from stopset.ring.taylor import Algebra

    algebra = Algebra(4 * n, order)
    centre = np.repeat([0.0, 0.0, 1.0, 0.0], n)
    z = [algebra.variable(i, centre[i]) for i in range(4 * n)]
    forms = forward_dynamics(robot.chain, robot.pi, rotor, z[n : 2 * n], z[2 * n : 3 * n], [0.0] * n, z[3 * n :])
    # sine and cosine as free variables allow many polynomials for one function; along a motion they all agree to the
    # order
    rng = np.random.default_rng(0)
    dir_q, dir_u = rng.uniform(-1, 1, (2, n))

    def at(x: complex) -> np.ndarray:
        return np.concatenate([0 * dir_q, np.sin(x * dir_q), np.cos(x * dir_q), x * dir_u])

    for form, p in zip(forms, model.acceleration, strict=True):
        a = _line(lambda x, f=form: np.array([np.prod((at(x) - centre) ** f.exponents, axis=1) @ f.value]), order)
        b = _line(lambda x, f=p: np.array([np.prod(at(x) ** f.exponent, axis=1) @ f.coefficient]), order)
        assert np.abs(a - b).max() < 1e-12


def test_model_2_is_exact_from_its_maximal_degree_on() -> None:
    robot, rotor, viscous = arm("lwa4p")
    assert degrees(robot, viscous) == (3, 12, 10)  # the last body is round: sin^2 + cos^2 takes two degrees away
    assert degrees(two_link(), VISCOUS)[::2] == (3, 3)  # sin(q2) dq1 dq2
    n, rng = robot.n, np.random.default_rng(5)
    chain = robot.chain._replace(gravity=np.zeros(3))
    M_a = mass_matrix(chain, robot.pi, np.zeros(n)) + np.diag(rotor)
    far = []
    for order in (3, 7, 11, 12, 14):
        model = build(2, order, robot, rotor, viscous)
        error = 0.0
        for _ in range(5):
            q, dq, u = rng.uniform(-3, 3, (3, n))
            c = torque(chain, robot.pi, q, dq, np.zeros(n))
            want = np.linalg.solve(M_a, u - c - sum(viscous[:, k] * dq ** (k + 1) for k in range(3)))
            error = max(error, float(np.abs(model.ddq(q[None], dq[None], u[None])[0] - want).max()))
        far.append(error)
    assert far[0] > 1e-2 and far[1] > 1e-4  # p = 3 and 7 are approximations out there
    assert max(far[3:]) < 1e-11


def test_coriolis_matrices_do_no_work_beyond_the_inertia() -> None:
    """``dq' c = 1/2 dq' (dM/dt) dq``: the energy test of the Coriolis polynomials, independent of how they were made."""
    robot, rotor, _ = arm("lwa4p")
    model = build(2, 12, robot, rotor, np.zeros((6, 1)))
    rng = np.random.default_rng(1)
    for _ in range(5):
        q, dq = rng.uniform(-3, 3, (2, 6))
        c = np.array([p(np.concatenate([dq, np.sin(q), np.cos(q)])[None])[0] for p in model.coriolis])
        h = 1e-4
        a, b = (mass_matrix(robot.chain, robot.pi, q + k * h * dq) for k in (1, -1))
        # central difference, used as a check only: its own error is h^2 times a third derivative of order 10
        assert abs(dq @ c - 0.5 * dq @ ((a - b) / (2 * h)) @ dq) < 1e-5


def test_order_one_is_one_linear_model() -> None:
    robot, rotor, viscous = arm("lwa4p")
    rng = np.random.default_rng(2)
    q, dq, u = rng.normal(size=(3, 7, robot.n))
    answers = [build(kind, 1, robot, rotor, viscous).ddq(q, dq, u) for kind in (1, 2, 3)]
    assert build(1, 1, robot, rotor, viscous).linear
    assert np.abs(answers[0] - answers[1]).max() == 0.0
    assert np.abs(answers[0] - answers[2]).max() < 1e-11


def test_another_expansion_point_is_exact_there() -> None:
    robot, rotor, viscous = arm("lwa4p")
    q_a = np.array([0.3, -0.8, 1.1, 0.5, -1.4, 0.2])
    u = np.arange(6.0)
    for kind in (1, 2, 3):
        model = build(kind, 3, robot, rotor, viscous, q_a=q_a)
        want = exact(robot, rotor, viscous, q_a, np.zeros(6), u)
        assert np.abs(model.ddq(q_a[None], np.zeros((1, 6)), u[None])[0] - want).max() < 1e-11


def test_construction_and_evaluation_stay_within_time_and_memory() -> None:
    """Model 3, p = 5, six joints: construction below 30 s and 2 GiB, a second of robot time evaluated in well under 10 s."""
    robot, rotor, viscous = arm("lwa4p")
    build(3, 3, robot, rotor, viscous).ddq(*np.zeros((3, 1, 6)))  # compile first
    began = time.process_time()
    model = build(3, 5, robot, rotor, viscous)
    model.ddq(*np.zeros((3, 1, 6)))
    assert time.process_time() - began < 30.0
    began = time.process_time()
    model.ddq(*np.random.default_rng(0).uniform(-1, 1, (3, 1000, 6)))
    assert time.process_time() - began < 2.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2 << 20  # [KiB]
    rows = sum(p.exponent.size * 16 for p in model.acceleration)
    assert rows <= predicted_bytes(3, 5, 6)


def test_what_would_not_fit_is_refused_before_the_work() -> None:
    robot, rotor, viscous = arm("lwa4p")
    began = time.process_time()
    with pytest.raises(StopsetError, match=r"GiB.*lower the order"):
        build(3, 11, robot, rotor, viscous)
    assert time.process_time() - began < 5.0
    with pytest.raises(StopsetError, match="model 1, 2 or 3"):
        build(4, 1, robot, rotor, viscous)


def test_polynomial_evaluation_and_jacobian() -> None:
    rng = np.random.default_rng(0)
    e, c = rng.integers(0, 4, (60, 5)), rng.normal(size=60)
    p = Polynomial(*collected(e, c))
    z = rng.uniform(-1, 1, (9, 5))
    want = np.prod(z[:, None, :] ** e, axis=2) @ c
    assert np.abs(p(z) - want).max() < 1e-13
    program = compiled((p,))
    assert np.abs(evaluate(program, z)[:, 0] - want).max() < 1e-13
    zero = Polynomial(np.zeros((1, 5), np.int64), np.zeros(1))
    assert np.all(zero(z) == 0.0)


def test_sine_and_cosine_do_not_forget_each_other() -> None:
    """Trap P20: as free variables they lose sin^2 + cos^2 = 1; the cut of the plain composition then bends a constant."""
    robot, rotor, _ = arm("lwa4p")
    q = np.random.default_rng(7).uniform(-2.5, 2.5, (50, 6))
    points = np.hstack([np.sin(q[:, 1:]), np.cos(q[:, 1:])])
    plain, ours = (dynamics(robot, rotor, as_composed=flag) for flag in (True, False))
    want = np.array([mass_matrix(robot.chain, robot.pi, x) + np.diag(rotor) for x in q])
    for forms in (plain, ours):  # uncut both are the same function
        got = np.array([[forms.M[i][j](points) for j in range(6)] for i in range(6)])
        assert np.abs(np.moveaxis(got, 2, 0) - want).max() < 1e-13
    cut = {}
    for name, forms in (("plain", plain), ("ours", ours)):
        e = forms.expanded(np.zeros(6), 1, inverse=False)
        got = np.array([e.M[4][4](points - e.centre), e.M[5][5](points - e.centre)])
        cut[name] = np.abs(got - want[:, (4, 5), (4, 5)].T).max()
    assert cut["ours"] < 0.2 * cut["plain"]


def test_inverse_of_a_matrix_of_forms() -> None:
    robot, rotor, _ = arm("lwa4p")
    M = dynamics(robot, rotor).expanded(np.zeros(6), 4, inverse=True).M
    W = inverse(M)
    for i in range(6):
        for j in range(6):
            total = M[0][0] * 0.0
            for k in range(6):
                total = total + M[i][k] * W[k][j]
            assert np.abs((total - float(i == j)).value).max(initial=0.0) < 1e-14


def test_the_polynomials_survive_the_model_file() -> None:
    """Written and read back by the model file's own functions, a polynomial is the same to the bit, an empty one included."""
    from stopset.artifact.store import _build, _plain

    robot, rotor, viscous = arm("lwa4p")
    model = build(2, 3, robot, rotor, viscous)
    again = _build(Abstraction, json.loads(json.dumps(_plain(model))), "model")
    x = np.random.default_rng(0).uniform(-1, 1, (3, 4, 6))
    assert np.array_equal(again.ddq(*x), model.ddq(*x))


def test_abstraction_is_immutable_and_compiles_once() -> None:
    robot, rotor, viscous = arm("lwa4p")
    model = build(2, 3, robot, rotor, viscous)
    assert isinstance(model, Abstraction) and model.program is model.program
    with pytest.raises(AttributeError):
        model.kind = 3  # type: ignore[misc]


def test_table_one_is_in_the_papers_order_of_magnitude() -> None:
    """The linear model 1 within a factor of three of the paper's 0.0040 and 0.0408 rad/s; the exact model as the yardstick."""
    path = Path(__file__).resolve().parents[1] / "benchmarks" / "table1.py"
    spec = importlib.util.spec_from_file_location("table1", path)
    assert spec is not None and spec.loader is not None
    table1 = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(table1)
    answer = table1.table(load_robot("lwa4p"), 2, "near", orders=(1, 3))
    cell = {(c["speed"], c["model"], c["order"]): c["error"] for c in answer["cells"]}
    for speed, paper in (("slow", 0.0040), ("fast", 0.0408)):
        assert cell[speed, "exact", None] < 1e-6
        assert paper / 3 < cell[speed, "model 1", 1] < 3 * paper
        assert cell[speed, "model 1", 1] == cell[speed, "model 2", 1]
        assert cell[speed, "model 1", 3] < 0.7 * cell[speed, "model 1", 1]
        assert cell[speed, "model 2", 12] <= cell[speed, "model 1", 3]
    assert answer["maximal_degrees"] == {"model_1": 3, "model_2": 12, "model_2_reduced": 10}
    assert "∞" in table1.text({**answer, "cells": [{**c, "diverged": 1} for c in answer["cells"]]})


def test_a_prediction_that_runs_away_is_told_without_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """An order was chosen by 2.4e19 mrad against infinitely many."""
    errors = iter([0.0334, 2.4e16, np.inf])
    monkeypatch.setattr(identified, "abstract", lambda arm, kind, p: SimpleNamespace(kind=kind, order=p))
    monkeypatch.setattr(identified, "prediction_error", lambda *args: next(errors))
    note = identified.best_order(None, 1, (1, 2, 3), lambda model: [], 0.01).note  # type: ignore[arg-type]
    assert "order 1: 33.40 mrad" in note and "order 2: runs away" in note and "order 3: runs away" in note
