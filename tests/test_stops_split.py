"""Cutting what is known of brakes: the parts still hold every arm, and a hopeless case costs few tubes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from stop_sampling import sample_stops, tightness
from stopset.reach.stops import StopBounds
from stopset.reach.stops.split import FIELDS, REWARD, TRIALS, certify, harm_of, nearer
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Plant, Tube
from stopset.reach.stops.tubes import Knots, march_box, tubes_of

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import shipped
from stop_arms_wide import random_arm

PIECES, LASTS = 64, 0.3


class Counted:
    """Tubes of one state, counted; one comes to rest where the interval that harms most does at most ``widest`` of what it does uncut.

    ``falls``: the kinetic energy shows no end.
    """

    def __init__(self, widest: float, *, falls: bool = True) -> None:
        setting = StopBounds.of(shipped(), (2.75, 3.0)).setting
        assert setting is not None
        self.setting, self.widest, self.falls = setting, widest, falls
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
            return tube._replace(end=OK + 1) if self.falls else tube
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
    assert [t.end for t in cut(march)] != [OK] and march.energetic == 1
    assert 1 < len(march.tried) <= TRIALS


def test_nothing_is_cut_where_the_energy_knows_an_end() -> None:
    march = Counted(widest=-1.0, falls=False)
    assert [(t.end, t.energetic) for t in cut(march)] == [(OK, True)]
    assert len(march.tried) == march.energetic == 1


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


def test_where_bands_feed_on_each_other_the_nearer_proof_counts() -> None:
    """A light arm of seven joints: one tube closes, its bands of speeds wider than any joint was fast, and goes up to four times as far as the
    energy lets it."""
    model = random_arm(7, 1)
    s, rng = StopBounds.of(model, (0.0, 0.0)).setting, np.random.default_rng(1)
    assert s is not None
    r, v, ratios = s.noise.radius[:7], s.noise.radius[7:], []
    for k in range(3):
        start = Start(rng.uniform(-np.pi, np.pi, 7), rng.uniform(-1.0, 1.0, 7) * model.domain.dq.hi, r, v)
        plain = march_box(s, s.plant, start, energetic=False)
        (tube,) = tubes_of(s, start, 1)
        assert plain.end == OK and tube.energetic
        x = sample_stops(s.plant, start.q, start.dq, r, v, s.payload_com, tube, 40, k)
        assert x.escaped == 0
        ratios.append(tightness(tube, np.inf, x, start.dq, model.domain.dq.hi).angle)
    assert np.median(np.concatenate(ratios)) < 1.4  # the tubes of joint speeds alone: 2


def test_a_tube_of_joint_speeds_stays_where_the_energy_lets_the_arm_go_farther() -> None:
    class Farther(Counted):
        def __call__(self, plant: Plant, /, *, energetic: bool) -> Tube:
            tube = super().__call__(plant, energetic=energetic)
            wide = tube.v_hi.copy()
            wide[1] = tube.v_lo[1] + 9.0  # as when bands feed on each other
            return tube._replace(v_hi=wide, d_hi=tube.d_hi + (1.0 if energetic else 0.0))

    march = Farther(widest=1.0, falls=False)
    (tube,) = cut(march)
    assert not nearer(march, march.setting.plant, tube).energetic and march.energetic == 1
