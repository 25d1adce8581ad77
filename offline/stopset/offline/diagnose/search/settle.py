"""Which of several contenders is claimed: the likeliest, unless a simpler law says as much."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace

import numpy as np

from stopset.effects import Effect, get
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, EffectKey, Scored
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.scores import score_new
from stopset.offline.diagnose.search.held_out import HeldOut, held_out, on_motions
from stopset.offline.diagnose.search.moment_arms import distinct, geared
from stopset.offline.diagnose.search.predicts import as_described
from stopset.offline.diagnose.search.refine import refine
from stopset.offline.diagnose.search.settled import Settled, all_refitted, refines, refitted
from stopset.offline.diagnose.search.wanted import askable, asked, load_forms
from stopset.offline.diagnose.side_by_side import side_by_side


def settle(
    now: Hypothesis,
    best: Sequence[Scored],
    hyper: Hyper,
    refused: Set[EffectKey] = frozenset(),
    names: Sequence[str] | None = None,
) -> tuple[Settled, tuple[Scored, ...]]:
    """Of contenders, ``best`` first, the one to claim, and its rivals.

    Whoever's score lacks more than a claim's evidence, and at the best one's joints what its form takes up, is out of the question.
    The likeliest is claimed; but of laws that look alike at its joints the simplest that leaves as little, but for a claim's evidence,
    when it may be off by `SAME_LAW`, and was not ``refused`` for what it leaves: a finer law must say more than that the plainer one is
    not quite true, as one with levers of its own does that is `distinct`.  One that explains the rows with numbers that it cannot have,
    as a spring that pushes, gives way to the likeliest that need not, but to no finer form of itself.  One to none of whose numbers the
    rows give a size, as two terms and levers that bend into any curve, gives way to the likeliest of those that have one and lack less
    than a claim's evidence.  A finer law that does not lower the held-out error of its plainer form, as any claim must, is not named for it,
    nor another law at the joint of one that the model has, for that one.  ``names``: of the effects that are asked for, where not all are.
    """
    first = refitted(now, best[0], hyper)
    lacks = [first.taken_up * _touch(s.candidate, first.candidate) + limit.THRESHOLD for s in best]
    near = [s for s, lack in zip(best[1:], lacks[1:], strict=True) if s.score > best[0].score - lack]
    settled = [first, *all_refitted(now, near, hyper)]
    settled = geared(settled, now, hyper)
    likeliest = max(settled, key=lambda x: x.evidence)
    keys = {x.candidate.key for x in settled}
    plainer = _plainer(now, likeliest, hyper, refused, names)
    settled += [x for x in plainer if x.candidate.key not in keys and not said_already(now.active, x.candidate)]
    separate = [x for x in settled if x.evidence > likeliest.evidence - limit.THRESHOLD and distinct(x, settled)]
    likeliest = max(separate, key=lambda x: x.evidence, default=likeliest)
    alike = [x for x in settled if not separate and _simplifies(x.candidate, likeliest.candidate)]
    enough = [x for x in alike if _excused(x, likeliest) > likeliest.evidence - limit.THRESHOLD]
    top = min(enough, key=lambda x: (_size(x.candidate), -x.mended), default=likeliest)
    if not top.possible:
        sound = (x for x in settled if x.possible and not refines(x.candidate, top.candidate))
        top = max(sound, key=lambda x: x.evidence, default=top)
    if not top.weighed:
        near_it = (x for x in settled if x.possible and x.evidence > top.evidence - limit.THRESHOLD and x.weighed)
        top = max(near_it, key=lambda x: x.evidence, default=top)
    is_distinct = any(x is top for x in separate)
    top = max((x for x in settled if _leaves_as_little(x, top, is_distinct=is_distinct)), key=lambda x: x.evidence, default=top)
    top = max((x for x in settled if _stays(x, top)), key=lambda x: x.evidence, default=top)
    return top, tuple(s for s in (best[0], *near) if s.candidate.key != top.candidate.key)


def _excused(plainer: Settled, likeliest: Settled) -> float:
    """Evidence of a plainer law whose form may be off: not where it has more numbers, as the linear law of a load beside the quadratic one."""
    return plainer.mended if _size(plainer.candidate) < _size(likeliest.candidate) else plainer.evidence


def _leaves_as_little(plainer: Settled, top: Settled, *, is_distinct: bool) -> bool:
    """Whether a plainer form of the ``top`` law leaves as little, but for what a claim must lower, on motions that were not fitted.

    Evidence of many rows is large for a form that is off by what no prediction shows.  One that is `distinct` says more than that: where the
    plainer form needs links that are off by more than their tolerance, it is judged with links as described (`as_described`).
    """
    return (
        refines(top.candidate, plainer.candidate)
        and plainer.weighed
        and _lowers_too_little(top, plainer, is_distinct=is_distinct)
    )


def _stays(own: Settled, top: Settled) -> bool:
    """Whether a law that identification chose in these recordings stays: the ``top`` one at its joint leaves as much of what was not fitted.

    To name the other one would take out of the model a law that explains as much.  Where its own leaves the sensors' noise alone, evidence is
    what it says: links, whose description speaks against it, may take up the difference, which then shows in no other motion.
    """
    a, b = own.candidate, top.candidate
    if a.key not in top.now.engine.chosen or b.key in top.now.engine.chosen or a.joints != b.joints:
        return False
    left = own.now.excesses(own.fit.theta, own.hyper)
    likelier = top.evidence > own.evidence + limit.THRESHOLD and all(left[j] <= limit.SENSORS for j in a.joints)
    return not likelier and _lowers_too_little(top, own)


def _lowers_too_little(top: Settled, other_law: Settled, *, is_distinct: bool = False) -> bool:
    """Whether ``top`` does not lower the held-out error of another law at its joint by what a claim must."""
    if not other_law.possible:
        return False
    (j,) = top.candidate.joints
    finer, other = held_out(top.now, top.hyper), held_out(other_law.now, other_law.hyper)
    if is_distinct:
        other = as_described(other_law.now, top.candidate, other, top.hyper)
    lowers = any(share > limit.LOWERED for share in _lowered(other, finer, j))
    return not lowers or not _lowers_on_motions(other_law.now, other_law.hyper, top)


def _lowered(before: HeldOut, after: HeldOut, joint: int) -> tuple[float, float]:
    """Shares by which a joint's error falls, in all and within the motions."""
    both = ((before.whole, after.whole), (before.within, after.within))
    whole, within = (1.0 - float(y[joint]) / max(float(x[joint]), 1e-12) for x, y in both)
    return whole, within


def _lowers_on_motions(now: Hypothesis, hyper: Hyper, top: Settled) -> bool:
    """Whether ``top`` lowers the error that ``now`` has on whole motions, in all or within them, and raises neither, where motions are so few
    that blocks of time are held out.

    Such a block lies between what was fitted before and after it: four numbers of a law and four motions leave no scatter between these.
    """
    before, after = on_motions(now, hyper), on_motions(top.now, top.hyper)
    if before is None or after is None:
        return True
    shares = _lowered(before, after, top.candidate.joints[0])
    return max(shares) > limit.LOWERED and min(shares) > -limit.LOWERED


def shows_in_its_place(now: Hypothesis, top: Settled) -> bool:
    """Whether the finer law ``top`` shows on whole motions, where these are few, in the place of the plainer one that ``now`` has."""
    return _lowers_on_motions(now, now.fit(top.hyper)[0], top)


def said_already(active: Sequence[Candidate], c: Candidate) -> bool:
    """Whether a law that is ``active`` at the same joints says what ``c`` would: the same one, or another form of the same plainer law.

    What the form of a balancing spring leaves looks like a spring, and is no second one; a finer form may still replace a plainer one.
    """

    def forms(x: Candidate) -> set[str]:
        return {x.effect.name, *x.effect.refines}

    return any(a.joints == c.joints and not refines(c, a) and bool(forms(a) & forms(c)) for a in active)


def instead(now: Hypothesis, plainer: Candidate, top: Settled, hyper: Hyper) -> Settled:
    """The finer law of ``top`` in the place of a plainer one that was claimed: there is one spring, not two."""
    base = now.without(plainer.key)
    h, _ = base.fit(hyper)
    return refitted(base, refine(base, top.scored, h), h)


def likeliest_gear(
    now: Hypothesis, gear: Settled, rivals: tuple[Scored, ...], hyper: Hyper
) -> tuple[Settled, tuple[Scored, ...]]:
    """The likeliest of a claimed gear and of the `other_gears`, all with their true swing, and its rivals: those that are as likely.

    A joint's own gear may be none of the contenders, where it swings faster than was looked for, and one that it shakes the best of them.
    """
    others = all_refitted(now, other_gears(now, gear, hyper), hyper)
    best = max((gear, *others), key=lambda x: x.evidence)
    least = best.evidence - best.taken_up - limit.THRESHOLD
    return best, (*rivals, *(x.scored for x in (gear, *others) if x is not best and x.evidence > least))


def other_gears(now: Hypothesis, gear: Settled, hyper: Hyper) -> tuple[Scored, ...]:
    """Gears of other joints that explain nearly as much as a claimed one whose link swings faster than was looked for.

    Its stiffness came out beyond `SWINGS`, where no other joint's was asked; a gear shakes its neighbours at its own frequency.
    """
    c = gear.candidate
    if c.effect.role != "swing" or within_reach(now.engine, c):
        return ()
    M = np.median(np.diagonal(now.engine.source.mass, axis1=1, axis2=2), axis=0)
    ratio = M / M[c.joints[0]]

    def of(j: int) -> Scored | None:
        shapes = {**gear.scored.candidate.shapes, "K": c.shapes["K"] * ratio[j], "D": c.shapes["D"] * ratio[j]}
        s = score_new(now, c.effect, (j,), shapes, hyper)
        return refine(now, s, hyper) if s is not None and s.score > 0 else None

    others = [j for j, x in enumerate(ratio) if x > 0 and j not in c.joints and now.engine.rows[j].size > limit.FEWEST_ROWS]
    least = gear.scored.score - gear.taken_up - limit.THRESHOLD
    return tuple(s for s in side_by_side(of, others) if s is not None and s.admissible and s.score > least)


def within_reach(engine: Engine, c: Candidate) -> bool:
    """Whether a gear's link swings as slowly as was looked for."""
    M = float(np.median(engine.source.mass[:, c.joints[0], c.joints[0]]))
    return c.shapes["K"] < limit.SWINGS[1] ** 2 * M


def _plainer(now: Hypothesis, best: Settled, hyper: Hyper, refused: Set[EffectKey], names: Sequence[str] | None) -> list[Settled]:
    """Laws without shapes that look like the one of ``best``, are plainer and could be claimed themselves, at its joints."""
    c = best.candidate
    alike = map(get, dict.fromkeys((*c.effect.refines, *c.effect.looks_like)))
    fewer = [e for e in alike if e.scope == c.effect.scope and not e.shapes and _plainer_than(e, c, names)]
    laws = [e for e in fewer if askable(now.engine, e) and (e.name, c.joints) not in refused]
    forms = [(e, form) for e in laws if e.enters == c.effect.enters for form in load_forms(now.engine, e, c.joints)]
    scored = (score_new(now, e, c.joints, form, hyper) for e, form in forms)
    sound = [s for s in scored if s is not None and s.admissible and s.score >= limit.THRESHOLD]
    return all_refitted(now, [replace(s, score=min(s.score, best.scored.score)) for s in sound], hyper)


def _plainer_than(e: Effect, c: Candidate, names: Sequence[str] | None) -> bool:
    """Whether a law has fewer parameters than a candidate, or refined by it has more and is one of the ``names`` that are asked for."""
    return len(e.terms) < _size(c) or (e.name in c.effect.refines and asked(e, names))


def _touch(a: Candidate, b: Candidate) -> bool:
    """Whether two effects act at one joint."""
    return not a.joints or not b.joints or bool(set(a.joints) & set(b.joints))


def _simplifies(a: Candidate, b: Candidate) -> bool:
    """Whether ``a`` says with fewer parameters what looks like ``b`` at the same joints, or is a plainer form of it."""
    alike = a.effect.name in (*b.effect.looks_like, *b.effect.refines)
    return a.joints == b.joints and alike and (_size(a) < _size(b) or refines(b, a))


def _size(c: Candidate) -> int:
    """Parameters of a candidate's law."""
    return len(c.effect.terms) + len(c.effect.shapes)
