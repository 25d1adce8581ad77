"""The held-out rule, one for all commands: how much of the error on motions that it was not fitted to a claim must take away."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate, EffectKey, Scored
from stopset.offline.diagnose.evidence.hypothesis import Hyper, Hypothesis
from stopset.offline.diagnose.evidence.scores import scores
from stopset.offline.diagnose.search.held_out import HeldOut, held_out
from stopset.offline.diagnose.search.settled import refines
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Step:
    """One claim more: held-out torque error ``before`` and ``after``, why that is too little, empty where it is not, and at which
    joints it acts, empty for the whole arm; ``inner``: it is within motions that it shows, not in the whole error; ``halves``: of the
    errors of either half of the time."""

    before: HeldOut
    after: HeldOut
    why: str
    joints: tuple[int, ...] = ()
    inner: bool = False
    halves: bool = False

    @property
    def stated(self) -> tuple[Array, Array]:
        """(n,) [N m] each: the errors before and after, at its joints those in which it shows."""
        here = np.isin(np.arange(len(self.before.whole)), self.joints) | (not self.joints)
        all_of_it = (x.halves if self.halves and x.halves is not None else x.whole for x in (self.before, self.after))
        inner = (x.within for x in (self.before, self.after))
        before, after = (np.where(here & self.inner, within, whole) for within, whole in zip(inner, all_of_it, strict=True))
        return before, after

    @property
    def joint(self) -> int:
        """Where, of its joints, it takes most away."""
        before, after = self.stated
        where = list(self.joints) or list(range(len(before)))
        return where[int(np.argmax((before - after)[where]))]


def step(
    now: Hypothesis, candidate: Candidate, before: HeldOut, hyper: Hyper, earlier: Sequence[Candidate], left: Sequence[float] = ()
) -> Step:
    """What ``candidate`` takes off the error ``before`` of ``now``, which has the ``earlier`` claims.

    ``left``: each joint's residual variance over its sensors' noise when all claims are known; empty while they are being looked for.
    """
    return judged(now, candidate, before, held_out(now.plus(candidate), hyper), hyper, earlier, left)


def judged(
    now: Hypothesis, candidate: Candidate, before: HeldOut, after: HeldOut, hyper: Hyper, earlier: Sequence[Candidate],
    left: Sequence[float] = (),
) -> Step:  # fmt: skip
    """`step` where the error ``after`` is known.

    A delay is judged against ``now`` with its joint's stamps held: far off, they would imitate a good part of it.
    What a free base model takes up can't show in motions that were not fitted: it is weighed against the description instead.
    Against a model from other recordings, whose base is not free, it must show where it is a gain, in all or within the motions, as links
    may be off by a few percent of a joint's torque, or stands beside other claims; so must, where its joint keeps more than its noise, a
    second one of its kind, as two of them share what one description is off by (half a degree of tilt beside a load), and one of a single
    joint: what else that joint keeps looks like a scale or a rotor, and no other joint speaks against it.
    Where links must be off by more than their tolerance without a law with levers and are not with it, it is judged against links as described.
    Where a joint keeps more than its noise whatever is claimed, many a law takes up a few percent of it: there a cause must stand out.
    What a law of friction shows too little in the whole error it may show within the motions, whatever scale friction has in each: there,
    too, it must stand out.
    Where blocks of time are held out it must show in either half of the time by a fit of the other one as well: a block has what was fitted
    on both sides of it, at the same places of the arm, and any curve lies between these.
    """
    if candidate.effect.enters == "input_delay":
        before = held_out(replace(now, held=(int(now.engine.stamps[candidate.joints[0]]),)), hyper)
    before = as_described(now, candidate, before, hyper)
    inner = Step(before, after, "", candidate.joints, inner=True)
    whole = replace(inner, inner=False)
    doubtful = _keeps_more(whole, left) and (bool(candidate.joints) or any(c.effect.absorbed for c in earlier))
    gain = candidate.effect.enters == "input_gain" and now.engine.modelled
    unseen = gain and max(_lowered(whole)[1], _lowered(inner)[1]) <= limit.LOWERED
    if candidate.effect.absorbed and not (doubtful or unseen or (earlier and now.engine.modelled)):
        return whole
    whole = replace(whole, why=too_little(whole, candidate, earlier, left))
    if before.halves is not None and not whole.why:
        return replace(whole, why=too_little(replace(whole, halves=True), candidate, earlier, left))
    hidden = whole.why and candidate.effect.role == "friction"
    return inner if hidden and not too_little(inner, candidate, earlier, left) else whole


def as_described(now: Hypothesis, candidate: Candidate, before: HeldOut, hyper: Hyper) -> HeldOut:
    """The error ``before`` a claim with a place and levers of its own, with links that are what their description says, where ``hyper`` of
    the fit with the claim has them so and without it they must be off by more than their tolerance.

    Links that may be anything take up a gas spring over half a radian: what it explains shows in no other motion then, but in the description.
    Of a straight piece of a law, or of a curve that bends as it likes, that may be the description's error as well.
    """
    geometric = candidate.effect.shapes and candidate.effect.refines
    if not geometric or not hyper.scale <= 1.0 < before.scale:
        return before
    same, _ = now.refit(replace(hyper, forms=()))
    return held_out(now, same)


def outdone(s: Scored, asked: Sequence[Scored], refused: Set[EffectKey]) -> bool:
    """Whether what a free base takes up at one joint is said far better by a law that was ``refused`` there, of all that were ``asked``.

    Such a claim need not show in motions that were not fitted, the other law must: that one does not show there is no reason to name the
    other, which explains less of the same torque.  Nor is a law that was refused named in a finer form that says no more.
    """
    c = s.candidate
    if any(x.candidate.key in refused and refines(c, x.candidate) and x.score > s.score for x in asked):
        return True
    same = (x for x in _far_likelier(s, asked, refused) if x.candidate.joints == c.joints)
    return bool(c.joints and c.effect.absorbed) and any(same)


def outdone_elsewhere(now: Hypothesis, s: Scored, asked: Sequence[Scored], refused: Set[EffectKey], hyper: Hyper) -> bool:
    """`outdone` of a claim of the whole arm or of one joint: whether beside such a law of one other joint nothing of it is left.

    A load or a tilted base loads every joint.  One that says nothing but a part of what a law of one joint would is another name of that
    joint's torque.  So is a scale of one joint whose links another joint's scale has moved: of a creeping UR10e whose shoulder read 11 % less,
    that scale took 21 % of the elbow's error away and 1 % of its own; 12 % of the elbow were named, which took 19 %.
    """
    c = s.candidate
    if not c.effect.absorbed:
        return False
    local = (x for x in _far_likelier(s, asked, refused) if len(x.candidate.joints) == 1 and x.candidate.joints != c.joints)
    return any(scores(now.plus(x.candidate), [c], hyper)[0].score < limit.THRESHOLD for x in local)


def _far_likelier(s: Scored, asked: Sequence[Scored], refused: Set[EffectKey]) -> Iterator[Scored]:
    """Of all that were ``asked`` those that were ``refused`` and say more than ``s`` by a claim's evidence."""
    return (x for x in asked if x.candidate.key in refused and x.score > s.score + limit.THRESHOLD)


def _lowered(x: Step) -> tuple[int, float]:
    """At which of its joints the largest share of the error goes, and that share."""
    where = list(x.joints) or list(range(len(x.stated[0])))
    share = 1.0 - x.stated[1][where] / x.stated[0][where]
    return where[int(np.argmax(share))], float(np.max(share))


def _keeps_more(x: Step, left: Sequence[float]) -> bool:
    """Whether that joint keeps more than its noise whatever is claimed."""
    return len(left) > 0 and left[_lowered(x)[0]] > limit.QUIET


def too_little(x: Step, candidate: Candidate, earlier: Sequence[Candidate], left: Sequence[float]) -> str:
    """Why an error falls too little, empty where it does not."""
    lowered, expected, beside = _lowered(x)[1], _least(candidate, earlier), ""
    if candidate.effect.role == "swing" and lowered > limit.LOWERED:
        # it shakes its neighbours, whose rows may hold less noise than its own
        lowered = _lowered(replace(x, joints=()))[1]
    keeps = x.inner or _keeps_more(x, left)
    if keeps and expected < limit.STANDS_OUT:
        expected, beside = limit.STANDS_OUT, ", as much is left there that nothing explains"
    where = "the other half of these recordings than was fitted" if x.halves else "motions that were not fitted"
    falls = f"lowers the error on {where} by {lowered:.1%}"
    rises = f"raises the error on {where} by {-lowered:.1%}, which it should lower"
    why = f"it {rises if lowered < 0 else falls}; expected more than {expected:.0%}{beside}"
    return "" if lowered > expected else why


def _least(candidate: Candidate, earlier: Sequence[Candidate]) -> float:
    """The share that a claim must lower; a finer form of an earlier claim is no second cause."""
    if candidate.effect.role == "swing":
        return limit.LOWERED_SWING
    if any(set(candidate.joints) & set(c.joints) and c.effect.name not in candidate.effect.refines for c in earlier):
        return limit.LOWERED_MORE
    return limit.LOWERED
