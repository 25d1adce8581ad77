"""``stopset simulate``: recordings of the simulated arm, with effects hidden in it on request."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from stopset.cli.common import add_output_options, check_outputs, say, write_json
from stopset.cli.steps import steps

if TYPE_CHECKING:
    from stopset.progress import Progress
    from stopset.recording import Recording

HELP = "recordings from the simulated arm, effects hidden on request"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--robot", default="lwa4p", metavar="R", help="URDF file or a shipped arm (default lwa4p)")
    parser.add_argument(
        "--hide", action="append", default=[], metavar="EFFECT[:JOINT]",
        help="hide this effect, at this joint (else one is drawn); may be repeated; 'none' for a healthy arm",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="directory for the files")
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same recordings (default 1)")
    parser.add_argument(
        "--plan", choices=("short", "compact", "motions", "full"), default="compact",
        help="of six joints about 20,000, 50,000, 120,000 or 140,000 rows; motions: many of them, hardly repeated",
    )  # fmt: skip
    parser.add_argument(
        "--size", choices=("large", "easy", "hard"), default="easy",
        help="how much the effect raises the torque residual of its joint: about 7, 3.2 or 1.4 times",
    )  # fmt: skip
    parser.add_argument("--cad", choices=("exact", "wrong"), default="exact", help="masses of the URDF: true, or 2-5 %% off")
    parser.add_argument(
        "--link-encoder", action="store_true", help="encoders of 19 bit behind the gears, too: columns q_link_<joint>"
    )
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    from stopset.errors import EffectError, OutputError
    from stopset.files import write_text
    from stopset.offline.description import load_robot
    from stopset.progress import counted
    from stopset.recording import write_recordings
    from stopset.simulation import prepare

    if args.seed < 0:
        raise EffectError(f"--seed {args.seed} is negative; give a whole number from 0 on")
    check_outputs(args.json, args.report)
    out: Path = args.out
    if out.exists() and not out.is_dir():
        raise OutputError(f"--out {out} is a file; expected a directory: choose another name")
    check_outputs(out / "recording.parquet" if out.is_dir() else out)
    robot = load_robot(args.robot)
    scenario = prepare(robot, args.hide, args.seed, args.plan, args.size, args.cad, link_encoder=args.link_encoder)
    out.mkdir(exist_ok=True)
    lengths: list[int] = []

    def measured(progress: Progress) -> Iterator[Recording]:
        for r in counted(scenario.recordings(), scenario.count, "recordings simulated", progress):
            lengths.append(len(r.t))
            yield r

    with steps("simulate", quiet=args.quiet) as progress:
        write_recordings(out / "recording.parquet", scenario.meta, measured(progress))
    rows = sum(lengths)
    write_text(out / "robot.urdf", scenario.robot.urdf)
    write_text(out / "robot.json", scenario.datasheet)
    write_json(out / "truth.json", {**scenario.truth, "rows": rows})
    if args.json:
        write_json(args.json, {**scenario.truth, "rows": rows})
    if args.report:
        from stopset.offline.inspect.page import save

        save(args.report, [out / "recording.parquet"], load_robot(out / "robot.urdf"))
        say(f"report {args.report}")
    say(f"{out}: {scenario.count} recordings, {rows} rows of {robot.name}; recording.parquet, robot.urdf, robot.json")
    for e in scenario.truth["effects"]:
        where = f" at {e['joint']}" if e["joint"] else ""
        say(f"hidden: {e['effect']}{where}, residual {e['ratio_achieved']:.2f} times its floor {e['note']}".rstrip())
    say("nothing is hidden" if not scenario.truth["effects"] else f"do not look before you have diagnosed: {out}/truth.json")
    return 0
