"""Certificates that are kept: found again by the states they hold for, and by no other."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import save_model
from stopset.monitor.certificates import Certificate, Numbers, Shelf
from stopset.monitor.config import Stops
from stopset.monitor.sample import Quantum
from stopset.monitor.stopdesk import LEFT, NARROW, WIDE, Heading, StopDesk
from stopset.sets import Box
from test_monitor_stops import prbt_like

SEEN = Box.symmetric(np.repeat([3.0, 2.0], 6))
N = 6
NONE = np.zeros(2 * N)


def answer(middle: float, radius: float, angle: float) -> Certificate:
    a, x = np.full(N, angle), np.full(2 * N, middle)
    return Certificate("0", x - radius, x + radius, Numbers(a, a, a, angle, np.full(N, True)), 0.01)


def test_the_tightest_of_those_that_hold_is_found_and_the_oldest_goes() -> None:
    shelf = Shelf(N, kept=3)
    at = np.full(2 * N, 0.5)
    assert shelf.best(at, NONE) is None
    for angle, radius in ((0.3, 1.0), (0.1, 1.0), (0.01, 0.2)):
        shelf.put(answer(0.0, radius, angle))
    best = shelf.best(at, NONE)
    assert best is not None and best.numbers.tcp == 0.1, "the tightest is too small a box for this state"
    assert shelf.best(at, np.full(2 * N, 0.6)) is None, "what bus rounding may hide must lie in the box too"
    one_off = at.copy()
    one_off[7] = 1.0000001
    assert shelf.best(one_off, NONE) is None
    one_off[7] = np.nan
    assert shelf.best(one_off, NONE) is None and not answer(0.0, 1.0, 0.1).covers(one_off, NONE)
    shelf.put(answer(5.0, 0.1, 0.2))
    shelf.put(answer(5.0, 0.1, 0.2))
    assert len(shelf.answers) == 3 and shelf.best(at, NONE) is None, "the two that held it were the oldest"


def test_the_box_ahead_holds_the_motion_it_was_made_for() -> None:
    motion, rng = Heading(SEEN), np.random.default_rng(3)
    q0, v0, a = rng.uniform(-1, 1, N), rng.uniform(-1, 1, N), rng.uniform(-4, 4, N)
    for k in range(20):
        t = 0.004 * k
        motion.see(t, q0 + v0 * t + 0.5 * a * t * t, v0 + a * t)
    motion.settle()
    for size in (NARROW, WIDE):
        lo, hi = motion.box(size.ahead, size)
        for s in np.linspace(0.0, size.ahead, 9):
            t = 0.076 + s
            x = np.concatenate([q0 + v0 * t + 0.5 * a * t * t, v0 + a * t])
            assert np.all(lo <= x) and np.all(x <= hi)
    narrow, wide = (np.subtract(*motion.box(s.ahead, s)[::-1]) for s in (NARROW, WIDE))
    assert np.all(narrow < wide)


class Hand:
    """A clock that is moved by hand, so that every state is looked at however fast this machine is."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        self.now += 0.02
        return self.now

    def time_ns(self) -> int:
        return round(self.now * 1e9)

    def sleep(self, seconds: float) -> None:
        """Nobody sleeps."""


@pytest.fixture
def desk(tmp_path: Path) -> StopDesk:
    save_model(prbt_like(), tmp_path / "m.model.json")
    return StopDesk(str(tmp_path / "m.model.json"), SEEN, Stops(("0",), rate_hz=1000.0), 0.0, Quantum.none(N), clock=Hand())


def passed(desk: StopDesk, period: float = 1.0) -> list[bool]:
    """Once round, with every answer waited for: what counts is what is kept, not how fast this machine is."""
    held = []
    for t in np.arange(0.0, period, 0.02):
        w = 2 * np.pi / period
        q, dq = 0.1 * np.sin(w * t + np.arange(N)), 0.1 * w * np.cos(w * t + np.arange(N))
        until = time.monotonic() + 30.0
        while time.monotonic() < until:
            desk.offer(t, q, dq)
            if desk._ready and all(c.waiting is None for c in desk.counters.values()):
                break
            time.sleep(0.001)
        held.append(desk.now(q, dq)[1])
    return held


def asked(desk: StopDesk) -> int:
    return len(desk.counters["0"].narrow.answers) + len(desk.counters["0"].wide.answers)


def test_an_arm_that_comes_by_again_asks_for_nothing_and_a_lost_process_takes_nothing_away(desk: StopDesk) -> None:
    try:
        kept, before = asked(desk), -1
        for _ in range(10):
            if kept == before:
                break
            passed(desk)
            before, kept = kept, asked(desk)
        assert 1 < kept == before, "it asked, and then no more"
        assert all(passed(desk)) and asked(desk) == kept, "every state was held, and nothing was asked for"
        os.kill(desk._process.pid, signal.SIGKILL)
        until = time.monotonic() + 30.0
        while desk.restarts == 0 and time.monotonic() < until:
            desk.offer(0.0, np.zeros(N), np.zeros(N))
            time.sleep(0.01)
        assert desk.restarts == 1 and all(passed(desk)), "the model is the same: so are its certificates"
        numbers, fresh = desk.now(np.full(N, 0.9), np.full(N, 1.9))
        assert not fresh and numbers["0"].why == LEFT and not numbers["0"].provable.any()
    finally:
        desk.close()
