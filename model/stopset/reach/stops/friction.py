"""What the effects of a model do to its joints in a stop: every one by its own law, over all that the stop may reach.

Lemma 1 of docs/stops.md (what is put back).  The powered arm obeys ``rigid + effects = tau``; ``U`` encloses what is left of the measured torque
once the compensation has taken its effects off and the abstraction its own.  So what either took is not in ``U`` and acts on
the unpowered arm by its law; what neither took is in ``U`` and is not added again.  By what an effect ``enters``:

- ``compensation``, ``state`` (taken off, whatever the abstraction's kind and whatever torque was recorded): its law is put back;
- ``viscous``, and a cubic that the abstraction holds: in the abstraction, not in ``U``: put back by the same law;
- ``inertia``: in the rigid body and rotors, of the abstraction as of the stop: nothing to add;
- ``input_gain``: scales a torque that no motor gives with its power off: nothing to add, and nothing of it is in ``U``;
- ``input_delay``: stays in ``U``, though a late reading moves no unpowered arm: ``U`` is only too wide;
- ``swing`` (a role): stays in ``U`` as far as the powered arm swung; a braked gear may swing farther: no stop is bounded.

Values are those that were taken off, so what they are wrong by is in ``U``; their standard deviations come on top, of a
payload as the doubt of its mass (`payload.bodies`).
Compensated torque came without the drive's own Coulomb friction and gravity: gravity is put back by the rigid body, that
friction is not known and counted as none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import or_
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.core.library import check, ffi, given, lib, view
from stopset.effects.base import LOOSE, REFERENCE_TEMPERATURE, Effect, Fitted
from stopset.effects.bound import ACTING, misread, uncovered
from stopset.effects.signals import tilt_directions
from stopset.errors import EffectError, NotCovered
from stopset.reach.stops.brakes import brakes_of
from stopset.reach.stops.expansion import Curvature, curvature
from stopset.reach.stops.gravity import gravity_curvature
from stopset.reach.stops.laws import ActingLaw, acting_law
from stopset.reach.stops.payload import bodies, effect_of, largest_gravity, weighed
from stopset.ring import Interval
from stopset.robot.rigid import Chain, arm_struct
from stopset.sets import Box
from stopset.types import Array

FRICTION_TOLERANCE: float = lib.stopset_friction_tolerance  # relative, on top: friction drifts with wear, oil and temperature
BEYOND = 0.5  # [rad] how far past the identified angles `Torques.everywhere` holds
ROUNDING = 1e-12  # of an expansion, relative to the largest
UNBOUNDED = "its law cannot be evaluated over intervals: it has no bound on what a stop may lead to"
# rows of a sum over effects: friction that never drives, what else opposes the motion, and what may push
RUBS, RUBS_VISCOUS, DRY, VISCOUS, PUSH = range(5)


@dataclass(frozen=True, slots=True)
class Friction:
    """Dry and viscous friction as intervals: ``dry`` [N m], ``viscous`` [N m s/rad], ``push``: torque on the arm in any
    direction [N m], (n,) each."""

    dry: Box
    viscous: Box
    push: Box

    def same(self, other: Friction) -> bool:
        """Whether all numbers have the same bits: a tube with the other is a tube with this one."""
        mine, others = ([x for b in (f.dry, f.viscous, f.push) for x in (b.lo, b.hi)] for f in (self, other))
        return all(a.tobytes() == b.tobytes() for a, b in zip(mine, others, strict=True))


@dataclass(frozen=True, slots=True)
class Body:
    """The rigid body as the laws see it; ``tilted``: with gravity's derivatives by roll and pitch in gravity's place, and the
    bounds of what gravity then is (`gravity_curvature`)."""

    chain: Chain
    pi: Array
    half: Array
    K: Curvature
    tilted: tuple[tuple[Chain, Array, Array], ...]

    @classmethod
    def of(cls, chain: Chain, pi: Array, half: Array, *, tilts: bool) -> Body:
        tilted = []
        for direction in tilt_directions(chain.gravity) if tilts else ():
            other = chain._replace(gravity=direction)
            bend, most = _both(gravity_curvature, other, pi, half)
            tilted.append((other, bend, most))
        return cls(chain, pi, half, Curvature(*_both(curvature, chain, pi, half)), tuple(tilted))


@dataclass(frozen=True, slots=True)
class Torques:
    """The effects of a model that act in a stop, prepared.

    ``fixed`` (5, n, 2): the sum of those that depend on no pose and no other joint, which holds up to ``speed`` (n,) [rad/s],
    infinite where they do not depend on it either; ``base``: without any; ``fastest`` (n,) [rad/s]: seen in identification;
    ``everywhere``: over all identified angles, and `BEYOND` them, and speeds.
    """

    laws: tuple[ActingLaw, ...]
    body: Body
    gear: Array
    temp: Box | None
    base: Array
    fixed: Array
    speed: Array
    fastest: Array
    everywhere: Friction
    _core: tuple[Any, Any, Any] | None = None  # the core's view of body and effects, and what it points at

    @property
    def settled(self) -> bool:
        """Whether nothing depends on where the arm is and how fast it goes."""
        return not any(x.roams for x in self.laws) and bool(np.all(np.isinf(self.speed)))

    @property
    def kelvin(self) -> Array | None:
        """(n, 2) above the reference temperature, over the domain [K]; None where none was recorded."""
        return None if self.temp is None else np.column_stack([self.temp.lo, self.temp.hi]) - REFERENCE_TEMPERATURE

    @property
    def needs(self) -> int:
        """What laws look at of the rigid body, in the core's bits."""
        return reduce(or_, (x.needs for x in self.laws), 0)

    @property
    def far_seeing(self) -> bool:
        """Whether laws look at most joints, as they do by the rigid body: then a guessed region mostly has to be mended."""
        return self.needs != 0 or 2 * len({x.joint for x in self.laws if x.roams}) > len(self.gear)

    def carrying(self, pi: Array, half: Array) -> Torques:
        """The same of an arm with ``pi +- half`` (n, 10), a part of what it may carry: what bounds all of that bounds the part."""
        out = replace(self, body=replace(self.body, pi=pi, half=half))
        return replace(out, _core=_core_of(out))

    def over(self, q: Box, speed: Array) -> Friction:
        """At angles in ``q`` (n,) [rad], no joint faster than ``speed`` (n,) [rad/s]. Raises `NotCovered` where a law has no bound."""
        n = len(speed)
        if not q.lo.shape == q.hi.shape == speed.shape == (n,):
            raise ValueError(f"a region of {q.lo.shape} angles and {speed.shape} speeds")
        plant, struct, _ = self._core or _core_of(self)
        out = np.empty((6, n))
        code = lib.stopset_friction_over(plant, struct, *(view(given(x)) for x in (q.lo, q.hi, speed)), view(out))
        if code >= lib.STOPSET_NO_BOUND:
            raise NotCovered(uncovered(self.laws[code - lib.STOPSET_NO_BOUND].label, UNBOUNDED))
        check(-code)
        return Friction(Box(out[0], out[1]), Box(out[2], out[3]), Box(out[4], out[5]))


def torque_fields(x: Torques, free: Box) -> dict[str, Array | None]:
    """The arrays of ``StopsetTorques`` by their names, laws apart, with the torque ``free`` (n,) [N m] that belongs to no effect."""
    n, tilted = len(x.gear), x.body.tilted
    return {
        "turn": x.body.K.Gamma, "tilt_gravity": np.array([c.gravity for c, *_ in tilted]) if tilted else np.zeros((2, 3)),
        "tilt_bend": np.array([b for _, b, _ in tilted]) if tilted else np.zeros((2, n, n, n)),
        "tilt_load": np.array([m for *_, m in tilted]) if tilted else np.zeros((2, n)), "gear": x.gear, "temp": x.kelvin,
        "base": x.base, "fixed": x.fixed, "speed": x.speed, "fastest": x.fastest, "free_lo": free.lo, "free_hi": free.hi,
    }  # fmt: skip


def torques_struct(x: Torques, free: Box) -> tuple[Any, list[Any]]:
    """``StopsetTorques``, and what must live as long."""
    keep: list[Any] = []
    table = ffi.new("StopsetActing[]", [law.struct(keep) for law in x.laws] or 1)
    arrays = {k: None if v is None else given(v) for k, v in torque_fields(x, free).items()}
    values = {k: ffi.NULL if v is None else view(v) for k, v in arrays.items()}
    struct = ffi.new("StopsetTorques *", {"laws": len(x.laws), "needs": x.needs, "law": table, **values})
    return struct, [keep, table, arrays]


def _core_of(x: Torques) -> tuple[Any, Any, Any]:
    """Of the plant only what laws see of the rigid body."""
    n, body = len(x.gear), x.body
    struct, held = torques_struct(x, Box.point(np.zeros(n)))
    arm = arm_struct(body.chain, body.pi)
    bent = [given(k) for k in (body.K.M, body.K.g, body.K.size, body.K.load)]
    half = given(body.half)
    plant = ffi.new("StopsetPlant *", {"arm": arm[0], "pi_half": view(half), "curvature": tuple(view(k) for k in bent)})
    return plant, struct, (held, arm, bent, half)


def torques_of(model: Model, payload: tuple[float, float] | None = None, com: Array | None = None) -> Torques:
    """The effects of ``model`` for stops with a ``payload`` [kg], default the domain's, at ``com`` (3,) [m], default the flange.

    Raises `NotCovered` with the label of an effect that cannot be bounded.
    """
    n, brakes = model.n, brakes_of(model)
    payload = model.domain.payload if payload is None else payload
    com = weighed(model, com)[1]
    gear = largest_gravity(model, payload[1], com) + (0.0 if brakes is None else brakes.torque.hi)
    fastest = np.maximum(np.abs(model.domain.dq.lo), np.abs(model.domain.dq.hi))
    laws, damped = _acting(model, fastest)
    pi, half = bodies(model, payload, com)
    body = Body.of(model.robot.chain, pi, half, tilts=any(x.needs & lib.STOPSET_NEEDS_TILT for x in laws))
    base = np.zeros((5, n, 2))
    unknown = np.setdiff1d(np.arange(n), damped)  # there the abstraction's linear friction, as nothing better is known
    base[RUBS_VISCOUS, unknown] = model.abstraction.viscous[unknown, :1]
    first = Torques(laws, body, gear, model.domain.temp, base, base.copy(), np.full(n, np.inf), fastest, _friction(base, fastest))
    for x in laws:
        if not x.roams:
            here, fast = acting(first, x, fastest), acting(first, x, 3.0 * fastest + 1.0)
            if np.any(here != fast):
                first.speed[x.joint] = fastest[x.joint]
            _put(first.fixed, x, here)
    # damping below zero pushes the more the faster the joint goes
    drives = np.maximum(first.fixed[RUBS_VISCOUS, :, 0], 0.0) + first.fixed[VISCOUS, :, 0] < 0.0
    speed = np.where(drives, np.minimum(first.speed, fastest), first.speed)
    out = replace(first, speed=speed, everywhere=_friction(first.fixed, fastest))
    out = replace(out, _core=_core_of(out))
    q = Box(model.domain.q.lo - BEYOND, model.domain.q.hi + BEYOND)
    return out if out.settled else replace(out, everywhere=out.over(q, fastest))


def acting(x: Torques, law: ActingLaw, speed: Array) -> Array:
    """``direction (dry + viscous |dq|) + push`` of a law that does not roam, (3, 2) [N m, N m s/rad, N m], up to ``speed`` (n,) [rad/s]."""
    keep: list[Any] = []
    j = law.joint
    temp = (0.0, 0.0) if x.kelvin is None else x.kelvin[j].tolist()
    sight = {"speed": speed[j], "past": x.fastest[j], "gear": x.gear[j], "temp": temp}
    return acted(law, sight, keep)


def acted(law: ActingLaw, sight: Mapping[str, Any], keep: list[Any]) -> Array:
    """The core's bound of one law over a ``StopsetSight``. Raises `NotCovered` where it has none."""
    out = np.empty((3, 2))
    table = ffi.new("StopsetActing[]", [law.struct(keep)])
    if lib.stopset_act(table, ffi.new("StopsetSight *", dict(sight)), view(out)):
        raise NotCovered(uncovered(law.label, UNBOUNDED))
    return out


def misreadings(model: Model, fastest: Array) -> Box:
    """(2n,) true less recorded state, of the effects that misread a position, up to ``fastest`` (n,) [rad/s]."""
    n, lo, hi = model.n, np.zeros(2 * model.n), np.zeros(2 * model.n)
    for f in model.effects:
        effect = effect_of(f)
        if effect.role != "reading":
            continue
        for i in _places(effect, f, model):
            q = Interval(model.domain.q.lo[[i]] - BEYOND, model.domain.q.hi[[i]] + BEYOND)
            position, share = misread(effect, f, q)
            speed = share * Interval(-fastest[[i]], fastest[[i]])
            lo[[i, n + i]] += np.concatenate([position.lo, speed.lo])
            hi[[i, n + i]] += np.concatenate([position.hi, speed.hi])
    return Box(lo, hi)


def misread_shares(model: Model) -> Array:
    """(n,) [1] by how much more or less than it reads a joint may turn."""
    return np.asarray(misreadings(model, np.ones(model.n)).hi[model.n :])


def described(model: Model) -> tuple[str, ...]:
    """What stop bounds make of the effects, in sentences, where it is not friction."""
    of = {
        role: [f.label for f in model.effects if effect_of(f).role == role]
        for role in ("torque", "arm or drive", "input", "reading")
    }
    out = []
    if of["torque"]:
        out.append(f"on the arm with its drives off, each by its law wherever the stop may lead: {', '.join(of['torque'])}")
    if of["arm or drive"]:
        out.append(f"with and without, as it may be the drive's own: {', '.join(of['arm or drive'])}")
    if of["input"]:
        out.append(f"only in the motors' torque, of which there is none with the power off: {', '.join(of['input'])}")
    scaled = [f.label for f in model.effects if effect_of(f).enters == "input_gain"]
    if scaled:
        out.append(f"a drive that gives less than it tells has that much less than its limit for a ramp: {', '.join(scaled)}")
    if of["reading"]:
        out.append(f"angles are the true ones, the recorded ones set right by {', '.join(of['reading'])}")
    return tuple(out)


def _places(effect: Effect, f: Fitted, model: Model) -> tuple[int, ...]:
    try:
        return effect.acts_on(f.joint, model.joints)
    except EffectError as e:
        raise NotCovered(uncovered(f.label, str(e))) from e


def _acting(model: Model, fastest: Array) -> tuple[tuple[ActingLaw, ...], list[int]]:
    """Every law at every joint, and the joints whose damping an effect says."""
    laws: list[ActingLaw] = []
    damped: list[int] = []
    warm = model.domain.temp is not None
    for f in model.effects:
        effect = effect_of(f)
        if effect.role in LOOSE:
            raise NotCovered(uncovered(f.label, LOOSE[effect.role]))
        if effect.role in ACTING:
            places = _places(effect, f, model)
            damped += places if effect.enters == "damping" else ()
            for i in places:
                other = sum(places) - i if effect.scope == "pair" else -1
                laws.append(acting_law(effect, f, i, other, float(fastest[i]), warm=warm))
    return tuple(laws), damped


def _both(bounds: Callable[[Chain, Array], Sequence[Array]], chain: Chain, pi: Array, half: Array) -> Sequence[Array]:
    """``bounds`` of the middle payload and of half the range together."""
    out = bounds(chain, pi)
    return [x + y for x, y in zip(out, bounds(chain, half), strict=True)] if np.any(half) else out


def _put(total: Array, law: ActingLaw, parts: Array) -> None:
    rubs = law.role == lib.STOPSET_RUBS
    for row, x in zip((RUBS if rubs else DRY, RUBS_VISCOUS if rubs else VISCOUS, PUSH), parts, strict=True):
        total[row, law.joint] += x


def _friction(total: Array, speed: Array) -> Friction:
    """Of all effects together: friction never drives, and what else would be negative pushes."""
    push = total[PUSH].copy()
    boxes = []
    for rubs, other, per in ((RUBS, DRY, np.ones_like(speed)), (RUBS_VISCOUS, VISCOUS, speed)):
        lo, hi = (np.maximum(total[rubs], 0.0) + total[other]).T
        short = (1.0 + FRICTION_TOLERANCE) * np.maximum(-lo, 0.0) * per
        push[:, 0] -= short
        push[:, 1] += short
        boxes.append(Box.of(np.maximum(lo, 0.0) * (1.0 - FRICTION_TOLERANCE), np.maximum(hi, 0.0) * (1.0 + FRICTION_TOLERANCE)))
    # effects stand on the side of the arm's own torques: what they give, the arm is pushed by with the opposite sign
    return Friction(boxes[0], boxes[1], Box.of(-push[:, 1], -push[:, 0]))
