"""``stopset export-fmu``: the identified arm as a functional mock-up unit."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import add_output_options, check_outputs, say, write_json

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
    parser.add_argument("--no-reference", action="store_true", help="no reference results beside the FMU")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Export; exit code 0."""
    from stopset.artifact import load_model
    from stopset.errors import OutputError
    from stopset.fmu import export, reference_paths, write_reference
    from stopset.fmu.build import chosen
    from stopset.fmu.stops import stop_refusal

    beside = [] if args.no_reference else list(reference_paths(args.out))
    check_outputs(args.out, args.json, args.report, *beside)
    if args.out.suffix != ".fmu":
        raise OutputError(f"--out {args.out}: importers know an FMU by its name; expected one ending in .fmu: add it")
    platforms = [p.name for p in chosen(args.platform)]
    model = load_model(args.model)
    say(f"compiling for {', '.join(platforms)} (the first time takes a minute or two, later seconds)")
    target = export(model, args.out, args.fmi, platforms)
    if beside:
        write_reference(model, args.out)
    say(f"{target}: FMI {args.fmi}.0, co-simulation and model exchange, {target.stat().st_size / 1024:.0f} KiB")
    for path in beside:
        say(f"{path}: reference")
    refusal = stop_refusal(model)
    if refusal:
        say(f"STOP 0 in it: {refusal}")
    say("Bounds are covered while the output `covered` is true; they are a monitoring aid, not a safety function.")
    if args.json:
        write_json(
            args.json,
            {"fmu": str(target), "fmi": args.fmi, "platforms": platforms, "reference": [str(p) for p in beside]},
        )
    if args.report:
        from stopset.fmu.variables import variables
        from stopset.offline.report.page import Page

        page = Page(f"{model.robot.name} as FMU", model)
        page.text(f"{target.name}: FMI {args.fmi}.0, co-simulation and model exchange, for {', '.join(platforms)}.")
        page.text(f"Made from the model with SHA-256 {model.sha256}. {model.guarantee.text}")
        rows = [(v.name, v.causality, v.unit, v.start, v.lo, v.hi, v.description) for v in variables(model)]
        page.table(("variable", "causality", "unit", "start", "least", "largest", "what it is"), rows)
        page.save(args.report)
        say(f"report {args.report}")
    return 0
