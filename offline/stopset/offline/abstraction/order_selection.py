"""The abstraction of an identified arm, its order chosen by the error on trials that neither it nor the numbers were fitted to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stopset.artifact import Abstraction
from stopset.effects.base import Fitted
from stopset.errors import RecordingError
from stopset.offline.abstraction.grid import GRID, coarser
from stopset.offline.abstraction.identified import Chosen, IdentifiedArm, best_order, candidates
from stopset.offline.abstraction.nominal_part import NominalPart, fit_nominal, pairs_of
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.survey import Survey
from stopset.recording import Recording
from stopset.types import Array

Held = Callable[[Recording], bool]


def abstracted(run: Run, known: tuple[Fitted, ...], nominal: NominalPart) -> NominalPart:
    """``nominal`` with the abstraction that the settings ask for; ``run``: of the trials it was fitted to.

    Without an order, each candidate is built from a nominal model of one half of the motions and predicts the other half.
    Raises `RecordingError` for a model that compensated torque cannot give.
    """
    robot, meta, found = run.robot, run.meta, run.survey
    kind, order = run.settings.model, run.settings.order
    compensated = meta.effort == "compensated_torque"  # one lag per joint is all it shows
    orders = (order,) if order is not None else candidates(robot, nominal.effects, kind)
    if kind == 1 and (orders == (1,) or (order is None and compensated)):
        return nominal  # linear, as it was made
    if compensated:
        raise RecordingError(
            f"model {kind} of order {order or 'any'} needs the arm's inertias, which compensated torque does not "
            "show; give recordings of motor torque, or take --model 1 --order 1"
        )
    if len(orders) == 1:
        chosen = _best(nominal, found, found.sample, meta.effort, kind, orders)
        return replace(nominal, abstraction=chosen.abstraction, notes=(*nominal.notes, chosen.note))
    held = _half(found)
    if held is None:
        judged = _best(nominal, found, found.sample, meta.effort, kind, orders)
        note = f"{judged.note}; one trial has nothing held out, so this is the error on the trial it was fitted to"
    else:
        rest = replace(found, sample=tuple(r for r in found.sample if not held(r)))
        half = fit_nominal(replace(run, trials=lambda: (r for r in run.trials() if not held(r)), survey=rest), known)
        judged = _best(half, found, tuple(r for r in found.sample if held(r)), meta.effort, kind, orders)
        note = f"{judged.note} on trials held out of the fit"
    chosen = _best(nominal, found, found.sample, meta.effort, kind, (judged.abstraction.order,))
    return replace(nominal, abstraction=chosen.abstraction, notes=(*nominal.notes, note))


def _half(found: Survey) -> Held | None:
    """Which trials judge: every other motion, or every other repetition of a single motion; None: there is one trial."""
    numbers = sorted({found.motion[r.suite_key] for r in found.sample})
    if len(numbers) > 1:
        judges = frozenset(numbers[1::2])
        return lambda r: r.phase == found.phase and found.motion.get(r.suite_key) in judges
    places = frozenset(r.place for r in found.sample[1::2])
    return (lambda r: r.phase == found.phase and r.place in places) if places else None


def _best(
    nominal: NominalPart, found: Survey, trials: tuple[Recording, ...], effort: str, kind: int, orders: tuple[int, ...]
) -> Chosen:
    """The abstraction of ``nominal`` whose order predicts ``trials`` best."""
    poses = np.vstack([r.q[:: max(1, len(r.q) // 20)] for r in found.sample])
    every = max(1, round(GRID / found.dt))

    def seen(model: Abstraction) -> list[tuple[Array, Array]]:
        pairs = pairs_of(lambda: trials, found, replace(nominal, abstraction=model), effort)
        return coarser([(np.hstack([r.q, r.dq]), u) for _, r, u in pairs()], every)

    standstill = nominal.abstraction.standstill
    arm = IdentifiedArm(nominal.robot, nominal.rotor, nominal.effects, poses, standstill if standstill.size else None)
    return best_order(arm, kind, orders, seen, every * found.dt)
