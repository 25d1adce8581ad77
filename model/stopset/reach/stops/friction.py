"""What the effects of a model do to its joints in a stop: every one by its own law, over all that the stop may reach.

Lemma (what is put back).  The powered arm obeys ``rigid + effects = tau``; ``U`` encloses what is left of the measured torque
once the compensation has taken its effects off and the abstraction its own.  So what either took is not in ``U`` and acts on
the unpowered arm by its law; what neither took is in ``U`` and is not added again.  By what an effect ``enters``:

- ``compensation``, ``state`` (taken off, whatever the abstraction's kind and whatever torque was recorded): its law is put back;
- ``viscous``, and a cubic that the abstraction holds: in the abstraction, not in ``U``: put back by the same law;
- ``inertia``: in the rigid body and rotors, of the abstraction as of the stop: nothing to add;
- ``input_gain``: scales a torque that no motor gives with its power off: nothing to add, and nothing of it is in ``U``;
- ``input_delay``: stays in ``U``, though a late reading moves no unpowered arm: ``U`` is only too wide;
- ``swing`` (a role): stays in ``U`` as far as the powered arm swung; a braked gear may swing farther: no stop is bounded.

Values are those that were taken off, so what they are wrong by is in ``U``; their standard deviations come on top.
Compensated torque came without the drive's own Coulomb friction and gravity: gravity is put back by the rigid body, that
friction is not known and counted as none.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.effects.base import REFERENCE_TEMPERATURE, Effect, Fitted
from stopset.effects.bound import ACTING, Acting, Sight, acting, misread, uncovered
from stopset.effects.registry import get
from stopset.effects.signals import tilt_directions
from stopset.errors import EffectError, NotCovered
from stopset.reach.stops.brakes import brakes_of
from stopset.reach.stops.expansion import Curvature, curvature, expand
from stopset.reach.stops.payload import bodies, largest_gravity
from stopset.ring import Interval
from stopset.robot.rigid import Chain
from stopset.sets import Box

Array = NDArray[np.float64]
FRICTION_TOLERANCE = 0.25  # relative, on top: friction drifts with wear, oil and temperature
BEYOND = 0.5  # [rad] how far past the identified angles `Torques.everywhere` holds
# rows of a sum over effects: friction that never drives, what else opposes the motion, and what may push
RUBS, RUBS_VISCOUS, DRY, VISCOUS, PUSH = range(5)


@dataclass(frozen=True, slots=True)
class Friction:
    """Dry and viscous friction as intervals: ``dry`` [N m], ``viscous`` [N m s/rad], ``push``: torque on the arm in any
    direction [N m], (n,) each."""

    dry: Box
    viscous: Box
    push: Box


@dataclass(frozen=True, slots=True)
class _Entry:
    """One effect on one joint; ``partner``: the other joint of a pair."""

    fitted: Fitted
    effect: Effect
    joint: int
    partner: int | None


@dataclass(frozen=True, slots=True)
class _Body:
    """The rigid body as the laws see it; ``tilted``: with gravity's derivatives by roll and pitch in gravity's place."""

    chain: Chain
    pi: Array
    half: Array
    K: Curvature
    tilted: tuple[tuple[Chain, Curvature], ...]

    @classmethod
    def of(cls, chain: Chain, pi: Array, half: Array, tilts: bool) -> _Body:
        chains = [chain._replace(gravity=d) for d in tilt_directions(chain.gravity)] if tilts else []
        return cls(chain, pi, half, _curvature(chain, pi, half), tuple((c, _curvature(c, pi, half)) for c in chains))


@dataclass(frozen=True, slots=True)
class Torques:
    """The effects of a model that act in a stop, prepared.

    ``fixed`` (5, n, 2): the sum of those that depend on no pose and no other joint, which holds up to ``speed`` (n,) [rad/s],
    infinite where they do not depend on it either; ``roaming``: the others; ``fastest`` (n,) [rad/s]: seen in identification;
    ``everywhere``: over all identified angles, and `BEYOND` them, and speeds.
    """

    entries: tuple[_Entry, ...]
    roaming: tuple[_Entry, ...]
    body: _Body
    gear: Array
    temp: Box | None
    base: Array
    fixed: Array
    speed: Array
    fastest: Array
    everywhere: Friction

    @property
    def settled(self) -> bool:
        """Whether nothing depends on where the arm is and how fast it goes."""
        return not self.roaming and bool(np.all(np.isinf(self.speed)))

    def over(self, q: Box, speed: Array) -> Friction:
        """At angles in ``q`` (n,) [rad], no joint faster than ``speed`` (n,) [rad/s]."""
        slow = not np.any(speed > self.speed)
        total = self.fixed.copy() if slow else self.base.copy()
        entries = self.roaming if slow else self.entries
        if entries:
            sights = _sights(self, q, speed, {name for e in entries for name in e.effect.needs})
            for e in entries:
                _add(total, e, sights, speed)
        return _friction(total, speed)


def torques_of(model: Model, payload: tuple[float, float] | None = None, com: Array | None = None) -> Torques:
    """The effects of ``model`` for stops with a ``payload`` [kg], default the domain's, at ``com`` (3,) [m], default the flange.

    Raises `NotCovered` with the label of an effect that cannot be bounded.
    """
    n, brakes = model.n, brakes_of(model)
    payload = model.domain.payload if payload is None else payload
    com = model.robot.tip if com is None else com
    entries = _entries(model)
    pi, half = bodies(model, payload, com)
    body = _Body.of(model.robot.chain, pi, half, any("tilt" in e.effect.needs for e in entries))
    gear = largest_gravity(model, payload[1], com) + (0.0 if brakes is None else brakes.torque.hi)
    fastest = np.maximum(np.abs(model.domain.dq.lo), np.abs(model.domain.dq.hi))
    base = np.zeros((5, n, 2))
    damped = {e.joint for e in entries if e.effect.enters == "viscous"}
    for i in set(range(n)) - damped:  # the abstraction's linear friction, where nothing better is known
        base[RUBS_VISCOUS, i] += model.abstraction.viscous[i, 0]
    fixed, speed, roaming = base.copy(), np.full(n, np.inf), []
    blind = tuple(
        Sight(float(v), float(v), float(g), temp=_kelvin(model.domain.temp, i))
        for i, (v, g) in enumerate(zip(fastest, gear, strict=True))
    )
    for e in entries:
        try:
            here = acting(e.effect, e.fitted, blind[e.joint])
        except NotCovered:  # it looks at more than the joint's own speed, or cannot be bounded at all
            roaming.append(e)
            continue
        other = replace(blind[e.joint], speed=3.0 * blind[e.joint].speed + 1.0, past=3.0 * blind[e.joint].past + 1.0)
        quick = acting(e.effect, e.fitted, other)
        if not all(np.array_equal(getattr(here, k), getattr(quick, k)) for k in ("dry", "viscous", "push")):
            speed[e.joint] = fastest[e.joint]
        _put(fixed, e, here)
    out = Torques(entries, tuple(roaming), body, gear, model.domain.temp, base, fixed, speed, fastest, _friction(fixed, fastest))
    q = Box(model.domain.q.lo - BEYOND, model.domain.q.hi + BEYOND)
    return replace(out, everywhere=out.over(q, fastest))


def misreadings(model: Model, fastest: Array) -> Box:
    """(2n,) true less recorded state, of the effects that misread a position, up to ``fastest`` (n,) [rad/s]."""
    n, lo, hi = model.n, np.zeros(2 * model.n), np.zeros(2 * model.n)
    for f in model.effects:
        effect = _known(f)
        if effect.role != "reading":
            continue
        for i in _places(effect, f, model):
            q = Interval(model.domain.q.lo[i] - BEYOND, model.domain.q.hi[i] + BEYOND)
            position, share = misread(effect, f, q)
            speed = share * Interval(np.array(-fastest[i]), np.array(fastest[i]))
            lo[[i, n + i]] += float(position.lo), float(speed.lo)
            hi[[i, n + i]] += float(position.hi), float(speed.hi)
    return Box(lo, hi)


def described(model: Model) -> tuple[str, ...]:
    """What stop bounds make of the effects, in sentences, where it is not friction."""
    of = {
        role: [f.label for f in model.effects if _known(f).role == role]
        for role in ("torque", "arm or drive", "input", "reading")
    }
    out = []
    if of["torque"]:
        out.append(f"on the arm with its drives off, each by its law wherever the stop may lead: {', '.join(of['torque'])}")
    if of["arm or drive"]:
        out.append(f"with and without, as it may be the drive's own: {', '.join(of['arm or drive'])}")
    if of["input"]:
        out.append(f"only in the motors' torque, of which there is none with the power off: {', '.join(of['input'])}")
    if of["reading"]:
        out.append(f"angles are the true ones, the recorded ones set right by {', '.join(of['reading'])}")
    return tuple(out)


def _known(f: Fitted) -> Effect:
    try:
        return get(f.effect)
    except EffectError as e:
        raise NotCovered(uncovered(f, "it is in no catalogue that is installed here")) from e


def _places(effect: Effect, f: Fitted, model: Model) -> tuple[int, ...]:
    try:
        return effect.acts_on(f.joint, model.joints)
    except EffectError as e:
        raise NotCovered(uncovered(f, str(e))) from e


def _entries(model: Model) -> tuple[_Entry, ...]:
    out = []
    for f in model.effects:
        effect = _known(f)
        if effect.role == "swing":
            raise NotCovered(uncovered(f, "it swings in a way that a rigid arm does not have"))
        if effect.role not in ACTING:
            continue
        places = _places(effect, f, model)
        pair = effect.scope == "pair"
        out += [_Entry(f, effect, i, sum(places) - i if pair else None) for i in places]
    return tuple(out)


def _curvature(chain: Chain, pi: Array, half: Array) -> Curvature:
    return Curvature(*(x + y for x, y in zip(curvature(chain, pi), curvature(chain, half), strict=True)))


def _kelvin(temp: Box | None, i: int) -> Interval | None:
    """Above the reference temperature, over the domain [K]."""
    return None if temp is None else Interval(temp.lo[i] - REFERENCE_TEMPERATURE, temp.hi[i] - REFERENCE_TEMPERATURE)


def _add(total: Array, e: _Entry, sights: Sequence[Sight], speed: Array) -> None:
    sight = sights[e.joint]
    if e.partner is not None:
        sight = replace(sight, other=float(speed[e.partner]))
    _put(total, e, acting(e.effect, e.fitted, sight))


def _put(total: Array, e: _Entry, a: Acting) -> None:
    rubs = e.effect.role == "friction"
    total[RUBS if rubs else DRY, e.joint] += a.dry
    total[RUBS_VISCOUS if rubs else VISCOUS, e.joint] += a.viscous
    total[PUSH, e.joint] += a.push


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


def _sights(x: Torques, q: Box, speed: Array, needs: Collection[str]) -> list[Sight]:
    """What the laws see at angles in ``q``, no joint faster than ``speed``: expansions at the middle, and what lies beyond."""
    body, middle, r = x.body, q.centre, q.radius
    E = expand(body.chain, body.pi, body.half, np.zeros(len(r)), middle)
    # rounding of the middle and the radius: a hair more
    r = r + 1e-12

    def around(value: Array, half: Array, most: Array) -> tuple[Array, Array]:
        return np.maximum(value - half, -most), np.minimum(value + half, most)

    def gravity(chain: Chain, K: Curvature) -> tuple[Array, Array]:
        e = E if chain is body.chain else expand(chain, body.pi, body.half, np.zeros(len(r)), middle)
        bend = 0.5 * np.einsum("ikl,k,l->i", K.g, r, r)
        return around(e.g, np.abs(e.dg) @ r + np.abs(e.gp) + np.abs(e.dgp) @ r + bend, K.load)

    load, K = gravity(body.chain, body.K), body.K
    tilts = [gravity(c, k) for c, k in body.tilted]
    stiff = inertia = coriolis = None
    own = np.arange(len(r))
    if "stiff" in needs:
        stiff = around(E.dg[own, own], np.abs(E.dgp[own, own]) + K.g[own, own] @ r, K.load)
    if "inertia" in needs:
        half = np.abs(E.Mp[own, own]) + (np.abs(E.dM[own, own]) + np.abs(E.dMp[own, own])) @ r
        half = half + 0.5 * np.einsum("ikl,k,l->i", K.M[own, own], r, r)
        lo, hi = around(E.M[own, own], half, K.size)
        inertia = np.maximum(lo, 0.0), hi
    if "coriolis" in needs:
        size = np.einsum("ikl,k,l->i", np.abs(E.Gamma) + np.abs(E.Gammap) + K.Gamma @ r, speed, speed)
        coriolis = -size, size

    def at(ends: tuple[Array, Array] | None, i: int) -> Interval | None:
        return None if ends is None else Interval(ends[0][i], ends[1][i])

    return [
        Sight(
            float(speed[i]), float(x.fastest[i]), float(x.gear[i]), Interval(q.lo[i], q.hi[i]), at(load, i), None, _kelvin(x.temp, i),
            (Interval(tilts[0][0][i], tilts[0][1][i]), Interval(tilts[1][0][i], tilts[1][1][i])) if tilts else None,
            at(stiff, i), at(inertia, i), at(coriolis, i),
        )
        for i in range(len(r))
    ]  # fmt: skip
