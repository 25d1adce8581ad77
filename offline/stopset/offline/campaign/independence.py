"""Which recordings are independent: the motion is, the repetition and the later start of the same motion are not (P8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from stopset.offline.campaign.noise import spread
from stopset.recording import Recording, SuiteKey
from stopset.types import Array, Index

OVERLAP = 0.4  # of the shorter recording must be shared at least
FEWEST = 50  # samples, at least
# Torques are the same where they differ by no more than their noise one and a half times and a tenth of their variation: clocks differ by up
# to half a sample, drives by a few percent. Different motions of the arms measured differ by half their variation or more.
NOISES = 1.5
ALIKE = 0.1
VARIES = 2.0  # in noises: what hardly moves tells nothing
# Pieces of one recording: the next begins where the last one ended, in position and in speed, while the arm moves
SEAM = 0.25  # [s] that may be lost, or recorded twice, between pieces
FEWEST_JOINTS = 3  # of an arm whose state tells where in its motion it is
SEAM_ANGLE, SEAM_SPEED = 2e-3, 0.05  # [rad], [rad/s] besides a tenth of what the arm moved and a usual acceleration
SEAM_ACCELERATION = 10.0  # [rad/s^2]
READINGS = 5  # in a row that are the same to the last bit, each other than the one before: no arm repeats itself so
MOVING = 0.05  # [rad/s] slower, every trial that starts where the last one rested would be a piece


@dataclass(frozen=True, slots=True)
class Ends:
    """Where a suite begins and where it ends: ``t`` (2,) [s], ``q, dq`` (2, n)."""

    t: Array
    q: Array
    dq: Array

    @classmethod
    def of(cls, r: Recording) -> Ends:
        """Those of one trial."""
        return cls(r.t[[0, -1]].copy(), r.q[[0, -1]].copy(), r.dq[[0, -1]].copy())

    def until(self, later: Ends) -> Ends:
        """From the beginning of this trial to the end of a ``later`` one."""
        return Ends(*(np.stack([a[0], b[1]]) for a, b in ((self.t, later.t), (self.q, later.q), (self.dq, later.dq))))


def independent_motions(
    torques: Mapping[SuiteKey, Array], ends: Mapping[SuiteKey, Ends] = MappingProxyType({})
) -> dict[SuiteKey, int]:
    """Number of the motion each suite belongs to; ``torques``: suite -> (N, n) torque of one of its trials.

    Two suites are starts of one motion where the torques of one, from some sample on, are those of the other: so test suites
    are cut from a recorded motion (Liu & Althoff 2018, sec. V-B).  Every shift is tried; what cannot be told apart counts as
    one motion, which can only weaken what is promised.  Two suites are also one motion where one goes on where the other
    ended (``ends``), or begins with readings that the other holds: into how many pieces or files a recording was cut says nothing.
    """
    suites = list(torques)
    found = {s: s for s in suites}

    def head(s: SuiteKey) -> SuiteKey:
        while found[s] != s:
            s = found[s]
        return s

    signals = _Signals([torques[s] for s in suites])
    for i, a in enumerate(suites):
        for k in signals.alike(i):
            found[head(suites[k])] = head(a)
    pairs = [(suites[i], suites[k]) for i, k in _overlapping(list(torques.values()))] + _pieces(ends)
    for a, b in pairs:
        if a in found and b in found:
            found[head(b)] = head(a)
    numbers = {h: k for k, h in enumerate(dict.fromkeys(head(s) for s in suites))}
    return {s: numbers[head(s)] for s in suites}


def _overlapping(torques: Sequence[Array]) -> list[tuple[int, int]]:
    """Pairs of which the first holds the `READINGS` that the second begins with: pieces that were cut with an overlap."""
    heads = {k: x[:READINGS] for k, x in enumerate(torques) if len(x) >= READINGS}
    heads = {k: x for k, x in heads.items() if (np.diff(x, axis=0) != 0).any(axis=1).all()}
    if len(torques) < 2 or not heads:
        return []
    firsts: dict[bytes, list[int]] = {}
    for k, x in heads.items():
        firsts.setdefault(x[0].tobytes(), []).append(k)
    # a joint alone tells most samples apart
    joint = np.array([x[0, 0] for x in heads.values()])
    out = []
    for i, x in enumerate(torques):
        for at in np.flatnonzero(np.isin(x[:, 0], joint)):
            for k in firsts.get(x[at].tobytes(), ()):
                if k != i and np.array_equal(x[at : at + READINGS], heads[k]):
                    out.append((i, k))
    return out


def _pieces(ends: Mapping[SuiteKey, Ends]) -> list[tuple[SuiteKey, SuiteKey]]:
    """Pairs of which the second goes on where the first ended."""
    near = _near(list(ends.values()))
    suites = list(ends)
    return [(suites[i], suites[k]) for i, k in near if goes_on(ends[suites[i]], ends[suites[k]])]


def uncut(ends: Sequence[Ends]) -> list[int]:
    """Number of the recording that each trial is a piece of; pieces are those that go on where another one ended."""
    number = list(range(len(ends)))
    for i, k in _near(ends):
        if goes_on(ends[i], ends[k]) and number[i] != number[k]:
            number = [number[i] if x == number[k] else x for x in number]
    return number


def _near(ends: Sequence[Ends]) -> list[tuple[int, int]]:
    """Pairs worth a look: the second begins within what an arm can move in `SEAM` of where the first ended."""
    if len(ends) < 2:
        return []
    begins = np.array([e.q[0] for e in ends])
    fast = np.array([np.abs(e.dq).max() for e in ends])
    out = []
    for i, e in enumerate(ends):
        off = np.abs(begins - e.q[1]).max(axis=1)
        out += [(i, int(k)) for k in np.flatnonzero(off <= SEAM_ANGLE + 1.1 * SEAM * np.maximum(fast, fast[i])) if k != i]
    return out


def goes_on(a: Ends, b: Ends) -> bool:
    """Whether ``b`` begins where ``a`` ended: in position and speed under way, or at rest where the clock ran on."""
    jump, speed = b.q[0] - a.q[1], 0.5 * (a.dq[1] + b.dq[0])
    top = float(np.abs(speed).max())
    # the time lost between them that fits best
    seam = SEAM if len(jump) >= FEWEST_JOINTS else 0.0  # one or two joints meet by chance, sooner or later
    gap = float(np.clip(jump @ speed / max(float(speed @ speed), 1e-12), -seam, seam))
    off, turned = np.abs(jump - gap * speed).max(), np.abs(b.dq[0] - a.dq[1]).max()
    if off > SEAM_ANGLE + 0.1 * abs(gap) * top or turned > SEAM_SPEED + 0.1 * top + SEAM_ACCELERATION * abs(gap):
        return False
    # an arm at rest tells nothing, unless the clock ran on: a trial's own time begins at zero
    moving = min(float(np.abs(a.dq[1]).max()), float(np.abs(b.dq[0]).max())) > MOVING
    return bool(moving or (b.t[0] > 0 and abs(b.t[0] - a.t[1]) <= SEAM))


class _Signals:
    """Torques of all suites with what comparing them at every shift needs: spectra and running sums."""

    def __init__(self, torques: list[Array]) -> None:
        mean = np.mean(np.vstack([x.mean(axis=0) for x in torques]), axis=0)
        self.x = [x - mean for x in torques]
        self.size = next_fast_len(2 * max(len(x) for x in torques), real=True)
        self.spectrum = [rfft(x.T, self.size) for x in self.x]
        self.sums = [np.vstack([np.zeros(x.shape[1]), np.cumsum(x, axis=0)]) for x in self.x]
        self.squares = [np.concatenate([[0.0], np.cumsum((x**2).sum(axis=1))]) for x in self.x]
        self.noise = [float((spread(x) ** 2).sum()) for x in self.x]
        self.varies = [bool(x.var(axis=0).sum() > VARIES**2 * e) for x, e in zip(self.x, self.noise, strict=True)]

    def alike(self, i: int) -> list[int]:
        """Later suites whose torques are those of suite ``i``, shifted."""
        return [k for k in range(i + 1, len(self.x)) if self._same(i, k)]

    def _same(self, i: int, k: int) -> bool:
        a, b = len(self.x[i]), len(self.x[k])
        if not self.varies[i] and not self.varies[k]:
            return True
        shift, i0, k0, m = _overlaps(a, b)
        if not len(shift):
            return False
        product = irfft((self.spectrum[i] * self.spectrum[k].conj()).sum(axis=0), self.size)[shift]
        ours, theirs = self.squares[i][i0 + m] - self.squares[i][i0], self.squares[k][k0 + m] - self.squares[k][k0]
        distance = np.sqrt(np.maximum(ours + theirs - 2.0 * product, 0.0) / m)
        noise = np.sqrt(self.noise[i] + self.noise[k])
        # nothing varies by more than its size: most pairs are told apart by that already
        near = np.flatnonzero(distance <= NOISES * noise + ALIKE * np.sqrt(theirs / m))
        if not len(near):
            return False
        k0, m = k0[near], m[near]
        middle = ((self.sums[k][k0 + m] - self.sums[k][k0]) ** 2).sum(axis=1) / m
        varies = np.sqrt(np.maximum(theirs[near] - middle, 0.0) / m)
        same = distance[near] <= NOISES * noise + ALIKE * varies
        return bool(np.any(same & (varies > VARIES * noise) & (varies > 0)))


@lru_cache(maxsize=64)
def _overlaps(a: int, b: int) -> tuple[Index, Index, Index, Index]:
    """Every shift at which signals of lengths ``a`` and ``b`` share enough; where the shared part begins in each; its length."""
    least = max(FEWEST, round(OVERLAP * min(a, b)))
    # sample j of the second beside sample j + shift of the first
    shift = np.arange(least - b, a - least + 1 if min(a, b) >= least else least - b)
    i0, k0 = np.maximum(shift, 0), np.maximum(-shift, 0)
    return shift, i0, k0, np.minimum(a - i0, b - k0)
