"""Stops bred towards what a bound publishes: arms with several effects, any payload of a range wherever it sits, every category.

    python benchmarks/stops_attack.py [--cases 40] [--rounds 12] [--count 32] [--seed 1] [--model FILE ...] [--category 0 ...]
                                      [--effect NAME ...] [--kept FILE [--seconds 150]]

A case is drawn: an arm (`stop_arms_wide.py`) with one to three effects of `stops_effects.py`, or a model file; a range of payloads and where it
sits; a category with a ramp that works or fails; a state or a box of them. Half of the arms have sets of recorded stops: readings that are wrong
when power is taken, and speeds that drives change while it goes (`X0`). Where a ramp works, half of the arms have drives hardly strong enough for
a number. All that a stop may vary in is a row of numbers from 0 to 1: first random ones, then ones bred from those that came nearest to any of
the numbers, joint by joint. Where the arm is in space is told by kinematics of its own here. Asked besides: that drives never give more for a ramp
that works than they have. Prints what is contradicted (exit code 1), and how near to the bounds the nearest came. With ``--kept`` cases are done
in pieces of ``--seconds``: the file holds what was found, and every case draws numbers of its own, so pieces give what one run gives; exit code
3: not done yet. Stops along a path: `stops_attack_paths.py`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms_wide import arms
from stops_effects import COLD, PIECE, WARM, Batch, Laws, cases
from stops_effects_published import ELSE, HELD, Asked, held, left_window, power_off, ramps, rests

from stop_failing import failing_shares
from stop_published import CHECKED, SHOWN, Places, Stopped, ramp_motion
from stop_sampling import DT, SPEED_ERROR
from stopset.artifact import Brakes, Model, UncertaintySets, load_model
from stopset.effects import catalogue
from stopset.effects.base import REFERENCE_TEMPERATURE, Fitted, Signals
from stopset.effects.registry import get
from stopset.errors import NotCovered
from stopset.reach.stops import CATEGORIES, Category, Ramp, StopBound, StopBounds
from stopset.reach.stops.ramp import drive_limit, ramp_of
from stopset.robot import Robot
from stopset.robot.rigid import torques
from stopset.sets import Box
from stopset.types import Array
from synthetic import with_payload

GENES, OWN = 700, 350  # numbers of a stop; from which on they are those of its ramp
NO_BOUND = ("elasticity", "backlash", "coupled_wrist", "opposed_wrist")  # effects with which no stop is bounded
LONGEST = 0.5  # [s] simulated after power-off: few stops last longer, some bounds do
CHANGED = 0.06  # of a bred stop's numbers
HALVINGS = 7  # of the search for the weakest drives with a number
ROOT = Path(__file__).resolve().parents[1]


class Genes:
    """In place of a random generator: what it draws for rows (N, k) of numbers in [0, 1), one stop each, is the rows'."""

    def __init__(self, rows: Array) -> None:
        self.rows, self.used = rows, 0

    def _next(self, size: Any) -> Array:
        N = len(self.rows)
        shape = () if size is None else tuple(np.atleast_1d(size).tolist())
        of_each = shape[1:] if shape[:1] == (N,) and N > 1 else shape
        count = int(np.prod(of_each))
        at = (self.used + np.arange(count)) % self.rows.shape[1]
        self.used += count
        out = self.rows[:, at].reshape(N, *of_each)
        return np.asarray(out[0] if N == 1 else out)

    def random(self, size: Any = None) -> Any:
        return self._next(size)

    def uniform(self, lo: Any, hi: Any, size: Any = None) -> Any:
        return lo + (hi - lo) * self._next(size)

    def integers(self, lo: int, hi: int, size: Any = None) -> Any:
        out = lo + np.floor((hi - lo) * self._next(size)).astype(int)
        return int(out) if out.ndim == 0 else out

    def choice(self, of: Sequence[float], size: Any = None, p: Sequence[float] | None = None) -> Any:
        edges = np.cumsum(np.full(len(of), 1.0 / len(of)) if p is None else p)
        return np.asarray(of)[np.minimum(np.searchsorted(edges, self._next(size), side="right"), len(of) - 1)]


def frames(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Orientations (S, n, 3, 3) and origins (S, n, 3) of the links at ``q`` (S, n), joint by joint."""
    chain = robot.chain
    R, o = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    turned, origins = [], []
    for i in range(robot.n):
        o = o + np.einsum("sij,j->si", R, chain.p[i])
        x, y, z = chain.axis[i] / np.linalg.norm(chain.axis[i])
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        s, c = np.sin(q[:, i])[:, None, None], np.cos(q[:, i])[:, None, None]
        R = R @ chain.R[i] @ (np.eye(3) + s * K + (1.0 - c) * (K @ K))
        turned.append(R)
        origins.append(o)
    return np.stack(turned, axis=1), np.stack(origins, axis=1)


def places(robot: Robot, tool: Array, x: Stopped) -> Places:
    """As `stop_published.places`, by `frames`."""
    n = robot.n
    at = np.unique(np.r_[np.linspace(0, len(x.t) - 1, SHOWN).astype(int), np.argmax(np.abs(x.v), axis=0)])
    R, o = frames(robot, x.q[at])
    tips = [robot.chain.p[i + 1] if i + 1 < n else robot.tip for i in range(n)]
    ends = np.stack([o[:, i] + R[:, i] @ tips[i] for i in range(n)], axis=1)
    at_tool = o[:, -1] + R[:, -1] @ tool
    spin = np.stack([(R[:, i] @ robot.chain.axis[i]) * x.v[at][:, i : i + 1] for i in range(n)], axis=1)

    def speed(p: Array, last: int) -> Array:
        return np.asarray(sum(np.cross(spin[:, i], p - o[:, i]) for i in range(last + 1)))

    own = robot.arm.capsules
    axes = np.stack([np.stack([o[:, i] + R[:, i] @ own[i, c : c + 3] for i in range(n)], axis=1) for c in (0, 3)], axis=2)
    return Places(
        at_tool, speed(at_tool, n - 1), ends, np.stack([speed(ends[:, i], i) for i in range(n)], axis=1), axes, own[:, 6]
    )


class Misread:
    """By what the readings of ``N`` arms are wrong, wherever they are: parameters drawn once."""

    def __init__(self, model: Model, genes: Genes, N: int) -> None:
        self.rows = []
        for f in model.effects:
            effect = get(f.effect)
            if effect.role == "reading" and effect.reading is not None:
                values = [f.values[t.symbol] + f.std[t.symbol] * genes.uniform(-3.0, 3.0, N) for t in effect.terms]
                self.rows.append((effect.reading, model.joints.index(str(f.joint)), values))

    def first(self, N: int) -> Misread:
        """Of the first arms alone."""
        return self._of(lambda x: x[:N])

    def one(self, k: int, times: int) -> Misread:
        """Of one arm, at many of its places."""
        return self._of(lambda x: np.full(times, x[k]))

    def _of(self, taken: Callable[[Array], Array]) -> Misread:
        out = Misread.__new__(Misread)
        out.rows = [(reading, i, [taken(x) for x in values]) for reading, i, values in self.rows]
        return out

    def __call__(self, read: Array) -> tuple[Array, Array]:
        """True less ``read`` angles (N, n), and speed per speed."""
        out = np.zeros_like(read), np.zeros_like(read)
        for reading, i, values in self.rows:
            for total, each in zip(out, reading(Signals(q=read[:, i]), {}), strict=True):
                for x, c in zip(values, each, strict=True):
                    total[:, i] += c * x
        return out


def armed(arm: Model, effects: Sequence[Fitted], residual: Array | None = None) -> Model:
    """An arm of `stop_arms_wide` with effects; its disturbance and brakes known well, so that the effects are what matters. ``residual`` (2n,): with
    sets of recorded stops that start off by so much."""
    n, brakes = arm.n, arm.brakes
    assert brakes is not None
    pi = arm.robot.pi.copy()
    for f in effects:
        if f.effect == "payload":
            pi[-1] += [f.values[t.symbol] for t in get("payload").terms]
    torque, late = brakes.torque.centre, brakes.delay.hi
    sharp = Brakes(Box.of(0.97 * torque, 1.03 * torque), Box.of(0.9 * late, late), Box.of(0.9 * late, late), "assumed")
    temp = Box.of(np.full(n, REFERENCE_TEMPERATURE + COLD), np.full(n, REFERENCE_TEMPERATURE + WARM))
    own = replace(arm.powered, U=Box.symmetric(0.15 * arm.powered.U.hi))
    friction = tuple(replace(f, std={k: 0.03 * v for k, v in f.values.items()}) for f in arm.effects)
    domain = replace(arm.domain, q=Box.symmetric(np.full(n, 2.9)), temp=temp)
    return replace(
        arm, robot=arm.robot.with_parameters(pi), brakes=sharp, domain=domain, effects=(*friction, *effects),
        sets={"powered": own} | ({} if residual is None else {"stop0": replace(own, X0=Box(-0.6 * residual, residual))}),
    )  # fmt: skip


@dataclass(frozen=True)
class Case:
    """What a bound is asked for: masses ``payload`` [kg], a measured state and by how much others of its box differ, (n,) each."""

    name: str
    bounds: StopBounds
    category: Category
    q: Array
    dq: Array
    radii: tuple[Array, Array]

    @property
    def model(self) -> Model:
        return self.bounds.model

    def asked(self) -> StopBound:
        return self.bounds.bound(self.q, self.dq, self.category, *self.radii)

    @property
    def sets(self) -> UncertaintySets:
        return self.model.sets.get("stop0", self.model.powered)


@dataclass(frozen=True)
class Drawn:
    """Arms; the angles and speeds (N, n) that they are led by, which they read without noise; and by what these are wrong."""

    batch: Batch
    read: Array
    pace: Array
    misread: Misread


def _end(genes: Genes, lo: Array, hi: Array, N: int, *shape: int) -> Array:
    return np.where(genes.integers(0, 2, (N, *shape)) > 0, hi, lo)


def residual(case: Case, genes: Genes, N: int) -> Array:
    """(N, n) [rad/s] what drives change the speeds by while their power goes."""
    n, X0 = case.model.n, case.sets.X0
    return _end(genes, X0.lo[n:], X0.hi[n:], N, n) if "stop0" in case.model.sets else np.zeros((N, n))


def drawn(case: Case, genes: Genes, N: int) -> Drawn:
    """Arms behind the measured states, at the ends of every interval."""
    model, s = case.model, case.bounds.setting
    assert s is not None and model.brakes is not None
    n, V, brakes, p = model.n, case.sets.V, model.brakes, s.payload
    off = Box(-V.hi, -V.lo) if case.category != "0" or "stop0" not in model.sets else case.sets.X0

    def end(lo: Array, hi: Array, *shape: int) -> Array:
        return _end(genes, lo, hi, N, *shape)

    q = case.q + case.radii[0] * genes.choice([-1.0, 1.0], (N, n)) + end(off.lo[:n], off.hi[:n], n)
    dq = case.dq + case.radii[1] * genes.choice([-1.0, 1.0], (N, n)) + end(off.lo[n:], off.hi[n:], n)
    one = with_payload(model.robot, 1.0, s.payload_com).pi - model.robot.pi
    load = genes.choice(p, N)[:, None, None]
    t = model.domain.temp
    temp = np.full((N, n), REFERENCE_TEMPERATURE) if t is None else end(t.lo, t.hi, n)
    U = model.powered.U
    batch = Batch(
        q, dq, model.robot.pi + load * one, end(brakes.torque.lo, brakes.torque.hi, n), end(brakes.delay.lo, brakes.delay.hi, n),
        end(brakes.rise.lo, brakes.rise.hi, n), end(U.lo, U.hi, 4, n), end(np.full(n, 0.75), np.full(n, 1.25), n), temp,
        genes.integers(0, 2, N).astype(float),
    )  # fmt: skip
    misread = Misread(model, genes, N)
    wrong, share = misread(q)
    return Drawn(replace(batch, q=q + wrong, dq=dq * (1.0 + share)), q, dq, misread)


def stops(case: Case, b: StopBound, rows: Array) -> Iterator[tuple[Stopped, float]]:
    """The stop of each row, and by how much its ramp asks more of a drive than it has [N m]."""
    genes = Genes(rows[:, :OWN])
    d = drawn(case, genes, len(rows))
    batch, shed = d.batch, residual(case, genes, len(rows))
    a, own = Asked(case.bounds, b, batch, genes), [Genes(r[None, OWN:]) for r in rows]  # type: ignore[arg-type]
    if b.category in ("1", "2"):
        yield from _ramped(case, a, d, shed, own)
        return
    ramp, n, said = case.bounds.ramp, case.model.n, b.time
    assert said is not None
    before, pace = [np.zeros((1, n))] * len(rows), [v[None] for v in batch.dq]
    if b.category == "1 guaranteed":
        assert ramp is not None
        shares = [failing_shares(ramp, v, g) for v, g in zip(batch.dq, own, strict=True)]  # type: ignore[arg-type]
        pace = [s * v for s, v in zip(shares, batch.dq, strict=True)]
        before = [np.vstack([np.zeros(n), np.cumsum(x * DT, axis=0)]) for x in pace]
    at, fast = batch.q + np.array([x[-1] for x in before]), np.array([x[-1] for x in pace])
    if b.category == "1 guaranteed":
        fast = fast + shed
    qs, vs, hold = power_off(case.model, a, at, fast, min(float(said.max()), LONGEST))
    for k, (moved, slow) in enumerate(zip(before, pace, strict=True)):
        early = DT * np.arange(len(moved) - 1)
        t = np.r_[early, DT * (len(moved) - 1) + PIECE * np.arange(len(qs))]
        q, v = np.vstack([batch.q[k] + moved[:-1], qs[:, k]]), np.vstack([slow[: len(early)], vs[:, k]])
        yield Stopped(t, q, v, rests(t, v, SPEED_ERROR), hold[k]), -1.0


def _ramped(case: Case, a: Asked, d: Drawn, shed: Array, own: Sequence[Genes]) -> Iterator[tuple[Stopped, float]]:
    """Ramps that work, of what arms read; of a STOP 2 the arm drifts out of its window, and power is taken."""
    ramp, batch, model = a.bounds.ramp, a.batch, case.model
    assert ramp is not None
    laws, crept, rows = Laws(model, batch, a.rng), batch.q.copy(), []
    side = np.array([g.choice([-1.0, 1.0], model.n) for g in own])
    for k, v in enumerate(d.pace):
        t, moved, w = ramp_motion(ramp, v, own[k])  # type: ignore[arg-type]
        wrong, share = d.misread.one(k, len(t))(d.read[k] + moved)
        moved, w = moved + wrong - wrong[0], w * (1.0 + share)
        ended = rests(t, w, ramp.band)
        if a.b.category == "2":
            moved, w, t = np.vstack([moved, moved[-1] + ramp.window * side[k]]), np.vstack([w, w[-1]]), np.r_[t, t[-1]]
        crept[k] += moved[-1] + side[k] * ramp.creep * ramp.reaction
        rows.append((t, batch.q[k] + moved, w, ended))
    over = _asked_of_drives(case, a, ramp, own)
    hold = held(model, a, laws, np.array([q[-1] for _, q, *_ in rows]))
    left = left_window(model, a, ramp, (crept, side * ramp.creep + shed), [q[-1] for _, q, *_ in rows])
    for k, (t, q, w, ended) in enumerate(rows):
        yield Stopped(t, q, w, ended, hold[k], left[k]), float(over[k])


def _asked_of_drives(case: Case, a: Asked, ramp: Ramp, own: Sequence[Genes]) -> Array:
    """(N,) [N m] what the ramp itself, all joints at once, asks of a drive more than it has."""
    model, batch = case.model, a.batch
    laws, limit, out = Laws(model, batch, a.rng), drive_limit(model), np.full(len(own), -np.inf)
    plain = replace(ramp, q_error=0.0 * ramp.q_error, dq_error=0.0 * ramp.dq_error, pace=(0.0, 0.0))
    ways = [ramp_motion(plain, v, g) for v, g in zip(batch.dq, own, strict=True)]  # type: ignore[arg-type]
    for share in (0.1, 0.35, 0.6, 0.85):
        at = [int(share * (len(t) - 1)) for t, *_ in ways]
        q = batch.q + np.array([d[i] for (_, d, _), i in zip(ways, at, strict=True)])
        v = np.array([w[i] for (*_, w), i in zip(ways, at, strict=True)])
        acc = np.array([(w[i] - w[i - 1]) / DT for (*_, w), i in zip(ways, at, strict=True)])
        dry, push = laws(q, v, acc, np.zeros_like(q))
        rigid = np.array(
            [torques(model.robot.chain, pi, *x) for pi, *x in zip(batch.pi, q[:, None], v[:, None], acc[:, None], strict=True)]
        )
        asked = rigid[:, 0] + model.rotor * acc + dry * np.sign(v) - push - batch.u[:, 0]
        out = np.maximum(out, (np.abs(asked) - limit).max(axis=1))
    return out


def ratios(b: StopBound, x: Stopped, p: Places) -> Array:
    """How near the stop came to each of the numbers, joint by joint: 1 is the bound."""
    d = x.q - x.q[0]
    found = [x.rests, d.max(axis=0), -d.min(axis=0), np.abs(x.v).max(axis=0)]
    found += [[np.linalg.norm(p.tool - p.tool[0], axis=1).max(), np.linalg.norm(p.tool_speed, axis=1).max()]]
    found += [np.linalg.norm(p.ends - p.ends[0], axis=2).max(axis=0), np.linalg.norm(p.end_speed, axis=2).max(axis=0)]
    said = [b.time, b.forward, b.back, b.speed, [b.tcp, b.tcp_speed], b.links, b.link_speed]
    if b.fallback is not None and x.left is not None:
        found, said = [*found, list(x.left)], [*said, list(b.fallback)]
    bound = np.concatenate([np.asarray(y, float) for y in said])
    return np.asarray(np.concatenate(found) / np.maximum(bound, 2e-3))


class Nearest:
    """Of each number the rows that came nearest to it; more are bred from these."""

    def __init__(self) -> None:
        self.score, self.rows = np.zeros(0), np.zeros((0, GENES))

    def learn(self, scores: Array, rows: Array) -> None:
        if not len(self.score):
            self.score, self.rows = np.full(scores.shape[1], -np.inf), np.zeros((scores.shape[1], GENES))
        best = np.argmax(scores, axis=0)
        top = scores[best, np.arange(scores.shape[1])]
        better = top > self.score
        self.score[better], self.rows[better] = top[better], rows[best[better]]

    def breed(self, count: int, rng: np.random.Generator) -> Array:
        kin = self.rows[rng.integers(0, len(self.rows), (2, count))]
        mixed = np.where((rng.random((count, 1)) < 0.5) & (rng.random((count, GENES)) < 0.3), kin[1], kin[0])
        return np.where(
            rng.random((count, GENES)) < rng.choice([CHANGED, 0.3 * CHANGED], (count, 1)), rng.random((count, GENES)), mixed
        )


@dataclass(frozen=True)
class Found:
    """How many stops, how near the nearest came to its angle, and what is contradicted."""

    stops: int
    nearest: float
    wrong: tuple[str, ...]


def bred(
    case: Case, b: StopBound, sampled: Callable[[Array], Iterator[tuple[Stopped, float]]], many: tuple[int, int], rng: np.random.Generator,
    without: set[str] = frozenset(),  # type: ignore[assignment]
) -> Found:  # fmt: skip
    """What ``sampled`` gives for rows of numbers, rounds and stops of each as in ``many``, bred towards the bound."""
    assert case.bounds.setting is not None
    (rounds, count), nearest, wrong, done = many, Nearest(), list[str](), 0
    for k in range(rounds):
        rows = rng.random((count, GENES)) if k < max(1, rounds // 4) else nearest.breed(count, rng)
        scores = []
        for x, over in sampled(rows):
            p = places(case.model.robot, case.bounds.setting.payload_com, x)
            scores.append(ratios(b, x, p))
            beyond = {name: check(b, x, p) - HELD.get(name, ELSE) for name, check in CHECKED.items() if name not in without}
            wrong += [f"{name} by {e:.3g}" for name, e in (beyond | {"drives": over - 1e-6}).items() if e > 0.0]
            done += 1
        nearest.learn(np.array(scores), rows)
    n = case.model.n  # speeds begin at their bound
    return Found(done, float(nearest.score[n : 3 * n].max()), tuple(wrong))


def attacked(case: Case, rounds: int, count: int, rng: np.random.Generator) -> Found | None:
    """None where there is no number."""
    b = case.asked()
    return None if b.time is None else bred(case, b, lambda rows: stops(case, b, rows), (rounds, count), rng)


def hardly_strong(case: Case, rng: np.random.Generator) -> Case:
    """The arm with other drives, the weakest of some with which there is a number."""
    s, model = case.bounds.setting, case.model
    assert s is not None
    base = rng.uniform(0.7, 2.0, model.n) * (5.0 + s.torques.gear)

    def made(share: float) -> Case:
        robot = replace(model.robot, torque_limit=share * base)
        return replace(
            case,
            bounds=replace(case.bounds, model=replace(model, robot=robot), setting=replace(s, model=replace(model, robot=robot))),
        )

    lo, hi = 0.0, 8.0
    if case.category not in ("1", "2") or made(hi).asked().time is None:
        return case
    for _ in range(HALVINGS):
        middle = 0.5 * (lo + hi)
        lo, hi = (middle, hi) if made(middle).asked().time is None else (lo, middle)
    return replace(made(hi), name=f"{case.name}, drives hardly strong enough")


def payload_range(model: Model, rng: np.random.Generator) -> tuple[float, float, Array | None]:
    """Masses [kg], and where they sit in the last link, None: as the model says."""
    lo, hi = model.domain.payload
    masses = (np.sort(rng.uniform(lo, hi, 2)), np.array([lo, hi]), np.full(2, rng.uniform(lo, hi)))[
        int(rng.choice(3, p=[0.5, 0.25, 0.25]))
    ]
    weighing = any(f.effect == "payload" for f in model.effects)
    com = None if weighing or rng.random() < 0.4 else model.robot.tip + rng.uniform(-0.15, 0.15, 3)
    return float(masses[0]), float(masses[1]), com


def case_of(model: Model, name: str, category: Category, rng: np.random.Generator) -> Case:
    """A state or a box of them, a range of payloads and their place, a ramp."""
    n, d = model.n, model.domain
    lightest, heaviest, com = payload_range(model, rng)
    of = list(ramps(n).items()) if ramp_of(model) is None else [("recorded", ramp_of(model).failing(0.1))]  # type: ignore[union-attr]
    kind, ramp = of[int(rng.integers(len(of)))]
    if category == "1" and ramp.off_after is not None:
        ramp = replace(ramp, off_after=None)
    bounds = StopBounds.of(model, (lightest, heaviest), com, ramp, pieces=1, fast=bool(rng.random() < 0.7))
    top = np.minimum(d.dq.hi, -d.dq.lo) * rng.choice([1.0, 0.6])
    boxed = rng.random() < 0.5
    radii = (np.full(n, 0.01 * boxed), np.full(n, 0.03 * boxed))
    q = rng.uniform(np.maximum(0.9 * d.q.lo, model.robot.q_limit[:, 0]), np.minimum(0.9 * d.q.hi, model.robot.q_limit[:, 1]))
    dq = np.clip(
        rng.uniform(-top, top) * rng.choice([1.0, 0.5, 0.05, 0.0], n, p=[0.5, 0.3, 0.1, 0.1]), radii[1] - top, top - radii[1]
    )
    said = "" if d.payload[0] == d.payload[1] else f", {lightest:.3g} to {heaviest:.3g} kg"
    said += ", readings of recorded stops" if "stop0" in model.sets else ""
    case = Case(f"{name}{said}, STOP {category} ({kind}{', box' if boxed else ''})", bounds, category, q, dq, radii)
    return hardly_strong(case, rng) if rng.random() < 0.5 else case


def an_arm(rng: np.random.Generator, wanted: Sequence[str] = ()) -> tuple[str, Model]:
    """An arm with effects, with one of the ``wanted`` where there are any."""
    wide = [(k, m) for k, (m, _) in arms().items() if m.n >= 6]
    name, arm = wide[int(rng.choice(4) if rng.random() < 0.8 else rng.integers(len(wide)))]
    of = {k: v for k, v in cases(arm.joints).items() if v and k not in NO_BOUND and "+" not in k}
    picked = rng.choice(list(of), int(rng.integers(1, 4)), replace=False)
    if wanted:
        picked = np.unique([*picked[1:], rng.choice(wanted)])
    off = rng.uniform(0.0, 1.0, 2 * arm.n) * np.repeat([4e-3, 0.05], arm.n)
    return f"{name} with {' + '.join(picked)}", armed(
        arm, [f for k in picked for f in of[k]], off if rng.random() < 0.5 else None
    )


def with_campaign(parser: argparse.ArgumentParser, *, cases: int, rounds: int, count: int) -> argparse.ArgumentParser:
    """With what a run of many cases is told."""
    parser.add_argument("--cases", type=int, default=cases)
    parser.add_argument("--rounds", type=int, default=rounds)
    parser.add_argument("--count", type=int, default=count, help="stops of a round")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kept", type=Path, metavar="FILE", help="go on with what this file holds")
    parser.add_argument("--seconds", type=float, default=np.inf, help="of this piece")
    return parser


def code() -> str:
    """Of which bounds and attack are made."""
    files = [
        *ROOT.glob("model/**/*.py"),
        *ROOT.glob("model/**/*.[ch]"),
        *ROOT.glob("benchmarks/stop*.py"),
        *ROOT.glob("tests/stop_*.py"),
    ]
    return hashlib.sha256(b"".join(f.read_bytes() for f in sorted(files))).hexdigest()[:16]


def campaign(given: argparse.Namespace, one: Callable[[int], tuple[str, Found | None]]) -> int:
    """Every case, its name and what was found; the exit code."""
    if min(given.cases, given.rounds, given.count) < 1:
        raise SystemExit("expected at least one case, one round and one stop: with none nothing is contradicted")
    wanted = {"seed": given.seed, "rounds": given.rounds, "count": given.count, "code": code()}
    wanted["asked"] = {k: str(v) for k, v in vars(given).items() if k not in (*wanted, "cases", "kept", "seconds")}
    results: dict[str, Any] = {**wanted, "cases": {}}
    if given.kept and given.kept.exists():
        results = json.loads(given.kept.read_text())
        if before := {key: results[key] for key in wanted if results[key] != wanted[key]}:
            raise SystemExit(f"{given.kept} holds {before}; expected { {key: wanted[key] for key in before} }: name another file")
    until, begun = time.monotonic() + given.seconds, time.process_time()
    for k in range(given.cases):
        if str(k) in results["cases"]:
            continue
        if time.monotonic() > until:
            print(f"{len(results['cases'])} of {given.cases} cases done", flush=True)
            return 3
        name, found = one(k)
        results["cases"][str(k)] = {"name": name, "found": None if found is None else asdict(found)}
        said = "no number" if found is None else f"{found.stops} stops, nearest {found.nearest:.3f}, {len(found.wrong)} beyond"
        print(f"{name}: {said}", *sorted(set(found.wrong if found else ()))[:6], sep="\n    ", flush=True)
        if given.kept:
            half = given.kept.with_suffix(".half")
            half.write_text(json.dumps(results) + "\n")
            half.replace(given.kept)
    every = [x["found"] for k, x in results["cases"].items() if int(k) < given.cases and x["found"]]
    wrong, near = sum(len(x["wrong"]) for x in every), [x["nearest"] for x in every] or [0.0]
    print(
        f"{given.cases} cases, {len(every)} with a number, {sum(x['stops'] for x in every)} stops, {wrong} numbers contradicted; nearest of each "
        f"case to an angle, median and most: {np.median(near):.3f}, {max(near):.3f}; {time.process_time() - begun:.0f} s of processor time"
    )
    return int(wrong > 0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with_campaign(parser, cases=40, rounds=12, count=32)
    parser.add_argument("--model", type=Path, nargs="+", default=[], help="model files instead of drawn arms")
    parser.add_argument("--category", nargs="+", choices=CATEGORIES, default=CATEGORIES)
    parser.add_argument("--effect", nargs="+", default=[], help="arms have one of these")
    given = parser.parse_args()
    if unknown := sorted(set(given.effect) - set(catalogue())):
        parser.error(f"--effect {unknown[0]}: no such effect; expected some of {', '.join(catalogue())}")
    files = [(f.name, load_model(f)) for f in given.model]

    def one(k: int) -> tuple[str, Found | None]:
        rng = np.random.default_rng([given.seed, k])
        name, model = files[k % len(files)] if files else an_arm(rng, given.effect)
        case = None
        try:
            case = case_of(model, f"{k}: {name}", given.category[k % len(given.category)], rng)
            return case.name, attacked(case, given.rounds, given.count, rng)
        except NotCovered as e:
            return f"{k}: {name if case is None else case.name}: refused: {e}", None

    return campaign(given, one)


if __name__ == "__main__":
    sys.exit(main())
