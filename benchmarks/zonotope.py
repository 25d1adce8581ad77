"""When a zonotope is smaller than a box: the torque set U of model 1, both shapes, on the same recordings.

    python benchmarks/zonotope.py ROBOT RECORDING [ROBOT RECORDING]...

One row per pair, each identified with `--shape zonotope`.  Both shapes are found without margin, enclose the same
windows, and are asked to be narrow in the same directions: the joints' axes and, since a distance at the tool adds the
joints up, the tool's x, y and z at six poses.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from plain_sets import volume
from stopset.offline.conform.linear_program import FittedSets
from stopset.offline.conform.linear_sets import BOX
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Settings, identify

FEW = 18  # generators; the volume is a sum over all choices of n among them


def tube(fit: FittedSets) -> float:
    """Mean width of the tube over the directions [mrad]."""
    assert fit.template is not None
    return 1e3 * fit.cost / len(fit.template.directions)


def size(fit: FittedSets) -> float:
    """Edge of the cube of the same volume [N m]."""
    assert fit.zonotope is not None
    few = fit.zonotope.generators.shape[1] <= FEW
    return volume(fit.zonotope.set) ** (1.0 / fit.U.dim) if few else float("nan")


def main() -> None:
    if len(sys.argv) < 3 or len(sys.argv) % 2 == 0:
        sys.exit(__doc__)
    print("| recordings | tube, box [mrad] | tube, zonotope [mrad] | sum of U widths [N m] | volume^(1/n) of U [N m] |")
    print("|---|---|---|---|---|")
    for robot, recording in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        found = identify(load_robot(robot), [recording], Settings(shape="zonotope"))
        table = found.conformance.table
        box, zonotope = table[BOX], table["all"]
        print(
            f"| {recording} | {tube(box):.1f} | {tube(zonotope):.1f} ({tube(zonotope) / tube(box) - 1:+.0%}) | "
            f"{np.sum(box.U.width):.1f} → {np.sum(zonotope.U.width):.1f} | {size(box):.2f} → {size(zonotope):.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
