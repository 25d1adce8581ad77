"""Path-preserving STOP 1: on the path, within torque, shorter than any gentler stop; refused where it cannot be."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path as File

import numpy as np
import pytest

import stopset.reach.stops.path
from stopset.artifact import Model
from stopset.core.library import lib
from stopset.effects.base import Fitted
from stopset.errors import NotCovered
from stopset.reach.stops import Ramp, StopBounds
from stopset.reach.stops.start import Extrapolation
from stopset.robot.rigid import torque
from stopset.sets import Box

sys.path.insert(0, str(File(__file__).resolve().parents[1] / "benchmarks"))
from independent_stops import carrying, gravity_load, shipped_arm
from stop_arms import prbt_like

from stopset.reach.stops.path import Path, path_stop

MODEL = prbt_like((0.0, 0.5))
RAMP = Ramp.stated(6, time=0.3, control=0.02)
BOUNDS = StopBounds.of(MODEL, ramp=RAMP)
POINTS = np.array(
    [
        [0.0, 0.3, 0.4, 0.0, 0.5, 0.0],
        [0.5, 0.6, 0.1, 0.2, 0.3, 0.2],
        [1.0, 0.5, -0.4, 0.5, 0.2, 0.6],
        [1.4, 0.2, -0.6, 0.7, 0.0, 1.0],
    ]
)


def test_stays_on_the_path_within_torque_and_uses_it() -> None:
    path = Path.through(POINTS)
    stop = path_stop(BOUNDS, path, 0.5, 1.5)
    assert stop.bound.certified and stop.room >= 0.0
    dense = path.p(np.linspace(0.5, 0.5 + stop.length, 4000), 0)
    assert all(np.abs(dense - q).max(axis=1).min() < 1e-3 for q in stop.q)
    travel = dense - dense[0]
    assert np.all(travel.max(axis=0) <= stop.bound.forward + 1e-9) and np.all(-travel.min(axis=0) <= stop.bound.back + 1e-9)
    # full braking leaves some drive with little torque: no shorter stop exists
    assert stop.room < 0.1 * MODEL.robot.torque_limit.max()
    slower = path_stop(BOUNDS, path, 0.5, 0.75)
    assert slower.length < stop.length and slower.time < stop.time


def controllable(path: Path, begin: float, length: float, rate: float) -> bool:
    """Whether toppra stops the arm of `MODEL` within ``length`` of the path from ``begin`` at ``rate``."""
    toppra = pytest.importorskip("toppra")
    toppra.setup_logging("CRITICAL")
    setting = BOUNDS.setting
    assert setting is not None and setting.torques.settled
    plant, robot = setting.plant, MODEL.robot
    top = np.abs(path.p(np.linspace(begin, begin + length, 400), 1)).max(axis=0) * rate
    extra = plant.coulomb_hi + plant.viscous_hi * top + np.maximum(np.abs(plant.u_lo), np.abs(plant.u_hi))
    room = 0.98 * robot.torque_limit - extra

    class Piece(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        dof, path_interval, waypoints = MODEL.n, np.array([0.0, length]), None

        def __call__(self, s: np.ndarray, order: int = 0) -> np.ndarray:
            rows = path.p(np.atleast_1d(np.asarray(s, float)) + begin, order)
            return rows[0] if np.ndim(s) == 0 else rows

    c = toppra.constraint
    constraints = [
        c.JointTorqueConstraint(
            lambda q, v, a, pi=pi: torque(robot.chain, pi, q, v, a) + plant.rotor * a, np.stack([-room, room], axis=1),
            np.zeros(MODEL.n), discretization_scheme=c.DiscretizationType.Interpolation,
        )
        for pi in (plant.pi - plant.pi_half, plant.pi + plant.pi_half)
    ]  # fmt: skip
    instance = toppra.algorithm.TOPPRA(
        constraints, Piece(), gridpoints=np.linspace(0.0, length, 121), solver_wrapper="seidel", parametrizer="ParametrizeConstAccel"
    )  # fmt: skip
    speeds = instance.compute_parameterization(rate, 0.0)[1]
    return speeds is not None and bool(np.all(np.isfinite(speeds)))


@pytest.mark.parametrize("seed", range(8))
def test_the_core_s_stop_is_the_shortest_that_toppra_finds(seed: int) -> None:
    """One percent more it finds, one percent less it does not."""
    rng = np.random.default_rng(seed)
    path, begin, rate = (
        Path.through(0.5 * rng.uniform(-0.8, 0.8, (5, 6)).cumsum(axis=0)),
        rng.uniform(0.0, 2.0),
        rng.uniform(0.3, 2.5),
    )
    stop = path_stop(BOUNDS, path, begin, rate)
    late = begin + 0.02 * rate
    length = stop.length - 0.02 * rate
    assert controllable(path, late, 1.01 * length, rate) and not controllable(path, late, 0.99 * length, rate)


def test_a_path_is_the_natural_spline_through_its_rows() -> None:
    from scipy.interpolate import CubicSpline

    rng = np.random.default_rng(0)
    for count in (3, 4, 40):
        points = rng.normal(size=(count, 6))
        path, want = Path.through(points), CubicSpline(np.arange(count), points, axis=0, bc_type="natural")
        s = np.linspace(0.0, count - 1.0, 300)
        assert all(np.abs(path.p(s, k) - want(s, k)).max() < 1e-11 for k in range(3))
    line = Path.through(points[:2])
    assert np.array_equal(line.p(np.array([0.5]), 0)[0], points[0] + 0.5 * (points[1] - points[0]))
    assert np.all(line.p(np.array([0.3]), 2) == 0.0)


def test_straight_line_matches_the_closed_form() -> None:
    """Joint 6 alone, torque limit tau: deceleration tau_free / M_66, length v^2 / 2a, within the bisection and the grid."""
    q = np.zeros(6)
    weak = replace(MODEL.robot, torque_limit=np.array([1e4, 1e4, 1e4, 1e4, 1e4, 8.0]))
    model = replace(MODEL, robot=weak)
    end = q.copy()
    end[5] = 1.0
    ramp = Ramp.stated(6, time=0.3, control=0.0)
    stop = path_stop(StopBounds.of(model, (0.0, 0.0), ramp=ramp), Path.through(np.array([q, end])), 0.0, 1.0)
    # the drive's torque less friction (2 N m and 1 N m s/rad, a quarter more), U and reserve does the braking
    free = 8.0 * 0.98 - 2.5 - 1.25 - 0.4
    inertia = (
        MODEL.rotor[5] + torque(weak.chain, weak.pi, q, 0 * q, np.eye(6)[5])[5] - torque(weak.chain, weak.pi, q, 0 * q, 0 * q)[5]
    )
    assert stop.length == pytest.approx(0.5 * inertia / free, rel=0.02)


@pytest.mark.parametrize(
    ("points", "s", "ds", "word"),
    [
        (POINTS, 2.968, 1.5, "too fast"),
        (POINTS, 0.5, 50.0, "too fast"),
        (POINTS + 3.0, 0.5, 1.0, "beyond its limits"),
        (POINTS, 7.0, 1.0, "expected 0 <= row"),
        (POINTS[:1], 0.0, 1.0, "at least two"),
    ],
)
def test_impossible_paths_are_refused(points: np.ndarray, s: float, ds: float, word: str) -> None:
    with pytest.raises(NotCovered, match=word):
        path_stop(BOUNDS, Path.through(points), s, ds)


IDENTICAL = np.tile(POINTS[:1], (4, 1))
DWELLING = np.vstack([POINTS[:2], POINTS[1:]])
BROKEN = np.where(np.arange(24).reshape(4, 6) == 9, np.nan, POINTS)


@pytest.mark.parametrize(
    ("points", "word"),
    [
        (IDENTICAL, "rows 0 and 1 of the path are the same"),
        (DWELLING, "rows 1 and 2 of the path are the same"),
        (BROKEN, "row 1 of the path has the angle nan"),
        (POINTS * 1e300, "expected finite ones"),
        (POINTS[0], "expected at least two rows"),
        (np.zeros((0, 6)), "a path of 0 rows"),
    ],
)
def test_a_path_that_is_none_is_refused(points: np.ndarray, word: str) -> None:
    with pytest.raises(NotCovered, match=word):
        Path.through(points)


@pytest.mark.parametrize(("s", "ds"), [(0.5, -1.0), (0.5, 0.0), (0.5, np.nan), (np.nan, 1.0), (0.5, np.inf), (-0.1, 1.0)])
def test_a_path_is_passed_forward_from_a_row_of_it(s: float, ds: float) -> None:
    with pytest.raises(NotCovered, match="positive, finite rate"):
        path_stop(BOUNDS, Path.through(POINTS), s, ds)


def test_a_path_whose_parameter_decreases_is_refused() -> None:
    good = Path.through(POINTS)
    with pytest.raises(NotCovered, match="knots that grow"):
        Path(np.r_[0.0, good.knots[:0:-1]], good.coefficient)


def weak_brakes(share: float) -> Model:
    """Brakes that give this share of what gravity asks where the path ends, as an arm tells it that shares no code with bounds."""
    end = Path.through(POINTS).p(np.array([0.5 + path_stop(BOUNDS, Path.through(POINTS), 0.5, 1.5).length]), 0)[0]
    load = np.abs(gravity_load(carrying(shipped_arm(MODEL.rotor), 0.5, MODEL.robot.tip), end))
    torque = share * load
    strong = MODEL.brakes.torque.centre
    dry = np.array([15.0, 15.0, 10.0, 8.0, 3.0, 2.0])
    torque = np.where(load > dry, np.maximum(torque - dry, 0.5), strong)
    return replace(MODEL, brakes=replace(MODEL.brakes, torque=Box.of(0.99 * torque, 1.01 * torque)))


def test_a_path_stop_needs_brakes_that_hold_the_arm_as_any_stop_does() -> None:
    path = Path.through(POINTS)
    model = weak_brakes(0.8)  # friction included they hold a fifth less than gravity asks
    bounds = StopBounds.of(model, ramp=RAMP)
    bound = path_stop(bounds, path, 0.5, 1.5).bound
    assert not bound.certified and bound.time is None and bound.tcp is None and bound.angle is None
    assert "no stop provable" in bound.why and bound.holding_margin.min() < 0
    # the same rule as for a pose: at the path's end the same joint lacks the same torque
    q = path.p(np.array([0.5 + path_stop(BOUNDS, path, 0.5, 1.5).length]), 0)[0]
    at = bounds.bound(q, np.zeros(6), "1")
    assert not at.certified and int(np.argmin(at.holding_margin)) == int(np.argmin(bound.holding_margin))


def core_s_answers(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Codes of the core's path stops from here on, two to an answer: it asks where the path ends first."""
    core, codes = stopset.reach.stops.path.lib, list[int]()

    class Listened:
        def __getattr__(self, name: str) -> object:
            if name != "stopset_path_stop":
                return getattr(core, name)
            return lambda *args: codes.append(core.stopset_path_stop(*args)) or codes[-1]

    monkeypatch.setattr(stopset.reach.stops.path, "lib", Listened())
    return codes


def test_the_core_lets_brakes_hold_where_they_hold_at_every_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    """It asks around stretches of the way first, and pose by pose where that is too much: from brakes too weak to strong ones."""
    codes = core_s_answers(monkeypatch)
    certified = [
        path_stop(StopBounds.of(weak_brakes(x), ramp=RAMP), Path.through(POINTS), 0.5, 1.5).bound.certified
        for x in np.linspace(0.9, 2.1, 60)
    ]
    assert not certified[0] and certified[-1] and [c == lib.STOPSET_OK for c in codes[1::2]] == certified


def test_power_that_is_taken_before_the_path_stop_is_over_leaves_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the core as in Python, by the moment at which it is over."""
    codes = core_s_answers(monkeypatch)
    path, over = Path.through(POINTS), path_stop(BOUNDS, Path.through(POINTS), 0.5, 1.5).bound.time.max()
    for off_after, stops in ((0.0, False), (over - 1e-6, False), (over, True), (2.0 * over, True)):
        bound = path_stop(replace(BOUNDS, ramp=replace(RAMP, off_after=off_after)), path, 0.5, 1.5).bound
        assert bound.certified == stops == (codes[-1] == lib.STOPSET_OK)
        assert stops or (bound.time is None and "before" in bound.why)


def test_a_ramp_that_begins_early_ends_where_the_arm_is_held_as_told() -> None:
    """A stop known to begin within 0.1 s may end anywhere between; each of these ends holds what the stop says, in every number."""
    rng, told = np.random.default_rng(0), 0
    early = [StopBounds.of(MODEL, (0.0, 0.25), ramp=Ramp.stated(6, time=0.3, control=c)) for c in (0.0, 0.03, 0.06)]
    for _ in range(30):
        path, rate = Path.through(np.cumsum(rng.uniform(-0.5, 0.5, (5, 6)), axis=0)), rng.uniform(0.5, 3.0)
        try:
            whole = path_stop(replace(early[0], ramp=Ramp.stated(6, time=0.3, control=0.1)), path, 0.5, rate).bound
        except NotCovered:
            continue
        for b in early:
            one = path_stop(b, path, 0.5, rate).bound
            told += 1
            assert np.all(one.holding_margin >= whole.holding_margin - 1e-9)
            for name in ("time", "forward", "back", "speed"):
                assert np.all(getattr(one, name) <= getattr(whole, name) + 1e-9), name
    assert told > 30


def test_a_path_stop_carries_its_payload_where_it_is() -> None:
    path, far = Path.through(POINTS), np.array([0.0, 0.0, 0.5])
    near, out = path_stop(BOUNDS, path, 0.5, 1.5), path_stop(StopBounds.of(MODEL, payload_com=far, ramp=RAMP), path, 0.5, 1.5)
    assert out.length > near.length and out.bound.tcp > near.bound.tcp
    assert any("[0.0, 0.0, 0.5] m" in a for a in out.bound.assumptions)


def test_a_path_that_grazes_the_end_of_a_range_is_told_so_within_the_tracking_error() -> None:
    """The path stays within the ranges; the arm that is led along it may be a tracking error and a reading's error beside it."""
    path, s = Path.through(POINTS), np.linspace(0.0, 3.0, 3001)
    begin, top = float(s[np.argmax(path.p(s, 0)[:, 1])]), path.p(s, 0)[:, 1].max()
    ramp = replace(RAMP, q_error=np.full(6, 2e-3))
    noise = StopBounds.of(MODEL, ramp=ramp).setting.noise  # type: ignore[union-attr]
    read = max(-noise.lo[1], noise.hi[1])
    for beside, told in ((1e-4, True), (1.9e-3 + read, True), (2.1e-3 + read, False)):
        limit = MODEL.robot.q_limit.copy()
        limit[1, 1] = top + beside
        bound = path_stop(
            StopBounds.of(replace(MODEL, robot=replace(MODEL.robot, q_limit=limit)), ramp=ramp), path, begin, 0.5
        ).bound
        assert bound.certified and bound.end_stops == (("arm_2_joint",) if told else ())
        assert ("arm_2_joint can come to an end stop" in bound.why) is told


def test_a_path_through_states_no_recording_shows_is_not_covered_or_marked() -> None:
    path = Path.through(POINTS)
    v = 1.5 * np.abs(path.p(np.array([0.5]), 1)[0])
    slow = replace(MODEL, domain=replace(MODEL.domain, dq=Box.symmetric(v / 1.58)))  # 158 % of what was seen
    narrow = replace(
        MODEL,
        domain=replace(
            MODEL.domain,
            q=Box(POINTS.min(axis=0) - 0.01, np.r_[path.p(np.array([0.5]), 0)[0, 0] + 0.005, POINTS.max(axis=0)[1:] + 0.1]),
        ),
    )
    for model, word in ((slow, "rad/s, seen"), (narrow, "arm_1_joint at")):
        bound = path_stop(StopBounds.of(model, ramp=RAMP), path, 0.5, 1.5).bound
        assert not bound.certified and bound.time is None and word in bound.why and "not covered" in bound.why
        marked = path_stop(StopBounds.of(model, ramp=RAMP, extrapolate=Extrapolation(state=True)), path, 0.5, 1.5).bound
        assert not marked.certified and marked.time is not None and "EXTRAPOLATED STATE" in marked.extrapolated
        assert "EXTRAPOLATED STATE" in marked.why and any("EXTRAPOLATED STATE" in a for a in marked.assumptions)


@pytest.mark.parametrize(("begin", "sees"), [(0.0, True), (2.6, False)])
def test_a_path_stop_counts_effects_where_the_arm_passes(begin: float, sees: bool) -> None:
    """A spring on the first joint: weak where the path begins, however far it was identified; too strong a rad away, wherever it was."""
    path, limit = Path.through(POINTS[: 2 if sees else 4]), float(MODEL.robot.torque_limit[0])
    spring = Fitted("spring", MODEL.joints[0], {"k": 0.85 * limit, "c": 0.0}, {"k": 0.0, "c": 0.0})
    q = Box(np.r_[-0.1, MODEL.domain.q.lo[1:]], np.r_[0.1, MODEL.domain.q.hi[1:]])
    for domain in (MODEL.domain, replace(MODEL.domain, q=q)):
        model = replace(MODEL, effects=(*MODEL.effects, spring), domain=domain)
        bounds = StopBounds.of(model, ramp=RAMP, extrapolate=Extrapolation(state=True))
        if sees:
            stop = path_stop(bounds, path, begin, 0.5)
            # what an arm told by its law needs, at the pose where it needs most
            assert 0.0 <= stop.room <= limit * (1.0 - 0.85 * stop.q[-1, 0])
        else:
            with pytest.raises(NotCovered, match="no torque left"):
                path_stop(bounds, path, begin, 0.5)


def test_a_path_stop_lasts_until_rest() -> None:
    ringing = replace(RAMP, dq_error=np.full(6, 0.1), settle=0.08)
    still, long = (path_stop(replace(BOUNDS, ramp=r), Path.through(POINTS), 0.5, 1.5) for r in (RAMP, ringing))
    assert long.bound.time == pytest.approx(still.bound.time + 0.08)
    unknown = path_stop(replace(BOUNDS, ramp=replace(ringing, settle=None)), Path.through(POINTS), 0.5, 1.5)
    assert not unknown.bound.certified and unknown.bound.time is None


def test_between_the_poses_looked_at_nothing_leaves_the_bound() -> None:
    """Tool, link ends and speeds of a hundred times as many points of the path."""
    from stopset.robot.rigid import link_frames

    path, robot = Path.through(POINTS), MODEL.robot
    stop = path_stop(BOUNDS, path, 0.5, 1.5)
    s = np.linspace(0.5, 0.5 + stop.length, 20000)
    q, d1 = path.p(s, 0), path.p(s, 1)

    def ends(x: np.ndarray) -> np.ndarray:
        R, o = link_frames(robot.chain, x)
        return np.array([*o[1:], o[-1] + R[-1] @ robot.tip])

    p = np.array([ends(x) for x in q])
    far = np.linalg.norm(p - p[0], axis=2).max(axis=0)
    pace = 1.5 * np.linalg.norm(np.diff(p, axis=0), axis=2).max(axis=0) / (s[1] - s[0])
    b = stop.bound
    # the start is known to 1 mrad in each of six joints, 0.7 m long together
    assert np.all(far <= b.links) and far[-1] <= b.tcp <= far[-1] + 0.005
    assert pace[-1] <= b.tcp_speed <= 1.5 * pace[-1] and np.all(1.5 * np.abs(d1).max(axis=0) <= b.speed)
    travel = p[:, -1] - p[0, -1]
    assert np.all(travel >= b.tcp_box[:, 0]) and np.all(travel <= b.tcp_box[:, 1])
    assert b.holding_margin is not None and b.holding_margin.min() > 0.0


def test_path_from_the_command_line(tmp_path: File, capsys: pytest.CaptureFixture[str]) -> None:
    from stopset.artifact import save_model
    from stopset.cli.main import main

    save_model(MODEL, tmp_path / "m.json")
    lines = [",".join(f"{x:.3f}" for x in row) for row in POINTS]
    (tmp_path / "p.csv").write_text("\n".join([",".join(MODEL.joints), *lines]) + "\n")
    asked = ["stops", str(tmp_path / "m.json"), "--path", str(tmp_path / "p.csv"), "--ramp-time", "0.3", "--path-start", "0.5"]
    assert main([*asked, "--path-rate", "1.5"]) == 0
    assert "stays on its programmed path" in capsys.readouterr().out
    for rate, word in ((["--path-rate", "60"], "too fast"), ([], "--path-rate")):
        assert main([*asked, *rate]) == 2
        err = capsys.readouterr().err
        assert word in err and err.count("\n") == 1
    for wrong, word in (
        (["--at", "0,0,0,0,0,0"], "no --at"), (["--speed", "50%"], "nor --speed"), (["--category", "0"], "expected 1"),
        (["--payload-at", "1e9,0,0"], "at most 10 m"), (["--payload", "nan"], "at least 0 kg"), (["--path-start", "nan"], "rate"),
    ):  # fmt: skip
        assert main([*asked, "--path-rate", "1.5", *wrong]) == 2
        err = capsys.readouterr().err
        assert word in err and err.count("\n") == 1
    far = ["--payload", "0.5", "--payload-at", "0,0,0.5", "--path-rate", "1.5", "--json"]
    assert main([*asked, *far[:2], *far[4:], str(tmp_path / "near.json")]) == 0
    assert main([*asked, *far, str(tmp_path / "far.json")]) == 0
    near, out = (json.loads((tmp_path / f).read_text())[0]["tcp_m"] for f in ("near.json", "far.json"))
    assert out > near
    for text, word in (
        ("1,2,3\n4,5,6\n", "expected 6 angles"), ("0,0,0,0,0,0\n0,0,0,0,0,nan\n", "angle nan"), ("\n".join(lines[:1] * 5), "the same"),
        (lines[0], "a path of 1 rows"), ("", "a path of 0 rows"), ("0,0,0,0,0,0\n0,0,0,0,0\n", "a row of 5 numbers"),
    ):  # fmt: skip
        (tmp_path / "p.csv").write_text(text)
        assert main([*asked, "--path-rate", "1"]) == 2
        err = capsys.readouterr().err
        assert word in err and err.count("\n") == 1


def arm_of(torque: float = 1e4, speed: float = 100.0, model: Model = MODEL, **changes: float) -> StopBounds:
    """The arm with other drives: torque limits [N m], of ``joint_<k>`` alone where given, speed limits [rad/s], any state seen."""
    n = model.n
    limits = np.array([changes.get(f"joint_{k + 1}", torque) for k in range(n)])
    far = Box.symmetric(np.full(n, 1e3))
    domain = replace(model.domain, q=far, dq=far)
    robot = replace(model.robot, torque_limit=limits, dq_limit=np.full(n, speed))
    return StopBounds.of(replace(model, robot=robot, domain=domain), (0.0, 0.0), ramp=RAMP)


def test_what_weak_drives_can_stop_strong_ones_can() -> None:
    """From drives that do not even hold the arm where the stop begins, over those that do not on the way, to those that stop it."""
    stopped = []
    for limit in np.linspace(22.0, 120.0, 80):
        try:
            stopped.append(path_stop(arm_of(joint_2=limit), Path.through(POINTS), 0.2, 1.2).length)
        except NotCovered as e:
            assert "cannot stop within" in str(e) or "no torque left" in str(e)
            stopped.append(np.inf)
    assert np.isinf(stopped[0]) and np.isfinite(stopped[-1]) and np.all(np.diff(np.array(stopped)[np.isfinite(stopped)]) <= 1e-9)
    assert np.all(np.isfinite(stopped[int(np.argmin(np.isinf(stopped))) :]))


def test_a_path_that_gets_too_fast_on_the_way_is_refused() -> None:
    """Within the limits where the stop is asked for, beyond them before braking begins."""
    q = np.zeros((6, 6))
    q[:, 5] = [0.0, 0.01, 0.03, 0.3, 1.0, 2.0]
    path = Path.through(q)
    begin = np.abs(path.p(np.array([1.0]), 1)[0] * 20.0).max()
    assert path_stop(arm_of(), path, 1.0, 20.0).bound.certified
    with pytest.raises(NotCovered, match="too fast: arm_6_joint would pass its limit"):
        path_stop(arm_of(speed=1.2 * begin), path, 1.0, 20.0)


def test_a_request_too_late_on_the_path_is_refused() -> None:
    with pytest.raises(NotCovered, match="the path ends before braking begins"):
        path_stop(BOUNDS, Path.through(POINTS), 2.99, 1.5)


def test_a_path_rougher_than_its_grid_is_refused() -> None:
    """What the knots do not show, four times as many points do."""
    rng = np.random.default_rng(3)
    q = np.zeros((600, 6))
    q[:, 5] = np.linspace(-1.5, 1.5, 600) + 2e-4 * rng.normal(size=600)
    with pytest.raises(NotCovered, match=r"than a drive has: not credible|cannot stop within"):
        path_stop(arm_of(joint_6=8.0), Path.through(q), 5.0, 400.0)


def test_a_drive_that_has_no_torque_left_farther_on_is_said() -> None:
    """The spring is weak where the stop begins, and too strong where it may lead."""
    limit = float(MODEL.robot.torque_limit[0])
    spring = Fitted("spring", MODEL.joints[0], {"k": 0.85 * limit, "c": 0.0}, {"k": 0.0, "c": 0.0})
    robot = replace(MODEL.robot, dq_limit=np.full(6, 100.0))
    model = replace(MODEL, effects=(*MODEL.effects, spring), robot=robot)
    bounds = StopBounds.of(model, ramp=RAMP, extrapolate=Extrapolation(state=True))
    path = Path.through(POINTS)
    assert path_stop(bounds, path, 1.0, 4.0).room >= 0.0
    refused = set()
    for rate in np.linspace(4.0, 8.0, 40):
        try:
            path_stop(bounds, path, 1.0, rate)
        except NotCovered as e:
            refused.add("no torque left" if f"the drive of {MODEL.joints[0]} has no torque left" in str(e) else "other")
    assert "no torque left" in refused


@pytest.mark.parametrize("rate", [0.6, 1.2])
def test_a_motion_that_gets_faster_is_stopped_from_where_and_as_fast_as_it_then_is(rate: float) -> None:
    """Until its ramp begins it gains up to its pace: from there at that rate no drive stops it sooner than the bound without any pace says."""
    late, pace = 0.05, 1.4
    ramp = Ramp.stated(6, time=0.3, control=late)
    path = Path.through(POINTS)
    told = path_stop(replace(BOUNDS, ramp=replace(ramp, pace=(-pace, pace))), path, 0.5, rate)
    s, quick = 0.5 + rate * late * (1.0 + 0.5 * pace * late), rate * (1.0 + pace * late)
    then = path_stop(replace(BOUNDS, ramp=Ramp.stated(6, time=0.3, control=0.0)), path, s, quick)
    assert told.bound.certified and then.bound.certified
    assert told.length >= 0.999 * (s - 0.5 + then.length) and told.time >= 0.999 * (late + then.time)
    assert told.length > 1.03 * path_stop(replace(BOUNDS, ramp=ramp), path, 0.5, rate).length
    at = np.linspace(0.5, 0.999 * (s + then.length - 0.5) + 0.5, 50)
    moved = path.p(at, 0) - path.p(at[:1], 0)
    assert np.all(moved.max(axis=0) <= told.bound.forward + 1e-9) and np.all(-moved.min(axis=0) <= told.bound.back + 1e-9)
    assert np.all(np.abs(path.p(np.array([s]), 1)[0] * quick) <= told.bound.speed + 1e-9)


LOWERED = np.zeros((2, 6))
LOWERED[:, 1] = 0.6, 2.5  # the second joint, down past where gravity asks most of it


def led_to_rest(bounds: StopBounds, s: float, rate: float, late: float, step: float = 2e-4) -> float:
    """[s] from the request until an arm led along `LOWERED` rests, its ramp begun after ``late`` [s], as hard as its drive then surely can."""
    assert bounds.setting is not None
    p, path, time = bounds.setting.plant, Path.through(LOWERED), late
    along, none = path.p(np.array([s]), 1)[0], np.zeros(6)
    rubs = p.coulomb_hi + p.viscous_hi * np.abs(along) * rate + np.maximum(np.abs(p.u_lo), np.abs(p.u_hi))
    room, s = float((0.98 * bounds.model.robot.torque_limit - rubs)[1]), s + rate * late
    while rate > 0.0 and time < 20.0:
        q = path.p(np.array([min(s, path.length)]), 0)[0]
        brakes = []
        for pi in (p.pi - p.pi_half, p.pi + p.pi_half):
            load = torque(p.chain, pi, q, none, none)
            inert = torque(p.chain, pi, q, none, along) - load + (p.rotor + p.rotor_half) * along
            brakes.append((room - abs(load[1])) / abs(inert[1]))
        rate, s, time = rate - step * min(brakes), s + step * rate, time + step
    return time


def test_a_ramp_that_begins_where_drives_are_weaker_takes_no_longer_than_told() -> None:
    """Who brakes early creeps where gravity asks most of the drive; who brakes late has passed that by, and rests sooner."""
    bounds = replace(arm_of(joint_2=74.0), ramp=Ramp.stated(6, time=0.3, control=0.3))
    told = path_stop(bounds, Path.through(LOWERED), 0.3, 0.6)
    times = [led_to_rest(bounds, 0.3, 0.6, late) for late in (0.0, 0.1, 0.2, 0.3)]
    assert times[0] > 1.04 * times[-1]  # else this asks nothing
    assert told.bound.certified and told.time == told.bound.time.max() >= max(times)


def test_the_time_of_a_path_stop_is_that_of_its_drives() -> None:
    """Where drives can brake about as hard everywhere, that ramps may begin early adds next to nothing."""
    bounds = replace(arm_of(joint_2=90.0), ramp=Ramp.stated(6, time=0.3, control=0.02))
    for rate in np.linspace(0.3, 0.6, 12):
        told, found = path_stop(bounds, Path.through(LOWERED), 0.3, rate).time, led_to_rest(bounds, 0.3, rate, 0.02)
        assert 0.999 * found <= told <= 1.02 * found


@pytest.mark.parametrize(
    ("weak", "held", "begin", "late"),
    [
        ({"joint_2": 72.0}, 0.0, 0.3, 0.6),
        ({"joint_3": 27.0}, 0.0, 0.45, 0.4),
        ({"joint_2": 90.0, "joint_3": 24.0}, 2.2, 0.3, 0.4),
    ],
)
def test_where_an_early_ramp_is_not_surely_braked_there_is_no_time(
    weak: dict[str, float], held: float, begin: float, late: float
) -> None:
    """The drive that brakes, or another that has to hold its joint meanwhile, is strong enough only where the latest ramp begins; or the one lets it
    brake no harder than the other needs it to."""
    path, bounds = Path.through(LOWERED + held * np.eye(6)[2]), arm_of(**weak)
    with pytest.raises(NotCovered, match="cannot stop within"):
        path_stop(replace(bounds, ramp=Ramp.stated(6, time=0.3, control=late)), path, begin, 0.6)
    assert path_stop(replace(bounds, ramp=Ramp.stated(6, time=0.3, control=0.0)), path, begin + 0.6 * late, 0.6).bound.certified


def test_a_motion_that_may_rest_before_any_ramp_begins_takes_no_longer_than_told() -> None:
    """Its pace may be such that it has come to rest by then, or that it goes on as fast."""
    late = replace(Ramp.stated(6, time=0.3, control=0.3), control=Box(np.full(6, 0.3), np.full(6, 0.3)), pace=(-5.0, 0.0))
    bounds = replace(arm_of(joint_2=74.0), ramp=late)
    told = path_stop(bounds, Path.through(LOWERED), 0.3, 0.6)
    assert told.bound.certified and told.time >= max(led_to_rest(bounds, 0.3, rate, 0.3) for rate in (0.05, 0.3, 0.6))


def test_where_an_effect_leaves_an_early_ramp_nothing_there_is_no_time() -> None:
    """A spring that is slack where the latest ramp begins, and has all of the drive's torque where the stop is asked for."""
    spring = Fitted("spring", MODEL.joints[1], {"k": 190.0, "c": 0.0}, {"k": 0.0, "c": 0.0})
    bounds = arm_of(joint_2=200.0, model=replace(MODEL, effects=(*MODEL.effects, spring)))
    path = Path.through(LOWERED - [0.0, 1.8, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(NotCovered, match="cannot stop within"):
        path_stop(replace(bounds, ramp=Ramp.stated(6, time=0.3, control=0.6)), path, 0.05, 0.6)
    assert path_stop(replace(bounds, ramp=Ramp.stated(6, time=0.3, control=0.0)), path, 0.41, 0.6).bound.certified


TURNED = np.zeros((2, 6))
TURNED[:, 0], TURNED[:, 1] = (-1.5, 1.5), 0.5  # the whole arm about its upright axis, leaning out


def led_off(joint: int, off: float, late: float) -> StopBounds:
    """One joint's reading off by up to ``off`` [rad], all others' exact; a ramp that begins after ``late`` [s]."""
    sets = replace(MODEL.powered, V=Box.symmetric(off * np.eye(12)[joint]))
    return replace(arm_of(model=replace(MODEL, sets={"powered": sets})), ramp=Ramp.stated(6, time=0.3, control=late))


def tool_at(q: np.ndarray) -> np.ndarray:
    from stopset.robot.rigid import link_frames

    R, o = link_frames(MODEL.robot.chain, q)
    return np.asarray(o[:, -1] + R[:, -1] @ MODEL.robot.tip)


@pytest.mark.parametrize("late", [0.02, 1.6])
def test_an_arm_that_leans_out_farther_than_it_reads_goes_no_farther_nor_faster_than_told(late: float) -> None:
    """Turned by more than a rad it is moved by up to twice as much more as it leans out more."""
    bounds, path = led_off(1, 0.03, late), Path.through(TURNED)
    b = path_stop(bounds, path, 0.0, 0.5).bound
    s = np.linspace(0.0, 0.5 * late, 200)
    true = path.p(s, 0) + 0.03 * np.eye(6)[1]
    p = tool_at(true)
    turning = np.cross(MODEL.robot.chain.axis[0], p[0]) * 0.5 * path.p(s[:1], 1)[0, 0]
    assert b.certified and np.linalg.norm(p - p[0], axis=1).max() <= b.tcp and np.linalg.norm(turning) <= b.tcp_speed
    assert np.linalg.norm(p - p[0], axis=1).max() <= b.links[-1] and np.linalg.norm(turning) <= b.link_speed[-1]
    assert np.all(p - p[0] <= b.tcp_box[:, 1]) and np.all(p - p[0] >= b.tcp_box[:, 0])


@pytest.mark.parametrize("joint", [0, 1])
def test_a_joint_that_turns_more_than_it_reads_is_told_so(joint: int) -> None:
    """A code disc off its centre: the angle that is read is wrong once per turn, and so is how far and how fast a joint has turned."""
    eccentric = Fitted("encoder_eccentricity", MODEL.joints[joint], {"a": 0.015, "b": -0.01}, {"a": 1e-4, "b": 1e-4})
    bounds = arm_of(model=replace(MODEL, effects=(*MODEL.effects, eccentric)))
    rows = np.zeros((2, 6))
    rows[:, joint] = -0.6, 0.2
    for points in (rows, -rows):
        path, late = Path.through(points), 0.2
        b = path_stop(replace(bounds, ramp=Ramp.stated(6, time=0.3, control=late)), path, 0.0, 1.5).bound
        read = path.p(np.linspace(0.0, 1.5 * late, 100), 0)[:, joint]
        true, share = read + 0.015 * np.sin(read) - 0.01 * np.cos(read), 1.0 + 0.015 * np.cos(read) + 0.01 * np.sin(read)
        moved = true - true[0]
        assert b.certified and np.abs(1.5 * share * (points[1] - points[0])[joint]).max() <= b.speed[joint]
        assert moved.max() <= b.forward[joint] and -moved.min() <= b.back[joint]
