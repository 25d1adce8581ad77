"""Cutting what is known of brakes: the parts still hold every arm, and a hopeless case costs few tubes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from stopset.reach.stops import StopBounds
from stopset.reach.stops.split import FIELDS, REWARD, TRIALS, certify, harm_of
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Plant, Tube
from stopset.reach.stops.tubes import Knots, march_box

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import shipped

PIECES, LASTS = 64, 0.3


class Counted:
    """Tubes of one state, counted; one comes to rest where the interval that harms most does at most ``widest`` of what it does uncut."""

    def __init__(self, widest: float) -> None:
        setting = StopBounds.of(shipped(), (2.75, 3.0)).setting
        assert setting is not None
        self.setting, self.widest = setting, widest
        self.start = Start(np.zeros(6), np.full(6, 0.3), np.zeros(6), np.zeros(6))
        self.tried: list[Plant] = []
        self.closed: list[Plant] = []
        self.energetic = 0

    def harm(self, plant: Plant) -> float:
        return float(harm_of(plant, self.start.q, LASTS).max())

    def __call__(self, plant: Plant, /, *, energetic: bool) -> Tube:
        tube = march_box(self.setting, plant, self.start, energetic=energetic, knots=Knots(20, 1))
        if energetic:
            self.energetic += 1
            return tube
        self.tried.append(plant)
        if self.harm(plant) > self.widest * self.harm(self.setting.plant):
            return tube._replace(end=OK + 1)
        self.closed.append(plant)
        return tube._replace(end=OK)


def cut(march: Counted) -> list[Tube]:
    plant = march.setting.plant
    return certify(march, plant, march.start.q, LASTS, PIECES, last_resort=True)


def test_where_no_part_comes_to_rest_few_tubes_are_tried() -> None:
    march = Counted(widest=-1.0)
    assert len(cut(march)) == 1 and march.energetic == 1
    assert len(march.tried) <= TRIALS


def test_a_budget_that_successes_extend_is_kept() -> None:
    for widest in (0.8, 0.6, 0.4):
        march = Counted(widest)
        tubes = cut(march)
        assert len(tubes) <= PIECES
        assert len(march.tried) <= TRIALS + REWARD * len(march.closed)


def test_the_parts_hold_every_arm_of_the_whole() -> None:
    march = Counted(widest=0.8)
    assert len(cut(march)) == len(march.closed) > 1
    plant, rng = march.setting.plant, np.random.default_rng(3)
    for _ in range(300):
        x = {f: rng.uniform(getattr(plant, f"{f}_lo"), getattr(plant, f"{f}_hi")) for f in FIELDS}
        assert any(
            all(np.all(x[f] >= getattr(p, f"{f}_lo")) and np.all(x[f] <= getattr(p, f"{f}_hi")) for f in FIELDS)
            for p in march.closed
        )
