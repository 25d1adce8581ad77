"""Stops of one joint against the exact solution: as many as one likes, in pieces, none may leave its bound.

    python benchmarks/stops_one_joint.py [--stops 1000000000] [--counts FILE] [--seconds 150]

Each arm is one joint about a vertical axis, drawn at random with its brake, friction, disturbance and start speed; its bound is the
product's. Each of its stops has constants drawn within what the bound was given (corners and anywhere), and is solved exactly: a
constant, a linearly growing and a constant torque act one after the other. Viscous friction is none, as with it there is no such
solution.  ``--counts``: the file that adds up what was sampled, by the code that was; other code is refused.  Arm k draws with seed k,
so pieces give what one run gives.  The exit code is 1 where a stop leaves its bound.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms_wide import arm_model, urdf

from stopset.core.library import ffi, lib
from stopset.offline.description import robot_from_text
from stopset.reach.stops import StopBounds
from stopset.reach.stops.tube import Plant
from stopset.types import Array

ROOT = Path(__file__).resolve().parents[1]
PER_ARM, CHUNK = 2_000_000, 20_000  # stops; the chunk stays in the cache
ROUNDING = 1e-9  # [rad], [s], [rad/s] of the solution in doubles
WEAKENED = 0.99  # of the bound: that this is left shows that the sampling reaches it


def joint(rng: np.random.Generator) -> tuple[StopBounds, float]:
    """Bounds of a random arm of one joint, and its speed at the request [rad/s]."""
    mass, length, top = rng.uniform(1.0, 15.0), rng.uniform(0.1, 0.8), np.array([rng.uniform(1.0, 4.0)])
    own = mass * length**2 / 12
    rows = [((0.0, 0.0, 0.1), (0.0, 0.0, 0.0), "0 0 1", mass, (0.5 * length, 0.0, 0.0), (1e-3, own, own))]
    robot = robot_from_text(urdf("one", rows, (length, 0.0, 0.0), top, np.array([1e3])), {}, "one")
    brake = np.array([10.0 ** rng.uniform(0.7, 2.3)])
    dry = brake * rng.uniform(0.02, 0.1)
    rotor, u = np.array([10.0 ** rng.uniform(-1.5, 0.5)]), 0.3 * dry
    model = arm_model(robot, rotor, brake, dry, np.zeros(1), u, 5.0, top)
    load = np.sort(rng.uniform(0.0, 5.0, 2))
    return StopBounds.of(model, (float(load[0]), float(load[1]))), float(
        rng.uniform(0.05, 1.0) * top[0] * rng.choice([-1.0, 1.0])
    )


def exact(v: Array, inertia: Array, ahead: Array, brake: Array, delay: Array, rise: Array) -> tuple[Array, Array]:
    """Angle [rad] and time [s] to rest from speeds ``v`` > 0 [rad/s], each (K,).

    ``ahead`` [N m], at most 0: disturbance less dry friction; the ``brake`` takes nothing until ``delay``, its torque after
    ``rise`` more seconds, and grows linearly in between.
    """
    slow = -ahead / inertia  # [rad/s^2]
    early = v / slow  # at rest before the brake engages
    t = np.minimum(delay, early)
    angle, v = v * t - 0.5 * slow * t**2, np.maximum(v - slow * t, 0.0)
    jerk = brake / inertia / rise
    # v - slow s - jerk s^2 / 2 = 0
    s = np.minimum(rise, 2.0 * v / (slow + np.sqrt(slow**2 + 2.0 * jerk * v)))
    angle, t, v = angle + s * (v - s * (0.5 * slow + jerk * s / 6.0)), t + s, np.maximum(v - s * (slow + 0.5 * jerk * s), 0.0)
    full = slow + brake / inertia
    return angle + 0.5 * v**2 / full, t + v / full


def _between(lo: Array, hi: Array, size: int, rng: np.random.Generator) -> Array:
    """(size,) of one joint's interval: its ends, and anywhere in it, as often."""
    share = rng.random(size)
    share = np.where(rng.random(size) < 0.5, np.round(share), share)
    return np.asarray(lo[0] + (hi[0] - lo[0]) * share)


def drawn(p: Plant, speed: float, error: float, size: int, rng: np.random.Generator) -> tuple[Array, ...]:
    """Arguments of `exact` for ``size`` stops, the motion forward."""
    load = _between(np.array([-1.0]), np.array([1.0]), size, rng)
    # about the vertical axis: what the link's parameters say of z z
    inertia = p.pi[0, 9] + load * p.pi_half[0, 9] + _between(p.rotor - p.rotor_half, p.rotor + p.rotor_half, size, rng)
    push = _between(p.u_lo, p.u_hi, size, rng) * np.sign(speed)
    v = np.maximum(abs(speed) + error * _between(np.array([-1.0]), np.array([1.0]), size, rng), 1e-12)
    brake = _between(p.brake_lo, p.brake_hi, size, rng)
    delay, rise = _between(p.delay_lo, p.delay_hi, size, rng), _between(p.rise_lo, p.rise_hi, size, rng)
    return v, inertia, push - _between(p.coulomb_lo, p.coulomb_hi, size, rng), brake, delay, rise


def nothing() -> dict[str, Any]:
    """What nothing sampled yet counts as."""
    return {"code": code(), "arms": 0, "bounded": 0, "stops": 0, "escapes": 0, "weakened": 0, "angle": [], "time": []}


def run(number: int, seen: dict[str, Any], stops: int = PER_ARM) -> None:
    """``stops`` of one arm, counted into ``seen``."""
    rng = np.random.default_rng(number)
    bounds, speed = joint(rng)
    s = bounds.setting
    assert s is not None
    b = bounds.bound(np.zeros(1), np.array([speed]))
    seen["arms"] += 1
    if b.angle is None or b.time is None or b.forward is None or b.back is None:
        return
    seen["bounded"] += 1
    angle, last = float((b.forward if speed > 0 else b.back)[0]), float(b.time[0])
    far, late = 0.0, 0.0
    for _ in range(stops // CHUNK):
        a, t = exact(*drawn(s.plant, speed, float(s.noise.radius[1]), CHUNK, rng))
        seen["escapes"] += int(np.sum((a > angle + ROUNDING) | (t > last + ROUNDING)))
        seen["weakened"] += int(np.sum((a > WEAKENED * angle) | (t > WEAKENED * last)))
        far, late = max(far, float(a.max())), max(late, float(t.max()))
    seen["stops"] += stops // CHUNK * CHUNK
    seen["angle"].append(angle / far)
    seen["time"].append(last / late)


def code() -> str:
    """Of all that decides a bound or a sampled stop."""
    h = hashlib.sha256(ffi.string(lib.stopset_sources()))
    for path in (
        *sorted((ROOT / "model/stopset/reach/stops").glob("*.py")),
        Path(__file__),
        ROOT / "benchmarks/stop_arms_wide.py",
    ):
        h.update(path.read_bytes())
    return h.hexdigest()[:16]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stops", type=int, default=1_000_000_000)
    parser.add_argument("--counts", type=Path, help="go on with what this file holds, and add to it")
    parser.add_argument("--seconds", type=float, default=150.0, help="of one piece, with --counts")
    args = parser.parse_args()
    seen = nothing()
    if args.counts and args.counts.exists():
        before = json.loads(args.counts.read_text())
        if before["code"] != seen["code"]:
            raise SystemExit(f"{args.counts} holds stops of code {before['code']}; expected {seen['code']}: name another file")
        seen = before
    until = time.monotonic() + (args.seconds if args.counts else np.inf)
    while seen["stops"] < args.stops and time.monotonic() < until:
        run(seen["arms"], seen)
        if args.counts:
            args.counts.write_text(json.dumps(seen) + "\n")
    a, t = (np.percentile(seen[k], [5, 50, 95]).round(4).tolist() for k in ("angle", "time"))
    print(
        f"{seen['stops']} stops of {seen['bounded']} of {seen['arms']} arms of one joint solved exactly: {seen['escapes']} left their "
        f"bound, {seen['weakened']} one of {WEAKENED:.0%} of it; bound over the farthest and longest of each arm (5/50/95 %): angle {a}, "
        f"time {t}; code {seen['code']}"
    )
    return int(seen["escapes"] > 0)


if __name__ == "__main__":
    sys.exit(main())
