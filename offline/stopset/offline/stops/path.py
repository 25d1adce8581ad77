"""STOP 1 on a given path: the shortest stop that keeps the arm on its programmed path within the drives' torque.

The path is ``q = p(s)``; the shortest stopping length is the least L for which the controllable set of ``[s0, s0 + L]`` with
rest at its end still holds the present speed (toppra), found by bisection; there the only profile left is full braking.
toppra holds the torque limits at its grid points only, so the result is checked four times as densely.

Source: Pham & Pham (2018), A new approach to time-optimal path parameterization based on reachability analysis.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Model
from stopset.errors import NotCovered
from stopset.reach.stops import Ramp, StopBound, StopBounds
from stopset.reach.stops.setting import Setting, beyond_domain
from stopset.reach.stops.tube import Plant
from stopset.reach.stops.words import NO_REST, UNSEEN, ramp_assumptions
from stopset.robot.rigid import link_frames, torque
from stopset.sets import Box
from stopset.types import Array

GRID = 60
DENSE = 4  # times as many points in the check
BISECTIONS = 18  # of the length: a quarter of a millionth of the path
FARTHEST = 1e3  # [rad] of an angle: beyond, it is no angle
RESERVE = 0.02  # share of the torque kept for what happens between grid points

Errors = tuple[Array, Array]  # (n,) [rad], [rad/s] by which the arm may be off its path


@dataclass(frozen=True, slots=True)
class Passed:
    """What a stop passes: ``poses`` and ``speeds`` (K, n) in ``time`` [s], ``spacing`` apart in s at a ``rate`` of at most [1/s].

    ``first``, ``second``: (n,) bounds of ``|dp/ds|`` and ``|d2p/ds2|`` there.
    """

    poses: Array
    speeds: Array
    time: float
    spacing: float
    rate: float
    first: Array
    second: Array


@dataclass(frozen=True, slots=True)
class Path:
    """``p(s, order)`` gives angles (n,) or their derivatives by ``s`` for ``s`` in ``[0, length]``.

    Between two neighbours of ``knots`` the path is a polynomial of degree at most 3.
    """

    p: Callable[[Array, int], Array]  # rows for an array of s
    length: float
    knots: Array

    def __post_init__(self) -> None:
        if not (0.0 < self.length < np.inf and np.all(np.diff(self.knots) > 0.0)):
            raise NotCovered(
                f"a path of length {self.length:g} with knots {np.array2string(self.knots, precision=3, threshold=8)}; expected a "
                "positive length and knots that grow: give its points in the order they are passed"
            )

    @classmethod
    def through(cls, waypoints: Array) -> Path:
        """A cubic spline through ``waypoints`` (W, n) [rad], ``s`` being their number.

        Raises `NotCovered` for fewer than two rows, angles that are none, and rows like the one before them.
        """
        from scipy.interpolate import CubicSpline

        if waypoints.ndim != 2 or len(waypoints) < 2:
            raise NotCovered(f"a path of {len(waypoints)} rows; expected at least two rows of angles: give where the path leads")
        bad = ~(np.abs(waypoints) <= FARTHEST)
        if np.any(bad):
            k, j = np.argwhere(bad)[0]
            raise NotCovered(
                f"row {k} of the path has the angle {waypoints[k, j]:g}; expected finite ones of at most {FARTHEST:g} rad: give every "
                "angle in rad"
            )
        still = np.flatnonzero(np.all(waypoints[1:] == waypoints[:-1], axis=1))
        if len(still):
            raise NotCovered(
                f"rows {still[0]} and {still[0] + 1} of the path are the same ({len(still)} of {len(waypoints) - 1} steps do not move); "
                "expected every row to move a joint: leave out what repeats"
            )
        spline = CubicSpline(np.arange(len(waypoints)), waypoints, axis=0, bc_type="natural" if len(waypoints) > 2 else "clamped")
        if len(waypoints) == 2:  # a straight line in joint space
            a, b = waypoints
            return cls(
                lambda s, k: (a + np.asarray(s)[:, None] * (b - a)) if k == 0 else (np.tile((b - a) * (k == 1), (len(s), 1))), 1.0,
                np.array([0.0, 1.0]),
            )  # fmt: skip
        return cls(lambda s, k: np.asarray(spline(s, k)), float(len(waypoints) - 1), np.arange(len(waypoints), dtype=float))

    def steepest(self, begin: float, end: float) -> tuple[Array, Array]:
        """(n,) each: bounds of ``|dp/ds|`` and ``|d2p/ds2|`` on ``[begin, end]``, between the points looked at too."""
        grid = np.linspace(begin, end, 400)
        inner = self.knots[(self.knots > begin) & (self.knots < end)]
        # a cubic's second derivative is linear: largest at knots and ends; the first lies near its samples
        second = np.abs(self.p(np.concatenate([inner, [begin, end]]), 2)).max(axis=0)
        first = np.abs(self.p(grid, 1)).max(axis=0) + 0.5 * (grid[1] - grid[0]) * second
        return first, second


@dataclass(frozen=True, slots=True)
class PathStop:
    """A stop along a path: ``length`` in ``s``, ``time`` [s]; ``q`` (K, n) the poses passed; ``room`` [N m] least torque left."""

    length: float
    time: float
    q: Array
    room: float
    bound: StopBound


def path_stop(bounds: StopBounds, path: Path, s0: float, ds: float) -> PathStop:
    """The shortest stop along ``path`` from ``s0`` at the rate ``ds`` [1/s], after the control delay of the bounds' ramp.

    The bound has no numbers where brakes do not surely hold the arm, as for any other stop, and where the way leads through
    states outside the model's domain, unless these are to be extrapolated.
    Raises `NotCovered` if the path leaves the limits, is too fast for them or for its drives, or cannot stop before its end.
    """
    setting, ramp = bounds.setting, bounds.ramp
    if setting is None:
        raise NotCovered(
            "the model holds no brakes, so no stop ends held; expected brakes: give them in robot.json or identify them"
        )
    if ramp is None:
        raise NotCovered("no ramp says how late and how exactly the drives brake; expected one: state it (--ramp-time)")
    if not (0.0 <= s0 < path.length and 0.0 < ds < np.inf):
        raise NotCovered(
            f"a path stop from row {s0:g} at {ds:g} rows per second; expected 0 <= row < {path.length:g} and a positive, finite rate: "
            "give --path-start and --path-rate"
        )
    begin = s0 + ds * float(np.max(ramp.control.hi))  # the arm goes on until the drives begin to brake
    if begin >= path.length:
        raise NotCovered(
            f"the path ends before braking begins (row {begin:.4g} of {path.length:.4g}); it starts too fast: give a lower --path-rate"
        )
    _check_limits(bounds.model, path, s0, ds)
    off = (ramp.q_error + setting.noise.radius[: bounds.model.n], ramp.dq_error + setting.noise.radius[bounds.model.n :])
    shortest, profile = _shortest(setting, path, begin, ds, off)
    q, rates, room = _dense(setting, path, begin, profile, off)
    early = np.linspace(s0, begin, GRID)
    poses = np.vstack([path.p(early, 0), q])
    speeds = np.vstack([path.p(early, 1) * ds, rates])
    _check_speeds(bounds.model, speeds)
    time = float(np.max(ramp.control.hi)) + float(np.sum(2.0 * np.diff(profile[0]) / (profile[1][1:] + profile[1][:-1])))
    spacing = max(begin - s0, 0.0) / (GRID - 1), shortest / GRID / DENSE
    fastest = max(ds, float(profile[1].max()))
    passed = Passed(poses, speeds, time, max(spacing), fastest, *path.steepest(s0, begin + shortest))
    bound = _judged(bounds, setting, ramp, passed)
    return PathStop(begin - s0 + shortest, time, poses, room, bound)


def _judged(bounds: StopBounds, setting: Setting, ramp: Ramp, passed: Passed) -> StopBound:
    """The bound, or why there is none: outside the domain, no time to rest known, not held."""
    seen = (beyond_domain(bounds.model, q, v) for q, v in zip(passed.poses, passed.speeds, strict=True))
    beyond = next((x for x in seen if x), None)
    if beyond and not bounds.extrapolate_state:
        return StopBound(
            "1", certified=False, why=f"not covered, the path leads there: {beyond}; {UNSEEN}", assumptions=setting.assumptions
        )
    if ramp.after is None:
        return StopBound("1", certified=False, why=NO_REST, assumptions=setting.assumptions)
    off = ramp.q_error + setting.noise.radius[: bounds.model.n]
    margin = np.minimum(bounds.margin(passed.poses[0], off), bounds.margin(passed.poses[-1], off))
    if margin.min() <= 0:
        return bounds.refused_for("1", margin, passed.poses[-1])
    bound = _bound(bounds.model, setting, ramp, passed, passed.time + ramp.after)
    return bounds.marked(replace(bound, holding_margin=margin), beyond)


def _check_limits(model: Model, path: Path, s0: float, ds: float) -> None:
    s = np.linspace(s0, path.length, 400)
    q, limit = path.p(s, 0), model.robot.q_limit
    inside = (q >= limit[:, 0]) & (q <= limit[:, 1])
    if not np.all(inside):
        j = int(np.argmin(np.all(inside, axis=0)))
        raise NotCovered(
            f"the path takes {model.joints[j]} to [{q[:, j].min():.4g}, {q[:, j].max():.4g}] rad, beyond its limits "
            f"[{limit[j, 0]:.4g}, {limit[j, 1]:.4g}] rad; give a path within them"
        )
    _check_speeds(model, path.p(np.array([s0]), 1) * ds)


def _check_speeds(model: Model, speeds: Array) -> None:
    """Speeds (K, n) on the way against the data sheet's."""
    v = np.abs(speeds).max(axis=0)
    if not np.all(v <= model.robot.dq_limit * (1 + 1e-9)):
        j = int(np.argmax(v / model.robot.dq_limit))
        raise NotCovered(
            f"the path is too fast: {model.joints[j]} at {v[j]:.4g} rad/s, its limit is {model.robot.dq_limit[j]:.4g} rad/s; give a "
            "lower --path-rate"
        )


def _there(setting: Setting, poses: Array, speeds: Array, off: Errors) -> Plant:
    """What the effects give where the arm passes, its errors ``off`` the path included: not where identification was."""
    region = Box(poses.min(axis=0) - off[0], poses.max(axis=0) + off[0])
    return setting.near(setting.plant, region, np.abs(speeds).max(axis=0) + off[1])


def _friction(p: Plant, dq: Array) -> Array:
    extra = p.coulomb_hi + p.viscous_hi * np.abs(dq) + np.maximum(np.abs(p.u_lo), np.abs(p.u_hi))
    return np.asarray(extra)


def _room(setting: Setting, plant: Plant, dq_top: Array) -> Array:
    """(n,) [N m]: torque the rigid body may use; friction helps or not, disturbance and reserve are taken off."""
    room = setting.model.robot.torque_limit * (1.0 - RESERVE) - _friction(plant, dq_top)
    if np.any(room <= 0):
        j = int(np.argmin(room))
        raise NotCovered(
            f"the drive of {setting.model.joints[j]} has no torque left beside friction and disturbance; no ramp is provable"
        )
    return np.asarray(room)


def _shortest(setting: Setting, path: Path, begin: float, ds: float, off: Errors) -> tuple[float, tuple[Array, Array]]:
    """Least stopping length, and its profile (s, ds) at the grid points."""
    longest = path.length - begin
    whole = _profile(setting, path, begin, longest, ds, off)
    if whole is None:
        raise NotCovered(
            f"the path starts too fast: at {ds:.4g} 1/s it cannot stop within its remaining {longest:.4g} with the drives' torque"
        )
    lo, hi, best = 0.0, longest, whole
    for _ in range(BISECTIONS):
        middle = 0.5 * (lo + hi)
        found = _profile(setting, path, begin, middle, ds, off)
        if found is None:
            lo = middle
        else:
            hi, best = middle, found
    return hi, best


def _profile(setting: Setting, path: Path, begin: float, length: float, ds: float, off: Errors) -> tuple[Array, Array] | None:
    import toppra
    from toppra import algorithm, constraint

    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    toppra.setup_logging("CRITICAL")
    robot, plant = setting.model.robot, setting.plant
    ahead = np.linspace(begin, begin + length, 40)
    top = np.abs(path.p(ahead, 1)).max(axis=0) * ds
    room = _room(setting, _there(setting, path.p(ahead, 0), top[None], off), top)

    class Piece(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        def __call__(self, s: Array, order: int = 0) -> Array:
            rows = path.p(np.atleast_1d(np.asarray(s, float)) + begin, order)
            return rows[0] if np.ndim(s) == 0 else rows

        @property
        def dof(self) -> int:
            return robot.n

        @property
        def path_interval(self) -> Array:
            return np.array([0.0, length])

        @property
        def waypoints(self) -> None:
            return None

    def dynamics(pi: Array) -> Callable[[Array, Array, Array], Array]:
        return lambda q, v, a: np.asarray(torque(robot.chain, pi, q, v, a) + plant.rotor * a)

    limits = np.stack([-room, room], axis=1)
    constraints = [
        constraint.JointTorqueConstraint(
            dynamics(pi), limits, np.zeros(robot.n), discretization_scheme=constraint.DiscretizationType.Interpolation
        )
        for pi in (plant.pi - plant.pi_half, plant.pi + plant.pi_half)
    ]
    grid = np.linspace(0.0, length, GRID + 1)
    instance = algorithm.TOPPRA(
        constraints, Piece(), gridpoints=grid, solver_wrapper="seidel", parametrizer="ParametrizeConstAccel"
    )
    _, sd, _ = instance.compute_parameterization(ds, 0.0)
    if sd is None or not np.all(np.isfinite(sd)):
        return None
    return grid, np.asarray(sd, float)


def _dense(setting: Setting, path: Path, begin: float, profile: tuple[Array, Array], off: Errors) -> tuple[Array, Array, float]:
    """Poses and speeds along the stop, and the least torque left, `DENSE` times as finely as the grid.

    Raises `NotCovered` if that is negative.
    """
    s, sd = profile
    robot, plant = setting.model.robot, setting.plant
    x = sd**2
    passed, speeds, used = [], [], []
    for k in range(len(s) - 1):
        acceleration = (x[k + 1] - x[k]) / (2.0 * (s[k + 1] - s[k]))
        for here in np.linspace(s[k], s[k + 1], DENSE, endpoint=False):
            rate = np.sqrt(max(x[k] + 2.0 * acceleration * (here - s[k]), 0.0))
            at = np.array([begin + here])
            q, d1, d2 = path.p(at, 0)[0], path.p(at, 1)[0], path.p(at, 2)[0]
            v, a = d1 * rate, d1 * acceleration + d2 * rate**2
            for pi in (plant.pi - plant.pi_half, plant.pi + plant.pi_half):
                used.append((np.abs(torque(robot.chain, pi, q, v, a) + plant.rotor * a), v))
            passed.append(q)
            speeds.append(v)
    passed.append(path.p(np.array([begin + s[-1]]), 0)[0])
    speeds.append(np.zeros(robot.n))
    poses = np.array(passed)
    there = _there(setting, poses, np.array(speeds), off)
    left = min(float(np.min(robot.torque_limit - tau - _friction(there, v))) for tau, v in used)
    if left < 0.0:
        raise NotCovered(f"between its grid points the stop asks {-left:.3g} N m more than a drive has: not credible; slow down")
    return poses, np.array(speeds), left


def _bound(model: Model, setting: Setting, ramp: Ramp, passed: Passed, time: float) -> StopBound:
    """Displacements and speeds over the poses passed, at rest after ``time`` [s].

    What lies between two poses is within half their spacing of one of them.
    """
    poses, spacing, rate, first, second = passed.poses, passed.spacing, passed.rate, passed.first, passed.second
    robot, n = model.robot, model.n
    between = 0.5 * spacing * first
    travel = poses - poses[0]
    ends = np.array([_ends(model, setting, q) for q in poses])  # (P, n + 1, 3), the tool last
    reach = float(np.linalg.norm(robot.chain.p[1:], axis=1).sum() + max(map(np.linalg.norm, (setting.payload_com, robot.tip))))
    slack = reach * float(np.sum(between + ramp.q_error + setting.noise.radius[:n]))
    moved = ends - ends[0]
    far = np.linalg.norm(moved, axis=2).max(axis=0) + slack
    # chords are shorter than arcs: by no more than the bend of the tool's path allows
    bend = reach * float(first.sum() ** 2 + second.sum())
    pace = np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=0) / spacing + spacing * bend
    speed = rate * pace + reach * float(ramp.dq_error.sum())
    return StopBound(
        "1", certified=True, why="", time=np.full(n, time),
        forward=np.maximum(travel.max(axis=0), 0.0) + between + ramp.q_error,
        back=np.maximum(-travel.min(axis=0), 0.0) + between + ramp.q_error,
        speed=rate * first + ramp.dq_error, tcp=float(far[-1]), tcp_speed=float(speed[-1]),
        tcp_box=np.stack([moved[:, -1].min(axis=0) - slack, moved[:, -1].max(axis=0) + slack], axis=1),
        links=far[:-1], link_speed=speed[:-1], layer="ramp",
        assumptions=(
            *setting.assumptions, *ramp_assumptions(ramp, "1"),
            "the arm stays on its programmed path within the tracking error, braking as hard as the weakest drive allows",
        ),
    )  # fmt: skip


def _ends(model: Model, setting: Setting, q: Array) -> Array:
    """(n + 1, 3) [m]: the outer end of every link, then the tool."""
    chain = model.robot.chain
    R, o = link_frames(chain, q)
    return np.array([*o[1:], o[-1] + R[-1] @ model.robot.tip, o[-1] + R[-1] @ setting.payload_com])
