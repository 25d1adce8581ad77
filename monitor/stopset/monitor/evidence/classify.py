"""Which class a violation is of: the smallest change of the readings after which they agree with the model again.

Readings that repeat themselves are seen as they are. For the rest every kind of fault says how it would have changed the
readings; that change is taken back, and the model decides whether what remains could have been measured. Kinds that change
less are asked first. What only a torque from outside explains is told apart by its course: a sharp onset is a contact, a slow
one a drift, one that goes with a signal a missing effect.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stopset.monitor.evidence.cause import UNCLASSED, Cause, Kind
from stopset.monitor.evidence.dynamics import Dynamics, Readings
from stopset.monitor.evidence.trace import Window
from stopset.types import Array

FEWEST, BEFORE = 8, 2  # rows after and before the first contradiction; with fewer nothing is told
AHEAD, AFTER = 0.2, 0.6  # [s] of readings around the first contradiction, without a gap, that tell delays and pushes apart
REPEATS = 5  # identical readings in a row that are no coincidence where the arm moves
FEW = 3.0  # smallest steps of a position that a speed must have made for it to be called frozen
TURN = 8.0  # smallest steps that a torque which turns round makes, at most, as long before or after as it seems to stay
SPIKE = 3  # rows that a spike lasts at most
LATEST = 12  # cycles that torque is tried late by
TRIED = 12  # of the most promising ways of being late, held against the model
SHARP = 0.03  # [s] in which most of a contact's push has come
BACK = 10  # rows before the first contradiction in which its cause is looked for
GOES_WITH = 0.7  # of what a steady or growing push, or a delay, leaves unexplained, a signal may leave at most
CREDIBLE = 0.5  # of all that is to be explained


@dataclass(frozen=True, slots=True)
class Case:
    """Rows without a gap, the row ``at`` that was contradicted first, and the ``joint`` and ``signal`` it showed in."""

    w: Window
    at: int
    joint: int
    signal: str
    model: Dynamics
    readings: Readings
    pause: Callable[[], None]

    def holds(self, changed: Readings) -> bool:
        self.pause()
        return self.model.contradiction(changed) <= 0.0

    @property
    def unit(self) -> str:
        return "rad" if self.signal == "q" else "rad/s"

    def cause(self, kind: Kind, says: str, joint: int | None, row: int, **more: object) -> Cause:
        name = "" if joint is None else self.model.joints[joint]
        return Cause(kind, says, name, t=float(self.w.t[row]), **more)  # type: ignore[arg-type]


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
        return _untold(case, case.at, "to tell delays and pushes apart")
    pushes = Pushes.of(case)
    return late_torque(case, pushes) or pushed(case, pushes)


def _untold(c: Case, row: int, what: str) -> Cause:
    """Over so short a time one kind looks like another."""
    ahead, after = c.at * c.model.dt, (len(c.w) - c.at) * c.model.dt
    says = f"readings without a gap: {ahead:.2f} s before and {after:.2f} s after it; {AHEAD:g} and {AFTER:g} s are needed {what}"
    return replace(UNCLASSED, t=float(c.w.t[row]), says=says)


def _same(x: Array) -> NDArray[np.bool_]:
    """(N,) whether a row is the one before."""
    return np.concatenate([[False], np.all(x[1:] == x[:-1], axis=1)])


def _repeat_around(same: NDArray[np.bool_], at: int, least: int) -> tuple[int, int] | None:
    """First and last row of the longest repetition that touches what led to row ``at``."""
    best = None
    k = 0
    while k < len(same):
        end = k
        while end < len(same) and same[end]:
            end += 1
        if end - k >= least - 1 and k - BACK <= at <= end + BACK and (best is None or end - k > best[1] - best[0]):
            best = (k, end)
        k = end + 1
    return None if best is None else (best[0] - 1, best[1] - 1)


def repeated(c: Case) -> Cause | None:
    """Readings that stay exactly what they were while the arm cannot have stood still."""
    w, n = c.w, c.model.n
    every = _same(np.hstack([w.q, w.dq, w.tau]))
    if (found := _repeat_around(every, c.at, REPEATS)) and _moved(c, found, range(n)):
        a, b = found
        return c.cause(
            Kind.STALE, f"all readings stayed exactly the same for {b - a + 1} cycles while the arm moved: old messages sent again",
            None, a, signal="q", size=(b - a + 1) * c.model.dt, unit="s",
        )  # fmt: skip
    for j in sorted(range(n), key=lambda j: j != c.joint):
        for signal, columns, least in (("q", [w.q, w.dq], REPEATS), ("q", [w.q], REPEATS), ("tau", [w.tau], 2 * REPEATS)):
            same = _same(np.column_stack([x[:, j] for x in columns]))
            found = _repeat_around(same, c.at, least)
            if found is None or not _moved(c, found, [j]) or _usual(same, found, c.at):
                continue
            a, b = found
            if not _says_it_moves(c, found, j) if signal == "q" else _turns(c, found, j):
                continue
            what = "torque" if signal == "tau" else "position and speed" if len(columns) == 2 else "position"
            return c.cause(
                Kind.FROZEN, f"the {what} of {c.model.joints[j]} stayed exactly the same for {b - a + 1} cycles while it moved",
                j, a, signal=signal, size=(b - a + 1) * c.model.dt, unit="s",
            )  # fmt: skip
    return None


def _says_it_moves(c: Case, rows: tuple[int, int], j: int) -> bool:
    """Whether the speed that is read contradicts a position that stays: by the time it would have made some of its smallest steps."""
    a, b = rows
    steps = np.abs(np.diff(c.w.q[:, j]))
    smallest = float(steps[steps > 0].min(initial=np.inf))
    travel = float(np.abs(c.w.dq[a : b + 1, j]).min()) * (b - a) * c.model.dt
    return travel > FEW * smallest


def _turns(c: Case, rows: tuple[int, int], j: int) -> bool:
    """Whether a torque may only have turned round there, below its smallest step: it changes little as long before and after."""
    (a, b), tau = rows, c.w.tau[:, j]
    steps = np.abs(np.diff(tau))
    around = abs(tau[a] - tau[max(0, 2 * a - b)]), abs(tau[min(len(tau) - 1, 2 * b - a)] - tau[b])
    return bool(max(around) <= TURN * steps[steps > 0].min(initial=np.inf))


def _moved(c: Case, rows: tuple[int, int], joints: range | list[int]) -> bool:
    """Whether the model says that some of the joints went on moving there, by more than the tube of that age is wide."""
    a, b = rows
    ages = min(b - a, len(c.model.lo) - 1)
    if ages < 1 or a < 1:
        return False
    x = c.readings.x[a]
    for k in range(ages):
        x = x @ c.model.Ad.T + c.readings.u[a + k] @ c.model.Bd.T
    e = c.readings.x[a + ages] - x
    out = (e > c.model.hi[ages]) | (e < c.model.lo[ages])
    return any(out[j] or out[c.model.n + j] for j in joints)


def _usual(same: NDArray[np.bool_], rows: tuple[int, int], at: int) -> bool:
    """Coarse readings repeat themselves at slow speeds: as long a repetition before means nothing."""
    longest = run = 0
    for k in range(min(rows[0], at - BACK)):
        run = run + 1 if same[k] else 0
        longest = max(longest, run)
    return 2 * longest >= rows[1] - rows[0]


def spike(c: Case) -> Cause | None:
    """A few bad samples: without them everything agrees."""
    before = c.readings.x[c.at - 1]
    for length in range(1, SPIKE + 1):
        for start in (c.at, c.at - 1, c.at - 2):
            rows = slice(start, start + length)
            if start < 1 or start + length >= len(c.w) or not c.holds(c.readings.without(rows)):
                continue
            torque = Readings(c.readings.x, c.readings.without(rows).u, c.readings.good)
            if c.holds(torque):
                size = c.w.tau[rows] - 0.5 * (c.w.tau[start - 1] + c.w.tau[start + length])
                j = int(np.argmax(np.abs(size).max(axis=0) / (c.model.U_hi - c.model.U_lo)))
                value, signal, unit = float(size[np.argmax(np.abs(size[:, j])), j]), "tau", "N m"
            else:
                j, signal, unit = c.joint, c.signal, c.unit
                away = (c.w.q if signal == "q" else c.w.dq)[rows, j] - before[j if signal == "q" else c.model.n + j]
                value = float(away[np.argmax(np.abs(away))])
            words = {"q": "position", "dq": "speed", "tau": "torque"}[signal]
            many = "one sample" if length == 1 else f"{length} samples"
            return c.cause(
                Kind.SPIKE, f"{many} of the {words} of {c.model.joints[j]} off by {value:.3g} {unit}; all others agree with the model",
                j, start, signal=signal, size=value, unit=unit,
            )  # fmt: skip
    return None


def jump(c: Case) -> Cause | None:
    """A reading that is off by the same amount from some row on."""
    n, i = c.model.n, c.joint + (0 if c.signal == "q" else c.model.n)
    lo = max(0, c.at - BACK)
    e = c.model.innovations(c.readings)[lo : c.at, :]
    for signal, column in ((c.signal, i), ("q", c.joint), ("dq", n + c.joint)):
        k = lo + int(np.argmax(np.abs(e[:, column])))
        step = _step(c, k, column)
        if step is None:
            continue
        shift = np.zeros_like(c.readings.x)
        shift[k + 1 :, column] = -step
        if not c.holds(c.readings.plus(x=shift)):
            continue
        what, unit = ("position", "rad") if signal == "q" else ("speed", "rad/s")
        return c.cause(
            Kind.ENCODER_JUMP, f"the {what} of {c.model.joints[c.joint]} jumped by {step:.3g} {unit} and stayed there, without motion",
            c.joint, k + 1, signal=signal, size=step, unit=unit,
        )  # fmt: skip
    return None


def _step(c: Case, k: int, column: int) -> float | None:
    """The middle of what a state can have jumped by after row ``k``, by the rows around; None if no jump explains them."""
    least, most, x = -np.inf, np.inf, c.readings.x
    for start in range(max(0, k - BACK), k + 1):
        predicted = x[start]
        for row in range(start + 1, min(k + 1 + BACK, len(x))):
            predicted = predicted @ c.model.Ad.T + c.readings.u[row - 1] @ c.model.Bd.T
            age = row - start
            if row > k and age < len(c.model.lo):
                away = x[row, column] - predicted[column]
                least, most = max(least, away - c.model.hi[age, column]), min(most, away - c.model.lo[age, column])
    return 0.5 * float(least + most) if least <= most else None


def late_torque(c: Case, pushes: Pushes) -> Cause | None:
    """Torque that was told later than it acted: moved back in time it agrees, and no law explains the ``pushes`` far better.

    In wide sets a motion back and forth lets a little delay pass for a weak spring; and what is outside by a hair agrees after any
    change, so the pushes are asked where none is more than the model may lack, too.
    """
    tau, y = c.w.tau, c.model.pushes(c.readings)
    width, rows = c.model.U_hi - c.model.U_lo, np.arange(len(c.w))
    tried: list[tuple[float, int, int, int | None]] = []
    for late in range(1, min(LATEST, len(c.w) - c.at - 2) + 1):
        for since in {0, *range(max(0, c.at - 2 * BACK), c.at + 1, 2)}:
            earlier = _earlier(tau, late, np.flatnonzero(rows >= since))
            over = np.square(c.model.beyond(y - c.model.averaged(earlier)) / width).sum(axis=0)
            as_is = np.square(c.model.beyond(y) / width).sum(axis=0)
            tried.append((float(over.sum()), late, since, None))
            tried.append((float(over[c.joint] + np.delete(as_is, c.joint).sum()), late, since, c.joint))
        c.pause()
    for _, late, since, joint in sorted(tried, key=lambda x: (x[0], x[1]))[:TRIED]:
        more = _earlier(tau, late, np.flatnonzero(rows >= since), joint)
        if pushes.lawful_beside(pushes.left_by(c, more)):
            continue
        u = c.readings.u + more
        if c.holds(Readings(c.readings.x[:-late], u[:-late], c.readings.good[:-late])):
            where = "of all joints" if joint is None else f"of {c.model.joints[joint]}"
            return c.cause(
                Kind.LATE_TORQUE, f"the torque {where} is told about {1e3 * late * c.model.dt:.0f} ms later than it acts", joint,
                max(since, 0), signal="tau", size=late * c.model.dt, unit="s",
            )  # fmt: skip
    return None


def _earlier(tau: Array, late: int, rows: NDArray[np.int64], joint: int | None = None) -> Array:
    """(N, n) what moving the torque of ``rows`` ``late`` cycles back in time adds to it."""
    out = np.zeros_like(tau)
    rows = rows[rows < len(tau) - late]
    columns = slice(None) if joint is None else [joint]
    moved = np.zeros_like(tau)
    moved[rows] = tau[rows + late] - tau[rows]
    out[:, columns] = moved[:, columns]
    return out


# ---- what only another torque explains -----------------------------------------------------------------------------------


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
        return _untold(c, 0, f"to tell how the push on {c.model.joints[j]} began")
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
