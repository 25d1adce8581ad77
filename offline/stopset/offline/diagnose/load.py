"""What is said of a load: its numbers are those of a body, its mass has an interval, and what would weigh it better.

Gravity tells a load's mass and centre; its inertia shows where the arm accelerates only, and there a real arm's large joints leave much
that is no load.  So a free fit gave 2.9 kg an inertia of -0.11 +- 0.03 kg m^2.  While effects are looked for the inertia stays free, so
that what is left there bends neither mass nor centre.

Source: Wensing, Kim & Slotine (2018), Linear matrix inequalities for physically consistent inertial parameter identification.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stopset.effects import Effect
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.answer import Parameter
from stopset.offline.diagnose.evidence.uncertainty import TWO_SIDES
from stopset.offline.nominal.physical import SMALL, pseudo_inertia
from stopset.robot.arm import standard_parameters
from stopset.types import Array

# measured on a UR10e that carried nothing (benchmarks/payload_limits.py): 0.8 kg too much by its description, 2.2 to 0.3 kg with its torque
# 15 % too small or too large
CARRIED_BY_LINKS = " The error hardly falls with it, because the links' masses, fitted again, carry it as well."
WEIGHED_ALONE = (
    " It was weighed against the robot's description alone, whose masses and torque scale decide as much: record these motions without it, "
    "`stopset identify` from that, and diagnose this recording against that model."
)
NO_SUCH_BODY = " The inertia that fits best is no body's: stated is that of the nearest one, known no better than the two differ."


def nearest_body(free: Array) -> Array:
    """``free`` (10,) standard parameters where a body can have them, else with the inertia of the body nearest to them.

    Mass and first moments stay; second moments about the centre that are negative become those of a body as small as `SMALL`.
    Of a load that is missing, whose mass is negative, the parameters are those of a body taken off.
    """
    sign = np.sign(free[0])
    m, centre = abs(free[0]), free[1:4] / free[0]
    central = sign * pseudo_inertia(free)[:3, :3] - m * np.outer(centre, centre)
    size, axes = np.linalg.eigh(central)
    if size[0] >= 0.0:
        return free
    second = (axes * np.maximum(size, m * SMALL**2)) @ axes.T
    body = standard_parameters(m, centre, np.trace(second) * np.eye(3) - second)
    return np.concatenate([free[:4], sign * body[4:]])


def of_a_body(effect: Effect, numbers: Mapping[str, Parameter]) -> Mapping[str, Parameter]:
    """The numbers of a claim; of a load those of the nearest body, and how far an inertia was moved counts to its error."""
    if not effect.carried:
        return numbers
    body = nearest_body(np.array([p.value for p in numbers.values()])).tolist()
    return {k: p if x == p.value else _moved(p, x) for (k, p), x in zip(numbers.items(), body, strict=True)}


def _moved(p: Parameter, to: float) -> Parameter:
    return Parameter(to, p.unit, None if p.std is None else float(np.hypot(p.std, to - p.value)))


def says(
    effect: Effect, fitted: Mapping[str, Parameter], stated: Mapping[str, Parameter], *, described: bool, lowered: float
) -> str:
    """The effect's sentence; of a payload also what it weighs, in an interval, where its centre is, and what would weigh it better.

    ``fitted``: its numbers as the rows have them, ``stated`` `of_a_body`; ``described``: it is held against the robot's description, not
    against a model from recordings without it; ``lowered``: share of the held-out error that it takes away.
    """
    m = stated["m"] if effect.carried else None
    if m is None or m.std is None:
        return effect.says
    half = TWO_SIDES * m.std
    lo, hi = m.value - half, m.value + half
    if lo < 0.0 < hi:  # that it is there, or gone, is known by itself: the description's masses decide how much it is
        lo, hi = (0.0, hi) if m.value > 0.0 else (lo, 0.0)
    text = f"{effect.says} {m.value:.2f} kg (95 %: {lo:.2f} to {hi:.2f} kg)"
    alone = (CARRIED_BY_LINKS if lowered < limit.STANDS_OUT else "") + WEIGHED_ALONE if described else ""
    if abs(m.value) < half:
        return f"{text}.{alone}"
    centre = ", ".join(f"{stated[k].value / m.value:.3f}" for k in ("mx", "my", "mz"))
    body = NO_SUCH_BODY if stated != fitted else ""
    return f"{text}, centre at ({centre}) m in the last link's frame.{body}{alone}"


def joints_disagree(shares: Mapping[str, float]) -> str:
    """What is said of joints that feel a load heavier or lighter than the others by their ``shares``; empty where all agree."""
    if not shares:
        return ""
    each = ", ".join(f"{joint} {1.0 + share:.2f}" for joint, share in shares.items())
    return (
        f" The joints do not agree on it (times what they say together: {each}), which its interval holds: check their torque constants, "
        "or weigh the tool."
    )
