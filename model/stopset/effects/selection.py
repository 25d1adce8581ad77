"""Effects as users name them: ``warm_up`` (every joint) or ``warm_up:arm_1_joint``."""

from __future__ import annotations

from stopset.effects.base import Effect, Fitted
from stopset.effects.registry import get
from stopset.errors import EffectError
from stopset.robot import Robot


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
