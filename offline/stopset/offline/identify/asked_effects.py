"""Numbers of the effects that an identification is asked for: those that `diagnose` would give them, and `add` too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stopset.effects.base import Fitted
from stopset.effects.registry import get
from stopset.effects.selection import matches, parse_effect
from stopset.errors import EffectError, RecordingError
from stopset.offline.abstraction.nominal_part import NO_TRACE, fit_nominal, regressed
from stopset.offline.campaign.run import Run
from stopset.offline.compare.known import TorqueModel
from stopset.offline.diagnose.compensated import search_open_loop
from stopset.offline.diagnose.estimate import estimates
from stopset.offline.diagnose.question import first_question
from stopset.recording import Recordings
from stopset.robot import Robot


def asked_effects(run: Run, known: Sequence[Fitted] = (), chosen: Sequence[str] = ()) -> tuple[Fitted, ...]:
    """Numbers of the effects that the settings of ``run`` ask for beyond friction; ``run``: of what may shape the nominal model.

    ``known`` ones are kept, ``chosen`` ones taken where they leave a trace; friction that the evidence chooses unasked has the numbers that it
    has then.  What the torque was late and what a filter took off it is that of a nominal model without them, so that the recordings are
    asked as a diagnosis of that model asks them.
    Raises `EffectError` for an effect that these recordings show no trace of.
    """
    if run.meta.effort == "compensated_torque":
        return _simulated(run, known)
    wanted = [
        name for name in (*run.settings.effects, *chosen)
        if _estimated(name, run.robot, run.settings.friction) and not any(matches(f, name) for f in known)
    ]  # fmt: skip
    if not wanted:
        return tuple(known)
    settings = replace(run.settings, effects=tuple(x for x in run.settings.effects if x not in wanted))
    part = fit_nominal(replace(run, settings=settings), tuple(known))
    unasked = {f.label: f for f in part.effects if any(g.name == f.label for g in part.chosen)}
    own = [unasked[name] for name in wanted if name in unasked]
    if len(own) == len(wanted):
        return (*known, *own)
    trials = Recordings(replace(run.meta, joints=run.robot.joints), tuple(run.trials()))
    plain = TorqueModel(part.robot, part.rotor, part.effects, part.abstraction)
    beside = [f for f in known if not get(f.effect).base]
    found = estimates(first_question(run.robot, trials, plain, run.survey.low_pass, beside, part.taken_out), wanted).found
    left = [name for name in wanted if name not in unasked]
    for name in left:
        if name not in chosen and not any(e.name == name for e in found):
            raise EffectError(f"{name}: {NO_TRACE}")
    return (*known, *own, *(unasked.get(e.fitted.label, e.fitted) for e in found if e.name in left))


def _simulated(run: Run, known: Sequence[Fitted]) -> tuple[Fitted, ...]:
    """`asked_effects` of compensated torque; what no simulation names is fitted with everything else, by output error."""
    wanted = [e for e in run.settings.effects if not parse_effect(e, run.robot)[0].base and not any(matches(f, e) for f in known)]
    if not wanted:
        return tuple(known)
    settings = replace(run.settings, effects=tuple(x for x in run.settings.effects if x not in wanted))
    part = fit_nominal(replace(run, settings=settings), tuple(known))
    plain = TorqueModel(part.robot, part.rotor, part.effects, part.abstraction)
    trials = Recordings(replace(run.meta, joints=run.robot.joints), tuple(run.trials()))
    try:
        joints = {joint for e in wanted for joint in parse_effect(e, run.robot)[1]}
        found = search_open_loop(plain, trials, run.survey, joints=joints)
    except RecordingError:  # nothing was repeated, so nothing can be judged
        return tuple(known)
    return (*known, *(r.fitted for r, _ in found.ranked() if any(matches(r.fitted, e) for e in wanted)))


def _estimated(name: str, robot: Robot, friction: str) -> bool:
    """Whether numbers of an effect are estimated: not of plain friction, nor, where ``friction`` is but what is asked for, of a law
    that is asked for at every joint: that is what friction then is."""
    effect = parse_effect(name, robot)[0]
    return not effect.base and (":" in name or friction == "evidence" or not regressed(effect))
