"""Add effects to a model: a new revision that re-identifies everything, judged on data the fit has not seen.

The judgement comes first and is cheap: the nominal model with and without the effect is fitted on one half of the motions
(or of the repetitions, where there are few motions) and simulated on the other.  Several effects are judged one after
another, each beside those that were taken before it.  Only then is the whole model identified again, once.  An effect that
does not help is refused, with the numbers, unless forced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stopset.artifact import Model, Revision
from stopset.artifact.inputs import entry
from stopset.effects import get
from stopset.effects.base import Fitted
from stopset.errors import EffectError, ModelFileError, NotCovered
from stopset.offline.campaign.survey import survey
from stopset.offline.effect_names import find, parse_effect
from stopset.offline.identify.pipeline import Keep, Settings, identify
from stopset.offline.revise.held_out import nominal_figures
from stopset.reach.stops import stop
from stopset.recording import Recording, read_meta, read_recordings, stream_recordings
from stopset.robot import Robot
from stopset.robot.arm import robot_from_text

if TYPE_CHECKING:
    from stopset.offline.conform.gather import Kept
    from stopset.offline.update.signals_file import Signals

Tell = Callable[[str], None]

# an effect helps if, on held-out data, one error falls by this share over all joints, or at its own joints by the larger one
# (a single joint's error scatters more), while none rises by as much
HELPS, HELPS_THERE = 0.02, 0.05
HELD_OUT = ("held_out_torque_rmse", "held_out_velocity_rmse", "held_out_position_rmse")
SHIFTS = frozenset({"inertia", "input_gain"})  # where an effect enters that a free fit would absorb


@dataclass(frozen=True, slots=True)
class Judged:
    """One effect held against data that the fit has not seen; ``why`` it was refused, empty where it was taken."""

    name: str
    before: dict[str, float]
    after: dict[str, float]
    helps: bool
    enters: str  # where it goes in the model
    why: str = ""


@dataclass(frozen=True, slots=True)
class Revised:
    """Outcome of `add`: the new model (None if all was refused), held-out errors and model figures before and after."""

    model: Model | None
    before: dict[str, float]
    after: dict[str, float]
    judged: tuple[Judged, ...]
    judged_on: str
    kept: Kept | Signals | None = None  # what later recordings can be added to, where that was asked for

    @property
    def helps(self) -> bool:
        """Whether all that was asked for lowers the error on held-out data."""
        return all(j.helps for j in self.judged)


def add(
    model: Model, effect: str | Sequence[str], joint: str | None, paths: Sequence[str | Path], force: bool = False,
    tell: Tell = lambda _: None, keep: Keep = None,
) -> Revised:  # fmt: skip
    """A revision of ``model`` with ``effect`` (at ``joint``, or wherever its scope says), identified from ``paths``.

    Several effects are given as ``effect`` or ``effect:joint`` each, in the order to try them; ``joint`` is then left out.
    ``keep``: also keep what later recordings can be added to (`stopset.offline.update.update`).
    Raises `EffectError` if an effect or joint is unknown or already part of the model.
    """
    robot, settings = description(model), settings_of(model)
    names = _names(effect, joint, robot, settings)
    held, judged_on = _halves(robot, paths)
    judge = _Judge(robot, model.effort, paths, held, tell)
    known, judged = _known(model), []
    first = errors = _judged_before(model, paths) or judge.errors(settings, known)
    for name in names:
        found = judge.estimate(name, known)
        if found is None:
            # no trace in the data, so there are no numbers to add, even if forced
            judged.append(Judged(name, errors, errors, False, "", "the data show no trace of it, so there are no numbers to add"))
            continue
        tell(f"judging {name} on held-out data")
        more, with_it = replace(settings, effects=(*settings.effects, name)), (*known, *found)
        after = judge.errors(more, with_it)
        kind = get(name.partition(":")[0])
        joints = parse_effect(name, robot)[1]
        helps = _helps(errors, after, joints, kind.enters in SHIFTS)
        why = "" if helps or force else "it does not lower the error on held-out data"
        judged.append(Judged(name, errors, after, helps, entry(kind), why))
        if not why:
            settings, known, errors = more, with_it, after
    taken = [j for j in judged if not j.why]
    if not taken:
        return Revised(None, first, judged[-1].after, tuple(judged), judged_on)
    tell("identifying the new revision")
    identified = identify(robot, paths, settings, tell, known=known, keep=keep)
    fresh = identified.model
    tell("bounding stops before and after")
    before = (dict(model.revisions[-1].after) if model.revisions else {}) | first | stop_figures(model, model)
    after = errors | dict(fresh.revisions[-1].after) | stop_figures(fresh, model)
    number = model.revisions[-1].number + 1 if model.revisions else 1
    revision = Revision(number, ", ".join(j.name for j in taken), before, after, _note(taken, judged_on))
    revised = replace(fresh, revisions=(*model.revisions, revision))
    return Revised(revised, before, after, tuple(judged), judged_on, identified.kept)


@dataclass(frozen=True, slots=True)
class _Judge:
    """Fits nominal models on one half of the data and holds them against the other."""

    robot: Robot
    effort: str
    paths: Sequence[str | Path]
    held: Callable[[Recording], bool]
    tell: Tell

    def errors(self, settings: Settings, known: tuple[Fitted, ...]) -> dict[str, float]:
        """Held-out RMS errors over the joints."""
        figures = nominal_figures(self.robot, self.paths, settings, lambda r: not self.held(r), self.held, known)
        return _flat(figures)

    def estimate(self, name: str, known: tuple[Fitted, ...]) -> tuple[Fitted, ...] | None:
        """Numbers of an effect in motor torque, None where there is no trace of it.

        In compensated torque none are needed: they are fitted with everything else.
        """
        if self.effort == "compensated_torque":
            return ()
        self.tell(f"estimating {name}")
        effect, _, joint = name.partition(":")
        everything = read_recordings(self.paths, self.robot)
        if get(effect).enters not in SHIFTS:
            # a shifted parameter is weighed against the description, for which all data count; others must prove themselves
            half = tuple(r for r in everything if r.phase == "static" or not self.held(r))
            everything = replace(everything, trials=half)
        found = find(self.robot, everything, known, effect, joint or None)
        return None if found is None else (found,)


def _names(effect: str | Sequence[str], joint: str | None, robot: Robot, settings: Settings) -> tuple[str, ...]:
    """Effects as ``effect`` or ``effect:joint``, each known, fitting the robot and new to the model."""
    wanted = (effect,) if isinstance(effect, str) else tuple(effect)
    if joint and (len(wanted) > 1 or ":" in wanted[0]):
        raise EffectError(
            f"{' '.join(wanted)} with --joint {joint}: expected a joint for one effect only; write {wanted[0].partition(':')[0]}:{joint}"
        )
    names = tuple(f"{w}:{joint}" if joint else w for w in wanted)
    for k, name in enumerate(names):
        parse_effect(name, robot)
        if name in settings.effects:
            raise EffectError(f"{name} is already part of this model; name another effect, or identify again with other data")
        if name in names[:k]:
            raise EffectError(f"{name} is named twice; name every effect once")
    return names


def _judged_before(model: Model, paths: Sequence[str | Path]) -> dict[str, float] | None:
    """Held-out errors of this very model on these very recordings, where its last revision was judged on them."""
    same = set(dict(model.provenance.get("data", {})).values()) == {sha for p in paths for _, sha in read_meta(p).sources}
    tool = model.provenance.get("tool") == f"stopset {version('stopset')}"
    last = dict(model.revisions[-1].after) if model.revisions else {}
    found = {k: v for k, v in last.items() if k.partition(":")[0] in HELD_OUT}
    return found if same and tool and len(found) == len(HELD_OUT) * (model.n + 1) else None


def _note(taken: Sequence[Judged], judged_on: str) -> str:
    """What the model file says of a revision: where each effect went, and which were forced."""
    parts = [f"{j.name} enters {j.enters}" + ("" if j.helps else " (forced: it does not help on held-out data)") for j in taken]
    return "; ".join([*parts, f"judged on {judged_on}"])


def description(model: Model) -> Robot:
    """The robot as it was described (CAD and data sheet), from the texts in the model."""
    return robot_from_text(model.robot.urdf, model.robot.datasheet, "the model's URDF")


def stop_figures(model: Model, seen: Model) -> dict[str, float]:
    """STOP 0 angle bound [rad] of single-axis stops from the largest speed and mid pose that ``seen`` saw: ``stop0_angle``
    the mean, ``stop0_angle:<joint>`` each; empty where not every one of them can be proved, as with an effect that no stop
    is bounded with."""
    angles = {}
    for joint, name in enumerate(model.joints):
        speed = np.zeros(model.n)
        speed[joint] = max(seen.domain.dq.lo[joint], seen.domain.dq.hi[joint], key=abs)
        try:
            bound = stop(model, seen.domain.q.centre, speed, "0").angle
        except NotCovered:
            return {}
        if bound is None:
            return {}
        angles[f"stop0_angle:{name}"] = float(bound[joint])
    return {"stop0_angle": float(np.mean(list(angles.values())))} | angles


def _known(model: Model) -> tuple[Fitted, ...]:
    """Effects beyond base friction with the numbers the model holds; none where they are refitted with everything else."""
    if model.effort == "compensated_torque":
        return ()
    return tuple(f for f in model.effects if not get(f.effect).base)


def settings_of(model: Model) -> Settings:
    """The settings a model was identified with. Raises `ModelFileError` for settings that this stopset does not have."""
    kept = dict(model.provenance.get("settings", {}))
    kept["effects"] = tuple(kept.get("effects", ()))
    try:
        return Settings(**kept)
    except TypeError as e:
        unknown = ", ".join(sorted(kept.keys() - {f.name for f in fields(Settings)}))
        raise ModelFileError(
            f"the model was identified with settings that this stopset does not have ({unknown}); expected those of its version: "
            "identify again"
        ) from e


def _halves(robot: Robot, paths: Sequence[str | Path]) -> tuple[Callable[[Recording], bool], str]:
    """What is held out: every other motion where there are at least four, else every other repetition.

    A suite may be a later start of another suite's motion (trap P8): motions are told apart by their torques.
    """
    motion = survey(lambda: stream_recordings(paths, robot)).motion
    if len(set(motion.values())) >= 4:
        return (lambda r: motion.get(r.suite_key, r.begun) % 2 == 1), "every other motion"
    return (lambda r: r.repetition % 2 == 1), "every other repetition"


def _flat(figures: dict[str, dict[str, float]]) -> dict[str, float]:
    """Torque [N m], velocity [rad/s] and position [rad]: RMS over the joints, and of each joint after a colon."""
    out: dict[str, float] = {}
    for key in HELD_OUT:
        each = {j: float(row[key.removeprefix("held_out_")]) for j, row in figures.items()}
        out |= {key: _rms(each.values())} | {f"{key}:{j}": e for j, e in each.items()}
    return out


def _rms(errors: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(errors)))))


def _helps(before: dict[str, float], after: dict[str, float], joints: Sequence[str], shift: bool) -> bool:
    """Whether held-out errors fall, over the arm or at the effect's own ``joints``; a ``shift`` need only not raise them.

    A shifted parameter (a payload, a rotor, a torque scale) is absorbed by a free fit at the price of implausible values:
    the evidence for it is the description it contradicts, which the diagnosis has weighed before it gave any numbers.
    """
    everywhere, there = [], []
    for key in ("held_out_torque_rmse", "held_out_position_rmse"):
        everywhere.append(after[key] / before[key] - 1.0)
        own = [_rms(errors[f"{key}:{j}"] for j in joints) for errors in (before, after)]
        there.append(own[1] / own[0] - 1.0)
    falls = min(everywhere) <= -HELPS or min(there) <= -HELPS_THERE
    # at its own joint one error may rise if the other falls by more: warming of a joint that gravity is not yet right for
    rises = max(everywhere) >= HELPS or max(there) >= max(HELPS_THERE, -min(there))
    return not rises and (shift or falls)
