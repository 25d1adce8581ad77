"""Whether Coriolis and centrifugal torque is taken off the input at the measured speed, as gravity is at the measured angle.

A model with a constant mass matrix lacks it, and U then holds the largest that was recorded, at all times.  Taken off it costs
nothing: no number is fitted in it, so every trial may judge.  Stop bounds have it in their own dynamics either way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stopset.offline.abstraction.metrics import torque_error
from stopset.offline.abstraction.nominal_part import NominalPart, pairs_of
from stopset.offline.campaign.survey import Survey
from stopset.types import Array

LOWERS = 0.05  # share by which it must lower the torque error, in the (geometric) mean over joints


def swift(nominal: NominalPart, found: Survey, effort: str) -> NominalPart:
    """``nominal`` with the input that leaves less of the torque unexplained over a stop's length, and the choice in a sentence."""
    plain = nominal.abstraction
    if plain.kind != 1 or effort == "compensated_torque":
        return nominal
    taken = replace(plain, swift=True)
    before, after = (lacking(replace(nominal, abstraction=a), found, effort) for a in (plain, taken))
    if not np.all(np.isfinite(before)) or float(np.mean(np.log(after / before))) > np.log1p(-LOWERS):
        return nominal
    j = int(np.argmax(before - after))
    note = (
        "Coriolis and centrifugal torque is taken off at the measured speeds, as gravity is: what the linear model lacks over a stop's "
        f"length falls from {before.sum():.3g} to {after.sum():.3g} N m, summed over joints ({nominal.robot.joints[j]}: {before[j]:.3g} to "
        f"{after[j]:.3g}), and U need not hold it"
    )
    return replace(nominal, abstraction=taken, notes=(*nominal.notes, note))


def lacking(nominal: NominalPart, found: Survey, effort: str) -> Array:
    """(n,) RMS [N m] of what the abstraction lacks over a stop's length; never zero."""
    pairs = pairs_of(lambda: found.sample, found, nominal, effort)
    e = [torque_error(nominal.abstraction, found.dt, r.q, r.dq, u) for _, r, u in pairs()]
    rows = np.concatenate(e) if e else np.zeros((0, nominal.robot.n))
    return np.asarray(np.sqrt(np.mean(rows**2, axis=0)) + 1e-12) if len(rows) else np.full(nominal.robot.n, np.nan)
