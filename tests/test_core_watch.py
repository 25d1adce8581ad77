"""The core's part of the monitor's cycle against the same written plainly: input, unknown states, predictions, message."""

from __future__ import annotations

import math
import zlib
from dataclasses import replace

import numpy as np
import pytest

from float32 import outward
from stopset.artifact.inputs import InputMap, effect_torques, law_signals, memories_along
from stopset.artifact.taped import SIGNALS, Pinned
from stopset.core.library import ffi, lib, view
from stopset.effects import Fitted
from stopset.effects.memory import coefficients, stepped
from stopset.effects.registry import catalogue, get
from stopset.effects.signals import Samples
from stopset.errors import EffectError
from stopset.offline.description import load_robot
from stopset.ring import Tape
from stopset.robot.rigid import gravity_torques, torques
from stopset.sets import Box
from stopset.types import Array

ARM = load_robot("lwa4p")
N = 37
RNG = np.random.default_rng(0)
Q, DQ, TAU = RNG.normal(size=(3, N, ARM.n))
TEMP, T = 20.0 + 20.0 * RNG.random((N, ARM.n)), np.arange(N) * 0.01


def plainly(m: InputMap, q: Array, dq: Array, tau: Array, temp: Array, warm: float, t: Array) -> Array:
    """Eq. (11) with numpy, effect by effect."""
    u = tau / m.gain - m.offset
    if m.effort != "compensated_torque":
        c, pi = m.robot.chain, m.robot.pi
        u = u - (torques(c, pi, q, dq, np.zeros_like(q)) if m.swift else gravity_torques(c, pi, q))
    memories = memories_along(m.robot, m.effects, Samples(q, dq, None, temp, warm, t))
    moving = u - effect_torques(m.robot, m.effects, Samples(q, dq, None, temp, warm, t), memories=memories)
    if m.effort == "compensated_torque":
        return moving
    ahead, back = (
        effect_torques(
            m.robot, m.effects, Samples(q, np.zeros_like(dq), None, temp, warm), direction=direction, memories=memories
        )
        for direction in (1.0, -1.0)
    )
    held = np.clip(u, np.minimum(ahead, back), np.maximum(ahead, back))
    return np.where(np.abs(dq) <= m.standstill, u - held, moving)


def with_effect(name: str, effort: str, swift: bool = False) -> InputMap:
    e = catalogue()[name]
    values = {x.symbol: RNG.uniform(max(x.lo, -2.0), min(x.hi, 2.0)) for x in e.terms} | {x.symbol: x.grid[0] for x in e.shapes}
    at = [None] if e.scope == "arm" else ["+".join(ARM.joints[1:3])] if e.scope == "pair" else ARM.joints[:4:2]
    return InputMap(
        ARM,
        tuple(Fitted(name, j, values) for j in at),
        effort,
        np.full(ARM.n, 1.1),
        RNG.normal(size=ARM.n),
        np.full(ARM.n, 0.3),
        swift,
    )


@pytest.mark.parametrize(("effort", "swift"), [("motor_torque", False), ("motor_torque", True), ("compensated_torque", False)])
@pytest.mark.parametrize("name", catalogue())
def test_the_input_is_that_of_the_laws(name: str, effort: str, swift: bool) -> None:
    """Rows beyond one block of the core, and joints at rest among them."""
    m = with_effect(name, effort, swift)
    got, want = m(Q, DQ, TAU, TEMP, 0.3, T), plainly(m, Q, DQ, TAU, TEMP, 0.3, T)
    if "dtau" in get(name).needs:  # at rest no torque changes, whatever the recording did before and after
        got, want = (np.where(np.abs(DQ) <= m.standstill, 0.0, x) for x in (got, want))
    assert np.abs(got - want).max() < 1e-12 * max(1.0, np.abs(want).max())


def test_rows_by_themselves_are_the_rows_together() -> None:
    m = with_effect("load_coulomb", "motor_torque")
    assert np.array_equal(m(Q, DQ, TAU), np.vstack([m(Q[k : k + 1], DQ[k : k + 1], TAU[k : k + 1]) for k in range(N)]))


def test_every_step_of_a_tape_does_what_it_says() -> None:
    tape = Tape()
    x, y = tape.signal(SIGNALS.index("q")), tape.signal(SIGNALS.index("dq"))
    signals = np.zeros((lib.STOPSET_SIGNALS, 40))
    a, b = signals[0], signals[1]
    a[:], b[:] = RNG.normal(size=(2, 40))
    a[:4], b[:4] = [math.nan, 1.0, 0.0, -0.0], [1.0, math.nan, 0.0, 2.0]
    for number, want in (
        (x + y, a + b), (x - 2.0, a - 2.0), (2.0 - x, 2.0 - a), (x * y, a * b), (x / y, a / np.where(b == 0.0, np.nan, b)),
        (1.0 / y, 1.0 / np.where(b == 0.0, np.nan, b)), (-x, -a), (x**3, a * a * a), (x**0, np.ones(40)), (x.absolute(), np.abs(a)),
        (x.sign(), np.sign(a)), (x.square(), a * a), (x.absolute().sqrt(), np.sqrt(np.abs(a))), (x.minimum(y), np.minimum(a, b)),
        (x.maximum(0.5), np.maximum(a, 0.5)),
    ):  # fmt: skip
        steps, numbers = replace(tape, steps=list(tape.steps), numbers=list(tape.numbers), _place=dict(tape._place)).finished(
            replace(number, tape=tape)
        )
        law = ffi.new("StopsetProgram *", (len(steps), ffi.cast("int32_t *", ffi.from_buffer(steps)), view(numbers)))
        out = np.empty(40)
        lib.stopset_law(law, 40, view(signals), view(out))
        fine = ~np.isnan(want) | np.isnan(a) | np.isnan(b)
        assert np.array_equal(out[fine], want[fine], equal_nan=True), (steps[-1], out, want)
        alone = np.empty(1)
        for k in range(8):  # one sample by itself has the same bits
            lib.stopset_law(law, 1, view(signals[:, k].copy()), view(alone))
            assert np.array_equal(alone[0], out[k], equal_nan=True)
    for name in ("sin", "cos", "exp", "tanh"):
        number = getattr(x, name)()
        steps, numbers = tape.finished(number)
        law = ffi.new("StopsetProgram *", (len(steps), ffi.cast("int32_t *", ffi.from_buffer(steps)), view(numbers)))
        lib.stopset_law(law, 40, view(signals), view(out))
        assert np.allclose(out, getattr(np, name)(a), rtol=1e-15, equal_nan=True)


def test_a_step_is_written_once_and_a_long_law_is_refused() -> None:
    tape = Tape()
    x = tape.signal(0)
    assert (x * x).at == (x * x).at and (x + 1.0).at == (x + 1.0).at
    with pytest.raises(ValueError, match="256 elementary steps"):
        for k in range(300):
            x = x * x + float(k)
    with pytest.raises(ValueError, match="not a number"):
        Tape().constant(math.nan)


def test_a_law_that_is_no_sum_of_steps_is_refused_with_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    m = with_effect("viscous", "motor_torque")
    broken = replace(get("viscous"), law=lambda s, shape: (s.dq if s.dq > 0 else 0.0,))
    monkeypatch.setattr("stopset.artifact.taped.get", lambda name: broken)
    with pytest.raises(EffectError, match="taken apart into elementary steps"):
        m(Q, DQ, TAU)


def test_a_states_interval_goes_on_as_its_flow_says() -> None:
    """The core's step of one state's two ends against `stopset.effects.memory`."""
    from monitor_arm import DT, known_model
    from stopset.monitor.inputs import Inputs
    from stopset.monitor.sample import Quantum

    model = known_model()
    f = Fitted("hysteresis", model.joints[0], {"F_h": 12.0, "delta": 0.02}, {})
    model = replace(model, effects=(f,))
    inputs = Inputs.of(model, Quantum.none(model.n), (0.0, 0.0))
    z = inputs.carried.ends.copy()[0]
    for k in range(20):
        q, dq = Q[k, : model.n], DQ[k, : model.n] * (k != 7)  # at rest it stays as it is
        b, a = coefficients(
            get("hysteresis"), law_signals(model.robot, [(f, get("hysteresis"))], Samples(q[None], dq[None]))[0], f.values
        )
        _, du = inputs(q, dq, TAU[k, : model.n], None)
        assert du[0] == pytest.approx(0.5 * 12.0 * (z[1] - z[0]), rel=1e-12, abs=1e-15) and not du[1:].any()
        z = np.array([stepped(z, b, a, DT).min(), stepped(z, b, a, DT).max()])
        assert np.allclose(inputs.carried.ends[0], z, rtol=1e-13, atol=1e-15)


def test_checksums_and_rounding() -> None:
    for data in (b"", b"\0", b"123456789", bytes(range(256)) * 3):
        here = ffi.from_buffer("uint8_t[]", data)
        assert lib.stopset_crc32(len(data), here) == zlib.crc32(data)
    assert lib.stopset_crc32c(9, ffi.from_buffer("uint8_t[]", b"123456789")) == 0xE3069283
    x = np.array([0.1, -0.1, 1e-60, -1e-60, 1e300, -1e300, math.inf, -math.inf, 0.0, -0.0, 0.5, math.nan, 1.4e-45, 3.0e38])
    for side in (1, -1):
        bits = np.empty(len(x), np.uint32)
        lib.stopset_outward(
            len(x), view(x), ffi.from_buffer("int8_t[]", np.full(len(x), side, np.int8)), ffi.from_buffer("uint32_t[]", bits)
        )
        assert np.array_equal(bits.view(np.float32).astype(float), [outward(v, "up" if side > 0 else "down") for v in x])


def test_the_nearest_float_and_what_is_no_number() -> None:
    x = np.array([0.1, -0.1, 1e-60, 1e300, -math.inf, math.nan, 0.5])
    bits = np.empty(len(x), np.uint32)
    lib.stopset_outward(
        len(x), view(x), ffi.from_buffer("int8_t[]", np.zeros(len(x), np.int8)), ffi.from_buffer("uint32_t[]", bits)
    )
    with np.errstate(over="ignore"):
        assert np.array_equal(bits.view(np.float32), x.astype(np.float32), equal_nan=True)


def test_a_law_of_no_steps_gives_nothing_and_a_speed_that_is_none_stays_visible() -> None:
    out = np.ones(3)
    empty = ffi.new("StopsetProgram *", (0, ffi.NULL, ffi.NULL))
    lib.stopset_law(empty, 3, view(np.zeros(3 * lib.STOPSET_SIGNALS)), view(out))
    assert not out.any()
    dq = DQ.copy()
    dq[5, 2] = math.nan
    u = with_effect("coulomb", "motor_torque")(Q, dq, TAU)
    assert np.isnan(u[5, 2]) and np.isfinite(np.delete(u, 5, axis=0)).all()


def test_what_counts_bounds_passed_and_finds_a_certificate() -> None:
    """Against numpy, edges and numbers that are none among them."""
    for _ in range(200):
        n, count = int(RNG.integers(1, 9)), int(RNG.integers(0, 6))
        lo, hi = -RNG.random((count, n)).round(1), RNG.random((count, n)).round(1)
        cost, slack = RNG.integers(0, 4, count).astype(float), (0.2 * RNG.random(n)).round(1)
        x = RNG.normal(scale=0.3, size=n).round(1)
        x[RNG.random(n) < 0.05] = RNG.choice([math.nan, math.inf, -math.inf])
        holds = np.flatnonzero(np.all((x - slack >= lo) & (x + slack <= hi), axis=1)) if count else np.zeros(0, int)
        want = min(holds.tolist(), key=lambda k: (cost[k], k), default=-1)
        assert lib.stopset_tightest(count, n, *map(view, (lo.ravel(), hi.ravel(), cost, x, slack))) == want
        assert lib.stopset_sound(n, view(x), 0.5) == bool(np.all(np.abs(x) <= 0.5))
        if count:
            beyond = np.count_nonzero((x < lo[0] - slack) | (x > hi[0] + slack))
            assert lib.stopset_beyond(n, *map(view, (x, lo[0].copy(), hi[0].copy(), slack))) == beyond


@pytest.mark.parametrize("loaded", [False, True])
def test_rounding_and_what_is_remembered_bound_every_sample_they_may_stand_for(loaded: bool) -> None:
    """Rounded positions, speeds and torques, an unknown state and friction that falls with temperature: the input of any true sample
    is within ``u +- du``."""
    from monitor_arm import known_model
    from stopset.monitor.inputs import Inputs
    from stopset.monitor.sample import Quantum

    model = known_model()
    n = model.n
    effects = (
        Fitted("hysteresis", model.joints[0], {"F_h": 12.0, "delta": 0.02}, {}),
        Fitted("thermal_coulomb", model.joints[1], {"k_C": -0.2}, {}),
        Fitted("spring", model.joints[2], {"k": 30.0, "c": 1.0}, {}),
        *((Fitted("load_coulomb", model.joints[1], {"k_lift": 0.1, "k_lower": 0.05}, {}),) if loaded else ()),
    )
    model = replace(model, effects=effects)
    fine = Quantum(np.full(n, 1e-3), np.full(n, 2e-3), np.full(n, 0.1))
    speeds_alone = replace(fine, q=np.zeros(n))
    for quantum, temp in ((fine, TEMP[:, :n]), (fine, None), (Quantum.none(n), TEMP[:, :n]), (speeds_alone, None)):
        inputs = Inputs.of(model, quantum, (0.0, 0.0))
        for k in range(10):
            q, dq, tau, heat = Q[k, :n], DQ[k, :n], TAU[k, :n], None if temp is None else temp[k]
            z = inputs.carried.ends.copy()[0]
            u, du = inputs(q, dq, tau, heat)
            for _ in range(20):
                off = RNG.uniform(-1.0, 1.0, (3, n))
                true = q + off[0] * quantum.q, dq + off[1] * quantum.dq, tau + off[2] * quantum.tau
                state = {0: (np.array([RNG.uniform(*z)]),)}
                got = model.input(*(x[None] for x in true), None if heat is None else heat[None], memories=state)[0]
                assert np.all(np.abs(got - u) <= du + 1e-9)


def plainly_compared(e: Array, w: Array, age: Array, A: Array, r: Array, dw: Array, lo: Array, hi: Array) -> tuple[Array, Array]:
    """Room (2n,) and the worst rows (2, 2n) after one step, every row by itself; ``e, w, age`` become those after it."""
    with np.errstate(all="ignore"):
        for x, a, b in ((e, A, r), (w, np.abs(A), dw)):
            was = x.copy()
            x[:] = b
            for j in range(len(b)):
                x += np.where(a[:, j] != 0.0, a[:, j] * was[:, j : j + 1], -0.0)
        age += age >= 0
        age[age >= len(lo)] = -1
        rows = np.flatnonzero(age >= 0)
        low, high = lo[age[rows]] - w[rows], hi[age[rows]] + w[rows]
        over, under, width = e[rows] - high, low - e[rows], high - low
        worst = np.full((2, len(r)), -1)
        for side, out, bound in ((0, over, high), (1, under, -low)):
            for i in range(len(r)):
                most = 0.0
                for k, row in enumerate(rows):
                    if not (out[k, i] <= 0.0 or bound[k, i] == np.inf) and not out[k, i] / width[k, i] <= most:
                        most, worst[side, i] = out[k, i] / width[k, i], row
        room = np.where((width > 0.0) & (width < np.inf), -2.0 * np.where(over > under, over, under) / width, np.inf)
        room = np.where(np.isnan(room), np.inf, room).min(axis=0, initial=np.inf)
    return np.where(room == np.inf, 1.0, room), worst


@pytest.mark.parametrize("seed", range(60))
def test_rows_passed_over_say_nothing_else(seed: int) -> None:
    """Only rows near a bound are looked at closely: what comes out has the bits of all rows looked at, sample after sample."""
    rng = np.random.default_rng(seed)
    n, rows, ages = int(rng.choice([1, 2, 5, 6, 7, 8])), int(rng.integers(1, 60)), int(rng.integers(2, 60))
    m = 2 * n
    A = rng.normal(scale=0.6, size=(m, m))
    if seed % 3:  # joints on their own
        A = np.where(np.kron(np.ones((2, 2)), np.eye(n)) != 0.0, A, 0.0)
    age, size = rng.integers(-1, ages, rows), 10.0 ** rng.integers(-6, 3, m)
    e, w = size * rng.normal(scale=0.5, size=(rows, m)), size * 0.1 * rng.random((rows, m))
    lo, hi = -size * (0.5 + rng.random((ages, m))), size * (0.5 + rng.random((ages, m)))
    lo[:, rng.random(m) < 0.1], hi[:, rng.random(m) < 0.1] = -np.inf, np.inf
    lo += (shift := size * rng.normal(size=m) * rng.choice([0.0, 1.0, 1e6]))
    hi += shift
    e += shift
    if seed % 4 == 0:
        e[rng.integers(rows), rng.integers(m)] = rng.choice([np.nan, np.inf, -np.inf])
    foreign, row, seen = np.zeros(rows, bool), np.zeros((2, m), np.int64), ffi.new("int64_t[2]")
    middle, reach, room, nearest = np.empty((ages, m)), np.empty((ages, m)), np.empty(m), np.full(m, -1)
    pinned = Pinned([])
    struct = ffi.new("StopsetPredictions *", (
        m, rows, ages, *map(pinned.shared, (e, w, age, foreign, A, np.zeros((m, n)), lo, hi, middle, reach, room, nearest, row)),
    ))  # fmt: skip
    lib.stopset_centre(struct)
    for _ in range(5):
        x, none = size * 0.05 * rng.normal(size=m), np.zeros(n)
        plain = e.copy(), w.copy(), age.copy()
        want_room, want_row = plainly_compared(*plain, A, x, np.zeros(m), lo, hi)
        before = np.zeros(m)
        reading = ffi.new("StopsetReading *", (view(x), view(before), view(none), view(none)))
        live = lib.stopset_advance(struct, reading, 0, 1, seen)
        assert live == np.count_nonzero(plain[2] >= 0)
        for got, want in zip((e, w, age), plain, strict=True):
            assert np.array_equal(got[plain[2] >= 0], want[plain[2] >= 0], equal_nan=True)
        assert np.array_equal(row, want_row) and np.array_equal(room, want_room)


def test_an_arm_of_no_or_too_many_joints_is_refused() -> None:
    from monitor_arm import known_model
    from stopset.monitor.inputs import Inputs
    from stopset.monitor.sample import Quantum

    model = known_model()
    model = replace(model, effects=(Fitted("spring", model.joints[2], {"k": 30.0, "c": 1.0}, {}),))
    x, none = view(np.zeros(64)), ffi.NULL
    sample = ffi.new("StopsetSamples *", (x, x, x, none))
    inputs = Inputs.of(model, Quantum.none(model.n), (0.0, 0.0))
    for n in (0, 33):
        inputs.struct.map.arm.n = n
        assert lib.stopset_sample_input(inputs.struct, sample, x, x, x) == lib.STOPSET_TOO_MANY_JOINTS
        samples = ffi.new("StopsetSamples *")
        assert lib.stopset_inputs(inputs.struct.map, 1, samples, x) == lib.STOPSET_TOO_MANY_JOINTS
        predictions = ffi.new("StopsetPredictions *", {"states": 2 * n})
        assert lib.stopset_advance(predictions, ffi.new("StopsetReading *", (x, x, x, x)), 0, 0, ffi.new("int64_t[2]")) == -1
    inputs.struct.map.arm.n = model.n
    inputs.struct.states = 65
    assert lib.stopset_sample_input(inputs.struct, sample, x, x, x) == lib.STOPSET_TOO_MANY_JOINTS


def watched(effort: str = "compensated_torque", windows: str = "sliding", hot: bool = False):  # type: ignore[no-untyped-def]
    """A check of the known arm with its struct, and samples of a motion inside it."""
    from monitor_arm import known_model, motion
    from stopset.monitor.watch import Watch

    model = known_model(windows=windows)
    if hot:
        temp = Box.of(np.full(model.n, 20.0), np.full(model.n, 40.0))
        model = replace(model, domain=replace(model.domain, temp=temp))
    watch, r = Watch(replace(model, effort=effort)), motion(1, 60)
    return watch, watch._struct, r


def taken(watch, row: Array, temp: Array | None = None) -> int:  # type: ignore[no-untyped-def]
    watch._here[:3] = row
    if temp is not None:
        watch._here[3] = temp
    return int(lib.stopset_next(watch._struct, temp is not None))


def test_readings_that_cannot_be_are_no_samples() -> None:
    """Not a number, beyond any robot, all zero: a code, and nothing of the check has moved on. So for temperatures, where there are some."""
    watch, s, r = watched()
    rows = np.stack([r.q, r.dq, r.tau], axis=1)
    assert taken(watch, rows[0]) == taken(watch, rows[1]) == lib.STOPSET_OK and s.known and s.live == 1
    untouched = watch._x.copy()
    for place, bad in (((0, 0), math.nan), ((1, 5), math.inf), ((2, 3), -math.inf), ((2, 3), 1e300)):
        row = rows[2].copy()
        row[place] = bad
        assert taken(watch, row) == lib.STOPSET_NOT_A_NUMBER
    assert taken(watch, 0.0 * rows[2]) == lib.STOPSET_ALL_ZERO
    assert taken(watch, rows[2], np.full(6, math.nan)) == lib.STOPSET_NOT_A_NUMBER
    assert np.array_equal(watch._x, untouched) and taken(watch, rows[2], np.full(6, 25.0)) == lib.STOPSET_OK
    for n in (0, 33):
        s.monitor.map.arm.n = n
        assert lib.stopset_readable(s, 0) == lib.stopset_look(s, 0) == lib.STOPSET_TOO_MANY_JOINTS


@pytest.mark.parametrize("hot", [False, True])
def test_a_temperature_is_looked_at_where_the_domain_has_one(hot: bool) -> None:
    watch, s, r = watched(hot=hot)
    row = np.stack([r.q[0], r.dq[0], r.tau[0]])
    for temp, beyond in ((None, 0), (np.full(6, 30.0), 0), (np.array([30.0, 50, 30, 30, 10, 30]), 2 if hot else 0)):
        assert taken(watch, row, temp) == lib.STOPSET_OK and s.outside == beyond


def test_from_the_start_alone_one_prediction_starts() -> None:
    """Of the windows of the paper: the first sample's, as long as the tube; sliding ones start every sample."""
    live = {}
    for windows in ("start", "sliding"):
        watch, s, r = watched(windows=windows)
        live[windows] = []
        for k in range(20):
            assert taken(watch, np.stack([r.q[k], r.dq[k], r.tau[k]])) == lib.STOPSET_OK
            live[windows].append(s.live)
    assert live["start"] == [0, *[1] * 19] and live["sliding"] == list(range(20))


def test_an_arm_that_leaves_its_model_is_refuted_and_predicts_nothing() -> None:
    watch, s, r = watched()
    for k in range(10):
        taken(watch, np.stack([r.q[k], r.dq[k], r.tau[k]]))
    before = s.place
    assert not s.seen[1] and taken(watch, np.stack([r.q[10] + 0.1, r.dq[10], r.tau[10]])) == lib.STOPSET_OK
    assert s.seen[1] >= 6 and s.place == before and s.seen[0] == 10


def test_predictions_start_as_often_as_they_are_asked_to() -> None:
    watch, s, r = watched()
    s.every, live = 4, []
    for k in range(13):
        assert taken(watch, np.stack([r.q[k], r.dq[k], r.tau[k]])) == lib.STOPSET_OK
        live.append(s.live)
    assert live == [0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3]


def test_widening_by_what_is_known_exactly_changes_nothing() -> None:
    """A plain input without rounding: the tube is the same whether or not it is widened from step to step."""
    rooms = []
    for widen in (0, 1):
        watch, s, r = watched()
        s.widen = widen
        for k in range(20):
            taken(watch, np.stack([r.q[k], r.dq[k], r.tau[k]]))
        rooms.append(watch.tubes.room.copy())
    assert np.array_equal(*rooms)


def test_what_is_not_known_of_a_state_widens_the_tube() -> None:
    """A joint with presliding friction whose state is unknown at first has more room than one whose state has come to be known."""
    from monitor_arm import known_model, motion
    from stopset.monitor.watch import Watch

    model, r = known_model(), motion(1, 60)
    rigid = Watch(replace(model, effort="motor_torque"))
    assert taken(rigid, np.stack([r.q[0], r.dq[0], r.tau[0]])) == lib.STOPSET_OK and not rigid._du.any(), "nothing is remembered"
    held = Fitted("hysteresis", model.joints[0], {"F_h": 0.05, "delta": 0.02}, {})
    watch = Watch(replace(model, effort="motor_torque", effects=(held,)))
    du = []
    for k in range(40):
        row = np.stack([r.q[k], r.dq[k], r.tau[k] + gravity_torques(model.robot.chain, model.robot.pi, r.q[k : k + 1])[0]])
        assert taken(watch, row) == lib.STOPSET_OK
        du.append(watch._du[0, 0])
    assert not watch._struct.monitor.plain and du[0] == pytest.approx(0.05) and du[-1] < du[0] and not watch._du[0, 1:].any()
