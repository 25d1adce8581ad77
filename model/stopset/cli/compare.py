"""``stopset compare``: a model against recordings."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from stopset.cli.common import add_output_options, check_outputs, say, write_json
from stopset.cli.steps import steps
from stopset.words import many

if TYPE_CHECKING:
    from stopset.artifact import Model
    from stopset.offline.compare.compare import Comparison

AVERAGING_S, LONGEST_S = 0.2, 5.0  # as the comparison takes them; a test holds both together
WORST = 5  # violations listed
HELP = "where a model fails on recordings: per joint, per motion, violations, tubes"


MEANS = (
    f"  torque: what the model that predicts lacks, averages over {AVERAGING_S:g} s, the whole of every trial",
    "  in full: what rigid body, friction and effects leave; the rest is what the abstraction makes simpler",
    "  floor: scatter of the torque error between repetitions of the same torques; - where nothing is repeated",
    f"  velocity, position: prediction from every trial's start, the first {LONGEST_S:g} s of it",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", metavar="M", help="model file")
    parser.add_argument("--data", required=True, nargs="+", metavar="REC", help="recordings, Parquet or CSV")
    parser.add_argument("--all", action="store_true", help="list every violation, not the worst few")
    parser.add_argument("--mcap", type=Path, metavar="FILE.mcap", help="one recording with its predictions, for Foxglove")
    parser.add_argument("--recording", metavar="LABEL", help="which one (default: the one that fails most)")
    add_output_options(parser)


def _export(model: Model, found: Comparison, args: argparse.Namespace) -> None:
    """Write the recording asked for, or the worst. Raises `RecordingError`, `OutputError`."""
    from stopset.errors import RecordingError
    from stopset.offline.compare.mcap_file import save_mcap
    from stopset.offline.compare.scene import listed, scene

    label = args.recording or listed(found)[0]["label"]
    drawn = scene(model, found, label)
    if drawn is None:
        some = ", ".join(r.label for r in found.rows[:3])
        raise RecordingError(f"no recording is called {label!r}; expected one of these, as {some}: give its label")
    save_mcap(args.mcap, model, drawn)
    say(f"{label}: {args.mcap}, for Foxglove")


def _over(model: Model, found: Comparison) -> str:
    """What was compared, in a line."""
    s = found.survey
    seconds = s.samples * s.dt
    return (
        f"{many(len(found.rows), f'{s.phase} trial')}, {seconds:.0f} s of {many(len(set(s.motion.values())), 'independent motion')}, with "
        f"model {model.abstraction.kind} of order {model.abstraction.order}"
    )


def run(args: argparse.Namespace) -> int:
    """Compare; exit code 1 when a recording leaves the sets, or its readings are none."""
    from stopset.offline.compare.compare import answer, compare
    from stopset.offline.compare.verdict import by_failure, verdict
    from stopset.offline.conform.tightness import table
    from stopset.offline.description.older import load_model

    check_outputs(args.json, args.report, args.mcap)
    model = load_model(args.model)
    with steps("compare", args.data, quiet=args.quiet) as progress:
        found = compare(model, args.data, progress)
    said = verdict(found)
    say(said.text)
    say(f"what next: {said.next}")
    for sentence in (*found.said, *found.unsound[1:], *found.left_out):
        say(sentence)
    say(_over(model, found))
    say(f"{'joint':<22}{'torque':>9}{'in full':>9}{'floor':>9}{'velocity':>10}{'position':>10}   RMS errors, SI")
    for j, row in by_failure(found):
        keys = ("torque_rmse", "torque_rmse_known", "torque_rmse_floor", "velocity_rmse", "position_rmse")
        cells = zip((row[k] for k in keys), (9, 9, 9, 10, 10), strict=True)
        say(f"{j:<22}" + "".join(f"{'-' if c is None else f'{c:.4f}':>{w}}" for c, w in cells))
    for line in (*MEANS, *table(found.tightness, tuple(found.figures))):
        say(line)
    worst = sorted(found.violations, key=lambda v: -v.relative)
    for v in worst if args.all else worst[:WORST]:
        say(
            f"violation: {v.recording}: {v.state} {v.side} the set by {v.excess:.4g} {v.unit} "
            f"at age {v.age_s:.3f} s (start {v.start_s:.3f} s)"
        )
    if len(worst) > WORST and not args.all:
        say(f"violation: {len(worst) - WORST} more, --all lists them")
    say(f"of {many(len(found.rows), 'recording')} {len(found.violations)} left the sets and {found.outside_domain} the domain")
    for name, (held, out) in found.bands.items():
        say(f"{name}: {out} of the {held} recordings at its temperatures leave its narrower sets (nothing is promised of them)")
    say(f"when it was identified: {model.guarantee.text}")
    if args.json:
        write_json(args.json, answer(model, found))
    if args.report:
        from stopset.offline.compare.page import page

        page(model, found, args.data).save(args.report)
        say(f"report {args.report}")
    if args.mcap:
        _export(model, found, args)
    return 1 if found.violations or found.unsound else 0
