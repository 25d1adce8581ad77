"""Write the tables of docs that state numbers of the code, from the code.

Run: python benchmarks/doc_tables.py
"""

from __future__ import annotations

import re
from pathlib import Path

from stopset.files import write_text
from stopset.offline.diagnose.thresholds import TABLE
from stopset.offline.nominal.prior import IDENTIFICATION, Tolerance

ROOT = Path(__file__).parents[1]
# a page and the table between its marks
MARK = "<!-- {name}: made by benchmarks/doc_tables.py -->"
END = "<!-- end -->"


def thresholds() -> str:
    """The thresholds of the diagnosis."""
    rows = [f"| {t.meaning} | {t.shown} | {t.calibration} | `{t.name}` |" for t in TABLE]
    return "\n".join(("| what | value | why | constant |", "|---|---|---|---|", *rows))


def description() -> str:
    """How well a robot description is known, for the diagnosis and for an identification."""
    one = Tolerance()
    rows = []
    for what, size, unit, why in (
        (
            "mass of a link",
            100 * one.mass,
            "%",
            "masses 2 to 5 % off are 3.6 % off in the mean square (measured on the labelled sets: 3.6 %)",
        ),
        ("its centre, along each axis", 1e3 * one.centre, "mm", "3 mm in all are 1.7 mm along each axis (measured: 1.7 mm)"),
        ("its inertia", 100 * one.inertia, "%", "chosen"),
        ("inertia of a rotor", 100 * one.rotor, "%", "data sheets 4 % off at most are 2.3 % off in the mean square"),
    ):
        rows.append(f"| {what} | {size:.3g} {unit} | {IDENTIFICATION * size:.3g} {unit} | {why} |")
    head = "| standard deviation of | diagnosis, times what evidence says | identification | why |"
    return "\n".join((head, "|---|---|---|---|", *rows))


TABLES = {("docs/diagnosis.md", "thresholds"): thresholds, ("docs/diagnosis.md", "description"): description}


def build() -> dict[str, str]:
    """The pages with their tables made anew."""
    pages: dict[str, str] = {}
    for (page, name), table in TABLES.items():
        text = pages.get(page) or (ROOT / page).read_text(encoding="utf-8")
        mark = MARK.format(name=name)
        parts = re.split(f"({re.escape(mark)}\n).*?(\n{re.escape(END)})", text, flags=re.DOTALL)
        if len(parts) != 4:
            raise ValueError(
                f"{page} has {(len(parts) - 1) // 3} places for the table {name}; expected {mark} and {END} around one"
            )
        pages[page] = parts[0] + parts[1] + table() + parts[2] + parts[3]
    return pages


def main() -> None:
    """Write them."""
    for page, text in build().items():
        write_text(ROOT / page, text)


if __name__ == "__main__":
    main()
