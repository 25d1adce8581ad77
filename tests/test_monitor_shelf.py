"""Certificates that are kept: found again by the states they hold for, and by no other."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import save_model
from stopset.monitor.ahead import LONG, NARROW, WIDE, Heading
from stopset.monitor.asking import FULL, Budget, Counter
from stopset.monitor.certificates import Certificate, CommonBox, Numbers, Shelf
from stopset.monitor.config import Stops
from stopset.monitor.sample import Quantum
from stopset.monitor.stopdesk import LEFT, SPENT, StopDesk, seen_by
from stopset.reach.stops import StopBounds
from stopset.sets import Box
from stopset.types import Array
from test_monitor_stops import prbt_like

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from monitor_bounds import Alone, Standing, never_twice

CYCLE = 0.004  # [s]
SEEN = Box.symmetric(np.repeat([3.0, 2.0], 6))
N = 6
NONE = np.zeros(2 * N)


def answer(middle: float, radius: float, angle: float) -> Certificate:
    a, x = np.full(N, angle), np.full(2 * N, middle)
    return Certificate("0", x - radius, x + radius, Numbers(a, a, a, angle, np.full(N, True)), 0.01, 0.01)


def test_the_tightest_of_those_that_hold_is_found_and_the_oldest_goes() -> None:
    shelf = Shelf(N, capacity=3)
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


def test_the_common_box_is_where_all_answers_in_use_hold_as_long_as_that_is_known() -> None:
    box, q, dq = CommonBox(np.full(2 * N, 0.01)), np.full(N, 0.5), np.full(N, -0.5)
    assert not box.holds(q, dq), "nothing is in use yet"
    box.of([answer(0.0, 1.0, 0.1), answer(0.2, 1.0, 0.1)])
    assert box.holds(q, dq) and box.x.tolist() == [0.5] * N + [-0.5] * N
    assert box.holds(q + 0.489, dq) and not box.holds(q + 0.491, dq), "what bus rounding may hide must lie in it too"
    assert box.holds(q, dq - 0.289) and not box.holds(q, dq - 0.291), "the second one ends there"
    assert not box.holds(np.where(np.arange(N) == 3, np.nan, q), dq)
    box.forget()
    assert not box.holds(q, dq)
    box.of([answer(5.0, 0.1, 0.1)])
    assert not box.holds(q, dq) and box.holds(q + 4.5, dq + 5.5)


def test_the_box_ahead_holds_the_motion_it_was_made_for() -> None:
    motion, rng = Heading(SEEN), np.random.default_rng(3)
    q0, v0, a = rng.uniform(-1, 1, N), rng.uniform(-1, 1, N), rng.uniform(-4, 4, N)
    for k in range(20):
        t = 0.004 * k
        motion.see(t, q0 + v0 * t + 0.5 * a * t * t, v0 + a * t)
    motion.settle()
    for size in (NARROW, LONG, WIDE):
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


class Beside(Alone):
    """With a stated time that a proof takes, so that nothing hangs on this machine's."""

    prepared = StopBounds.of(prbt_like((0.0, 0.25)), fast=True)
    cost = 0.0  # [s]

    def price(self, answer: Certificate) -> float:
        """The same for every answer."""
        return self.cost

    def see(self, q: Array, dq: Array) -> bool:
        """A cycle later the arm is here; whether its stop is bounded."""
        self.clock.now += CYCLE
        self.arrive()
        self.offer(self.clock.now, q, dq)
        numbers, fresh = self.now(q, dq)
        return fresh and all(x.proven for x in numbers.values())


def beside(cost: float) -> Beside:
    desk = Beside("", seen_by(prbt_like()), Stops(("0",)), None, Quantum.none(N), clock=Standing())
    desk.cost = cost
    return desk


@pytest.mark.parametrize("cost", [0.005, 0.02])
def test_new_motion_costs_its_share_of_a_core_and_no_more(cost: float) -> None:
    """The arm comes by no state twice; boxes reach as far as can be paid for, and still hold it."""
    desk, (q, dq) = beside(cost), never_twice(prbt_like(), 20.0, 3)
    held = [desk.see(x, v) for x, v in zip(q, dq, strict=True)]
    spent = desk.spending["cpu_s"]
    assert 0.5 < spent <= 0.1 * len(q) * CYCLE + FULL + cost, f"{spent / (len(q) * CYCLE):.3f} of a core"
    assert np.mean(held[250:]) > 0.98, "and the arm is in a box nearly all the time"


def test_what_was_saved_makes_the_bounds_of_motion_that_comes_again_tight() -> None:
    desk, (q, dq) = beside(0.02), never_twice(prbt_like(), 4.0, 3)
    angles, retained = [], []
    for _ in range(8):
        angles_now = []
        for x, v in zip(q, dq, strict=True):
            desk.see(x, v)
            angles_now.append(desk.now(x, v)[0]["0"].forward.sum())
        angles.append(np.median(angles_now))
        retained.append(desk.spending["kept"]["0"])
    assert angles[-1] < 0.95 * angles[0]
    assert retained[0] < retained[2] < retained[-2] == retained[-1], "it asked for tighter ones, and then no more"


def test_on_a_machine_that_becomes_busy_bounds_become_wider_and_health_says_so() -> None:
    """What a proof takes is what a share of a core buys; bounds of new motion are then of boxes that reach farther."""
    found = []
    for later in (0.004, 0.04):
        desk, angles = beside(0.004), []
        for seed, cost in ((3, 0.004), (5, later)):
            desk.cost = cost
            for x, v in zip(*never_twice(prbt_like(), 8.0, seed), strict=True):
                bounded = desk.see(x, v)
                if seed == 5:
                    angles.append(desk.now(x, v)[0]["0"].forward.sum() if bounded else np.inf)
        found.append((np.median(angles), desk.spending["dearer"]["0"], desk.spending["box_ms"]["0"]))
    assert found[0][1] < 1.01 and abs(found[0][2] - 4.0) < 0.01
    assert found[1][1] > 5.0 and found[1][2] > 20.0 and found[1][0] > 1.1 * found[0][0]


def test_a_share_that_is_used_up_is_no_bound_and_is_said() -> None:
    desk = beside(FULL + 0.5)  # what no machine takes: the first answer uses up all that is saved and more
    for _ in range(1000):
        assert not desk.see(np.zeros(N), np.zeros(N)) or desk.budget.spent
    moved = np.full(N, 1.0)
    assert not desk.see(moved, 0.5 * moved)
    numbers, fresh = desk.now(moved, 0.5 * moved)
    assert not fresh and numbers["0"].why == SPENT and not numbers["0"].provable.any() and desk.spending["share_used_up"]
    asked = desk.spending["cpu_s"]
    for _ in range(20_000):  # 80 s
        desk.see(moved, 0.0 * moved)
    assert desk.see(moved, 0.0 * moved) and desk.spending["cpu_s"] > asked, "what is earned is spent again"


def test_what_a_wide_box_takes_says_nothing_of_near_ones() -> None:
    """Proofs that fail take a hundred times as long; near boxes asked for as far ahead as that were as wide, and failed too."""
    box, good = np.ones(2 * N), Numbers(np.ones(N), np.ones(N), np.ones(N), 0.1, np.ones(N, bool))
    c, motion = Counter.of(N, Budget(0.1, saved=10 * FULL), 3), Heading(SEEN)
    motion.see(0.0, np.zeros(N), np.zeros(N))
    for size, numbers, took in ((NARROW, good, 0.002), (WIDE, Numbers.none(N, "not proved"), 0.2), (NARROW, good, 0.002)):
        c.waiting = size
        c.take(Certificate("0", box, 2 * box, numbers, took, took))
    wanted = c.lacks(motion, np.zeros(2 * N), 0.01)
    assert wanted is not None and wanted[1] is NARROW and wanted[0] < 0.1, wanted
    c.budget.saved = 0.3  # dear by now: longer ones, and shorter again where one could not be proved
    c.cost = 0.05
    ahead = []
    for proven in (True, False, False, True):
        c.waiting = LONG
        c.take(Certificate("0", box, 2 * box, good if proven else Numbers.none(N, "not proved"), 0.002, 0.0))
        c.cost, c.only_narrow = 0.05, 1
        (reaches, size) = c.lacks(motion, np.zeros(2 * N), 0.01) or (0.0, None)
        ahead.append(reaches)
        assert size is LONG
    assert ahead[0] > ahead[1] > ahead[2] < ahead[3], ahead


@pytest.fixture
def desk(tmp_path: Path) -> StopDesk:
    save_model(prbt_like(), tmp_path / "m.model.json")
    return StopDesk(str(tmp_path / "m.model.json"), SEEN, Stops(("0",), rate_hz=1000.0), None, Quantum.none(N), clock=Hand())


def passed(desk: StopDesk, turn: int) -> list[bool]:
    """Once round in a second, for the ``turn``-th time and to the last bit as before, with every answer waited for: what counts is what is
    kept, not how fast this machine is."""
    held = []
    for t in np.arange(64) / 64:
        w = 2 * np.pi
        q, dq = 0.1 * np.sin(w * t + np.arange(N)), 0.1 * w * np.cos(w * t + np.arange(N))
        until = time.monotonic() + 30.0
        while time.monotonic() < until:
            desk.offer(turn + t, q, dq)
            if desk._ready and all(c.waiting is None for c in desk.counters.values()):
                break
            time.sleep(0.001)
        held.append(desk.now(q, dq)[1])
    return held


def asked(desk: StopDesk) -> int:
    return desk.counters["0"].certificates


def test_an_arm_that_comes_by_again_asks_for_nothing_and_a_lost_process_takes_nothing_away(desk: StopDesk) -> None:
    try:
        # on a busy machine each proof takes longer: fewer are asked for in a turn, none where little is saved, and some have no bound, which
        # leaves no certificate but another size to ask for; and how an arm accelerates is told from the end of the turn before
        turn, quiet = 0, 0
        while quiet < 3 and turn < 90:
            spent, full = desk.budget.total, desk.budget.saved == FULL
            passed(desk, turn)
            turn, quiet = turn + 1, quiet + 1 if full and desk.budget.total == spent else 0
        assert quiet == 3 and asked(desk) > 1, "it asked, and then no more"
        spent = desk.budget.total
        assert all(passed(desk, turn)) and desk.budget.total == spent, "every state was held, and nothing was asked for"
        os.kill(desk._process.pid, signal.SIGKILL)
        until = time.monotonic() + 30.0
        while desk.restarts == 0 and time.monotonic() < until:
            desk.offer(0.0, np.zeros(N), np.zeros(N))
            time.sleep(0.01)
        assert desk.restarts == 1 and all(passed(desk, turn + 1)), "the model is the same: so are its certificates"
        # no box reaches there, however far ahead a slow machine has to ask
        numbers, fresh = desk.now(SEEN.hi[:N] + 0.5, SEEN.hi[N:])
        assert not fresh and numbers["0"].why == LEFT and not numbers["0"].provable.any()
    finally:
        desk.close()
