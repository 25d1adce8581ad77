"""What several commands share: output options, machine-readable answers, progress on the terminal."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import signal
import sys
import textwrap
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

from stopset.errors import OutputError
from stopset.files import writable, write_text
from stopset.words import is_number

if TYPE_CHECKING:
    from stopset.monitor.consumer import Expected
    from stopset.monitor.links.zenoh_link import ZenohLink

T = TypeVar("T")


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """``--json FILE`` and ``--report FILE.html``."""
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the machine-readable answer here")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write a self-contained page here")
    parser.add_argument("--quiet", action="store_true", help="the answer alone: say nothing on the way")


def add_robot_options(parser: argparse.ArgumentParser) -> None:
    """``--tip FRAME`` and ``--lock J,K``: which chain of a URDF is the arm."""
    parser.add_argument(
        "--tip", metavar="FRAME", help="link or joint of the URDF that is the tool point, and so the last of the chain"
    )
    parser.add_argument(
        "--lock", metavar="J,K", type=lambda text: tuple(text.split(",")), default=(), help="joints that stand still at zero (fingers, a lift)"
    )  # fmt: skip


def add_condition_options(parser: argparse.ArgumentParser) -> None:
    """``--condition KEY=VALUE@FILE``, as often as wanted."""
    parser.add_argument(
        "--condition", action="append", default=[], metavar="KEY=VALUE@FILE",
        help="what holds for a recording (payload=2.8@a.parquet; without @FILE for all); several conditions are not taken as one",
    )  # fmt: skip


def add_keep_options(parser: argparse.ArgumentParser) -> None:
    """``--keep FILE.state`` and ``--keep-as``."""
    parser.add_argument(
        "--keep", type=Path, metavar="FILE.state", help="keep what later recordings can be added to (identify --update)"
    )
    parser.add_argument(
        "--keep-as", choices=("signals", "sums"), default="signals",
        help="signals (default): all recordings, compressed; an update is then the same as identifying from all of them. sums: "
        "constant size for campaigns without end; an update then keeps the nominal model",
    )  # fmt: skip


def add_arm_options(parser: argparse.ArgumentParser) -> None:
    """Which arm's monitor, where, and what is believed of it."""
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", metavar="ENDPOINT", help="zenoh (default: %(default)s)")
    parser.add_argument("--arm", default="site/cell/arm", metavar="SITE/CELL/ARM", help="which arm (default: %(default)s)")
    parser.add_argument(
        "--config", type=Path, metavar="C.toml",
        help="the monitor's own configuration: only messages of its data id, model, configuration and keys are believed",
    )  # fmt: skip
    parser.add_argument("--zenoh", metavar="FILE.json5", help="zenoh configuration (TLS) instead of --connect")


def open_link(args: argparse.Namespace) -> tuple[ZenohLink, Expected | None]:
    """The session that `add_arm_options` asks for, and what to expect of the monitor; raises `BusError`."""
    from stopset.monitor.links.zenoh_link import ZenohLink

    arm, connect, file, expected = f"{args.arm}/stopset", [args.connect], args.zenoh, None
    if args.config:
        from stopset.monitor.authentication import load_keys
        from stopset.monitor.config import load_config
        from stopset.monitor.consumer import Expected
        from stopset.monitor.service import trusted

        c = load_config(args.config)
        arm, file = c.prefix, c.zenoh.file or None
        connect = [*c.zenoh.listen, *c.zenoh.connect] if c.zenoh.mode == "peer" else list(c.zenoh.connect)
        expected = Expected.of(c.data_id, trusted(c)().sha256, c.sha256, load_keys(c.keys) if c.keys else None)
    return ZenohLink(arm, mode="client", connect=[] if file else connect, file=file), expected


def end_as_a_service_ends() -> None:
    """From here on SIGTERM, by which a service is ended, is Ctrl-C: what waits is written, what was asked for at the end is given."""
    if threading.current_thread() is threading.main_thread():  # nobody else may set it
        signal.signal(signal.SIGTERM, signal.default_int_handler)


def check_outputs(*paths: str | Path | None) -> None:
    """Refuse impossible output places before any work is done; raises `OutputError`."""
    for p in paths:
        if p is not None:
            writable(p)


# what a command may write, by option; everything else that names a file is read
OUTPUTS = ("out", "json", "report", "csv", "pdf", "keep", "mcap")


def check_distinct(args: argparse.Namespace) -> None:
    """Refuse to write over what the same command reads or writes besides; raises `OutputError`."""
    named: dict[Path, str] = {}
    for name, value in sorted(vars(args).items(), key=lambda item: item[0] in OUTPUTS):
        for p in value if isinstance(value, list) else [value]:
            if not isinstance(p, str | Path) or (name not in OUTPUTS and not _is_file(p)):
                continue
            target, option = Path(p).absolute().resolve(), f"--{name.replace('_', '-')}"
            if name == "state":
                continue  # what is kept may take the place of what it continues
            if name in OUTPUTS and target in named:
                raise OutputError(f"{option} {p} is also {named[target]}; expected a file of its own: choose another name")
            named[target] = f"the place of {option}" if name in OUTPUTS else "read by this command"


def _is_file(p: str | Path) -> bool:
    try:
        return Path(p).is_file()
    except (OSError, ValueError):  # no name a file could have
        return False


def write_json(path: str | Path, data: Any) -> None:
    """Write ``data`` as JSON (no NaN or infinity: they are not JSON)."""
    write_text(path, json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def listed(lines: Sequence[str], what: str, *, whole: bool) -> None:
    """Lines of a list that not everybody wants: all of them if ``whole``, else how many there are."""
    if whole or len(lines) == 1:
        for line in lines:
            say(f"{what}: {line}")
    elif lines:
        say(f"{what}: {len(lines)}, --all lists them")


def open_missing_streams() -> None:
    """Standard streams that whoever started this process has closed, opened on nothing.

    Else the next file or socket gets their number, and what a library says on standard error goes into that.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # noqa: FBT003 - the lowest free number is this one
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115 - as long as the process


def say(text: str) -> None:
    """A line of the command's answer for people, broken where the window ends."""
    sys.stdout.write(broken(text, sys.stdout) + "\n")
    sys.stdout.flush()


def mention(text: str) -> None:
    """The same of a command that goes on where nobody takes its words: the reader has died, or the disk behind is full."""
    try:
        say(text)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left unsaid would be tried again at the end


def complain(text: str) -> None:
    """Why there is no answer, in one sentence, broken where the window ends."""
    with contextlib.suppress(OSError):  # nobody takes it; the exit code says it too
        sys.stderr.write(broken(f"stopset: {text}", sys.stderr) + "\n")


def broken(text: str, stream: TextIO, inner: int | None = None) -> str:
    """``text`` in lines no longer than the window of ``stream``, if it has one; ``inner``: blanks before all but the first."""
    if not stream.isatty() or len(text) <= (room := shutil.get_terminal_size().columns):
        return text
    blanks = " " * (len(text) - len(text.lstrip()) + 4 if inner is None else inner)
    return "\n".join(textwrap.wrap(text, max(room, 40), subsequent_indent=blanks, drop_whitespace=False) or [text])


def path_rows(path: Path, n: int) -> Any:
    """(W, n) [rad] from a CSV file; a first line that is no numbers is a head. Raises `NotCovered`."""
    import csv

    import numpy as np

    from stopset.errors import NotCovered

    try:
        lines = [r for r in csv.reader(path.read_text().splitlines()) if r]
    except (OSError, UnicodeDecodeError) as e:
        raise NotCovered(f"{path} cannot be read ({e}); expected a CSV file with {n} angles a row") from e
    try:
        head = 0 if lines and all(is_number(x) for x in lines[0]) else 1
        values = [[float(x) for x in r] for r in lines[head:]]
    except ValueError as e:
        raise NotCovered(
            f"{path} holds rows that are not {n} numbers ({e}); expected {n} angles [rad] a row: give only these"
        ) from e
    wrong = next((r for r in values if len(r) != n), None)
    if wrong is not None:
        raise NotCovered(f"{path} holds a row of {len(wrong)} numbers; expected {n} angles [rad] a row: give one for every joint")
    return np.array(values).reshape(-1, n)
