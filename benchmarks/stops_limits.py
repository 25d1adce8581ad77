"""What limits the tight certificate on an arm with strong coupling: shares of states that one tube closes, with each interval in turn
replaced by its middle.

    python benchmarks/stops_limits.py [--states 60] [--arm NAME [--share 0.3]] [--far | --cuts]

UR5-like arm with a quarter of the rotor inertia, 4.75 to 5 kg, random states up to 2 rad/s; or an arm of `stop_arms_wide` with its
rated payload, up to a share of its full speed.  ``--far``: instead how far the tubes with the kinetic energy go, median angle over the
worst of 60 sampled stops of the same intervals, and over the tubes as stated; brakes cut together too.  ``--cuts``: how far they go
over the tube as stated where each interval of the brakes in turn, or the most harmful ones, are cut and every piece is bounded.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms import ur5_like
from stop_arms_wide import arms

from stop_sampling import sample_stops
from stopset.reach.stops import StopBounds
from stopset.reach.stops.parts import ALL_PARTS
from stopset.reach.stops.setting import Setting
from stopset.reach.stops.split import halves, harm_of
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Plant, Stride, march
from stopset.reach.stops.tubes import ENERGY_KNOTS, KNOTS, Knots, expected_stop, march_box, tubes_of
from stopset.reach.stops.windows import windows
from stopset.sets import Box
from stopset.types import Array

TOP = 2.0
STOPS = 60  # sampled for each tube
TOGETHER = 2e-3  # [s] by which the delays of brakes lie apart that one power stage cuts


def known(plant: Plant, *names: str) -> Plant:
    """The plant with these intervals as points."""
    points = {}
    for name in names:
        middle = 0.5 * (getattr(plant, f"{name}_lo") + getattr(plant, f"{name}_hi"))
        points[f"{name}_lo"], points[f"{name}_hi"] = middle, middle
    return plant._replace(**points)


Case = tuple[list[Plant], float, int]  # plants that together hold the arm, share of the start's uncertainty, times as many steps


def cases(p: Plant, lag: Array | None) -> dict[str, Case]:
    """The plant with each interval in turn as a point."""
    return {
        "as stated": ([p], 1.0, 1),
        "time steps a quarter as long": ([p], 1.0, 4),
        "payload known": ([p._replace(pi_half=0.0 * p.pi_half)], 1.0, 1),
        "U known": ([known(p, "u")], 1.0, 1),
        "friction known": ([known(p, "coulomb", "viscous")], 1.0, 1),
        "start state known": ([p], 1e-6, 1),
        "brake torques known": ([known(p, "brake")], 1.0, 1),
        f"brakes cut together, within {1e3 * TOGETHER:g} ms": (windows(p, TOGETHER, lag), 1.0, 1),
        "brake times known": ([known(p, "delay", "rise")], 1.0, 1),
        "brakes known": ([known(p, "brake", "delay", "rise")], 1.0, 1),
        "all known": ([known(p, "u", "coulomb", "viscous", "brake", "delay", "rise")._replace(pi_half=0.0 * p.pi_half)], 1e-6, 1),
    }  # fmt: skip


def closes(s: Setting, case: Case, states: Callable[[], list[tuple[Array, Array]]]) -> float:
    """Share of states whose tubes of joint speeds all come to rest."""
    (plants, scale, finer), n, good = case, s.model.n, []
    r, v = scale * s.noise.radius[:n], scale * s.noise.radius[n:]
    for q, dq in states():
        h = expected_stop(s.plant, q, np.abs(dq) + v) / KNOTS.stop / finer
        stride = Stride(h, 6 * KNOTS.stop * finer)
        good.append(all(march(p, Box(q - r, q + r), Box(dq - v, dq + v), stride, ALL_PARTS).end == OK for p in plants))
    return float(np.mean(good))


def how_far(s: Setting, case: Case, states: Callable[[], list[tuple[Array, Array]]]) -> tuple[Array, Array]:
    """(states, n) [rad]: how far the energy's tubes go, and the worst sampled stop; not a number where a tube does not come to rest."""
    (plants, scale, finer), n = case, s.model.n
    knots, far, worst = Knots(ENERGY_KNOTS.stop * finer, ENERGY_KNOTS.closing * finer), [], []
    for k, (q, dq) in enumerate(states()):
        start = Start(q, dq, scale * s.noise.radius[:n], scale * s.noise.radius[n:])
        tubes = [march_box(s, p, start, energetic=True, knots=knots) for p in plants]
        stops = [
            sample_stops(p, q, dq, start.q_radius, start.dq_radius, s.payload_com, t, STOPS, k)
            for p, t in zip(plants, tubes, strict=True)
        ]
        assert not any(x.escaped for x, t in zip(stops, tubes, strict=True) if t.end == OK)
        reach = np.max([np.maximum(t.d_hi.max(axis=0), -t.d_lo.min(axis=0)) for t in tubes], axis=0)
        far.append(reach if all(t.end == OK for t in tubes) else np.full(n, np.nan))
        worst.append(np.max([np.maximum(x.forward, x.back) for x in stops], axis=0))
    return np.array(far), np.array(worst)


def farthest(s: Setting, plants: list[Plant], start: Start) -> Array:
    """(n,) [rad]: how far the energy's tubes of these plants go together; infinite where one does not come to rest."""
    tubes = [march_box(s, p, start, energetic=True) for p in plants]
    return np.max(
        [np.maximum(t.d_hi.max(axis=0), -t.d_lo.min(axis=0)) if t.end == OK else np.full(s.model.n, np.inf) for t in tubes],
        axis=0,
    )


def in_two(plant: Plant, name: str, joint: int) -> list[Plant]:
    """The plant with one joint's interval cut in its middle."""
    lo, hi = getattr(plant, f"{name}_lo").copy(), getattr(plant, f"{name}_hi").copy()
    below, above = hi.copy(), lo.copy()
    below[joint] = above[joint] = 0.5 * (lo[joint] + hi[joint])
    return [plant._replace(**{f"{name}_hi": below}), plant._replace(**{f"{name}_lo": above})]


def by_harm(plant: Plant, q: Array, lasts: float, pieces: int) -> list[Plant]:
    """The plant in pieces, each cut where it does most harm."""
    parts = [plant]
    while len(parts) < pieces:
        worst = int(np.argmax([harm_of(p, q, lasts).max() for p in parts]))
        parts += halves(parts.pop(worst), q, lasts)
    return parts


def cuts(s: Setting, top: Array, states: list[tuple[Array, Array]]) -> None:
    """Prints what cutting brings, medians over joints in motion of each state and then over states."""
    n, found = s.model.n, dict[str, list[float]]()
    for q, dq in states:
        start, fast = Start(q, dq, s.noise.radius[:n], s.noise.radius[n:]), np.abs(dq) > 0.2 * top
        lasts, whole = expected_stop(s.plant, q, start.fastest), farthest(s, [s.plant], start)
        ways = {f"{name} of joint {j + 1}": in_two(s.plant, name, j) for name in ("delay", "rise", "brake") for j in range(n)}
        share = {way: float(np.median((farthest(s, parts, start) / whole)[fast])) for way, parts in ways.items()}
        found.setdefault("the one interval in two that helps most", []).append(min(share.values()))
        for pieces in (8, 32):
            parts = by_harm(s.plant, q, lasts, pieces)
            found.setdefault(f"{pieces} pieces", []).append(float(np.median((farthest(s, parts, start) / whole)[fast])))
    for way, values in found.items():
        print(f"{way}: {np.median(values):.3f} times as far ({min(values):.3f} to {max(values):.3f})", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=60)
    parser.add_argument("--arm", choices=list(arms()))
    parser.add_argument("--share", type=float, default=1.0, help="of full speed")
    parser.add_argument("--far", action="store_true")
    parser.add_argument("--cuts", action="store_true")
    args = parser.parse_args()
    model, payload, top = ur5_like(), (4.75, 5.0), np.full(6, TOP)
    if args.arm:
        model, top = arms()[args.arm]
        payload = 0.98 * model.domain.payload[1], model.domain.payload[1]
    top = args.share * top
    s = StopBounds.of(model, payload).setting
    assert s is not None
    n = model.n

    def states(count: int = args.states) -> list[tuple[Array, Array]]:
        rng = np.random.default_rng(77)
        return [(rng.uniform(-np.pi, np.pi, n), rng.uniform(-top, top)) for _ in range(count)]

    if args.cuts:
        cuts(s, top, states())
        return
    stated = None
    for name, case in cases(s.plant, s.lag).items():
        if not args.far:
            print(f"{name}: {closes(s, case, states):.0%} closed by one tube", flush=True)
            continue
        far, worst = how_far(s, case, states)
        stated = far if stated is None else stated
        fast = np.abs([dq for _, dq in states()]) > 0.2 * top  # slower ones move by their disturbance only
        over, of = np.nanmedian((far / worst)[fast]), np.nanmedian((far / stated)[fast])
        print(f"{name}: {over:.2f} times the worst sampled stop, {of:.2f} times as far as stated", flush=True)
    for pieces in () if args.far else (64, 512):
        good = sum(
            tubes_of(s, Start(q, dq, s.noise.radius[:n], s.noise.radius[n:]), pieces, last_resort=False)[-1].end == OK
            for q, dq in states(20)
        )
        print(f"as stated, {pieces} pieces: {good} of the first 20 states closed", flush=True)


if __name__ == "__main__":
    main()
