"""Recordings that no model may be made of: a clock, a sign or a unit that is wrong, refused in the words of `stopset inspect`.

A model of torque in mN m, or with its sign turned, encloses its own recordings like any other; nothing later would tell.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby, islice

import numpy as np

from stopset.effects.selection import of_part, usual_friction
from stopset.errors import RecordingError
from stopset.offline.inspect.contradiction import ALIGN, Dissent, OwnClock, dissents, loaded_trials, sums_of
from stopset.offline.inspect.finding import Finding
from stopset.offline.inspect.findings_clock import clock, held, polled
from stopset.offline.inspect.findings_signals import readings, saturation, velocity
from stopset.offline.inspect.findings_torque import (
    RIGHT,
    RIGHT_TORN,
    misplaced,
    mounted,
    pushed,
    spikes,
    torque_beyond,
    torque_limits,
    torque_sign,
)
from stopset.offline.inspect.inertia import Momentum
from stopset.offline.inspect.inspection import against_model
from stopset.offline.inspect.mounting import mounting
from stopset.offline.inspect.order import exchanged
from stopset.offline.inspect.reversals import add_reversals
from stopset.offline.inspect.tally import SignalSums
from stopset.offline.nominal.delay import Delay
from stopset.offline.nominal.normal_equations import NormalEquations, accumulate
from stopset.offline.nominal.scale import rubbing, torque_scales
from stopset.recording import Meta, Recording, Recordings
from stopset.recording.types import Spike
from stopset.robot import Robot

SURE_SCALE = 0.1  # relative error of a torque's scale that tells something
LOOKED_AT = 64  # trials: what is wrong here is wrong in all of them


def check_signals(robot: Robot, meta: Meta, sample: Sequence[Recording]) -> tuple[str, ...]:
    """dq against q, and compensated torque against the described inertia. Raises `RecordingError`.

    What `stopset inspect` would say besides is returned: identification goes on, but nobody should have to ask.
    """
    some = sample[:: max(1, len(sample) // LOOKED_AT)]
    tally, momentum = SignalSums(robot.n), Momentum(robot)
    for r in some:
        tally.add(r)
    # a scale that no unit, sign or clock explains may be that of a few trials: sets that hold them say so
    speeds = velocity(tally, robot.joints, meta)
    _refuse(readings(tally, robot.joints))
    _refuse(f for f in speeds if f.kind != "dq_scale")
    sound = all(f.kind in ("velocity_derived", "clock_scale", "dq_scale") for f in speeds)
    pace = clock(tally, meta, dq_sound=sound)
    _refuse(f for f in pace if f.kind in ("slow_rate", "pauses"))
    beyond = torque_limits(tally, robot.joints, robot.torque_limit)
    # a wrong unit is told best by the rigid body: of motor torque when that is fitted, see `check_torque`
    found = [*pace, *speeds, *saturation(tally, robot.joints, meta), *beyond]
    if meta.effort == "compensated_torque":
        for r in some:
            momentum.add(r)
        _refuse(against_model(robot, meta, RIGHT_TORN, *momentum.scales()))
        _refuse(beyond)
    elif (order := exchanged(robot, some)) is not None:
        _refuse(misplaced([robot.joints[k] for k in order.joints], order.better, motion=order.motion))
    elif not torque_sign(tally, robot.joints, compensated=False):  # torque of the wrong sign is not that of an arm on the ceiling
        hangs = mounting(robot, some)
        _refuse([] if hangs is None else mounted(hangs.gravity, hangs.angle, robot.chain.gravity))
    return _in_words(found)


def left_out(
    robot: Robot, seen: Sequence[tuple[str, Spike]], readings: tuple[int, int] = (0, 0), rows: float = 1.0
) -> tuple[str, ...]:
    """What of trials was left out, in the words of `stopset inspect`: samples whose torque is none, ``readings`` that a logger wrote again
    or passed over, and what stood in several ``rows`` each; all as a survey counts them."""
    return _in_words([*spikes(seen, robot.joints), *polled(*readings), *held(rows)])


def unsound(robot: Robot, meta: Meta, trials: Iterable[Recording]) -> list[Finding]:
    """Angles that jump, channels that nobody recorded, columns that are swapped or in another unit."""
    tally = SignalSums(robot.n)
    for r in trials:
        tally.add(r)
    speeds = [f for f in velocity(tally, robot.joints, meta) if f.kind in ("dq_not_derivative", "wrong_unit")]
    return [f for f in (*readings(tally, robot.joints), *speeds) if f.severity == "error"]


def check_readings(robot: Robot, meta: Meta, trials: Iterable[Recording]) -> None:
    """An effect that is named from what is `unsound` is a false one. Raises `RecordingError`."""
    _refuse(unsound(robot, meta, trials), "nothing is named from these recordings")


def check_torque(robot: Robot, meta: Meta, data: NormalEquations, lag: Delay, some: Iterable[Recording]) -> tuple[str, ...]:
    """Motor torque, ``lag`` after the motion, against the description's rigid body, from the sums of the nominal regression, and in ``some``
    of the trials against friction where joints turn round.

    What is strange but no error is returned in words. Raises `RecordingError`.
    """
    turns = np.zeros((3, robot.n))
    for r in islice(some, LOOKED_AT):
        add_reversals(turns, r)
    seen = (*torque_scales(robot, data), turns)
    _refuse(against_model(robot, meta, RIGHT_TORN, *seen))  # a wrong unit is no lag
    _refuse(torque_beyond(lag.beyond))
    _refuse(pushed(rubbing(robot, data), robot.joints))
    # other laws of friction, perhaps through a filter: `stopset inspect` need not have found the same
    strange = against_model(robot, meta, RIGHT, *seen)
    return tuple(f"seen beside the fitted friction ({f.severity}): {f.says}" for f in strange if f.severity != "note")


def check_unit(robot: Robot, meta: Meta, data: NormalEquations) -> None:
    """Torque far too small for the arm that a model knows, at several joints or by more than a drive's scale can be off: of another unit.

    A load makes it larger at will, but nothing smaller than that of the bare arm.  Raises `RecordingError`.
    """
    scale, std = torque_scales(robot, data)
    small = [j for j in range(robot.n) if std[j] < SURE_SCALE * abs(scale[j]) and abs(scale[j]) < RIGHT[0]]
    least = 1.0 + of_part("torque scale").terms[0].lo
    if len(small) > 1 or any(abs(scale[j]) < least for j in small):
        seen = ", ".join(f"{robot.joints[j]} {scale[j]:.3g}" for j in small)
        raise RecordingError(
            f"nothing is named from these recordings: their torque over what the identified arm needs is {seen}; expected about 1 N m "
            "per N m on the link side: convert tau if it is in per cent, ampere or of the motor's side"
        )


def check_files(robot: Robot, meta: Meta, trials: Iterable[Recording], *, mixed: bool) -> tuple[str, ...]:
    """Files against each other: of the same arm, but not in one state. Raises `RecordingError` where a load makes the difference.

    A load that some recordings carry would end in the torque sets of all.  What else differs (``mixed``: that, too) is returned.
    """
    names, found = [name for name, _ in meta.sources], _dissents(robot, meta, trials)
    late = next((d for d in found if isinstance(d, OwnClock)), None)
    if late is not None and not mixed:
        raise RecordingError(f"{late.seen(names)}; expected one clock: {ALIGN}, or say --mixed to take them as they are")
    rest = [d for d in found if isinstance(d, Dissent)]
    loaded = next((d for d in rest if d.mass is not None), None)
    if loaded is not None and not mixed:
        raise RecordingError(
            f"{loaded.joint}: {loaded.seen(names)}; expected files of one arm in one state, for a model of several holds all their "
            "differences in its sets: identify them apart, each with what it carries (--condition payload=KG@FILE), or say --mixed to "
            "take them as one"
        )
    clocks = tuple(f"inspect says (error): {d.seen(names)}; expected one clock" for d in found if isinstance(d, OwnClock))
    return clocks + tuple(
        f"inspect says (warning): {d.joint}: {d.seen(names)}; expected files of one arm in one state" for d in rest
    )


def check_trials(robot: Robot, meta: Meta, trials: Iterable[Recording], *, mixed: bool) -> tuple[str, ...]:
    """As `check_files`, of trials that one file holds together. Raises `RecordingError` where some carry another load."""
    found = _loaded(robot, meta, trials)
    if found and not mixed:
        label, d = found[0]
        raise RecordingError(
            f"{d.joint}: {d.seen(('the rest', label))}; expected trials of one arm in one state, for a model of several holds all their "
            "differences in its sets: identify them apart, each with what it carries (column condition), or say --mixed to take them as one"
        )
    return tuple(f"inspect says (warning): {d.joint}: {d.seen(('the rest', label))}" for label, d in found)


def check_one_state(robot: Robot, meta: Meta, trials: Recordings) -> None:
    """As `check_files` and `check_trials`, before effects are named or added: what only some of the recordings have, a load or a lag, would
    be found by half.

    Raises `RecordingError`.
    """
    names, found = [name for name, _ in meta.sources], _dissents(robot, meta, trials)
    for d in found:
        if isinstance(d, OwnClock) or d.mass is not None:
            raise RecordingError(
                f"nothing is named from these recordings together: {d.seen(names)}; expected files of one arm in one state and on one "
                "clock: ask of each apart"
            )
    for label, loaded in _loaded(robot, meta, trials):
        raise RecordingError(
            f"nothing is named from these recordings together: {loaded.seen(('the rest', label))}; expected trials of one arm in one state: "
            "ask of each apart"
        )


def _loaded(robot: Robot, meta: Meta, trials: Iterable[Recording]) -> list[tuple[str, Dissent]]:
    """Long trials that carry another load than the rest; of compensated torque nothing."""
    if meta.effort == "compensated_torque":
        return []
    return loaded_trials(robot, {r.label: data for r in islice(trials, LOOKED_AT) if (data := sums_of(robot, r)) is not None})


def _dissents(robot: Robot, meta: Meta, trials: Iterable[Recording]) -> list[Dissent | OwnClock]:
    """What files say against each other; of compensated torque nothing."""
    if len(meta.sources) < 2 or meta.effort == "compensated_torque":
        return []
    sums: list[NormalEquations | None] = [None] * len(meta.sources)
    for k, some in groupby(trials, key=lambda r: r.file):
        if k < len(sums):
            sums[k] = accumulate(robot, some, usual_friction())
    return dissents(robot, sums)


def _in_words(found: Iterable[Finding]) -> tuple[str, ...]:
    return tuple(f"inspect says ({f.severity}): {f.says}" for f in found if f.severity != "note")


def _refuse(found: Iterable[Finding], why: str = "the recordings make no model of this arm") -> None:
    worst = next((f for f in found if f.severity == "error"), None)
    if worst is not None:
        raise RecordingError(f"{why}: {worst.says}")
