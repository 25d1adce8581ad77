"""``stopset renew``: a model file of an older version as one of this version."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import check_outputs, say

HELP = "a model file of an older version as one of this version"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", metavar="M", help="model file")
    parser.add_argument(
        "--out", metavar="M2", type=Path, required=True, help="where to write the same model in this version's format"
    )


def run(args: argparse.Namespace) -> int:
    """Read it as it was meant, write it as it is written now."""
    from stopset.artifact import save_model
    from stopset.offline.description.older import load_model

    check_outputs(args.out)
    model = save_model(load_model(args.model), args.out)
    say(f"{args.out}: {args.model} renewed, sha256 {model.sha256[:16]}")
    return 0
