"""``stopset workbench``: the loop compare, diagnose, add as a web page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from stopset.cli.common import add_condition_options

if TYPE_CHECKING:
    from stopset.artifact import Model
    from stopset.progress import Progress

HELP = "compare, diagnose and add on one web page"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("model", metavar="M", help="model file")
    parser.add_argument("--data", required=True, nargs="+", metavar="REC", help="recordings, Parquet or CSV")
    add_condition_options(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for new revisions (default: beside the model)")
    parser.add_argument("--host", default="127.0.0.1", help="address of the page; it has no log-in (default: this machine only)")
    parser.add_argument("--port", type=int, default=8610, help="port of the page, 0 for a free one (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=0.0, metavar="S", help="end after this time (default: never)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="at the end, write every answer given so far here")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="at the end, write the history of the last model here")


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C, SIGTERM or ``--seconds``."""
    import time

    from stopset.cli.common import check_outputs, end_as_a_service_ends, say, write_json
    from stopset.files import write_text
    from stopset.offline.workbench import Loop, Server

    check_outputs(args.json, args.report)
    end_as_a_service_ends()
    loop = Loop(args.model, args.data, args.out or Path(args.model).parent, fmu, args.condition)
    server = Server(loop, args.host, args.port)
    server.start()
    loop.attend()
    say(f"workbench: {server.url}  (Ctrl-C ends it)")
    end = time.monotonic() + (args.seconds or float("inf"))
    try:
        while time.monotonic() < end:
            time.sleep(min(0.2, max(0.0, end - time.monotonic())))
    except KeyboardInterrupt:
        say("")
    finally:
        server.shutdown()
        server.server_close()
        loop.close()
    if args.json:
        write_json(args.json, loop.snapshot())
    if args.report:
        write_text(args.report, loop.report("history") or "")
        say(f"report {args.report}")
    return 0


def fmu(model: Model, target: Path, progress: Progress) -> None:
    """Write ``model`` as FMU, as the workbench's worker is told to."""
    from stopset.fmu import export

    export(model, target, say=progress)
