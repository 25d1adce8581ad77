"""Recordings in which nothing moves: all that can be told from them is whether something pushes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stopset.effects import Fitted
from stopset.effects.selection import of_part
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.answer import Diagnosis
from stopset.offline.diagnose.explain.identifiable import Blind
from stopset.recording import Recording, Recordings
from stopset.robot import Robot

USUAL_TORQUE = 100.0  # [N m] limit of a joint that has none stated
MOVE = "Move every joint through its range at several speeds."


def moves(r: Recording) -> bool:
    """Whether a trial is one in which some joint moves."""
    return r.phase != "static" and bool(np.max(np.ptp(r.q, axis=0)) > limit.STANDING)


def standing(robot: Robot, recordings: Recordings, fitted: Sequence[Fitted] = ()) -> Diagnosis:
    """Recordings in which no joint moves: torque that changes there by more than friction can hold comes from outside."""
    dry = of_part("dry friction")
    level = {f.joint: f.values.get(dry.terms[0].symbol, 0.0) for f in fitted if f.effect == dry.name}
    pushed = []
    for j, name in enumerate(robot.joints):
        most = robot.torque_limit[j] if np.isfinite(robot.torque_limit[j]) else USUAL_TORQUE
        friction = level.get(name, limit.STANDING_FRICTION * most)
        swing = max(float(np.ptp(np.quantile(r.tau[:, j], [limit.ODD, 1.0 - limit.ODD]))) for r in recordings)
        if swing > 2 * friction + limit.PUSHED * most:
            pushed.append((swing / most, name))
    names = tuple(f"time at standstill (torque of {name})" for _, name in sorted(pushed, reverse=True))
    return Diagnosis(
        verdict="unknown" if pushed else "none", ranked=(), rivals=(), depends_on=names,
        not_identifiable=(Blind("every effect of motion", (), "no joint moves in these recordings", MOVE),),
        next_experiment=(
            "The torque changes while every joint stands still: something touches the arm. Repeat with nothing in contact."
            if pushed else MOVE
        ),
        trials=len(recordings),
    )  # fmt: skip
