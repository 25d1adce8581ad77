"""Envelope of measured deviations from the nominal prediction, per prediction age: all that the sets need to know.

One pass over the recordings and constant memory: a running maximum and minimum per age and state (a map-reduce, exact
and independent of order).  ``windows='sliding'`` restarts the prediction at every sample (trap P15: conformance from the
trial's start does not survive a restart); ``'start'`` predicts from the trial's first sample only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from stopset.artifact import Abstraction, ActiveBound
from stopset.errors import RecordingError
from stopset.offline.conform.windows import Outermost, update, update_decoupled
from stopset.reach.flowpipe import discretise
from stopset.recording import Recording
from stopset.types import Array, Index


@dataclass(slots=True)
class Envelope:
    """Running envelope: ``hi``, ``lo`` (H+1, 2k) of deviations at age ``k dt``; where each was reached; samples per age.

    Columns are positions and speeds of the joints (k = n), and of further directions across them where asked for.
    """

    dt: float
    hi: Array
    lo: Array
    hi_at: Index  # (H+1, 2k, 2) trial number (position in `labels`), start sample
    lo_at: Index
    count: Index  # (H+1,) number of windows that reach this age
    labels: list[str] = field(default_factory=list)

    @classmethod
    def empty(cls, dt: float, steps: int, states: int) -> Envelope:
        shape = (steps + 1, states)
        at = np.full((*shape, 2), -1, np.int64)
        return cls(dt, np.full(shape, -np.inf), np.full(shape, np.inf), at, at.copy(), np.zeros(steps + 1, np.int64))

    @property
    def steps(self) -> int:
        """Last age (in steps) that any window reached."""
        return int(np.flatnonzero(self.count)[-1])

    def merge(self, other: Envelope) -> Envelope:
        """Envelope of both parts; maxima are associative, so the order of merging does not matter."""
        out = self.upto(len(self.hi) - 1)
        out.absorb(other)
        return out

    def absorb(self, other: Envelope) -> None:
        """`merge` in place."""
        shift = np.array([len(self.labels), 0])
        for mine, theirs, mine_at, theirs_at, beyond in (
            (self.hi, other.hi, self.hi_at, other.hi_at, other.hi > self.hi),
            (self.lo, other.lo, self.lo_at, other.lo_at, other.lo < self.lo),
        ):
            mine[beyond], mine_at[beyond] = theirs[beyond], theirs_at[beyond] + shift
        self.count += other.count
        self.labels += other.labels

    def upto(self, steps: int) -> Envelope:
        """The same at ages up to ``steps``; ages that nothing reached are added where it is shorter."""
        out = Envelope.empty(self.dt, steps, self.hi.shape[1])
        m = min(steps, len(self.hi) - 1) + 1
        for name in ("hi", "lo", "hi_at", "lo_at", "count"):
            getattr(out, name)[:m] = getattr(self, name)[:m]
        out.labels = list(self.labels)
        return out

    def where(self, bound: str, age: int, state: int, side: str, names: Sequence[str]) -> ActiveBound:
        """Which recording and time put the envelope where it is at this age and state, ``names`` of which see `state_names`."""
        at = (self.hi_at if side == "hi" else self.lo_at)[age, state]
        label = self.labels[int(at[0])] if at[0] >= 0 else "noise alone"
        return ActiveBound(bound, label, float(at[1]) * self.dt, age * self.dt, names[state])


def state_names(joints: Sequence[str], directions: int) -> list[str]:
    """Names of an envelope's columns: positions, then speeds, of the joints and of further directions across them."""
    across = [*joints, *(f"direction {k + 1}" for k in range(directions - len(joints)))]
    return [f"{x}_{name}" for x in ("q", "dq") for name in across]


def step_residual(Ad: Array, Bd: Array, x: Array, u: Array) -> Array:
    """``x(k+1) - Ad x(k) - Bd u(k)``, (N-1, 2n): what one step of the nominal model leaves unexplained."""
    return np.ascontiguousarray(x[1:] - x[:-1] @ Ad.T - u[:-1] @ Bd.T)


class Deviations:
    """Deviations of one nominal model on one grid, trial by trial; ``windows`` as in the module's first lines.

    ``across``: (k, n) directions in the joints that are looked at, the joints themselves among them (None: only these).
    """

    def __init__(
        self, abstraction: Abstraction, dt: float, steps: int, windows: str = "sliding", across: Array | None = None
    ) -> None:
        self.dt, self.steps, self.windows = dt, steps, windows
        self._Ad, self._Bd = discretise(abstraction, dt)
        self.across = np.eye(abstraction.n) if across is None else np.ascontiguousarray(across)
        self._blocks: Array | None = None
        if abstraction.decoupled and across is None:
            pairs = [[j, abstraction.n + j] for j in range(abstraction.n)]
            self._blocks = np.ascontiguousarray(np.stack([self._Ad[np.ix_(p, p)] for p in pairs]))
        self.states = 2 * len(self.across)

    def empty(self) -> Envelope:
        return Envelope.empty(self.dt, self.steps, self.states)

    def add(self, env: Envelope, r: Recording, u: Array) -> None:
        """Widen ``env`` by a recording sampled on the grid and its input ``u`` (N, n) [N m].

        Raises `RecordingError` for a trial whose clock is not the grid's (resample it first).
        """
        off = float(np.abs(np.diff(r.t) - self.dt).max())
        if off > 0.05 * self.dt:
            raise RecordingError(
                f"{r.label}: a step of its clock differs from {self.dt} s by {off:.3g} s; resample it to the grid"
            )
        residual = step_residual(self._Ad, self._Bd, np.hstack([r.q, r.dq]), u)
        if not np.isfinite(residual).all():  # no maximum sees what is not a number
            raise RecordingError(
                f"{r.label}: the model's torque at {np.argwhere(~np.isfinite(residual))[0, 0] * self.dt:.3f} s is not finite; "
                "expected numbers: look for the effect or the signal that overflows there"
            )
        starts = len(residual) if self.windows == "sliding" else 1
        trial = len(env.labels)
        env.labels.append(r.label)
        worst = Outermost(env.hi, env.lo, env.hi_at, env.lo_at)
        if self._blocks is not None:
            update_decoupled(self._blocks, residual, starts, trial, worst)
        else:
            update(self._Ad, self.across, residual, starts, trial, worst)
        reach = min(self.steps, len(residual))
        ages = np.arange(1, reach + 1)
        env.count[1 : reach + 1] += np.minimum(starts, len(residual) - ages + 1)
        env.count[0] += starts
        env.hi[0], env.lo[0] = 0.0, 0.0

    def add_to(self, targets: Sequence[Envelope], r: Recording, u: Array) -> None:
        """`add` to several envelopes at once: the windows are the same, and where none is beyond any of them is not looked up."""
        if len(targets) == 1:
            self.add(targets[0], r, u)
            return
        one = self.empty()
        np.minimum.reduce([t.hi for t in targets], out=one.hi)
        np.maximum.reduce([t.lo for t in targets], out=one.lo)
        self.add(one, r, u)
        for t in targets:
            t.absorb(one)

    def of(self, r: Recording, u: Array) -> Envelope:
        """Envelope of one recording alone."""
        env = self.empty()
        self.add(env, r, u)
        return env
