"""``stopset plan``: designs the experiments, and says what each part of them will identify."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import add_output_options, check_outputs, say, write_json
from stopset.cli.steps import steps

HELP = "design the experiments: excitation, PTP, static poses, open-loop suites, stops"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--robot", required=True, metavar="URDF", help="URDF, or the name of a shipped arm")
    parser.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder for the CSV files and the table")
    parser.add_argument("--data", nargs="+", metavar="REC", help="recordings that exist: what do they leave undetermined?")
    parser.add_argument("--motions", type=int, default=38, help="independent PTP motions (default 38, as in the paper)")
    parser.add_argument("--repeats", type=int, default=15, help="trials per open-loop suite (default 15)")
    parser.add_argument("--poses", type=int, default=60, help="static poses (default 60)")
    parser.add_argument("--excitations", type=int, default=3, help="excitation trajectories (default 3)")
    parser.add_argument("--period", type=float, default=20.0, help="length of an excitation [s] (default 20)")
    parser.add_argument("--speed", type=float, default=0.9, help="share of the speed limits (default 0.9)")
    parser.add_argument("--torque", type=float, default=0.7, help="share of the torque limits, friction included (default 0.7)")
    parser.add_argument("--floor", type=float, metavar="Z", help="keep link origins and flange above this height [m]")
    parser.add_argument("--rate", type=float, default=250.0, help="samples per second of the CSV files (default 250)")
    parser.add_argument("--seed", type=int, default=0, help="of the random choices (default 0)")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Write the campaign into the folder and its table to the terminal."""
    from stopset.errors import StopsetError
    from stopset.offline.description import load_robot
    from stopset.offline.plan import Wishes, design, write_plan
    from stopset.offline.plan.files import as_dict, summary
    from stopset.recording import stream_recordings

    robot = load_robot(args.robot)
    fresh = not args.out.exists()
    _make(args.out)
    check_outputs(args.json, args.report, args.out / "plan.json")
    wishes = Wishes(
        motions=args.motions, repeats=args.repeats, poses=args.poses, excitations=args.excitations, period=args.period,
        speed=args.speed, torque=args.torque, floor=args.floor, rate=args.rate, seed=args.seed,
    )  # fmt: skip
    recordings = stream_recordings(args.data, robot) if args.data else None
    try:
        with steps("plan", args.data or (), quiet=args.quiet) as progress:
            plan = design(robot, wishes, recordings, progress)
    except StopsetError:
        if fresh:
            args.out.rmdir()  # a refused plan leaves nothing behind
        raise
    files = write_plan(plan, args.out)
    say(summary(plan))
    say(f"{len(files)} files in {args.out}")
    if args.json:
        write_json(args.json, as_dict(plan))
    if args.report:
        from stopset.offline.plan.page import page

        page(plan).save(args.report)
        say(f"report {args.report}")
    return 0


def _make(folder: Path) -> None:
    from stopset.errors import OutputError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise OutputError(f"--out {folder} cannot be made a directory ({e.strerror}); choose another place") from e
