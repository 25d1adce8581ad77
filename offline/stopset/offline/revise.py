"""Add an effect to a model: a new revision that re-identifies everything, judged on data the fit has not seen.

The judgement comes first and is cheap: the nominal model with and without the effect is fitted on one half of the motions
(or of the repetitions, where there are few motions) and simulated on the other.  Only then is the whole model identified
again.  An effect that does not help is refused, with the numbers, unless forced.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stopset.artifact import Model, Revision
from stopset.effects import get
from stopset.effects.base import Fitted
from stopset.errors import EffectError
from stopset.offline.effect_names import find, parse_effect
from stopset.offline.identify import Settings, identify, nominal_figures
from stopset.offline.survey import survey
from stopset.reach.stops import stop
from stopset.recording import Recording, read_recordings, stream_recordings
from stopset.robot import Robot
from stopset.robot.arm import robot_from_text

Tell = Callable[[str], None]

# an effect helps if one error falls by this share on held-out data while the other does not rise by as much
HELPS = 0.02
SHIFTS = frozenset({"inertia", "input_gain"})  # where an effect enters that a free fit would absorb


@dataclass(frozen=True, slots=True)
class Revised:
    """Outcome of `add`: the new model (None if refused), held-out errors and model figures before and after."""

    model: Model | None
    before: dict[str, float]
    after: dict[str, float]
    helps: bool
    judged_on: str


def add(
    model: Model, effect: str, joint: str | None, paths: Sequence[str | Path], force: bool = False, tell: Tell = lambda _: None
) -> Revised:
    """A revision of ``model`` with ``effect`` (at ``joint``, or wherever its scope says), identified from ``paths``.

    Raises `EffectError` if the effect or joint is unknown or already part of the model.
    """
    robot = description(model)
    name = f"{effect}:{joint}" if joint else effect
    parse_effect(name, robot)
    settings = settings_of(model)
    if name in settings.effects:
        raise EffectError(f"{name} is already part of this model; name another effect, or identify again with other data")
    more = replace(settings, effects=(*settings.effects, name))
    held, judged_on = _halves(robot, paths)
    shift = get(effect).enters in SHIFTS
    known = with_it = _known(model)
    if model.effort != "compensated_torque":
        tell(f"estimating {name}")
        everything = read_recordings(paths, robot)
        half = replace(everything, trials=tuple(r for r in everything if r.phase == "static" or not held(r)))
        # a shifted parameter is weighed against the description, for which all data count; others must prove themselves
        fitted = find(robot, everything if shift else half, known, effect, joint)
        if fitted is None:
            # no trace in the data, so there are no numbers to add, even if forced
            now = _sums(nominal_figures(robot, paths, settings, lambda r: not held(r), held, known), "held_out_")
            return Revised(None, now, now, False, judged_on)
        with_it = (*known, fitted)
    tell(f"judging {name} on held-out data")
    old = nominal_figures(robot, paths, settings, lambda r: not held(r), held, known)
    new = nominal_figures(robot, paths, more, lambda r: not held(r), held, with_it)
    before, after = _sums(old, "held_out_"), _sums(new, "held_out_")
    helps = _helps(before, after, shift)
    if not helps and not force:
        return Revised(None, before, after, False, judged_on)
    tell("identifying the new revision")
    fresh = identify(robot, paths, more, tell, known=known).model
    tell("bounding stops before and after")
    before |= dict(model.revisions[-1].after) if model.revisions else {}
    before |= stop_figures(model, model)
    after |= dict(fresh.revisions[-1].after) | stop_figures(fresh, model)
    number = model.revisions[-1].number + 1 if model.revisions else 1
    note = "" if helps else "forced: it does not help on held-out data"
    revision = Revision(number, name, before, after, note)
    return Revised(replace(fresh, revisions=(*model.revisions, revision)), before, after, helps, judged_on)


def description(model: Model) -> Robot:
    """The robot as it was described (CAD and data sheet), from the texts in the model."""
    return robot_from_text(model.robot.urdf, model.robot.datasheet, "the model's URDF")


def stop_figures(model: Model, seen: Model) -> dict[str, float]:
    """``stop0_angle``: mean STOP 0 angle bound [rad] over single-axis stops from the largest speed and mid pose that ``seen``
    saw; empty where not every one of them can be proved."""
    angles = []
    for joint in range(model.n):
        speed = np.zeros(model.n)
        speed[joint] = np.abs([seen.domain.dq.lo[joint], seen.domain.dq.hi[joint]]).max()
        bound = stop(model, seen.domain.q.centre, speed, "0").angle
        if bound is None:
            return {}
        angles.append(float(bound[joint]))
    return {"stop0_angle": float(np.mean(angles))}


def _known(model: Model) -> tuple[Fitted, ...]:
    """Effects beyond base friction with the numbers the model holds; none where they are refitted with everything else."""
    if model.effort == "compensated_torque":
        return ()
    return tuple(f for f in model.effects if not get(f.effect).base)


def settings_of(model: Model) -> Settings:
    """The settings a model was identified with."""
    kept = dict(model.provenance.get("settings", {}))
    kept["effects"] = tuple(kept.get("effects", ()))
    return Settings(**kept)


def _halves(robot: Robot, paths: Sequence[str | Path]) -> tuple[Callable[[Recording], bool], str]:
    """What is held out: every other motion where there are at least four, else every other repetition.

    A suite may be a later start of another suite's motion (trap P8): motions are told apart by their torques.
    """
    motion = survey(lambda: stream_recordings(paths, robot)).motion
    if len(set(motion.values())) >= 4:
        return (lambda r: motion.get(r.motion, r.suite) % 2 == 1), "every other motion"
    return (lambda r: r.trial % 2 == 1), "every other repetition"


def _sums(figures: dict[str, dict[str, float]], prefix: str) -> dict[str, float]:
    """RMS over joints for torque [N m], velocity [rad/s] and position [rad]."""
    keys = ("torque_rmse", "velocity_rmse", "position_rmse")
    return {prefix + k: float(np.sqrt(np.mean([row[k] ** 2 for row in figures.values()]))) for k in keys}


def _helps(before: dict[str, float], after: dict[str, float], shift: bool) -> bool:
    """Whether held-out errors fall; a ``shift`` need only not raise them.

    A shifted parameter (a payload, a rotor, a torque scale) is absorbed by a free fit at the price of implausible values:
    the evidence for it is the description it contradicts, which the diagnosis has weighed before it gave any numbers.
    """
    change = [after[k] / before[k] - 1.0 for k in ("held_out_torque_rmse", "held_out_position_rmse")]
    return max(change) < HELPS and (shift or min(change) <= -HELPS)
