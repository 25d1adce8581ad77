"""The monitor's stop bounds hold for every state of the box they are given for, also those that brake worst."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from stopset.monitor.stopdesk import answer_for
from stopset.offline.stops.sampling import sample_stops
from stopset.reach.stops import Ramp, StopBounds
from stopset.reach.stops.tubes import tube_of

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like

Q = np.array([0.1, 0.5, 0.3, -0.4, 0.2, 0.1])
DQ = np.array([1.0, 0.8, -0.7, 0.3, 0.5, -1.0])
BOX = np.full(6, 0.02), np.full(6, 0.08)


@pytest.fixture(scope="module")
def prepared() -> StopBounds:
    return StopBounds.of(prbt_like(), (0.0, 0.25), ramp=Ramp.stated(6, time=0.3, off_after=0.1))


def test_an_answer_holds_for_every_state_of_its_box(prepared: StopBounds) -> None:
    s = prepared.setting
    assert s is not None
    told = answer_for(prepared, ("0", "1", "1 guaranteed", "2"), Q, DQ, *BOX).numbers
    assert all(x.provable.all() for x in told.values())
    narrow = prepared.bound(Q, DQ, "0")
    assert narrow.forward is not None and narrow.time is not None
    longer = 0
    rng = np.random.default_rng(5)
    for k in range(12):
        q, dq = Q + BOX[0] * rng.choice([-1.0, 1.0], 6), DQ + BOX[1] * (np.sign(DQ) if k % 2 else rng.uniform(-1, 1, 6))
        r, v = s.noise.radius[:6], s.noise.radius[6:]
        x = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube_of(s, q, dq, r, v), 60, k)
        assert np.all(x.forward <= told["0"].forward + 2e-6) and np.all(x.back <= told["0"].back + 2e-6)
        assert np.all(x.time <= told["0"].time + 5e-4) and x.tcp <= told["0"].tcp
        longer += bool(np.any(x.forward > narrow.forward + 1e-3))
        for category in ("1", "1 guaranteed", "2"):
            # bounds of a state of the box lie in those of the box, to within the steps of time they are made with
            alone = prepared.bound(q, dq, category)
            assert alone.forward is not None and alone.back is not None
            assert np.all(alone.forward <= told[category].forward + 2e-3) and np.all(alone.back <= told[category].back + 2e-3)
    assert longer > 0, "the box asks for more than its middle: a bound of the middle alone would have been exceeded"
