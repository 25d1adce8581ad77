"""``stopset watch``: look at a running monitor."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from stopset.cli.common import add_arm_options, end_as_a_service_ends, open_link, say

if TYPE_CHECKING:
    from stopset.monitor.links.zenoh_link import ZenohLink
    from stopset.monitor.viewer import View

OPEN = "  (without a log-in or encryption, for everybody who reaches this address)"
HELP = "live page and terminal view of a running monitor, from zenoh alone"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_arm_options(parser)
    parser.add_argument(
        "--check", action="store_true",
        help="say what holds after --seconds (default 2) and end: exit code 0 for a fresh, valid message of a state that is "
        "not FAULT, INIT or SHUTDOWN, else 1; with --config, for a health check",
    )  # fmt: skip
    parser.add_argument("--host", default="127.0.0.1", help="address of the page (default: this machine only)")
    parser.add_argument("--port", type=int, default=8600, help="port of the page, 0 for none (default: %(default)s)")
    parser.add_argument(
        "--reset-as", metavar="NAME", help="let who sees the page clear a latched violation, with a reason, in this person's name"
    )  # fmt: skip
    parser.add_argument(
        "--reset-key", metavar="FILE", help="sign these orders with this secret key, for a monitor with operators"
    )
    parser.add_argument(
        "--passphrase", nargs="?", const="-", metavar="FILE", help="of this key: asked for, or the first line of FILE"
    )
    parser.add_argument("--seconds", type=float, default=0.0, metavar="S", help="end after this time (default: never)")


def run(args: argparse.Namespace) -> int:
    """Show until Ctrl-C, SIGTERM or ``--seconds``."""
    import sys
    import threading
    import time

    from rich.console import Console
    from rich.live import Live

    from stopset.monitor.viewer import View, ViewerPage, terminal
    from stopset.serving import loopback

    end_as_a_service_ends()
    link, expected = open_link(args)
    view = View(expected=expected)
    view.ask = lambda nonce: link.put("challenge", nonce)
    try:
        for name, take in (
            ("state", view.take_state), ("state/json", view.take_json), ("health", view.take_health), ("event", view.take_event),
        ):  # fmt: skip
            link.subscribe(name, take)
        threading.Thread(target=_hear_model, args=(link, view), daemon=True, name="model").start()
        if args.check:
            return _check(view, args.seconds or 2.0)
        if args.port:
            page = ViewerPage(view, args.host, args.port, _order(link, args), _in_whose_name(args))
            page.start()
            say(f"page: {page.url}{'' if loopback(args.host) else OPEN}")
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
    except KeyboardInterrupt:
        say("")
    finally:
        link.close()
    return 0


def _order(link: ZenohLink, args: argparse.Namespace) -> Callable[[str], None] | None:
    """What the page clears the latch with, in the name of whoever started the viewer; None: it only shows.

    Raises `BusError`, `SigningKeyError`.
    """
    from stopset.cli.sign import asked_passphrase
    from stopset.monitor.operators import Moment, about, look, signed
    from stopset.monitor.orders import Reset

    name, key = args.reset_as, args.reset_key
    if name is None and key is None:
        return None
    who, passphrase = name or "by key", asked_passphrase(args.passphrase, fresh=False)
    first = Reset.of(who, "said now rather than at the first order")
    if key is not None:
        signed(first, Moment(0, 0, 0), key, passphrase)

    def send(reason: str) -> None:
        order, seen = Reset.of(who, reason), look(link)
        order = about(order, seen) if key is None else signed(order, seen, key, passphrase)
        link.put("reset", order.text(), must_arrive=True)

    return send


def _in_whose_name(args: argparse.Namespace) -> str:
    """What stands beside the page's form."""
    if args.reset_key is not None:
        return "signed: the monitor's log will hold the name that belongs to the key"
    return f"in the name of {args.reset_as}, which nothing proves" if args.reset_as else ""


def _hear_model(link: ZenohLink, view: View) -> None:
    """Ask for the model that the monitor speaks of, whenever that is another one, until the session ends."""
    import time

    while True:
        if view.wants_model:
            try:
                for _, data in link.get("model"):
                    view.take_model(data)
            except Exception:  # noqa: BLE001 - the session was closed, in zenoh's own words: there is nothing left to draw
                return
        time.sleep(0.5)


# a daemon that has not heard its arm yet is not healthy: after a bad upgrade it would say that for ever
NOT_WATCHING = ("NO DATA", "FAULT", "INIT", "SHUTDOWN")


def _check(view: View, seconds: float) -> int:
    """Wait for a state that may be believed, at most ``seconds``; exit code."""
    import time

    end = time.monotonic() + seconds
    word, why = view.word()
    while word in NOT_WATCHING and time.monotonic() < end:
        time.sleep(0.02)
        word, why = view.word()
    say(f"{word}  {why}")
    return int(word in NOT_WATCHING)
