"""The running envelope's kernels, to the last bit: maxima through whole numbers, and one simulation for many envelopes."""

from __future__ import annotations

import numpy as np
import pytest

from stopset.artifact import Abstraction
from stopset.core.library import ffi, given, lib, view
from stopset.errors import RecordingError
from stopset.offline.conform.envelope import Deviations, Envelope
from stopset.recording import Recording

DT = 0.01


def extremes(x: np.ndarray) -> tuple[float, float]:
    top, bottom = ffi.new("double *"), ffi.new("double *")
    lib.stopset_extremes(len(x), view(given(x)), top, bottom)
    return top[0], bottom[0]


def test_extremes_are_those_of_the_floats_to_the_last_bit() -> None:
    rng = np.random.default_rng(3)
    tiny = np.finfo(float).smallest_subnormal
    for size in (1, 2, 7, 64, 1001):
        for _ in range(20):
            x = rng.normal(size=size) * 10.0 ** rng.integers(-320, 300, size)
            some = rng.random(size) < 0.2
            x[some] = rng.choice([0.0, -0.0, tiny, -tiny, np.inf, -np.inf], some.sum())
            assert extremes(x) == (x.max(), x.min())
    # the largest and the smallest of zeros is zero, whatever their signs: the file's bits do not depend on the order of trials
    for zeros in ([-0.0], [0.0, -0.0], [-0.0, 0.0], [-1.0, -0.0], [-0.0, 1.0]):
        assert not any(v == 0.0 and np.signbit(v) for v in extremes(np.array(zeros)))


def trial(k: int, samples: int) -> tuple[Recording, np.ndarray]:
    rng = np.random.default_rng(k)
    q, dq, u = (rng.normal(size=(samples, 2)) for _ in range(3))
    if k % 2:
        q[:, 1] = dq[:, 1] = u[:, 1] = 0.0  # ties at zero everywhere: a joint that stands still
    return Recording("open_loop", k, k, k, DT * np.arange(samples), q, dq, u), u


@pytest.mark.parametrize("coupled", [False, True])
def test_envelopes_widened_together_are_those_widened_one_by_one(coupled: bool) -> None:
    inertia = np.array([[2.0, 0.3 if coupled else 0.0], [0.3 if coupled else 0.0, 1.0]])
    d = Deviations(Abstraction(1, 1, np.linalg.inv(inertia), np.array([[3.0], [2.0]])), DT, 60)
    together, alone = [d.empty() for _ in range(3)], [d.empty() for _ in range(3)]
    for k, samples in enumerate((61, 40, 80, 61, 61, 25)):
        r, u = trial(k, samples)
        wide = [j for j in range(3) if k % (j + 1) == 0]  # another choice of envelopes for every trial
        d.add_to([together[j] for j in wide], r, u)
        for j in wide:
            d.add(alone[j], r, u)
    for a, b in zip(together, alone, strict=True):
        same(a, b)
        assert (a.hi_at[1:, :, 0] > 0).any() and (a.hi_at[1:] >= 0).all()


def test_what_is_not_a_number_is_refused_not_passed_over() -> None:
    d = Deviations(Abstraction(1, 1, np.eye(2), np.ones((2, 1))), DT, 60)
    r, u = trial(0, 30)
    u[7, 1] = np.nan
    with pytest.raises(RecordingError, match=r"suite 0 trial 0: .* at 0\.070 s is not finite"):
        d.of(r, u)


def same(a: Envelope, b: Envelope) -> None:
    for name in ("hi", "lo", "hi_at", "lo_at", "count"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    assert a.labels == b.labels
