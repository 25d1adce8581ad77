"""How far, how long, where to, if the arm is stopped now: for tables and for every cycle of the monitor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stopset.artifact import Model
from stopset.errors import NotCovered
from stopset.reach.stops.cartesian import SLICES, point_motion, slices
from stopset.reach.stops.fast import Certificate
from stopset.reach.stops.local import ALL_PARTS, Parts
from stopset.reach.stops.plant import Setting, setting_of
from stopset.reach.stops.ramp import Cell, Ramp, failed_cells, infeasible, ramp_of, ramp_time, ramp_tube
from stopset.reach.stops.split import certify
from stopset.reach.stops.tube import OK, UNBOUNDED, Plant, Tube, march
from stopset.reach.stops.types import CATEGORIES, Category, StopBound
from stopset.robot.rigid import gravity_torque

Array = NDArray[np.float64]
KNOTS = 200  # time steps over the expected stop; the bound's time is coarse by one of them
PATIENCE = 6  # times the expected stop before a tube is called endless


def expected_stop(plant: Plant, q: Array, speed: Array) -> float:
    """Rough length of a stop [s], to choose the time step: engagement plus the slowest joint's deceleration."""
    engaged = float(np.max(plant.delay_hi + plant.rise_hi))
    M = plant.rotor + np.maximum(1e-3, np.abs(plant.pi[:, 0]) * 0.1)
    authority = plant.brake_lo + plant.coulomb_lo - np.abs(gravity_torque(plant.chain, plant.pi, q))
    authority = np.maximum(authority, 0.2 * plant.brake_lo + 1e-6)
    return engaged + float(np.min([0.5, np.max(np.abs(speed) * M / authority)]))


def tube_of(setting: Setting, q: Array, dq: Array, q_radius: Array, dq_radius: Array, parts: Parts = ALL_PARTS) -> Tube:
    """The STOP 0 tube from the box ``q +- q_radius, dq +- dq_radius`` (angles [rad], speeds [rad/s], (n,) each)."""
    return tubes_of(setting, q, dq, q_radius, dq_radius, 1, parts)[0]


def tubes_of(
    setting: Setting, q: Array, dq: Array, q_radius: Array, dq_radius: Array, pieces: int, parts: Parts = ALL_PARTS
) -> list[Tube]:
    """Tubes that together hold all stops from the box, up to ``pieces`` of them; the last is not OK if that failed."""
    lasts = expected_stop(setting.plant, q, np.abs(dq) + dq_radius)
    lo, hi, v_lo, v_hi = q - q_radius, q + q_radius, dq - dq_radius, dq + dq_radius

    def one(plant: Plant) -> Tube:
        tube: Tube = march(plant, lo, hi, v_lo, v_hi, lasts / KNOTS, PATIENCE * KNOTS, parts)
        return tube

    return certify(one, setting.plant, q, lasts, pieces)


def stopped_after(tube: Tube) -> Array:
    """(n,) [s]: the first knot from which each joint's speed bounds are zero."""
    moving = (tube.v_lo != 0.0) | (tube.v_hi != 0.0)
    last = np.where(moving.any(axis=0), len(tube.t) - 1 - np.argmax(moving[::-1], axis=0), -1)
    after: Array = tube.t[np.minimum(last + 1, len(tube.t) - 1)]
    return after


@dataclass(frozen=True, slots=True)
class StopBounds:
    """Stop bounds of one model, prepared: ``StopBounds.of(model)`` once, then ``bound(q, dq)`` every cycle.

    ``setting`` is None when the model knows no brakes: then no STOP 0 can be proved. ``ramp``: for categories 1 and 2;
    ``pieces``: how many tubes a hard case may be cut into (1 in a fast loop, 64 for tables).
    """

    model: Model
    setting: Setting | None
    ramp: Ramp | None
    pieces: int = 1

    @classmethod
    def of(
        cls, model: Model, payload: tuple[float, float] | None = None, payload_com: Array | None = None,
        ramp: Ramp | None = None, pieces: int = 1,
    ) -> StopBounds:  # fmt: skip
        """Prepare the bounds; ``payload`` [kg] range and ``payload_com`` (3,) [m] as in `setting_of`.

        ``ramp``: default what the model holds from stop1 recordings.
        """
        return cls(model, setting_of(model, payload, payload_com), ramp or ramp_of(model), pieces)

    def bound(self, q: ArrayLike, dq: ArrayLike, category: Category = "0") -> StopBound:
        """The stop from the measured state ``q`` [rad], ``dq`` [rad/s], (n,) each.

        Raises `NotCovered` for a state outside the robot's limits or of the wrong size.
        """
        if category not in CATEGORIES:
            raise NotCovered(f"stop category {category!r}; expected one of {', '.join(CATEGORIES)}")
        q, dq = self._checked(q, dq)
        if self.setting is None:
            return StopBound(category, False, NO_BRAKES)
        if category != "0" and self.ramp is None:
            return StopBound(category, False, NO_RAMP, assumptions=self.setting.assumptions)
        n, noise = self.model.n, self.setting.noise
        q, dq = q - noise.centre[:n], dq - noise.centre[n:]
        if category == "0":
            return self._power_off(q, dq, noise.radius[:n], noise.radius[n:])
        if category == "1 guaranteed":
            return self._failed_ramp(q, dq, noise.radius[:n], noise.radius[n:])
        return self._working_ramp(q, dq, noise.radius[:n], noise.radius[n:], category)

    def certify(self, q: ArrayLike, dq: ArrayLike, q_radius: Array, dq_radius: Array) -> Certificate | None:
        """A certificate for STOP 0 on a box of measured states, for a fast loop; None if one tube does not come to rest.

        ``q_radius`` [rad], ``dq_radius`` [rad/s]: (n,) half-widths for the state to move in, measurement noise on top.
        """
        if self.setting is None:
            return None
        q, dq = self._checked(q, dq)
        n, noise = self.model.n, self.setting.noise
        q, dq = q - noise.centre[:n], dq - noise.centre[n:]
        q_radius, dq_radius = q_radius + noise.radius[:n], dq_radius + noise.radius[n:]
        tube = tube_of(self.setting, q, dq, q_radius, dq_radius)
        if tube.end != OK:
            return None
        return Certificate(tube, q, dq, q_radius, dq_radius, noise.radius[:n], noise.radius[n:])

    def _checked(self, q: ArrayLike, dq: ArrayLike) -> tuple[Array, Array]:
        robot, n = self.model.robot, self.model.n
        q, dq = np.array(q, float), np.array(dq, float)
        if q.shape != (n,) or dq.shape != (n,) or not (np.all(np.isfinite(q)) and np.all(np.isfinite(dq))):
            raise NotCovered(f"state of {q.size} angles and {dq.size} speeds; expected {n} finite numbers each")
        out = (q < robot.q_limit[:, 0]) | (q > robot.q_limit[:, 1])
        if np.any(out):
            i = int(np.argmax(out))
            raise NotCovered(
                f"{robot.joints[i]} at {q[i]:.4g} rad is beyond its limits [{robot.q_limit[i, 0]:.4g}, "
                f"{robot.q_limit[i, 1]:.4g}] rad; give a pose within them"
            )
        return q, dq

    def _power_off(self, q: Array, dq: Array, q_radius: Array, dq_radius: Array) -> StopBound:
        assert self.setting is not None
        tubes = tubes_of(self.setting, q, dq, q_radius, dq_radius, self.pieces)
        if tubes[-1].end != OK:
            return StopBound(
                "0", False, self._why(tubes[-1], q), holding_margin=self._margin(q), assumptions=self.setting.assumptions
            )
        margin = np.min([t.margin for t in tubes], axis=0)
        time = np.max([stopped_after(t) for t in tubes], axis=0)
        return self._told("0", tubes, time, q, q_radius, margin, self.setting.assumptions)

    def _working_ramp(self, q: Array, dq: Array, q_radius: Array, dq_radius: Array, category: Category) -> StopBound:
        assert self.setting is not None and self.ramp is not None
        ramp, plant = self.ramp, self.setting.plant
        assumptions = (*self.setting.assumptions, *ramp_assumptions(ramp, category))
        fast = np.abs(dq) + dq_radius
        extra = plant.coulomb_hi + plant.viscous_hi * fast + np.maximum(np.abs(plant.u_lo), np.abs(plant.u_hi))
        bodies = (plant.pi - plant.pi_half, plant.pi + plant.pi_half)
        refusal = infeasible(self.model, ramp, bodies, plant.rotor, extra, q, dq)
        margin = self._margin(q)
        if refusal:
            return StopBound(category, False, refusal, holding_margin=margin, assumptions=assumptions)
        tube = ramp_tube(ramp, dq - dq_radius, dq + dq_radius)
        if category == "2":
            after = (tube.t > 0)[:, None] * ramp.window
            tube = tube._replace(d_lo=tube.d_lo - after, d_hi=tube.d_hi + after)
            assumptions = (*assumptions, self._fallback(q, tube))
        elif margin.min() <= 0:
            return StopBound(category, False, self._why(tube, q), holding_margin=margin, assumptions=assumptions)
        return self._told(
            category, [tube], ramp_time(ramp, dq - dq_radius, dq + dq_radius), q, q_radius, margin, assumptions
        )  # fmt: skip

    def _fallback(self, q: Array, tube: Tube) -> str:
        """What follows if the standstill window of a STOP 2 is left: a STOP 0 from the creeping speed."""
        assert self.setting is not None and self.ramp is not None
        n = self.model.n
        middle, radius = 0.5 * (tube.d_lo[-1] + tube.d_hi[-1]), 0.5 * (tube.d_hi[-1] - tube.d_lo[-1])
        creep = np.full(n, self.ramp.creep)
        tubes = tubes_of(self.setting, q + middle, np.zeros(n), radius, creep, self.pieces)
        if tubes[-1].end != OK:
            return "if the standstill window is left: STOP 0, for which no bound is proved here"
        angle = max(float(np.maximum(t.d_hi.max(), -t.d_lo.min())) for t in tubes)
        time = max(float(stopped_after(t).max()) for t in tubes)
        return (
            f"if the standstill window is left, noticed below {self.ramp.creep:g} rad/s: STOP 0, which adds at most "
            f"{angle:.4g} rad and {time:.4g} s"
        )

    def _failed_ramp(self, q: Array, dq: Array, q_radius: Array, dq_radius: Array) -> StopBound:
        assert self.setting is not None and self.ramp is not None
        ramp = self.ramp
        assumptions = (*self.setting.assumptions, *ramp_assumptions(ramp, "1 guaranteed"))
        cells = failed_cells(ramp, dq)
        if not cells:
            return StopBound(
                "1 guaranteed", False,
                "no stop provable: nothing says when power is taken if the ramp fails; state the SS1-t time or a monitored ramp",
                holding_margin=self._margin(q), assumptions=assumptions,
            )  # fmt: skip
        tubes: list[Tube] = []
        time = np.zeros(self.model.n)
        margin = np.full(self.model.n, np.inf)
        for cell in cells:
            before, here, speed = _state_of(cell, dq, q_radius, dq_radius, ramp)
            parts = tubes_of(self.setting, q + here[0], speed[0], here[1], speed[1], self.pieces)
            if parts[-1].end != OK:
                why = self._why(parts[-1], q + here[0])
                return StopBound("1 guaranteed", False, why, holding_margin=self._margin(q), assumptions=assumptions)
            for part in parts:
                time = np.maximum(time, cell.time + stopped_after(part))
                margin = np.minimum(margin, part.margin)
                # displacement since the request: where the cell lies, then the tube
                tubes.append(part._replace(d_lo=part.d_lo + before[0], d_hi=part.d_hi + before[1]))
        return self._told("1 guaranteed", tubes, time, q, q_radius, margin, assumptions)

    def _told(
        self, category: Category, tubes: list[Tube], time: Array, q: Array, q_radius: Array, margin: Array,
        assumptions: tuple[str, ...],
    ) -> StopBound:  # fmt: skip
        """The bound in words of joints and space, over all ``tubes`` of displacement since the stop request."""
        assert self.setting is not None
        robot, n = self.model.robot, self.model.n
        ends = [robot.chain.p[i + 1] if i + 1 < n else robot.tip for i in range(n)]
        tcp, tcp_speed, box, links = 0.0, 0.0, np.zeros((3, 2)), np.zeros(n)
        for tube in tubes:
            cut = slices(tube, SLICES)
            far, fast, hull = point_motion(robot.chain, q, q_radius, cut, n - 1, self.setting.payload_com)
            tcp, tcp_speed = max(tcp, far), max(tcp_speed, fast)
            box[:, 0], box[:, 1] = np.minimum(box[:, 0], hull[:, 0]), np.maximum(box[:, 1], hull[:, 1])
            moved = [point_motion(robot.chain, q, q_radius, cut, i, ends[i])[0] for i in range(n)]
            links = np.maximum(links, moved)
        return StopBound(
            category, True, "", time=time,
            forward=np.maximum(np.max([t.d_hi.max(axis=0) for t in tubes], axis=0), 0.0),
            back=np.maximum(-np.min([t.d_lo.min(axis=0) for t in tubes], axis=0), 0.0),
            speed=np.max([np.maximum(np.abs(t.v_lo), np.abs(t.v_hi)).max(axis=0) for t in tubes], axis=0),
            tcp=tcp, tcp_speed=tcp_speed, tcp_box=box, links=links, holding_margin=margin, assumptions=assumptions,
        )  # fmt: skip

    def _margin(self, q: Array) -> Array:
        """(n,) [N m]: what brakes and dry friction surely leave over when holding the arm at ``q``."""
        assert self.setting is not None
        p = self.setting.plant
        g = [gravity_torque(p.chain, p.pi + s * p.pi_half, q) for s in (-1.0, 1.0)]
        low, high = np.minimum(*g) - p.u_hi, np.maximum(*g) - p.u_lo
        out: Array = p.brake_lo + p.coulomb_lo - np.maximum(np.abs(low), np.abs(high))
        return out

    def _why(self, tube: Tube, q: Array) -> str:
        margin = self._margin(q)
        worst = int(np.argmin(margin))
        if margin[worst] <= 0:
            return (
                f"no stop provable: brake and friction of {self.model.joints[worst]} hold {-margin[worst]:.3g} N m less than "
                f"gravity and disturbance can ask"
            )
        if tube.end == UNBOUNDED:
            return f"no certificate: the speeds could not be bounded any more {tube.t[-1] * 1e3:.0f} ms after the cut"
        return f"no certificate: the bound is still moving {tube.t[-1] * 1e3:.0f} ms after the cut"


def _state_of(
    cell: Cell, dq: Array, q_radius: Array, dq_radius: Array, ramp: Ramp
) -> tuple[tuple[Array, Array], tuple[Array, Array], tuple[Array, Array]]:
    """Displacement (lo, hi) before a cell's power-off, and its box of positions and speeds as (middle, radius)."""
    (a, b), (s, r) = cell.travel, cell.share
    lo, hi = np.minimum(a * dq, b * dq) - b * dq_radius, np.maximum(a * dq, b * dq) + b * dq_radius
    lo, hi = lo - ramp.q_error, hi + ramp.q_error
    v_lo, v_hi = np.minimum(s * dq, r * dq) - r * dq_radius, np.maximum(s * dq, r * dq) + r * dq_radius
    v_lo, v_hi = v_lo - ramp.dq_error, v_hi + ramp.dq_error
    return (
        (lo, hi), (0.5 * (lo + hi), 0.5 * (hi - lo) + q_radius), (0.5 * (v_lo + v_hi), 0.5 * (v_hi - v_lo)),
    )  # fmt: skip


def ramp_assumptions(ramp: Ramp, category: Category) -> tuple[str, ...]:
    """What the bound of a ramp rests on, in sentences."""
    unit = "s" if ramp.kind == "time" else "rad/s^2"
    out = [
        f"ramp ({ramp.source}): fixed {ramp.kind} {ramp.value.lo.min():.4g} to {ramp.value.hi.max():.4g} {unit}, starts "
        f"{1e3 * ramp.control.lo.min():.3g} to {1e3 * ramp.control.hi.max():.3g} ms after the request, tracked within "
        f"{ramp.q_error.max():.3g} rad and {ramp.dq_error.max():.3g} rad/s"
    ]
    if category == "1":
        out.append("the ramp works, and the brakes have engaged before power is taken")
    if category == "1 guaranteed":
        when = "when the monitored ramp is left (SS1-r)" if ramp.monitored else f"{ramp.off_after} s after the request (SS1-t)"
        out.append(
            f"the ramp fails as a whole: the arm goes on along its motion with 0 to {ramp.share:g} of its speed until power is "
            f"taken {when}"
        )
    if category == "2":
        out.append(f"the ramp works and the drives hold within {ramp.window:g} rad")
    return tuple(out)


NO_BRAKES = (
    "no stop provable: the model holds no brake torque, delay and rise for every joint; give them in robot.json or identify "
    "them from stop0 recordings"
)
NO_RAMP = (
    "no ramp known: the model holds none from stop1 recordings; state its time (--ramp-time) or deceleration "
    "(--ramp-deceleration)"
)


def stop(model: Model, q: ArrayLike, dq: ArrayLike, category: Category = "0") -> StopBound:
    """The bound of one stop from a measured state; for many states prepare `StopBounds` once."""
    return StopBounds.of(model).bound(q, dq, category)
