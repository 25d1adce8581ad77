"""``stopset identify-fleet``: many arms identified and diagnosed with one command."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import add_output_options, check_outputs, say, write_json
from stopset.cli.steps import steps

HELP = "identify and diagnose many arms, one folder each, here or on a Dask cluster"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument(
        "fleet", type=Path, metavar="DIR",
        help="a subfolder per arm: robot.urdf (robot.json), recordings to identify from, and in later/ those to diagnose on",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where ARM.model.json and ARM.diagnosis.json go")
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="on this Dask cluster, whose workers read the same files (extra fleet)"
    )
    parser.add_argument(
        "--workers", type=int, default=0, metavar="N", help="without a cluster: so many processes (extra fleet); 0: this one"
    )
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """One line per arm as it is done; exit code 1 if an arm could not be."""
    from dataclasses import asdict

    from stopset.errors import OutputError, StopsetError
    from stopset.files import write_text
    from stopset.offline.fleet import answers, find_arms

    check_outputs(args.json, args.report)
    if not 0 <= args.workers <= 1024:
        raise StopsetError(f"--workers is {args.workers}; expected 0 to 1024: give as many as there are cores")
    if args.out.exists() and not args.out.is_dir():
        raise OutputError(f"--out {args.out} is a file; expected a directory: choose another name")
    arms = find_arms(args.fleet)
    if args.out.resolve() == args.fleet.resolve():
        raise OutputError(
            f"--out {args.out} is the fleet's own folder; expected another: what is found does not go among what is read"
        )
    args.out.mkdir(parents=True, exist_ok=True)
    done = []
    with steps("identify-fleet", [p for a in arms for p in (*a.data, *a.later)], quiet=args.quiet) as progress:
        for answer in answers(arms, args.scheduler, args.workers):
            done.append(answer)
            progress(f"{answer.name}: {answer.says} ({len(done)} of {len(arms)})")
            if not answer.error:
                write_text(args.out / f"{answer.name}.model.json", answer.model)
                write_json(args.out / f"{answer.name}.diagnosis.json", answer.diagnosis)
    done.sort(key=lambda a: a.name)
    wide = max(len(a.name) for a in done)
    for a in done:
        say(f"{a.name:<{wide}}  {'' if a.error else f'U {a.torque_width:8.3g} N m  '}{a.says}")
    bad = [a.name for a in done if a.error]
    say(f"{len(done) - len(bad)} of {len(done)} arms identified and diagnosed, in {args.out}")
    if args.json:
        write_json(args.json, [{k: v for k, v in asdict(a).items() if k != "model"} for a in done])
    if args.report:
        from stopset.offline.report.page import Page

        page = Page("A fleet, identified and diagnosed", data=[p for a in arms for p in (*a.data, *a.later)])
        page.verdict(f"{len(done) - len(bad)} of {len(done)} arms are done.", "bad" if bad else "good")
        page.table(("arm", "sum of U widths [N m]", "diagnosis"), [(a.name, a.torque_width, a.says) for a in done])
        page.save(args.report)
    return int(bool(bad))
