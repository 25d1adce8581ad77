"""How far, how long, where to, if the arm is stopped now: STOP 0 from a state, for tables and for every cycle of the monitor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stopset.artifact import Model
from stopset.errors import NotCovered
from stopset.reach.stops.cartesian import SLICES, point_motion, slices
from stopset.reach.stops.plant import Setting, setting_of
from stopset.reach.stops.local import ALL_PARTS, Parts
from stopset.reach.stops.tube import OK, UNBOUNDED, Plant, Tube, march
from stopset.reach.stops.types import Category, StopBound
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
    h = expected_stop(setting.plant, q, np.abs(dq) + dq_radius) / KNOTS
    return march(
        setting.plant, q - q_radius, q + q_radius, dq - dq_radius, dq + dq_radius, h, PATIENCE * KNOTS, parts
    )  # fmt: skip


def stopped_after(tube: Tube) -> Array:
    """(n,) [s]: the first knot from which each joint's speed bounds are zero."""
    moving = (tube.v_lo != 0.0) | (tube.v_hi != 0.0)
    last = np.where(moving.any(axis=0), len(tube.t) - 1 - np.argmax(moving[::-1], axis=0), -1)
    return tube.t[np.minimum(last + 1, len(tube.t) - 1)]


@dataclass(frozen=True, slots=True)
class StopBounds:
    """Stop bounds of one model, prepared: ``StopBounds.of(model)`` once, then ``bound(q, dq)`` every cycle.

    ``setting`` is None when the model knows no brakes: then no stop can be proved.
    """

    model: Model
    setting: Setting | None

    @classmethod
    def of(
        cls, model: Model, payload: tuple[float, float] | None = None, payload_com: Array | None = None
    ) -> StopBounds:
        """Prepare the bounds; ``payload`` [kg] range and ``payload_com`` (3,) [m] as in `setting_of`."""
        return cls(model, setting_of(model, payload, payload_com))

    def bound(self, q: ArrayLike, dq: ArrayLike, category: Category = "0") -> StopBound:
        """The stop from the measured state ``q`` [rad], ``dq`` [rad/s], (n,) each.

        Raises `NotCovered` for a state outside the robot's limits or of the wrong size.
        """
        q, dq = self._checked(q, dq)
        if self.setting is None:
            return StopBound(
                category, False,
                "the model holds no brake torque, delay and rise for every joint; give them in robot.json or identify them "
                "from stop0 recordings",
            )  # fmt: skip
        if category != "0":
            raise NotCovered(f"category {category!r} needs a ramp; expected '0' here")
        n = self.model.n
        noise = self.setting.noise
        q_mid, dq_mid = q - noise.centre[:n], dq - noise.centre[n:]
        tube = tube_of(self.setting, q_mid, dq_mid, noise.radius[:n], noise.radius[n:])
        return self._from_tube(tube, q_mid, noise.radius[:n], category)

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

    def _from_tube(self, tube: Tube, q: Array, q_radius: Array, category: Category) -> StopBound:
        assert self.setting is not None
        robot, assumptions = self.model.robot, self.setting.assumptions
        if tube.end != OK:
            return StopBound(
                category, False, self._why(tube, q), holding_margin=self._margin(q), assumptions=assumptions
            )
        cut = slices(tube, SLICES)
        n = robot.n
        tcp, tcp_speed, box = point_motion(robot.chain, q, q_radius, cut, n - 1, self.setting.payload_com)
        ends = [robot.chain.p[i + 1] if i + 1 < n else robot.tip for i in range(n)]
        links = np.array([point_motion(robot.chain, q, q_radius, cut, i, ends[i])[0] for i in range(n)])
        return StopBound(
            category, True, "",
            time=stopped_after(tube), forward=np.maximum(tube.d_hi.max(axis=0), 0.0),
            back=np.maximum(-tube.d_lo.min(axis=0), 0.0),
            speed=np.maximum(np.abs(tube.v_lo), np.abs(tube.v_hi)).max(axis=0),
            tcp=tcp, tcp_speed=tcp_speed, tcp_box=box, links=links, holding_margin=tube.margin, assumptions=assumptions,
        )  # fmt: skip

    def _margin(self, q: Array) -> Array:
        """(n,) [N m]: what brakes and dry friction surely leave over when holding the arm at ``q``."""
        assert self.setting is not None
        p = self.setting.plant
        g = [gravity_torque(p.chain, p.pi + s * p.pi_half, q) for s in (-1.0, 1.0)]
        low, high = np.minimum(*g) - p.u_hi, np.maximum(*g) - p.u_lo
        return p.brake_lo + p.coulomb_lo - np.maximum(np.abs(low), np.abs(high))

    def _why(self, tube: Tube, q: Array) -> str:
        margin = self._margin(q)
        worst = int(np.argmin(margin))
        if margin[worst] <= 0:
            return (
                f"no stop provable: brake and friction of {self.model.joints[worst]} hold {margin[worst]:.3g} N m less than "
                f"gravity and disturbance can ask"
            )
        if tube.end == UNBOUNDED:
            return f"no certificate: accelerations could not be enclosed {tube.t[-1] * 1e3:.0f} ms after the cut"
        return f"no certificate: the bound is still moving {tube.t[-1] * 1e3:.0f} ms after the cut"


def stop(model: Model, q: ArrayLike, dq: ArrayLike, category: Category = "0") -> StopBound:
    """The bound of one stop from a measured state; for many states prepare `StopBounds` once."""
    return StopBounds.of(model).bound(q, dq, category)
