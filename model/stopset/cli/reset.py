"""``stopset reset``: clear a latched violation, by a person and for a reason."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import add_arm_options, open_link, say

HELP = "clear a latched violation of a running monitor, with a name and a reason"
WAIT_S = 3.0  # [s] for the monitor's word that it has


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    add_arm_options(parser)
    parser.add_argument("--name", help="who clears it; stands in the monitor's event and journal, unless --key says who it is")
    parser.add_argument("--key", type=Path, metavar="FILE", help="secret key of an operator of the monitor: the order is signed")
    parser.add_argument(
        "--passphrase", nargs="?", const="-", metavar="FILE",
        help="the key's passphrase: asked for on the terminal, or the first line of FILE",
    )  # fmt: skip
    parser.add_argument("--reason", required=True, help="why it may be cleared: what was found, what was done")


def run(args: argparse.Namespace) -> int:
    """Send the order and wait for the answer; exit code 1 where none comes."""
    import queue
    import time

    import msgspec

    from stopset.cli.sign import asked_passphrase
    from stopset.errors import BusError
    from stopset.monitor.operators import about, look, signed
    from stopset.monitor.orders import Reset
    from stopset.monitor.viewer.events import Event
    from stopset.monitor.viewer.words import plain

    if args.name is None and args.key is None:
        raise BusError("neither --name nor --key was given; expected who clears it: give the name, or the key that proves it")
    order = Reset.of("by key" if args.name is None else args.name, args.reason)
    passphrase = asked_passphrase(args.passphrase, fresh=False)
    heard: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    link, _ = open_link(args)
    try:
        link.subscribe("event", lambda _, data: heard.put(data))
        time.sleep(0.5)  # subscriptions travel before the order does
        seen = look(link)
        order = about(order, seen) if args.key is None else signed(order, seen, args.key, passphrase)
        link.put("reset", order.text(), must_arrive=True)
        end = time.monotonic() + WAIT_S
        while (left := end - time.monotonic()) > 0:
            try:
                event = msgspec.json.decode(heard.get(timeout=left), type=Event)
            except (queue.Empty, msgspec.MsgspecError):
                continue
            if event.kind == "reset" and event.reason == order.reason and (event.key or event.name) == (order.key or order.name):
                say(f"cleared, {plain(event.line())}; what is violated again is latched again")
                return 0
            if event.kind == "reset_refused":
                say(f"refused: {plain(event.why)}")
                return 1
    finally:
        link.close()
    say(f"no monitor has answered within {WAIT_S:g} s; expected the event `reset`: look with `stopset watch` whether it lives")
    return 1
