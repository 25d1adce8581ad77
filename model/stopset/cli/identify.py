"""``stopset identify``: recordings to a model file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from stopset.cli.common import (
    add_condition_options,
    add_keep_options,
    add_output_options,
    add_robot_options,
    check_outputs,
    say,
    write_json,
)
from stopset.cli.steps import steps
from stopset.errors import StopsetError
from stopset.words import many

if TYPE_CHECKING:
    from stopset.artifact import Model
    from stopset.offline.conform.linear_program import FittedSets
    from stopset.offline.identify.pipeline import Identification
    from stopset.progress import Progress

HELP = "recordings of a robot -> a reachset-conformant model file"


def margin(text: str) -> float | None:
    """``auto`` or a factor of at least 1."""
    if text == "auto":
        return None
    try:
        value = float(text)
    except ValueError as e:
        raise argparse.ArgumentTypeError(f"{text!r} is neither 'auto' nor a factor") from e
    if not 1.0 <= value < 100.0:
        raise argparse.ArgumentTypeError(f"{text} is no margin; expected 'auto' or a factor from 1 to 100")
    return value


def order(text: str) -> int:
    """A polynomial order."""
    if not text.isdecimal() or not 1 <= int(text) <= 20:
        raise argparse.ArgumentTypeError(f"{text!r} is no order; expected a whole number from 1 to 20")
    return int(text)


def bands(text: str) -> int:
    """A number of temperature bands."""
    if not text.isdecimal() or not 2 <= int(text) <= 20:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of bands; expected 2 to 20")
    return int(text)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument(
        "--robot", metavar="URDF", help="URDF (robot.json beside it is read), or a shipped arm: lwa4p; not with --update"
    )
    add_robot_options(parser)
    parser.add_argument("--data", required=True, nargs="+", metavar="REC", help="recordings, Parquet or CSV")
    add_condition_options(parser)
    parser.add_argument("--mixed", action="store_true", help="take recordings of several conditions as one")
    parser.add_argument("--out", required=True, type=Path, metavar="M.model.json", help="the model file to write")
    parser.add_argument(
        "--model", type=int, choices=(1, 2, 3), help="abstraction (default: 1, and the next one where its sets say too little)"
    )
    parser.add_argument("--order", type=order, metavar="P", help="polynomial order (default: by held-out error)")
    parser.add_argument("--effects", default="", metavar="a,b", help="effects beyond the base ones (see `stopset diagnose`)")
    parser.add_argument(
        "--friction", choices=("evidence", "plain"), default="evidence",
        help="laws beside Coulomb and viscous friction: those that lower the held-out error (default), or only what --effects names",
    )  # fmt: skip
    parser.add_argument(
        "--conform", choices=("all", "position"), default="all", help="states that must be enclosed (default all)"
    )
    parser.add_argument(
        "--windows", choices=("sliding", "start"), default="sliding",
        help="predictions restart at every sample, or only at each trial's start as in the paper (default sliding)",
    )  # fmt: skip
    parser.add_argument(
        "--shape", choices=("box", "zonotope"),
        help="of the torque set (default box); a zonotope is narrower at the tool where joints are disturbed together, and slower to find",
    )  # fmt: skip
    parser.add_argument("--margin", type=margin, default=None, metavar="auto|FACTOR", help="growth of the sets (default auto)")
    parser.add_argument(
        "--bands", type=bands, default=0, metavar="N", help="also sets for N temperature bands, where temperature is recorded"
    )
    parser.add_argument(
        "--accept-wide", action="store_true",
        help="exit 0 even if the sets are too wide to say anything (more than 10 times the largest deviation after 0.1 s)",
    )  # fmt: skip
    add_keep_options(parser)
    parser.add_argument(
        "--update",
        type=Path,
        metavar="M.model.json",
        help="add the recordings of --data to this model without reading its old ones again; needs --state. With kept signals the "
        "new model is that of identifying from old and new recordings together, to the last bit; with kept sums its nominal model "
        "stays, all else is that of old and new recordings together, and it says when the nominal model is out of date",
    )
    parser.add_argument("--state", type=Path, metavar="FILE.state", help="what --keep wrote beside the model of --update")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="run the heavy pass on this Dask cluster (extra fleet)")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Identify, write the model file, print what was found."""
    from stopset.artifact import save_model

    check_outputs(args.out, args.json, args.report, args.keep)
    with steps("identify", args.data, quiet=args.quiet) as progress:
        found = _updated(args, progress) if args.update else _identified(args, progress)
    model = save_model(found.model, args.out)
    if args.keep:
        from stopset.offline.update.update import save_state

        assert found.retained is not None
        save_state(args.keep, found.retained, model)
    say(summary(found))
    say(f"model file {args.out}  (SHA-256 {model.sha256[:16]}...)")
    if args.keep:
        say(f"state {args.keep}: with it, --update {args.out} adds recordings without reading these again")
    if args.json or args.report:
        _compared(args, model)
    return verdict(found, accepted=args.accept_wide)


def _compared(args: argparse.Namespace, model: Model) -> None:
    """The model against its own recordings, once for answer and page."""
    from stopset.offline.compare.compare import answer, compare

    with steps("compare", args.data, quiet=args.quiet) as progress:
        comparison = compare(model, args.data, progress)
    if args.json:
        write_json(args.json, answer(model, comparison))
    if args.report:
        from stopset.offline.compare.page import page

        page(model, comparison, args.data).save(args.report)
        say(f"report {args.report}")


def verdict(found: Identification, *, accepted: bool) -> int:
    """Exit code: 1 for sets that enclose everything and say nothing, unless they are accepted."""
    from stopset.offline.conform.tightness import LIMIT

    if not (found.tightness.too_wide() or found.absurd):
        return 0
    why = "absurd (see the notes)" if found.absurd else f"too wide: more than {LIMIT:g} times what deviated after 0.1 s"
    if accepted:
        say(f"accepted as asked although the sets are {why}")
        return 0
    say(
        f"not accepted: the sets are {why}. The model file is written, to find out what is missing (`stopset diagnose`); take it "
        "as it is with --accept-wide"
    )
    return 1


def _identified(args: argparse.Namespace, progress: Progress) -> Identification:
    from stopset.offline.campaign.conditions import tagged
    from stopset.offline.campaign.source import campaign_of
    from stopset.offline.description import load_robot
    from stopset.offline.identify.pipeline import Settings, identified

    if args.robot is None:
        raise StopsetError("no robot is named; expected --robot URDF (or --update M.model.json): give one")
    if args.state is not None:
        raise StopsetError(f"--state {args.state} is only read by --update; name the model it belongs to, or leave it out")
    robot = load_robot(args.robot, tip=args.tip, lock=args.lock)
    settings = Settings(
        model=args.model or 1, order=args.order, effects=tuple(e for e in args.effects.split(",") if e),
        conform=args.conform, windows=args.windows, margin=args.margin, bands=args.bands,
        ladder=args.model is None and args.order is None and args.shape is None,
        shape=args.shape or "box", friction=args.friction, mixed=args.mixed,
    )  # fmt: skip
    campaign = tagged(campaign_of(robot, args.data), args.condition, args.data)
    return identified(robot, campaign, settings, progress, args.scheduler, keep=args.keep_as if args.keep else None)


def _updated(args: argparse.Namespace, progress: Progress) -> Identification:
    from stopset.offline.description.older import load_model
    from stopset.offline.update.update import load_state, update

    parser = argparse.ArgumentParser()
    add_arguments(parser)
    given = [
        f"--{name.replace('_', '-')}"
        for name in (
            "robot",
            "model",
            "order",
            "effects",
            "friction",
            "mixed",
            "condition",
            "tip",
            "lock",
            "conform",
            "windows",
            "margin",
            "bands",
            "shape",
            "keep_as",
        )
        if getattr(args, name) != parser.get_default(name)
    ]
    if given:
        raise StopsetError(f"{', '.join(given)} cannot be given with --update: they stay those of {args.update}; leave them out")
    if args.state is None:
        raise StopsetError(
            f"--update needs the sums behind {args.update}; expected --state FILE.state: identify once with --keep FILE.state"
        )
    model = load_model(args.update)
    return update(model, load_state(args.state, model), args.data, progress, args.scheduler, wide=args.accept_wide)


def summary(found: Identification) -> str:
    """The printout: what is promised, sets per joint, the variants beside them, what fixes the bounds, notes."""
    from stopset.offline.conform.bands import narrower
    from stopset.offline.conform.linear_sets import BOX
    from stopset.offline.conform.tightness import table

    m, c = found.model, found.conformance
    s = m.powered
    n = m.n
    lines = [
        f"{m.robot.name}: model {m.abstraction.kind}, order {m.abstraction.order}, {many(found.survey.trials, 'trial')} of "
        f"{many(len(set(found.survey.motion.values())), 'independent motion')}, step {s.dt * 1e3:g} ms, horizon {s.horizon:.2f} s",
        m.guarantee.text,
        "",
    ]
    lines.append(f"{'joint':<22}{'U [N m]':>20}{'X0 q [rad]':>22}{'X0 dq [rad/s]':>20}{'q rmse':>9}{'dq rmse':>9}")
    for k, j in enumerate(m.joints):
        q, dq = (m.errors[j][key] for key in ("position_rmse", "velocity_rmse"))
        far = "".join(f"{'-' if x is None else format(x, '.4f'):>9}" for x in (q, dq))
        lines.append(
            f"{j:<22}{f'[{s.U.lo[k]:.3f}, {s.U.hi[k]:.3f}]':>20}{f'[{s.X0.lo[k]:.1e}, {s.X0.hi[k]:.1e}]':>22}"
            f"{f'[{s.X0.lo[n + k]:.3f}, {s.X0.hi[n + k]:.3f}]':>20}{far}"
        )
    lines += ["", f"sum of U widths {s.U.width.sum():.2f} N m (margin {s.margin:.2f}; without margin:"]
    lines += [f"  {name:<32}{fit.U.width.sum():8.2f} N m" for name, fit in c.table.items()]
    lines.append("  ) the first is the chosen case; 'start' restarts predictions only at each trial's start, as the paper does")
    if s.zonotope is not None:
        lines.append(_beside_box(c.table[s.conform], c.table[BOX]))
    for b in narrower(m):
        tube = "" if b.tube_share is None else f"position tube {b.tube:.4f} rad, {b.tube_share:.0%} of the whole's; "
        lines.append(f"  {b.band:<17} {b.at:<20} {tube}U {b.torque:.2f} N m, {b.torque_share:.0%}")
    lines += ["", *table(found.tightness, m.joints)]
    lines += ["", "what fixes the bounds of U:"]
    lines += [
        f"  {a.bound:<28} {a.recording}, from {a.start_s:.3f} s, age {a.age_s:.3f} s, {a.state}"
        for a in s.active if a.bound.startswith("U")
    ]  # fmt: skip
    lines += ["", *(f"note: {x}" for x in m.notes)]
    return "\n".join(lines)


def _beside_box(zonotope: FittedSets, box: FittedSets) -> str:
    """How much a zonotope gains on the data at hand."""
    assert zonotope.template is not None
    share, mean = zonotope.cost / box.cost - 1.0, 1e3 / len(zonotope.template.directions)
    return (
        f"  zonotope of {len(zonotope.inputs.lo) - len(zonotope.template.generators)} generators: mean tube width over the "
        f"joints and the tool's directions {mean * box.cost:.1f} mrad as a box, {mean * zonotope.cost:.1f} mrad as a zonotope "
        f"({share:+.1%})"
    )
