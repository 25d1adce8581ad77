"""Write docs/reference: the commands from their parsers, the state message from its table of fields.

Run: python benchmarks/reference_pages.py
With ``--tutorial`` also run the commands of docs/tutorials/simulated-cell.md (a minute) and put in what they say.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from stopset.cli.main import commands, parser_of
from stopset.files import write_text
from stopset.monitor.evidence.cause import Kind
from stopset.monitor.layout import FIELDS, LAYOUT_VERSION, LENGTH, Flag, State, offsets

DOCS = Path(__file__).parents[1] / "docs"
TUTORIAL = DOCS / "tutorials" / "simulated-cell.md"
# a block of commands, and what they say (kept to so many lines)
STEP = re.compile(r"```sh\n(.*?)```\n(?:\n```text\n.*?```\n)?", re.S)
LINES, WIDTH = 14, 130
TYPES = {"u8": "uint8", "u16": "uint16", "u32": "uint32", "u64": "uint64", "f32": "float32"}


def cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def sentence(text: str | None) -> str:
    said = cell(text or "")
    return f"{said[:1].upper()}{said[1:]}."


def taken(action: argparse.Action) -> tuple[str, str]:
    """How an option is written, and what it means."""
    if isinstance(action.metavar, tuple):
        value = " ".join(action.metavar)
    elif action.nargs == 0:
        value = ""
    else:
        value = action.metavar or ("{" + ",".join(map(str, action.choices)) + "}" if action.choices else action.dest.upper())
    name = action.option_strings[-1] if action.option_strings else ""
    helped = (action.help or "").replace("%%", "%").replace("%(default)s", str(action.default))
    return f"`{f'{name} {value}'.strip()}`" + (" ..." if action.nargs in ("+", "*") else ""), helped + (
        " (required)" if action.required and name else ""
    )


# what a script or notebook needs, in the order in which it is used
API = (
    "stopset.offline.description.load_robot", "stopset.recording.read_recordings", "stopset.recording.stream_recordings",
    "stopset.offline.identify.pipeline.identify", "stopset.offline.identify.pipeline.Settings", "stopset.artifact.load_model",
    "stopset.artifact.save_model", "stopset.offline.compare.compare.compare", "stopset.offline.compare.verdict.verdict",
    "stopset.offline.diagnose.diagnose_model", "stopset.offline.revise.revise.add", "stopset.reach.stops.stop",
    "stopset.reach.stops.StopBounds", "stopset.offline.stops.table.stop_table", "stopset.offline.plan.design", "stopset.fmu.export",
    "stopset.simulation.simulate_stop", "stopset.simulation.simulate_stops",
    "stopset.offline.notebook.columns", "stopset.offline.notebook.frame", "stopset.offline.notebook.plot",
    "stopset.offline.compare.mcap_file.save_mcap",
)  # fmt: skip


def python_page() -> str:
    out = [
        "# Python\n",
        "Written by `python benchmarks/reference_pages.py` from the docstrings. The functions behind the commands, for scripts and notebooks:",
        "everything is SI, arrays are numpy, and `Model`, `Comparison`, `Diagnosis` and `StopBound` show themselves in a notebook.\n",
        "```python",
        "from stopset.artifact import load_model",
        "from stopset.offline.compare.compare import compare",
        "from stopset.offline.notebook import frame, plot",
        "from stopset.reach.stops import stop\n",
        'model = load_model("arm.model.json")',
        'found = compare(model, ["other.parquet"])',
        'stop(model, q=model.domain.q.centre, dq=model.domain.dq.hi, category="0")',
        "plot(found)  # and frame(found) for pandas",
        "```\n",
    ]
    for name in API:
        module, _, word = name.rpartition(".")
        thing = getattr(importlib.import_module(module), word)
        given = re.sub(r"<function (\w+) at 0x\w+>", r"\1", str(inspect.signature(thing)).replace("'", ""))
        out += [f"## {word}\n", f"```python\nfrom {module} import {word}\n\n{word}{given}\n```\n", f"{inspect.getdoc(thing)}\n"]
    return "\n".join(out)


def commands_page() -> str:
    out = [
        "# Commands\n",
        'Written by `python benchmarks/reference_pages.py` from the commands themselves. Exit codes: 0 done, 1 the answer is "no", 2 bad input',
        "(one sentence: what was seen, what was expected, what to do), 70 a defect of stopset, 130 interrupted. Units are SI.\n",
    ]
    for name in commands():
        parser = parser_of(name)
        rows = [taken(a) for a in parser._actions if a.dest != "help" and a.help != argparse.SUPPRESS]
        out += [f"## stopset {name}\n", f"{sentence(parser.description)}\n"]
        if rows:
            out += ["| takes | |", "|---|---|", *(f"| {cell(how)} | {cell(what)} |" for how, what in rows), ""]
    return "\n".join(out)


def message_page() -> str:
    at = offsets()
    rows = [
        f"| {at[f.name]} | `{f.name}` | {TYPES[f.kind]}{f'[{f.count}]' if f.count > 1 else ''} | {f.unit} | {cell(f.means)} | {f.rounds} |"
        for f in FIELDS
    ]
    codes = [f"| `0x{s.value:02X}` | {s.name} |" for s in State]
    flags = [f"| {f.value} | {f.name} |" for f in Flag]
    kinds = [f"| {k.code} | {k.name.lower()} |" for k in Kind]
    return "\n".join(
        [
            "# The state message\n",
            "Written by `python benchmarks/reference_pages.py` from the table that packs it; `deploy/plc/stopset_state.h` and `.st` come",
            f"from the same table. Layout version {LAYOUT_VERSION}, {LENGTH} bytes, little endian, every field naturally aligned.",
            'Published every cycle under `<site>/<cell>/<arm>/stopset/state`. Rounding: "up" is never below the number it stands for,',
            '"down" never above. What a consumer has to check before it believes a message: [A PLC bridge](../how-to/plc-bridge.md).\n',
            "| byte | field | type | unit | meaning | rounded |",
            "|---|---|---|---|---|---|",
            *rows,
            "\n## State codes\n\nAny two differ in at least four bits; every other value means FAULT.\n",
            "| code | state |",
            "|---|---|",
            *codes,
            "\n## Flags\n",
            "| bit | flag |",
            "|---|---|",
            *flags,
            "\n## Classes of a violation\n\nWhat they mean: [Violations](../violations.md).\n",
            "| code | class |",
            "|---|---|",
            *kinds,
            "",
        ]
    )


def steps(page: str) -> list[list[str]]:
    """The commands of a page's `sh` blocks, one list a block, continued lines joined."""
    blocks = (found.group(1).replace("\\\n", " ") for found in STEP.finditer(page))
    return [[line for line in block.splitlines() if line.strip() and not line.startswith("#")] for block in blocks]


def output_of(command: str, folder: Path) -> str:
    """Run a line of a tutorial in ``folder``; what it says on standard output.

    Raises:
        RuntimeError: it ended with something else than 0, or 1 ("the answer is no").
    """
    words = shlex.split(command.split("  #")[0])
    if words[0] == "stopset":
        words[:1] = [sys.executable, "-m", "stopset.cli.main"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=600)
    if done.returncode not in (0, 1):
        raise RuntimeError(f"{command}: exit code {done.returncode}: {done.stderr}")
    return done.stdout


def tutorial(page: str) -> str:
    """The page with what its commands say now."""
    with tempfile.TemporaryDirectory() as folder:

        def step(found: re.Match[str]) -> str:
            said = "".join(output_of(c, Path(folder)) for c in steps(found.group(0))[0]).rstrip().splitlines()
            shown = [line[:WIDTH] + ("..." if len(line) > WIDTH else "") for line in said[:LINES]]
            more = ["..."] if len(said) > LINES else []
            return f"```sh\n{found.group(1)}```\n" + (f"\n```text\n{chr(10).join(shown + more)}\n```\n" if said else "")

        return STEP.sub(step, page)


def pages() -> dict[Path, str]:
    """What this script writes, by file."""
    folder = DOCS / "reference"
    return {
        folder / "commands.md": commands_page(),
        folder / "python.md": python_page(),
        folder / "state-message.md": message_page(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tutorial", action="store_true")
    args = parser.parse_args()
    made = pages()
    if args.tutorial:
        made[TUTORIAL] = tutorial(TUTORIAL.read_text(encoding="utf-8"))
    for path, text in made.items():
        path.parent.mkdir(exist_ok=True)
        write_text(path, text)


if __name__ == "__main__":
    main()
