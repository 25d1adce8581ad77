"""``stopset verify``: whether a model may be trusted."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import add_output_options, check_outputs, say, write_json

HELP = "whether a model is signed by an accepted key, unchanged, and new enough"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", metavar="M", help="model file, with M.sig beside it")
    parser.add_argument("--key", required=True, nargs="+", type=Path, metavar="FILE.pub", help="public keys that are accepted")
    parser.add_argument("--least-revision", type=int, default=0, metavar="N", help="refuse models older than this")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Verify; exit code 1 and one sentence where it may not be trusted."""
    from stopset.artifact.signature import Accepted, NotTrusted, load_trusted, revision_of

    check_outputs(args.json, args.report)
    accepted = Accepted.of(args.key, args.least_revision)
    model, why = None, ""
    try:
        model = load_trusted(args.model, accepted)
    except NotTrusted as e:
        why = str(e)
    say(f"{args.model}: revision {revision_of(model)}, signed by an accepted key, unchanged" if model else why)
    if args.json:
        write_json(
            args.json, {"trusted": model is not None, "why": why, "revision": None if model is None else revision_of(model)}
        )
    if args.report:
        from stopset.offline.report.page import Page

        page = Page(f"Signature of {Path(args.model).name}", model)
        page.verdict(why or "The model is signed by an accepted key, unchanged and new enough.", "bad" if why else "good")
        page.save(args.report)
    return 0 if model is not None else 1
