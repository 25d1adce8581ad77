"""``stopset check-fmu``: is the unit on this machine what the Python model was where it was exported."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import check_outputs, say, write_json

HELP = "run an FMU of ours against the reference results inside it, on this machine"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("fmu", type=Path, help="the FMU, from `stopset export-fmu`")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the machine-readable answer here")


def run(args: argparse.Namespace) -> int:
    """Check; exit code 0 where nothing differs, 1 where something does."""
    from stopset.fmu.check import AGREE, STEMS, check_fmu

    check_outputs(args.json)
    c = check_fmu(args.fmu)
    say(f"{args.fmu}: FMI {c.fmi}, library for {c.platform}")
    say(f"fmpy's validator: {'clean' if not c.problems else '; '.join(c.problems)}")
    for stem, x in c.differences.items():
        say(f"{stem:<6} {c.rows} rows: differs from the reference by {x:.1e} {STEMS[stem]} at most (allowed {AGREE:g})")
    if c.stops:
        say(f"stop bounds: {c.equal} of {c.stops} states equal to the last bit")
    else:
        say("stop bounds: this model has none")
    say(f"a step takes {1e6 * c.step:.0f} us of CPU time here (with fmpy's call)")
    say(
        "The unit is what it was where it was exported."
        if c.good
        else "The unit is NOT what it was where it was exported: do not use it."
    )
    if args.json:
        write_json(
            args.json,
            {
                "fmu": str(args.fmu), "fmi": c.fmi, "platform": c.platform, "good": c.good, "problems": list(c.problems), "rows": c.rows,
                "largest_difference": {k: x if x < float("inf") else None for k, x in c.differences.items()},
                "stop_states": c.stops, "stop_states_equal": c.equal, "step_s": c.step,
            },
        )  # fmt: skip
    return 0 if c.good else 1
