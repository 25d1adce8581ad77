"""Effects by what they are to the arm, and as users name them: ``warm_up`` (every joint) or ``warm_up:arm_1_joint``."""

from __future__ import annotations

from functools import cache

from stopset.effects.base import Effect, Fitted, Part
from stopset.effects.registry import catalogue, get
from stopset.errors import EffectError
from stopset.robot import Robot


@cache
def of_part(part: Part) -> Effect:
    """The effect that changes this number of a plain arm; of several packages' the first."""
    return next(e for e in catalogue().values() if e.part == part)


def base() -> tuple[str, ...]:
    """The laws that are part of every model from the start."""
    return tuple(e.name for e in catalogue().values() if e.base)


def usual(scope: str = "joint") -> tuple[str, ...]:
    """The laws that identification tries unasked, in their order."""
    found = (e for e in catalogue().values() if e.usual and e.scope == scope)
    return tuple(e.name for e in sorted(found, key=lambda e: e.usual))


def usual_friction() -> tuple[str, ...]:
    """Friction that drives commonly have, constant torques aside: what is left out of a model looks like something else."""
    return (*base(), *(name for name in usual() if not get(name).part))


def parse_effect(name: str, robot: Robot) -> tuple[Effect, tuple[str, ...]]:
    """The effect and the joints it is asked for; all joints where none is named. Raises `EffectError`."""
    effect, _, joint = name.partition(":")
    if joint and not set(joint.split("+")) <= set(robot.joints):
        raise EffectError(f"{name}: {robot.name} has no joint {joint!r}; expected one of {', '.join(robot.joints)}")
    return get(effect), tuple(joint.split("+")) if joint else robot.joints


def matches(fitted: Fitted, name: str) -> bool:
    """Whether a fitted effect is what ``name`` asks for."""
    effect, _, joint = name.partition(":")
    return fitted.effect == effect and (not joint or fitted.joint == joint)
