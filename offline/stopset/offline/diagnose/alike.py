"""Laws that these recordings cannot tell from a claimed one: it is named with all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.effects import catalogue
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.candidate import Candidate
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.search.search import Claim
from stopset.offline.diagnose.search.wanted import askable


@dataclass(frozen=True, slots=True)
class Undecided:
    """Effects that say as much as a claimed one at its joint, ``why``, and what would tell them apart; none where it stands alone."""

    effects: tuple[str, ...] = ()
    why: str = ""
    experiment: str = ""


def alike(engine: Engine, claim: Claim) -> Undecided:
    """What looks like a claimed law of the position where its joint moved over so little that a bent law is all but straight.

    There evidence is no judge: a straight line is the plainest of all that fit, whichever law it is a piece of.  A law that is seen to
    bend there is no straight one, and evidence tells it from the other bent ones, or they are its rivals.
    """
    c = claim.scored.candidate
    if claim.alike:
        joint = engine.data.joints[c.joints[0]]
        return Undecided(
            claim.alike,
            f"within such a lag hardly anything happens to {joint}'s torque that these recordings show over its noise",
            f"Drive {joint} with torque that changes within a few milliseconds (reversals, steps, up to 60 Hz), recorded at 500 Hz or more.",
        )
    if len(c.joints) != 1 or tuple(c.effect.needs) != ("q",):
        return Undecided()
    (j,) = c.joints
    travel = float(np.ptp(engine.rows[j].plain(engine.data.q[:, j])))
    if travel >= limit.STRAIGHT:
        return Undecided()
    others = _finer(engine, c)
    if not others:
        return Undecided()
    joint = engine.data.joints[j]
    return Undecided(
        others,
        f"{joint} moved by {travel:.2g} rad only, over which they look alike",
        f"Move {joint} slowly over {limit.STRAIGHT:.2g} rad or more, gravity loading it as little as possible, and diagnose that recording.",
    )


def _finer(engine: Engine, c: Candidate) -> tuple[str, ...]:
    """Laws that a claimed one is the plainer form of, where they may be."""
    finer = [e for e in catalogue().values() if c.effect.name in e.refines and askable(engine, e)]
    return tuple(e.name for e in finer if not e.loaded or engine.loaded(c.joints))
