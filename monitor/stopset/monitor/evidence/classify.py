"""Which class a violation is of: the smallest change of the readings after which they agree with the model again.

Readings that repeat themselves are seen as they are. For the rest every kind of fault says how it would have changed the
readings; that change is taken back, and the model decides whether what remains could have been measured. Kinds that change
less are asked first. What only a torque from outside explains is told apart by its course: a sharp onset is a contact, a slow
one a drift, one that goes with a signal a missing effect.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from stopset.monitor.evidence.case import AFTER, Case
from stopset.monitor.evidence.cause import UNCLASSED, Cause
from stopset.monitor.evidence.dynamics import Dynamics, Readings
from stopset.monitor.evidence.late import late_torque
from stopset.monitor.evidence.offsets import jump, spike
from stopset.monitor.evidence.pushes import Pushes, pushed
from stopset.monitor.evidence.repeats import repeated
from stopset.monitor.evidence.trace import Window

FEWEST, BEFORE = 8, 2  # rows after and before the first contradiction; with fewer nothing is told


def classify(
    window: Window, first: int, joint: int, signal: str, model: Dynamics, pause: Callable[[], None] = lambda: time.sleep(0)
) -> Cause:
    """The cause of the contradiction at row ``first`` of ``window``, seen at joint number ``joint`` in ``signal`` ("q", "dq").

    ``pause`` is called between looks that take milliseconds.
    """
    lo, hi = window.run(first)
    if hi - first < FEWEST or first - lo < BEFORE:
        return replace(UNCLASSED, t=float(window.t[first]))
    w = window.part(lo, hi)
    case = Case(w, first - lo, joint, signal, model, Readings.of(w), pause)
    for look in (repeated, spike, jump):
        if (found := look(case)) is not None:
            return found
    if hi - first < round(AFTER / model.dt):
        return case.untold(case.at, "to tell delays and pushes apart")
    pushes = Pushes.of(case)
    return late_torque(case, pushes) or pushed(case, pushes)
