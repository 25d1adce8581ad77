"""``stopset watch``: look at a running monitor."""

from __future__ import annotations

import argparse

HELP = "live page and terminal view of a running monitor, from zenoh alone"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", metavar="ENDPOINT", help="zenoh (default: %(default)s)")
    parser.add_argument("--arm", default="site/cell/arm", metavar="SITE/CELL/ARM", help="which arm (default: %(default)s)")
    parser.add_argument("--zenoh", metavar="FILE.json5", help="zenoh configuration (TLS) instead of --connect")
    parser.add_argument("--host", default="127.0.0.1", help="address of the page (default: this machine only)")
    parser.add_argument("--port", type=int, default=8600, help="port of the page, 0 for none (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=0.0, metavar="S", help="end after this time (default: never)")


def run(args: argparse.Namespace) -> int:
    import sys
    import time

    from rich.console import Console
    from rich.live import Live

    from stopset.cli.common import say
    from stopset.errors import BusError
    from stopset.monitor.links.zenoh_link import ZenohLink
    from stopset.monitor.viewer import Page, View, terminal

    view = View()
    link = ZenohLink(f"{args.arm}/stopset", mode="client", connect=[] if args.zenoh else [args.connect], file=args.zenoh)
    try:
        for name, take in (
            ("state", view.take_state), ("state/json", view.take_json), ("health", view.take_health), ("event", view.take_event),
        ):  # fmt: skip
            link.subscribe(name, take)
        if args.port:
            try:
                page = Page(view, args.host, args.port)
            except (OSError, OverflowError) as e:
                raise BusError(
                    f"the page cannot be served on {args.host}:{args.port} ({e}); choose another --host or --port"
                ) from e
            page.start()
            say(f"page: http://{args.host}:{args.port}/")
        end = time.monotonic() + (args.seconds or float("inf"))
        if sys.stdout.isatty():
            with Live(terminal(view), refresh_per_second=5) as live:
                while time.monotonic() < end:
                    time.sleep(0.2)
                    live.update(terminal(view))
        else:
            shown = ""
            while time.monotonic() < end:
                time.sleep(0.1)
                line = "  ".join(view.word())
                if line != shown:
                    say(line)
                    shown = line
            Console().print(terminal(view))
    finally:
        link.close()
    return 0
