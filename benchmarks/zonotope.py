"""When a zonotope is smaller than a box: the torque set U of model 1, both shapes, on the same recordings.

    python benchmarks/zonotope.py MODEL.model.json RECORDING...

The model comes from `stopset identify`; the directions are the joints' axes and, since a distance at the tool adds the
joints up, the tool's own directions at the poses of the recordings.  Both shapes enclose the same data in the same
directions.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stopset.artifact import Abstraction, load_model
from stopset.artifact.inputs import input_map
from stopset.offline.conform.cooperative import Trial
from stopset.offline.conform.zonotopes import ZonotopeFit, directions, fit_zonotope, template, torque_deviations
from stopset.offline.survey import survey
from stopset.recording import stream_recordings
from stopset.robot import Robot
from stopset.robot.rigid import Array, link_frames
from stopset.sets import Box

GRID = 0.02  # [s]
STARTS = 10  # a window starts every so many samples of the grid


def tool_directions(robot: Robot, poses: Array) -> Array:
    """Unit directions (up to 3 per pose, n) in joint space along which the tool moves in x, y, z."""
    rows = []
    for q in poses:
        R, o = link_frames(robot.chain, q)
        tip = o[-1] + R[-1] @ robot.tip
        axes = np.einsum("irk,ik->ir", R, robot.chain.axis)
        J = np.cross(axes, tip - o).T
        length = np.linalg.norm(J, axis=1)
        rows.append(J[length > 1e-3] / length[length > 1e-3, None])  # [m]; a direction the tool cannot move in says nothing
    return np.vstack(rows)


def compare(
    trials: Sequence[Trial], abstraction: Abstraction, noise: Box, extra: Array, dt: float, horizon: float
) -> dict[str, ZonotopeFit]:
    """Box and zonotope on the same directions: axes and ``extra`` (k, n)."""
    n = abstraction.n
    l = np.vstack([np.eye(n), extra])  # noqa: E741
    G = template(torque_deviations(trials, abstraction, dt), abstraction)
    steps = min(round(horizon / dt), max(len(x) for x, _ in trials) - 1)
    seen = directions(trials, abstraction, l, dt, steps, STARTS)
    return {name: fit_zonotope(seen, abstraction, g, noise) for name, g in (("box", np.eye(n)), ("zonotope", G))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("data", nargs="+", type=Path)
    parser.add_argument("--horizon", type=float, default=2.0, help="[s]")
    parser.add_argument("--phase", default="open_loop")
    args = parser.parse_args()
    model = load_model(args.model)
    to_input = input_map(model.robot, model.effects, model.effort, model.abstraction)
    found = survey(lambda: stream_recordings(args.data, model.robot))
    trials, dt = [], GRID
    for r in stream_recordings(args.data, model.robot):
        if r.phase != args.phase or len(r.t) < 10:
            continue
        every = max(1, round(GRID / float(np.median(np.diff(r.t)))))
        dt = every * float(np.median(np.diff(r.t)))
        u = to_input(r.q, r.dq, r.tau, r.temp, 0.0, r.t)
        steps = (len(r.t) - 1) // every
        mean = u[: steps * every].reshape(steps, every, -1).mean(axis=1)
        trials.append((np.hstack([r.q, r.dq])[: steps * every + 1 : every], np.vstack([mean, mean[-1:]])))
    poses = np.vstack([x[:: max(1, len(x) // 3), : model.n] for x, _ in trials[:: max(1, len(trials) // 4)]])
    tool = tool_directions(model.robot, poses[:6])
    fits = compare(trials, model.abstraction, found.noise, tool, dt, args.horizon)
    D = torque_deviations(trials, model.abstraction, dt)
    print(
        "correlation of the torque deviations between joints, largest:", np.abs(np.corrcoef(D.T) - np.eye(model.n)).max().round(2)
    )
    print("| shape | tube width, mean over directions [mrad] | sum of U widths per joint [N m] | volume^(1/n) [N m] |")
    print("|---|---|---|---|")
    for name, fit in fits.items():
        size = fit.U.volume ** (1.0 / model.n) if fit.U.generators.shape[1] <= 18 else float("nan")
        print(f"| {name} | {1e3 * fit.cost:.2f} | {fit.U.box.width.sum():.2f} | {size:.3f} |")


if __name__ == "__main__":
    main()
