"""``stopset export-fmu``: the identified arm as a functional mock-up unit."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import add_output_options, check_outputs, path_rows, say, write_json
from stopset.cli.steps import steps

HELP = "write the model as an FMU (FMI 2.0 or 3.0) that runs without Python"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("model", type=Path, help="model file from `stopset identify`")
    parser.add_argument("--out", type=Path, required=True, metavar="F.fmu", help="the FMU to write")
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=3, help="version of the standard (default 3)")
    parser.add_argument(
        "--platform",
        action="append",
        metavar="NAME",
        help="x86_64-linux, aarch64-linux, x86_64-windows, x86_64-darwin, aarch64-darwin; may be repeated (default: all)",
    )
    parser.add_argument(
        "--path",
        type=Path,
        metavar="CSV",
        help="bounds of a STOP 1 that stays on the path through these rows of angles [rad] too",
    )
    parser.add_argument("--clocks", action="store_true", help="FMI 3 clocks that ask for a stop, for importers that know clocks")
    parser.add_argument("--source-only", action="store_true", help="no libraries: whoever imports it compiles its sources")
    parser.add_argument(
        "--no-reference", action="store_true", help="no reference results inside (then check-fmu has nothing to do)"
    )
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Export; exit code 0."""
    from stopset.errors import OutputError
    from stopset.fmu import Contents, export
    from stopset.fmu.build import chosen
    from stopset.fmu.stops import stop_refusal
    from stopset.offline.description.older import load_model
    from stopset.reach.stops.path import Path as StopPath

    check_outputs(args.out, args.json, args.report)
    if args.out.suffix != ".fmu":
        raise OutputError(f"--out {args.out}: importers know an FMU by its name; expected one ending in .fmu: add it")
    platforms = [] if args.source_only else [p.name for p in chosen(args.platform)]
    model = load_model(args.model)
    path = None if args.path is None else StopPath.through(path_rows(args.path, model.n))
    contents = Contents(args.fmi, args.platform or (), args.source_only, not args.no_reference, args.clocks, path)
    with steps("export-fmu", quiet=args.quiet) as progress:
        target = export(model, args.out, contents, progress)
    what = "sources alone" if args.source_only else ", ".join(platforms)
    say(f"{target}: FMI {args.fmi}.0, co-simulation and model exchange, {target.stat().st_size / 1024:.0f} KiB; {what}")
    if not (args.no_reference or args.source_only):
        say(f"compare it on another machine: stopset check-fmu {target}")
    refusal = stop_refusal(model)
    if refusal:
        say(f"no stop is bounded in it: {refusal}")
    say("Bounds are covered while the output `covered` is true; they are a monitoring aid, not a safety function.")
    if args.json:
        write_json(
            args.json,
            {"fmu": str(target), "fmi": args.fmi, "platforms": platforms, "reference": not args.no_reference},
        )
    if args.report:
        from stopset.fmu.variables import variables
        from stopset.offline.report.page import Page

        page = Page(f"{model.robot.name} as FMU", model)
        page.text(f"{target.name}: FMI {args.fmi}.0, co-simulation and model exchange, {what}.")
        page.text(f"Made from the model with SHA-256 {model.sha256}. {model.guarantee.text}")
        rows = [(v.name, v.causality, v.unit, v.start, v.lo, v.hi, v.description) for v in variables(model, path=path)]
        page.table(("variable", "causality", "unit", "start", "least", "largest", "what it is"), rows)
        page.save(args.report)
        say(f"report {args.report}")
    return 0
