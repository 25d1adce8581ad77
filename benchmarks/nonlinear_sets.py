"""What nonlinear models gain and cost: sets of each abstraction, what linearising neglects, and a search per dimension.

    python benchmarks/nonlinear_sets.py ROBOT RECORDING

The recording holds motor torque with open-loop trials, e.g. of `stopset simulate --hide none --plan short`.  Every model is
identified from the same trials with the same algorithm, without margin.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from plain_sets import leak
from set_problems import binary_search, problem
from stopset.artifact import Abstraction, Model
from stopset.offline.campaign.reading_error import ReadingError
from stopset.offline.compare.compare import inputs
from stopset.offline.conform import monotone_sets as co
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Identification, Settings, identify
from stopset.reach.nonlinear import nominal
from stopset.recording import stream_recordings
from stopset.sets import Box

MODELS = ((1, 1), (2, 3), (2, 5), (3, 3), (3, 5))
TORQUES = (0.2, 0.4, 0.8)  # [N m] half-widths of U for the linearisation
AHEAD = 2.0  # [s]


def main() -> None:
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    robot, recording = load_robot(sys.argv[1]), sys.argv[2]
    print("| abstraction | open-loop position error [mrad] | sum of U widths [N m] | cost (mean tube width) [rad] |")
    print("|---|---|---|---|")
    found = {}
    for kind, order in MODELS:
        one = found[kind, order] = identify(robot, [recording], Settings(model=kind, order=order, margin=1.0))
        error = np.sqrt(np.mean([row["position_rmse"] ** 2 for row in one.model.errors.values()]))
        print(
            f"| model {kind}, p = {order} | {1e3 * error:.1f} | {one.model.powered.U.width.sum():.1f} | {one.conformance.cost:.3f} |",
            flush=True,
        )
    for (kind, order), one in found.items():
        if not one.model.abstraction.linear:
            shares = ", ".join(f"{share:.1%} at +-{torque} N m" for torque, share in neglected(one, recording))
            print(
                f"model {kind}, p = {order}: the nonlinear model leaves the linearised hull by {shares} of its half-width",
                flush=True,
            )
    print(per_dimension())


def neglected(one: Identification, recording: str) -> list[tuple[float, float]]:
    """(half-width of U, `leak`) along the longest open-loop trial, up to `AHEAD`."""
    model: Model = one.model
    dt = model.powered.dt
    _, r, u = max(
        inputs(model, lambda: stream_recordings([recording], model.robot), one.survey, dt), key=lambda item: len(item[2])
    )
    last = min(len(u), round(AHEAD / dt))
    x0 = np.concatenate([r.q[0], r.dq[0]])
    wide = [(h, replace(model.powered, U=Box.symmetric(np.full(model.n, h)))) for h in TORQUES]
    return [(h, leak(model.abstraction, sets, x0, u[:last])) for h, sets in wide]


def per_dimension() -> str:
    """The paper's binary search per dimension on a joint whose torque set is known, in two orders, beside the program."""
    dt, steps, rng = 0.01, 150, np.random.default_rng(0)
    noise, suffered = np.array([1e-4, 2e-3]), (-0.2, 0.8)
    model = Abstraction(1, 3, np.array([[1 / 1.9]]), np.array([[12.0, 0.5, -2.0]]))
    trials = []
    for k in range(4):
        u = 8.0 * np.sin((1 + k) * dt * np.arange(steps))[:, None]
        push = rng.choice(suffered, steps // 25 + 1).repeat(25)[:steps, None]
        x = nominal(model, np.zeros((1, 2)), (u + push)[None, :-1], dt)[0]
        trials.append((x + rng.uniform(-1, 1, x.shape) * noise, u))
    joint = co.problems(trials, problem(model, ReadingError.exact(Box.symmetric(noise)), dt, 100))[0]
    best, _ = co.verified(joint, co.search(joint))
    wide = co.scaled(joint, best, 2.0)
    torque_first = [co.U_LO, co.U_HI, co.Q_LO, co.Q_HI, co.V_LO, co.V_HI]
    torque_last = torque_first[2:] + torque_first[:2]
    said = [("program", best)]
    said += [
        (f"search, U {w}", binary_search(wide, joint.conformant, o)) for w, o in (("first", torque_first), ("last", torque_last))
    ]
    sets = "; ".join(f"{name}: [{z[co.U_LO]:.2f}, {z[co.U_HI]:.2f}]" for name, z in said)
    return f"torque set [{suffered[0]}, {suffered[1]}] N m of one simulated joint: {sets}"


if __name__ == "__main__":
    main()
