"""The command line: one file per command in this folder, found by name and imported only when asked for."""

from __future__ import annotations

import argparse
import contextlib
import errno
import importlib
import os
import pkgutil
import sys
import traceback
from collections.abc import Sequence
from types import ModuleType
from typing import Any, NoReturn

from stopset import cli
from stopset.cli.common import broken, check_distinct, complain, open_missing_streams
from stopset.errors import StopsetError

# matrices here are small: threads of the linear algebra library would only wait for each other
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")

NOT_COMMANDS = {"main", "common", "steps", "story"}
FILES = {"import": "import_logs"}  # commands that are keywords of Python, and so no module's name
DEFECT = 70  # exit code of an error inside stopset (EX_SOFTWARE): no answer, and nothing the caller could mend
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # a disk that takes no more, or is failing
DEBUG = "STOPSET_DEBUG"  # set to anything: an error inside stopset is shown whole
FOOTER = "Monitoring aid, not a certified safety function: see the README before you rely on a number."


class Parser(argparse.ArgumentParser):
    """Bad usage gets one sentence and exit code 2."""

    def error(self, message: str) -> NoReturn:
        complain(f"{message}; see `{self.prog} --help`")
        self.exit(2)

    def print_help(self, file: Any = None) -> None:
        """Told, or an error: argparse keeps it to itself where the words cannot be written."""
        (file or sys.stdout).write(self.format_help())
        sys.stdout.flush()


def commands() -> list[str]:
    """Names of all commands, as typed."""
    words = {file: command for command, file in FILES.items()}
    names = (m.name for m in pkgutil.iter_modules(cli.__path__))
    return sorted(words.get(n, n.replace("_", "-")) for n in names if n not in NOT_COMMANDS)


def _module(command: str) -> ModuleType:
    return importlib.import_module(f"stopset.cli.{FILES.get(command, command.replace('-', '_'))}")


def _overview() -> str:
    rows = "\n".join(broken(f"  {c:<14} {getattr(_module(c), 'HELP', '')}", sys.stdout, 17) for c in commands())
    more = "`stopset COMMAND --help` tells each command's options; start with `stopset demo`."
    return f"usage: stopset COMMAND [options]\n\n{rows}\n\n{broken(more, sys.stdout, 0)}\n{broken(FOOTER, sys.stdout, 0)}\n"


def parser_of(command: str) -> Parser:
    """What a command takes, as its ``--help`` and the reference pages tell it."""
    parser = Parser(prog=f"stopset {command}", epilog=FOOTER)
    module = _module(command)
    parser.description = module.HELP
    module.add_arguments(parser)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 1 the answer is "no", 2 bad input, `DEFECT`, 130 interrupted."""
    open_missing_streams()
    words = list(sys.argv[1:] if argv is None else argv) or ["--help"]
    try:
        code = _answer(words)
        sys.stdout.flush()
        return code
    except StopsetError as e:
        complain(" ".join(str(e).split()))
        return 2
    except BrokenPipeError:
        # whoever read our output has left (`stopset ... | head`): nothing more can be said, and nothing is wrong
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        complain("interrupted")
        return 130
    except Exception as e:  # noqa: BLE001 -- where everything ends that nobody foresaw: a traceback is no answer
        return _unforeseen(words[0], e)


def _answer(words: list[str]) -> int:
    command, *more = words
    if command in ("-h", "--help", "help"):
        sys.stdout.write(_overview())
        return 0
    if command == "--version":
        from importlib.metadata import version  # asked for seldom, and slow to load

        sys.stdout.write(f"stopset {version('stopset')}\n")
        return 0
    if command not in commands():
        import difflib  # for a mistake alone

        near = difflib.get_close_matches(command, commands(), n=1)
        like = f"; most like it is {near[0]}" if near else ""
        complain(f"no command {command!r}; expected one of {', '.join(commands())}{like}")
        return 2
    args = parser_of(command).parse_args(more)
    check_distinct(args)
    return int(_module(command).run(args))


def _unforeseen(command: str, e: Exception) -> int:
    """One sentence for an error that is not stopset's own way of saying no, and its exit code."""
    if isinstance(e, ModuleNotFoundError) and (e.name or "").split(".")[0] != "stopset":
        complain(f"{command} needs the package {e.name}; install stopset[all]")
        return 2
    if isinstance(e, OSError) and e.filename is not None:
        complain(f"{e.filename}: {e.strerror}; expected a file that may be used: mend its rights or name another")
        return 2
    if isinstance(e, OSError) and e.errno in NO_ROOM:
        with contextlib.suppress(OSError):  # what is left unsaid would be tried again at the end
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        complain(
            f"{command} could not write its answer ({e.strerror}); expected room where it goes: free some or send it elsewhere"
        )
        return 2
    if isinstance(e, MemoryError):
        complain(f"{command} ran out of memory; expected more of it or less to do: free some or give fewer recordings")
        return 2
    if os.environ.get(DEBUG):
        traceback.print_exception(e)
    frames = ((str(frame.f_globals.get("__name__")), line) for frame, line in traceback.walk_tb(e.__traceback__))
    where = [f"{name} line {line}" for name, line in frames if name.partition(".")[0] == "stopset"]
    what = " ".join(f"{type(e).__name__} {e}".split())[:200] + f", {(where or ['nowhere'])[-1]}"
    complain(
        f"{command} failed inside ({what}); this is a defect of stopset, not an answer and not your input's fault: "
        f"run it again with {DEBUG}=1 in the environment and report what it says"
    )
    return DEFECT


if __name__ == "__main__":
    sys.exit(main())
