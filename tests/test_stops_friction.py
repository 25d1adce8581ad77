"""Trap P23: friction that grows with the gear's load, while the brakes are what loads it: which quadrant holds is not known."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stop_sampling import ANGLE_ERROR, SPEED_ERROR, tube_at
from stop_tubes import tube_of
from stopset.artifact import Brakes, Model
from stopset.effects.base import Fitted
from stopset.effects.bound import SIGMAS
from stopset.reach.stops import StopBounds
from stopset.reach.stops.friction import FRICTION_TOLERANCE, Friction, torques_of
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.tube import OK, Tube
from stopset.robot.rigid import torque
from stopset.sets import Box
from stopset.simulation.stop import StoppingArm, simulate_stop

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like

LIFT, LOWER = 0.20, 0.10
PIECE, DT = 1e-3, 0.25e-3


def loaded(k_lift: float = LIFT, k_lower: float = LOWER):  # type: ignore[no-untyped-def]
    """An arm whose brakes and disturbance are known well, so that the friction is what matters."""
    arm = prbt_like((0.0, 3.0))
    torque_, late = arm.brakes.torque.centre, np.full(6, 0.02)
    sharp = Brakes(Box.of(0.99 * torque_, 1.01 * torque_), Box.of(0.99 * late, late), Box.of(0.99 * late, late), "assumed")
    arm = replace(arm, brakes=sharp, sets={"powered": replace(arm.powered, U=Box.symmetric(np.full(6, 0.05)))})
    more = [
        Fitted("load_coulomb", j, {"k_lift": k_lift, "k_lower": k_lower}, {"k_lift": 0.0, "k_lower": 0.0})
        for j in arm.joints[:4]
    ]  # fmt: skip
    return replace(arm, effects=(*arm.effects, *more))


def stop_with_load_friction(
    s: Setting, q: np.ndarray, dq: np.ndarray, mass: float, horizon: float
) -> tuple[np.ndarray, np.ndarray]:
    """A simulated stop whose dry friction follows the load that rigid body and brakes put on each gear, piece by piece."""
    p = s.plant
    pi = p.pi + mass * p.pi_half
    F0, k = 1.25 * np.array([15.0, 15.0, 10.0, 8.0, 3.0, 2.0]), np.array([1.0, 1.0, 1.0, 1.0, 0.0, 0.0])
    qs, vs = [q], [dq]
    a = np.zeros(6)
    for n in range(round(horizon / PIECE)):
        load = torque(p.chain, pi, qs[-1], vs[-1], a)
        share = np.where(load * vs[-1] > 0.0, LIFT, LOWER)
        x, v = simulate_stop(
            StoppingArm(p.chain, pi, p.rotor, F0 + k * share * np.abs(load), p.viscous_hi, p.brake_hi, p.delay_lo - n * PIECE, p.rise_lo),
            qs[-1], vs[-1], DT, round(PIECE / DT), np.zeros((1, 6)),
        )  # fmt: skip
        a = (v[-1] - vs[-1]) / PIECE
        qs.append(x[-1])
        vs.append(v[-1])
    return np.array(qs), np.array(vs)


def friction_of(model: Model, payload: float = 0.0) -> Friction:
    return torques_of(model, (0.0, payload)).everywhere


def leaves(tube: Tube, q: np.ndarray, dq: np.ndarray, s: Setting, mass: float) -> bool:
    qs, vs = stop_with_load_friction(s, q, dq, mass, float(tube.t[-1]))
    dl, dh, vl, vh = tube_at(tube, np.minimum(np.arange(len(qs)) * PIECE, tube.t[-1]))
    d = qs - q
    return bool(
        np.any(d > dh + ANGLE_ERROR)
        or np.any(d < dl - ANGLE_ERROR)
        or np.any(vs > vh + SPEED_ERROR)
        or np.any(vs < vl - SPEED_ERROR)
    )


@pytest.mark.parametrize("mass", [-1.0, 1.0])
def test_load_friction_under_hard_braking_stays_inside(mass: float) -> None:
    good, bare = StopBounds.of(loaded(), (0.5, 1.0)).setting, StopBounds.of(loaded(0.0, 0.0), (0.5, 1.0)).setting
    assert good is not None and bare is not None
    rng, escaped = np.random.default_rng(8), 0
    for _ in range(8):
        q, dq = rng.uniform(-2.3, 2.3, 6), rng.uniform(0.3, 1.26, 6) * rng.choice([-1.0, 1.0], 6)
        r, v = good.noise.radius[:6], good.noise.radius[6:]
        tube = tube_of(good, q, dq, r, v)
        assert tube.end == OK and not leaves(tube, q, dq, good, mass)
        without = tube_of(bare, q, dq, 1e-9 * r, 1e-9 * v)
        escaped += leaves(without, q, dq, good, mass)
    assert escaped > 0  # the same stops leave a bound that knows no load


def test_no_quadrant_is_credited_and_the_load_is_payload_and_brake_too() -> None:
    model = loaded()
    dry, none = friction_of(model, 3.0).dry, friction_of(loaded(0.0, 0.0), 3.0).dry
    assert np.allclose(dry.lo, none.lo)
    assert np.all(dry.hi[:4] - none.hi[:4] >= LIFT * model.brakes.torque.hi[:4])
    assert np.all(friction_of(model, 3.0).dry.hi[1:3] > friction_of(model, 0.0).dry.hi[1:3])


def test_a_share_that_may_be_negative_takes_friction_away() -> None:
    assert np.all(friction_of(loaded(0.1, -0.02), 0.0).dry.lo[:4] < friction_of(loaded(0.1, 0.0), 0.0).dry.lo[:4])


def test_a_drive_that_warms_itself_may_have_lost_what_the_fastest_work_takes() -> None:
    arm = prbt_like((0.0, 3.0))
    warm = Fitted("self_heating", arm.joints[0], {"k_c": -2.0, "k_v": -1.0, "tau_w": 5.0}, {"k_c": 0.1, "k_v": 0.0})
    before, after = friction_of(arm), friction_of(replace(arm, effects=(*arm.effects, warm)))
    fastest = max(abs(arm.domain.dq.lo[0]), abs(arm.domain.dq.hi[0]))
    taken = (1.0 - FRICTION_TOLERANCE) * (2.0 + SIGMAS * 0.1) * fastest
    assert after.dry.lo[0] == pytest.approx(max(before.dry.lo[0] - taken, 0.0))
    assert after.viscous.lo[0] == pytest.approx(max(before.viscous.lo[0] - (1.0 - FRICTION_TOLERANCE) * fastest, 0.0))
    assert after.dry.hi[0] == before.dry.hi[0]
