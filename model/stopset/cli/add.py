"""``stopset add``: effects into a model, as a new revision."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from stopset.cli.common import add_condition_options, add_keep_options, add_output_options, check_outputs, say, write_json
from stopset.cli.steps import steps
from stopset.errors import EffectError

if TYPE_CHECKING:
    from stopset.artifact import Model

HELP = "add effects: a new revision; errors, set widths and stop distance before -> after"

SHOWN = (
    ("held_out_torque_rmse", "torque error, held out", "N m"),
    ("held_out_velocity_rmse", "velocity error, held out", "rad/s"),
    ("held_out_position_rmse", "open-loop position error, held out", "rad"),
    ("sum_U_width", "sum of U widths", "N m"),
    ("sum_U_width_without_margin", "  of it without margin", "N m"),
    ("stop0_angle", "STOP 0 angle bound at full speed", "rad"),
)
OWN = (("U_width", "width of U, the unexplained torque", "N m"),)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", metavar="M", help="model file")
    parser.add_argument(
        "effect", metavar="EFFECT", nargs="+", help="as `stopset diagnose` names it, EFFECT or EFFECT:JOINT; several are tried in turn"
    )  # fmt: skip
    parser.add_argument("--joint", help="joint it acts at, for a single EFFECT (left out: every joint, or the whole arm)")
    parser.add_argument("--data", required=True, nargs="+", metavar="REC", help="recordings to identify the revision from")
    parser.add_argument("--out", required=True, type=Path, metavar="M2", help="the new model file")
    add_condition_options(parser)
    add_keep_options(parser)
    parser.add_argument("--force", action="store_true", help="add it even if it does not help on held-out data")
    add_output_options(parser)


def _named(effects: Sequence[str], joint: str | None) -> Sequence[str]:
    """``effects`` with the ``joint`` of --joint, which one of them may leave to it."""
    if joint is None:
        return effects
    if len(effects) > 1 or ":" in effects[0]:
        raise EffectError(
            f"{' '.join(effects)} with --joint {joint}: expected a joint for one effect only; write "
            f"{effects[0].partition(':')[0]}:{joint}"
        )
    return [f"{effects[0]}:{joint}"]


def run(args: argparse.Namespace) -> int:
    """Add; exit code 1 when the effect does not help and is not forced."""
    from stopset.artifact import save_model
    from stopset.offline.campaign.conditions import tagged
    from stopset.offline.campaign.source import campaign_of
    from stopset.offline.description.older import load_model
    from stopset.offline.revise.revise import add

    check_outputs(args.out, args.json, args.keep, args.report)
    model = load_model(args.model)

    names = _named(args.effect, args.joint)
    campaign = tagged(campaign_of(model.robot.as_described, args.data), args.condition, args.data)
    with steps("add", args.data, quiet=args.quiet) as progress:
        done = add(model, names, campaign, force=args.force, progress=progress, keep=args.keep_as if args.keep else None)
    for j in done.judged:
        say(f"{j.name}: {'refused, ' + j.why if j.why else 'enters ' + j.enters}")
        if j.stays and not j.why:
            say(f"  {j.stays}")
        if j.beside and not j.why:
            say(
                f"  its numbers are those beside {', '.join(j.beside)}, found there too: add {'them' if len(j.beside) > 1 else 'it'} as well"
            )
        if len(done.judged) > 1 or j.why:
            for line in (*_there(_joints(j.name), j.before, j.after), *_changes(j.before, j.after)):
                say(f"  {line}")
    if done.model is not None:
        say(f"before -> after, errors judged on {done.judged_on}")
        widths = {f"U_width:{j}": (a, b) for j, a, b in _widths(done.without, done.model)}
        before, after = (dict(f) | {k: w[side] for k, w in widths.items()} for side, f in enumerate((done.before, done.after)))
        own = dict.fromkeys(joint for j in done.judged if not j.why for joint in _joints(j.name))
        for line in (*_there(own, before, after), "over the whole arm", *_changes(before, after)):
            say(line)
        for key, (a, b) in widths.items():
            say(_line(f"U width of {key.partition(':')[2]} [N m]", a, b))
        if "stop0_angle" not in done.after:
            say("STOP 0: not every axis' stop from full speed can be proved, so there is no mean to compare")
    if args.json:
        write_json(args.json, {
            "helps": done.helps, "before": done.before, "after": done.after, "judged_on": done.judged_on,
            "judged": [{"effect": j.name, "helps": j.helps, "before": j.before, "after": j.after, "enters": j.enters, "why": j.why,
                        "in_model": j.in_model, "stays": j.stays} for j in done.judged],
        })  # fmt: skip
    saved = save_model(done.model, args.out) if done.model is not None else None
    if args.report:
        from stopset.offline.revise.page import tried

        tried(saved or model, done, args.data).save(args.report)
        say(f"report {args.report}")
    if saved is None:
        say(f"refused; nothing was written{'' if args.force else ' (--force adds what has numbers anyway)'}")
        return 1
    if args.keep and done.retained is not None:
        from stopset.offline.update.update import save_state

        save_state(args.keep, done.retained, saved)
        say(f"state {args.keep}: with it, identify --update {args.out} adds recordings without reading these again")
    say(f"revision {saved.revisions[-1].number}: model file {args.out}  (SHA-256 {saved.sha256[:16]}...)")
    return 0


def _joints(name: str) -> list[str]:
    """The joints an effect ``name[:joint[+joint]]`` acts at; none where it belongs to the whole arm."""
    return [j for j in name.partition(":")[2].split("+") if j]


def _changes(before: Mapping[str, float], after: Mapping[str, float], joint: str = "") -> list[str]:
    """One line per figure that both sides have: over the arm, or at one ``joint``."""
    keys = [(f"{key}:{joint}" if joint else key, means, unit) for key, means, unit in (*SHOWN, *(OWN if joint else ()))]
    return [_line(f"{means} [{unit}]", before[key], after[key]) for key, means, unit in keys if key in before and key in after]


def _there(joints: Iterable[str], before: Mapping[str, float], after: Mapping[str, float]) -> list[str]:
    """The figures at an effect's own joints come first: over the arm, other joints hide what it does there."""
    return [line for j in joints for line in (f"at {j}", *_changes(before, after, j))]


def _widths(before: Model | None, after: Model) -> list[tuple[str, float, float]]:
    """Of each joint: how wide its unknown torque is [N m], of the same recordings before (infinite where no sets enclose them) and after."""
    first = before.powered.U.width.tolist() if before else [float("inf")] * after.n
    return list(zip(after.joints, first, after.powered.U.width.tolist(), strict=True))


def _line(what: str, a: float, b: float) -> str:
    return f"{what:<56}{a:10.4g} -> {b:<10.4g}{f'{b / a - 1:+.0%}' if a else ''}"
