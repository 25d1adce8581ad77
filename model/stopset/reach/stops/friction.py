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

Values are those that were taken off, so what they are wrong by is in ``U``; their standard deviations come on top, of a
payload as the doubt of its mass (`payload.bodies`).
Compensated torque came without the drive's own Coulomb friction and gravity: gravity is put back by the rigid body, that
friction is not known and counted as none.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Model
from stopset.effects.base import REFERENCE_TEMPERATURE, Effect, Fitted
from stopset.effects.bound import ACTING, Acting, Sight, acting, misread, uncovered
from stopset.effects.signals import tilt_directions
from stopset.errors import EffectError, NotCovered
from stopset.reach.stops.brakes import brakes_of
from stopset.reach.stops.expansion import Curvature, Expansion, curvature, expand, gravity_curvature
from stopset.reach.stops.payload import bodies, effect_of, largest_gravity, weighed
from stopset.ring import Interval
from stopset.robot.rigid import Chain
from stopset.sets import Box
from stopset.types import Array

FRICTION_TOLERANCE = 0.25  # relative, on top: friction drifts with wear, oil and temperature
BEYOND = 0.5  # [rad] how far past the identified angles `Torques.everywhere` holds
ROUNDING = 1e-12  # of a middle, a radius and an expansion, relative to the largest
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
class _Group:
    """One effect wherever it acts: ``fitted`` at ``joints``, (m,) each; ``partners``: the other joints of pairs, else empty."""

    effect: Effect
    fitted: tuple[Fitted, ...]
    joints: tuple[int, ...]
    partners: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _Body:
    """The rigid body as the laws see it; ``tilted``: with gravity's derivatives by roll and pitch in gravity's place, and the
    bounds of what gravity then is (`gravity_curvature`)."""

    chain: Chain
    pi: Array
    half: Array
    K: Curvature
    tilted: tuple[tuple[Chain, Array, Array], ...]

    @classmethod
    def of(cls, chain: Chain, pi: Array, half: Array, tilts: bool) -> _Body:
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
    infinite where they do not depend on it either; ``roaming``: the others; ``fastest`` (n,) [rad/s]: seen in identification;
    ``everywhere``: over all identified angles, and `BEYOND` them, and speeds.
    """

    groups: tuple[_Group, ...]
    roaming: tuple[_Group, ...]
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
        groups = self.roaming if slow else self.groups
        if groups:
            sight = _sight(self, q, speed, {name for g in groups for name in g.effect.needs})
            for g in groups:
                other = speed[list(g.partners)] if g.partners else None
                _put(total, g, acting(g.effect, g.fitted, replace(sight.at(g.joints), other=other)))
        return _friction(total, speed)


def torques_of(model: Model, payload: tuple[float, float] | None = None, com: Array | None = None) -> Torques:
    """The effects of ``model`` for stops with a ``payload`` [kg], default the domain's, at ``com`` (3,) [m], default the flange.

    Raises `NotCovered` with the label of an effect that cannot be bounded.
    """
    n, brakes = model.n, brakes_of(model)
    payload = model.domain.payload if payload is None else payload
    com = weighed(model, com)[1]
    groups = _groups(model)
    pi, half = bodies(model, payload, com)
    body = _Body.of(model.robot.chain, pi, half, any("tilt" in g.effect.needs for g in groups))
    gear = largest_gravity(model, payload[1], com) + (0.0 if brakes is None else brakes.torque.hi)
    fastest = np.maximum(np.abs(model.domain.dq.lo), np.abs(model.domain.dq.hi))
    base = np.zeros((5, n, 2))
    damped = [i for g in groups if g.effect.enters == "damping" for i in g.joints]
    unknown = np.setdiff1d(np.arange(n), damped)  # there the abstraction's linear friction, as nothing better is known
    base[RUBS_VISCOUS, unknown] = model.abstraction.viscous[unknown, :1]
    fixed, speed, roaming = base.copy(), np.full(n, np.inf), []
    blind = Sight(fastest, fastest, gear, temp=_kelvin(model.domain.temp))
    quick = Sight(3.0 * fastest + 1.0, 3.0 * fastest + 1.0, gear, temp=blind.temp)
    for g in groups:
        try:
            here = acting(g.effect, g.fitted, blind.at(g.joints))
        except NotCovered:  # it looks at more than the joint's own speed, or cannot be bounded at all
            roaming.append(g)
            continue
        fast = acting(g.effect, g.fitted, quick.at(g.joints))
        for row, i in enumerate(g.joints):
            if any(np.any(getattr(here, k)[row] != getattr(fast, k)[row]) for k in ("dry", "viscous", "push")):
                speed[i] = fastest[i]
        _put(fixed, g, here)
    # damping below zero pushes the more the faster the joint goes
    drives = np.maximum(fixed[RUBS_VISCOUS, :, 0], 0.0) + fixed[VISCOUS, :, 0] < 0.0
    speed = np.where(drives, np.minimum(speed, fastest), speed)
    first = _friction(fixed, fastest)
    out = Torques(groups, tuple(roaming), body, gear, model.domain.temp, base, fixed, speed, fastest, first)
    q = Box(model.domain.q.lo - BEYOND, model.domain.q.hi + BEYOND)
    return out if out.settled else replace(out, everywhere=out.over(q, fastest))


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


def misreading(model: Model) -> tuple[str, ...]:
    """Labels of the effects by which positions are misread."""
    return tuple(f.label for f in model.effects if effect_of(f).role == "reading")


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
    if of["reading"]:
        out.append(f"angles are the true ones, the recorded ones set right by {', '.join(of['reading'])}")
    return tuple(out)


def _places(effect: Effect, f: Fitted, model: Model) -> tuple[int, ...]:
    try:
        return effect.acts_on(f.joint, model.joints)
    except EffectError as e:
        raise NotCovered(uncovered(f.label, str(e))) from e


def _groups(model: Model) -> tuple[_Group, ...]:
    found: dict[str, tuple[Effect, list[tuple[Fitted, int, int]]]] = {}
    for f in model.effects:
        effect = effect_of(f)
        if effect.role == "swing":
            raise NotCovered(uncovered(f.label, "it swings in a way that a rigid arm does not have"))
        if effect.role in ACTING:
            places = _places(effect, f, model)
            found.setdefault(effect.name, (effect, []))[1].extend((f, i, sum(places) - i) for i in places)
    return tuple(
        _Group(
            e, tuple(f for f, _, _ in rows), tuple(i for _, i, _ in rows), tuple(k for *_, k in rows) if e.scope == "pair" else ()
        )
        for e, rows in found.values()
    )


def _both(bounds: Callable[[Chain, Array], Sequence[Array]], chain: Chain, pi: Array, half: Array) -> Sequence[Array]:
    """``bounds`` of the middle payload and of half the range together."""
    out = bounds(chain, pi)
    return [x + y for x, y in zip(out, bounds(chain, half), strict=True)] if np.any(half) else out


def _kelvin(temp: Box | None) -> Interval | None:
    """(n,) above the reference temperature, over the domain [K]."""
    return None if temp is None else Interval(temp.lo - REFERENCE_TEMPERATURE, temp.hi - REFERENCE_TEMPERATURE)


def _put(total: Array, g: _Group, a: Acting) -> None:
    rubs = g.effect.role == "friction"
    for row, x in ((RUBS if rubs else DRY, a.dry), (RUBS_VISCOUS if rubs else VISCOUS, a.viscous), (PUSH, a.push)):
        np.add.at(total[row], list(g.joints), x)  # an effect may act on one joint more than once


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


def _sight(x: Torques, q: Box, speed: Array, needs: Collection[str]) -> Sight:
    """What the laws see at angles in ``q``, no joint faster than ``speed``: expansions at the middle, and what lies beyond."""
    body, middle, r = x.body, q.centre, q.radius + ROUNDING
    own = np.arange(len(r))
    still = np.zeros(len(r))
    E, K = expand(body.chain, body.pi, body.half, still, middle), body.K

    def around(value: Array, half: Array, most: Array) -> Interval:
        hair = ROUNDING * (1.0 + np.max(most))
        return Interval(np.maximum(value - half, -most) - hair, np.minimum(value + half, most) + hair)

    def gravity(e: Expansion, bend: Array, most: Array) -> Interval:
        near = np.abs(e.dg) @ r + np.abs(e.gp) + np.abs(e.dgp) @ r
        return around(e.g, near + 0.5 * np.einsum("ikl,k,l->i", bend, r, r), most)

    stiff = inertia = coriolis = None
    if "stiff" in needs:
        stiff = around(E.dg[own, own], np.abs(E.dgp[own, own]) + K.g[own, own] @ r, K.load)
    if "inertia" in needs:
        half = np.abs(E.Mp[own, own]) + (np.abs(E.dM[own, own]) + np.abs(E.dMp[own, own])) @ r
        inertia = around(E.M[own, own], half + 0.5 * np.einsum("ikl,k,l->i", K.M[own, own], r, r), K.size)
        inertia = inertia.maximum(0.0)
    if "coriolis" in needs:
        size = np.einsum("ikl,k,l->i", np.abs(E.Gamma) + np.abs(E.Gammap) + K.Gamma @ r, speed, speed) * (1.0 + ROUNDING)
        coriolis = Interval(-size, size)
    tilt = tuple(gravity(expand(c, body.pi, body.half, still, middle), *k) for c, *k in body.tilted) or None
    return Sight(
        speed,
        x.fastest,
        x.gear,
        Interval(q.lo, q.hi),
        gravity(E, K.g, K.load),
        None,
        _kelvin(x.temp),
        tilt,
        stiff,
        inertia,
        coriolis,
    )
