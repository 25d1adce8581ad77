"""Write docs/examples: each numbered script as a notebook too, and with ``--run`` (a minute) pictures and the page with what they print.

python benchmarks/example_pages.py [--run]
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from stopset.files import write_text

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
LINES, WIDTH = 14, 130


def scripts() -> list[Path]:
    """In the order in which they are run: each goes on with the files of those before it."""
    return sorted(EXAMPLES.glob("[0-9]-*.py"))


def cells(text: str) -> list[tuple[str, str]]:
    """(``markdown`` or ``code``, source) of a script in cells, `# %%` before each."""
    found = []
    for part in text.split("# %%")[1:]:
        head, _, body = part.partition("\n")
        words = body.strip("\n")
        if head.strip() == "[markdown]":
            found.append(("markdown", "\n".join(line.removeprefix("#").removeprefix(" ") for line in words.splitlines())))
        else:
            found.append(("code", words))
    return found


def notebook(text: str) -> str:
    """The same as a notebook (nbformat 4.5), without outputs."""
    made = []
    for k, (kind, source) in enumerate(cells(text)):
        cell = {"cell_type": kind, "id": f"cell-{k}", "metadata": {}, "source": source.splitlines(keepends=True)}
        made.append(cell | ({"execution_count": None, "outputs": []} if kind == "code" else {}))
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return json.dumps({"cells": made, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


def run(folder: Path) -> dict[str, str]:
    """What each script prints, run in this order in one folder."""
    shutil.copy(EXAMPLES / "arm.urdf", folder)
    # pictures with the same bytes for the same numbers
    (folder / "matplotlibrc").write_text("backend: agg\nsvg.hashsalt: stopset\n", encoding="utf-8")
    printed = {}
    for script in scripts():
        done = subprocess.run(
            [sys.executable, str(script)],
            cwd=folder,
            check=True,
            text=True,
            stdout=subprocess.PIPE,
            env={**os.environ, "SOURCE_DATE_EPOCH": "0"},
        )
        printed[script.stem] = done.stdout
    return printed


def page(printed: dict[str, str]) -> str:
    """One part per example: title, picture, what it prints, where it is."""
    parts = [
        "# Examples\n\nNumbered, to be run in this order in one folder that holds [arm.urdf](arm.urdf), each as a script and as a notebook; "
        "on the Python of [the reference](../reference/python.md).\nWritten by `python benchmarks/example_pages.py --run`; the tests "
        "run every cell.\n"
    ]
    for script in scripts():
        title = cells(script.read_text(encoding="utf-8"))[0][1].partition("\n")[0].removeprefix("# ")
        lines = [line[:WIDTH] for line in printed[script.stem].strip().splitlines()]
        shown = "\n".join([*lines[:LINES], *(["..."] if len(lines) > LINES else [])])
        parts.append(
            f"## {title}\n\n[Script]({script.name}), [notebook]({script.stem}.ipynb)\n\n![{title}]({script.stem}.svg)\n\n```text\n{shown}\n```\n"
        )
    return "\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", action="store_true")
    args = parser.parse_args()
    for script in scripts():
        write_text(script.with_suffix(".ipynb"), notebook(script.read_text(encoding="utf-8")))
    if args.run:
        with tempfile.TemporaryDirectory() as name:
            printed = run(Path(name))
            for script in scripts():
                shutil.copy(Path(name) / f"{script.stem}.svg", EXAMPLES)
        write_text(EXAMPLES / "index.md", page(printed))


if __name__ == "__main__":
    main()
