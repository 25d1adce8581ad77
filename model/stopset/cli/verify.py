"""``stopset verify``: whether a model or a unit may be trusted."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import add_output_options, check_outputs, say, write_json

HELP = "whether a model or an FMU is signed by an accepted key, unchanged, and new enough"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", metavar="M", help="model file or FMU, with M.sig beside it")
    parser.add_argument("--key", required=True, nargs="+", type=Path, metavar="FILE.pub", help="public keys that are accepted")
    parser.add_argument("--least-revision", type=int, default=0, metavar="N", help="refuse models older than this")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Verify; exit code 1 and one sentence where it may not be trusted."""
    from stopset.artifact.signature import Accepted, NotTrusted, kind_of, verified

    check_outputs(args.json, args.report)
    accepted = Accepted.of(args.key, args.least_revision)
    found, why = None, ""
    try:
        found = verified(args.model, accepted)
    except NotTrusted as e:
        why = str(e)
    say(f"{args.model}: revision {found.revision}, signed by an accepted key, unchanged" if found else why)
    if args.json:
        write_json(args.json, {"trusted": found is not None, "why": why, "revision": None if found is None else found.revision})
    if args.report:
        from stopset.offline.description.older import load_model
        from stopset.offline.report.page import Page

        kind = kind_of(args.model)
        page = Page(f"Signature of {Path(args.model).name}", load_model(args.model) if found and kind == "model" else None)
        page.verdict(why or f"The {kind} is signed by an accepted key, unchanged and new enough.", "bad" if why else "good")
        page.save(args.report)
    return 0 if found is not None else 1
