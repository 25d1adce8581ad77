"""Play and bend of a gear, where a second encoder reads the angle behind it: there the link's torque jumps it from one flank to the other.

What the link lies off its motor is the gear's bend, in proportion to the link's torque; with play it is half the gap more, on the side
to which that torque pushes.  Beside both a constant, the encoders' once-per-turn errors, friction behind the gear and readings of
another moment are fitted.  A gear that is merely soft about zero bends smoothly there: where a smooth curve explains as much there is no
gap.  The motor's torque tells none of it: see docs/diagnosis.md.  The gear's stiffness is the link's torque over that bend, known no better than
the arm's masses tell that torque.

Source: Nordin & Gutman (2002), Controlling mechanical systems with backlash: a survey.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from stopset.effects import Effect, catalogue
from stopset.offline.diagnose import thresholds as limit
from stopset.offline.diagnose.answer import Parameter, Ranked
from stopset.offline.diagnose.evidence.uncertainty import TWO_SIDES
from stopset.offline.diagnose.explain.identifiable import Blind
from stopset.offline.diagnose.standing import moves
from stopset.offline.nominal.preprocess import Preprocessing, motions
from stopset.recording import Recordings
from stopset.robot import Robot
from stopset.robot.rigid import torques
from stopset.types import Array, Mask

UNREAD = "no angle behind the gear is recorded (q_link_<joint>), and motor torque does not show it"
ONE_SIDED = "the link's torque never changes its side, so it lies on one flank"
PART = 2.5  # [s] of a motion that may err alike
FEWEST = 4  # of these, from which on their scatter tells an error
SOFT = (0.3, 1.0)  # of the link's torque, root mean square, over which a soft gear may turn over
CROSSING = 2  # rows, of 0.05 s
STILL = 0.015  # [rad/s] below which a link's friction may point anywhere


@dataclass(frozen=True, slots=True)
class Plays:
    """What the second encoders say: gears with play, joints of which nothing could be said of it, and gears that bend."""

    ranked: tuple[Ranked, ...]
    blind: tuple[Blind, ...]
    bends: tuple[Ranked, ...] = ()

    def beside(self, named: Collection[str]) -> tuple[Ranked, ...]:
        """What is to be named with the labels that torque ``named``: of a gear that it told to swing the numbers are its own."""
        return (*self.ranked, *(r for r in self.bends if r.label not in named))


@dataclass(frozen=True, slots=True)
class _Behind:
    """Rows of one joint, (N,): ``x`` [rad] link minus motor angle, ``tau`` [N m] of the link, ``q, dq``; ``part``: what may err alike."""

    x: Array
    tau: Array
    q: Array
    dq: Array
    part: Array

    @property
    def two_sided(self) -> bool:
        return min(int((self.tau > 0).sum()), int((self.tau < 0).sum())) >= limit.PLAY_ROWS

    def columns(self, *more: Array) -> Array:
        fixed = (np.ones_like(self.x), np.sin(self.q), np.cos(self.q), self.dq, np.tanh(self.dq / STILL), self.tau)
        return np.stack([*fixed, *more], axis=1)


def plays(robot: Robot, recordings: Recordings) -> Plays:
    """Gears with play, and that bend, of joints whose angle behind the gear is recorded; ``robot``: whose rigid body tells the links' torques."""
    effect, swings = (next(e for e in catalogue().values() if e.role == role) for role in ("play", "swing"))
    unread, one_sided, ranked, bends = list[str](), list[str](), list[Ranked](), list[Ranked]()
    for j, rows in enumerate(_rows(robot, recordings)):
        joint = robot.joints[j]
        if rows is not None and (bend := _bend(swings, joint, rows)) is not None:
            bends.append(bend)
        if rows is None:
            unread.append(joint)
        elif not rows.two_sided:
            one_sided.append(joint)
        elif (found := _gap(effect, joint, rows)) is not None:
            ranked.append(found)
    reasons = ((UNREAD, unread), (ONE_SIDED, one_sided))
    return Plays(
        tuple(ranked),
        tuple(Blind(effect.name, tuple(where), why, effect.distinguished_by) for why, where in reasons if where),
        tuple(bends),
    )


def _rows(robot: Robot, recordings: Recordings) -> list[_Behind | None]:
    """Of every joint the rows at which its link's torque has a side; None where no angle behind the gear was recorded."""
    parts: list[list[Array]] = [[] for _ in robot.joints]
    for k, r in enumerate(recordings):
        if r.q_link is None or not moves(r):
            continue
        for m in motions(r, Preprocessing()):
            at = m.retained
            q, dq, ddq = (np.ascontiguousarray(x[at]) for x in (m.q, m.dq, m.ddq))
            link = torques(robot.chain, robot.pi, q, dq, ddq)
            part = 1e4 * k + np.floor(m.t[at] / PART)
            for j in range(robot.n):
                x = np.interp(m.t[at], r.t, r.q_link[:, j] - r.q[:, j])
                take = np.isfinite(x) & _bears(link[:, j])
                parts[j].append(np.stack([x, link[:, j], q[:, j], dq[:, j], part])[:, take])
    return [_sided(np.concatenate(p, axis=1)) if p and any(x.size for x in p) else None for p in parts]


def _bears(tau: Array) -> Mask:
    """Rows (N,) not next to one at which the link's torque ``tau`` changes its side: there it may still be on its way."""
    turned = np.concatenate([[False], np.diff(np.sign(tau)) != 0, [False]])
    window = np.ones(2 * (CROSSING + 1), int)
    near = np.convolve(turned.astype(int), window, mode="same") > 0
    return ~(near[:-1] | near[1:])


def _sided(rows: Array) -> _Behind:
    tau = rows[1]
    certain = np.abs(tau) > limit.PLAY_CROSSING * np.sqrt(np.mean(tau**2))
    return _Behind(*rows[:, certain])


def _bend(effect: Effect, joint: str, rows: _Behind) -> Ranked | None:
    """The stiffness of one joint's gear; None where it is not told to bend."""
    number, parts = np.unique(rows.part, return_inverse=True)
    if len(number) < FEWEST:
        return None
    # encoders err twice per turn, too, and gravity's torque has that period beside others
    errs = (np.sin(2 * rows.q), np.cos(2 * rows.q), *([-0.5 * np.sign(rows.tau)] if rows.two_sided else []))
    soft = rows.columns(*errs)
    at = rows.columns().shape[1] - 1  # the column of the link's torque
    stiff = np.delete(soft, at, axis=1)
    per, left = np.empty(len(number)), np.empty((2, len(rows.x)))
    for k in range(len(number)):
        out = parts == k
        for model, A in enumerate((stiff, soft)):
            theta = np.linalg.lstsq(A[~out], rows.x[~out], rcond=None)[0]
            left[model, out] = rows.x[out] - A[out] @ theta
        per[k] = -theta[at]
    bend = -float(np.linalg.lstsq(soft, rows.x, rcond=None)[0][at])  # [rad/(N m)]
    scatter = float(np.sqrt((len(per) - 1) * np.mean((per - per.mean()) ** 2)))
    before, after = (float(x) for x in np.sqrt(np.mean(left**2, axis=1)))
    stiffness, damping = effect.shapes
    if (
        bend < limit.PLAY_SURE * scatter
        or after > (1 - limit.PLAY_LOWERED) * before
        or 1 / bend < stiffness.lo  # how stiff a gear may be is no question: this one bends
    ):
        return None
    # what all parts err by alike: the description, and torque that is the motor's angle's, a bend apart from the link's
    alike = limit.PLAY_CROSSING / TWO_SIDES, bend * float(np.sqrt(np.mean(rows.tau**2)))
    std = float(np.linalg.norm([scatter / bend, *alike])) / bend
    numbers = {t.symbol: Parameter(t.typical, t.unit, None) for t in effect.terms}
    numbers |= {stiffness.symbol: Parameter(1 / bend, stiffness.unit, std)}
    numbers |= {damping.symbol: Parameter(damping.grid[0], damping.unit, None)}
    return Ranked(
        effect.name, (joint,), (bend / scatter) ** 2, before, after, numbers, "link minus motor angle over the link's torque", effect.says,
        unit="rad",
    )  # fmt: skip


def _gap(effect: Effect, joint: str, rows: _Behind) -> Ranked | None:
    """The claim of one joint; None where it has none."""
    number, parts = np.unique(rows.part, return_inverse=True)
    if len(number) < FEWEST:
        return None
    side, size = -0.5 * np.sign(rows.tau), float(np.sqrt(np.mean(rows.tau**2)))
    plain, wide = rows.columns(), rows.columns(side)
    soft = [rows.columns(-0.5 * np.tanh(rows.tau / (w * size))) for w in SOFT]
    gaps, left = np.empty(len(number)), np.empty((2 + len(soft), len(rows.x)))
    for k in range(len(number)):
        out = parts == k
        for model, A in enumerate((plain, wide, *soft)):
            theta = np.linalg.lstsq(A[~out], rows.x[~out], rcond=None)[0]
            left[model, out] = rows.x[out] - A[out] @ theta
            if model == 1:
                gaps[k] = theta[-1]
    bend, gap = np.linalg.lstsq(wide, rows.x, rcond=None)[0][-2:].tolist()
    jackknife = (len(gaps) - 1) * float(np.mean((gaps - gaps.mean()) ** 2))
    std = float(np.hypot(np.sqrt(jackknife), limit.PLAY_BEND * bend * size))  # what all parts err by alike is the description's
    before, after, *smooth = (float(x) for x in np.sqrt(np.mean(left**2, axis=1)))
    term = effect.terms[0]
    inside = term.lo - limit.SURE * std <= gap <= term.hi + limit.SURE * std
    if not inside or gap < limit.PLAY_SURE * std or after > (1 - limit.PLAY_LOWERED) * before or after > min(smooth):
        return None
    return Ranked(
        effect.name, (joint,), (gap / std) ** 2, before, after, {term.symbol: Parameter(gap, term.unit, std)}, effect.look_at, effect.says,
        unit="rad",
    )  # fmt: skip
