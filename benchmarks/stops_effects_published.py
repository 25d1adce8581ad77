"""Every number that a stop bound publishes of arms with effects, in every category: STOP 0, ramps that fail (SS1-t, SS1-r), ramps that work,
and the STOP 0 after a left standstill window.

As `stops_effects.py` hides every effect in a stopped arm and asks its tube alone, this asks each number of the bound (`tests/stop_published.py`).

    python benchmarks/stops_effects_published.py --states 20 --stops 10 [--effect spring] [--seed 1]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms import prbt_like
from stops_effects import COLD, PIECE, STEPS, TOP, WARM, Batch, Laws, cases, drawn, hiding, misread_by

from stop_failing import failing_shares
from stop_published import CHECKED, Stopped, places, ramp_motion
from stop_sampling import DT, SPEED_ERROR
from stopset.artifact import Model
from stopset.effects.base import Fitted
from stopset.errors import NotCovered
from stopset.reach.stops import CATEGORIES, Ramp, StopBound, StopBounds
from stopset.robot.rigid import gravity_torque
from stopset.sets import Box
from stopset.simulation.stop import StoppingArm, simulate_stops
from stopset.types import Array

# of each number beyond what `stop_published` allows for the simulation: an effect's torque is held over a piece
HELD: dict[str, float] = {"time": PIECE, "speed": 3 * SPEED_ERROR, "holding_margin": 1e-6, "fallback": PIECE} | dict.fromkeys(
    ("tcp_speed", "link_speed", "directed_speed", "speed_towards"), 6e-3
)
ELSE = 1e-5  # [rad], [m]


def ramps(n: int) -> dict[str, Ramp]:
    """Ramps that work and fail, joints with delays of their own, tracked with errors, of motions that change their speed."""
    stated = replace(
        Ramp.stated(n, time=0.3), value=Box.of(np.full(n, 0.28), np.full(n, 0.32)), control=Box.of(np.full(n, 0.01), np.linspace(0.015, 0.04, n)),
        q_error=np.full(n, 2e-3), dq_error=np.full(n, 0.04), settle=0.1, pace=(-0.5, 0.5), off_after=0.12,
    )  # fmt: skip
    braked = replace(stated, kind="deceleration", value=Box.of(np.full(n, 2.5), np.full(n, 3.2)))
    return {
        "SS1-t": stated,
        "SS1-r": replace(stated, monitored=True, off_after=None),
        "SS1-r, deceleration": replace(braked, monitored=True, off_after=None),
        "SS1-t, drives accelerate": replace(stated, share=1.3, off_after=0.08),
    }


@dataclass(frozen=True)
class Asked:
    """A bound of a box of measured states, and arms behind its corners."""

    bounds: StopBounds
    b: StopBound
    batch: Batch
    rng: np.random.Generator


def power_off(model: Model, a: Asked, q: Array, dq: Array, seconds: float) -> tuple[Array, Array, Array]:
    """Angles and speeds (K, N, n) every `PIECE` from power-off at ``q, dq`` (N, n), and what holds the arms in the end (N, n) [N m]."""
    laws, b, chain = Laws(model, a.batch, a.rng), a.batch, model.robot.chain
    here, v, acc = q.copy(), dq.copy(), np.zeros_like(q)
    rotor, none = np.tile(model.rotor, (len(q), 1)), np.zeros_like(q)
    count = int(np.ceil(seconds / PIECE)) + 2
    out = np.empty((2, count + 1, *q.shape))
    for k in range(count + 1):
        out[0, k], out[1, k] = here, v
        share = np.clip((k * PIECE - b.delay) / b.rise, 0.0, 1.0)
        dry, push = laws(here, v, acc, share * b.brake)
        u = b.u[:, min(4 * k // (count + 1), 3)] + push
        arms = StoppingArm(chain, b.pi, rotor, dry, none, b.brake, b.delay - k * PIECE, b.rise)
        x, w = simulate_stops(arms, here, v, PIECE / STEPS, STEPS, u[:, None])
        here, acc, v = x[:, -1], (w[:, -1] - v) / PIECE, w[:, -1]
    return out[0], out[1], held(model, a, laws, here)


def held(model: Model, a: Asked, laws: Laws, q: Array) -> Array:
    """(N, n) [N m] what brakes and dry friction hold of arms at rest more than gravity, effects and U ask."""
    still, b, U = np.zeros_like(q), a.batch, model.powered.U
    dry, push = laws(q, still, still, b.brake)
    g = np.array([gravity_torque(model.robot.chain, pi, x) for pi, x in zip(b.pi, q, strict=True)]) - push
    return np.asarray(b.brake + dry - np.maximum(np.abs(g - U.lo), np.abs(g - U.hi)))


def rests(t: Array, v: Array, band: Array | float) -> Array:
    """(n,) [s] from which on each joint stays slower than ``band``."""
    moves = np.abs(v) > band
    return np.asarray(t[np.where(moves.any(axis=0), len(t) - 1 - np.argmax(moves[::-1], axis=0), 0)])


def left_window(
    model: Model, a: Asked, ramp: Ramp, begin: tuple[Array, Array], ended: Sequence[Array]
) -> list[tuple[float, float] | None]:
    """Of arms that drift out of a STOP 2's window: how far [rad] from where their ramps ``ended`` (N, n) they get, and how long [s] it takes;
    ``begin``: where and how fast they are as power is taken, (N, n) each. None each of other stops."""
    if a.b.category != "2" or a.b.fallback is None:
        return [None] * len(ended)
    qs, vs, _ = power_off(model, a, *begin, a.b.fallback[1])
    gone = PIECE * np.arange(len(qs))
    return [
        (float(np.abs(qs[:, k] - q).max()), float(ramp.reaction + rests(gone, vs[:, k], SPEED_ERROR).max()))
        for k, q in enumerate(ended)
    ]


def stops(model: Model, a: Asked) -> Iterator[Stopped]:
    """One stop of each arm of the batch."""
    ramp, q0, v0, n = a.bounds.ramp, a.batch.q, a.batch.dq, model.n
    assert ramp is not None and a.b.time is not None
    before = [np.zeros((1, n))] * len(q0)
    pace = [v[None] for v in v0]
    if a.b.category == "1 guaranteed":
        shares = [failing_shares(ramp, v, a.rng) for v in v0]
        pace = [s * v for s, v in zip(shares, v0, strict=True)]
        before = [np.vstack([np.zeros(n), np.cumsum(x * DT, axis=0)]) for x in pace]
    elif a.b.category != "0":
        yield from _ramped(model, a)
        return
    at, fast = q0 + np.array([x[-1] for x in before]), np.array([x[-1] for x in pace])
    qs, vs, hold = power_off(model, a, at, fast, float(a.b.time.max()))
    for k, (moved, slow) in enumerate(zip(before, pace, strict=True)):
        early = DT * np.arange(len(moved) - 1)
        t = np.r_[early, DT * (len(moved) - 1) + PIECE * np.arange(len(qs))]
        q, v = np.vstack([q0[k] + moved[:-1], qs[:, k]]), np.vstack([slow[: len(early)], vs[:, k]])
        yield Stopped(t, q, v, rests(t, v, SPEED_ERROR), hold[k])


def _ramped(model: Model, a: Asked) -> Iterator[Stopped]:
    """Ramps that work; of a STOP 2 the arm drifts out of its window, and power is taken."""
    ramp, q0, v0 = a.bounds.ramp, a.batch.q, a.batch.dq
    assert ramp is not None
    laws, rows, crept = Laws(model, a.batch, a.rng), [], q0.copy()
    side = a.rng.choice([-1.0, 1.0], q0.shape)
    for k, v in enumerate(v0):
        t, moved, w = ramp_motion(ramp, v, a.rng)
        ended = rests(t, w, ramp.band)
        if a.b.category == "2":
            moved, w, t = np.vstack([moved, moved[-1] + ramp.window * side[k]]), np.vstack([w, w[-1]]), np.r_[t, t[-1]]
        crept[k] += moved[-1] + side[k] * ramp.creep * ramp.reaction
        rows.append((t, q0[k] + moved, w, ended))
    hold = held(model, a, laws, np.array([q[-1] for _, q, *_ in rows]))
    left = left_window(model, a, ramp, (crept, side * ramp.creep), [q[-1] for _, q, *_ in rows])
    for k, (t, q, w, ended) in enumerate(rows):
        yield Stopped(t, q, w, ended, hold[k], left[k])


def contradicted(a: Asked, x: Stopped) -> dict[str, float]:
    """By how much the stop goes beyond which numbers."""
    assert a.bounds.setting is not None
    p = places(a.bounds.model.robot, a.bounds.setting.payload_com, x)
    over = {name: check(a.b, x, p) - HELD.get(name, ELSE) for name, check in CHECKED.items()}
    return {name: e for name, e in over.items() if e > 0.0}


def run(effects: Sequence[Fitted], states: int, count: int, seed: int, *, blind: bool = False) -> tuple[int, int, list[str]]:
    """How many bounds, how many stops, and what was contradicted, of an arm with ``effects``; ``blind``: by bounds that do not know them."""
    model, rng, known = hiding(effects), np.random.default_rng(seed), hiding(() if blind else effects)
    n, bounded, done, wrong = model.n, 0, 0, list[str]()
    asked = [(c, name, ramp) for name, ramp in ramps(n).items() for c in (CATEGORIES if name == "SS1-t" else ("1 guaranteed",))]
    ready = {name: StopBounds.of(known, (0.0, model.domain.payload[1]), ramp=ramp, fast=True) for name, ramp in ramps(n).items()}
    ready["works"] = replace(
        ready["SS1-t"], ramp=replace(ramps(n)["SS1-t"], off_after=None)
    )  # power stays on until the arm rests
    for k in range(states):
        category, name, _ = asked[k % len(asked)]
        q, dq = (
            rng.uniform(-2.2, 2.2, n),
            rng.uniform(-TOP, TOP, n) * rng.choice([1.0, 0.5, 0.05, 0.0], n, p=[0.3, 0.4, 0.2, 0.1]),
        )
        radii = (np.full(n, 0.01), np.full(n, 0.03)) if k % 2 else (np.zeros(n), np.zeros(n))
        dq = np.clip(dq, radii[1] - TOP, TOP - radii[1])
        bounds = ready["works" if category == "1" else name]
        b = bounds.bound(q, dq, category, *radii)
        if b.time is None:
            continue
        bounded += 1
        corner = [np.tile(x, (count, 1)) + r * rng.choice([-1.0, 1.0], (count, n)) for x, r in zip((q, dq), radii, strict=True)]
        batch = drawn(model, *corner, bounds.setting.payload_com, rng)  # type: ignore[union-attr]
        off, share = misread_by(model, batch.q, rng)
        a = Asked(bounds, b, replace(batch, q=batch.q + off, dq=batch.dq * (1.0 + share)), rng)
        for x in stops(model, a):
            done += 1
            wrong += [f"STOP {category}, {name}: {key} by {e:.3g}" for key, e in contradicted(a, x).items()]
    return bounded, done, wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=21)
    parser.add_argument("--stops", type=int, default=12, help="of each state")
    parser.add_argument("--effect", choices=cases(prbt_like().joints), metavar="CASE", help="only this case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--blind", action="store_true", help="the bound does not know the effect: stops must contradict it")
    given = parser.parse_args()
    if given.states < 1 or given.stops < 1:
        parser.error("expected at least one state and one stop: with none nothing is contradicted")
    total = beyond = 0
    for name, effects in cases(prbt_like().joints).items():
        if given.effect not in (None, name):
            continue
        begun = time.process_time()
        try:
            bounded, done, wrong = run(effects, given.states, given.stops, given.seed, blind=given.blind)
        except NotCovered as e:
            print(f"{name}: refused: {e}", flush=True)
            continue
        total, beyond = total + done, beyond + len(wrong)
        print(
            f"{name}: {bounded} of {given.states} bounded, {done} stops, {len(wrong)} beyond, {time.process_time() - begun:.1f} s",
            flush=True,
        )
        for line in sorted(set(wrong))[:8]:
            print(f"    {line}", flush=True)
    print(f"{total} stops, {beyond} numbers contradicted; drives between {COLD:g} and {WARM:g} K of the reference")


if __name__ == "__main__":
    main()
