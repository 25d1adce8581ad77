"""Stops bred towards what a bound publishes: arms with several effects, any payload of a range wherever it sits, every category.

    python benchmarks/stops_attack.py [--cases 40] [--rounds 12] [--count 32] [--seed 1] [--model FILE ...] [--category 0 ...]

A case is drawn: an arm (`stop_arms_wide.py`) with one to three effects of `stops_effects.py`, or a model file; a range of payloads and where it
sits; a category with a ramp that works or fails; a state or a box of them. All that a stop may vary in is a row of numbers from 0 to 1: first
random ones, then ones bred from those that came nearest to any of the numbers, joint by joint. Where the arm is in space is told by kinematics
of its own here. Asked besides: that drives never give more for a ramp that works than they have. Prints what is contradicted (exit code 1), and
how near to the bounds the nearest came.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms_wide import arms
from stops_effects import COLD, PIECE, WARM, Batch, Laws, cases, misread_by
from stops_effects_published import ELSE, HELD, Asked, held, left_window, power_off, ramps, rests

from stop_failing import failing_shares
from stop_published import CHECKED, SHOWN, Places, Stopped, ramp_motion
from stop_sampling import DT, SPEED_ERROR
from stopset.artifact import Brakes, Model, load_model
from stopset.effects.base import REFERENCE_TEMPERATURE, Fitted
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
NO_BOUND = ("elasticity", "backlash", "coupled_wrist")  # effects with which no stop is bounded
LONGEST = 0.5  # [s] simulated after power-off: few stops last longer, some bounds do
CHANGED = 0.06  # of a bred stop's numbers


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


def armed(arm: Model, effects: Sequence[Fitted]) -> Model:
    """An arm of `stop_arms_wide` with effects; its disturbance and brakes known well, so that the effects are what matters."""
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
        arm, robot=arm.robot.with_parameters(pi), brakes=sharp, domain=domain, sets={"powered": own}, effects=(*friction, *effects)
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


def drawn(case: Case, genes: Genes, N: int) -> Batch:
    """Arms behind the measured states, at the ends of every interval."""
    model, s = case.model, case.bounds.setting
    assert s is not None and model.brakes is not None
    n, V, brakes, p = model.n, model.powered.V, model.brakes, s.payload

    def end(lo: Array, hi: Array, *shape: int) -> Array:
        return np.where(genes.integers(0, 2, (N, *shape)) > 0, hi, lo)

    q = case.q + case.radii[0] * genes.choice([-1.0, 1.0], (N, n)) - end(V.lo[:n], V.hi[:n], n)
    dq = case.dq + case.radii[1] * genes.choice([-1.0, 1.0], (N, n)) - end(V.lo[n:], V.hi[n:], n)
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
    off, share = misread_by(model, q, genes)  # type: ignore[arg-type]
    return replace(batch, q=q + off, dq=dq * (1.0 + share))


def stops(case: Case, b: StopBound, rows: Array) -> Iterator[tuple[Stopped, float]]:
    """The stop of each row, and by how much its ramp asks more of a drive than it has [N m]."""
    genes = Genes(rows[:, :OWN])
    batch = drawn(case, genes, len(rows))
    a, own = Asked(case.bounds, b, batch, genes), [Genes(r[None, OWN:]) for r in rows]  # type: ignore[arg-type]
    if b.category in ("1", "2"):
        yield from _ramped(case, a, own)
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
    qs, vs, hold = power_off(case.model, a, at, fast, min(float(said.max()), LONGEST))
    for k, (moved, slow) in enumerate(zip(before, pace, strict=True)):
        early = DT * np.arange(len(moved) - 1)
        t = np.r_[early, DT * (len(moved) - 1) + PIECE * np.arange(len(qs))]
        q, v = np.vstack([batch.q[k] + moved[:-1], qs[:, k]]), np.vstack([slow[: len(early)], vs[:, k]])
        yield Stopped(t, q, v, rests(t, v, SPEED_ERROR), hold[k]), -1.0


def _ramped(case: Case, a: Asked, own: Sequence[Genes]) -> Iterator[tuple[Stopped, float]]:
    """Ramps that work; of a STOP 2 the arm drifts out of its window, and power is taken."""
    ramp, batch, model = a.bounds.ramp, a.batch, case.model
    assert ramp is not None
    laws, crept, rows = Laws(model, batch, a.rng), batch.q.copy(), []
    side = np.array([g.choice([-1.0, 1.0], model.n) for g in own])
    for k, v in enumerate(batch.dq):
        t, moved, w = ramp_motion(ramp, v, own[k])  # type: ignore[arg-type]
        ended = rests(t, w, ramp.band)
        if a.b.category == "2":
            moved, w, t = np.vstack([moved, moved[-1] + ramp.window * side[k]]), np.vstack([w, w[-1]]), np.r_[t, t[-1]]
        crept[k] += moved[-1] + side[k] * ramp.creep * ramp.reaction
        rows.append((t, batch.q[k] + moved, w, ended))
    over = _asked_of_drives(case, a, ramp, own)
    hold = held(model, a, laws, np.array([q[-1] for _, q, *_ in rows]))
    left = left_window(model, a, ramp, (crept, side * ramp.creep), [q[-1] for _, q, *_ in rows])
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


def attacked(case: Case, rounds: int, count: int, rng: np.random.Generator) -> tuple[int, float, list[str]] | None:
    """How many stops, how near the nearest came to its angle, and what is contradicted; None where there is no number."""
    b = case.bounds.bound(case.q, case.dq, case.category, *case.radii)
    if b.time is None:
        return None
    assert case.bounds.setting is not None
    found, wrong, done = Nearest(), [], 0
    for k in range(rounds):
        rows = rng.random((count, GENES)) if k < max(1, rounds // 4) else found.breed(count, rng)
        scores = []
        for x, over in stops(case, b, rows):
            p = places(case.model.robot, case.bounds.setting.payload_com, x)
            scores.append(ratios(b, x, p))
            beyond = {name: check(b, x, p) - HELD.get(name, ELSE) for name, check in CHECKED.items()} | {"drives": over - 1e-6}
            wrong += [f"{case.name}: {name} by {e:.3g}" for name, e in beyond.items() if e > 0.0]
            done += 1
        found.learn(np.array(scores), rows)
    n = case.model.n  # speeds begin at their bound
    return done, float(found.score[n : 3 * n].max()), wrong


def case_of(model: Model, name: str, category: Category, rng: np.random.Generator) -> Case:
    """A state or a box of them, a range of payloads and their place, a ramp."""
    n, (lo, hi), d = model.n, model.domain.payload, model.domain
    drawn_masses = np.sort(rng.uniform(lo, hi, 2)), np.array([lo, hi]), np.full(2, rng.uniform(lo, hi))
    masses = drawn_masses[int(rng.choice(3, p=[0.5, 0.25, 0.25]))]
    weighing = any(f.effect == "payload" for f in model.effects)
    com = None if weighing or rng.random() < 0.4 else model.robot.tip + rng.uniform(-0.15, 0.15, 3)
    of = list(ramps(n).items()) if ramp_of(model) is None else [("recorded", ramp_of(model).failing(0.1))]  # type: ignore[union-attr]
    kind, ramp = of[int(rng.integers(len(of)))]
    if category == "1" and ramp.off_after is not None:
        ramp = replace(ramp, off_after=None)
    bounds = StopBounds.of(model, (float(masses[0]), float(masses[1])), com, ramp, pieces=1, fast=bool(rng.random() < 0.7))
    top = np.minimum(d.dq.hi, -d.dq.lo) * rng.choice([1.0, 0.6])
    boxed = rng.random() < 0.5
    radii = (np.full(n, 0.01 * boxed), np.full(n, 0.03 * boxed))
    q = rng.uniform(np.maximum(0.9 * d.q.lo, model.robot.q_limit[:, 0]), np.minimum(0.9 * d.q.hi, model.robot.q_limit[:, 1]))
    dq = np.clip(
        rng.uniform(-top, top) * rng.choice([1.0, 0.5, 0.05, 0.0], n, p=[0.5, 0.3, 0.1, 0.1]), radii[1] - top, top - radii[1]
    )
    masses_said = "" if hi == lo else f", {masses[0]:.3g} to {masses[1]:.3g} kg"
    return Case(f"{name}{masses_said}, STOP {category} ({kind}{', box' if boxed else ''})", bounds, category, q, dq, radii)


def an_arm(rng: np.random.Generator) -> tuple[str, Model]:
    """An arm with effects."""
    wide = [(k, m) for k, (m, _) in arms().items() if m.n >= 6]
    name, arm = wide[int(rng.choice(4) if rng.random() < 0.8 else rng.integers(len(wide)))]
    of = {k: v for k, v in cases(arm.joints).items() if v and k not in NO_BOUND and "+" not in k}
    picked = rng.choice(list(of), int(rng.integers(1, 4)), replace=False)
    return f"{name} with {' + '.join(picked)}", armed(arm, [f for k in picked for f in of[k]])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--count", type=int, default=32, help="stops of a round")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--model", type=Path, nargs="+", default=[], help="model files instead of drawn arms")
    parser.add_argument("--category", nargs="+", choices=CATEGORIES, default=CATEGORIES)
    given = parser.parse_args()
    if min(given.cases, given.rounds, given.count) < 1:
        parser.error("expected at least one case, one round and one stop: with none nothing is contradicted")
    files = [(f.name, load_model(f)) for f in given.model]
    total, asked, near, wrong, begun = 0, 0, [], [], time.process_time()
    for k in range(given.cases):
        rng = np.random.default_rng([given.seed, k])
        name, model = files[k % len(files)] if files else an_arm(rng)
        case = case_of(model, f"{k}: {name}", given.category[k % len(given.category)], rng)
        try:
            found = attacked(case, given.rounds, given.count, rng)
        except NotCovered as e:
            print(f"{case.name}: refused: {e}", flush=True)
            continue
        if found is None:
            continue
        asked, total, near = asked + 1, total + found[0], [*near, found[1]]
        wrong += found[2]
        print(f"{case.name}: {found[0]} stops, nearest {found[1]:.3f}, {len(found[2])} beyond", flush=True)
        for line in sorted(set(found[2]))[:6]:
            print(f"    {line}", flush=True)
    print(
        f"{given.cases} cases, {asked} with a number, {total} stops, {len(wrong)} numbers contradicted; nearest of each case to an angle, "
        f"median and most: {np.median(near or [0.0]):.3f}, {max(near, default=0.0):.3f}; {time.process_time() - begun:.0f} s of processor time"
    )
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
