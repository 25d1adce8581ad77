"""What a row of a table says of every direction in which its axes may turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from stopset.reach.stops import Category, StopBound, StopBounds
from stopset.reach.stops.setting import beyond_domain
from stopset.reach.stops.types import LAYERS
from stopset.types import Array

NOT_COVERED = "not covered in"  # begins the remark of a row that speaks of some directions only


def in_every_direction(
    bounds: StopBounds, q: Array, group: Sequence[int], speed: Array, categories: Sequence[Category]
) -> list[tuple[StopBound, Array]]:
    """For each category what holds in every direction: both of one axis, every combination of several (`hull`); with the speeds
    (n,) [rad/s] of the one in which the axes of ``group`` turn farthest, of ``speed`` (n,) each.

    Of directions in which recordings have not seen such speeds nothing is said; where there are others the bound says so.
    """
    directions = []
    for signs in product((1.0, -1.0), repeat=len(group)):
        dq = np.zeros(len(q))
        dq[list(group)] = np.array(signs) * speed[list(group)]
        directions.append(dq)
    covered = [dq for dq in directions if bounds.extrapolate_state or not beyond_domain(bounds.model, q, dq)] or directions
    worst = []
    for c in categories:
        found = [bounds.bound(q, dq, c) for dq in covered]
        first = int(np.argmax([_badness(b, group) for b in found]))
        worst.append((hull(found[first], found), covered[first]))
    if len(covered) == len(directions):
        return worst
    only = f"{NOT_COVERED} {len(directions) - len(covered)} of {len(directions)} directions, in which no recording is as fast"
    return [(replace(b, why="; ".join(x for x in (b.why, only) if x)), dq) for b, dq in worst]


def _badness(bound: StopBound, group: Sequence[int]) -> float:
    angle = bound.angle
    return float("inf") if angle is None else float(angle[list(group)].max())


def hull(first: StopBound, found: Sequence[StopBound]) -> StopBound:
    """The bound of each of the stops ``found``, with the words of ``first``, which has no number if any has none.

    The tool may go farthest where axes do not turn farthest: turning the same way they carry it together.  What is swept is that
    of the direction in which the tool goes farthest; of directions in space nothing is said.
    """
    if first.time is None:
        return first
    largest: dict[str, Any] = {
        name: np.max([getattr(b, name) for b in found], axis=0)
        for name in ("time", "forward", "back", "speed", "links", "link_speed", "tcp", "tcp_speed")
    }
    largest |= {name: float(largest[name]) for name in ("tcp", "tcp_speed")}
    box = np.array([np.asarray(b.tcp_box) for b in found])
    left = [b.fallback for b in found]
    known = [x for x in left if x is not None]
    far = max(found, key=lambda b: b.tcp or 0.0)
    said = dict.fromkeys(part for b in found for part in b.why.split("; ") if part)
    return replace(
        first, **largest, tcp_box=np.stack([box[:, :, 0].min(axis=0), box[:, :, 1].max(axis=0)], axis=1),
        holding_margin=np.min([np.asarray(b.holding_margin) for b in found], axis=0), capsules=far.capsules, motion=None,
        fallback=(max(x[0] for x in known), max(x[1] for x in known)) if len(known) == len(left) else None,
        layer=max((b.layer for b in found), key=LAYERS.index), why="; ".join(said),
        assumptions=tuple(dict.fromkeys(a for b in found for a in b.assumptions)),
        end_stops=tuple(dict.fromkeys(j for b in found for j in b.end_stops)),
        here=tuple(dict.fromkeys(a for b in found for a in b.here)), certified=all(b.certified for b in found),
        extrapolated="; ".join(dict.fromkeys(b.extrapolated for b in found if b.extrapolated)),
    )  # fmt: skip
