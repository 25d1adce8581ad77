"""STOP 1 on a given path: the shortest stop that keeps the arm on its programmed path within the drives' torque.

The path is ``q = p(s)``, a cubic spline through rows of angles; the stop along it is the core's (``core/stops/path.c``), for
`stopset stops --path` and for units (FMU) alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.core.library import check, ffi, given, lib, view
from stopset.errors import NotCovered
from stopset.reach.stops.bounds import StopBounds
from stopset.reach.stops.compiled import CompiledStops
from stopset.reach.stops.ramp import Ramp, of_the_arm
from stopset.reach.stops.setting import Setting, beyond_domain
from stopset.reach.stops.types import StopBound
from stopset.reach.stops.words import NO_REST, UNSEEN, early_cut, ramp_assumptions
from stopset.robot.rigid import link_frames
from stopset.types import Array

EDGE = 1e-9  # [rad, rad/s] of the domain, as in `stopset.reach.stops.setting.beyond_domain`
FARTHEST = 1e3  # [rad] of an angle: beyond, it is no angle


@dataclass(frozen=True, slots=True)
class Path:
    """``p(s, order)`` gives angles or their derivatives for ``s`` in ``[0, length]``.

    ``knots`` (K + 1,) from 0; ``coefficient`` (K, n, 4) [rad] of 1, x, x^2, x^3 between two of them, x = s less the knot before it.
    """

    knots: Array
    coefficient: Array

    def __post_init__(self) -> None:
        if not (self.knots[0] == 0.0 and np.all(np.diff(self.knots) > 0.0) and self.length < np.inf):
            raise NotCovered(
                f"a path of length {self.length:g} with knots {np.array2string(self.knots, precision=3, threshold=8)}; expected a "
                "positive length and knots that grow: give its points in the order they are passed"
            )

    @property
    def length(self) -> float:
        """In rows."""
        return float(self.knots[-1])

    def p(self, s: Array, order: int) -> Array:
        """(len(s), n) [rad] the path at ``s``, or its derivative of this ``order``."""
        piece = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.coefficient) - 1)
        x, c = (np.asarray(s) - self.knots[piece])[:, None], self.coefficient[piece]
        for _ in range(order):
            c = c[:, :, 1:] * np.arange(1, c.shape[2])
        out = np.zeros(c.shape[:2])
        for k in reversed(range(c.shape[2])):
            out = out * x + c[:, :, k]
        return out

    def steepest(self, begin: float, end: float) -> tuple[Array, Array]:
        """(n,) each: bounds of ``|dp/ds|`` and ``|d2p/ds2|`` on ``[begin, end]``, between the points looked at too."""
        grid = np.linspace(begin, end, 400)
        inner = self.knots[(self.knots > begin) & (self.knots < end)]
        # a cubic's second derivative is a line: largest at knots and ends, from either side; the first lies near its samples
        edges = np.concatenate([inner, np.nextafter(inner, -np.inf), [begin, end]])
        second = np.abs(self.p(edges, 2)).max(axis=0)
        return np.abs(self.p(grid, 1)).max(axis=0) + 0.5 * (grid[1] - grid[0]) * second, second

    @classmethod
    def through(cls, waypoints: Array) -> Path:
        """A natural cubic spline through ``waypoints`` (W, n) [rad], ``s`` being their number; through two a straight line.

        Raises `NotCovered` for fewer than two rows, angles that are none, and rows like the one before them.
        """
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
        step, bend = np.diff(waypoints, axis=0), _natural(waypoints)
        first = step - (2.0 * bend[:-1] + bend[1:]) / 6.0
        pieces = np.stack([waypoints[:-1], first, 0.5 * bend[:-1], (bend[1:] - bend[:-1]) / 6.0], axis=2)
        return cls(np.arange(len(waypoints), dtype=float), pieces)


def _natural(y: Array) -> Array:
    """Second derivatives (W, n) of the natural cubic spline through rows a unit apart: a tridiagonal system, eliminated forward."""
    out, pivot = np.zeros_like(y), np.zeros(len(y))
    for k in range(1, len(y) - 1):
        pivot[k] = 1.0 / (4.0 - pivot[k - 1])
        out[k] = (6.0 * (y[k + 1] - 2.0 * y[k] + y[k - 1]) - out[k - 1]) * pivot[k]
    for k in range(len(y) - 3, 0, -1):
        out[k] -= pivot[k] * out[k + 1]
    return out


@dataclass(frozen=True, slots=True)
class Passed:
    """What a stop passes: poses ``q`` and speeds ``dq`` (K, n) at ``s`` (K,), at a ``rate`` of at most [1/s].

    ``first``, ``second``: (n,) bounds of ``|dp/ds|`` and ``|d2p/ds2|`` there.
    """

    s: Array
    q: Array
    dq: Array
    rate: float
    first: Array
    second: Array


@dataclass(frozen=True, slots=True)
class PathStop:
    """A stop along a path: ``length`` in ``s``, ``time`` [s]; ``q`` (K, n) the true poses passed; ``room`` [N m] least torque left."""

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
    n = bounds.model.n
    if path.coefficient.shape[1] != n:
        raise NotCovered(f"a path of {path.coefficient.shape[1]} angles a row; expected {n}: give one for every joint")
    core, work = CompiledStops.of(setting, ramp), np.empty(lib.stopset_path_room(n))
    fields = {k: given(x) for k, x in path_fields(setting, path).items()}
    struct = ffi.new("StopsetPath *", {"pieces": len(path.coefficient)} | {k: view(x) for k, x in fields.items()})
    passed, out = ffi.new("StopsetPassed *"), [np.empty(k) for k in (n, n, n, n, 2)]
    bound = ffi.new("StopsetBound *", tuple(view(x) for x in out))
    request = ffi.new("StopsetRequest *", (s0, ds))
    code = lib.stopset_path_stop(core.struct, core.braking, struct, request, view(work), passed, bound)
    check(-min(code, 0))
    if code == lib.STOPSET_OUT_OF_RANGE:
        raise NotCovered(
            f"a path stop from row {s0:g} at {ds:g} rows per second; expected 0 <= row < {path.length:g} and a positive, finite rate: "
            "give --path-start and --path-rate"
        )
    if code and code < lib.STOPSET_PATH_UNSEEN:
        raise NotCovered(_refusal(code, bounds.model, path, passed, ds))
    poses, most = passed.poses, work.size // (1 + 2 * n)
    s, q, dq = work[:poses], work[most:][: poses * n].reshape(-1, n), work[most * (1 + n) :][: poses * n].reshape(-1, n)
    ramp = of_the_arm(ramp, setting.shares)
    taken = Passed(s, q, dq, passed.rate, *path.steepest(s0, s0 + passed.length))
    return PathStop(passed.length, passed.time, q, passed.room, _judged(bounds, setting, ramp, taken, out))


def path_fields(setting: Setting, path: Path) -> dict[str, Array]:
    """A path, the arm's limits and where states were seen, by the names of the C struct: all of them where the arm truly is while it
    reads them, which effects may set right."""
    n, robot, noise, d = setting.model.n, setting.model.robot, setting.noise, setting.model.domain
    off = setting.truth.centre[:n]
    true = path.coefficient.copy()
    true[:, :, 0] += off
    return {
        "knots": path.knots, "coefficient": true, "noise": np.r_[noise.radius[:n], np.maximum(np.abs(noise.lo), np.abs(noise.hi))[n:]],
        "share": setting.shares,
        "q_lo": robot.q_limit[:, 0] + off, "q_hi": robot.q_limit[:, 1] + off, "fastest": robot.dq_limit,
        "seen_lo": np.concatenate([d.q.lo + off, d.dq.lo]) - EDGE, "seen_hi": np.concatenate([d.q.hi + off, d.dq.hi]) + EDGE,
    }  # fmt: skip


def _refusal(code: int, model: Model, path: Path, passed: Any, ds: float) -> str:
    joint, end = model.joints[max(passed.joint, 0)], path.length
    limit = model.robot.q_limit[max(passed.joint, 0)]
    said: Mapping[int, str] = {
        lib.STOPSET_PATH_ENDS: f"the path ends before braking begins (row {passed.begin:.4g} of {end:.4g}); it starts too fast: give a "
        "lower --path-rate",
        lib.STOPSET_PATH_BEYOND: f"the path takes {joint} beyond its limits [{limit[0]:.4g}, {limit[1]:.4g}] rad; give a path within them",
        lib.STOPSET_PATH_SPEED: f"the path is too fast: {joint} would pass its limit of {model.robot.dq_limit[max(passed.joint, 0)]:.4g} "
        "rad/s; give a lower --path-rate",
        lib.STOPSET_PATH_WEAK: f"the drive of {joint} has no torque left beside friction and disturbance; no ramp is provable",
        lib.STOPSET_PATH_FAST: f"the path starts too fast: at {ds:.4g} 1/s it cannot stop within its remaining {end - passed.begin:.4g} with "
        "the drives' torque",
        lib.STOPSET_PATH_SHORT: f"between its grid points the stop asks {-passed.room:.3g} N m more than a drive has: not credible; slow "
        "down",
    }  # fmt: skip
    return said[code]


def _judged(bounds: StopBounds, setting: Setting, ramp: Ramp, passed: Passed, out: list[Array]) -> StopBound:
    """The bound, or why there is none: outside the domain, no time to rest known, not held."""
    poses = passed.q
    read = poses - setting.truth.centre[: bounds.model.n]
    seen = (beyond_domain(bounds.model, q, v) for q, v in zip(read, passed.dq, strict=True))
    beyond = next((x for x in seen if x), None)
    if beyond and not bounds.extrapolate_state:
        return StopBound(
            "1", certified=False, why=f"not covered, the path leads there: {beyond}; {UNSEEN}", assumptions=setting.assumptions
        )
    if ramp.after is None:
        return StopBound("1", certified=False, why=NO_REST, assumptions=setting.assumptions)
    early = early_cut(ramp, float(out[0].max()))
    if early is not None:
        return StopBound("1", certified=False, why=early, assumptions=setting.assumptions)
    # wherever it is led: a ramp that begins early ends before the last pose
    near = ramp.q_error + setting.noise.radius[: bounds.model.n] + 0.5 * np.diff(passed.s).max() * passed.first
    margins = np.array([bounds.margin(q, near) for q in poses])
    margin = margins.min(axis=0)
    if margin.min() <= 0:
        return bounds.refused_for("1", margin, poses[int(np.argmin(margins.min(axis=1)))])
    bound = replace(_bound(bounds.model, setting, ramp, passed, out), holding_margin=margin)
    # the path itself stays within the joints' ranges; led along it the arm may not
    return bounds.marked(bounds.near_end_stops(bound, read[0], np.zeros(bounds.model.n)), beyond)


def _bound(model: Model, setting: Setting, ramp: Ramp, passed: Passed, out: list[Array]) -> StopBound:
    """The core's numbers ``out``, and the links' displacements and speeds over the poses ``passed``.

    What lies between two poses is within half their spacing of one of them; a chord is shorter than its arc, by no more than the
    bend of a point's path allows. The arm is beside these poses: see the core's `bound`.
    """
    time, forward, back, speed, tool = out
    robot, n = model.robot, model.n
    ends = np.array([_ends(model, setting, q) for q in passed.q])  # (P, n + 1, 3), the payload last
    reach = float(np.linalg.norm(robot.chain.p[1:], axis=1).sum() + max(map(np.linalg.norm, (setting.payload_com, robot.tip))))
    step, share, noise = np.diff(passed.s), setting.shares, setting.noise.radius[:n]
    travel = np.abs(passed.q - passed.q[0]).max(axis=0) + 0.5 * step.max() * passed.first
    slack = reach * float(
        np.sum(0.5 * step.max() * passed.first + ramp.q_error + travel * share) + noise.sum() * min(float(travel.sum()), 2.0)
    )
    moved = ends - ends[0]
    far = np.linalg.norm(moved, axis=2).max(axis=0) + slack
    turned = float(np.sum(passed.first * (1.0 + share)))
    bend = reach * float(turned**2 + passed.second.sum())
    beside = reach * float((ramp.q_error + noise).sum() * turned + np.sum(passed.first * share))
    moves = step > 0.0
    chord = np.linalg.norm(np.diff(ends, axis=0), axis=2)[moves] / step[moves, None]
    link_speed = passed.rate * (chord + step[moves, None] * bend + beside).max(axis=0) + reach * float(ramp.dq_error.sum())
    return StopBound(
        "1", certified=True, why="", time=time, forward=forward, back=back, speed=speed, tcp=float(tool[0]), tcp_speed=float(tool[1]),
        tcp_box=np.stack([moved[:, -1].min(axis=0) - slack, moved[:, -1].max(axis=0) + slack], axis=1),
        links=far[:-1], link_speed=link_speed[:-1], layer="ramp",
        assumptions=(
            *setting.assumptions, *ramp_assumptions(ramp, "1"),
            "the arm stays on its programmed path within the tracking error, braking as hard as the weakest drive allows",
        ),
    )  # fmt: skip


def _ends(model: Model, setting: Setting, q: Array) -> Array:
    """(n + 1, 3) [m]: the outer end of every link, then the payload."""
    chain = model.robot.chain
    R, o = link_frames(chain, q)
    return np.array([*o[1:], o[-1] + R[-1] @ model.robot.tip, o[-1] + R[-1] @ setting.payload_com])
