"""The shortcuts of the diagnosis against plain sums."""

import numpy as np
import pytest

from stopset.offline.description import load_robot
from stopset.offline.diagnose.evidence.evidence import JointGram
from stopset.offline.diagnose.gravity import gravity_moments
from stopset.offline.diagnose.rows.noise import Whitening, autocovariance
from stopset.offline.diagnose.rows.prepare import Kernel
from stopset.offline.diagnose.search.ripple import _power, _products
from stopset.robot import rigid

RNG = np.random.default_rng(3)
ARM = load_robot("lwa4p")
Q, DQ, DDQ = RNG.normal(size=(3, 20, ARM.n))


@pytest.mark.parametrize("joint", [0, 2, 5])
def test_a_bent_joint_is_that_joint_elsewhere(joint: int) -> None:
    x, dx, ddx = RNG.normal(size=(3, 20))
    unit = np.eye(ARM.n)[joint]
    moved = [a + b[:, None] * unit for a, b in ((Q, x), (DQ, dx), (DDQ, ddx))]
    out = np.full_like(Q, 7.0)
    rigid.bent_torques(ARM.chain, ARM.pi, (Q, DQ, DDQ), rigid.Bend(joint, x, dx, ddx), joint, out)
    expected = rigid.torques(ARM.chain, ARM.pi, *moved)
    assert np.allclose(out[:, joint:], expected[:, joint:], atol=1e-10) and np.all(out[:, :joint] == 7.0)


def test_levers_give_gravity_its_tilt_and_its_stiffness() -> None:
    chain, found = ARM.chain, gravity_moments(ARM.chain, ARM.pi, Q)
    for g in (chain.gravity, np.array([3.0, -2.0, 5.0])):
        turned = chain._replace(gravity=g)
        assert np.allclose(found.torque(g), rigid.gravity_torques(turned, ARM.pi, Q), atol=1e-10)
        for joint in range(ARM.n):
            step = 1e-5 * np.eye(ARM.n)[joint]
            up, down = (rigid.gravity_torques(turned, ARM.pi, Q + s * step) for s in (1, -1))
            assert np.allclose(found.stiffness(g, joint), (up - down) / 2e-5, atol=1e-6)


def test_ripple_sums_are_those_of_whitened_waves() -> None:
    covariances = [autocovariance(Kernel.gaussian(0.004, 0.012), 5, tau, 0.01) for tau in (1.0, 2.0)]
    q, fade, r = RNG.normal(size=60), 1e-5 * RNG.random(60), RNG.normal(size=60)
    whiten = Whitening.of(np.arange(60) % 25 == 0, np.arange(60) // 25 % 2, covariances)
    n = np.arange(12.0, 161.0, 0.5)
    size = np.exp(-fade[:, None] * n**2)
    s, c = (whiten(size * wave(q[:, None] * n)) for wave in (np.sin, np.cos))
    for got, expected in zip(_power(q, fade, whiten, n, 0.5), ((s * s), (c * c), (s * c)), strict=True):
        assert np.allclose(got, expected.sum(axis=0), rtol=1e-8, atol=1e-8)
    for got, expected in zip(_products(q, fade, whiten.adjoint(r), n, 0.5), (r @ s, r @ c), strict=True):
        assert np.allclose(got, expected, rtol=1e-8, atol=1e-8)


def test_a_bordered_gram_is_the_gram_of_all_columns() -> None:
    X, f, trial = RNG.normal(size=(40, 5)), RNG.normal(size=(40, 2)), np.repeat([0, 1, 2, -1], [12, 10, 13, 5])
    folds, index = np.array([0, 1, 0]), np.arange(5)
    whole = JointGram.of(X, f, trial, folds, 2, index)
    grown = JointGram.of(X[:, :2], f, trial, folds, 2, index[:2]).bordered(X[:, 2:], index[2:])
    assert np.allclose(whole.G, grown.G) and np.allclose(whole.g, grown.g)
    theta = RNG.normal(size=5)
    assert np.allclose(whole.residual(theta, 0.3, 1.2), grown.residual(theta, 0.3, 1.2))
    sums = JointGram.of(X[:, :2], f, trial, folds, 2, index[:2]).bordered(X[:, 2:], index[2:], rows=False)
    assert np.allclose(whole.G, sums.G) and np.allclose(whole.at(0.3, 1.2)[0], sums.at(0.3, 1.2)[0])
    few = grown.keep(np.array([1, 4]), rows=False)
    assert np.allclose(few.at(0.3, 1.2)[0], whole.at(0.3, 1.2)[0][np.ix_([1, 4], [1, 4])])
