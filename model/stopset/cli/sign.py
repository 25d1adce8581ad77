"""``stopset sign``: vouch for a model or a unit."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from stopset.cli.common import add_output_options, check_outputs, say, write_json

HELP = "sign a model or an FMU with an Ed25519 key, or make such a key"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", nargs="?", metavar="M", help="model file or FMU; its signature is written beside it, as M.sig")
    parser.add_argument("--key", type=Path, metavar="FILE", help="secret key to sign with")
    parser.add_argument(
        "--new-key", type=Path, metavar="FILE", help="make a key: FILE (keep it secret) and FILE.pub (give it away)"
    )
    parser.add_argument(
        "--passphrase", nargs="?", const="-", metavar="FILE",
        help="the key's passphrase: asked for on the terminal, or the first line of FILE; with --new-key the key gets it",
    )  # fmt: skip
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Make a key, sign a model, or both."""
    from stopset.artifact.signature import SigningKeyError, new_key, sign, signature_path

    check_outputs(args.json, args.report)
    if args.new_key is None and (args.model is None or args.key is None):
        raise SigningKeyError("a model to sign and --key FILE are needed; expected both, or --new-key FILE: add what is missing")
    made, passphrase = None, asked_passphrase(args.passphrase, fresh=args.new_key is not None)
    if args.new_key is not None:
        made = new_key(args.new_key, passphrase)
        say(f"key {made}: secret {args.new_key}, public {args.new_key}.pub")
    if args.model is None:
        if args.json:
            write_json(args.json, {"key": made})
        return 0
    statement, key = sign(args.model, args.key or args.new_key, passphrase)
    say(f"{args.model}: revision {statement.revision} of {statement.robot} signed by {key} in {signature_path(args.model)}")
    if args.json:
        write_json(args.json, {"key": key, **asdict(statement)})
    if args.report:
        from stopset.artifact.signature import kind_of
        from stopset.offline.description.older import load_model
        from stopset.offline.report.card import card
        from stopset.offline.report.page import Page

        kind = kind_of(args.model)
        model = load_model(args.model) if kind == "model" else None
        page = Page(f"{statement.robot}: signed {kind}", model)
        page.verdict(f"Revision {statement.revision} is signed by the key {key}.", "good")
        page.next(
            "give the model, its .sig file and the public key to the monitor; `signed.keys` of its configuration names the key."
            if kind == "model"
            else "give the unit, its .sig file and the public key to whoever imports it; `stopset verify F.fmu --key FILE.pub` tells."
        )
        if model is not None:
            card(page, model)
        page.save(args.report)
    return 0


def asked_passphrase(source: str | None, *, fresh: bool) -> str:
    """What was asked for, empty where nothing was; a ``fresh`` one is typed twice. Raises `SigningKeyError`."""
    from stopset.artifact.signature import SigningKeyError

    if source is None:
        return ""
    if source == "-":
        import getpass
        import sys

        if not sys.stdin.isatty():
            raise SigningKeyError(
                "--passphrase asks on a terminal, and there is none; expected one, or --passphrase FILE: name a file"
            )
        found = getpass.getpass("passphrase of the key: ")
        if fresh and getpass.getpass("once more: ") != found:
            raise SigningKeyError("the two passphrases differ; expected the same twice: begin again")
    else:
        try:
            found = Path(source).read_text(encoding="utf-8").partition("\n")[0]
        except (OSError, ValueError) as e:
            raise SigningKeyError(
                f"--passphrase {source} cannot be read ({type(e).__name__}); expected a text file: name one"
            ) from e
    if not found:
        raise SigningKeyError(
            "the passphrase is empty; expected at least one letter: leave --passphrase out for a key without one"
        )
    return found
