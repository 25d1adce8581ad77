"""From the model file to what bounds a stop: every parameter as an interval, every widening stated as an assumption."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Brakes, Model
from stopset.effects.base import REFERENCE_TEMPERATURE, Fitted
from stopset.errors import NotCovered
from stopset.reach.stops.expansion import Curvature, curvature
from stopset.reach.stops.tube import Plant
from stopset.robot.arm import standard_parameters
from stopset.robot.rigid import mass_matrix
from stopset.sets import Box

Array = NDArray[np.float64]
SIGMAS = 3.0  # identified parameters enter with this many standard deviations
FRICTION_TOLERANCE = 0.25  # relative, on top: friction drifts with wear, oil and temperature
OUTSIDE = "EXTRAPOLATED STATE, outside the identified domain"
BRAKE_TOLERANCE = 0.30  # relative half-width of a data sheet's brake torque where it states none


@dataclass(frozen=True, slots=True)
class Friction:
    """Dry and viscous friction as intervals: ``dry`` [N m], ``viscous`` [N m s/rad], ``push``: torque in any direction."""

    dry: Box
    viscous: Box
    push: Box
    left_out: tuple[str, ...]


def brakes_of(model: Model) -> Brakes | None:
    """The model's brakes, else the data sheet's with its tolerance; None if a torque or a delay is not known at all."""
    if model.brakes is not None:
        return model.brakes
    drives = model.robot.drives
    torque = np.array([d.brake_torque for d in drives])
    delay = np.array([d.brake_delay for d in drives])
    rise = np.array([d.brake_rise for d in drives])
    if not (np.all(np.isfinite(torque)) and np.all(np.isfinite(delay)) and np.all(np.isfinite(rise))):
        return None
    tolerance = np.array([d.brake_tolerance for d in drives])
    tolerance = np.where(np.isfinite(tolerance), tolerance, BRAKE_TOLERANCE)
    return Brakes(
        torque=Box.of(torque * (1 - tolerance), torque * (1 + tolerance)),
        delay=Box.of(delay[:, 0], delay[:, 1]),
        rise=Box.of(rise[:, 0], rise[:, 1]),
        source="data sheet",
    )


def _interval(f: Fitted, symbol: str) -> tuple[float, float]:
    """An identified value with its standard deviations; a missing value is zero."""
    value = float(f.values.get(symbol, 0.0))
    std = float(f.std.get(symbol, 0.0) or 0.0)
    spread = SIGMAS * std if np.isfinite(std) else abs(value)
    return value - spread, value + spread


def friction_of(model: Model, payload: float | None = None, lever: float | None = None) -> Friction:
    """Friction of all joints from the identified effects; what is not known is taken as none (lower) and counted in U.

    ``payload`` [kg] at most, default the domain's, ``lever`` [m] of its centre in the last link, default the flange's: they
    load the gears, as the brakes do, and friction that grows with the load is between none of it and all of it.
    """
    n = model.n
    heavy = model.domain.payload[1] if payload is None else payload
    load = _largest_load(model, heavy, float(np.linalg.norm(model.robot.tip)) if lever is None else lever)
    F, D, P = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 2))
    fast = np.maximum(np.abs(model.domain.dq.lo), np.abs(model.domain.dq.hi))
    q_far = np.stack([model.domain.q.lo, model.domain.q.hi], axis=1)
    left_out: list[str] = []
    known_viscous = np.zeros(n, bool)
    warm = (0.0, 0.0)
    for f in model.effects:
        if f.joint is None or f.joint not in model.joints:
            if f.effect not in ("payload", "base_tilt"):
                left_out.append(f.label)
            continue
        i = model.joints.index(f.joint)
        if model.domain.temp is not None:
            warm = (model.domain.temp.lo[i] - REFERENCE_TEMPERATURE, model.domain.temp.hi[i] - REFERENCE_TEMPERATURE)
        if f.effect == "coulomb":
            F[i] += _interval(f, "F_c")
        elif f.effect == "viscous":
            D[i] += _interval(f, "F_v")
            known_viscous[i] = True
        elif f.effect == "cubic_viscous":
            lo, hi = _interval(f, "v_3")
            D[i] += (min(lo, 0.0) * fast[i] ** 2, max(hi, 0.0) * fast[i] ** 2)
        elif f.effect == "asymmetric_coulomb":
            offset = max(map(abs, _interval(f, "F_o")))
            F[i] += (-offset, offset)
        elif f.effect == "stribeck":
            F[i, 1] += max(_interval(f, "F_s")[1], 0.0)
        elif f.effect == "hysteresis":
            F[i, 0] -= 2.0 * max(_interval(f, "F_h")[1], 0.0)
        elif f.effect == "load_coulomb":
            # which quadrant holds cannot be told from gravity while the brakes work (trap P23): the hull of both, at any load
            ends = (*_interval(f, "k_lift"), *_interval(f, "k_lower"), 0.0)
            F[i] += (min(ends) * load[i], max(ends) * load[i])
        elif f.effect == "warm_up":
            for array, symbol in ((F, "k_c"), (D, "k_v")):
                lo, hi = _interval(f, symbol)
                array[i] += (min(lo, 0.0), max(hi, 0.0))
        elif f.effect == "self_heating":
            # between cold and as warm as sliding for ever at the fastest speed makes it
            for array, symbol in ((F, "k_c"), (D, "k_v")):
                array[i, 0] += min(_interval(f, symbol)[0], 0.0) * fast[i]
        elif f.effect in ("thermal_coulomb", "thermal_viscous"):
            array, symbol = (F, "k_C") if f.effect == "thermal_coulomb" else (D, "k_T")
            # levelling off only brings the change closer to zero where warm, and away from it where cold
            gain = 1.0 if f.effect == "thermal_coulomb" or warm[0] >= 0 else float(np.exp(-f.values.get("b", 0.0) * warm[0]))
            products = [k * w * (gain if w < 0 else 1.0) for k in _interval(f, symbol) for w in warm] + [0.0]
            array[i] += (min(products), max(products))
        elif f.effect == "spring":
            products = [-k * q for k in _interval(f, "k") for q in q_far[i]]
            c = _interval(f, "c")
            P[i] += (min(products) - c[1], max(products) - c[0])
        elif f.effect == "torque_ripple":
            size = sum(max(map(abs, _interval(f, s))) for s in ("a", "b"))
            P[i] += (-size, size)
        else:
            left_out.append(f.label)
    unknown = ~known_viscous
    D[unknown] += model.abstraction.viscous[unknown, :1]  # the abstraction's linear friction, where nothing better is known
    lower, upper = 1.0 - FRICTION_TOLERANCE, 1.0 + FRICTION_TOLERANCE
    return Friction(
        dry=Box.of(np.maximum(F[:, 0], 0.0) * lower, np.maximum(F[:, 1], 0.0) * upper),
        viscous=Box.of(np.maximum(D[:, 0], 0.0) * lower, np.maximum(D[:, 1], 0.0) * upper),
        push=Box.of(P[:, 0], P[:, 1]),
        left_out=tuple(left_out),
    )


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


def _largest_load(model: Model, payload: float, lever: float) -> Array:
    """(n,) the gear of joint i carries no more than this [N m]: gravity in any pose, payload included, and its own brake."""
    robot = model.robot
    n = robot.n
    out = np.zeros(n)
    mass, moment = payload, payload * lever
    for i in range(n - 1, -1, -1):
        p = float(np.linalg.norm(robot.chain.p[i + 1])) if i + 1 < n else 0.0
        moment += float(np.linalg.norm(robot.pi[i, 1:4])) + (mass * p if i + 1 < n else 0.0)
        mass += abs(float(robot.pi[i, 0]))
        out[i] = moment * float(np.linalg.norm(robot.chain.gravity))
    brakes = brakes_of(model)
    return out if brakes is None else out + brakes.torque.hi


def _weighed(model: Model, given: Array | None) -> tuple[float, Array]:
    """How far an identified payload's mass may be off [kg], and where a payload's mass sits (3,) [m] in the last link's frame.

    The robot holds the identified payload already.  Its place is ``given``, or the identified payload's centre, or the flange.
    """
    mass, doubt, moment = 0.0, 0.0, np.zeros(3)
    for f in model.effects:
        if f.effect == "payload":
            mass, doubt = mass + f.values.get("m", 0.0), doubt + SIGMAS * f.std.get("m", 0.0)
            moment += [f.values.get(s, 0.0) for s in ("mx", "my", "mz")]
    com = moment / mass if mass > doubt else model.robot.tip
    return doubt, np.asarray(com if given is None else given, float)


@dataclass(frozen=True, slots=True)
class Setting:
    """A plant with its names: everything the bounds of a model and a payload range need, computed once."""

    model: Model
    plant: Plant
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


def setting_of(
    model: Model, payload: tuple[float, float] | None = None, payload_com: Array | None = None, extrapolate: bool = False
) -> Setting | None:
    """Everything known of the arm's stops, or None if its brakes are not known.

    ``payload``: [kg] range in addition to the robot's own, default the model's domain; ``payload_com``: (3,) [m] in the
    last link's frame, default the flange. Raises `NotCovered` for a payload outside the model's domain, unless it is to be
    ``extrapolate``-d: then the rigid body carries it, and an assumption says that no recording did.
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
    doubt, com = _weighed(model, payload_com)
    friction = friction_of(model, hi, float(np.linalg.norm(com)))
    regime = "stop0" if "stop0" in model.sets else "powered"
    sets = model.sets[regime]
    pi = model.robot.pi
    per_kg = np.zeros_like(pi)
    per_kg[-1] = standard_parameters(1.0, com, np.zeros((3, 3)))
    middle, half = pi + 0.5 * (lo + hi) * per_kg, (0.5 * (hi - lo) + doubt) * per_kg
    a, b = curvature(model.robot.chain, middle), curvature(model.robot.chain, half)
    # a constant torque seen in the powered data may belong to the drive or to the arm: with and without it
    offset = model.abstraction.offset if model.abstraction.offset.shape == (n,) else np.zeros(n)
    rotor = rotor_of(model)
    plant = Plant(
        chain=model.robot.chain, pi=middle, pi_half=half, rotor=0.5 * (rotor.lo + rotor.hi), rotor_half=rotor.radius,
        coulomb_lo=friction.dry.lo, coulomb_hi=friction.dry.hi,
        viscous_lo=friction.viscous.lo, viscous_hi=friction.viscous.hi,
        u_lo=sets.U.lo + friction.push.lo - np.maximum(offset, 0.0), u_hi=sets.U.hi + friction.push.hi - np.minimum(offset, 0.0),
        brake_lo=brakes.torque.lo, brake_hi=brakes.torque.hi, delay_lo=brakes.delay.lo, delay_hi=brakes.delay.hi,
        rise_lo=brakes.rise.lo, rise_hi=brakes.rise.hi,
        curvature=Curvature(*(x + y for x, y in zip(a, b, strict=True))),
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
    if doubt > 0.0:
        assumptions.append(f"payload weighed by its torque to +- {doubt:.3g} kg, its centre as identified")
    if not inside:
        assumptions.append(
            f"EXTRAPOLATED PAYLOAD: recordings carried {seen[0]:g} to {seen[1]:g} kg; beyond that the rigid body is computed, and "
            f"friction and U are taken not to change"
        )
    if np.any(rotor.width > 0):
        assumptions.append(f"rotor inertia between data sheet and the inertia identified: {_range(rotor)} kg m^2")
    if friction.left_out:
        assumptions.append(f"effects not in the stop bound except through U: {', '.join(friction.left_out)}")
    if np.all(friction.dry.hi == 0):
        assumptions.append("Coulomb friction unknown, taken as none")
    noise = sets.V
    assumptions.append(
        f"measured state exact to {_range(noise.take(slice(0, n)))} rad, {_range(noise.take(slice(n, 2 * n)))} rad/s"
    )
    start = sets.X0 if regime == "stop0" else Box(-noise.hi, -noise.lo)
    if not noise.encloses(Box(-start.hi, -start.lo)):
        assumptions.append(
            f"what the drives still give while their power goes changes the speeds by no more than "
            f"{_range(start.take(slice(n, 2 * n)))} rad/s, measurement error included"
        )
    if brakes.apart is not None:
        assumptions.append(f"within one stop the brakes' delays lie apart by no more than {1e3 * brakes.apart:.3g} ms")
    return Setting(model, plant, noise, start, brakes.apart, (lo, hi), com, tuple(assumptions))


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


def _range(box: Box, scale: float = 1.0) -> str:
    return " ".join(f"[{scale * a:.3g}, {scale * b:.3g}]" for a, b in zip(box.lo, box.hi, strict=True))
