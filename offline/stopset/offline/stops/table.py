"""Stop-time and stop-distance tables as ISO 10218-1 asks: three axes, 33/66/100 % speed, payload and extension.

One axis moves at a time, from the pose near the extension where gravity loads it most; the three axes are those that move the
tool centre point fastest.  Rows with all three axes at once stand beside them, since several axes together can take longer.
Each number of a row holds in every direction, whichever is the worst for it; and from its pose: others of the extension may be worse.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from stopset.artifact import Model
from stopset.errors import NotCovered
from stopset.offline.stops.directions import hull, in_every_direction
from stopset.offline.stops.poses import Poses
from stopset.progress import Progress, counted, silent
from stopset.reach.stops import CATEGORIES, Category, Ramp, StopBound, StopBounds
from stopset.reach.stops.failed import TABLE_TUBES
from stopset.reach.stops.setting import HEAVIEST, beyond_payload
from stopset.reach.stops.start import NONE, Extrapolation
from stopset.types import Array

SHARES = (33, 66, 100)
PIECES = 64
ONE_POSE = (
    "each row is of one pose, among those near its extension the one where gravity loads its axis most; from another pose of the same "
    "extension the arm may go farther: ask for it with --at, or for the worst of several with --poses"
)
MOST_POSES = 100
LIGHTEST = 1e-3  # [kg] of a rated payload
LOAD_TOLERANCE = 0.02  # of the largest payload: how well a stated payload is known


@dataclass(frozen=True, slots=True)
class StopRow:
    """One line of a table. ``joint``: the axis, or several joined by '+'; numbers are None where nothing can be proved.

    ``extrapolated``: where filled, the numbers are beyond what recordings have seen, as it says, and not certified.
    """

    category: Category
    joint: str
    speed_percent: float
    payload_percent: float
    extension_percent: float
    speed: float  # [rad/s] of the axis, in the direction in which it turns farthest
    payload: float  # [kg]
    time_s: float | None
    angle_rad: float | None
    tcp_m: float | None
    tcp_speed: float | None
    certified: bool
    why: str
    pose: tuple[float, ...] = ()  # [rad] all joints at the stop request
    far_m: float | None = None  # [m] displacement of whichever goes farthest, the tool or the end of a link
    far_speed: float | None = None  # [m/s] the fastest of them
    margin: tuple[float, ...] = ()  # [N m] holding margin of each joint, the least of all directions
    fallback: tuple[float, float] | None = None  # STOP 2: (rad, s) that a STOP 0 adds if the standstill window is left
    extrapolated: str = ""
    assumptions: tuple[str, ...] = ()  # of this row
    end_stops: tuple[str, ...] = ()  # joints that can strike the end of their range, after which the numbers say nothing
    # (P, 7) [m] capsules around what the links sweep, in the direction in which the tool goes farthest
    swept: Array | None = field(default=None, repr=False, compare=False)

    @property
    def answered(self) -> bool:
        """Whether there are numbers, certified or extrapolated."""
        return self.time_s is not None

    def as_json(self) -> dict[str, Any]:
        """With the keys that others rely on; an extrapolated row says so, with what it rests on."""
        keys = (
            "category", "joint", "speed_percent", "payload_percent", "extension_percent", "time_s", "angle_rad", "tcp_m",
            "certified", "why",
        )  # fmt: skip
        row = {k: getattr(self, k) for k in keys} | {"end_stops": list(self.end_stops)}
        return row | {"extrapolated": True, "assumptions": list(self.assumptions)} if self.extrapolated else row


@dataclass(frozen=True, slots=True)
class Question:
    """What a table is asked for."""

    ramp: Ramp | None = None
    categories: tuple[Category, ...] = CATEGORIES
    payload: float | None = None  # [kg] instead of 33/66/100 % of the largest
    payload_com: Array | None = None
    rated: float | None = None  # [kg] what 100 % payload means, default the largest of the model's domain
    extrapolate: Extrapolation = (
        NONE  # what beyond the domain is computed and marked; else payloads are refused, states not covered
    )
    poses: int = 1  # near each extension, of which a row is the worst


@dataclass(frozen=True, slots=True)
class Table:
    """Rows, and what they rest on."""

    rows: tuple[StopRow, ...]
    assumptions: tuple[str, ...]
    top_speed: Array  # (n,) [rad/s] what 100 % means
    reach: float  # [m]


def top_speed(model: Model) -> Array:
    """(n,) [rad/s]: 100 % speed: the robot's limit, or the fastest the model has seen if that is less (trap P25)."""
    seen = np.maximum(np.abs(model.domain.dq.lo), np.abs(model.domain.dq.hi))
    return np.minimum(model.robot.dq_limit, np.where(seen > 0, seen, np.inf))


def loads(model: Model, question: Question) -> list[tuple[float, float]]:
    """(percent, kg) of the payloads of a table. Raises `NotCovered` beyond the model's domain, unless extrapolated."""
    lo, hi = model.domain.payload
    top = hi if question.rated is None else question.rated
    if question.rated is not None and not LIGHTEST <= question.rated <= HEAVIEST:
        raise NotCovered(
            f"a rated payload of {question.rated:g} kg; expected {LIGHTEST:g} to {HEAVIEST:g} kg: give what 100 % payload means in kg"
        )
    if question.payload is not None:
        chosen = [(100.0 * question.payload / top if top > 0 else 100.0 * (question.payload > 0), question.payload)]
    elif top <= 0:
        chosen = [(0.0, 0.0)]
    else:
        chosen = [(float(s), max(lo, top * s / 100.0)) for s in SHARES]
    for _, kg in chosen:
        if not 0.0 <= kg <= HEAVIEST:
            raise NotCovered(
                f"a payload of {kg:g} kg; expected a mass of at least 0 kg and at most {HEAVIEST:g} kg: give it in kg"
            )
        if not (question.extrapolate.payload or lo - 1e-9 <= kg <= hi + 1e-9):
            raise NotCovered(beyond_payload(kg, kg, (lo, hi)))
    return chosen


def prepared(model: Model, kg: float, question: Question) -> StopBounds:
    """Bounds for one payload, known within `LOAD_TOLERANCE`."""
    lo, hi = model.domain.payload
    if lo - 1e-9 <= kg <= hi + 1e-9:
        slack = LOAD_TOLERANCE * hi
        between = max(lo, kg - slack), min(hi, kg + slack)
    else:
        between = kg * (1.0 - LOAD_TOLERANCE), kg * (1.0 + LOAD_TOLERANCE)
    return StopBounds.of(model, between, question.payload_com, question.ramp, PIECES, extrapolate=question.extrapolate)


def three_axes(model: Model, poses: Poses, speed: Array) -> list[int]:
    """The axes that move the tool centre point fastest at full extension (all of a smaller arm)."""
    q = poses.q[int(np.argmax(poses.extension))]
    step = 1e-6
    base = _tip(model, q, poses.tip)
    pace = [
        float(np.linalg.norm(_tip(model, q + step * np.eye(model.n)[j], poses.tip) - base)) / step * speed[j]
        for j in range(model.n)
    ]
    # an axis along the stretched arm moves nothing there: its lever is that of the bent arm, which the poses contain
    return sorted(np.argsort(pace)[::-1][:3].tolist())


def _tip(model: Model, q: Array, tip: Array) -> Array:
    from stopset.robot.rigid import link_frames

    R, o = link_frames(model.robot.chain, q)
    out: Array = o[-1] + R[-1] @ tip
    return out


class StopCase(NamedTuple):
    """A payload [% and kg], an extension [%] and the axes that move: rows of every speed and category."""

    percent: float
    kg: float
    extension: int
    group: tuple[int, ...]


Asked = tuple[
    Array, list[list[tuple[StopBound, Array]]]
]  # a pose, and for each share of the speed what `in_every_direction` says


def few_poses(count: int) -> str:
    """What rows of several poses are."""
    return (
        f"each row is the worst of {count} poses near its extension, each of its numbers for itself: that in which gravity loads its axis most, "
        "those with the longest lever and the most inertia about it, others far from these; from yet another pose the arm may go farther: ask for "
        "it with --at"
    )


def worst_pose(found: Sequence[tuple[Array, StopBound, Array]]) -> tuple[Array, StopBound, Array]:
    """Of poses with their bounds and speeds the one from which the tool goes farthest and what links sweep from there, with the largest of
    all numbers; without any where one has none."""
    q, first, dq = max(found, key=lambda x: np.inf if x[1].tcp is None else x[1].tcp)
    return q, replace(hull(first, [b for _, b, _ in found]), capsules=first.capsules) if len(found) > 1 else first, dq


def stop_table(model: Model, question: Question, progress: Progress = silent) -> Table:
    """The whole table; ``progress`` is given how far it is. Raises `NotCovered` for what no table can be asked."""
    if not 1 <= question.poses <= MOST_POSES:
        raise NotCovered(
            f"rows of the worst of {question.poses} poses; expected 1 to {MOST_POSES}: say near how many of each extension the arm is stopped"
        )
    tip = model.robot.tip if question.payload_com is None else question.payload_com
    poses = Poses.of(model.robot, tip, model.domain.q)
    speed = top_speed(model)
    axes = three_axes(model, poses, speed)
    rows: list[StopRow] = []
    assumptions: tuple[str, ...] = ()
    cases = [
        StopCase(percent, kg, extension, tuple(group))
        for percent, kg in loads(model, question)
        for extension in SHARES
        for group in [*([j] for j in axes), axes]
        if len(group) == 1 or extension == 100
    ]
    ready = {kg: replace(prepared(model, kg, question), tubes=TABLE_TUBES) for _, kg in loads(model, question)}
    outside: set[str] = set()

    def tried(case: StopCase) -> list[Array]:
        setting, group = ready[case.kg].setting, case.group
        pi = setting.plant.pi if setting is not None else model.robot.pi
        joint = group[-1] if len(group) == 1 else group[1 % len(group)]
        return poses.worst_few(joint, case.extension / 100.0, pi, question.poses)

    asked = [(case, q) for case in cases for q in tried(case)]
    found: dict[StopCase, list[Asked]] = {}
    for case, q in counted(asked, len(asked), "stop bounds", progress):
        bounds = [in_every_direction(ready[case.kg], q, case.group, speed * s / 100.0, question.categories) for s in SHARES]
        found.setdefault(case, []).append((q, bounds))
    for case, of_poses in found.items():
        for q, _ in of_poses:
            outside |= {model.joints[j] for j in np.flatnonzero((q < model.domain.q.lo) | (q > model.domain.q.hi))}
        for k, share in enumerate(SHARES):
            for c in range(len(question.categories)):
                q, bound, dq = worst_pose([(q, *bounds[k][c]) for q, bounds in of_poses])
                rows.append(_row(model, bound, case.group, q, dq, Shares(share, case.percent, case.kg, case.extension)))
                stated = tuple(a for a in bound.assumptions if a not in bound.here)
                assumptions += tuple(a for a in stated if a not in assumptions)
    order = {c: i for i, c in enumerate(CATEGORIES)}
    rows.sort(key=lambda r: (order[r.category], r.joint, r.payload_percent, r.extension_percent, r.speed_percent))
    limits = ", ".join(f"{j} {v:.3g}" for j, v in zip(model.joints, speed, strict=True))
    assumptions += (f"100 % speed is, in rad/s, the smaller of data sheet and identified domain: {limits}",)
    assumptions += (ONE_POSE if question.poses == 1 else few_poses(question.poses),)
    if model.domain.payload[1] <= 0 and question.rated is None and question.payload is None:
        assumptions += (
            "no recording carried a payload, so every row is without; --rated-payload KG --extrapolate-payload computes 33/66/100 % of it",
        )
    if outside:
        names = ", ".join(sorted(outside))
        what = (
            f"EXTRAPOLATED POSES: {names} lie outside the angles of the recordings in some test poses; there the rigid body is computed, "
            "and friction and U are taken not to change"
            if question.extrapolate.state
            else f"no recording shows {names} at the angles of some test poses: those are not covered"
        )
        assumptions += (what,)
    return Table(tuple(rows), assumptions, speed, poses.reach)


@dataclass(frozen=True, slots=True)
class Shares:
    """In percent, of the largest each: speed, payload (``kg`` of it) and extension of one row."""

    speed: float
    payload: float
    kg: float
    extension: float


def _row(model: Model, bound: StopBound, group: Sequence[int], q: Array, dq: Array, of: Shares) -> StopRow:
    angle = bound.angle
    far = bound.tcp if bound.tcp is None or bound.links is None else max(bound.tcp, float(bound.links.max()))
    fast = bound.tcp_speed
    if fast is not None and bound.link_speed is not None:
        fast = max(fast, float(bound.link_speed.max()))
    return StopRow(
        category=bound.category, joint="+".join(model.joints[j] for j in group), speed_percent=float(of.speed),
        payload_percent=of.payload, extension_percent=float(of.extension), speed=float(dq[group[0]]), payload=of.kg,
        time_s=None if bound.time is None else _up(float(bound.time.max())),
        angle_rad=None if angle is None else _up(float(angle[list(group)].max())),
        tcp_m=None if bound.tcp is None else _up(bound.tcp), tcp_speed=bound.tcp_speed, certified=bound.certified,
        why=bound.why, pose=tuple(map(float, q)), far_m=far, far_speed=fast,
        margin=() if bound.holding_margin is None else tuple(map(float, bound.holding_margin)), fallback=bound.fallback,
        extrapolated=bound.extrapolated if bound.time is not None else "", assumptions=bound.assumptions,
        end_stops=bound.end_stops, swept=None if bound.capsules is None else bound.capsules.reshape(-1, 7),
    )  # fmt: skip


def farthest(rows: Sequence[StopRow]) -> StopRow | None:
    """The row whose flange goes farthest; None where no row has a number and a pose."""
    provable = [r for r in rows if r.tcp_m is not None and r.pose]
    return max(provable, key=lambda r: r.tcp_m or 0.0, default=None)


def _up(x: float, digits: int = 6) -> float:
    """Rounded outward, so that a printed number is still a bound."""
    return float(np.ceil(x * 10**digits) / 10**digits)


def at_pose(model: Model, q: Array, dq: Array, question: Question) -> tuple[list[StopRow], dict[Category, StopBound]]:
    """Rows for one pose and the speeds of all axes at once: one per joint and category, and the bounds behind them.

    Raises `NotCovered` for a state beyond the data sheet's limits or a payload outside the domain.
    """
    limit, sheet = top_speed(model), model.robot.dq_limit
    if np.any(np.abs(dq) > sheet * (1 + 1e-9)):
        j = int(np.argmax(np.abs(dq) / sheet))
        raise NotCovered(
            f"{model.joints[j]} at {dq[j]:.4g} rad/s is beyond its limit of {sheet[j]:.4g} rad/s; give a speed within it"
        )
    tip = model.robot.tip if question.payload_com is None else question.payload_com
    percent, kg = loads(model, question)[-1]
    bounds = prepared(model, kg, question)
    found = {c: bounds.bound(q, dq, c) for c in question.categories}
    extension = 100.0 * Poses.of(model.robot, tip, model.domain.q).extension_of(q)
    rows = []
    for bound in found.values():
        for j in range(model.n):
            row = _row(model, bound, [j], q, dq, Shares(100.0 * abs(dq[j]) / limit[j], percent, kg, extension))
            own = None if bound.time is None else _up(float(bound.time[j]))
            rows.append(replace(row, speed=float(dq[j]), time_s=own))
    return rows, found


def along_path(
    model: Model, waypoints: Array, start: float, rate: float, question: Question
) -> tuple[list[StopRow], dict[Category, StopBound]]:
    """Rows of a STOP 1 that stays on the path through ``waypoints`` (W, n) [rad], from ``s = start`` (s counts them) at ``rate`` [1/s].

    Raises `NotCovered` for a path beyond the limits or one that starts too fast to be stopped on.
    """
    from stopset.reach.stops.path import Path, path_stop

    percent, kg = loads(model, question)[-1]
    ready = prepared(model, kg, question)
    # of a ramp only its control delay, tracking errors and settling count here
    ready = replace(ready, ramp=ready.ramp or Ramp.stated(model.n, time=1.0))
    path = Path.through(waypoints)
    found = path_stop(ready, path, start, rate)
    q, dq = path.p(np.array([start]), 0)[0], path.p(np.array([start]), 1)[0] * rate
    tip = model.robot.tip if question.payload_com is None else question.payload_com
    extension = 100.0 * Poses.of(model.robot, tip, model.domain.q).extension_of(q)
    limit = top_speed(model)
    rows = [
        replace(
            _row(model, found.bound, [j], q, dq, Shares(100.0 * abs(dq[j]) / limit[j], percent, kg, extension)), speed=float(dq[j])
        )
        for j in range(model.n)
    ]  # fmt: skip
    return rows, {"1": found.bound}


def holding(model: Model, rows: Sequence[StopRow]) -> list[str]:
    """Holding margins in words, for each payload the least of all poses: how much more than it must each joint surely holds."""
    out = []
    for kg in sorted({r.payload for r in rows if r.margin}):
        least = np.min([r.margin for r in rows if r.payload == kg and r.margin], axis=0)
        each = ", ".join(f"{j} {-_up(-m, 1):.1f}" for j, m in zip(model.joints, least, strict=True))
        out.append(f"holding margin of brakes and dry friction with {kg:g} kg, least of all rows [N m]: {each}")
    left = [r.fallback for r in rows if r.fallback is not None]
    if left:
        out.append(
            f"STOP 2, standstill window left: the STOP 0 that follows adds at most {_up(max(x[0] for x in left), 3):.3f} rad and "
            f"{_up(max(x[1] for x in left), 3):.3f} s, worst of all rows"
        )
    return out


def as_csv(rows: Sequence[StopRow]) -> str:
    """The rows as a CSV with units in its head."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    out.writerow(
        ["category", "joint", "speed [%]", "speed [rad/s]", "payload [%]", "payload [kg]", "extension [%]", "time [s]",
         "angle [rad]", "TCP [m]", "TCP speed [m/s]", "certified", "why", "pose [rad]", "holding margin [N m]", "extrapolated"]
    )  # fmt: skip
    for r in rows:
        out.writerow(
            [r.category, r.joint, r.speed_percent, r.speed, r.payload_percent, r.payload, r.extension_percent, r.time_s,
             r.angle_rad, r.tcp_m, r.tcp_speed, r.certified, r.why, " ".join(f"{x:.4f}" for x in r.pose),
             " ".join(f"{-_up(-x, 2):.2f}" for x in r.margin), r.extrapolated]
        )  # fmt: skip
    return text.getvalue()
