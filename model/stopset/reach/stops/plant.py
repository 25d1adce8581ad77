"""From the model file to what bounds a stop: every parameter as an interval, every widening stated as an assumption."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.effects.bound import SIGMAS
from stopset.errors import NotCovered
from stopset.reach.stops.brakes import brakes_of
from stopset.reach.stops.friction import FRICTION_TOLERANCE, Torques, described, misreadings, torques_of
from stopset.reach.stops.payload import bodies
from stopset.reach.stops.tube import Plant
from stopset.robot.rigid import mass_matrix
from stopset.sets import Box

Array = NDArray[np.float64]
STANDSTILL = 1.5  # how much larger the error of a speed may be in motion than at standstill
OUTSIDE = "EXTRAPOLATED STATE, outside the identified domain"


def rotor_of(model: Model) -> Box:
    """(n,) reflected rotor inertia: a point where torque told the rigid body apart from it.

    With compensated torque the identified inertia of each joint and the data sheet's are two opinions; both are in the box.
    """
    stated = np.array(model.rotor, float)
    if model.effort != "compensated_torque" or model.abstraction.kind != 1:
        return Box.point(stated)
    q = np.clip(model.domain.q.centre, model.robot.q_limit[:, 0], model.robot.q_limit[:, 1])
    rigid = np.diag(mass_matrix(model.robot.chain, model.robot.pi, q))
    seen = np.maximum(1.0 / np.diag(model.abstraction.Minv) - rigid, 1e-3)
    return Box(np.minimum(stated, seen), np.maximum(stated, seen))


@dataclass(frozen=True, slots=True)
class Setting:
    """A plant with its names: everything the bounds of a model and a payload range need, computed once.

    ``plant``: with what the effects give over the identified angles and speeds, see `Torques.everywhere`; `near` for elsewhere.
    """

    model: Model
    plant: Plant
    torques: Torques
    free: Box  # (n,) [N m] U and what may be the drives' offset: torque that belongs to no effect
    noise: Box  # (2n,) error of a measured state (q, dq)
    start: Box  # (2n,) what a power-off stop starts from, less the measured state: its error, and what the drive still gives
    apart: float | None  # [s] see `Brakes`
    payload: tuple[float, float]
    payload_com: Array
    assumptions: tuple[str, ...]

    @property
    def truth(self) -> Box:
        """(2n,) the true state less the measured one."""
        return Box(-self.noise.hi, -self.noise.lo)

    def near(self, plant: Plant, q: Box, speed: Array) -> Plant:
        """``plant`` with what the effects give at angles in ``q`` (n,) [rad], no joint faster than ``speed`` (n,) [rad/s]."""
        if self.torques.settled:
            return plant
        f = self.torques.over(q, speed)
        return plant._replace(
            coulomb_lo=f.dry.lo, coulomb_hi=f.dry.hi, viscous_lo=f.viscous.lo, viscous_hi=f.viscous.hi,
            u_lo=self.free.lo + f.push.lo, u_hi=self.free.hi + f.push.hi,
        )  # fmt: skip


def setting_of(
    model: Model, payload: tuple[float, float] | None = None, payload_com: Array | None = None, extrapolate: bool = False
) -> Setting | None:
    """Everything known of the arm's stops, or None if its brakes are not known.

    ``payload``: [kg] range on top of what the robot's ``pi`` holds, default the model's domain; ``payload_com``: (3,) [m] in the
    last link's frame, default the flange. Raises `NotCovered` for a payload outside the model's domain, unless it is to be
    ``extrapolate``-d: then the rigid body carries it, and an assumption says that no recording did; and for an effect of the
    model that no stop can be bounded with.
    """
    n = model.n
    lo, hi = model.domain.payload if payload is None else payload
    seen = model.domain.payload
    if not (0.0 <= lo <= hi < np.inf or seen[0] <= lo <= hi <= seen[1]):
        raise NotCovered(f"a payload of {lo:g} to {hi:g} kg; expected a range of finite masses from 0 kg on")
    inside = seen[0] - 1e-9 <= lo and hi <= seen[1] + 1e-9
    if not inside and not extrapolate:
        raise NotCovered(beyond_payload(lo, hi, seen))
    brakes = brakes_of(model)
    if brakes is None:
        return None
    com = np.asarray(model.robot.tip if payload_com is None else payload_com, float)
    torques = torques_of(model, (lo, hi), com)
    friction = torques.everywhere
    regime = "stop0" if "stop0" in model.sets else "powered"
    sets = model.sets[regime]
    middle, half = bodies(model, (lo, hi), com)
    # a constant torque seen in the powered data may belong to the drive or to the arm: with and without it
    offset = model.abstraction.offset if model.abstraction.offset.shape == (n,) else np.zeros(n)
    free = Box(sets.U.lo - np.maximum(offset, 0.0), sets.U.hi - np.minimum(offset, 0.0))
    rotor = rotor_of(model)
    plant = Plant(
        chain=model.robot.chain, pi=middle, pi_half=half, rotor=0.5 * (rotor.lo + rotor.hi), rotor_half=rotor.radius,
        coulomb_lo=friction.dry.lo, coulomb_hi=friction.dry.hi,
        viscous_lo=friction.viscous.lo, viscous_hi=friction.viscous.hi,
        u_lo=free.lo + friction.push.lo, u_hi=free.hi + friction.push.hi,
        brake_lo=brakes.torque.lo, brake_hi=brakes.torque.hi, delay_lo=brakes.delay.lo, delay_hi=brakes.delay.hi,
        rise_lo=brakes.rise.lo, rise_hi=brakes.rise.hi, curvature=torques.body.K,
    )  # fmt: skip
    assumptions = [
        "serial arm of rigid links; rotor inertia on the link side; no contact, no joint limit on the way",
        f"brakes ({brakes.source}): torque {_range(brakes.torque)} N m, delay {_range(brakes.delay, 1e3)} ms, "
        f"rise {_range(brakes.rise, 1e3)} ms, linear rise, constant during a stop",
        f"dry friction {_range(friction.dry)} N m and viscous friction {_range(friction.viscous)} N m s/rad, "
        f"from the identified effects +- {SIGMAS:g} standard deviations +- {FRICTION_TOLERANCE:.0%}; none where unknown",
        f"any further torque within U of regime '{regime}': {_range(sets.U)} N m, free in time",
        f"payload {lo:g} to {hi:g} kg as a point at {np.round(com, 4).tolist()} m in the last link",
    ]
    if not inside:
        assumptions.append(
            f"EXTRAPOLATED PAYLOAD: recordings carried {seen[0]:g} to {seen[1]:g} kg; beyond that the rigid body is computed, and "
            f"friction and U are taken not to change"
        )
    if np.any(rotor.width > 0):
        assumptions.append(f"rotor inertia between data sheet and the inertia identified: {_range(rotor)} kg m^2")
    assumptions += described(model)
    if np.all(friction.dry.hi == 0):
        assumptions.append("Coulomb friction unknown, taken as none")
    misread = misreadings(model, torques.fastest)
    measured = _noise(model, sets.V, regime)
    noise = Box(measured.lo - misread.hi, measured.hi - misread.lo)
    assumptions.append(
        f"measured state exact to {_range(noise.take(slice(0, n)))} rad, {_range(noise.take(slice(n, 2 * n)))} rad/s"
    )
    start = sets.X0 + misread if regime == "stop0" else Box(-noise.hi, -noise.lo)
    if not noise.encloses(Box(-start.hi, -start.lo)):
        assumptions.append(
            f"what the drives still give while their power goes changes the speeds by no more than "
            f"{_range(start.take(slice(n, 2 * n)))} rad/s, measurement error included"
        )
    if brakes.apart is not None:
        assumptions.append(f"within one stop the brakes' delays lie apart by no more than {1e3 * brakes.apart:.3g} ms")
    return Setting(model, plant, torques, free, noise, start, brakes.apart, (lo, hi), com, tuple(assumptions))


def beyond_payload(lo: float, hi: float, seen: tuple[float, float]) -> str:
    """Refusal of a payload outside the domain ``seen`` [kg]."""
    what = f"{hi:g} kg" if lo == hi else f"{lo:g} to {hi:g} kg"
    return (
        f"a payload of {what} lies outside the model's domain of {seen[0]:g} to {seen[1]:g} kg; identify with recordings that "
        f"carry it, or accept a marked extrapolation (--extrapolate-payload)"
    )


def beyond_domain(model: Model, q: Array, dq: Array) -> str | None:
    """One sentence where a state lies outside the angles or speeds that identification has seen (trap P25), else None."""
    parts = []
    for name, x, box in (("rad", q, model.domain.q), ("rad/s", dq, model.domain.dq)):
        out = (x < box.lo - 1e-9) | (x > box.hi + 1e-9)
        parts += [
            f"{model.joints[i]} at {x[i]:.3g} {name}, seen [{box.lo[i]:.3g}, {box.hi[i]:.3g}]" for i in np.nonzero(out)[0]
        ]  # fmt: skip
    if not parts:
        return None
    return f"{OUTSIDE}: {'; '.join(parts)}"


def _noise(model: Model, V: Box, regime: str) -> Box:
    """Error of a measured state. ``V`` of the powered regime also holds what its model cannot explain; where the speed at
    standstill was measured, `STANDSTILL` times that is the error of a measured speed."""
    n, still = model.n, model.abstraction.standstill
    if regime == "stop0" or still.shape != (n,):
        return V
    bound = np.concatenate([np.full(n, np.inf), STANDSTILL * np.abs(still)])
    return Box(np.maximum(V.lo, -bound), np.minimum(V.hi, bound))


def _range(box: Box, scale: float = 1.0) -> str:
    return " ".join(f"[{scale * a:.3g}, {scale * b:.3g}]" for a, b in zip(box.lo, box.hi, strict=True))
