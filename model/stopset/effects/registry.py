"""Which effects there are: every file of this folder that holds an ``EFFECT``, and those of installed packages."""

from __future__ import annotations

import importlib
import math
import pkgutil
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

from stopset.effects.base import Effect, Part, Role, Shape, Term
from stopset.effects.bound import silent_at_rest
from stopset.errors import EffectError

GROUP = "stopset.effects"


@cache
def catalogue() -> MappingProxyType[str, Effect]:
    """All effects by name, ours first, then those registered by other packages.

    Raises `EffectError` if a registered object is not a sound effect or takes a name twice.
    """
    found: dict[str, Effect] = {}
    for info in pkgutil.iter_modules([str(Path(__file__).parent)]):
        if info.name not in ("base", "bound", "registry", "selection", "signals", "memory"):
            effect = importlib.import_module(f"stopset.effects.{info.name}").EFFECT
            found[effect.name] = effect
    for entry in sorted(entry_points(group=GROUP), key=lambda e: e.name):
        try:
            effect = entry.load()
        except Exception as e:
            raise EffectError(
                f"effect {entry.name} of {entry.value} cannot be loaded ({type(e).__name__}: {e}); mend or remove that package"
            ) from e
        check(effect, entry.value)
        if effect.name in found:
            raise EffectError(f"effect {effect.name} of {entry.value} has the name of another one; rename it")
        found[effect.name] = effect
    return MappingProxyType(found)


def names() -> tuple[str, ...]:
    """The names of all effects."""
    return tuple(catalogue())


def get(name: str) -> Effect:
    """The effect of that name (``-`` and ``_`` alike). Raises `EffectError` with the known names."""
    effect = catalogue().get(name.strip().lower().replace("-", "_"))
    if effect is None:
        raise EffectError(f"{name!r} is no effect of the catalogue; expected one of {', '.join(catalogue())}")
    return effect


def check(effect: Any, where: str) -> None:
    """Refuse what would break later: no effect at all, a parameter without unit, an empty range, a start outside it."""
    if not isinstance(effect, Effect):
        raise EffectError(f"{where} is a {type(effect).__name__}; expected a stopset.effects.Effect")
    parameters: list[Term | Shape] = [*effect.terms, *effect.shapes]
    for p in parameters:
        if not p.unit or not p.means:
            raise EffectError(f"{where}: parameter {p.symbol} of {effect.name} lacks a unit or a meaning; state both")
        if not p.lo < p.hi:
            raise EffectError(f"{where}: {effect.name}.{p.symbol} ranges from {p.lo} to {p.hi}; expected lo < hi")
    for s in effect.shapes:
        if not s.grid or not all(s.lo <= g <= s.hi and math.isfinite(g) for g in s.grid):
            raise EffectError(f"{where}: start values {s.grid} of {effect.name}.{s.symbol} leave [{s.lo}, {s.hi}]")
    if not effect.terms:
        raise EffectError(f"{where}: {effect.name} has no term; expected at least one parameter the torque is linear in")
    if not (effect.says and effect.look_at and effect.needs):
        raise EffectError(f"{where}: {effect.name} lacks its sentence, what to look at, or the signals it needs")
    if effect.role not in get_args(Role):
        raise EffectError(f"{where}: {effect.name} has the role {effect.role!r}; expected one of {', '.join(get_args(Role))}")
    if effect.part not in get_args(Part):
        raise EffectError(f"{where}: {effect.name} is the part {effect.part!r}; expected one of {', '.join(get_args(Part))}")
    if effect.usual and (effect.states or effect.shapes or effect.scope == "arm"):
        raise EffectError(
            f"{where}: {effect.name} is to be tried unasked and is not linear, has a memory or is of the whole arm; expected a law of "
            "joints that a regression holds: leave `usual` at 0"
        )
    if effect.periodic and (len(effect.shapes) != 1 or effect.needs != ("q",)):
        raise EffectError(f"{where}: {effect.name} is called periodic; expected a law of q with one shape, its cycles per turn")
    if effect.role == "reading" and effect.reading is None:
        raise EffectError(f"{where}: {effect.name} misreads a position and does not say by how much; give its `reading`")
    if effect.role == "friction" and not silent_at_rest(effect):
        raise EffectError(
            f"{where}: {effect.name} is called friction and pulls at a joint that stands; expected a law that is zero there, or the "
            "role torque"
        )
