"""What limits the tight certificate on an arm with strong coupling: shares of states that one tube closes, with each interval in turn
replaced by its middle.

    python benchmarks/stops_limits.py [--states 60] [--arm NAME [--share 0.3]]

UR5-like arm with a quarter of the rotor inertia, 4.75 to 5 kg, random states up to 2 rad/s; or an arm of `stop_arms_wide` with its
rated payload, up to a share of its full speed.
"""

from __future__ import annotations

import argparse

import numpy as np
from stop_arms import ur5_like
from stop_arms_wide import arms

from stopset.reach.stops import StopBounds
from stopset.reach.stops.parts import ALL_PARTS
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Plant, Stride, march
from stopset.reach.stops.tubes import KNOTS, expected_stop, tubes_of
from stopset.sets import Box

TOP = 2.0


def known(plant: Plant, *names: str) -> Plant:
    """The plant with these intervals as points."""
    points = {}
    for name in names:
        middle = 0.5 * (getattr(plant, f"{name}_lo") + getattr(plant, f"{name}_hi"))
        points[f"{name}_lo"], points[f"{name}_hi"] = middle, middle
    return plant._replace(**points)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=60)
    parser.add_argument("--arm", choices=list(arms()))
    parser.add_argument("--share", type=float, default=1.0, help="of full speed")
    args = parser.parse_args()
    model, payload, top = ur5_like(), (4.75, 5.0), np.full(6, TOP)
    if args.arm:
        model, top = arms()[args.arm]
        payload = 0.98 * model.domain.payload[1], model.domain.payload[1]
    top = args.share * top
    s = StopBounds.of(model, payload).setting
    assert s is not None
    p, n = s.plant, model.n
    cases: dict[str, tuple[Plant, float, int]] = {
        "as stated": (p, 1.0, 1),
        "time steps a quarter as long": (p, 1.0, 4),
        "payload known": (p._replace(pi_half=0.0 * p.pi_half), 1.0, 1),
        "U known": (known(p, "u"), 1.0, 1),
        "friction known": (known(p, "coulomb", "viscous"), 1.0, 1),
        "start state known": (p, 1e-6, 1),
        "brake torques known": (known(p, "brake"), 1.0, 1),
        "brake times known": (known(p, "delay", "rise"), 1.0, 1),
        "brakes known": (known(p, "brake", "delay", "rise"), 1.0, 1),
        "all known": (known(p, "u", "coulomb", "viscous", "brake", "delay", "rise")._replace(pi_half=0.0 * p.pi_half), 1e-6, 1),
    }
    for name, (plant, scale, finer) in cases.items():
        rng, good = np.random.default_rng(77), 0
        r, v = scale * s.noise.radius[:n], scale * s.noise.radius[n:]
        for _ in range(args.states):
            q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-top, top)
            h = expected_stop(s.plant, q, np.abs(dq) + v) / KNOTS.stop / finer
            good += march(plant, Box(q - r, q + r), Box(dq - v, dq + v), Stride(h, 6 * KNOTS.stop * finer), ALL_PARTS).end == OK
        print(f"{name}: {good / args.states:.0%} closed by one tube", flush=True)
    for pieces in (64, 512):
        rng, good = np.random.default_rng(77), 0
        for _ in range(20):
            q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-top, top)
            tubes = tubes_of(s, Start(q, dq, s.noise.radius[:n], s.noise.radius[n:]), pieces, last_resort=False)
            good += tubes[-1].end == OK
        print(f"as stated, {pieces} pieces: {good} of the first 20 states closed", flush=True)


if __name__ == "__main__":
    main()
