"""Under-determined data: fitted, said, and the sets widened by what the numbers leave open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nominal_cases import F_C, F_V, JOINTS, Truth, arm, moving
from stopset.artifact import TorqueZonotope, UncertaintySets, load_model, save_model
from stopset.offline.abstraction.metrics import STOP_TIME
from stopset.offline.identify.pipeline import Settings, identify
from stopset.offline.nominal import identify_nominal
from stopset.offline.nominal.parameter_uncertainty import STATES, of_regression, recombined, widened
from stopset.recording import Meta, Recording, write_recordings
from stopset.robot.rigid import regressors
from stopset.sets import Box


def recorded(path: Path, motions: int, seed: int = 3) -> list[Recording]:
    """Motions of an arm whose friction differs by 2 % between them."""
    rng = np.random.default_rng(seed)
    trials = []
    for k in range(motions):
        c, v = F_C * (1 + 0.02 * rng.normal(size=3)), F_V * (1 + 0.02 * rng.normal(size=3))
        law = lambda dq, load, c=c, v=v: c * np.sign(dq) + v * dq  # noqa: E731
        trials.append(moving(Truth(arm(), friction=law), k, 4.0, (1.2, 0.8)[k % 2], seed))
    write_recordings(path, Meta(JOINTS, rate_hz=250.0), trials)
    return trials


def test_one_motion_gives_no_narrower_sets_than_it_can_know(tmp_path: Path) -> None:
    """A single motion is explained by its own numbers: what it deviates by then says nothing, and one said so with U alone."""
    cad = arm(mass=1.04, shift=0.004)
    recorded(tmp_path / "one.parquet", 1)
    one = identify(cad, [tmp_path / "one.parquet"]).model
    widened_joints = [x for x in one.notes if "U was widened" in x]
    assert widened_joints, one.notes
    recorded(tmp_path / "many.parquet", 14)
    many = identify(cad, [tmp_path / "many.parquet"]).model
    assert not [x for x in many.notes if "U was widened" in x]
    saved = save_model(one, tmp_path / "m")
    assert np.array_equal(load_model(tmp_path / "m").powered.U.width, saved.powered.U.width)


@pytest.mark.parametrize("motions", [1, 3])
def test_the_doubt_covers_the_torque_error_elsewhere(motions: int, tmp_path: Path) -> None:
    """The error of the regressed rigid torque at recombined states is inside twice its standard error as often as it should."""
    true = arm()
    inside = []
    for seed in range(6):
        trials = recorded(tmp_path / "r.parquet", motions, seed)
        cad = arm(mass=1.03, shift=0.003)
        nominal = identify_nominal(cad, trials)
        uncertainty = of_regression(cad, nominal, trials)
        q, dq, ddq = recombined(trials)
        assert q.shape == (STATES, 3)
        Y = regressors(true.chain, q, dq, ddq)
        rigid = Y @ (nominal.pi - true.pi).ravel() + ddq * (nominal.rotor - true.rotor)
        F = np.array([[nominal.value(e, j)[k] for j in JOINTS] for e, k in (("coulomb", "F_c"), ("viscous", "F_v"))])
        error = rigid + (F[0] - F_C) * np.sign(dq) + (F[1] - F_V) * dq
        inside.append(np.mean(np.abs(error) <= uncertainty))
    assert np.mean(inside) > 0.8, inside


def test_widening_is_outward_and_only_where_it_lacks() -> None:
    U, none = Box.of([-1.0, 0.0, 2.0], [1.0, 0.2, 6.0]), Box.symmetric(np.zeros(6))
    sets = UncertaintySets(none, U, none, 0.004, STOP_TIME)
    out = widened(sets, np.array([0.5, 0.5, 2.0]))
    np.testing.assert_allclose(out.U.lo, [-1.0, -0.4, 2.0])
    np.testing.assert_allclose(out.U.hi, [1.0, 0.6, 6.0])
    assert widened(sets, np.zeros(3)) is sets
    z = TorqueZonotope(U.centre, np.diag(U.radius) @ np.array([[1.0, 0, 0], [0, 0.5, 0.5], [0, 0, 1.0]]), np.eye(3))
    tilted = UncertaintySets(none, z.set.box, none, 0.004, STOP_TIME, zonotope=z)
    out = widened(tilted, np.array([0.5, 0.5, 2.0]))
    assert out.zonotope is not None
    np.testing.assert_allclose(out.U.radius, [1.0, 0.5, 2.0])
    np.testing.assert_array_equal(out.U.lo, out.zonotope.set.box.lo)


def test_a_chosen_margin_does_not_undo_the_widening(tmp_path: Path) -> None:
    recorded(tmp_path / "one.parquet", 1)
    cad = arm(mass=1.04, shift=0.004)
    narrow, wide = (identify(cad, [tmp_path / "one.parquet"], Settings(margin=m)).model.powered.U for m in (1.0, 1.01))
    np.testing.assert_allclose(narrow.width.max(), wide.width.max(), rtol=0.02)
