"""Numbers of effects that were asked for, with the error before and after each: what the diagnosis itself says of them.

The whole catalogue is searched, so an effect gets the numbers it has beside all others, whichever command asks.  One that the
search does not name is looked for alone; what is then found is what these recordings give it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from stopset.effects.base import Fitted
from stopset.offline.diagnose.against_model import examined
from stopset.offline.diagnose.answer import Ranked
from stopset.offline.diagnose.examination import Examination
from stopset.offline.diagnose.question import Inquiry
from stopset.offline.diagnose.search.held_out import judged_on
from stopset.offline.diagnose.standing import moves
from stopset.progress import Progress, silent
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Estimate:
    """An effect where it was found: ``before``, ``after`` (n,) [N m] held-out torque error without and with it."""

    name: str  # as it was asked for
    found: Ranked
    before: Array
    after: Array

    @property
    def fitted(self) -> Fitted:
        return self.found.fitted


@dataclass(frozen=True, slots=True)
class Estimates:
    """What was found of what was asked for, ``before`` (n,) [N m] the error without any of it, and what it was judged on."""

    found: tuple[Estimate, ...]
    before: Array | None
    words: str


def estimates(q: Inquiry, names: Sequence[str], progress: Progress = silent) -> Estimates:
    """Estimates of the effects ``names`` (``effect`` or ``effect:joint``), in their order; one that left no trace is missing."""
    if not any(map(moves, q.asked)):
        return Estimates((), None, "nothing: no joint moves in these recordings")
    x = examined(q, progress)
    out = _of(x, [(name, _claims(x, name)) for name in names])
    out += _loose(x, names, [e.found.label for e in out])
    named = {e.name for e in out}
    for name in names:
        if name in named:
            continue
        beside = (*q.fitted, *(e.fitted for e in out))
        alone = examined(replace(q, fitted=beside), progress, [name.partition(":")[0]])
        out += _of(alone, [(name, _claims(alone, name))])
    return Estimates(tuple(sorted(out, key=lambda e: list(names).index(e.name))), x.found.before.whole, judged_on(x.engine))


def _claims(x: Examination, name: str) -> tuple[int, ...]:
    effect, _, joint = name.partition(":")
    return x.matching(effect, joint.split("+") if joint else None)


def _loose(x: Examination, names: Sequence[str], by_torque: Sequence[str]) -> list[Estimate]:
    """What angles behind the gears say: no torque shows it, so no torque error falls."""
    error = x.found.before.whole
    return [Estimate(name, r, error, error) for name in names for r in x.plays.beside(by_torque) if name in (r.effect, r.label)]


def _of(x: Examination, wanted: Sequence[tuple[str, tuple[int, ...]]]) -> list[Estimate]:
    order = list(dict.fromkeys(k for _, claims in wanted for k in claims))
    by = {k: name for name, claims in reversed(wanted) for k in claims}
    return [Estimate(by[k], x.ranked[k], *s.stated) for k, s in zip(order, x.steps(order), strict=True)]
