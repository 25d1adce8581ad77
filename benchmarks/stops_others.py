"""What other formulas say of a STOP 0, beside the stops that can happen: how often and by how much they promise too short a way.

    pip install ruckig
    python benchmarks/stops_others.py [--states 40] [--stops 200]

For each arm random poses and speeds, the worst of sampled stops of the nonlinear arm, and for each joint faster than a fifth of its
full speed: v^2 / 2a with the nominal deceleration, the same after the nominal delay and half the rise of the brake, and a
jerk-limited stop (ruckig) of that deceleration which builds up over the nominal rise, after the nominal delay; then our bound.
Deceleration: middle of brake and dry friction over the joint's own inertia at the pose, rotor and payload included.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms_wide import arms

from stop_sampling import sample_stops
from stopset.reach.stops import StopBounds
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Plant
from stopset.reach.stops.tubes import tubes_of
from stopset.robot.rigid import mass_matrix

try:
    from ruckig import ControlInterface, InputParameter, Ruckig, Synchronization, Trajectory
except ImportError:
    raise SystemExit("ruckig is not installed; expected it for the jerk-limited stops: pip install ruckig") from None

Array = NDArray[np.float64]
FAST = 0.2  # of full speed
ARMS = {
    "PRBT-like": (0.0, 1.0),
    "UR5-like, light rotors": (0.0, 1.0),
    "UR10e-like": (0.0, 1.0),
    "cobot of seven joints": (0.0, 1.0),
}


def jerk_limited(dq: Array, deceleration: Array, rise: Array) -> Array:
    """(n,) [rad] every joint's way in ruckig's stop of its own."""
    n = len(dq)
    given = InputParameter(n)
    given.control_interface, given.synchronization = ControlInterface.Velocity, Synchronization.No
    given.current_position, given.current_velocity, given.current_acceleration = [0.0] * n, dq.tolist(), [0.0] * n
    given.target_velocity, given.target_acceleration = [0.0] * n, [0.0] * n
    given.max_acceleration, given.max_jerk = deceleration.tolist(), (deceleration / rise).tolist()
    found = Trajectory(n)
    Ruckig(n).calculate(given, found)
    return np.abs(found.at_time(found.duration)[0])


def predictions(p: Plant, q: Array, dq: Array) -> dict[str, Array]:
    """(n,) [rad] way of each joint by each formula."""
    brake, dry = 0.5 * (p.brake_lo + p.brake_hi), 0.5 * (p.coulomb_lo + p.coulomb_hi)
    delay, rise = 0.5 * (p.delay_lo + p.delay_hi), 0.5 * (p.rise_lo + p.rise_hi)
    a = (brake + dry) / (np.diag(mass_matrix(p.chain, p.pi, q)) + p.rotor)
    v = np.abs(dq)
    return {
        "v^2/2a": v**2 / (2 * a),
        "v^2/2a after delay and half the rise": v * (delay + 0.5 * rise) + v**2 / (2 * a),
        "jerk-limited stop after the delay": v * delay + jerk_limited(dq, a, rise),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=int, default=40)
    parser.add_argument("--stops", type=int, default=200, help="sampled for each state")
    args = parser.parse_args()
    everything = arms()
    for name, shares in ARMS.items():
        model, top = everything[name]
        for share in shares:
            load = share * model.domain.payload[1]
            s = StopBounds.of(model, (0.98 * load, load)).setting
            assert s is not None
            n, rng, rows = model.n, np.random.default_rng(1), dict[str, list[float]]()
            r, v = s.noise.radius[:n], s.noise.radius[n:]
            for k in range(args.states):
                q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top
                tube = tubes_of(s, Start(q, dq, r, v), 1)[-1]
                if tube.end != OK:
                    continue
                x = sample_stops(s.plant, q, dq, r, v, s.payload_com, tube, args.stops, k)
                assert x.escaped == 0
                worst = np.maximum(x.forward, x.back)
                predicted = {
                    **predictions(s.plant, q, dq),
                    "our bound": np.maximum(tube.d_hi.max(axis=0), -tube.d_lo.min(axis=0)),
                }
                for word, bound in predicted.items():
                    rows.setdefault(word, []).extend((worst / bound)[np.abs(dq) > FAST * top].tolist())
            print(f"{name}, {load:.3g} kg, {len(rows['our bound'])} joints in motion:", flush=True)
            for word, values in rows.items():
                ratio = np.array(values)
                short = ratio > 1.0
                by = f"by {np.median(ratio[short]):.2f}, at most {ratio.max():.2f}" if short.any() else "never"
                print(
                    f"  {word}: too short in {short.mean():.0%}, {by}; median of worst over said {np.median(ratio):.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
