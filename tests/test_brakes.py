"""Brakes and ramps from recorded stops: the true values are found, held-out stops are enclosed, too narrow intervals are not."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact import Brakes, Model, load_model, save_model
from stopset.effects.base import Fitted
from stopset.errors import RecordingError
from stopset.offline.brakes import divide, identify_stops, judge_stop0, judge_stop1, with_stops
from stopset.offline.brakes.bands import RISK, band, beyond, farther, hull
from stopset.offline.brakes.impulse import Impulse, impulses
from stopset.offline.brakes.timing import brake_estimate
from stopset.offline.description import load_robot
from stopset.reach.stops import Ramp, StopBounds, ramp_of
from stopset.reach.stops.setting import setting_of
from stopset.reach.stops.windows import windows
from stopset.recording import Recording, read_recordings
from stopset.sets import Box
from stopset.simulation.stop import StoppingArm, simulate_stop

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data" / "hidden_effect"
PERIOD = 0.004
DELAY, RISE = (0.040, 0.055), 0.012  # [s] true values of the recorded arm
NOISE_Q, NOISE_DQ = 5e-5, 3e-3
FINE = 8  # steps of the simulation in a sample


def arm() -> Model:
    """The arm before any stop was recorded: brakes known as a data sheet knows them."""
    model = prbt_like((0.0, 0.0))
    torque = model.brakes.torque.centre
    wide = Brakes(
        Box.of(0.7 * torque, 1.3 * torque),
        Box.of(np.full(6, 0.005), np.full(6, 0.1)),
        Box.of(np.full(6, 0.002), np.full(6, 0.03)),
    )
    return replace(model, brakes=wide)


def usual(rng: np.random.Generator) -> np.ndarray:
    """(6,) [s] delays of brakes that are cut together."""
    return np.full(6, rng.uniform(*DELAY))


def sticking(rng: np.random.Generator) -> np.ndarray:
    """The same of an arm whose second brake sticks in a fifth of its stops."""
    out = usual(rng)
    out[1] += rng.uniform(0.02, 0.04) if rng.random() < 0.2 else 0.0
    return out


def simulated_stop0(
    model: Model, count: int, seed: int, delays: Callable[[np.random.Generator], np.ndarray]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """True angles and speeds (K, 6) of each stop, eight to a sample."""
    rng, robot = np.random.default_rng(seed), model.robot
    torque = model.brakes.torque.centre
    F, D = np.array([15.0, 15, 10, 8, 3, 2]), np.array([5.0, 5, 3, 3, 1, 1])
    for _ in range(count):
        q, dq = rng.uniform(-1.5, 1.5, 6), rng.uniform(-1.2, 1.2, 6)
        delay = delays(rng)
        yield simulate_stop(
            StoppingArm(robot.chain, robot.pi, model.rotor, F, D, torque * rng.uniform(0.95, 1.05, 6), delay, np.full(6, RISE)), q, dq,
            PERIOD / FINE, 80 * FINE, np.zeros((1, 6)),
        )  # fmt: skip


def recorded_stop0(
    model: Model, count: int, seed: int, delays: Callable[[np.random.Generator], np.ndarray] = usual
) -> list[Recording]:
    rng = np.random.default_rng(seed + 1000)
    return [
        _recording("stop0", k, qs[::FINE], vs[::FINE], rng)
        for k, (qs, vs) in enumerate(simulated_stop0(model, count, seed, delays))
    ]


def _recording(phase: str, k: int, q: np.ndarray, v: np.ndarray, rng: np.random.Generator) -> Recording:
    before = 10
    t = np.arange(before + len(q)) * PERIOD
    q = np.vstack([q[0] + v[0] * PERIOD * np.arange(-before, 0)[:, None], q]) + rng.uniform(-NOISE_Q, NOISE_Q, (len(t), 6))
    v = np.vstack([np.tile(v[0], (before, 1)), v]) + rng.normal(0.0, NOISE_DQ, (len(t), 6))
    trigger = np.arange(len(t)) >= before
    return Recording(phase, 0, k, k, t, q, v, np.zeros_like(q), stop_trigger=trigger)


def recorded_stop1(count: int, seed: int) -> list[Recording]:
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        dq, lasts, control = rng.uniform(-1.2, 1.2, 6), rng.uniform(0.28, 0.32), rng.uniform(0.004, 0.012)
        t = np.arange(140) * PERIOD
        s = np.clip((t[:, None] - control) / lasts, 0.0, 1.0)
        v = dq * (1.0 - s)
        q = dq * (np.minimum(t[:, None], control) + lasts * (s - 0.5 * s * s)) + 2e-4 * np.sin(30 * t)[:, None]
        out.append(_recording("stop1", k, q, v + 6e-3 * np.cos(30 * t)[:, None], rng))
    return out


def test_true_brakes_are_found_and_held_out_stops_enclosed(tmp_path: Path) -> None:
    model = arm()
    stops = recorded_stop0(model, 24, 4)
    fit = identify_stops(model, [*stops, *recorded_stop1(16, 5)])
    b = fit.model.brakes
    assert b is not None and fit.stop0 is not None and fit.noise is not None
    truth = model.brakes.torque.centre
    assert np.all((b.torque.lo <= truth) & (truth <= b.torque.hi))
    # the cut lies within a sample of the trigger, so the delay is known no better than that
    assert b.delay.lo.max() - PERIOD <= DELAY[0] and DELAY[1] <= b.delay.hi.min() + PERIOD
    assert (b.delay.hi - b.delay.lo).max() < 0.04
    # one delay for all joints of a stop: what remains apart is the error of the estimates
    assert b.delay_spread is not None and b.delay_spread < 0.010
    assert fit.stop0.violated == 0 and fit.stop0.motions == 8
    assert 0 < fit.stop0.upper_bound < 0.35 and "held-out" in fit.stop0.text
    assert fit.stop1 is not None and fit.stop1.violated == 0
    known = with_stops(model, fit)
    back = load_model(_saved(known, tmp_path))
    assert back.brakes is not None and back.brakes.delay_spread == b.delay_spread
    ramp = ramp_of(back)
    assert ramp is not None and ramp.kind == "time" and ramp.value.lo[0] <= 0.29 and ramp.value.hi[0] >= 0.31
    bound_ = StopBounds.of(back).bound(np.zeros(6) + 0.3, np.full(6, 0.8), "1")
    # tracking errors are as large as those recorded, from whatever speed the arm is stopped: from which they were is told
    assert ramp.fastest is not None and np.all((ramp.fastest > 0.9) & (ramp.fastest < 1.21))
    assert any(f"recorded from at most [{ramp.fastest[0]:.3g}, " in a for a in bound_.assumptions)
    assert bound_.certified and bound_.forward.max() >= 0.8 * 0.5 * 0.3
    # the test has teeth: other brakes and another ramp are refuted by the same held-out stops
    held = divide(stops)[1]
    fast = replace(b, delay=Box.of(np.full(6, 0.002), np.full(6, 0.012)))
    assert judge_stop0(replace(known, brakes=fast), held).outside
    weak = replace(b, torque=Box(0.4 * b.torque.lo, 0.5 * b.torque.lo))
    assert judge_stop0(replace(known, brakes=weak), held).outside
    short = replace(ramp, value=Box.of(np.full(6, 0.2), np.full(6, 0.22)))
    assert judge_stop1(short, fit.noise, divide(recorded_stop1(16, 5))[1]).outside


def test_a_brake_that_sticks_now_and_then_is_in_the_bound() -> None:
    """Its late stops are no misfits: stops of the same arm that nobody recorded stay inside their bounds, each number for itself."""
    model = arm()
    known = with_stops(model, identify_stops(model, recorded_stop0(model, 36, 4, sticking)))
    bounds, late = StopBounds.of(known, (0.0, 0.0), pieces=8), 0
    for qs, vs in simulated_stop0(model, 60, 99, sticking):
        b = bounds.bound(qs[0], vs[0])
        assert b.certified and b.time is not None and b.forward is not None and b.back is not None
        moves = np.abs(vs) > 1e-3
        rests = PERIOD / FINE * np.where(moves.any(axis=0), len(vs) - np.argmax(moves[::-1], axis=0), 0)
        late += rests[1] > 0.085
        moved = qs - qs[0]
        assert np.all(moved.max(axis=0) <= b.forward + 1e-5) and np.all(-moved.min(axis=0) <= b.back + 1e-5)
        assert np.all(rests <= b.time + 1e-3)
    assert late >= 3  # or nothing was asked


def test_recorded_stops_that_a_data_sheet_does_not_hold_widen_it() -> None:
    """Too few of them to identify brakes from, and later than the data sheet says: no bound is told that they leave."""
    model = arm()
    late = recorded_stop0(model, 4, 11, lambda rng: np.full(6, rng.uniform(0.15, 0.16)))
    fit = identify_stops(model, [*late, *recorded_stop1(16, 5)])
    assert fit.stop0 is None
    before = replace(
        fit.model, brakes=model.brakes, sets={**fit.model.sets, "stop0": replace(fit.model.powered, X0=fit.noise, V=fit.noise)}
    )
    assert judge_stop0(before, late).outside  # the test has teeth
    assert not judge_stop0(with_stops(model, fit), late).outside


@pytest.mark.parametrize("count", [1, 3])
def test_fewer_stops_than_tell_anything_widen_a_data_sheet_that_does_not_hold_them(count: int) -> None:
    """Neither brakes nor the readings' noise can be identified from one stop or three; what they leave is not published all the same."""
    model = arm()
    late = recorded_stop0(model, count, 11, lambda rng: np.full(6, rng.uniform(0.15, 0.16)))
    fit = identify_stops(model, late)
    assert fit.stop0 is None and judge_stop0(model, late).outside  # the test has teeth
    known = with_stops(model, fit)
    assert not judge_stop0(known, late).outside
    assert any("were held against the data sheet's brakes: some left its bound" in x for x in known.notes)
    # stops that it holds change nothing
    usual_ones = recorded_stop0(model, count, 13)
    fit = identify_stops(model, usual_ones)
    assert fit.model is model
    assert any("none left its bound" in x for x in fit.notes)


def test_controlled_stops_alone_say_nothing_of_drives_whose_power_goes() -> None:
    """Nor are readings of an arm at rest all that a moving one's err by: without a power-off stop its sets stay the powered arm's."""
    model = arm()
    known = with_stops(model, identify_stops(model, recorded_stop1(16, 5)))
    assert ramp_of(known) is not None and set(known.sets) == set(model.sets)
    before, after = (setting_of(m) for m in (model, known))
    assert before is not None and after is not None and np.array_equal(before.start.radius, after.start.radius)
    assert "the drives give nothing more once power is taken" in after.assumptions


def test_a_held_out_stop_that_refutes_its_bound_is_inside_what_is_published() -> None:
    """The guarantee tells that it left; a bound that the user's own recordings refute is not told."""
    model = arm()
    stops = recorded_stop0(model, 24, 4)
    stops[5] = recorded_stop0(model, 24, 4, lambda rng: usual(rng) + np.r_[np.zeros(1), 0.06, np.zeros(4)])[5]
    fit = identify_stops(model, stops)
    assert fit.stop0 is not None and fit.stop0.violated == 1 and "of all 24 stops" in fit.stop0.text
    assert not judge_stop0(with_stops(model, fit), stops).outside
    ramps = recorded_stop1(24, 5)
    k = ramps[5].stop_requested
    ramps[5].q[k:] += 0.05 * (1.0 - np.exp(-10.0 * (ramps[5].t[k:] - ramps[5].t[k])))[:, None]
    fit = identify_stops(model, ramps)
    assert fit.stop1 is not None and fit.stop1.violated == 1 and fit.ramp is not None and fit.noise is not None
    assert not judge_stop1(fit.ramp, fit.noise, ramps).outside


def test_what_an_effect_pushes_with_is_no_brake() -> None:
    """An arm that a constant torque pushes, and a spring: what its brakes took is read off as of an arm that nothing pushes."""
    model, push, k = prbt_like((0.0, 0.0)), 30.0, 25.0
    robot, torque, zero = model.robot, model.brakes.torque.centre, np.zeros(6)
    F, D = np.array([15.0, 15, 10, 8, 3, 2]), np.array([5.0, 5, 3, 3, 1, 1])
    spring = Fitted("spring", model.joints[1], {"k": k, "c": push}, {"k": 0.0, "c": 0.0})
    setting = setting_of(replace(model, effects=(*model.effects, spring)))
    assert setting is not None
    q, dq, fine = np.array([0.3, -0.4, 0.5, 0.2, 0.6, 0.0]), np.array([0.6, 0.9, -0.7, 0.6, 0.8, 0.5]), 8
    # the stop is short: the spring turns with the joint's own angle by a hundredth of its torque
    u = np.array([[0.0, -push - k * (q[1] + 0.5 * 0.06 * dq[1]), 0.0, 0.0, 0.0, 0.0]])
    qs, vs = simulate_stop(
        StoppingArm(robot.chain, robot.pi, model.rotor, F, D, torque, zero + 0.04, zero + RISE), q, dq, PERIOD / fine, 40 * fine, u,
    )  # fmt: skip
    t = np.arange(len(qs[::fine])) * PERIOD
    r = Recording("stop0", 0, 0, 0, t, qs[::fine], vs[::fine], np.zeros((len(t), 6)), stop_trigger=t >= 0.0)
    seen = impulses(setting, r, zero + 1e-3)[1]
    assert seen is not None and seen.t[-1] > 0.045
    given = torque[1] * np.array([0.5 * min(max(x - 0.04, 0.0), RISE) ** 2 / RISE + max(x - 0.04 - RISE, 0.0) for x in seen.t])
    # the push alone would be 30 N m for 50 ms
    assert np.abs(seen.taken - given).max() < 0.1 * push * 0.05


@pytest.mark.parametrize("lag", [np.zeros(6), np.array([0.0, 0.0, 0.025, 0.0, 0.003, 0.0])])
def test_windows_hold_every_stop_true_to_the_words_and_few_others(lag: np.ndarray) -> None:
    """ "Delays of a stop that, less each its own lag, lie apart by no more than 6 ms: every such stop is in a window, wherever the
    joints' intervals lie."""
    setting = setting_of(prbt_like((0.0, 0.0)))
    assert setting is not None
    rng, delay_spread = np.random.default_rng(2), 0.006
    for _ in range(20):
        lo = 0.02 + rng.uniform(0.0, 0.03, 6) + lag
        plant = setting.plant._replace(delay_lo=lo, delay_hi=lo + rng.uniform(0.02, 0.06, 6))
        parts = windows(plant, delay_spread, lag)

        def held(delay: np.ndarray, parts: list = parts) -> bool:  # type: ignore[type-arg]
            return any(np.all((p.delay_lo <= delay + 1e-12) & (delay <= p.delay_hi + 1e-12)) for p in parts)

        true = (
            rng.uniform(0.0, 0.12, (20_000, 1))
            + delay_spread * rng.uniform(0.0, 1.0, (20_000, 6)).round(rng.integers(0, 3))
            + lag
        )
        true = true[np.all((true >= plant.delay_lo) & (true <= plant.delay_hi), axis=1)]
        assert all(held(d) for d in true)
        assert len(true) > 0 or len(parts) == 1
        # and one late brake among five early ones is in none, nor anything outside the joints' own intervals
        far = np.where(np.arange(6) == 2, plant.delay_hi, plant.delay_lo)
        assert np.ptp(far - lag) < 3 * delay_spread or not held(far)
        assert all(np.all(p.delay_lo >= plant.delay_lo) and np.all(p.delay_hi <= plant.delay_hi) for p in parts)
    alike = plant._replace(delay_lo=0.02 + lag, delay_hi=0.07 + lag)
    assert len(windows(alike, delay_spread, lag)) > 3 and len(windows(alike, delay_spread, lag, 2)) == 2
    assert windows(alike, None) == [alike] and windows(alike, 0.06, lag) == [alike]


def test_brakes_cut_together_are_bounded_where_independent_ones_are_not() -> None:
    model = prbt_like((0.0, 0.0))
    n, b = 6, model.brakes
    late = replace(b, delay=Box.of(np.full(n, 0.02), np.full(n, 0.09)))
    q, dq = np.array([0.3, 0.9, -0.8, 0.4, 0.7, 0.1]), np.array([1.2, -1.1, 1.2, -1.2, 1.1, 1.2])
    alone = StopBounds.of(replace(model, brakes=late), pieces=2).bound(q, dq)
    together = StopBounds.of(replace(model, brakes=replace(late, delay_spread=0.004)), pieces=2).bound(q, dq)
    assert together.certified
    assert not alone.certified or together.angle.max() < alone.angle.max()
    assert any("apart" in a for a in together.assumptions)


def test_the_margins_keep_their_risk_however_few_the_values() -> None:
    rng = np.random.default_rng(1)
    for count in (3, 4, 7, 12, 30):
        x = rng.uniform(size=(400_000, count + 1))
        lo, hi = x[:, :-1].min(axis=1), x[:, :-1].max(axis=1)
        more, new = beyond(count) * (hi - lo), x[:, -1]
        assert np.mean((new < lo - more) | (new > hi + more)) == pytest.approx(RISK, rel=0.1)
        assert np.mean(x[:, -1] > farther(count) * hi) == pytest.approx(RISK, rel=0.1)
    assert beyond(4) > beyond(12) > 0 and farther(4) > farther(12) > 1


def test_what_was_varied_around_the_regular_takes_fewer_stops_to_judge() -> None:
    rng, left, alone = np.random.default_rng(2), 0, 0.0
    for _ in range(4000):
        middle, half = rng.uniform(0.05, 0.5), rng.uniform(0.01, 0.04)
        regular = list(middle + rng.uniform(-0.1 * half, 0.1 * half, 12))
        varied = middle + rng.uniform(-half, half, 5)
        lo, hi = hull({0: (regular, 12), 1: (list(varied[:4]), 4)}, (0.0, np.inf))
        left += not lo <= varied[4] <= hi
        alone += np.diff(band(varied[:4]))[0] / (hi - lo)
    # the regular stops' middle is not exactly that of the variation, which costs a little
    assert left / 4000 < 1.5 * RISK and alone / 4000 > 1.3
    # a few stops say little: what they say is cut where no brake or ramp is taken to go
    wild = {0: ([0.06] * 9, 9), 1: ([0.02, 0.10], 2)}
    assert hull(wild) == pytest.approx((0.0, 0.15))


def test_a_joint_at_rest_before_its_brake_tells_no_delay() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(20) * PERIOD
    noise, torque, delay, rise = 5e-3, 60.0, 0.030, 0.014

    def curve(until: int) -> Impulse:
        x = np.maximum(t - delay, 0.0)
        taken = 0.4 * t + torque * np.where(x < rise, 0.5 * x * x / rise, x - 0.5 * rise) + rng.normal(0.0, noise, len(t))
        return Impulse(t[:until], taken[:until] - taken[0], noise, 1.0, 10.0)

    seen, early = brake_estimate(curve(20), 70.0, 1.0), brake_estimate(curve(7), 70.0, 1.0)
    assert abs(seen.delay - delay) < 4e-3 and seen.torque == pytest.approx(torque, rel=0.15)
    assert np.isnan(early.delay) and np.isnan(early.torque)


def test_a_ramp_slows_a_motion_that_was_itself_changing_its_speed() -> None:
    v0, pace, lasts = np.array([1.0, -0.6]), -2.0, 0.35
    ramp = Ramp("time", Box.point(np.full(2, lasts)), Box.point(np.zeros(2)), np.full(2, 1e-6), np.full(2, 1e-6))
    t = np.arange(140) * PERIOD
    s = np.clip(t / lasts, 0.0, 1.0)
    path_time = lasts * (s - 0.5 * s * s)
    q, v = v0 * (path_time + 0.5 * pace * path_time**2)[:, None], v0 * ((1.0 - s) * (1.0 + pace * path_time))[:, None]
    before = np.arange(-30, 0) * PERIOD
    q = np.vstack([v0 * (before + 0.5 * pace * before**2)[:, None], q])
    v = np.vstack([v0 * (1.0 + pace * before)[:, None], v])
    r = Recording("stop1", 0, 0, 0, np.arange(len(q)) * PERIOD, q, v, np.zeros_like(q), stop_trigger=np.arange(len(q)) >= 30)
    noise = Box.symmetric(np.array([1e-6, 1e-6, 1e-5, 1e-5]))
    steady = judge_stop1(ramp, noise, [r])
    assert steady.uncovered == (r.label,) and steady.certified == 0
    wide = judge_stop1(replace(ramp, pace=(-2.1, 2.1)), noise, [r])
    assert wide.certified == 1 and not wide.outside and not wide.uncovered
    # and the pace is what encloses it: a ramp that only claims to apply is left
    assert judge_stop1(replace(ramp, pace=(-2.1, 2.1), value=Box.point(np.full(2, 0.2))), noise, [r]).outside


def test_without_brake_data_there_is_one_sentence_and_no_number() -> None:
    model = arm()
    drives = tuple(replace(d, brake_torque=np.nan) for d in model.robot.drives)
    bare = replace(model, brakes=None, robot=replace(model.robot, drives=drives))
    bound_ = StopBounds.of(bare).bound(np.zeros(6), np.full(6, 0.5))
    assert (
        not bound_.certified
        and bound_.time is None
        and bound_.forward is None
        and "brake" in bound_.why
        and "\n" not in bound_.why
    )
    # stops so slow that every joint rests before its brake closes tell no torque either
    slow = [replace(r, dq=0.02 * r.dq) for r in recorded_stop0(model, 12, 7)]
    fit = identify_stops(bare, slow)
    assert fit.model.brakes is None and fit.stop0 is None and fit.notes


def _saved(model: Model, folder: Path) -> Path:
    path = folder / "m.model.json"
    save_model(model, path)
    return path


def test_few_stops_identify_nothing_and_say_so() -> None:
    fit = identify_stops(arm(), recorded_stop0(arm(), 3, 1))
    assert fit.stop0 is None and any("too few" in n for n in fit.notes)


def test_a_stop_without_trigger_is_refused() -> None:
    r = replace(recorded_stop0(arm(), 1, 1)[0], stop_trigger=None)
    with pytest.raises(RecordingError, match="stop_trigger"):
        identify_stops(arm(), [r])


@pytest.mark.shared
@pytest.mark.parametrize("name", ["d04", "p10"])
def test_simulated_cells_of_the_shared_data(name: str) -> None:
    if not SHARED.is_dir():
        pytest.skip("../shared/data is not here")
    from stopset.offline.identify.pipeline import identify

    data = SHARED / name / "recording.parquet"
    robot = load_robot(SHARED / name / "robot.urdf")
    model = identify(robot, [data]).model
    truth = json.loads((SHARED / "labels.json").read_text())[name]["truth"]
    torque = np.array([truth[j]["brake"] for j in robot.joints])
    b, ramp, setting = model.brakes, ramp_of(model), setting_of(model)
    assert b is not None and np.all((b.torque.lo <= torque) & (torque <= b.torque.hi))
    assert sum("held-out stops have a certified bound" in n for n in model.notes) == 2
    stops = list(read_recordings([data], robot))
    power_off = judge_stop0(model, divide([r for r in stops if r.phase == "stop0"])[1])
    assert power_off.certified >= 6 and not power_off.outside
    assert ramp is not None and setting is not None
    controlled = judge_stop1(ramp, setting.noise, divide([r for r in stops if r.phase == "stop1"])[1])
    assert controlled.certified >= 6 and not controlled.outside
