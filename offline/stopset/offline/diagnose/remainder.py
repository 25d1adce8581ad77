"""What the claims leave: variables that the rest depends on, joints whose variance is more than their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.evidence.hypothesis import Hyper
from stopset.offline.diagnose.explain.residual import Dependence, dependences, slow_excess
from stopset.offline.diagnose.search.search import Claim, Found
from stopset.types import Array


@dataclass(frozen=True, slots=True)
class Left:
    """What the claims leave: ``depends`` by joint, best variable first; ``noisy`` joints have too much variance, in rows or slowly.

    ``hyper``, ``theta``: the whole model refitted with the claims; ``ranking``: all variables by joint.
    """

    hyper: Hyper
    theta: Array
    ranking: dict[int, list[Dependence]]
    depends: dict[int, list[Dependence]]
    noisy: tuple[int, ...]
    contradicted: tuple[int, ...]  # joints whose own claims leave much of what they should have explained
    scattering: tuple[int, ...]

    @property
    def worst(self) -> int | None:
        if self.depends:
            return max(self.depends, key=lambda j: self.depends[j][0].gain)
        return next(iter((*self.noisy, *self.scattering)), None)


def left_of(found: Found) -> Left:
    now, engine = found.now, found.now.engine
    hyper, p = now.fit(found.hyper)
    depends, contradicted, wandering = {}, [], []
    ranking: dict[int, list[Dependence]] = {j: [] for j in range(engine.data.n)}
    for j in range(engine.data.n):
        if len(engine.rows[j].take) < limit.PATTERN_ROWS:
            continue
        ranked = ranking[j] = dependences(now, p.theta, hyper, j)
        if slow_excess(now, p.theta, hyper, j) > limit.WANDER:
            wandering.append(j)
        if ranked[0].gain > limit.PATTERN:
            depends[j] = ranked
            if _contradicts(ranked[0], found, j):
                contradicted.append(j)
    noisy = tuple(dict.fromkeys([*wandering, *(j for j, e in enumerate(found.excess) if e > limit.QUIET)]))
    scattering = tuple(j for j, s in enumerate(found.hyper.sigma) if s > limit.FRICTION_SCATTER)
    return Left(hyper, p.theta, ranking, depends, noisy, tuple(contradicted), scattering)


def _contradicts(rest: Dependence, found: Found, joint: int) -> bool:
    """Whether a pattern left at a joint speaks against its own claims, by evidence and by size.

    Evidence alone would not do: it saturates where a claim takes nearly all away, and what a law leaves whose form is a little off
    (a dress pack that stiffens is no straight spring) is still large beside the sensors' noise.
    """
    claims = _at(found, joint)
    by_evidence = rest.gain > limit.PATTERN_SHARE * sum(c.score for c in claims)
    return bool(claims) and by_evidence and pattern_size(rest, found, joint) > limit.PATTERN_SIZE


def pattern_size(rest: Dependence, found: Found, joint: int) -> float:
    """Variance of a pattern left at a joint over what its claims took away."""
    taken = sum(max(0.0, c.excess_before[joint] - c.excess_after[joint]) for c in _at(found, joint))
    left = rest.share * found.excess[joint]
    return left / taken if taken else (np.inf if left > 0 else 0.0)


def _at(found: Found, joint: int) -> list[Claim]:
    """The claims that act at a joint, and gears that explain a good part of it: they shake their neighbours."""
    return [c for c in found.claims if not c.joints or joint in c.joints or shakes(c, joint)]


def shakes(claim: Claim, joint: int) -> bool:
    """Whether a claim is of a gear that explains a good part of what a joint's rows left unexplained."""
    swings = claim.scored.candidate.effect.role == "swing"
    return swings and _good_part(claim.excess_before[joint], claim.excess_after[joint])


def verdict_of(found: Found, left: Left) -> str:
    """unknown: something is left that no claim accounts for, and nothing found explains a good part of it.

    A joint of which a model leaves no more than of its own recordings has nothing new to account for.
    """
    same = found.now.engine.as_before
    contradicted, depends, noisy, scattering = (
        [j for j in joints if not same[j]] for joints in (left.contradicted, left.depends, left.noisy, left.scattering)
    )
    if contradicted or ((depends or noisy) and not _telling(found.claims)):
        return "unknown"
    if found.claims:
        return "missing"
    return "unknown" if scattering else "none"


def _telling(claims: Sequence[Claim]) -> bool:
    """Whether one claim alone takes away a good part of what some joint's rows left unexplained."""
    return any(_good_part(b, a) for c in claims for b, a in zip(c.excess_before, c.excess_after, strict=True))


def _good_part(before: float, after: float) -> bool:
    """Whether a joint's variance over its sensors' noise falls by a good part of what is not that noise."""
    return before > limit.SENSORS and before - after > limit.TELLING * (before - 1.0)


def accounts_for(found: Found, left: Left, joint: int, share: float, refused: Sequence[Claim] = ()) -> bool:
    """Whether a change of a level that leaves ``share`` of the torque's variance at a joint accounts for that joint.

    Where the search, to which levels are free within their drift, leaves no more than noise, a level is all that can have changed.
    Where something is left, a level explains a part of anything: it must explain as much as a claim must.  What a claim took up that was
    ``refused``, as its numbers are none that it can have, is left, too: the search found more there than levels that drift, and no name.
    """
    unnamed = any(joint in c.joints and c.excess_before[joint] > limit.SENSORS for c in refused)
    if joint not in left.depends and joint not in left.noisy and not unnamed:
        return True
    before = found.claims[0].excess_before[joint] if found.claims else found.excess[joint]
    return _good_part(before, before * share)
