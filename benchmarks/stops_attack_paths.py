"""Stops along a path bred towards what a bound publishes: arms with several effects, recorded paths and few rows, ramps that begin early or late.

    python benchmarks/stops_attack_paths.py [--cases 40] [--rounds 6] [--count 24] [--seed 1] [--effect NAME ...] [--kept FILE [--seconds 150]]

As `stops_attack.py` does of poses. A case is drawn: an arm with one to three effects, a payload's range, a path (through a few rows, a joint
lowered past where gravity asks most of it, or as recorded: many rows, unevenly apart, rounded), a state of it, a ramp that begins between two
times of a motion that changes its speed; and drives hardly strong enough for a bound, or stronger. Each sampled arm is led where it reads the
path to be, its readings wrong by what effects and noise allow; from when its ramp begins it brakes as hard as its own drives let it, or, where
it is told less of itself, as hard as another arm's would too. That is integrated in time here, and shares nothing with the grid of `path.c`.
Asked besides the numbers: that drives can follow at all, and slow down. Prints what is contradicted (exit code 1). With ``--kept`` cases are
done in pieces of ``--seconds``, each of numbers of its own; exit code 3: not done yet.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from stops_attack import (
    OWN,
    Case,
    Found,
    Genes,
    Misread,
    an_arm,
    bred,
    campaign,
    drawn,
    payload_range,
    with_campaign,
)
from stops_effects import PIECE, Batch, Laws
from stops_effects_published import Asked, held, rests

from stop_published import NOT_ALONG_A_PATH, RINGING, Stopped
from stopset.artifact import Model
from stopset.effects import catalogue
from stopset.errors import NotCovered
from stopset.reach.stops import Ramp, StopBounds
from stopset.reach.stops.path import Path, PathStop, path_stop
from stopset.reach.stops.payload import largest_gravity
from stopset.reach.stops.ramp import drive_limit
from stopset.robot.rigid import torques
from stopset.sets import Box
from stopset.types import Array

LONGEST = 4.0  # [s] simulated from the request on
HALVINGS = 9  # of the search for the weakest drives with a bound
SEARCHED = 7  # halvings to where friction is as large as the gear's load makes it
BESIDE = 1e-5  # [rad] from where a reading's slope is told


@dataclass(frozen=True)
class PathCase:
    """A stop of ``path`` from row ``begin`` at ``rate`` [1/s]."""

    name: str
    bounds: StopBounds
    path: Path
    begin: float
    rate: float

    def asked(self) -> PathStop:
        return path_stop(self.bounds, self.path, self.begin, self.rate)

    @property
    def state(self) -> Case:
        """As it is measured at the request."""
        at = np.array([self.begin])
        q, dq = self.path.p(at, 0)[0], self.rate * self.path.p(at, 1)[0]
        none = np.zeros(len(q))
        return Case(self.name, self.bounds, "1", q, dq, (none, none))


@dataclass(frozen=True)
class Led:
    """Arms (N) on a path: where they read it to be and where they are."""

    path: Path
    misread: Misread
    noise: Array  # (N, n) [rad] constant, of the reading

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """(N, n) each: true angles at ``s`` (N,), first and second slopes."""
        s = np.minimum(s, self.path.length)
        q, first, second = (self.path.p(s, k) for k in range(3))
        off, share = self.misread(q)
        bend = (self.misread(q + BESIDE)[1] - self.misread(q - BESIDE)[1]) / (2.0 * BESIDE)
        return q + off + self.noise, (1.0 + share) * first, (1.0 + share) * second + bend * first**2


@dataclass(frozen=True)
class Drives:
    """What arms need of their drives: (N, n) torque per deceleration of the path, and what they need besides [N m]."""

    per: Array
    rest: Array
    limit: Array

    def decelerations(self) -> tuple[Array, Array]:
        """(N,) the least and the largest ``s''`` that all drives can give."""
        slope = np.where(np.abs(self.per) < 1e-12, 1e-12, self.per)
        ends = np.array([(side * self.limit - self.rest) / slope for side in (-1.0, 1.0)])
        return ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)

    def over(self, u: Array) -> Array:
        """(N,) [N m] what ``u`` (N,) asks of a drive more than it has."""
        return np.asarray((np.abs(self.per * u[:, None] + self.rest) - self.limit).max(axis=1))


def needed(model: Model, batch: Batch, laws: Laws, place: tuple[Array, Array, Array], w: Array, u: Array, part: int) -> Drives:
    """At true places and slopes, passed at ``w`` (N,); ``u``: (N,) the deceleration a moment ago, for friction that grows with the gear's load."""
    q, first, second = place
    v, bend = first * w[:, None], second * w[:, None] ** 2
    dry, push = laws(q, v, first * u[:, None] + bend, np.zeros_like(q))
    rest, per = np.empty_like(q), np.empty_like(q)
    for pi in np.unique(batch.pi, axis=0):
        k = np.all(batch.pi == pi, axis=(1, 2))
        rest[k] = torques(model.robot.chain, pi, q[k], v[k], bend[k])
        per[k] = torques(model.robot.chain, pi, q[k], v[k], bend[k] + first[k]) - rest[k]
    rest += model.rotor * bend + dry * np.sign(v) - push - batch.u[:, part]
    return Drives(per + model.rotor * first, rest, drive_limit(model))


def hardest(asks: Callable[[Array], Drives], before: Array, by_load: bool) -> tuple[Drives, Array, Array]:
    """What arms ask of their drives, and the least and the largest (N,) deceleration that these can give; where friction grows with what a gear
    bears, ``by_load``, both where that friction is."""
    drives = asks(before)
    lo, hi = drives.decelerations()
    if not by_load:
        return drives, lo, hi
    mild, hard = np.zeros_like(before), asks(0.0 * before).decelerations()[0]
    for _ in range(SEARCHED):
        middle = 0.5 * (mild + hard)
        able = asks(middle).over(middle) <= 0.0
        mild, hard = np.where(able, middle, mild), np.where(able, hard, middle)
    drives = asks(mild)
    return drives, mild, drives.decelerations()[1]


def braked(case: PathCase, batch: Batch, laws: Laws, led: Led, own: Genes, seconds: float) -> tuple[Array, Array, Array, Array]:
    """Times (K,), places and rates (K, N) every `PIECE` until all rest; and (N,) [N m] what drives lacked. The batch's second half is what
    arms of the first are told that they are; who is told nothing brakes as hard as it can."""
    ramp, N = case.bounds.ramp, len(batch.q) // 2
    assert ramp is not None
    late = own.choice(
        [float(ramp.control.lo.min()), float(ramp.control.hi.max()), 0.5 * float(ramp.control.lo.min() + ramp.control.hi.max())],
        N,
    )
    late = np.where(
        own.random(N) < 0.5, late, ramp.control.lo.min() + own.random(N) * (ramp.control.hi.max() - ramp.control.lo.min())
    )
    pace, told, lack = own.choice([*ramp.pace, 0.0], N), own.random(N) < 0.7, np.full(N, -np.inf)
    s, w, u = np.full(N, case.begin), np.full(N, case.rate), np.zeros(N)
    kept = [(s, w)]
    by_load = any("load" in effect.needs for effect, *_ in laws.rows)
    for k in range(int(min(seconds, LONGEST) / PIECE)):
        t = (k + 1) * PIECE
        run = np.minimum(PIECE, np.maximum(t - late, 0.0))  # of this moment, how much the ramp has
        free = PIECE - run
        s, w = s + free * np.maximum(w + 0.5 * free * case.rate * pace, 0.0), np.maximum(w + free * case.rate * pace, 0.0)
        if np.any(run > 0.0):
            twice = [np.tile(x, 2) for x in (s, w, u)]
            where = led.at(twice[0])

            def asks(now: Array, k: int = min(int(4 * t / seconds), 3)) -> Drives:
                return needed(case.bounds.model, batch, laws, where, twice[1], now, k)  # noqa: B023

            drives, lo, hi = hardest(asks, twice[2], by_load)
            mine, other = lo[:N], np.where(told, lo[N:], -np.inf)
            u = np.maximum(mine, other)
            on = (run > 0.0) & (w > 0.0)
            stuck = on & ((mine > hi[:N]) | (u >= 0.0))
            lack = np.where(
                stuck, np.maximum(lack, drives.over(np.tile(np.where(mine > hi[:N], 0.5 * (mine + hi[:N]), 0.0), 2))[:N]), lack
            )
            u = np.where(on, np.minimum(u, 0.0), 0.0)
            last = np.maximum(w + run * u, 0.0)
            run = np.where(u < 0.0, np.minimum(run, w / np.maximum(-u, 1e-12)), run)
            s, w = s + np.where(on, 0.5 * run * (w + last), 0.0), np.where(on, last, w)
        kept.append((s, w))
        if np.all(w <= 0.0):
            break
    places, rates = (np.array([x[j] for x in kept]) for j in range(2))
    return PIECE * np.arange(len(kept)), places, rates, lack


def stops(case: PathCase, b: PathStop, rows: Array) -> Iterator[tuple[Stopped, float]]:
    """The stop of each row, and what its drives lack [N m]."""
    model, ramp, N, said = case.bounds.model, case.bounds.ramp, len(rows), b.bound.time
    assert ramp is not None and said is not None
    genes = Genes(np.tile(rows[:, :OWN], (2, 1)) + np.repeat([[0.0], [0.5]], N, axis=0))
    genes.rows %= 1.0
    d, own, V = drawn(case.state, genes, 2 * N), Genes(rows[:, OWN:]), case.state.sets.V
    batch, misread = d.batch, d.misread
    side = own.choice([-1.0, 1.0], (N, model.n))
    noise = np.tile(np.where(side > 0, -V.lo[: model.n], -V.hi[: model.n]), (2, 1))
    laws, led = Laws(model, batch, genes), Led(case.path, misread, noise)  # type: ignore[arg-type]
    over = float(said.max()) + 0.1
    t, s, w, lack = braked(case, batch, laws, led, own, over)
    alone = replace(batch, **{k: getattr(batch, k)[:N] for k in Batch.__dataclass_fields__})
    mine = Led(case.path, misread.first(N), noise[:N])
    end = mine.at(s[-1])[0]
    a = Asked(case.bounds, b.bound, alone, genes)  # type: ignore[arg-type]
    hold = held(model, a, Laws(model, alone, Genes(rows[:, :OWN])), end)  # type: ignore[arg-type]
    off = np.minimum(ramp.q_error, ramp.dq_error / RINGING) * own.choice([-1.0, 1.0], (N, model.n))
    settle = ramp.after or 0.0
    extra = np.arange(1, int(settle / PIECE) + 2) * PIECE
    t = np.r_[t, t[-1] + extra]
    s, w = np.vstack([s, np.tile(s[-1], (len(extra), 1))]), np.vstack([w, np.tile(0.0 * w[-1], (len(extra), 1))])
    for k in range(N):
        only = Led(case.path, misread.one(k, len(t)), np.tile(noise[k], (len(t), 1)))
        q, first, _ = only.at(s[:, k])
        stopped = t[np.argmax(w[:, k] <= 0.0)] + 0.9 * settle
        until = np.minimum(t, stopped)[:, None]
        share = 1.0 + only.misread(case.path.p(s[:, k], 0))[1]  # errors of the tracking are of what is read
        ring = RINGING * np.cos(RINGING * until) * (t[:, None] < stopped)
        q, v = q + share * off[k] * np.sin(RINGING * until), first * w[:, k : k + 1] + share * off[k] * ring
        yield Stopped(t, q, v, rests(t, v, ramp.band), hold[k]), float(lack[k])


def attacked(case: PathCase, rounds: int, count: int, rng: np.random.Generator) -> Found | None:
    """None where there is no number."""
    stop = case.asked()
    if stop.bound.time is None:
        return None

    def sampled(rows: Array) -> Iterator[tuple[Stopped, float]]:
        return stops(case, stop, rows)

    return bred(case.state, stop.bound, sampled, (rounds, count), rng, NOT_ALONG_A_PATH)


# ---- cases --------------------------------------------------------------------------------------------------------------------


def a_path(model: Model, rng: np.random.Generator) -> tuple[str, Path]:
    """A few rows, a joint that gravity loads lowered, or as recorded."""
    n, kind = model.n, ("few rows", "lowered", "recorded")[int(rng.integers(3))]
    begin = rng.uniform(-1.2, 1.2, n)
    if kind == "lowered":
        joint = int(rng.integers(1, min(n, 4)))
        ends = np.tile(begin, (2, 1))
        ends[:, joint] += np.array([-0.9, 0.9]) * rng.choice([-1.0, 1.0])
        ends[1] += rng.uniform(-0.1, 0.1, n)
        return kind, Path.through(ends)
    rows = np.cumsum(np.vstack([begin, rng.uniform(-0.5, 0.5, (int(rng.integers(2, 6)), n))]), axis=0)
    rows = np.clip(rows, -2.6, 2.6)
    if kind == "few rows":
        return kind, Path.through(rows)
    smooth, count = Path.through(rows), int(rng.choice([30, 100, 400]))
    at = np.sort(rng.uniform(0.0, smooth.length, count)) if rng.random() < 0.5 else np.linspace(0.0, smooth.length, count)
    digits = rng.choice([1e-3, 1e-4, 1e-5])
    dense = np.round(smooth.p(at, 0) / digits) * digits
    moved = np.r_[True, np.any(np.diff(dense, axis=0) != 0.0, axis=1)]
    return f"{kind}, {int(moved.sum())} rows to {digits:g} rad", Path.through(dense[moved])


def a_ramp(n: int, rng: np.random.Generator) -> Ramp:
    late = float(rng.choice([0.01, 0.05, 0.2, 0.4]))
    early = late * float(rng.choice([0.0, 0.0, 0.5, 1.0]))
    stated = Ramp.stated(n, time=0.3, control=late)
    tracked = rng.random() < 0.5
    pace = ((0.0, 0.0), (-0.5, 0.5), (-3.0, 0.5), (-6.0, 0.0), (0.0, 2.0))[int(rng.integers(5))]
    return replace(
        stated, control=Box.of(np.full(n, early), np.full(n, late)), pace=pace, settle=0.1,
        q_error=np.full(n, 2e-3 * tracked), dq_error=np.full(n, 0.04 * tracked),
    )  # fmt: skip


def weakest(made: Callable[[float], PathCase]) -> float | None:
    """The least share of some drives with which there is a bound; None where there is none at all."""

    def certified(share: float) -> bool:
        try:
            return made(share).asked().bound.time is not None
        except NotCovered:
            return False

    lo, hi = 0.0, 8.0
    if not certified(hi):
        return None
    for _ in range(HALVINGS):
        middle = 0.5 * (lo + hi)
        lo, hi = (lo, middle) if certified(middle) else (middle, hi)
    return hi


def a_case(k: int, rng: np.random.Generator, wanted: Sequence[str]) -> PathCase | None:
    """None where no drives lead to a bound."""
    name, arm = an_arm(rng, wanted)
    lo, hi, com = payload_range(arm, rng)
    kind, path = a_path(arm, rng)
    ramp = a_ramp(arm.n, rng)
    begin = float(rng.uniform(0.0, 0.4)) * path.length
    top = np.minimum(arm.domain.dq.hi, arm.robot.dq_limit)
    ahead = (
        np.abs(path.p(np.linspace(begin, path.length, 200), 1)) if rng.random() < 0.7 else np.abs(path.p(np.array([begin]), 1))
    )
    rate = float(rng.choice([0.9, 0.5, 0.2]) * np.min(top / np.maximum(ahead.max(axis=0), 1e-9)))
    rate /= 1.0 + max(0.0, *ramp.pace) * float(ramp.control.hi.max())
    base = (largest_gravity(arm, hi, arm.robot.tip) + 5.0) * rng.uniform(0.7, 2.0, arm.n)

    def made(share: float) -> PathCase:
        model = replace(arm, robot=replace(arm.robot, torque_limit=share * base))
        bounds = StopBounds.of(model, (lo, hi), com, ramp)
        return PathCase(
            f"{k}: {name}, {lo:.3g} to {hi:.3g} kg, {kind}, ramp from {ramp.control.lo[0]:g} to {ramp.control.hi[0]:g} s",
            bounds,
            path,
            begin,
            rate,
        )

    least = weakest(made)
    return None if least is None else made(least * float(rng.choice([1.0, 1.0, 1.05, 1.5])))


def one(k: int, given: argparse.Namespace) -> tuple[str, Found | None]:
    rng = np.random.default_rng([given.seed, k])
    try:
        case = a_case(k, rng, given.effect)
    except NotCovered as e:
        return f"{k}: refused: {e}", None
    if case is None:
        return f"{k}: no drives lead to a bound", None
    return case.name, attacked(case, given.rounds, given.count, rng)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    with_campaign(parser, cases=40, rounds=6, count=24).add_argument(
        "--effect", nargs="+", default=[], help="arms have one of these"
    )
    given = parser.parse_args()
    if unknown := sorted(set(given.effect) - set(catalogue())):
        parser.error(f"--effect {unknown[0]}: no such effect; expected some of {', '.join(catalogue())}")
    return campaign(given, lambda k: one(k, given))


if __name__ == "__main__":
    sys.exit(main())
