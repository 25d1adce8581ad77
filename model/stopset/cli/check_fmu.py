"""``stopset check-fmu``: is the unit on this machine what the Python model was where it was exported."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import add_output_options, check_outputs, say, write_json

HELP = "run an FMU of ours against the reference results inside it, on this machine"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("fmu", type=Path, help="the FMU, from `stopset export-fmu`")
    parser.add_argument("--key", nargs="+", type=Path, metavar="FILE.pub", help="public keys, one of which must have signed it")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Check; exit code 0 where nothing differs, 1 where something does."""
    from stopset.fmu.check import AGREE, STEMS, check_fmu

    check_outputs(args.json, args.report)
    signed, trusted = _signed(args.fmu, args.key)  # before any of it is run
    c = check_fmu(args.fmu, trusted=trusted)
    good = c.good and trusted
    title = f"{args.fmu}: FMI {c.fmi}, library for {c.platform}"
    lines = [f"files and fmpy's validator: {'; '.join(c.problems) or 'clean'}"]
    for stem, x in c.differences.items():
        lines.append(f"{stem:<6} {c.rows} rows: differs from the reference by {x:.1e} {STEMS[stem]} at most (allowed {AGREE:g})")
    if c.rows:
        equal = f"{c.equal} of {c.stops} states equal to the last bit" if c.stops else "this model has none"
        lines += [f"stop bounds: {equal}", f"a step takes {1e6 * c.step:.0f} us of CPU time here (with fmpy's call)"]
    else:
        lines.append("nothing of it was run to its end, as it is not what was exported or signed")
    lines.append(signed)
    lines.append(
        f"The unit is {'what' if good else 'NOT what'} it was where it was exported{'.' if good else ': do not use it.'}"
    )
    say("\n".join([title, *lines]))
    if args.json:
        write_json(
            args.json,
            {
                "fmu": str(args.fmu), "fmi": c.fmi, "platform": c.platform, "good": good, "signature": signed,
                "problems": list(c.problems), "rows": c.rows,
                "largest_difference": {k: x if x < float("inf") else None for k, x in c.differences.items()},
                "stop_states": c.stops, "stop_states_equal": c.equal, "step_s": c.step,
            },
        )  # fmt: skip
    if args.report:
        from stopset.offline.report.page import Page

        page = Page(f"Check of {args.fmu.name}")
        for line in [title, *lines]:
            page.text(line)
        page.save(args.report)
        say(f"report {args.report}")
    return 0 if good else 1


def _signed(fmu: Path, keys: list[Path] | None) -> tuple[str, bool]:
    """Who signed it, in words; false where it is not what was signed, or not by one of these keys."""
    from stopset.artifact.signature import Accepted, NotTrusted, signer, verified

    try:
        if keys:
            return f"signature: revision {verified(fmu, Accepted.of(keys)).revision}, by an accepted key, unchanged", True
        key = signer(fmu)
    except NotTrusted as e:
        return f"signature: {e}", False
    return ("signature: none" if key is None else f"signature: names the key {key}; `--key FILE.pub` proves it"), True
