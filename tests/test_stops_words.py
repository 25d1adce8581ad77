"""What a stop bound says in words is what it holds for: stops of an arm that shares no code with the bounds, true to the printed
assumptions, stay inside; and bounds that mean something else are left."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import Model, load_model, save_model
from stopset.offline.brakes import identify_stops, with_stops
from stopset.offline.brakes.power_off import own_lags, timing_of, without_strays
from stopset.reach.stops import Ramp, StopBound, StopBounds, ramp_of
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK
from stopset.reach.stops.tubes import tubes_of
from stopset.sets import Box

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from independent_stops import DT, rested, shipped_arm, stopped
from stop_arms import prbt_like

from test_brakes import PERIOD, _recording, arm, recorded_stop0

MODEL = prbt_like((0.0, 0.0))
ARM = shipped_arm(MODEL.rotor)
ANGLE, SPEED = 5e-5, 5e-3  # what steps of 0.1 ms err by: at most 3e-6 rad and 2e-4 rad/s against steps of 10 us, with room


def drawn(bounds: StopBounds, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Friction, brakes and disturbance at random corners of what the assumptions say."""
    p = bounds.setting.plant

    def pick(name: str) -> np.ndarray:
        return np.where(rng.random(6) < 0.5, getattr(p, f"{name}_lo"), getattr(p, f"{name}_hi"))

    u = np.where(rng.random((8, 6)) < 0.5, p.u_lo, p.u_hi)
    return {"F": pick("coulomb"), "D": pick("viscous"), "B": pick("brake"), "delay": pick("delay"), "rise": pick("rise"), "u": u}


def corner(box: Box, rng: np.random.Generator) -> np.ndarray:
    return np.where(rng.random(box.dim) < 0.5, box.lo, box.hi)


def test_the_temperatures_that_friction_is_told_for_are_among_the_assumptions() -> None:
    """Of every bound: those of the recordings, or that none was recorded."""
    temp = Box.of(np.full(6, 22.5), np.linspace(30.0, 41.0, 6))
    warm = replace(MODEL, domain=replace(MODEL.domain, temp=temp))
    for model, words in (
        (warm, "drives no colder and no warmer than recorded: [22.5, 30] [22.5, 32.2]"),
        (MODEL, "no recording tells a temperature"),
    ):
        bounds = StopBounds.of(model, ramp=Ramp.stated(6, time=0.5).failing(0.6))
        for category in ("0", "1", "1 guaranteed", "2"):
            said = bounds.bound(np.full(6, 0.3), np.full(6, 0.2), category).assumptions  # type: ignore[arg-type]
            assert sum(words in a for a in said) == 1


@pytest.mark.parametrize("category", ["0", "1", "1 guaranteed", "2"])
def test_who_can_run_into_an_end_stop_is_told(category: str) -> None:
    """No joint limit on the way is what a bound rests on; where it does not itself rule that out it says so, of boxes by their corner."""
    limit, j = MODEL.robot.q_limit[1, 1], MODEL.joints[1]
    arm_ = replace(MODEL, domain=replace(MODEL.domain, q=Box.symmetric(np.full(6, 2.96))))
    bounds = StopBounds.of(arm_, ramp=Ramp.stated(6, time=0.3).failing(0.4))
    q, dq = np.full(6, 0.2), np.zeros(6)
    q[1], dq[1] = limit - 0.02, 1.2

    def said(v: np.ndarray, box: float = 0.0) -> str:
        b = bounds.bound(q - box * np.eye(6)[1], v, category, np.full(6, box), np.zeros(6))  # type: ignore[arg-type]
        assert b.certified
        return b.why

    assert f"{j} can come to an end stop on the way" in said(dq) and f"{j} can come" in said(dq, 0.03)
    q[1] = limit - 0.6
    assert "end stop" not in said(dq) and "end stop" not in said(-dq)


def test_a_brake_heard_of_only_when_it_is_early_is_not_always_early() -> None:
    """Brakes that engage at times of their own; the first joint is at rest before 32 ms in all recorded stops. In a faster one it is not."""
    delay = np.random.default_rng(3).uniform(0.02, 0.06, (40, 6))
    told = np.where((np.arange(6) == 0) & (delay > 0.032), np.nan, delay)
    own = own_lags(told)
    box, delay_spread, _ = timing_of(told, own, [0] * 40)
    assert own[0] == 0.0 and np.all(box.hi >= delay.max(axis=0)) and np.all(box.lo <= delay.min(axis=0))
    assert delay_spread is not None and np.ptp(delay - own, axis=1).max() <= delay_spread
    # one that really is always early is heard of in every stop
    early = delay * 0.2 + 0.04 - 0.02 * (np.arange(6) == 0)
    assert own_lags(early)[0] == pytest.approx(-0.02, abs=3e-3)


# ---- brakes that engage close together -----------------------------------------------------------------------------------


def escapes_of_brakes_cut_together(model: Model, lag: np.ndarray | None, states: int, stops: int) -> int:
    """Stops whose delays, less the true lags, lie ``delay_spread``: how many leave the tubes at any ms."""
    bounds, rng = StopBounds.of(model, pieces=8), np.random.default_rng(1)
    s, b, escaped = bounds.setting, model.brakes, 0
    own = np.zeros(6) if lag is None else lag
    grid = np.arange(0.0, 0.4, 1e-3)
    first, last = (b.delay.lo - own).max() - b.delay_spread, (b.delay.hi - own).min()
    for _ in range(states):
        q, dq = rng.uniform(-1.5, 1.5, 6), rng.choice([-1.2, 1.2], 6)
        tubes = tubes_of(s, Start(q, dq, s.noise.radius[:6], s.noise.radius[6:]), 8)
        assert tubes[-1].end == OK

        def at(name: str, tubes: list = tubes) -> np.ndarray:  # type: ignore[type-arg]
            return np.array([[np.interp(grid, t.t, getattr(t, name)[:, j]) for j in range(6)] for t in tubes])

        far, back, fast, slow = at("d_hi").max(axis=0), at("d_lo").min(axis=0), at("v_hi").max(axis=0), at("v_lo").min(axis=0)
        for _ in range(stops):
            while True:
                delay = rng.uniform(first, last) + b.delay_spread * rng.integers(0, 2, 6) + own
                if np.all((delay >= b.delay.lo) & (delay <= b.delay.hi)):
                    break
            q0, v0 = q + corner(Box(s.noise.lo[:6], s.noise.hi[:6]), rng), dq + corner(Box(s.noise.lo[6:], s.noise.hi[6:]), rng)
            _, qs, vs = stopped(ARM, **(drawn(bounds, rng) | {"delay": delay}), q=q0, dq=v0, lasts=0.4)
            d, v = (qs - q0)[:-1:10].T, vs[:-1:10].T
            escaped += bool(
                np.any(d > far + ANGLE) or np.any(d < back - ANGLE) or np.any(v > fast + SPEED) or np.any(v < slow - SPEED)
            )
    return escaped


def test_delays_apart_as_printed_stay_inside_wherever_the_joints_intervals_lie() -> None:
    quiet, torque = Box.symmetric(np.full(12, 1e-6)), MODEL.brakes.torque.centre
    sets = {"powered": replace(MODEL.powered, V=quiet, X0=quiet, U=Box.symmetric(np.full(6, 0.05)))}
    lo = 0.02 + np.array([0.0, 0.0, 0.04, 0.0, 0.0, 0.0])
    brakes = replace(
        MODEL.brakes, torque=Box.of(0.98 * torque, 1.02 * torque), rise=Box.of(np.full(6, 0.019), np.full(6, 0.021)),
        delay=Box.of(lo, lo + 0.05), delay_spread=0.004,
    )  # fmt: skip
    model = replace(MODEL, sets=sets, brakes=brakes)
    assert "within one stop the brakes' delays lie apart by no more than 4 ms" in StopBounds.of(model).setting.assumptions
    assert escapes_of_brakes_cut_together(model, None, 3, 40) == 0
    # the same place within each joint's interval is another promise, with other words, and these stops leave it
    other = replace(model, brakes=replace(brakes, lag=lo - lo.min()))
    words = " ".join(StopBounds.of(other).setting.assumptions)
    assert "less the [0, 0, 40, 0, 0, 0] ms by which each is always later" in words
    assert escapes_of_brakes_cut_together(other, None, 3, 40) > 0
    assert escapes_of_brakes_cut_together(other, other.brakes.lag, 3, 40) == 0


def test_a_brake_that_is_always_late_is_no_stray() -> None:
    rng, late = np.random.default_rng(4), np.array([0.0, 0.0, 0.025, 0.0, 0.0, 0.0])
    delay = rng.uniform(0.04, 0.055, (20, 1)) + late + rng.uniform(0.0, 0.002, (20, 6))
    delay[rng.random((20, 6)) < 0.3] = np.nan
    delay[3, 0] = 0.2  # a misfit
    notes: list[str] = []
    own = own_lags(delay)
    regular = without_strays(delay, own, notes)
    assert np.all(np.isnan(regular[:, 2]) == np.isnan(delay[:, 2])) and np.isnan(regular[3, 0])
    box, delay_spread, _ = timing_of(regular, own, [0] * 20)
    assert delay_spread is not None and 0.001 < delay_spread < 0.006 and own - own.min() == pytest.approx(late, abs=2e-3)
    assert box.lo[2] <= 0.066 and box.hi[2] >= 0.079 and box.hi[0] < 0.07
    # two joints alone tell of the lag between them, too
    assert np.ptp(own_lags(delay[:, [1, 2]])) == pytest.approx(0.025, abs=2e-3)


def test_identified_brakes_hold_one_that_is_always_late(tmp_path: Path) -> None:
    model, rng = arm(), np.random.default_rng(8)
    torque = model.brakes.torque.centre
    F, D = np.array([15.0, 15, 10, 8, 3, 2]), np.array([5.0, 5, 3, 3, 1, 1])
    late, recordings = np.array([0.0, 0.025, 0.0, 0.0, 0.0, 0.0]), []
    for k in range(18):
        q, dq = rng.uniform(-1.5, 1.5, 6), rng.uniform(-1.2, 1.2, 6)
        delay = np.full(6, rng.uniform(0.030, 0.040)) + late
        _, qs, vs = stopped(ARM, F, D, torque * rng.uniform(0.95, 1.05, 6), delay, np.full(6, 0.012), q, dq, 0.4)
        every = round(PERIOD / DT)
        recordings.append(_recording("stop0", k, qs[::every], vs[::every], rng))
    fit = identify_stops(model, recordings)
    b = fit.model.brakes
    assert b is not None and b.lag is not None and b.lag[1] - np.median(b.lag) == pytest.approx(0.025, abs=4e-3)
    assert b.delay.hi[1] >= 0.065 - PERIOD and b.delay_spread < 0.015
    assert fit.stop0.violated == 0 and fit.stop0.motions >= 4
    save_model(fit.model, tmp_path / "m.model.json")
    back = load_model(tmp_path / "m.model.json").brakes
    assert np.array_equal(back.lag, b.lag) and back.delay_spread == b.delay_spread


def test_brakes_of_an_older_file_keep_their_meaning(tmp_path: Path) -> None:
    """Files before the lags meant the same place within each joint's interval: those lags are read into them."""
    import json

    from stopset.artifact.store import _digest
    from stopset.offline.description.older import load_model

    lo = np.array([0.02, 0.06, 0.02, 0.02, 0.03, 0.02])
    path = tmp_path / "m.model.json"
    save_model(replace(MODEL, brakes=replace(MODEL.brakes, delay=Box.of(lo, lo + 0.05), delay_spread=0.004)), path)
    body = json.loads(path.read_text())
    assert load_model(path).brakes.lag is None
    del body["brakes"]["lag"], body["robot"]["arm"]
    body["schema"] = 2
    body["sha256"] = _digest(body)
    path.write_text(json.dumps(body))
    assert load_model(path).brakes.lag == pytest.approx(lo - 0.02)


# ---- what the drives still give --------------------------------------------------------------------------------------------

RESIDUAL = np.array([0.02, 0.02, 0.03, 0.03, 0.06, 0.06])


def with_residual() -> Model:
    """The arm with a regime STOP 0 whose X0 holds more than the measurement's error."""
    X0 = Box.symmetric(np.r_[np.full(6, 1e-3), np.maximum(RESIDUAL, 0.01)])
    return replace(MODEL, sets={**MODEL.sets, "stop0": replace(MODEL.powered, X0=X0)})


def outside(bound: StopBound, t: np.ndarray, d: np.ndarray, v: np.ndarray) -> bool:
    """Whether a stop (times, displacements, speeds since the request) leaves what the bound says."""
    late = rested(t, v) > bound.time + 2 * DT
    far = np.any(d.max(axis=0) > bound.forward + ANGLE) or np.any(-d.min(axis=0) > bound.back + ANGLE)
    return bool(np.any(late) or far or np.any(np.abs(v).max(axis=0) > bound.speed + SPEED))


@pytest.mark.parametrize("kind", ["SS1-r", "SS1-t"])
def test_after_a_failed_ramp_the_drives_still_give_what_they_give(kind: str) -> None:
    off = {"monitored": True} if kind == "SS1-r" else {"off_after": 0.15}
    ramp = Ramp.stated(6, time=0.3).failing(**off)  # type: ignore[arg-type]
    bounds, rng = StopBounds.of(with_residual(), ramp=ramp), np.random.default_rng(3)
    assert any("the drives still give" in a for a in bounds.setting.assumptions)
    lost = replace(bounds, setting=replace(bounds.setting, residual=Box.point(np.zeros(6))))
    escaped = missed = 0
    for _ in range(3):
        q, dq = rng.uniform(-1.5, 1.5, 6), rng.uniform(-1.2, 1.2, 6) * rng.integers(0, 2, 6)
        bound, without = bounds.bound(q, dq, "1 guaranteed"), lost.bound(q, dq, "1 guaranteed")
        assert bound.certified and without.certified
        for k in range(60):
            # the ramp works almost to its end, or each drive keeps a share of its own
            cut = 0.024 + 0.3 + ramp.reaction if kind == "SS1-r" else 0.15
            share = np.zeros(6) if k % 2 else 0.1 * rng.random(6)
            before = np.zeros((2, 6)) if kind == "SS1-t" else dq * np.array([[0.0], [0.024 + 0.15]])
            v0 = share * dq + corner(Box.symmetric(np.maximum(RESIDUAL, 0.01)), rng)
            t, qs, vs = stopped(ARM, **drawn(bounds, rng), q=q + before[-1], dq=v0, lasts=0.3)
            t, d, v = np.r_[0.0, cut + t], np.vstack([before[:1], qs - q]), np.vstack([dq, vs])
            escaped += outside(bound, t, d, v)
            missed += outside(without, t, d, v)
    assert escaped == 0
    assert missed > 0, "the drives' residual is what these stops go farther or longer by"


def test_a_standstill_window_that_is_left_adds_what_is_told() -> None:
    ramp = Ramp.stated(6, time=0.3)
    bounds, rng = StopBounds.of(with_residual(), ramp=ramp), np.random.default_rng(6)
    lost = replace(bounds, setting=replace(bounds.setting, residual=Box.point(np.zeros(6))))
    escaped = missed = 0
    for _ in range(3):
        q, dq = rng.uniform(-1.2, 1.2, 6), 0.15 * rng.uniform(-1.0, 1.0, 6)
        end = q + dq * (0.15 + 0.012)
        late, without = bounds.bound(q, dq, "2").fallback, lost.bound(q, dq, "2").fallback
        assert late is not None and without is not None
        for _ in range(60):
            creep, wait = ramp.creep * rng.choice([-1.0, 1.0], 6), ramp.reaction
            start = end + ramp.window * rng.choice([-1.0, 1.0], 6)
            v0 = creep + np.sign(creep) * RESIDUAL
            t, qs, vs = stopped(ARM, **drawn(bounds, rng), q=start + creep * wait, dq=v0, lasts=0.4)
            angle, time = np.abs(qs - start).max(), wait + rested(t, vs).max()
            escaped += angle > late[0] + ANGLE or time > late[1] + 2 * DT
            missed += angle > without[0] + ANGLE or time > without[1] + 2 * DT
    assert escaped == 0 and missed > 0


# ---- rest ------------------------------------------------------------------------------------------------------------------


def test_with_the_power_off_every_joint_rests_when_it_is_said_to() -> None:
    bounds, rng = StopBounds.of(MODEL), np.random.default_rng(5)
    close = []
    for _ in range(4):
        q, dq = rng.uniform(-1.5, 1.5, 6), rng.uniform(-1.2, 1.2, 6)
        bound, last = bounds.bound(q, dq), np.zeros(6)
        assert bound.certified and any("speed zero" in a for a in bound.assumptions)
        for _ in range(50):
            v0 = dq + corner(Box.symmetric(bounds.setting.noise.radius[6:]), rng)
            t, qs, vs = stopped(ARM, **drawn(bounds, rng), q=q, dq=v0, lasts=0.3)
            assert not outside(bound, t, qs - q, vs)
            last = np.maximum(last, rested(t, vs))
        close.append(float(bound.time.max() / last.max()))
    assert np.median(close) < 1.3


def ringing_stop1(count: int, seed: int) -> list:  # type: ignore[type-arg]
    """Controlled stops that ring on after their ramp: 60 to 120 ms beyond 0.02 rad/s."""
    rng, out = np.random.default_rng(seed), []
    for k in range(count):
        dq, lasts, control = rng.uniform(-1.2, 1.2, 6), rng.uniform(0.28, 0.32), rng.uniform(0.004, 0.012)
        t = np.arange(160) * PERIOD
        s = np.clip((t[:, None] - control) / lasts, 0.0, 1.0)
        since = np.maximum(t - control - lasts, 0.0)[:, None]
        decay = rng.uniform(0.02, 0.04)
        ring = 0.2 * np.exp(-since / decay) * np.sin(40.0 * since) * (since > 0) * rng.uniform(0.3, 1.0, 6)
        v = dq * (1.0 - s) + ring
        q = dq * (np.minimum(t[:, None], control) + lasts * (s - 0.5 * s * s)) + np.cumsum(ring, axis=0) * PERIOD
        out.append(_recording("stop1", k, q, v, rng))
    return out


def test_a_controlled_stop_lasts_until_the_arm_stands_still() -> None:
    model = arm()
    fit = identify_stops(model, [*recorded_stop0(model, 12, 4), *ringing_stop1(24, 5)])
    ramp = fit.ramp
    assert ramp is not None and ramp.settle is not None and 0.05 < ramp.settle < 0.4 and fit.stop1.violated == 0
    known = with_stops(model, fit)
    assert ramp_of(known).as_dict() == ramp.as_dict()
    bounds, reference = StopBounds.of(known), 0.0
    moving_on = late = 0
    for r in ringing_stop1(30, 77):
        k = int(np.argmax(r.stop_trigger))
        # the arm of these stops has no recording elsewhere: one pose stands for all, a ramp's time does not depend on it
        bound = bounds.bound(np.zeros(6), np.clip(r.dq[k], -1.2, 1.2), "1")
        assert bound.certified and any("standstill speed of" in a for a in bound.assumptions)
        t, v = r.t[k:] - r.t[k], np.abs(r.dq[k:])
        late += bool(np.any(v[t > bound.time.max()] > np.max(ramp.band)))
        reference = float((ramp.control.hi + ramp.value.hi).max())
        moving_on += bool(np.any(v[t > reference] > 0.02))
    assert moving_on > 20, "they do move on after the reference ramp"
    assert late <= 1, "and hardly ever after the time to rest: 24 stops tell the next one's with some risk"
    older = {k: v for k, v in ramp.as_dict().items() if k not in ("settle", "standstill")}
    silent = StopBounds.of(known, ramp=Ramp.from_dict(older)).bound(np.zeros(6), np.full(6, 0.5), "1")
    assert not silent.certified and silent.time is None and "identify again" in silent.why
