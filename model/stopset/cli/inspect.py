"""``stopset inspect``: what recordings offer, what they lack, what is wrong with them."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from stopset.cli.common import add_output_options, add_robot_options, check_outputs, say, write_json
from stopset.cli.steps import steps
from stopset.words import many

if TYPE_CHECKING:
    from stopset.offline.inspect import Inspection

HELP = "what is in a recording, what is missing for identification, what is wrong with it"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recordings", nargs="+", metavar="REC", help="recordings (Parquet, or CSV with a JSON beside it)")
    parser.add_argument("--robot", metavar="URDF", help="hold the torque against this robot's model: unit, sign, delay")
    add_robot_options(parser)
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """0: nothing wrong; 1: something is wrong that identification should not be run over."""
    from stopset.offline.description import load_robot
    from stopset.offline.inspect import inspect_recordings

    check_outputs(args.json, args.report)
    robot = load_robot(args.robot, tip=args.tip, lock=args.lock) if args.robot else None
    with steps("inspect", args.recordings, quiet=args.quiet) as progress:
        results = inspect_recordings(args.recordings, robot, progress)
    for r in results:
        _print_answer(r)
    if args.robot is None:
        say("Without --robot the torque's unit and its delay cannot be checked.")
    if args.json:
        write_json(args.json, {"files": [r.as_dict() for r in results], "usable": not any(r.wrong for r in results)})
    if args.report:
        from stopset.offline.inspect.page import page

        page(results, robot.name if robot is not None else None).save(args.report)
        say(f"report {args.report}")
    return int(any(r.wrong for r in results))


def _print_answer(r: Inspection) -> None:
    o = r.offers
    wrong = [f"[{f.severity}] {f.says}" for f in r.findings] + ([f"[error] {r.refused}"] if r.refused else [])
    if not o["trials"]:  # nothing was read: there is nothing to tell but why
        say(r.path)
        _list("wrong", wrong)
        return
    rate = f"{o['rate_hz']:.4g} Hz" if o["rate_hz"] else "unknown rate"
    say(f"{r.path}\n  {many(o['trials'], 'trial')}, {o['samples']} samples, {o['seconds']:.4g} s at {rate}; {o['effort']}, "
        f"{o['velocity']} velocity, {o['clock']} clock; channels {', '.join(o['channels'])}")  # fmt: skip
    for cause in o["said"]:
        say(f"  the monitor that wrote it took its violation for: {cause}")
    for phase, p in o["phases"].items():
        say(
            f"  {phase:12} {p['trials']:5} trial{'s' if p['trials'] != 1 else ''} of {many(p['motions'], 'motion')}, {p['seconds']:.4g} s"
        )
    for joint, x in o["joints"].items():
        say(f"  {joint:24} q {_range(x['q'], 'rad')}  dq {_range(x['dq'], 'rad/s')}  tau {_range(x['tau'], 'N m')}")
    _list("wrong", wrong)
    _list("missing for identification", [m.says for m in r.missing])


def _range(x: Any, unit: str) -> str:
    return f"{x[0]:8.3g} .. {x[1]:<8.3g} {unit}" if x else "-"


def _list(title: str, items: list[str]) -> None:
    say(f"  {title}: {'nothing' if not items else ''}")
    for item in items:
        say(f"    - {item}")
