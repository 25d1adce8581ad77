"""Which physical effect is missing: the question from outside, and what is made of the search's findings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from stopset.artifact import Model
from stopset.effects import Fitted, get
from stopset.offline.campaign.source import Campaign
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.against_model import examined, given_by_state
from stopset.offline.diagnose.answer import Diagnosis, Parameter, Ranked, Unexplained
from stopset.offline.diagnose.as_added import alone, in_question
from stopset.offline.diagnose.changes import Change, changes
from stopset.offline.diagnose.evidence.engine import Engine
from stopset.offline.diagnose.evidence.priors import Beforehand, Known
from stopset.offline.diagnose.examination import Examination, examine, refusing
from stopset.offline.diagnose.explain import advice
from stopset.offline.diagnose.explain.identifiable import blind_spots
from stopset.offline.diagnose.explain.leftover import Pattern, pattern
from stopset.offline.diagnose.question import question
from stopset.offline.diagnose.remainder import accounts_for, verdict_of
from stopset.offline.diagnose.search.search import Claim, label
from stopset.offline.diagnose.standing import moves, standing
from stopset.offline.inspect.gate import check_readings, left_out
from stopset.offline.nominal.prior import Tolerance
from stopset.progress import Progress, silent
from stopset.recording import Recordings
from stopset.robot import Robot

SINGLE = (
    "one trial: how friction scatters from trial to trial cannot be known from it, so effects that differ only from trial to trial are not "
    "told; the others were judged on blocks of time left out in turn, which speaks of this motion only"
)
LEAVES_TOO_MUCH = "it explains a part, and leaves too much to be the cause"
SINCE = "Record the same motion again after a while: what keeps changing wears, what came at once was done to the arm."
OF_ALL = "grows with all that the gear transmits"
ALREADY = " The model has it already, with these numbers: identification chose it. The error before is without it."


def diagnose(
    robot: Robot,
    recordings: Recordings,
    fitted: Sequence[Fitted] = (),
    tolerance: Tolerance | None = None,
    names: Sequence[str] | None = None,
    known: Known | None = None,
) -> Diagnosis:
    """Find the effects that the rigid body of ``robot`` and friction (and ``fitted``) do not explain in ``recordings``.

    ``robot``: description and data sheet, the prior of what is known; ``fitted``: effects the model already has (kept as
    nuisance, refitted); ``names``: look for these effects only; ``known``: a model from other recordings.
    Raises `RecordingError` where no trial moves or readings are none, `EffectError` for an effect that does not fit the robot.
    """
    check_readings(robot, recordings.meta, recordings)
    if not any(moves(r) for r in recordings):
        return standing(robot, recordings, fitted)
    return answered(examine(robot, recordings, fitted, Beforehand(tolerance, known), names), names)


def answered(x: Examination, names: Sequence[str] | None = None) -> Diagnosis:
    """The answer that an examination gives; ``names``: of these effects only, whatever else was found beside them."""
    engine, found, left = x.engine, x.found, x.left
    ranked = tuple(r for r in x.ranked if not r.objection and (names is None or r.effect in names))
    claims = [c for c, r in zip(found.claims, x.ranked, strict=True) if r in ranked]
    verdict = verdict_of(found, left)
    if verdict == "missing" and not ranked:
        new = ~engine.as_before
        before = [np.array(c.excess_before)[new] for c in _refused(x)]
        verdict = "unknown" if any(np.max(e, initial=0.0) > limit.SENSORS for e in before) else "none"
    structure = x.structure() if verdict == "unknown" or x.structures else None
    if structure is not None:  # what is claimed beside a gear that is none is a part of the same swing
        verdict = "unknown"
    loose = tuple(r for r in x.plays.beside([r.label for r in ranked]) if names is None or r.effect in names)
    blind = (
        *blind_spots(found.now, found.hyper, [s.candidate for s in found.left], names),
        *(b for b in x.plays.blind if names is None or b.effect in names),
    )
    undecided = tuple(r for r in ranked if r.alternatives and verdict == "missing")
    rivals = _rivals(engine, claims, [x for r in undecided for x in r.one_of[1:]]) if verdict == "missing" else ()
    joints = engine.data.joints
    worst, shown = left.worst, None
    if worst is not None and (verdict == "unknown" or left.depends):
        shown = pattern(found.now, left.theta, left.hyper, worst, left.ranking[worst], limit.PATTERN)
    next_experiment = {
        "unknown": lambda: _slower(x) or (None if worst is None else advice.to_explain(joints[worst], shown)),
        "missing": lambda: advice.to_decide(rivals),
        "none": lambda: advice.to_see(blind),
    }[verdict]()
    if undecided:
        next_experiment = " ".join(dict.fromkeys(r.telling for r in undecided))
    named = (*(ranked if verdict == "missing" else ()), *loose)
    return Diagnosis(
        verdict="missing" if loose else verdict,
        ranked=named,
        alternatives=undecided,
        claims=(*ranked, *loose),
        rivals=rivals,
        depends_on=_depends(verdict, worst, shown, joints),
        not_identifiable=blind,
        next_experiment=next_experiment,
        unexplained=_unexplained(x, verdict),
        structure=None if loose else structure,
        excess={j: round(float(x), 3) for j, x in zip(joints, found.excess, strict=True)},
        friction_scatter=dict(zip(joints, found.hyper.sigma, strict=True)),
        trials=len(engine.data.trials),
        rows=sum(r.size for r in engine.rows),
        notes=(*engine.data.sampling, *((SINGLE,) if len(engine.data.trials) == 1 else ()), *_as_ever(x)),
    )


def _as_ever(x: Examination) -> tuple[str, ...]:
    """What is said of joints that hold more than noise, as they did when the model was identified."""
    joints = [
        j for j, same, e in zip(x.engine.data.joints, x.engine.as_before, x.found.excess, strict=True) if same and e > limit.QUIET
    ]
    if not joints:
        return ()
    return (
        f"{', '.join(joints)}: the model leaves at most {limit.AS_BEFORE:g} times the torque that it left of its own recordings, so what it "
        "does not explain there is no change since; on its own recordings `diagnose` asks what that is",
    )


def diagnose_model(
    model: Model, recordings: Recordings, names: Sequence[str] | None = None, progress: Progress = silent
) -> tuple[Diagnosis, str]:
    """`diagnose` for a model file, with ``names`` of these effects only; also says what the recordings were measured against.

    ``progress`` is given each step.

    The whole catalogue is searched whatever is asked for: an effect looked for alone takes up what another one does.
    """
    check_readings(model.robot, recordings.meta, recordings)
    readings = sum(r.again for r in recordings), sum(r.skipped for r in recordings)
    rows = max((r.held for r in recordings), default=1.0)
    without = left_out(model.robot, [(r.label, x) for r in recordings for x in r.spikes], readings, rows)
    if model.effort == "compensated_torque":
        from stopset.offline.diagnose.compensated import diagnose_open_loop

        found = diagnose_open_loop(model, recordings, names, progress)
        return replace(found, notes=(*without, *found.notes)), "open-loop simulation from each trial's start"
    q = question(model, recordings)
    if not any(map(moves, q.asked)):
        return replace(standing(q.robot, q.recordings, q.fitted), notes=(*without, *q.notes)), q.against
    x = _as_added(model, recordings, examined(q, progress), progress) if q.model is None else examined(q, progress)
    progress("what all of it says together")
    found = answered(x, names)
    known = {f.label for f in q.fitted}
    chosen = {f.label: f for f in model.effects if f.label not in known}

    def marked(ranked: tuple[Ranked, ...]) -> tuple[Ranked, ...]:
        return tuple(_of_the_model(r, chosen[r.label]) if r.label in chosen else r for r in ranked)

    found = replace(found, ranked=marked(found.ranked), claims=marked(found.claims), alternatives=marked(found.alternatives))
    found = replace(found, taken_out=q.taken_out, notes=(*without, *q.notes, *found.notes))
    if q.known is None:
        return found, q.against
    progress("what changed since identification")
    beside = _beside_what_is_named(model, found)
    transmitted = [r.fitted for r in found.ranked if r.transmitted]
    moving = [r for r in q.recordings if moves(r)]
    changed = [c for c in changes(beside, moving, transmitted) if get(c.effect).scope != "arm"]
    return _with_changes(x, found, [c for c in changed if names is None or c.effect in names]), q.against


def _of_the_model(r: Ranked, law: Fitted) -> Ranked:
    """What is named, with the numbers of the ``law`` that identification chose in the same recordings, beside all else."""
    numbers = {k: replace(p, value=law.values[k], std=law.std.get(k)) for k, p in r.parameters.items()}
    return replace(r, in_model=True, says=r.says + ALREADY, parameters=numbers)


def _as_added(model: Model, recordings: Recordings, x: Examination, progress: Progress) -> Examination:
    """The examination of a model's own recordings without what `add` would refuse for what nominal models leave of them."""
    campaign = Campaign(recordings.meta, lambda: iter(recordings.trials))
    asked = dict[str, str]()
    chosen = [f for f in model.effects if f.label in model.provenance.get("chosen", ())]
    loaded = {j for f in chosen if "load" in get(f.effect).needs for j in f.joints}
    while True:
        named = [r for r in x.ranked if not r.objection]
        for r in named:
            if r.label not in asked and in_question(model, recordings.meta, [r.label]):
                progress(f"what the model would leave of these recordings with {r.label}")
                why = alone(model, campaign, r.fitted).why
                new = r.transmitted and not loaded.intersection(r.joints)
                asked[r.label] = _beyond_gravity(r) + why if why and new else why
        refused = {name: why for name, why in asked.items() if why}
        if not any(r.label in refused for r in named):
            return x
        x = refusing(x, refused)  # what was one too many may be named now


def _beyond_gravity(r: Ranked) -> str:
    """What is told of friction that no model takes, where the model has no law of the load."""
    return (
        f"it lowers the held-out error from {r.error_before:.3g} to {r.error_after:.3g} N m, but {OF_ALL}, what moves the arm besides what it "
        "weighs, and no model takes that, as its stops would have no bound; with gravity's part alone "
    )


def _slower(x: Examination) -> str | None:
    """What to do about friction that no model takes; None where there is none such."""
    beyond = next((r for r in x.ranked if OF_ALL in r.objection), None)
    if beyond is None:
        return None
    at = f"What is left at {beyond.joints[0]} looks like friction ({beyond.effect}) that {OF_ALL}"
    return f"{at}: move it slowly, so that this is what it weighs, and diagnose that recording."


def _beside_what_is_named(model: Model, found: Diagnosis) -> Model:
    """The model with the named effects whose torque the measured state tells, and drives' scales: what these explain is no change of a level.

    A cable pack at a joint that gravity loads looks like a torque scale of all joints, as hardly another one carries as much; and a drive
    that tells too much tells too much friction.
    """
    known = {f.label for f in model.effects}
    new = [r for r in found.ranked if r.label not in known]
    telling = tuple(r.fitted for r in new if given_by_state(r) or get(r.effect).enters == "input_gain")
    return replace(model, effects=(*model.effects, *telling)) if telling else model


def _with_changes(x: Examination, found: Diagnosis, changed: Sequence[Change]) -> Diagnosis:
    """The answer with what changed since identification: that is the verdict where nothing is missing besides.

    A level that leaves something unknown at its joint is no change: what is left there is told to resemble it.  Where it explains most, but
    leaves more than noise, its form is not quite that of the cause: then a law that explains as much may as well be it.
    """
    none = {r.label for r in x.ranked if r.objection}  # what is no finding of these recordings is no change either
    same = {j for j, held in zip(x.engine.data.joints, x.engine.as_before, strict=True) if held}
    changed = [c for c in changed if c.label not in none and c.at not in same and not _of_any_law(x, c)]
    sound = [c for c in changed if _accounts(x, c)]
    refuted = [c for c in changed if c not in sound]
    found = replace(found, unexplained=tuple(_resembling(u, refuted) for u in found.unexplained))
    named_already = {label for r in found.ranked for label in r.one_of}
    changed = [c if _leaves_more(x, c) else replace(c, alike=()) for c in sound if c.label not in named_already]
    if not changed:
        return found
    if found.verdict == "missing":
        # a load that is named and a scale of all torque are one question; and of what is told at all a handful is enough
        beside = [c for c in changed if c.joint or not any(get(r.effect).carried for r in found.ranked)]
        return replace(found, changed=tuple(beside[: max(0, limit.HANDFUL - len(found.ranked))]))
    ranked = tuple(_as_ranked(c) for c in changed)
    undecided = tuple(r for r in ranked if r.alternatives)
    left = tuple(_beside(u, changed) for u in found.unexplained)
    todo = " ".join(x for x in (*dict.fromkeys(r.telling for r in undecided), SINCE) if x)
    answer = replace(
        found, verdict="changed", ranked=ranked, alternatives=undecided, unexplained=left, next_experiment=todo, changed=tuple(changed),
        structure=None,
    )  # fmt: skip
    if found.verdict != "unknown":
        return answer
    rest = "beside what changed, something is left that no effect explains"
    where = ", ".join(f"{u.joint} {u.size:.3g} N m" for u in left)
    todo = " ".join(x for x in (todo, found.next_experiment) if x)
    return replace(answer, notes=(*found.notes, f"{rest}: {where}" if where else rest), next_experiment=todo)


def _as_ranked(c: Change) -> Ranked:
    """A change as an entry of the answer."""
    of = "its" if c.joint is None else f"{c.joint}'s"
    return Ranked(
        c.effect, () if c.joint is None else (c.joint,), abs(c.after - c.before) / max(c.std, 1e-12), c.error_before, c.error_after,
        {c.symbol: Parameter(c.after - c.before, c.unit, c.std)}, "torque against the model", c.says, change=c, alternatives=c.alike,
        alike="each explains it at these loads and speeds, and leaves more than noise" if c.alike else "",
        telling=f"Record {of} motion under other loads and at other speeds." if c.alike else "",
    )  # fmt: skip


def _beside(left: Unexplained, changed: Sequence[Change]) -> Unexplained:
    """What is left of a joint beside what changed there: the error after that."""
    return replace(left, size=min([c.error_after for c in changed if c.at == left.joint], default=left.size))


def _of_any_law(x: Examination, c: Change) -> bool:
    """Whether a constant torque is told of a joint that moved so little that any law of the position is all but constant there."""
    if c.joint is None or get(c.effect).part != "constant torque":
        return False
    j = x.engine.data.joints.index(c.joint)
    return float(np.ptp(x.engine.rows[j].plain(x.engine.data.q[:, j]))) < limit.TRAVEL


def _accounts(x: Examination, c: Change) -> bool:
    share = (c.error_after / max(c.error_before, 1e-12)) ** 2
    return accounts_for(x.found, x.left, x.engine.data.joints.index(c.at), share, _refused(x))


def _refused(x: Examination) -> list[Claim]:
    """Claims that are no finding."""
    return [c for c, r in zip(x.found.claims, x.ranked, strict=True) if r.objection]


def _leaves_more(x: Examination, c: Change) -> bool:
    """Whether at a change's joint more is left than noise."""
    joint = x.engine.data.joints.index(c.at)
    return joint in x.left.depends or joint in x.left.noisy


def _resembling(left: Unexplained, refuted: Sequence[Change]) -> Unexplained:
    """What is left of a joint, with the changes of levels there that are no finding."""
    here = dict.fromkeys(f"{c.label} changed: {LEAVES_TOO_MUCH}" for c in refuted if c.at == left.joint)
    return replace(left, resembles=(*left.resembles, *here))


def _depends(verdict: str, worst: int | None, shown: Pattern | None, joints: Sequence[str]) -> tuple[str, ...]:
    """The variables by name; for an unknown cause that follows none of them, that."""
    if shown is not None:
        return shown.variables
    return (f"no recorded variable (joint {joints[worst]})",) if verdict == "unknown" and worst is not None else ()


def _unexplained(x: Examination, verdict: str) -> tuple[Unexplained, ...]:
    """What is left at each joint that holds more than its sensors' noise, or a claim that is no finding.

    Of an unknown cause nothing is named, so what is left is what the model leaves without any claim.
    """
    unknown, unsettled = verdict == "unknown", {*x.left.noisy, *x.left.scattering}
    sound = [] if unknown else [k for k, r in enumerate(x.ranked) if not r.objection]
    error = (x.steps(sound)[-1].after if sound else x.found.before).whole
    out = []
    for j, joint in enumerate(x.engine.data.joints):
        here = [r for r in (*x.ranked, *x.refused) if joint in (r.joints or x.engine.data.joints[:1])]
        stands = {r.label: unknown and (r.surplus or not r.objection) for r in here}
        refuted = tuple(
            f"{r.label}: {LEAVES_TOO_MUCH if stands[r.label] else r.objection}" for r in here if unknown or r.objection
        )
        if x.found.excess[j] > limit.QUIET or j in x.left.depends or refuted or (unknown and j in unsettled):
            names = tuple(d.variable for d in x.left.depends.get(j, ())[:2])
            out.append(Unexplained(joint, float(error[j]), names, refuted))
    return tuple(out)


def _rivals(engine: Engine, claims: Sequence[Claim], stated: Collection[str]) -> tuple[tuple[str, ...], ...]:
    """Claims, each with what it beat narrowly and is not ``stated`` beside it anyway."""
    groups = []
    for claim in claims:
        others = tuple(x for x in (label(engine, s) for s in claim.rivals) if x not in stated)
        if others:
            groups.append((label(engine, claim.scored), *others))
    return tuple(groups)
