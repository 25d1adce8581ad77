"""``stopset add``: an effect into a model, as a new revision."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from stopset.cli.common import add_output_options, check_outputs, say, write_json

HELP = "add an effect: a new revision, errors and set widths before -> after"

SHOWN = (
    ("held_out_torque_rmse", "torque error, held out", "N m"),
    ("held_out_velocity_rmse", "velocity error, held out", "rad/s"),
    ("held_out_position_rmse", "open-loop position error, held out", "rad"),
    ("sum_U_width", "sum of U widths", "N m"),
    ("stop0_angle", "STOP 0 angle bound at full speed, mean of axes", "rad"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", metavar="M", help="model file")
    parser.add_argument("effect", metavar="EFFECT", help="name of the effect, as `stopset diagnose` gives it")
    parser.add_argument("--joint", help="joint it acts at (left out: every joint, or the whole arm)")
    parser.add_argument("--data", required=True, nargs="+", metavar="REC", help="recordings to identify the revision from")
    parser.add_argument("--out", required=True, type=Path, metavar="M2", help="the new model file")
    parser.add_argument("--force", action="store_true", help="add it even if it does not help on held-out data")
    add_output_options(parser, report=False)


def run(args: argparse.Namespace) -> int:
    """Add; exit code 1 when the effect does not help and is not forced."""
    from stopset.artifact import load_model, save_model
    from stopset.offline.revise import add

    check_outputs(args.out, args.json)
    model = load_model(args.model)

    def tell(text: str) -> None:
        sys.stderr.write(f"{text}\n")

    done = add(model, args.effect, args.joint, args.data, args.force, tell)
    say(f"{'':<46}{'before':>12}{'after':>12}   judged on {done.judged_on}")
    for key, means, unit in SHOWN:
        if key in done.before and key in done.after:
            a, b = done.before[key], done.after[key]
            say(f"{means + ' [' + unit + ']':<46}{a:12.4g}{b:12.4g}   {(b / a - 1) * 100 if a else 0:+.0f} %")
    if args.json:
        write_json(args.json, {"helps": done.helps, "before": done.before, "after": done.after, "judged_on": done.judged_on})
    if done.model is None:
        say(f"refused: {args.effect} does not lower the error on held-out data; nothing was written (--force adds it anyway)")
        return 1
    saved = save_model(done.model, args.out)
    say(f"revision {saved.revisions[-1].number}: model file {args.out}  (SHA-256 {saved.sha256[:16]}...)")
    return 0
