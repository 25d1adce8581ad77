"""``stopset diagnose``: which physical effect is missing."""

from __future__ import annotations

import argparse

from stopset.cli.common import add_output_options, check_outputs, listed, say, write_json
from stopset.cli.steps import steps
from stopset.words import many

HELP = "which physical effect is missing, at which joint, and what would decide"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", metavar="M", help="model file")
    parser.add_argument("--data", required=True, nargs="+", metavar="REC", help="recordings, Parquet or CSV")
    parser.add_argument("--effects", metavar="a,b", help="look for these effects only (left out: the whole catalogue)")
    parser.add_argument("--all", action="store_true", help="list what these recordings cannot tell, too")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Diagnose; the exit code is 0 whatever the verdict."""
    from stopset.effects import get
    from stopset.offline.description.older import load_model
    from stopset.offline.diagnose import diagnose_model
    from stopset.offline.nominal.nominal import taken_out_in_words
    from stopset.recording import read_recordings

    check_outputs(args.json, args.report)
    model = load_model(args.model)
    names = [get(name).name for name in args.effects.split(",")] if args.effects else None
    recordings = read_recordings(args.data, model.robot)
    with steps("diagnose", args.data, quiet=args.quiet) as progress:
        found, against = diagnose_model(model, recordings, names, progress)
    say(f"{found.verdict} (against the {against}; {many(found.trials, 'trial')})")
    for note in found.notes:
        say(f"note: {note}")
    for out in found.taken_out:
        say(f"taken out beforehand: {taken_out_in_words(out)}")
    for rank, r in enumerate(found.ranked, start=1):
        say(f"{rank}. {r.label}: score {r.score:.0f}, {r.errors}. {r.says}")
        for symbol, p in r.parameters.items():
            std = "" if p.std is None else f" +- {p.std:.2g}"
            say(f"     {symbol} = {p.value:.4g}{std} {p.unit}")
        say(f"     look at: {r.look_at}")
    for r in found.alternatives:
        say(f"{r.label} may as well be {' or '.join(r.one_of[1:])}: {r.alike}")
    for c in found.changed if found.verdict == "missing" else ():
        say(f"also changed since identification: {c.says}")
    for group in found.rivals:
        say(f"these data hardly separate {' from '.join(group)}")
    if found.depends_on:
        say(f"what is left depends on: {', '.join(found.depends_on)}")
    for u in found.unexplained:
        of = f", depends on {', '.join(u.depends_on)}" if u.depends_on else ""
        like = f"; it resembles {'; '.join(u.resembles)}" if u.resembles else ""
        say(f"unexplained at {u.joint}: {u.size:.3g} N m{of}{like}")
    if found.structure:
        say(found.structure.says)
    listed([str(b) for b in found.not_identifiable], "not identifiable from these motions", whole=args.all)
    if found.next_experiment:
        say(f"next: {found.next_experiment}")
    if args.json:
        write_json(args.json, found.as_json())
    if args.report:
        from stopset.offline.diagnose.page import page

        page(model, found, against, args.data).save(args.report)
        say(f"report {args.report}")
    return 0
