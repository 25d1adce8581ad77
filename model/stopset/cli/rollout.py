"""``stopset rollout``: a signed model for many arms, one of them first."""

from __future__ import annotations

import argparse
import dataclasses
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING

from stopset.cli.common import add_output_options, check_outputs, say, write_json

if TYPE_CHECKING:
    from stopset.monitor.fleet.rollout import Taken

HELP = "bring a signed model to many arms, one first and watched; the first that gets worse ends it"
FOUND = 2.0  # [s] in which arms are found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", type=Path, metavar="M", help="model file, with M.sig beside it")
    parser.add_argument("--canary", required=True, metavar="SITE/CELL/ARM", help="the arm that gets it first")
    parser.add_argument("--arms", default="", metavar="SITE/CELL/ARM", help="the others; * stands for any (default: none)")
    parser.add_argument(
        "--deliver", required=True, metavar="COMMAND",
        help="brings the file to one arm and has it read; {model} {signature} {site} {cell} {arm} are filled in, like "
        "'./deliver.sh {cell} {model} {signature}'",
    )  # fmt: skip
    parser.add_argument(
        "--back", type=Path, metavar="OLD", help="if it ends early: bring this model to the arms that have the new one"
    )
    parser.add_argument(
        "--watch-s", type=float, default=600.0, metavar="S", help="how long the first arm is watched (default: %(default)g)"
    )
    parser.add_argument(
        "--each-s", type=float, default=20.0, metavar="S", help="how long every other one is (default: %(default)g)"
    )
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", metavar="ENDPOINT", help="zenoh router (default: %(default)s)")
    parser.add_argument("--zenoh", metavar="FILE.json5", help="zenoh configuration (TLS) instead of --connect")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """Roll out; exit code 1 if it ended early."""
    from stopset.artifact import load_model
    from stopset.artifact.signature import signature_path
    from stopset.errors import BusError, ModelFileError
    from stopset.monitor.fleet import Fleet
    from stopset.monitor.fleet.rollout import Patience, Reloads, Rollout, delivery
    from stopset.monitor.links.zenoh_link import ZenohLink

    check_outputs(args.json, args.report)
    for option, name in (("--canary", args.canary), ("--arms", args.arms or args.canary)):
        if not re.fullmatch(r"[^/#?$]+/[^/#?$]+/[^/#?$]+", name) or (option == "--canary" and "*" in name):
            raise BusError(f"{option} {name!r}; expected SITE/CELL/ARM{', one arm' if option == '--canary' else ''}: write it so")
    for option, seconds in (("--watch-s", args.watch_s), ("--each-s", args.each_s)):
        if not 0.0 < seconds < 1e6:
            raise BusError(f"{option} {seconds:g}; expected seconds, more than 0: name how long an arm is watched")
    models = {path: load_model(path) for path in (args.model, args.back) if path}
    for path in models:
        delivery(args.deliver, path, args.canary)
        if not signature_path(path).is_file():
            raise ModelFileError(f"{path} is not signed; expected {signature_path(path).name} beside it: `stopset sign` makes it")
    link = ZenohLink(mode="client", connect=[] if args.zenoh else [args.connect], file=args.zenoh)
    fleet, reloads = Fleet(), Reloads()
    try:
        for arms in {args.canary, args.arms or args.canary}:
            link.watch_alive(f"{arms}/stopset/alive", fleet.take_alive)
            link.subscribe(f"{arms}/stopset/state/json", fleet.take_json)
            link.subscribe(f"{arms}/stopset/event", reloads.take)
        time.sleep(FOUND)
        found = sorted(r["arm"] for r in fleet.rows())
        patience = Patience(canary=args.watch_s, each=args.each_s)
        progress = (lambda _: None) if args.quiet else say
        roll = Rollout(fleet, reloads, args.model, models[args.model].sha256, args.deliver, patience, progress)
        done = roll.run(found, args.canary)
        back = []
        if done[-1].why and args.back:
            say(f"{done[-1].arm}: {done[-1].why}; {args.back.name} is brought back")
            old = dataclasses.replace(
                roll, model=args.back, sha256=models[args.back].sha256, patience=Patience(canary=args.each_s)
            )
            new = [t.arm for t in done if (fleet.row(t.arm) or {}).get("model") == roll.sha256[:16]]
            back = [t for arm in new for t in old.run([], arm)]
    finally:
        link.close()
    return _answered(args, found, done, back)


def _answered(args: argparse.Namespace, found: list[str], done: list[Taken], back: list[Taken]) -> int:
    last = done[-1]
    new = [t.arm for t in done if not t.why]
    waiting = [a for a in found if a not in {t.arm for t in done}]
    if last.why:
        text = f"ended at {last.arm}: {last.why}; {len(new)} arms took {args.model.name}, {len(waiting)} were not asked"
    else:
        text = f"{len(new)} arms took {args.model.name}, none says worse than before"
    if args.back and last.why:
        returned = sum(not t.why for t in back)
        text += f"; {args.back.name} is back on {returned} of {len(back)} that had the new one"
    say(text)
    rows = {"taken": [dataclasses.asdict(t) for t in done], "back": [dataclasses.asdict(t) for t in back], "not_asked": waiting}
    if args.json:
        write_json(args.json, {"done": not last.why, "why": last.why, **rows})
    if args.report:
        from stopset.artifact import load_model
        from stopset.offline.report.page import Page

        page = Page(f"Roll-out of {args.model.name}", load_model(args.model))
        page.verdict(text, "bad" if last.why else "good")
        page.table(("arm", "seen with it", "what was wrong"), [(t.arm, _looks(t), t.why) for t in (*done, *back)])
        page.save(args.report)
    return 1 if last.why else 0


def _looks(t: Taken) -> str:
    return ", ".join(f"{n} x {word}" for word, n in t.looks.items())
