"""Write the tables of docs that state numbers of the code, from the code.

Run: python benchmarks/doc_tables.py
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from stopset.files import write_text
from stopset.offline.diagnose.thresholds import TABLE
from stopset.offline.nominal.prior import IDENTIFICATION, Tolerance

ROOT = Path(__file__).parents[1]
# a page and the table between its marks
MARK = "<!-- {name}: made by benchmarks/doc_tables.py -->"
END = "<!-- end -->"


SENSITIVITY = ROOT / "benchmarks" / "diagnosis_sensitivity.json"
LABELLED = "hidden_effect"  # folder of the labelled sets; others are unseen ones


def asked() -> dict[str, dict[str, Any]]:
    """What `diagnosis_sensitivity` stored by set; a threshold that has another value since then is ``due`` again."""
    known = json.loads(SENSITIVITY.read_text(encoding="utf-8"))
    values = json.loads(json.dumps({t.name: t.value for t in TABLE}))
    new = {name for name, value in values.items() if known["values"].get(name) != value}
    return {key: x | {"due": {*x["due"], *new}} for key, x in known["sets"].items()}


def thresholds() -> str:
    """The thresholds of the diagnosis, and which answers change with each."""
    sets, rows = asked(), []
    for t in TABLE:
        cells = [
            t.meaning,
            t.shown,
            t.calibration,
            *(_changes(sets, t.name, change) for change in ("less", "more")),
            f"`{t.name}`",
        ]
        rows.append(f"| {' | '.join(cells)} |")
    head = "| what | value | why | 30 % less changes | 30 % more changes | constant |"
    return "\n".join((head, "|---|---|---|---|---|---|", *rows))


def _changes(sets: dict[str, dict[str, Any]], name: str, change: str) -> str:
    """The answers that change when a threshold is 30 % ``less`` or ``more``; a dash where no set's answer is asked of it."""
    here = {key: x for key, x in sets.items() if name not in x["due"]}
    if not here:
        return "not asked"
    if not any(name in x["read"] for x in here.values()):
        return "-"
    found = []
    for key, x in here.items():
        other = x["changed"].get(name, {}).get(change)
        if other is not None:
            worse = {(True, False): ", **wrong**", (False, True): ", right"}.get((x["right"], other["right"]), "")
            found.append(f"{_set(key)} {_named(x['answer'])} → {_named(other['answer'])}{worse}")
    of = "" if len(here) == len(sets) else f" (of {len(here)} sets)"
    return ("; ".join(found) or "none") + of


def _set(key: str) -> str:
    folder, _, name = key.partition("/")
    return name if folder == LABELLED else f"unseen {name}"


def _named(answer: list[str]) -> str:
    """What is named, or the verdict where nothing is."""
    return " ".join(answer[1:] or answer[:1])


def sensitivity() -> str:
    """How many answers hang on a threshold, in sum."""
    sets = asked()
    count = {
        key: sum(key.startswith(f"{LABELLED}/") == labelled for key in sets) for key, labelled in (("l", True), ("u", False))
    }
    walks = [(x["right"], o["right"]) for x in sets.values() for changes in x["changed"].values() for o in changes.values()]
    questions = 2 * sum(len(TABLE) - len(x["due"]) for x in sets.values())
    unread = [f"`{t.name}`" for t in TABLE if _changes(sets, t.name, "less") == "-"]
    by_name = {t.name: sum(len(x["changed"].get(t.name, {})) for x in sets.values()) for t in TABLE}
    most = sorted((name for name in by_name if by_name[name]), key=lambda name: -by_name[name])
    return (
        f"Of {questions} such questions ({count['l']} labelled and {count['u']} unseen sets) {len(walks)} have another answer, "
        f"{sum(walk == (True, False) for walk in walks)} a wrong one instead of a right one"
        f"{', ' * bool(most)}{', '.join(f'`{name}` {by_name[name]}' for name in most)}. "
        f"No set's answer is asked of {len(unread)} thresholds: {', '.join(unread)}."
    )


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


TABLES = {
    ("docs/diagnosis.md", "thresholds"): thresholds,
    ("docs/diagnosis.md", "sensitivity"): sensitivity,
    ("docs/diagnosis.md", "description"): description,
}


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
