"""Let the diagnosis drive: identify, add what it names first, and so on until nothing more is claimed or helps.

Prints held-out errors and the sum of U widths after every revision.  On the paper's recordings:
python benchmarks/revisions.py --robot lwa4p --data PATH/open_loop.parquet
"""

from __future__ import annotations

import argparse

from stopset.artifact import Model
from stopset.offline.campaign.source import campaign_of
from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose_model
from stopset.offline.identify.pipeline import identify
from stopset.offline.revise.revise import add
from stopset.recording import read_recordings


def row(name: str, figures: dict[str, float]) -> None:
    keys = ("held_out_torque_rmse", "held_out_position_rmse", "sum_U_width")
    print(f"{name:<34}" + "".join(f"{figures[k]:14.4g}" if k in figures else f"{'-':>14}" for k in keys), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", required=True)
    parser.add_argument("--data", required=True, nargs="+")
    parser.add_argument("--steps", type=int, default=12, help="revisions at most (default 12)")
    args = parser.parse_args()
    robot = load_robot(args.robot)
    recordings = read_recordings(args.data, robot)
    model: Model = identify(robot, args.data).model
    print(f"{'':<34}{'torque [N m]':>14}{'position [rad]':>14}{'U sum [N m]':>14}")
    refused: set[str] = set()
    for step in range(args.steps):
        ranked = [r for r in diagnose_model(model, recordings)[0].ranked if r.label not in refused]
        if not ranked:
            break
        best = ranked[0]
        names = [best.label, *best.together]
        done = add(model, names, campaign_of(robot, args.data))
        if step == 0:
            row("first identification", done.before | dict(model.revisions[-1].after))
        if done.model is None:
            refused |= set(names)
            print(f"{' '.join(names):<34}  refused: it does not help on held-out data", flush=True)
            continue
        model = done.model
        row(f"+ {' '.join(names)}", done.after)


if __name__ == "__main__":
    main()
