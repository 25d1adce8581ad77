"""What only another torque explains: a contact, a drift, or an effect that the model lacks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from stopset.monitor.evidence.case import AHEAD, Case
from stopset.monitor.evidence.cause import Cause, Kind
from stopset.types import Array

SHARP = 0.03  # [s] in which most of a contact's push has come
GOES_WITH = 0.7  # of what a steady or growing push, or a delay, leaves unexplained, a signal may leave at most
CREDIBLE = 0.5  # of all that is to be explained


def _columns(c: Case, j: int) -> Iterator[tuple[str, Array]]:
    """Signals (N, m) that a missing law of joint ``j`` may go with; the name is what is said."""
    w = c.w
    one = np.ones(len(w))
    yield "tau", w.tau[:, [j]]
    yield "dq", w.dq[:, [j]]
    yield "direction of motion", np.tanh(w.dq[:, [j]] / 0.01)
    yield "q", np.column_stack([w.q[:, j], one])  # a spring rests anywhere
    yield "sin q", np.sin(w.q[:, [j]])
    yield "cos q", np.cos(w.q[:, [j]])
    if np.isfinite(w.temp[:, j]).all():
        yield "temp * dq", w.temp[:, [j]] * w.dq[:, [j]]


@dataclass(frozen=True, slots=True)
class PushFit:
    """A push from row ``onset`` on, ``size`` times a signal (the first of several); ``left``: the part of the pushes' squares that it
    does not explain."""

    size: float
    onset: int
    left: float


def _fit(c: Case, y: Array, course: Callable[[int], Array], onsets: list[int]) -> PushFit:
    """The best onset and sizes of a push that is a sum of the columns (N, m) of ``course(onset)``, for one joint's pushes ``y``."""
    best, total = PushFit(0.0, onsets[0], 1.0), float(y @ y) or 1.0
    for onset in onsets:
        x = c.model.averaged(course(onset))
        sizes = np.linalg.lstsq(x, y, rcond=None)[0]
        left = 1.0 - float(y @ x @ sizes) / total
        if left < best.left:
            best = PushFit(float(sizes[0]), onset, left)
    c.pause()
    return best


@dataclass(frozen=True, slots=True)
class Pushes:
    """What the model lacks of torque ``values`` (N, n) [N m], ``beyond`` what it may lack; in ``joint``, where that is most, or the
    most of what it may lack, the steady, the growing and the lawful push that explain it best, the law by the signal ``goes_with``."""

    values: Array
    beyond: Array
    joint: int
    step: PushFit
    ramp: PushFit
    law: PushFit
    goes_with: str

    @classmethod
    def of(cls, c: Case) -> Pushes:
        values, width = c.model.pushes(c.readings), c.model.U_hi - c.model.U_lo
        beyond = c.model.beyond(values)
        j = int(np.argmax(((beyond if beyond.any() else np.abs(values - c.model.middle)) / width).max(axis=0)))
        y = (values - c.model.middle)[:, j]
        rows = np.arange(len(c.w))[:, None]
        onsets = list(range(min(c.at + 1, len(rows) - c.model.steps - 4)))
        onsets = onsets[:: max(1, len(onsets) // 80)]
        step = _fit(c, y, lambda k: (rows >= k).astype(float), onsets)
        ramp = _fit(c, y, lambda k: np.maximum(rows - k, 0).astype(float), onsets)
        laws = {name: _fit(c, y, lambda k, x=x: np.where(rows >= k, x, 0.0), onsets) for name, x in _columns(c, j)}  # type: ignore[misc]
        goes_with, law = min(laws.items(), key=lambda item: item[1].left)
        return cls(values, beyond, j, step, ramp, law, goes_with)

    @property
    def felt(self) -> bool:
        """Whether some push of its own is more than the model may lack."""
        return bool(self.beyond.any())

    def lawful_beside(self, left: float) -> bool:
        """Whether the law explains far more than what leaves this part of the pushes' squares."""
        return self.law.left < GOES_WITH * left and self.law.left < CREDIBLE

    def left_by(self, c: Case, torque: Array) -> float:
        """The part of the squares that another input, by ``torque`` (N, n), does not explain."""
        y = (self.values - c.model.middle)[:, self.joint]
        rest = y - c.model.averaged(torque)[:, self.joint]
        return float(rest @ rest) / (float(y @ y) or 1.0)


def pushed(c: Case, pushes: Pushes) -> Cause:
    """Contact, drift or missing effect: the push that the model lacks, by its course in time and what it goes with."""
    j, law, ramp = pushes.joint, pushes.law, pushes.ramp
    if pushes.lawful_beside(min(pushes.step.left, ramp.left)):
        what, name = c.model.joints[j], pushes.goes_with
        return c.cause(
            Kind.MISSING_EFFECT, f"{what} needs a torque that goes with its {name}: an effect that the model lacks, or that has changed",
            j, law.onset, signal="tau", size=law.size, unit="", depends_on=name,
        )  # fmt: skip
    if not pushes.felt:
        return _crept(c)
    if min(c.at, int(np.argmax(pushes.beyond[:, j] > 0.0))) < round(AHEAD / c.model.dt):
        return c.untold(0, f"to tell how the push on {c.model.joints[j]} began")
    if _sharp(c, pushes.values[:, j]) or pushes.step.left <= ramp.left:
        return _contact(c, pushes.values, pushes.beyond, j)
    size = float(ramp.size * (len(c.w) - 1 - ramp.onset))
    return c.cause(
        Kind.DRIFT, f"{c.model.joints[j]} needs a torque that has grown slowly to {size:.3g} N m", j, ramp.onset,
        signal="tau", size=size, unit="N m",
    )  # fmt: skip


def _sharp(c: Case, y: Array) -> bool:
    """Whether most of the push came within `SHARP`, and there was none before."""
    span = c.model.steps + max(1, round(SHARP / c.model.dt))
    if len(y) <= span:
        return False
    change = float(np.max(np.abs(y[span:] - y[:-span])))
    return change > 0.6 * float(np.ptp(y))


def _contact(c: Case, pushes: Array, beyond: Array, worst: int) -> Cause:
    """The place is the last joint of the chain that feels it: a force on a link bends no joint behind it."""
    first = int(np.argmax(beyond[:, worst] > 0.0))
    row = min(first + c.model.steps - 1, len(c.w) - 1)
    after = pushes[first : first + max(1, round(0.1 / c.model.dt))] - c.model.middle
    torque = after[np.argmax(np.abs(after[:, worst]))]
    felt = np.flatnonzero(beyond[first : first + len(after)].max(axis=0) > 0.0)
    last = int(felt.max())
    said = ", ".join(f"{c.model.joints[i]} {torque[i]:+.3g} N m" for i in felt)
    return c.cause(
        Kind.CONTACT, f"a sudden push from outside on the link behind {c.model.joints[last]}, or beyond it: {said}", last, row,
        signal="tau", size=float(torque[worst]), unit="N m", torque=tuple(float(x) for x in torque),
    )  # fmt: skip


def _crept(c: Case) -> Cause:
    """No push of its own is too large, but they add up; or a reading creeps away from what the speeds say."""
    rows, i = np.arange(len(c.w)), c.joint + (0 if c.signal == "q" else c.model.n)
    e = c.model.innovations(c.readings)[:, i]
    for onset in range(0, max(1, c.at), max(1, c.at // 20)):
        slope = float(e[onset:].mean())
        creep = np.zeros_like(c.readings.x)
        creep[:, i] = -slope * np.maximum(rows - onset, 0)
        if c.signal == "q" and c.holds(c.readings.plus(x=creep)):
            size = slope * (len(rows) - 1 - onset)
            return c.cause(
                Kind.DRIFT, f"the position of {c.model.joints[c.joint]} creeps away from its speed, by {size:.3g} rad here",
                c.joint, onset, signal="q", size=size, unit="rad",
            )  # fmt: skip
    return c.cause(
        Kind.DRIFT, f"{c.model.joints[c.joint]} has slowly left its prediction; no moment of it stands out", c.joint, 0,
        signal=c.signal, size=0.0, unit="",
    )  # fmt: skip
