"""``stopset fleet``: many arms at a glance."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from stopset.cli.common import check_outputs, end_as_a_service_ends, say, write_json

HELP = "all arms of a router at a glance: one line or tile each, discovered by themselves"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", metavar="ENDPOINT", help="zenoh router (default: %(default)s)")
    parser.add_argument("--zenoh", metavar="FILE.json5", help="zenoh configuration (TLS) instead of --connect")
    parser.add_argument(
        "--arms", default="*/*/*", metavar="SITE/CELL/ARM", help="which ones; * stands for any (default: %(default)s)"
    )
    parser.add_argument("--host", default="127.0.0.1", help="address of the page (default: this machine only)")
    parser.add_argument("--port", type=int, default=8620, help="port of the page, 0 for none (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=0.0, metavar="S", help="end after this time (default: never)")
    parser.add_argument("--record", type=Path, metavar="FOLDER", help="record what all arms say (MCAP), an hour to a file")
    parser.add_argument("--keep-mb", type=float, default=10_000.0, metavar="MB", help="of it at most this (default: %(default)g)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="at the end, write what held of every arm here")


def run(args: argparse.Namespace) -> int:
    """Look until Ctrl-C, SIGTERM or ``--seconds``; exit code 1 if no arm was found."""
    import sys
    import time

    from rich.console import Console
    from rich.live import Live

    from stopset.errors import BusError
    from stopset.monitor.fleet import Fleet, FleetPage, terminal
    from stopset.monitor.fleet.central import TOPICS, Central
    from stopset.monitor.links.zenoh_link import ZenohLink

    check_outputs(args.json)
    end_as_a_service_ends()
    if not re.fullmatch(r"[^/#?$]+/[^/#?$]+/[^/#?$]+", args.arms):
        raise BusError(f"--arms {args.arms!r}; expected SITE/CELL/ARM, each a name or *, like hall3/*/*: write it so")
    if not args.keep_mb > 0:
        raise BusError(f"--keep-mb {args.keep_mb:g}; expected megabytes, more than 0: say how much of the recording is kept")
    link = ZenohLink(mode="client", connect=[] if args.zenoh else [args.connect], file=args.zenoh)
    central = Central(args.record, keep_mb=args.keep_mb) if args.record else None
    fleet = Fleet(notice=str if central is None else lambda: central.notice)
    try:
        if central is not None:
            for name in TOPICS:
                link.subscribe(f"{args.arms}/stopset/{name}", central.take)
        link.watch_alive(f"{args.arms}/stopset/alive", fleet.take_alive)
        link.subscribe(f"{args.arms}/stopset/state/json", fleet.take_json)
        if args.port:
            page = FleetPage(fleet, args.host, args.port)
            page.start()
            say(f"page: {page.url}")
        end = time.monotonic() + (args.seconds or float("inf"))
        if sys.stdout.isatty():
            with Live(terminal(fleet), refresh_per_second=4) as live:
                while time.monotonic() < end:
                    time.sleep(0.25)
                    live.update(terminal(fleet, max(5, live.console.height - 5)))
        else:
            while time.monotonic() < end:
                time.sleep(min(0.2, max(0.0, end - time.monotonic())))
            Console().print(terminal(fleet, 1000))
    except KeyboardInterrupt:
        say("")
    finally:
        link.close()
        if central is not None:
            central.close()
    shot = fleet.snapshot(1_000_000)
    if central is not None:
        shot["record"] = central.report()
        say(f"recorded: {central.written} messages in {central.files} files in {args.record}, {central.lost} lost")
    if args.json:
        write_json(args.json, shot)
    return 0 if shot["arms"] else 1
