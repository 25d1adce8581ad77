"""How trials are handed on: the same at every call, remembered where they are few, read again where they are many."""

from __future__ import annotations

import pickle
from collections.abc import Iterator

import numpy as np
import pytest

from stopset.offline.campaign import trials as handing
from stopset.offline.campaign.trials import ReadOnce, size
from stopset.recording import Recording

READS: list[int] = []


def trials() -> Iterator[Recording]:
    for k in range(3):
        READS.append(k)
        x = np.full((100, 2), float(k))
        yield Recording("open_loop", k, 0, k, np.arange(100) * 0.01, x, x, x)


def test_few_trials_are_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    READS.clear()
    source = ReadOnce(trials)
    next(iter(source()))
    assert READS == [0], "a pass that breaks off is none"
    first = tuple(source())
    assert tuple(source()) == first and READS == [0, 0, 1, 2]
    READS.clear()
    monkeypatch.setattr(handing, "MOST", 2 * size(first[0]))
    many = ReadOnce(trials)
    assert [r.suite for _ in range(2) for r in many()] == [0, 1, 2, 0, 1, 2] and len(READS) == 6
    READS.clear()
    elsewhere = pickle.loads(pickle.dumps(source))
    assert len(list(elsewhere())) == 3 and len(READS) == 3, "another process reads for itself"


def test_the_input_of_a_model_is_made_once() -> None:
    """Its laws are put on tape for it: once per model, not once per recording."""
    from monitor_arm import known_model

    model = known_model()
    assert model.input is model.input
