"""Causes outside the catalogue that are hidden in the independent arm: the right answer is "unknown"."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from independent_arm import Array
from independent_hidden import Hidden, between, fault, of_friction, put, replaced
from independent_sets import Truth


def _other(t: Truth, j: int, u: float) -> int:
    others = [k for k in range(t.arm.n) if k != j]
    return others[int(u * len(others))]


def _bump(t: Truth, j: int, x: float, u: Array) -> Truth:
    return put(t, j, BUMP=x, BUMP_AT=(u[0] - 0.5) * t.reach[j], BUMP_WIDTH=0.08 + 0.12 * u[1])


def _walk(t: Truth, j: int, x: float, u: Array) -> Truth:
    return replace(t, walk=replaced(t.walk, j, np.array([x, 3 + 15 * u[0]])))


def _resonance(t: Truth, j: int, x: float, u: Array) -> Truth:
    return put(t, j, RESONANCE=x, RES_AT=0.25 + 0.4 * u[0], RES_WIDTH=0.05 + 0.07 * u[1])


def _chatter(t: Truth, j: int, x: float, u: Array) -> Truth:
    return put(t, j, CHATTER=x, CHATTER_HZ=4 + 8 * u[0])


def _snag(t: Truth, j: int, x: float, u: Array) -> Truth:
    return put(t, j, SNAG=x, SNAG_Q0=(0.1 + 0.4 * u[0]) * t.reach[j])


OUTSIDE: dict[str, Hidden] = {
    "bump": Hidden(_bump, *of_friction(1e-3, 2.0), mask="window"),
    "walk": Hidden(_walk, *of_friction(1e-3, 2.0)),
    "resonance": Hidden(_resonance, *of_friction(1e-3, 2.0)),
    # friction by another joint's speed, or with the position; a torque that follows a product
    "cross_friction": Hidden(lambda t, j, x, u: put(t, j, CROSS=x, CROSS_JOINT=_other(t, j, u[0])), *of_friction(1e-3, 2.0)),
    "weave": Hidden(
        lambda t, j, x, u: put(t, j, WEAVE=x, WEAVE_N=3.0, WEAVE_JOINT=_other(t, j, u[0])), *of_friction(1e-3, 3.0)),
    "uneven": Hidden(lambda t, j, x, u: put(t, j, UNEVEN=x, UNEVEN_Q0=0.6 * (u[0] - 0.5)), *of_friction(1e-3, 1.0)),
    "rough": Hidden(lambda t, j, x, u: put(t, j, ROUGH=x, ROUGH_N=round(2 + 5 * u[0])), *of_friction(1e-3, 0.9)),
    "push": Hidden(lambda t, j, x, u: fault(t, "push", j, x), *of_friction(1e-2, 8.0)),  # something touches now and then
    "wear": Hidden(lambda t, j, x, u: fault(t, "wear", j, x), *between(1e-2, 1.5)),  # grows through the session, warm or cold
    "chatter": Hidden(_chatter, *of_friction(1e-3, 2.0)),  # oscillates when slow, as in stick-slip
    "snag": Hidden(_snag, *of_friction(1e-3, 5.0)),  # a cable that pulls beyond some position only
    "frozen": Hidden(lambda t, j, x, u: fault(t, "frozen", j, x), *between(1e-3, 0.9)),  # the reading stands still at times
}  # fmt: skip
