"""``stopset stops``: how far and how long, as tables for the safety file or for one pose."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HELP = "stop-time and stop-distance tables: STOP 0, 1 (nominal and guaranteed) and 2; or one pose with --at"
FEW = 24  # rows that are listed unasked: one pose, all joints, all categories


def add_arguments(parser: argparse.ArgumentParser) -> None:
    from stopset.cli.common import add_output_options

    parser.add_argument("model", help="model file from `stopset identify`")
    parser.add_argument(
        "--poses", type=int, metavar="N", help="rows of the table: the worst of N poses near their extension; default 1"
    )
    parser.add_argument("--at", metavar="Q1,Q2,..", help="one pose [rad] instead of the table, all axes at once")
    parser.add_argument("--speed", metavar="V1,V2,..", help="with --at: speeds [rad/s], or one percentage like 100%%")
    parser.add_argument(
        "--path", type=Path, metavar="CSV", help="STOP 1 that stays on the path through these rows of angles [rad]"
    )
    parser.add_argument("--path-rate", type=float, metavar="R", help="with --path: rows passed per second at the stop request")
    parser.add_argument(
        "--path-start", type=float, metavar="S", help="with --path: row (a fraction too) of the request; default 0"
    )
    parser.add_argument("--payload", type=float, metavar="KG", help="payload [kg] instead of 33/66/100 %% of the largest")
    parser.add_argument("--rated-payload", type=float, metavar="KG", help="what 100 %% payload means; default the model's domain")
    parser.add_argument("--extrapolate-payload", action="store_true", help="compute payloads no recording carried, and mark them")
    parser.add_argument(
        "--extrapolate-state", action="store_true", help="compute angles and speeds no recording has seen, and mark them"
    )
    parser.add_argument("--payload-at", metavar="X,Y,Z", help="its centre in the last link [m]; default the flange")
    parser.add_argument("--category", action="append", choices=("0", "1", "1 guaranteed", "2"), help="only this one; repeatable")
    parser.add_argument("--ramp-time", type=float, metavar="S", help="STOP 1 and 2: every speed to rest in this time [s]")
    parser.add_argument("--ramp-deceleration", type=float, metavar="A", help="or: with this deceleration [rad/s^2]")
    parser.add_argument("--off-after", type=float, metavar="S", help="SS1-t: power is taken this long after the request [s]")
    parser.add_argument("--monitored", action="store_true", help="SS1-r: the ramp is monitored")
    parser.add_argument(
        "--failed-speed", type=float, default=100.0, metavar="PERCENT",
        help="of the speed at the request that a failed ramp can reach; above 100 if drives may accelerate (default 100)",
    )  # fmt: skip
    parser.add_argument("--fail-together", action="store_true", help="failed ramps keep the path, as when the controller fails")
    parser.add_argument("--all", action="store_true", help="list every row of the table, not the worst of each axis")
    parser.add_argument("--data", nargs="+", metavar="REC", help="recordings whose measured stops are drawn into the pictures")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the rows as CSV")
    parser.add_argument("--pdf", type=Path, metavar="FILE", help="write tables and pictures as PDF")
    group = parser.add_argument_group("separation distance (ISO/TS 15066 and ISO 13855); every term must be given")
    group.add_argument("--separation", action="store_true", help="compute it for the worst stop of each category")
    group.add_argument("--v-human", type=float, metavar="M/S")
    group.add_argument("--reaction", type=float, metavar="S", help="from detection of the person to the stop request")
    group.add_argument("--intrusion", type=float, metavar="M", help="C")
    group.add_argument("--person-uncertainty", type=float, metavar="M", help="Z_d")
    group.add_argument("--robot-uncertainty", type=float, metavar="M", help="Z_r")
    group.add_argument("--device-distance", type=float, metavar="M", help="D_DS of ISO 13855:2024, with --supplement")
    group.add_argument("--supplement", type=float, metavar="M", help="Z of ISO 13855:2024")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    from stopset.cli.common import check_outputs, say, write_json
    from stopset.errors import OutputError
    from stopset.files import write_bytes, write_text
    from stopset.offline.description.older import load_model
    from stopset.offline.stops.measured import measured_stops
    from stopset.offline.stops.page import build_page
    from stopset.offline.stops.table import as_csv, loads, prepared
    from stopset.recording import read_recordings

    check_outputs(args.json, args.report, args.csv, args.pdf)
    if args.data and not (args.report or args.pdf):
        raise OutputError("--data draws measured stops into pictures; add --report FILE.html or --pdf FILE")
    model = load_model(args.model)
    recordings = list(read_recordings(args.data, model.robot)) if args.data else []
    terms = _terms(args)
    rows, assumptions, question = _answer(args, model)
    separations = _separations(terms, rows) if args.separation else []
    if args.json:
        write_json(args.json, [r.as_json() for r in rows])
    if args.csv:
        write_text(args.csv, as_csv(rows))
    if args.report or args.pdf:
        measured = []
        if recordings:
            kg = loads(model, question)[-1][1]
            measured = measured_stops(prepared(model, kg, question), recordings)
        if args.report:
            build_page(model, rows, assumptions, measured, separations).save(args.report)
        if args.pdf:
            from stopset.offline.stops.safety_file import build_pdf  # what sets pages takes half a second to load

            write_bytes(args.pdf, build_pdf(model, rows, assumptions, measured, separations))
    _print(model, rows, assumptions, separations, say, whole=args.all)
    return 0 if any(r.answered for r in rows) else 1


def _answer(args: argparse.Namespace, model: Any) -> tuple[list[Any], Sequence[str], Any]:
    from stopset.cli.common import path_rows
    from stopset.cli.steps import steps
    from stopset.errors import NotCovered
    from stopset.offline.stops.table import Question, along_path, at_pose, stop_table, top_speed
    from stopset.reach.stops import CATEGORIES, Ramp, ramp_of
    from stopset.reach.stops.start import Extrapolation

    ramp = None
    if args.ramp_time is not None or args.ramp_deceleration is not None:
        ramp = Ramp.stated(model.n, time=args.ramp_time, deceleration=args.ramp_deceleration)
    elif args.off_after is not None or args.monitored or args.fail_together or args.failed_speed != 100.0:
        ramp = ramp_of(model)
        if ramp is None:
            raise NotCovered(
                "--off-after, --monitored, --failed-speed and --fail-together say how a ramp fails, and the model holds none; expected "
                "one: add --ramp-time or --ramp-deceleration, or identify it from stop1 recordings"
            )
    if ramp is not None:
        ramp = ramp.failing(
            args.off_after, monitored=args.monitored, share=args.failed_speed / 100.0, together=args.fail_together
        )
    com = _numbers(args.payload_at, 3, "--payload-at") if args.payload_at else None
    categories = tuple(c for c in CATEGORIES if not args.category or c in args.category)
    beyond = Extrapolation(args.extrapolate_payload, args.extrapolate_state)
    if args.poses is not None and (args.path is not None or args.at is not None):
        raise NotCovered(
            "--poses is how many poses a row of the table is the worst of; with --at or --path there is one: leave it out"
        )
    poses = 1 if args.poses is None else args.poses
    question = Question(ramp, categories, args.payload, com, args.rated_payload, beyond, poses)
    if args.path is not None:
        if args.at is not None or args.speed is not None or args.path_rate is None:
            raise NotCovered("--path needs --path-rate, the rows passed per second at the stop request, and no --at nor --speed")
        if args.category and "1" not in args.category:
            raise NotCovered(
                f"--path with --category {args.category[0]}; expected 1, the stop that keeps to the path: leave it out"
            )
        rows, bounds = along_path(model, path_rows(args.path, model.n), args.path_start or 0.0, args.path_rate, question)
        return rows, bounds["1"].assumptions, question
    if args.path_rate is not None or args.path_start is not None:
        raise NotCovered("--path-rate and --path-start belong to a path; give --path FILE.csv too")
    if args.at is None:
        if args.speed is not None:
            raise NotCovered("--speed belongs to a pose; give --at Q1,Q2,.. too")

        with steps("stops", quiet=args.quiet) as progress:
            table = stop_table(model, question, progress)
        return list(table.rows), table.assumptions, question
    q = _numbers(args.at, model.n, "--at")
    if args.speed is None:
        raise NotCovered("--at needs --speed: the speeds of all axes [rad/s], or a percentage like 100%")
    if args.speed.strip().endswith("%"):
        percent = float(_numbers(args.speed.strip()[:-1], 1, "--speed")[0])
        if not 0.0 <= percent <= 100.0:
            raise NotCovered(
                f"--speed {percent:g}% is beyond what 100 % means; expected 0 to 100 %: give signed speeds in rad/s instead"
            )
        dq = top_speed(model) * percent / 100.0
    else:
        dq = _numbers(args.speed, model.n, "--speed")
    rows, bounds = at_pose(model, q, dq, question)
    assumptions = next((b.assumptions for b in bounds.values() if b.assumptions), ())
    return rows, assumptions, question


def _numbers(text: str, count: int, option: str) -> Any:
    import numpy as np

    from stopset.errors import NotCovered

    try:
        values = np.array([float(x) for x in text.split(",")])
    except ValueError as e:
        raise NotCovered(f"{option} {text!r} are not numbers; expected {count}, separated by commas") from e
    if values.shape != (count,) or not np.all(np.isfinite(values)):
        raise NotCovered(f"{option} has {values.size} numbers; expected {count} finite ones, separated by commas")
    return values


def _terms(args: argparse.Namespace) -> dict[str, float | None]:
    """The separation distance's terms as given; what is missing is told before the work."""
    from stopset.errors import NotCovered
    from stopset.offline.stops.separation import approach_distance_2024, protective_separation

    given = {
        "v_h": args.v_human, "T_r": args.reaction, "C": args.intrusion, "Z_d": args.person_uncertainty,
        "Z_r": args.robot_uncertainty, "D_DS": args.device_distance, "Z": args.supplement,
    }  # fmt: skip
    if args.separation:
        protective_separation(0.0, 0.0, 0.0, given)
        if given["D_DS"] is not None or given["Z"] is not None:
            approach_distance_2024(0.0, given)
    elif any(v is not None for v in given.values()):
        raise NotCovered("terms of a separation distance were given without --separation; add it")
    return given


def _separations(given: dict[str, float | None], rows: Sequence[Any]) -> list[Any]:
    from dataclasses import replace

    from stopset.errors import NotCovered
    from stopset.offline.stops.separation import approach_distance, approach_distance_2024, protective_separation

    out = []
    for category in dict.fromkeys(r.category for r in rows):
        mine = [r for r in rows if r.category == category]
        if not all(r.answered for r in mine):
            continue  # the worst of them has no number
        time, distance, speed = max(r.time_s for r in mine), max(r.far_m for r in mine), max(r.far_speed for r in mine)
        found = [protective_separation(time, distance, speed, given), approach_distance(time, given)]
        if given["D_DS"] is not None or given["Z"] is not None:
            found.append(approach_distance_2024(time, given))
        beyond = any(r.extrapolated for r in mine)
        out += [replace(s, category=category, extrapolated=beyond) for s in found]
    if not out:
        raise NotCovered(
            "in no category all stops of these rows are proved, so there is no separation distance; see their reasons"
        )
    return out


def _print(
    model: Any, rows: Sequence[Any], assumptions: Sequence[str], separations: Sequence[Any], say: Any, *, whole: bool
) -> None:
    """The answer; the worst stop of each axis, or every row; each remark of the rows once; what the numbers rest on."""
    from stopset.offline.stops.shown import answered, extrapolations, refusals, up
    from stopset.offline.stops.table import holding

    say(answered(rows))
    (_rows if whole or len(rows) <= FEW else _worst)(rows, say)
    for part, k in refusals(rows).items():
        say(f"[{k}] {part}")
    if beyond := extrapolations(rows):
        say(beyond)
    for s in separations:
        mark = " EXTRAPOLATED," if s.extrapolated else ""
        say(f"separation distance,{mark} {s.standard}, STOP {s.category}: {up(s.distance, 3)} m")
        for symbol, value, unit, what in s.terms:
            say(f"  {symbol:<4} {up(value, 4):>9} {unit:<4} {what}")
    for sentence in holding(model, rows):
        say(sentence)
    for a in assumptions:
        say(f"- {a}")
    say("Monitoring aid, not a safety function: stop distances for a risk assessment must be measured.")


def _worst(rows: Sequence[Any], say: Any) -> None:
    """Of each category and axis the longest time, angle and way of all rows."""
    from stopset.offline.stops.shown import worst

    lines = list(worst(rows))
    wide = max(len(axis) for _, axis, *_ in lines) + 2
    say(f"{'category':<13}{'axis':<{wide}}{'time s':>8}{'angle rad':>11}{'TCP m':>8}  proved")
    for category, axis, time, angle, tcp, proved in lines:
        say(f"{category:<13}{axis:<{wide}}{time:>8}{angle:>11}{tcp:>8}  {proved}")
    say(f"the longest of {len(rows)} rows; --all lists each by speed, payload and extension, --csv and --report write them")


def _rows(rows: Sequence[Any], say: Any) -> None:
    """Every row, with what it says of itself as numbers; a category without any number in one line."""
    from stopset.offline.stops.shown import axis_name, refusals, remarks, up

    wide = max(len(axis_name(r.joint)) for r in rows) + 2
    number = refusals(rows)
    say(f"{'category':<13}{'axis':<{wide}}{'speed %':>8}{'load kg':>8}{'ext. %':>7}{'time ms':>9}{'angle rad':>11}{'TCP mm':>9}")
    for category in dict.fromkeys(r.category for r in rows):
        mine = [r for r in rows if r.category == category]
        refused = not any(r.answered for r in mine)
        for r in mine[:1] if refused else mine:
            at = f"{axis_name(r.joint):<{wide}}{r.speed_percent:>8.0f}{r.payload:>8.3g}{r.extension_percent:>7.0f}"
            shown = (
                [up(x, d) for x, d in ((1e3 * r.time_s, 1), (r.angle_rad, 4), (1e3 * r.tcp_m, 1))] if r.answered else ["-"] * 3
            )
            numbers = "".join(f"{x:>{width}}" for x, width in zip(shown, (9, 11, 9), strict=True))
            said = dict.fromkeys(part for x in (mine if refused else [r]) for part in remarks(x))
            marks = " ".join(f"[{number[part]}]" for part in said)
            beyond = "EXTRAPOLATED " if r.extrapolated else ""
            say(f"{category:<13}{'every row' if refused else at:<{wide + 23}}{numbers}  {beyond}{marks}".rstrip())
