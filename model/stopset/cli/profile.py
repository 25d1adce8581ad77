"""``stopset profile``: is a bus profile right, before the monitor listens with it?"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from stopset.cli.common import add_output_options, check_outputs, say, write_json

if TYPE_CHECKING:
    from stopset.monitor.profile_check import ProfileCheck

HELP = "check a bus profile by itself and against a log of its bus"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", choices=("check",), help="check: frames, bus load, what is missing, what does not fit")
    parser.add_argument("profile", metavar="PROFILE", help="a shipped profile (lwa4p/monitor) or a TOML file")
    parser.add_argument("--log", type=Path, metavar="LOG", help="a candump, ASC, BLF or TRC log of the bus, the arm moving")
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    """0: it can be used; 1: something is wrong."""
    from stopset.monitor.links.logfile import read_log
    from stopset.monitor.profile import load_profile
    from stopset.monitor.profile_check import against_log, check_profile

    check_outputs(args.json, args.report)
    profile = load_profile(args.profile)
    found = check_profile(profile)
    if args.log is not None:
        against_log(found, profile, read_log(args.log))
    _print_answer(found)
    if args.json:
        write_json(args.json, found.plain())
    if args.report:
        _report(found, args.report)
    return int(bool(found.wrong))


def _rows(found: ProfileCheck) -> list[tuple[str, str, str, str]]:
    return [
        (f"0x{f['cob_id']:03X}", str(f["bytes"]), "every SYNC" if f["synchronous"] else "on change", ", ".join(f["carries"]))
        for f in found.frames
    ]


def _print_answer(found: ProfileCheck) -> None:
    say(f"{found.name}: {len(found.frames)} frames a cycle and SYNC, {found.load:.0%} of the bus's time")
    for cob, size, when, carries in _rows(found):
        say(f"  {cob}  {size} bytes  {when:10}  {carries}")
    if found.heard:
        h = found.heard
        say(
            f"  log: {h['sync']} SYNC, {h['cycles']} whole cycles, {h['incomplete_cycles']} incomplete; others: {h['others'] or 'none'}"
        )
    for words in found.wrong:
        say(f"  wrong: {words}")
    for words in found.notes:
        say(f"  note: {words}")
    if not found.wrong:
        say("  nothing is wrong with it" + ("" if found.heard else "; hold it against a --log of the bus too"))


def _report(found: ProfileCheck, path: Path) -> None:
    from stopset.offline.report.page import Page

    page = Page(f"Bus profile {found.name}")
    if found.wrong:
        page.verdict("; ".join(found.wrong), "bad")
    else:
        page.verdict("Nothing is wrong with this profile.", "good")
    page.text(f"A cycle takes {found.load:.0%} of the bus's time. " + " ".join(f"{n[:1].upper()}{n[1:]}." for n in found.notes))
    page.table(("COB-ID", "bytes", "comes", "carries"), _rows(found))
    page.save(path)
    say(f"report {path}")
