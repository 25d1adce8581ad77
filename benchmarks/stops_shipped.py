"""How tight STOP 0 bounds are: the arm as shipped, its brakes known from the data sheet, beside narrow assumed brakes.

    python benchmarks/stops_shipped.py [--states 40] [--model FILE.model.json]
    python benchmarks/stops_shipped.py --tables [cobot]

For random states up to full speed (for a model file: states of its domain, payloads extrapolated): the bound as in a table
(64 pieces) over the worst of 250 sampled stops; median over states of angle (joints faster than a fifth of full speed), time and
TCP, how many states have a bound, and how many the kinetic energy bounds.  With ``--tables``: processor time and memory of whole
tables of the arm as shipped, one category at a time, after the compiled code is loaded; of a cobot of seven joints that of STOP 0.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms import prbt_like, shipped
from stop_arms_wide import cobot7_like

from stop_sampling import ANGLE_ERROR, sample_stops
from stopset.artifact import Model, load_model
from stopset.offline.stops.table import Question, stop_table
from stopset.reach.stops import CATEGORIES, Ramp, StopBounds
from stopset.reach.stops.start import Extrapolation, Start
from stopset.reach.stops.tube import OK
from stopset.reach.stops.tubes import march_box
from stopset.reach.stops.types import Category

PER_STATE, PIECES, TOP = 250, 64, 1.26
ARMS = {
    "as shipped (data sheet: torque +-30 %, delay 15 to 60 ms)": shipped,
    "assumed: torque +-10 %, delay 15 to 25 ms": prbt_like,
}
LOADS = ((0.0, 0.0), (2.75, 3.0))


def measure(model: Model, load: tuple[float, float], states: int) -> str:
    """One line of figures."""
    bounds, rng = StopBounds.of(model, load, pieces=PIECES, extrapolate=Extrapolation(payload=True)), np.random.default_rng(11)
    limit, seen = model.robot.q_limit, model.domain
    poses = np.maximum(limit[:, 0], seen.q.lo), np.minimum(limit[:, 1], seen.q.hi)
    speeds = np.maximum(-TOP, seen.dq.lo), np.minimum(TOP, seen.dq.hi)
    s = bounds.setting
    assert s is not None
    r, v = s.noise.radius[:6], s.noise.radius[6:]
    angle: list[float] = []
    times, tcp, energy, escapes = [], [], 0, 0
    for k in range(states):
        q, dq = rng.uniform(*poses), rng.uniform(*speeds)
        b = bounds.bound(q, dq)
        if b.forward is None or b.back is None or b.angle is None or b.time is None or b.tcp is None:
            continue
        energy += b.layer == "energy"
        whole = march_box(s, s.plant, Start(q, dq, r, v), energetic=True)  # for how long to sample
        assert whole.end == OK
        x = sample_stops(s.plant, q, dq, r, v, s.payload_com, whole, PER_STATE, k)
        left = np.any(x.forward > b.forward + ANGLE_ERROR) or np.any(x.back > b.back + ANGLE_ERROR)
        escapes += bool(left or x.tcp > b.tcp + 1e-6 or x.time.max() > b.time.max() + 5e-4)
        angle += (b.angle / np.maximum(x.forward, x.back))[np.abs(dq) > 0.2 * TOP].tolist()
        times.append(float(b.time.max() / x.time.max()))
        tcp.append(b.tcp / x.tcp)
    return (
        f"{len(times)} of {states} states bounded, {energy} by the kinetic energy, {escapes} left by one of {PER_STATE} stops each; median "
        f"bound over worst sampled: angle {np.median(angle):.2f}, time {np.median(times):.2f}, TCP {np.median(tcp):.2f}"
    )


def timed_table(model: Model, category: Category, ramp: Ramp | None, how: str) -> None:
    """One line: a table of one category."""
    begin = time.process_time(), time.perf_counter()
    table = stop_table(model, Question(ramp=ramp, categories=(category,)))
    certified, loose = sum(r.certified for r in table.rows), sum("kinetic energy" in r.why for r in table.rows)
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"STOP {category} ({how}): {certified} of {len(table.rows)} rows, {loose} with the kinetic energy, "
        f"{time.process_time() - begin[0]:.0f} s of processor time, {time.perf_counter() - begin[1]:.0f} s, {size:.0f} MiB",
        flush=True,
    )


def tables(arm: str) -> None:
    """One line for every category, and for the guaranteed one with either way of taking the power; of the cobot STOP 0 alone."""
    if arm == "cobot":
        timed_table(cobot7_like(), "0", None, "cobot of seven joints, up to 3 kg")
        return
    timed, watched = Ramp.stated(6, time=0.5).failing(off_after=0.6), Ramp.stated(6, time=0.3).failing(monitored=True)
    model = shipped()
    for c in CATEGORIES:
        StopBounds.of(model, ramp=timed).bound(np.zeros(6), np.full(6, 0.1), c)
    for c, ramp in [*((c, timed) for c in CATEGORIES), ("1 guaranteed", watched)]:
        timed_table(model, c, ramp, "SS1-r, 0.3 s" if ramp.monitored else "SS1-t, ramp 0.5 s, power off after 0.6 s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=int, default=40)
    parser.add_argument("--model", help="an identified model too")
    parser.add_argument(
        "--tables", nargs="?", const="shipped", choices=("shipped", "cobot"), help="time and memory of whole tables instead"
    )
    args = parser.parse_args()
    if args.tables:
        tables(args.tables)
        return
    arms = {name: arm() for name, arm in ARMS.items()} | ({args.model: load_model(args.model)} if args.model else {})
    for name, arm in arms.items():
        for load in LOADS:
            print(f"{name}, {load[0]:g} to {load[1]:g} kg: {measure(arm, load, args.states)}", flush=True)


if __name__ == "__main__":
    main()
