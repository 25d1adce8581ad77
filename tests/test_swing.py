"""The swing of a link behind its gear, stepped by the core for many trials at a time, and what threads share of a search."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from stopset.core.library import ffi, flags, lib, view
from stopset.offline.diagnose.side_by_side import Recent, side_by_side
from stopset.types import Array

PARTS = 8


def newmark(M: Array, g: Array, first: Array, link: Array, x0: Array, dx0: Array, K: float, D: float, dt: float) -> Array:
    """(3, N) position, speed and acceleration, one trial after the other."""
    h, x, dx, out = dt / PARTS, 0.0, 0.0, np.empty((3, len(M)))
    for k in range(len(M)):
        stiff = K + g[k]
        if first[k]:
            x, dx = x0[k], dx0[k]
        elif k > 0:
            for i in range(PARTS):
                w = (i + 0.5) / PARTS
                m, force = M[k - 1] + w * (M[k] - M[k - 1]), -(link[k - 1] + w * (link[k] - link[k - 1]))
                ddx = (force - D * dx - stiff * (x + 0.5 * h * dx)) / (m + 0.5 * h * D + 0.25 * h * h * stiff)
                x, dx = x + h * dx + 0.5 * h * h * ddx, dx + h * ddx
        out[:, k] = x, dx, (-link[k] - D * dx - stiff * x) / M[k]
    return out


@pytest.mark.parametrize("lengths", [(1,), (7,), (3, 9, 1, 5), (4, 1, 1, 30, 2, 8, 8, 1, 17), (2,) * 12])
@pytest.mark.parametrize("before", [0, 3])
def test_trials_swing_each_by_itself_however_many_there_are(lengths: tuple[int, ...], before: int) -> None:
    """R-1550: to the last bit, of trials of any length, and of rows ``before`` the first one, which begin at rest."""
    rng = np.random.default_rng(sum(lengths) + before)
    starts = before + np.cumsum([0, *lengths[:-1]])
    N = before + sum(lengths)
    first = np.isin(np.arange(N), starts)
    M, g, link, x0, dx0 = rng.uniform(0.1, 3.0, N), *(rng.normal(0.0, s, N) for s in (30.0, 20.0, 0.1, 1.0))
    K, D, dt, out = 800.0, 3.0, 0.02, np.empty((3, N))
    swing = ffi.new("StopsetSwing *", (view(M), view(g), flags(first), K, D, dt, PARTS))
    lib.stopset_swung(swing, N, view(link), view(x0), view(dx0), view(out))
    assert np.array_equal(out, newmark(M, g, first, link, x0, dx0, K, D, dt))


def test_what_threads_make_is_in_its_place_and_the_last_of_it_is_kept() -> None:
    made, kept = list[int](), Recent[int](2)

    def asked(k: int) -> int:
        return kept.of(k, lambda: made.append(k) or k * k)  # type: ignore[func-returns-value]

    assert side_by_side(asked, range(20)) == [k * k for k in range(20)] and sorted(made) == list(range(20))
    made.clear()
    assert [asked(k) for k in (1, 2, 3, 3, 2, 1)] == [1, 4, 9, 9, 4, 1]
    assert made == [1, 2, 3, 1], "two are kept, and what is kept is not made again"
    kept.clear()
    assert asked(1) == 1 and made[-1] == 1 and len(made) == 5


def test_two_threads_that_ask_for_the_same_at_once_both_get_it() -> None:
    both, kept, got = threading.Barrier(2, timeout=10.0), Recent[int](1), list[int]()

    def slow() -> int:
        both.wait()  # neither waits for the other's
        return 7

    threads = [threading.Thread(target=lambda: got.append(kept.of("same", slow))) for _ in range(2)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert got == [7, 7] and kept.of("same", lambda: -1) == 7


def test_an_error_in_a_thread_is_the_callers() -> None:
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda k: 1 // k, (1, 0, 2))
