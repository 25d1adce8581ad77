"""Whether effects help on data that the fit has not seen: the rule of `stopset add`, and of what `stopset diagnose` names.

Motor torque is judged by the diagnosis itself: its estimate, its held-out torque error, before and after.  Compensated torque is
judged by simulation: the nominal model with and without the effect is fitted on one part of the recordings and predicts the rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stopset.artifact import Model
from stopset.artifact.inputs import entry
from stopset.effects import get
from stopset.effects.base import Fitted
from stopset.effects.selection import parse_effect
from stopset.errors import RecordingError
from stopset.offline.abstraction.halves import Halves, nominal_figures, nominal_of
from stopset.offline.abstraction.nominal_part import NominalPart
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.settings import Settings
from stopset.offline.campaign.source import Campaign
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.answer import Ranked
from stopset.offline.diagnose.as_added import (
    HELD_BACK,
    Alone,
    alone,
    in_question,
    left,
    levelled,
    not_chosen,
    raised,
    retained_effects,
    retained_elsewhere,
)
from stopset.offline.diagnose.compensated import JointStep, OpenLoop, search_open_loop
from stopset.offline.diagnose.estimate import Estimate, estimates
from stopset.offline.diagnose.evidence.baseline import own
from stopset.offline.diagnose.lacking import rises
from stopset.offline.diagnose.question import question
from stopset.progress import Progress
from stopset.recording import Recordings
from stopset.robot import Robot

HELD_OUT = ("held_out_torque_rmse", "held_out_velocity_rmse", "held_out_position_rmse")
SHIFTS = frozenset({"inertia", "input_gain"})  # where an effect enters that a free fit would absorb
NO_TRACE = "the data show no trace of it, so there are no numbers to add"
STAYS = "identification chose it in these recordings, beside all else: the model has it already, and its numbers stay; errors before are without it"


@dataclass(frozen=True, slots=True)
class Judged:
    """One effect held against data that the fit has not seen; ``why`` it was refused, empty where it was taken.

    ``beside``: what else was found at its joint, and not asked for; its numbers are those beside these.
    """

    name: str
    before: dict[str, float]
    after: dict[str, float]
    helps: bool
    enters: str  # where it goes in the model
    why: str = ""
    beside: tuple[str, ...] = ()
    in_model: bool = False  # identification chose it in these recordings already
    stays: str = ""  # that it keeps the numbers that identification gave it; empty where it gets the diagnosis'


@dataclass(frozen=True, slots=True)
class Judgement:
    """All that was judged; ``first``: errors without any; what to identify the revision with; ``words``: what judged."""

    judged: tuple[Judged, ...]
    first: dict[str, float]
    settings: Settings
    known: tuple[Fitted, ...]
    words: str


@dataclass(frozen=True, slots=True)
class Judge:
    """What judges: a model's recordings, and how they are divided."""

    model: Model
    robot: Robot
    campaign: Campaign
    halves: Halves
    progress: Progress

    def fitted(self, settings: Settings, known: tuple[Fitted, ...]) -> NominalPart:
        """The nominal model of one part of the recordings."""
        return nominal_of(self.robot, self.campaign.meta, self.halves, settings, known)

    def simulated(self, part: NominalPart) -> dict[str, float]:
        """Its errors on the other."""
        return _flat(nominal_figures(part, self.campaign.meta, self.halves))

    def left(self, part: NominalPart, settings: Settings) -> Iterator[dict[str, float]]:
        """The torque [N m] that it leaves there of each joint, looked at in more than one way."""
        return left(Run(self.robot, self.campaign.meta, self.halves.judging, self.halves.judged, settings), part)


def by_simulation(
    judge: Judge, settings: Settings, names: Sequence[str], first: Mapping[str, float] | None, *, force: bool
) -> Judgement:
    """Judge effects on compensated torque: what the diagnosis names is taken, with its numbers; the rest by whether it helps.

    ``first``: errors that are known already.
    """
    found = _named_by_simulation(judge, names)
    claims = {name: found.matching(name) if found else [] for name in names}
    raised = _raised(found, claims) if found and not force else {}
    order = [r for name in names if name not in raised for r in claims[name]]
    steps = dict(zip((r.label for r in order), found.steps(order) if found else (), strict=True))
    at_first = {r.joints[0]: steps[r.label] for r in reversed(order)}
    errors = start = _at_joints(first or judge.simulated(judge.fitted(settings, ())), at_first, 0)
    judged = []
    for name in names:
        judge.progress(f"judging {name} on held-out data")
        more = replace(settings, effects=(*settings.effects, name))
        after = judge.simulated(judge.fitted(more, ()))
        effect, joints = parse_effect(name, judge.robot)
        if name in raised:
            steps_there, why = raised[name]
            before, after = (_at_joints(x, steps_there, k) for k, x in enumerate((errors, after)))
            judged.append(Judged(name, before, after, helps=False, enters=entry(effect), why=why))
        elif claims[name]:
            mine = {r.joints[0]: steps[r.label] for r in claims[name]}
            before, after = (_at_joints(x, mine, k) for k, x in enumerate((errors, after)))
            beside = found.besides(order, mine) if found else ()
            judged.append(Judged(name, before, after, helps=True, enters=entry(effect), beside=beside))
        else:
            helps = _helps(errors, after, joints, shift=effect.enters in SHIFTS)
            why = "" if helps or force else "it does not lower the error on held-out data"
            judged.append(Judged(name, errors, after, helps, entry(effect), why))
        if not judged[-1].why:
            settings, errors = more, after
    retained = retained_effects(judge.model)
    known = found.with_claims(retained, order) if found else retained
    return Judgement(tuple(judged), start, settings, known, judge.halves.words)


def _named_by_simulation(judge: Judge, names: Sequence[str]) -> OpenLoop | None:
    """What the diagnosis finds missing; None where nothing was repeated, so that it can judge nothing."""
    judge.progress("estimating what was asked for, beside every effect of the catalogue")
    recordings = Recordings(replace(judge.campaign.meta, joints=judge.robot.joints), tuple(judge.campaign.trials()))
    joints = {joint for name in names for joint in parse_effect(name, judge.robot)[1]}
    try:
        return search_open_loop(judge.model, recordings, judge.campaign.seen.survey, judge.progress, joints=joints)
    except RecordingError:
        return None


def _raised(found: OpenLoop, claims: Mapping[str, Sequence[Ranked]]) -> dict[str, tuple[dict[str, JointStep], str]]:
    """Names whose claims raise the held-out torque error of their joints because what they stand together with is not asked for:
    the steps at these joints, and the reason."""
    asked = {r.label for mine in claims.values() for r in mine}
    out, taken = dict[str, tuple[dict[str, JointStep], str]](), list[Ranked]()
    for name, mine in claims.items():
        missing = tuple(dict.fromkeys(x for r in mine for x in r.together if x not in asked))
        steps = found.steps([*taken, *mine])[len(taken) :]
        before, after = (sum((s.torque[k] for s in steps), np.zeros(1)) for k in (0, 1))
        if missing and rises(before, after):
            why = f"it raises the torque error of its joints on held-out data unless {' and '.join(missing)} is added with it"
            out[name] = ({r.joints[0]: s for r, s in zip(mine, steps, strict=True)}, why)
        else:
            taken += mine
    return out


def _at_joints(simulated: Mapping[str, float], at: Mapping[str, JointStep], side: int) -> dict[str, float]:
    """Simulated errors with those of the diagnosis at its joints, before (``side`` 0) or after (1)."""
    found = {HELD_OUT[0]: {j: float(np.sqrt(s.torque[side].mean())) for j, s in at.items()}}
    found[HELD_OUT[2]] = {j: s.position[side] for j, s in at.items()}
    out = dict(simulated)
    for key, there in found.items():
        each = {k: x for k, x in simulated.items() if k.startswith(f"{key}:")} | {f"{key}:{j}": e for j, e in there.items()}
        out |= {key: _rms(each.values())} | each
    return out


def by_evidence(
    judge: Judge, settings: Settings, names: Sequence[str], first: Mapping[str, float] | None, *, force: bool
) -> Judgement:
    """Judge effects on motor torque as the diagnosis does: whoever it names is taken, with its numbers.

    What identification chose in the same recordings keeps its own, which were fitted together with all else that the model has, and is judged
    no more.
    """
    judge.progress("estimating what was asked for, beside every effect of the catalogue")
    recordings = Recordings(replace(judge.campaign.meta, joints=judge.robot.joints), tuple(judge.campaign.trials()))
    q = question(judge.model, recordings)
    answer = estimates(q, names, judge.progress)
    joints, same = judge.model.joints, own(judge.model, judge.campaign.meta)
    chosen = tuple(judge.model.provenance.get("chosen", ())) if same else ()
    judge.progress("simulating without and with it")
    rubbing = [n for n in names if levelled(n, judge.robot)]
    tried = _Trials(judge, settings, chosen if same else None)
    plain = dict(first) if first else tried.beside([]).errors
    found, refused, asked = list(answer.found), dict[str, str](), dict[str, Alone]()
    stays = {e.fitted.label for e in found} & set(chosen)
    while True:
        trial = tried.beside(found)
        laws = [] if force else [e for e in found if e.name in rubbing and e.fitted.label not in stays]
        each = [e for e in laws if in_question(judge.model, judge.campaign.meta, [e.fitted.label])]
        for e in each:
            if e.fitted.label not in asked:
                asked[e.fitted.label] = alone(judge.model, judge.campaign, e.fitted, parts=judge.halves)
        worse = {e.name: asked[e.fitted.label].why for e in each if asked[e.fitted.label].why}
        # what judges leaves the laws in question that identification chose; the model without friction that is added has them
        worse |= tried.raised([e for e in answer.found if e.name not in rubbing], trial, [e for e in laws if e not in each])
        if not worse:
            break
        refused |= worse
        found = [e for e in found if e.name not in worse]
    more, after = trial.settings, trial.errors
    if any(asked[e.fitted.label].among is not None for e in each):
        more = replace(more, friction_among=chosen)
    start = _with_torque(plain, joints, answer.before)
    judged = []
    for name in names:
        mine = [e for e in answer.found if e.name == name]
        if not mine:
            judged.append(Judged(name, start, start, helps=False, enters="", why=NO_TRACE))
            continue
        sides = (plain if mine[0] is answer.found[0] else after), after
        a, b = (_with_torque(x, joints, row) for x, row in zip(sides, (mine[0].before, mine[-1].after), strict=True))
        why = refused.get(name, "")
        unchanged = STAYS if all(e.fitted.label in stays for e in mine) else ""
        enters = entry(get(name.partition(":")[0]))
        judged.append(Judged(name, a, b, not why, enters, why, in_model=name in chosen, stays=unchanged))
    return Judgement(tuple(judged), start, more, trial.effects, answer.words)


@dataclass(frozen=True, slots=True)
class _Tried:
    """What to identify a revision with, its effects, its nominal model of one part of the recordings, errors on the other."""

    settings: Settings
    effects: tuple[Fitted, ...]
    part: NominalPart
    errors: dict[str, float]


@dataclass(frozen=True, slots=True)
class _Trials:
    """Revisions tried on what is held out, each once; ``chosen``: laws that identification chose in the same recordings, None: in others."""

    judge: Judge
    settings: Settings
    chosen: tuple[str, ...] | None
    _known: dict[tuple[str, ...], _Tried] = field(default_factory=dict)

    def beside(self, added: Sequence[Estimate]) -> _Tried:
        """The model with what is ``added``, with the numbers of its estimate, or the model's own and its other laws there of what it has."""
        which = tuple(e.fitted.label for e in added)
        if which not in self._known:
            has = set(which) & set(self.chosen or ())
            fitted = [e.fitted for e in added if e.fitted.label not in has]
            around = self.settings
            if self.chosen is not None:
                around = retained_elsewhere(around, [x for x in self.chosen if x not in has], fitted, self.judge.robot)
            more = replace(around, effects=(*self.settings.effects, *dict.fromkeys(e.name for e in added)))
            retained = [f for f in self.judge.model.effects if f.label in has]
            taken = (*retained_effects(self.judge.model), *fitted, *retained)
            part = self.judge.fitted(more, taken)
            self._known[which] = _Tried(more, taken, part, self.judge.simulated(part))
        return self._known[which]

    def raised(self, plain: Sequence[Estimate], trial: _Tried, laws: Sequence[Estimate]) -> dict[str, str]:
        """Which ``laws`` leave more of what is held out, in a ``trial`` with them beside the model with the ``plain`` alone, and why."""
        if not laws:
            return {}
        judge, names, labels, without = self.judge, [e.name for e in laws], {e.fitted.label for e in laws}, self.beside(plain)
        part = without.part
        if labels & {g.name for g in part.chosen}:
            part = judge.fitted(not_chosen(without.settings, labels, judge.robot), without.effects)
        looks = zip(*(judge.left(x, self.settings) for x in (part, trial.part)), strict=True)
        return raised(judge.robot, names, looks, self.chosen or (), HELD_BACK)


def _with_torque(simulated: Mapping[str, float], joints: Sequence[str], row: np.ndarray | None) -> dict[str, float]:
    """Simulated errors with the torque errors (n,) of the diagnosis in place of their own."""
    if row is None:
        return dict(simulated)
    key = HELD_OUT[0]
    each = {f"{key}:{j}": float(e) for j, e in zip(joints, row, strict=True)}
    return dict(simulated) | {key: _rms(each.values())} | each


def _flat(figures: dict[str, dict[str, float]]) -> dict[str, float]:
    """Torque [N m], velocity [rad/s] and position [rad]: RMS over the joints, and of each joint after a colon."""
    out: dict[str, float] = {}
    for key in HELD_OUT:
        each = {j: float(row[key.removeprefix("held_out_")]) for j, row in figures.items()}
        out |= {key: _rms(each.values())} | {f"{key}:{j}": e for j, e in each.items()}
    return out


def _rms(errors: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(errors)))))


def _helps(before: dict[str, float], after: dict[str, float], joints: Sequence[str], *, shift: bool) -> bool:
    """Whether held-out errors fall, over the arm or at the effect's own ``joints``, and none rises as much; a ``shift`` need only not raise them.

    A shifted parameter (a payload, a rotor, a torque scale) is absorbed by a free fit at the price of implausible values:
    the evidence for it is the description it contradicts, which the diagnosis has weighed before it gave any numbers.
    """
    everywhere, there = [], []
    for key in ("held_out_torque_rmse", "held_out_position_rmse"):
        everywhere.append(after[key] / before[key] - 1.0)
        own = [_rms(errors[f"{key}:{j}"] for j in joints) for errors in (before, after)]
        there.append(own[1] / own[0] - 1.0)
    falls = min(everywhere) <= -limit.HELPS or min(there) <= -limit.HELPS_THERE
    # at its own joint one error may rise if the other falls by more: warming of a joint that gravity is not yet right for
    rises = max(everywhere) >= limit.HELPS or max(there) >= max(limit.HELPS_THERE, -min(there))
    return not rises and (shift or falls)
