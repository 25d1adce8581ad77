"""Claims held against the model as it is: what is missing from it since must take away a part of what it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stopset.artifact import Model
from stopset.effects import get
from stopset.offline.diagnose.answer import Ranked
from stopset.offline.diagnose.changes import left_beside_friction
from stopset.offline.diagnose.examination import Examination, examine
from stopset.offline.diagnose.question import Inquiry
from stopset.offline.diagnose.standing import moves
from stopset.progress import Progress, silent
from stopset.recording import Recording


def examined(q: Inquiry, progress: Progress = silent, names: Sequence[str] | None = None) -> Examination:
    """`examine` of what is asked, its claims held against the model where that is from other recordings."""
    x = examine(q.robot, q.asked, q.fitted, q.before, names=names, progress=progress)
    return x if q.model is None else replace(x, ranked=_held(q.model, q, x.ranked))


def given_by_state(r: Ranked) -> bool:
    """Whether the arm's measured state tells a named law's torque, so that a model can be given it."""
    law = get(r.effect)
    return law.compensated() and not law.states and "warm" not in law.needs


def _held(model: Model, q: Inquiry, ranked: tuple[Ranked, ...]) -> tuple[Ranked, ...]:
    """The claims, with an objection where the model leaves more of a joint with a claim's torque than without it.

    The search lets links, scales and levels be others within what a model may be off.  So two of them may cancel: a spring beside links
    that weigh less, of which neither is there, where a model is wrong by a little at poses that it has not seen.  Of friction levels are
    others every day, and from motion to motion: a law of it is not asked.
    """
    known = {f.label for f in model.effects}
    moving = [r for r in q.recordings if moves(r)]
    while True:
        named = [r for r in ranked if not r.objection and r.label not in known]
        added = [r for r in named if given_by_state(r)]
        others = [r for r in named if r not in added]
        alone = [r for r in added if len(r.joints) == 1 and get(r.effect).role != "friction"]
        asked = [r for r in alone if not any(not o.joints or set(o.joints) & set(r.joints) for o in others)]
        if not asked:
            return ranked
        rises = {r.label: _rise(model, moving, added, r) for r in asked}
        worst = max(asked, key=lambda r: rises[r.label])
        if rises[worst.label] <= 0.0:
            return ranked
        why = (
            f"the model leaves {rises[worst.label]:.0%} more of that joint with it than without: what it explains is what links and levels "
            "that are others beside it would"
        )
        ranked = tuple(replace(r, objection=why) if r is worst else r for r in ranked)


def _rise(model: Model, moving: Sequence[Recording], added: Sequence[Ranked], r: Ranked) -> float:
    """By what share the torque that a model leaves of a claim's joint rises with it, beside all others that are ``added``."""
    j = model.joints.index(r.joints[0])
    with_it, without = (
        left_beside_friction(replace(model, effects=(*model.effects, *(x.fitted for x in chosen))), moving)[j]
        for chosen in (added, [x for x in added if x is not r])
    )
    return float(with_it / max(without, 1e-12)) - 1.0
