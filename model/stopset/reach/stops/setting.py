"""From the model file to what bounds a stop: every parameter as an interval, every widening stated as an assumption."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Brakes, Model
from stopset.core.library import lib, view
from stopset.effects.bound import SIGMAS
from stopset.errors import NotCovered
from stopset.reach.stops.brakes import brakes_of
from stopset.reach.stops.friction import FRICTION_TOLERANCE, Friction, Torques, described, misread_shares, misreadings, torques_of
from stopset.reach.stops.payload import bodies, weighed
from stopset.reach.stops.tube import Plant, plant_struct
from stopset.robot.rigid import mass_matrix
from stopset.sets import Box
from stopset.types import Array

OUTSIDE = "EXTRAPOLATED STATE, outside the identified domain"
NEXT_TO_NOTHING = 1e-300  # what rounding outwards makes of zero, in words
HEAVIEST, FARTHEST = 1000.0, 10.0  # [kg], [m] of a payload and its centre: beyond, a unit was mistaken


def rotor_of(model: Model) -> Box:
    """(n,) [kg m^2] reflected rotor inertia, with what the inertia about its axis is uncertain by: `SIGMAS` standard errors, which U does
    not hold at a stop's decelerations; a point in models of versions that did not say.

    What was identified and what a data sheet states are two opinions, and both are in the box.  Raises `NotCovered` where neither is known.
    """
    identified, std = np.array(model.rotor, float), np.zeros(model.n) if model.inertia_std is None else model.inertia_std
    if model.effort == "compensated_torque" and model.abstraction.kind == 1:
        q = np.clip(model.domain.q.centre, model.robot.q_limit[:, 0], model.robot.q_limit[:, 1])
        rigid = np.diag(mass_matrix(model.robot.chain, model.robot.pi, q))
        seen = np.maximum(1.0 / np.diag(model.abstraction.Minv) - rigid, 1e-3)
        return Box(np.minimum(identified, np.maximum(seen - SIGMAS * std, 0.0)), np.maximum(identified, seen + SIGMAS * std))
    if model.inertia_std is None:
        return Box.point(identified)
    stated = np.array([d.rotor_inertia for d in model.robot.as_described.drives], float)
    known, half = np.isfinite(stated), SIGMAS * std
    if model.rotors_shown:
        other = np.where(known & (std > 0.0), stated, identified)
        return Box(np.minimum(other, np.maximum(identified - half, 0.0)), np.maximum(other, identified + half))
    if not known.all():
        raise NotCovered(
            f"the recorded torque of most joints shows no rotor's inertia and robot.json states none for "
            f"{', '.join(np.array(model.joints)[~known])}; brakes have to stop the rotors too: state "
            "reflected_motor_inertia_kgm2 there (0 where there is none) and identify again"
        )
    return Box(np.maximum(stated - half, 0.0), stated + half)


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
    residual: Box  # (n,) [rad/s] what the drives change the speeds by while their power goes, whatever the arm did before
    delay_spread: float | None  # [s] see `Brakes`
    lag: Array | None  # (n,) [s] see `Brakes`
    payload: tuple[float, float]
    payload_com: Array
    assumptions: tuple[str, ...]
    extrapolated: str = ""  # where the payload is one that no recording carried

    @property
    def truth(self) -> Box:
        """(2n,) the true state less the measured one."""
        return Box(-self.noise.hi, -self.noise.lo)

    @property
    def shares(self) -> Array:
        """(n,) see `misread_shares`."""
        return misread_shares(self.model)

    @property
    def payloads(self) -> int:
        """One, some, or so much alike that parts of their range are asked only where all of it has no bound: as the core says."""
        return int(lib.stopset_payloads(*self.payload))

    @property
    def parts(self) -> tuple[Setting, ...]:
        """Two settings, the heavier first, of which every payload of the range lies in one; none where it is one payload."""
        if self.payloads == lib.STOPSET_ONE_PAYLOAD:
            return ()
        out, (struct, _held) = [], plant_struct(self.plant)
        for k in range(2):
            pi, half = np.empty_like(self.plant.pi), np.empty_like(self.plant.pi_half)
            lib.stopset_payload_part(struct, k, view(pi), view(half))
            out.append(replace(self, plant=self.plant._replace(pi=pi, pi_half=half), torques=self.torques.carrying(pi, half)))
        return tuple(out)

    def near(self, plant: Plant, q: Box, speed: Array) -> Plant:
        """``plant`` with what the effects give at angles in ``q`` (n,) [rad], no joint faster than ``speed`` (n,) [rad/s]."""
        return plant if self.torques.settled else self.with_friction(plant, self.torques.over(q, speed))

    def with_friction(self, plant: Plant, f: Friction) -> Plant:
        """``plant`` with the effects ``f`` in place of its own."""
        return plant._replace(
            coulomb_lo=f.dry.lo, coulomb_hi=f.dry.hi, viscous_lo=f.viscous.lo, viscous_hi=f.viscous.hi,
            u_lo=self.free.lo + f.push.lo, u_hi=self.free.hi + f.push.hi,
        )  # fmt: skip


def setting_of(
    model: Model, payload: tuple[float, float] | None = None, payload_com: Array | None = None, *, extrapolate: bool = False
) -> Setting | None:
    """Everything known of the arm's stops, or None if its brakes are not known.

    ``payload``: [kg] range on top of what the robot's ``pi`` holds, default the model's domain; ``payload_com``: (3,) [m] in the
    last link's frame, default an identified payload's centre, or the flange.

    Raises `NotCovered` for a payload outside the model's domain, unless it is to be ``extrapolate``-d: then the rigid body
    carries it, and an assumption says that no recording did; and for an effect of the model that no stop can be bounded with.
    """
    carried = payload_of(model, payload, extrapolate=extrapolate)
    brakes = brakes_of(model)
    if brakes is None:
        return None
    mass_uncertainty, com = weighed(model, payload_com)
    if com.shape != (3,) or not float(np.linalg.norm(com)) <= FARTHEST:
        raise NotCovered(
            f"a payload's centre at {com.tolist()} m in the last link; expected three numbers, at most {FARTHEST:g} m away: give it in "
            "metres"
        )
    n, torques = model.n, torques_of(model, carried, com)
    regime = "stop0" if "stop0" in model.sets else "powered"
    sets = model.sets[regime]
    # a constant torque seen in the powered data may belong to the drive or to the arm: with and without it
    offset = model.abstraction.offset if model.abstraction.offset.shape == (n,) else np.zeros(n)
    free = Box(sets.U.lo - np.maximum(offset, 0.0), sets.U.hi - np.minimum(offset, 0.0))
    noise, start = readings_of(model)
    residual = sets.X0.take(slice(n, 2 * n)) if regime == "stop0" else Box.point(np.zeros(n))
    lo, hi = model.domain.payload
    inside = lo - 1e-9 <= carried[0] and carried[1] <= hi + 1e-9
    setting = Setting(
        model=model, plant=_plant(model, brakes, torques, bodies(model, carried, com), free), torques=torques, free=free, noise=noise,
        start=start, residual=residual, delay_spread=brakes.delay_spread, lag=brakes.lag, payload=carried, payload_com=com, assumptions=(),
        extrapolated="" if inside else f"EXTRAPOLATED PAYLOAD: recordings carried {lo:g} to {hi:g} kg",
    )  # fmt: skip
    return replace(setting, assumptions=tuple(_assumptions(setting, brakes, regime, mass_uncertainty)))


def readings_of(model: Model) -> tuple[Box, Box]:
    """(2n,) each: error of a measured state, less what effects of the model set right in it; and what a power-off stop starts from, less
    the measured state."""
    sets = model.sets.get("stop0", model.powered)
    read_wrong = np.maximum(np.abs(sets.V.lo), np.abs(sets.V.hi))[model.n :]  # a share is misread of what is read without that
    misread = misreadings(model, np.maximum(np.abs(model.domain.dq.lo), np.abs(model.domain.dq.hi)) + read_wrong)
    noise = Box(sets.V.lo - misread.hi, sets.V.hi - misread.lo)
    return noise, sets.X0 + misread if "stop0" in model.sets else Box(-noise.hi, -noise.lo)


def payload_of(model: Model, payload: tuple[float, float] | None, *, extrapolate: bool) -> tuple[float, float]:
    """The range asked for [kg], the domain's where none is; refused as `setting_of` says."""
    lo, hi = model.domain.payload if payload is None else payload
    seen = model.domain.payload
    if not (0.0 <= lo <= hi <= HEAVIEST or seen[0] <= lo <= hi <= seen[1]):
        raise NotCovered(
            f"a payload of {lo:g} to {hi:g} kg; expected masses of at least 0 kg and at most {HEAVIEST:g} kg: give it in kg"
        )
    if not (seen[0] - 1e-9 <= lo and hi <= seen[1] + 1e-9) and not extrapolate:
        raise NotCovered(beyond_payload(lo, hi, seen))
    return lo, hi


def _plant(model: Model, brakes: Brakes, torques: Torques, body: tuple[Array, Array], free: Box) -> Plant:
    """``body``: middle and half range of the links' parameters with the payload."""
    friction, rotor = torques.everywhere, rotor_of(model)
    return Plant(
        chain=model.robot.chain, pi=body[0], pi_half=body[1], rotor=0.5 * (rotor.lo + rotor.hi), rotor_half=rotor.radius,
        coulomb_lo=friction.dry.lo, coulomb_hi=friction.dry.hi,
        viscous_lo=friction.viscous.lo, viscous_hi=friction.viscous.hi,
        u_lo=free.lo + friction.push.lo, u_hi=free.hi + friction.push.hi,
        brake_lo=brakes.torque.lo, brake_hi=brakes.torque.hi, delay_lo=brakes.delay.lo, delay_hi=brakes.delay.hi,
        rise_lo=brakes.rise.lo, rise_hi=brakes.rise.hi, curvature=torques.body.K,
    )  # fmt: skip


def _assumptions(s: Setting, brakes: Brakes, regime: str, mass_uncertainty: float) -> Iterator[str]:
    """What a bound of this setting rests on, a sentence each; ``mass_uncertainty``: of the payload's mass [kg]."""
    model, n, friction = s.model, s.model.n, s.torques.everywhere
    yield "serial arm of rigid links; rotor inertia on the link side; no contact, no joint limit on the way"
    yield (
        f"brakes ({brakes.source}): torque {_range(brakes.torque)} N m, delay {_range(brakes.delay, 1e3)} ms, "
        f"rise {_range(brakes.rise, 1e3)} ms, linear rise, constant during a stop"
    )
    yield (
        f"dry friction {_range(friction.dry)} N m and viscous friction {_range(friction.viscous)} N m s/rad, "
        f"from the identified effects +- {SIGMAS:g} standard deviations +- {FRICTION_TOLERANCE:.0%}; none where unknown"
    )
    yield _temperature(model)
    yield f"any further torque within U of regime '{regime}': {_range(model.sets[regime].U)} N m, free in time"
    lo, hi = s.payload
    yield f"payload {lo:g} to {hi:g} kg as a point at {np.round(s.payload_com, 4).tolist()} m in the last link"
    if mass_uncertainty > 0.0:
        yield f"payload weighed by its torque to +- {mass_uncertainty:.3g} kg, its centre as identified"
    if s.extrapolated:
        yield f"{s.extrapolated}; beyond that the rigid body is computed, and friction and U are taken not to change"
    yield f"rotor inertia {_range(rotor_of(model))} kg m^2, {_inertia(model)}"
    yield from described(model)
    if np.all(friction.dry.hi == 0):
        yield "Coulomb friction unknown, taken as none"
    yield f"measured state exact to {_range(s.noise.take(slice(0, n)))} rad, {_range(s.noise.take(slice(n, 2 * n)))} rad/s"
    if regime == "stop0":
        yield (
            f"what the drives still give while their power goes changes the speeds by no more than "
            f"{_range(s.residual)} rad/s, measurement error included"
        )
    else:
        yield "the drives give nothing more once power is taken"
        yield "the recorded torque in the same N m as the brakes': where its scale is wrong by some percent, so are inertias beside the brakes"
    if s.delay_spread is not None:
        yield _delay_spread(s.delay_spread, s.lag)


def _temperature(model: Model) -> str:
    """At which temperatures the friction of a stop is that of the recordings."""
    temp = model.domain.temp
    if temp is None:
        return "drives as warm as they were recorded, however warm that was: no recording tells a temperature"
    return f"drives no colder and no warmer than recorded: {_range(temp)} degC"


def _inertia(model: Model) -> str:
    """What the inertias of a stop rest on."""
    std = model.inertia_std
    if not model.rotors_shown:
        return (
            f"of the data sheet, as the torque shows none, with {SIGMAS:g} standard errors of the links' inertia about each axis"
        )
    if std is None:
        return "all inertias taken as exact: this model does not say how well they are known"
    if np.all(std == 0.0):
        return "all inertias as identified: brakes and U of recorded stops hold what they are wrong by at such decelerations"
    return f"with {SIGMAS:g} standard errors of the inertia about each axis and what a data sheet states; inertias between axes as identified"


def _delay_spread(delay_spread: float, lag: Array | None) -> str:
    less = "" if lag is None else f", less the {_list(lag, 1e3)} ms by which each is always later,"
    return f"within one stop the brakes' delays{less} lie apart by no more than {1e3 * delay_spread:.6g} ms"


def beyond_payload(lo: float, hi: float, seen: tuple[float, float]) -> str:
    """Refusal of a payload outside the domain ``seen`` [kg]."""
    what = f"{hi:g} kg" if lo == hi else f"{lo:g} to {hi:g} kg"
    return (
        f"a payload of {what} lies outside the model's domain of {seen[0]:g} to {seen[1]:g} kg; identify with recordings that "
        f"carry it, or accept a marked extrapolation (--extrapolate-payload)"
    )


def beyond_domain(model: Model, q: Array, dq: Array, q_radius: Array | None = None, dq_radius: Array | None = None) -> str | None:
    """One sentence where a state lies outside the angles or speeds that identification has seen (trap P25), else None.

    With radii (n,): where all states of that box do.
    """
    parts = []
    for name, x, r, box in (("rad", q, q_radius, model.domain.q), ("rad/s", dq, dq_radius, model.domain.dq)):
        near = 1e-9 + (0.0 if r is None else r)
        out = (x < box.lo - near) | (x > box.hi + near)
        parts += [
            f"{model.joints[i]} at {x[i]:.3g} {name}, seen [{box.lo[i]:.3g}, {box.hi[i]:.3g}]" for i in np.nonzero(out)[0]
        ]  # fmt: skip
    if not parts:
        return None
    return "; ".join(parts)


def _list(x: Array, scale: float = 1.0) -> str:
    return "[" + ", ".join(f"{scale * a:.6g}" for a in x) + "]"


def _range(box: Box, scale: float = 1.0) -> str:
    ends = [[0.0 if abs(x) < NEXT_TO_NOTHING else scale * x for x in side.tolist()] for side in (box.lo, box.hi)]
    return " ".join(f"[{a:.3g}, {b:.3g}]" for a, b in zip(*ends, strict=True))
