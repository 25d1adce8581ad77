"""``stopset history``: the revisions of a model."""

from __future__ import annotations

import argparse

from stopset.cli.add import SHOWN
from stopset.cli.common import add_output_options, check_outputs, say, write_json

HELP = "the revisions of a model, and how the errors fell"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", metavar="M", help="model file")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Print the chain."""
    from stopset.offline.description.older import load_model

    check_outputs(args.json, args.report)
    model = load_model(args.model)
    for r in model.revisions:
        say(f"revision {r.number}: {r.added or 'first identification'}{' (' + r.note + ')' if r.note else ''}")
        for key, means, unit in SHOWN:
            if key in r.after:
                was = f"{r.before[key]:.4g} -> " if key in r.before else ""
                say(f"    {means:<48}{was}{r.after[key]:.4g} {unit}")
    for name, key, unit in (("torque", "torque_rmse_floor", "N m"), ("open-loop position", "position_rmse_floor", "rad")):
        floor = [row.get(key) for row in model.errors.values()]
        if all(f is not None for f in floor):
            say(f"repeatability floor of the {name}, per joint: " + ", ".join(f"{f:.3g}" for f in floor) + f" {unit}")
    if args.json:
        rows = [
            {"number": r.number, "added": r.added, "before": dict(r.before), "after": dict(r.after), "note": r.note}
            for r in model.revisions
        ]
        write_json(args.json, rows)
    if args.report:
        from stopset.offline.revise.page import page

        page(model).save(args.report)
        say(f"report {args.report}")
    return 0
