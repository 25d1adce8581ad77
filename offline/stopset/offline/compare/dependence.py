"""Which variable explains the error of which joint: shares of the torque error's variance, judged on held-out stretches.

For each joint and variable the error is averaged within bins of the variable on one half of the interleaved stretches and
tried on the other; what that takes off the variance is the share explained.  Nothing is assumed of the shape.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.offline.abstraction.metrics import AVERAGING, torque_error
from stopset.offline.campaign.survey import Survey
from stopset.recording import Recording
from stopset.robot.rigid import gravity_torques
from stopset.types import Array

BINS = 12
ROUNDS = 20  # of backfitting: two overlapping variables have settled by then
STRETCH = 5  # windows of `AVERAGING` in a row that are held out together: about a second
TIE = 0.03  # shares that differ by less do not tell one variable from another
SAME = 0.005  # columns that print alike
FEWEST = 4 * BINS  # windows below which no share is given


class ErrorVariable(NamedTuple):
    """What an error may depend on: of each joint its own, or one ``joint``'s for all."""

    name: str
    joint: int | None = None


@dataclass(frozen=True, slots=True)
class Explained:
    """``share`` (n, k): fraction of each joint's squared torque error that each of the ``variables`` explains, 0 to 1.

    ``foreign`` (k,): whether a variable is another joint's; ``error`` (W, n) [N m] and ``values`` (k entries of (W, n)): the
    windows it was computed from.
    """

    variables: tuple[str, ...]
    share: Array
    error: Array
    values: tuple[Array, ...]
    foreign: tuple[bool, ...]

    def strongest(self, joint: int) -> int:
        """Number of the variable that explains most at a joint; of those that explain about as much, one of its own, the plainest.

        Joints that are moved together explain each other's errors as well as their own: only a clearly better one is believed.
        """
        good = np.flatnonzero(self.share[joint] >= self.share[joint].max() - TIE)
        own = [int(k) for k in good if not self.foreign[k]]
        return own[0] if own else int(np.argmax(self.share[joint]))


def strongest_first(found: Explained) -> NDArray[np.intp]:
    """Numbers of the variables, the ones that tell most first, without those that say the same as one before them."""
    order = np.argsort(-found.share.max(axis=0) + TIE * np.array(found.foreign, float), kind="stable")
    retained: list[int] = []
    for k in order:
        same = [
            m for m in retained if np.allclose(found.share[:, m], found.share[:, k], atol=SAME) and found.share[:, k].max() > SAME
        ]
        if not same:
            retained.append(int(k))
    return np.array(retained, dtype=np.intp)


@dataclass(frozen=True, slots=True)
class PartialResidual:
    """Torque error of a joint against its telling variable, what the ``other`` variable explains taken off.

    ``x, y`` (W,): the points; ``line``: mean of ``y`` within bins of ``x``, as (middle, mean) pairs (b, 2).
    """

    variable: str
    other: str
    x: Array
    y: Array
    line: Array


def partial_residual(found: Explained, joint: int, variable: int | None = None) -> PartialResidual:
    """The two variables that explain most together, fitted in turn by bin means until neither takes up the other's part.

    ``variable``: number of the first of them, instead of the telling one.

    Plain error over one variable misleads where another one acts as well: its part looks like scatter or, where both move
    together, like the first one's law.  Source: Hastie & Tibshirani (1990), backfitting.
    """
    e = found.error[:, joint] - found.error[:, joint].mean()
    first = found.strongest(joint) if variable is None else variable
    places = [_places(v[:, joint]) for v in found.values]
    left = e - _means(e, places[first])[places[first]]
    rest = [k for k in range(len(places)) if k != first]
    second = min(rest, key=lambda k: float(np.sum((left - _means(left, places[k])[places[k]]) ** 2)), default=first)
    law = np.zeros(1)
    other = np.zeros_like(e)
    for _ in range(ROUNDS):
        law = _means(e - other, places[first])
        if second != first:
            other = _means(e - law[places[first]], places[second])[places[second]]
    x, y = found.values[first][:, joint], e - other
    used = np.unique(places[first])
    line = np.array([[float(x[places[first] == b].mean()), float(y[places[first] == b].mean())] for b in used])
    names = found.variables
    return PartialResidual(names[first], names[second] if second != first else "", x, y, line)


def _places(x: Array) -> NDArray[np.intp]:
    """(W,) bin of each window, of equal numbers of windows."""
    return np.searchsorted(np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1])), x)


def _means(y: Array, place: NDArray[np.intp]) -> Array:
    """(BINS,) mean of ``y`` in each bin, zero in an empty one."""
    count = np.bincount(place, minlength=BINS)
    return np.bincount(place, weights=y, minlength=BINS) / np.maximum(count, 1)


def explained(model: Model, pairs: Iterable[tuple[int, Recording, Array]], found: Survey) -> Explained:
    """Shares over all trials of ``pairs`` (motion, trial, input)."""
    dt = model.powered.dt
    m = max(1, round(AVERAGING / dt))
    errors: list[Array] = []
    columns: dict[ErrorVariable, list[Array]] = {}
    for _, r, u in pairs:
        e = torque_error(model.abstraction, dt, r.q, r.dq, u)
        if not len(e):
            continue
        errors.append(e)
        middle = np.arange(len(e)) * m + m // 2
        for variable, value in _variables(model, r, u, found.warm(r)).items():
            columns.setdefault(variable, []).append(value[middle])
    variables = [k for k, parts in columns.items() if len(parts) == len(errors)]
    error = np.vstack(errors)
    values = tuple(np.vstack(columns[k]) for k in variables)
    # a joint's own angle and speed stand under their own names
    share = np.array(
        [
            [0.0 if k.joint == j else _share(error[:, j], v[:, j]) for k, v in zip(variables, values, strict=True)]
            for j in range(model.n)
        ]
    )
    return Explained(tuple(v.name for v in variables), share, error, values, tuple(v.joint is not None for v in variables))


def _variables(model: Model, r: Recording, u: Array, warm: float) -> dict[ErrorVariable, Array]:
    """Signals (N, n) that an error may depend on."""
    n = model.n
    gravity = gravity_torques(model.robot.chain, model.robot.pi, np.ascontiguousarray(r.q))
    direction = np.sign(r.dq)
    out = {
        "q": r.q, "dq": r.dq, "direction": direction, "gravity": gravity, "gravity * direction": gravity * direction,
        "input u": u, "place in session": np.full_like(r.q, warm), "warm * dq": warm * r.dq,
        "time in trial": np.repeat((r.t - r.t[0])[:, None], n, axis=1),
    }  # fmt: skip
    if r.temp is not None:
        out |= {"temperature": r.temp, "temp * dq": (r.temp - r.temp.mean()) * r.dq, "temp * direction": r.temp * direction}
    signals = {ErrorVariable(name): value for name, value in out.items()}
    for k, name in enumerate(model.joints):
        signals[ErrorVariable(f"q of {name}", k)] = np.repeat(r.q[:, k : k + 1], n, axis=1)
        signals[ErrorVariable(f"dq of {name}", k)] = np.repeat(r.dq[:, k : k + 1], n, axis=1)
    return signals


def _share(e: Array, x: Array) -> float:
    """Fraction of ``e``'s mean square that bin means of ``x`` take off on the stretches they were not computed from."""
    if len(e) < FEWEST or not np.ptp(x) > 0:
        return 0.0
    place = _places(x)
    fold = (np.arange(len(e)) // STRETCH) % 2
    left = 0.0
    for k in (0, 1):
        train = fold != k
        mean = _means(e[train], place[train])
        left += float(((e[~train] - mean[place[~train]]) ** 2).sum())
    # the constant is an offset, not a dependence: it is taken off first
    return max(0.0, 1.0 - left / max(float(((e - e.mean()) ** 2).sum()), 1e-30))
