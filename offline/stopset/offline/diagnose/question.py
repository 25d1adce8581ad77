"""What recordings are asked, and against what: the same question whichever command asks it.

A model's numbers of an effect must not depend on the way they were asked for.  So `diagnose`, `add` and `identify --effects` put one
question to the search: the same trials, the torque in step with the motion and without what a filter took off it, against the same
description, beside the same effects.  The motions that judge a model's sets are left out of it: a model that is made with these
numbers must not have seen them.  A law that identification chose unasked has the numbers that it has beside all else, in each of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stopset.artifact import Model
from stopset.effects.base import Fitted
from stopset.effects.selection import usual_friction
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.survey import survey
from stopset.offline.compare.known import TorqueModel, rms_left
from stopset.offline.compare.restored import restored
from stopset.offline.diagnose.evidence.baseline import DESCRIBED, baseline, settled
from stopset.offline.diagnose.evidence.priors import Beforehand, Known
from stopset.offline.diagnose.rows.sampling import in_step, period_of, whole_samples
from stopset.offline.diagnose.standing import moves
from stopset.offline.inspect.gate import check_one_state, check_torque, check_unit
from stopset.offline.nominal.delay import estimate_delay, lag_in_words, own_clock
from stopset.offline.nominal.low_pass import a_minute, in_words, recorded_low_pass
from stopset.offline.nominal.nominal import lag_entry
from stopset.offline.nominal.normal_equations import accumulate
from stopset.offline.nominal.prior import prior_of
from stopset.recording import Recordings, SuiteKey
from stopset.recording.repetition import POWERED
from stopset.robot import Robot

Lags = tuple[Mapping[str, Any], ...]  # entries of `lag_entry`


@dataclass(frozen=True, slots=True)
class Inquiry:
    """``recordings`` as they are asked, against ``robot`` and, of other recordings than the model's own, what is ``known`` of it.

    ``held``: suites that are not asked, because a model's sets are judged on them; ``fitted``: effects that stand beside every
    hypothesis; ``against``, ``notes``: for people; ``taken_out``: what was taken off before anything was asked; ``chosen``: laws that
    identification chose in these recordings; ``model``: that of other recordings, which these are held against.
    """

    robot: Robot
    recordings: Recordings
    held: frozenset[SuiteKey]
    fitted: tuple[Fitted, ...]
    known: Known | None
    against: str
    notes: tuple[str, ...] = ()
    taken_out: tuple[Mapping[str, Any], ...] = ()
    chosen: tuple[str, ...] = ()
    model: Model | None = None

    @property
    def before(self) -> Beforehand:
        """What is known of the recordings before they are asked."""
        return Beforehand(None, self.known, taken_std(self.asked, self.taken_out), self.chosen)

    @property
    def asked(self) -> Recordings:
        """The recordings without those that judge."""
        return replace(self.recordings, trials=tuple(r for r in self.recordings if r.suite_key not in self.held))


def question(model: Model, recordings: Recordings) -> Inquiry:
    """What ``recordings`` are asked against a model.

    What `identify` chose itself stays in question on its own recordings; against others the model stands as it is.
    Raises `RecordingError` for others that are not of one state.
    """
    base = baseline(model, recordings)
    own = base.known is None
    powered = any(moves(r) and r.phase in POWERED for r in recordings)
    held = survey(lambda: recordings.trials).held_out if powered else frozenset()
    learnt = [r for r in recordings if moves(r) and r.suite_key not in held]
    if not own and not model.provenance.get("settings", {}).get("mixed"):
        check_one_state(model.robot.as_described, recordings.meta, recordings)
    by_model = tuple(model.provenance.get("taken_out", ()))
    asked = replace(recordings, trials=tuple(learnt))
    taken_out, late = (by_model, ()) if own else _lag_of(base.robot, asked, common_lags(by_model))
    cutoff = recorded_low_pass(model.robot.as_described, learnt)
    filtered = (
        (f"{in_words(cutoff)}; what it took off was put back from the model, and says nothing of its own",) if cutoff else ()
    )
    prepared = in_time(recordings, model, cutoff, taken_out)
    known = base.known
    if known is not None and len(known.own):
        known = replace(known, now=rms_left(model, [r for r in prepared if moves(r) and r.suite_key not in held]))
    return Inquiry(
        base.robot, prepared, held, settled(model) if own else model.effects, known,
        base.against, (*base.notes, *late, *filtered), taken_out, tuple(model.provenance.get("chosen", ())) if own else (),
        None if own else model,
    )  # fmt: skip


def _lag_of(robot: Robot, recordings: Recordings, usual: Lags) -> tuple[Lags, tuple[str, ...]]:
    """What all joints' torque lags the motion in recordings that are not the model's own: as in the model's, unless these show another.

    Raises `RecordingError` where it is farther off than can be searched: friction and inertia named from it would be false ones.
    """
    pieces = a_minute(recordings.trials)
    data = accumulate(robot, pieces, usual_friction())
    check_unit(robot, recordings.meta, data)
    found = estimate_delay(data, prior_of(robot))
    value, std = sum(float(x["value"]) for x in usual), float(np.hypot.reduce([float(x["std"]) for x in usual])) if usual else 0.0
    expected = replace(found, common=value, common_std=std, beyond=0.0)
    if not own_clock(found, expected, 2 * found.hold):
        return usual, ()
    for half in (pieces[::2], pieces[1::2]):  # a lag is in every part; what a load in one of them leaves only looks like one
        again = estimate_delay(accumulate(robot, half, usual_friction()), prior_of(robot))
        if half and not own_clock(again, expected, 2 * found.hold):
            return usual, ()
    if found.beyond:
        check_torque(robot, recordings.meta, data, found, pieces)
    note = (
        f"the torque of these recordings is {lag_in_words(found)} the motion at all joints, that of the model's own "
        f"{lag_in_words(expected)} it: taken out before anything was asked; record torque and motion on one clock"
    )
    return (lag_entry(None, found.common, found.common_std),), (note,)


def first_question(
    robot: Robot,
    recordings: Recordings,
    body: TorqueModel,
    cutoff: float,
    fitted: Sequence[Fitted],
    taken_out: Sequence[Mapping[str, Any]],
) -> Inquiry:
    """What an identification asks its ``recordings``, of which none judges, before there is a model of them."""
    prepared = in_time(recordings, body, cutoff, taken_out)
    return Inquiry(robot, prepared, frozenset(), tuple(fitted), None, DESCRIBED, (), tuple(taken_out))


def in_time(
    recordings: Recordings, body: Model | TorqueModel, cutoff: float, taken_out: Sequence[Mapping[str, Any]]
) -> Recordings:
    """Recordings with what a low-pass of ``cutoff`` [Hz] took off put back, and without the lag of all joints' torque.

    That lag was taken out by identification, which is told: nothing is asked of it again.
    """
    if cutoff:
        recordings = replace(recordings, trials=tuple(restored(body, recordings, cutoff)))
    return in_step(recordings, *_common(taken_out))


def own_in_time(run: Run, body: Model | TorqueModel, taken_out: Sequence[Mapping[str, Any]]) -> Recordings:
    """All that a model of a run is held against of its own recordings, `in_time`."""
    return in_time(Recordings(run.meta, tuple(run.survey.sample)), body, run.survey.low_pass, taken_out)


def _common(taken_out: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """[s] how late all joints' torque is, by what was taken out, and how far that may be off."""
    lags = common_lags(taken_out)
    return -sum(float(x["value"]) for x in lags), sum(float(x["std"]) for x in lags)


def taken_std(recordings: Recordings, taken_out: Sequence[Mapping[str, Any]]) -> float:
    """[s] how far off the lag is that was taken out of the torque that is asked; 0 where none was.

    A joint's own lag, which identification takes out of its fit, stays in the record: a delay found there is told by that alone.
    """
    moving = [r for r in recordings if r.phase != "static" and len(r.t) > 1]
    lag, std = _common(taken_out)
    return std if moving and whole_samples(lag, std, period_of(moving)) else 0.0


def common_lags(taken_out: Sequence[Mapping[str, Any]]) -> Lags:
    """The lag of all joints, of what was taken out."""
    return tuple(x for x in taken_out if x["joint"] is None and x["unit"] == "s")
