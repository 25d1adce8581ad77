"""Whether an updated model asks for a new nominal model: what later recordings say about the one that was kept.

An update keeps the nominal model, because envelopes hold for one nominal model only.  Its own sums are folded on, though:
solved again they are the nominal model of all recordings together, to rounding, and what it would change is compared with
the torque error.  Compensated torque is fitted by simulation, which has no such sums; there, and everywhere, the
torque error on the new recordings is held against that on the old ones.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from stopset.artifact import Model
from stopset.effects.base import Fitted
from stopset.offline.abstraction.metrics import Figures
from stopset.offline.campaign.survey import Survey
from stopset.offline.nominal import NormalEquations, accumulate, solve_nominal
from stopset.offline.nominal.known_effects import described, plain
from stopset.recording import Recording
from stopset.robot import Robot
from stopset.types import Array

SHARE = 0.3  # of the torque error: a new nominal model that differs by more takes five percent off it
GROWN = 1.25  # times: a torque error on new recordings that is larger says that they are of another arm, or another day
DUE = "identify again from all recordings"


def folded(data: NormalEquations, robot: Robot, model: Model, new: Iterable[Recording], found: Survey) -> NormalEquations:
    """The nominal model's sums with those of ``new`` trials, motions that judge the sets left out; ``robot`` as described."""
    known = _known(data, model)
    cad = described(robot, known)
    held = found.held_out
    arm = cad.with_parameters(data.reference)  # what is known was taken off the earlier ones as this arm's laws say it
    trials = (plain(r, arm, known, found.warm(r)) for r in new if r.suite_key not in held)
    return data + accumulate(cad, trials, data.layout.effects, data.settings, data.reference, compensated=data.compensated)


def _known(data: NormalEquations, model: Model) -> tuple[Fitted, ...]:
    """Effects whose numbers the nominal regression was given, not those it found."""
    return tuple(f for f in model.effects if f"{f.effect}:{f.joint}" not in data.layout.effects)


def torque_difference(data: NormalEquations, robot: Robot, model: Model) -> Array:
    """RMS torque (n,) [N m] over all samples of ``data`` by which its own nominal model differs from the one in ``model``."""
    again = solve_nominal(described(robot, _known(data, model)), data)
    friction = {(f.effect, f.joint): f.values for f in model.effects}
    values = [friction[c.effect.name, model.joints[j]][c.symbol] for j, cs in enumerate(data.layout.columns) for c in cs]
    change = again.theta - np.concatenate([model.robot.pi.ravel(), model.rotor, values])
    out = np.zeros(model.n)
    for j in range(model.n):
        index = data.layout.index(j)
        H = data.moving[:, j].sum(axis=0)[: len(index), : len(index)]
        out[j] = np.sqrt(max(float(change[index] @ H @ change[index]), 0.0) / max(float(data.rows_moving[:, j].sum()), 1.0))
    return out


def note(model: Model, old: Figures, new: Figures, difference: Array | None) -> str:
    """What the new recordings say about the nominal model that was kept, in one sentence; ``difference``: see `torque_difference`."""
    before, after = ([row["torque_rmse"] for row in f.result(model.joints).values()] for f in (old, new))
    ratio = [a / b if a is not None and b else 1.0 for a, b in zip(after, before, strict=True)]
    worst = int(np.argmax(ratio))
    says = (
        f"the torque error on the new recordings is {ratio[worst]:.2f} times that on the old ones at most ({model.joints[worst]})"
    )
    due = ratio[worst] > GROWN
    if difference is not None:
        share = difference / np.maximum(model.powered.U.radius, 1e-12)
        j = int(np.argmax(share))
        says += (
            f"; a nominal model of all recordings would differ by {difference[j]:.3g} N m RMS, {share[j]:.0%} of U's half-width"
        )
        says += f", at {model.joints[j]}"
        due |= bool(share[j] > SHARE)
    return f"{says}: {DUE if due else 'no new identification is due'}"
