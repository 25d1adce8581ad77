"""Whether drives have the torque for a ramp is asked of every state, payload, rotor, delay and pace: sampled ramps ask no more."""

from __future__ import annotations

import itertools
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from stopset.artifact import Model
from stopset.effects.base import Fitted
from stopset.reach.stops import Ramp, StopBounds
from stopset.reach.stops.compiled import CompiledStops, ramp_torque
from stopset.reach.stops.ramp import ramp_tube
from stopset.reach.stops.start import Start
from stopset.robot.rigid import torques
from stopset.sets import Box
from stopset.types import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms_wide import arms

ARMS = {name: arm for name, (arm, _) in arms().items()}
NAMES = (
    "PRBT-like",
    "UR10e-like",
    "cobot of seven joints",
    "random arm of 2 joints, 0",
    "random arm of 5 joints, 0",
    "random arm of 7 joints, 1",
)


@dataclass(frozen=True)
class Ramps:
    """Ramps of an arm with rotors known to 20 % and any payload up to the rated one."""

    bounds: StopBounds
    ramp: Ramp

    @classmethod
    def of(cls, model: Model, kind: str, pace: float = 0.5) -> Ramps:
        n = model.n
        value = (0.2, 0.3) if kind == "time" else (4.0, 6.0)
        stated = Ramp.stated(n, time=0.3, control=0.03)
        ramp = replace(
            stated, kind=kind, value=Box.of(*np.tile(value, (n, 1)).T), control=Box.of(np.full(n, 0.01), np.full(n, 0.03))
        )
        ramp = replace(ramp, pace=(-pace, pace))
        bounds = StopBounds.of(replace(model, inertia_std=model.rotor / 15.0), None, ramp=ramp, fast=True)
        return cls(bounds, ramp)

    def asked(self, start: Start, have: float = 0.0) -> Array:
        setting = self.bounds.setting
        assert setting is not None
        tube = ramp_tube(self.ramp, start.speeds.lo, start.speeds.hi)
        return ramp_torque(setting, setting.plant, self.ramp, start, tube, np.full(self.bounds.model.n, have))

    def sampled(self, start: Start, count: int, rng: np.random.Generator, instants: int = 12) -> Array:
        """(n,) [N m] the largest that ramps ask of links and rotors; each of one state, arm, delay and value per joint, and pace."""
        setting, ramp, n = self.bounds.setting, self.ramp, self.bounds.model.n
        assert setting is not None
        p, worst = setting.plant, np.zeros(n)
        shape = (count, n)

        def pick(lo: Array, hi: Array) -> Array:
            return np.where(rng.random(shape) < 0.2, rng.uniform(lo, hi, shape), np.where(rng.random(shape) < 0.5, lo, hi))

        q0, v0 = (pick(b.lo, b.hi) for b in (start.angles, start.speeds))
        begin, value = pick(ramp.control.lo, ramp.control.hi), pick(ramp.value.lo, ramp.value.hi)
        lasts = value if ramp.kind == "time" else np.maximum(np.abs(v0), 1e-9) / value
        rotor, pace = pick(p.rotor - p.rotor_half, p.rotor + p.rotor_half), rng.choice([*ramp.pace, 0.0], (count, 1))
        for t in np.r_[0.0, np.sort(rng.uniform(0.0, float((begin + lasts).max()), instants))]:
            s = np.clip((t - begin) / lasts, 0.0, 1.0)
            run = np.minimum(t, begin) + lasts * (s - 0.5 * s * s)
            slowing = (t >= begin) & (t <= begin + lasts)
            a = v0 * (pace * (1.0 - s) ** 2 - np.where(slowing, (1.0 + pace * run) / lasts, 0.0)) * (t <= begin + lasts)
            q, v = q0 + v0 * (run + 0.5 * pace * run * run), v0 * (1.0 - s) * (1.0 + pace * run)
            for side in (-1.0, 1.0):
                tau = torques(p.chain, p.pi + side * p.pi_half, q, v, a) + rotor * a
                worst = np.maximum(worst, np.abs(tau).max(axis=0))
        return worst


def starts(model: Model, rng: np.random.Generator) -> list[Start]:
    n, top = model.n, model.domain.dq.hi
    out = []
    for angle, speed in (
        (1e-3, 0.01),
        (0.03, 0.1),
        (0.1, 0.4),
        (0.25, 1.0),
    ):  # up to the monitor's widest boxes: any speed there is
        middle = rng.uniform(-1.0, 1.0, n) * np.maximum(top - speed * top, 0.0) * (rng.random(n) < 0.8)
        out.append(Start(rng.uniform(-2.5, 2.5, n), middle, np.full(n, angle), np.maximum(speed * top, 1e-2)))
    return out


@pytest.mark.parametrize("kind", ["time", "deceleration"])
@pytest.mark.parametrize("name", NAMES)
def test_no_ramp_asks_more_of_a_drive_than_is_told(name: str, kind: str) -> None:
    """8,000 ramps of each arm at 13 instants each, from boxes of states that are wider and wider."""
    model, rng = ARMS[name], np.random.default_rng(NAMES.index(name))
    ramps = Ramps.of(model, kind)
    for start in starts(model, rng) + starts(model, rng):
        closely, at_once = ramps.asked(start), ramps.asked(start, have=np.inf)
        assert np.all(ramps.sampled(start, 1000, rng) <= closely * (1.0 + 1e-9)) and np.all(closely <= at_once)


@pytest.mark.parametrize("name", ["PRBT-like", "UR10e-like", "cobot of seven joints"])
def test_what_is_told_of_a_state_is_nearly_asked(name: str) -> None:
    """Of one state and one motion that keeps its speed: within 30 % of the largest of the drives."""
    model, rng = ARMS[name], np.random.default_rng(4)
    ramps, ratio = Ramps.of(model, "time", pace=0.0), []
    for _ in range(12):
        q, dq = rng.uniform(-2.5, 2.5, model.n), 0.7 * rng.uniform(-1.0, 1.0, model.n) * model.domain.dq.hi
        start = Start(q, dq, np.full(model.n, 1e-3), np.full(model.n, 1e-2))
        told, found = ramps.asked(start), ramps.sampled(start, 400, rng)
        worst = int(np.argmax(found / model.robot.torque_limit))
        ratio.append(told[worst] / found[worst])
    assert 1.0 <= np.median(ratio) < 1.3


@pytest.mark.parametrize(
    ("name", "most"), [("UR10e-like", 0.88), ("cobot of seven joints", 0.92), ("random arm of 7 joints, 1", 0.93)]
)
def test_a_box_looked_at_closely_asks_less(name: str, most: float) -> None:
    """What an angle does to inertia, gravity and Coriolis torque together, and one payload at a time, is less than all of it apart: of the drive
    of which it says the most."""
    model, rng = ARMS[name], np.random.default_rng(6)
    ramps, ratio = Ramps.of(model, "time"), []
    for _ in range(10):
        q, dq = rng.uniform(-2.0, 2.0, model.n), 0.5 * rng.uniform(-1.0, 1.0, model.n) * model.domain.dq.hi
        start = Start(q, dq, np.full(model.n, 0.05), 0.1 * model.domain.dq.hi)
        ratio.append((ramps.asked(start) / ramps.asked(start, have=np.inf)).min())
    assert np.median(ratio) < most


@pytest.mark.parametrize(
    ("name", "payload"),
    [("PRBT-like", None), ("UR10e-like", None), ("cobot of seven joints", None), ("UR10e-like", (12.5, 12.5))],
)
def test_every_corner_of_a_box_of_angles_asks_no_more(name: str, payload: tuple[float, float] | None) -> None:
    """Speeds, zero or not, and a short ramp known: where it begins, at all 2^n corners, with the least and the most payload; nearly as told."""
    model, rng, ratio = ARMS[name], np.random.default_rng(8), []
    n, ramp = model.n, Ramp.stated(model.n, time=0.05, control=0.0)
    ramps = Ramps(StopBounds.of(model, payload, ramp=ramp, fast=True), ramp)
    setting, signs = ramps.bounds.setting, np.array(list(itertools.product((-1.0, 1.0), repeat=model.n)))
    assert setting is not None
    p, every = setting.plant, np.ones((len(signs), 1))
    for k in range(12):
        q, dq = rng.uniform(-2.5, 2.5, n), 0.2 * rng.uniform(-1.0, 1.0, n) * model.domain.dq.hi * (k % 2)
        told = ramps.asked(Start(q, dq, np.full(n, 0.02), np.full(n, 1e-9)))
        a = -dq / ramp.value.lo
        moved = q + ramp.control.hi * dq + 0.02 * signs
        tau = [torques(p.chain, p.pi + side * p.pi_half, moved, every * dq, every * a) + p.rotor * a for side in (-1.0, 1.0)]
        found = np.abs(tau).max(axis=(0, 1))
        assert np.all(found <= told * (1.0 + 1e-9))
        worst = int(np.argmax(found / model.robot.torque_limit))
        ratio.append(told[worst] / found[worst])
    assert np.median(ratio) < 1.25


def test_an_arm_that_stands_asks_for_its_weight() -> None:
    """Of a state that is known exactly: gravity of the heaviest or the lightest arm, and no rotor or speed on top."""
    model, rng = ARMS["UR10e-like"], np.random.default_rng(2)
    ramps, still = Ramps.of(model, "time"), np.zeros(model.n)
    setting = ramps.bounds.setting
    assert setting is not None
    p = setting.plant
    for q in rng.uniform(-2.5, 2.5, (20, model.n)):
        g = [torques(p.chain, p.pi + side * p.pi_half, q[None], still[None], still[None])[0] for side in (-1.0, 1.0)]
        assert ramps.asked(Start(q, still, still, still)) == pytest.approx(np.abs(g).max(axis=0), rel=1e-9, abs=1e-9)


def test_no_state_of_a_box_with_a_stop_1_asks_more_than_its_drives_have() -> None:
    """Boxes of the UR10e-like arm at half its speed: of those that were bounded once the fastest state of one direction had the torque."""
    model, rng = ARMS["UR10e-like"], np.random.default_rng(1)
    ramps = Ramps.of(model, "time")
    limit, told = model.robot.torque_limit, 0
    for k in range(24):
        q, dq = rng.uniform(-2.0, 2.0, 6), 0.4 * rng.uniform(-1.0, 1.0, 6) * model.domain.dq.hi * (k % 4 > 0)
        radii = np.full(6, 0.05 + 0.05 * (k % 2)), (0.05 + 0.25 * (k % 3 > 0)) * model.domain.dq.hi
        if ramps.bounds.bound(q, dq, "1", *radii).certified:
            told += 1
            assert np.all(ramps.sampled(Start(q, dq, *radii), 3000, rng) <= limit)
    assert told >= 4


def test_a_drive_that_gives_less_than_it_tells_has_less_for_a_ramp() -> None:
    """Where the recorded torque is half as much again as the true one, so is the limit that the data sheet tells: the same ramp is refused,
    by the numbers of a drive that much weaker, in text and in the core. One that gives more than it tells gains nothing."""
    plain, ramp, j = ARMS["PRBT-like"], Ramp.stated(6, time=0.3), 1
    q, dq = np.array([0.2, 0.8, 0.4, -0.3, 0.5, 0.1]), np.array([0.3, 1.0, 0.4, 0.2, 0.5, 0.6])

    def limited(limit: float, e: float | None = None, std: float = 0.0) -> Model:
        torque_limit = plain.robot.torque_limit.copy()
        torque_limit[j] = limit
        gain = () if e is None else (Fitted("torque_gain", plain.joints[j], {"e": e}, {"e": std}),)
        return replace(plain, robot=replace(plain.robot, torque_limit=torque_limit), effects=(*plain.effects, *gain))

    def asked(model: Model) -> tuple[str, bool]:
        bounds = StopBounds.of(model, ramp=ramp, fast=True)
        assert bounds.setting is not None
        said = bounds.bound(q, dq, "2").why
        return said, CompiledStops.of(bounds.setting, ramp).bound(q, dq, "2") is not None

    need = float(asked(limited(1.0))[0].split("asks ")[1].split(" N m")[0])
    assert asked(limited(1.2 * need)) == ("", True)
    weaker = asked(limited(1.2 * need / 1.5))
    assert "not credible" in weaker[0] and not weaker[1]
    assert asked(limited(1.2 * need, 0.5)) == weaker == asked(limited(1.2 * need, 0.44, std=0.02))
    assert asked(limited(1.2 * need, -0.3)) == ("", True) and not asked(limited(0.9 * need, -0.3))[1]
    told = StopBounds.of(limited(1.2 * need, 0.5)).setting
    assert told is not None and any("less than its limit for a ramp: torque_gain" in a for a in told.assumptions)


@pytest.mark.parametrize("kind", ["time", "deceleration"])
def test_a_ramp_of_a_motion_that_changes_its_speed_is_at_no_time_slower_or_faster_than_its_tube(
    kind: Literal["time", "deceleration"],
) -> None:
    """Starts, values, paces and speeds anywhere in what is known as ranges: a late start of a motion that gets slower, ramped quickly, has less
    speed left than a late start and a gentle ramp have, or an early start and a quick one."""
    rng, worst = np.random.default_rng(0), 0.0
    for _ in range(150):
        top = 10.0 * rng.random()
        pace = np.array([-top, top]) if rng.random() < 0.5 else np.sort(rng.uniform(-top, top, 2))
        control, size, v = (
            np.sort(rng.uniform(*x, 2)) for x in ((0.0, 0.1), (0.1, 0.6) if kind == "time" else (1.0, 8.0), (-1.0, 2.0))
        )
        ramp = Ramp(
            kind,
            Box.of(*size[:, None]),
            Box.of(*control[:, None]),
            np.zeros(1),
            np.zeros(1),
            pace=(float(pace[0]), float(pace[1])),
        )
        tube = ramp_tube(ramp, v[:1], v[1:])
        t = np.linspace(0.0, tube.t[-1], 700)[:, None]
        step = np.clip(np.searchsorted(tube.t, t[:, 0], side="right") - 1, 0, len(tube.t) - 2)
        p, begin, value, w = (
            np.where(rng.random(60) < 0.5, rng.choice(x, 60), rng.uniform(*x, 60)) for x in (pace, control, size, v)
        )
        lasts = value if kind == "time" else np.abs(w) / value
        s = np.clip((t - begin) / lasts, 0.0, 1.0)
        share = np.maximum(1.0 + p * (np.minimum(t, begin) + lasts * (s - 0.5 * s * s)), 0.0)
        speed = w * (1.0 - s) * share
        worst = max(worst, float(np.max(speed - tube.e_hi[step])), float(np.max(tube.e_lo[step] - speed)))
    assert worst <= 1e-12


@pytest.mark.parametrize("effect", ["load_coulomb", "quadratic_load"])
def test_friction_by_the_gear_s_load_is_not_promised_less_than_a_hard_ramp_makes_it(effect: str) -> None:
    """Where the shoulder brakes hard the elbow, which moves the other way, is loaded by more than its gravity and brake: so is its friction."""
    arm, n, elbow = ARMS["PRBT-like"], 6, 2
    values = {"load_coulomb": {"k_lift": 0.4, "k_lower": 0.4}, "quadratic_load": {"k_2": 0.004}}[effect]
    rubs = Fitted(effect, arm.joints[elbow], values, dict.fromkeys(values, 0.0))
    assert arm.brakes is not None
    brakes = replace(arm.brakes, torque=Box.of(0.3 * arm.brakes.torque.lo, 0.3 * arm.brakes.torque.hi))
    q, dq = np.array([0.3, 1.5, 0.3, 0.1, 0.2, 0.0]), np.array([0.0, 1.2, 0.0, 0.0, 0.0, 0.0])
    chain, pi = arm.robot.chain, arm.robot.pi
    dq[elbow] = 0.05 * np.sign(torques(chain, pi, q[None], dq[None], -dq[None])[0, elbow])
    told = []
    for lasts, limit in itertools.product((0.3, 0.014, 0.012, 0.01), np.linspace(20.0, 400.0, 60)):
        ramp, robot = (
            Ramp.stated(n, time=lasts, control=0.0),
            replace(arm.robot, torque_limit=np.where(np.arange(n) == elbow, limit, 1e5)),
        )
        model = replace(arm, effects=(*arm.effects, rubs), brakes=brakes, robot=robot)
        bounds = StopBounds.of(model, (0.0, 0.0), ramp=ramp)
        link = float(torques(chain, pi, q[None], dq[None], -dq[None] / lasts)[0, elbow])
        rub = 1.25 * (0.4 * abs(link) if effect == "load_coulomb" else 0.004 * link**2)
        needs = abs(link - arm.rotor[elbow] * dq[elbow] / lasts + np.sign(dq[elbow]) * rub)
        certified = bounds.bound(q, dq, "1").certified
        assert bounds.setting is not None
        assert certified == (CompiledStops.of(bounds.setting, ramp).bound(q, dq, "1") is not None)
        assert not certified or limit >= needs
        told.append((lasts, certified, abs(link) > bounds.setting.torques.gear[elbow]))
    assert any(certified for lasts, certified, _ in told if lasts == 0.3) and any(hard for *_, hard in told)
