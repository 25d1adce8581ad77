"""The fleet on a terminal: one line per arm, as many as fit."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from stopset.monitor.fleet.fleet import Fleet
from stopset.monitor.viewer.terminal import COLOURS
from stopset.monitor.viewer.terminal import number as bound


def terminal(fleet: Fleet, lines: int = 40) -> RenderableType:
    """How many arms are in which state, then the first ``lines`` arms, those that need somebody first."""
    shot = fleet.snapshot(lines)
    counts = ", ".join(f"{n} {word}" for word, n in shot["counts"].items())
    table = Table(box=None, pad_edge=False)
    for title, right in (("arm", False), ("state", False), ("STOP 0", True), ("STOP 1", True), ("for", True), ("why", False)):
        table.add_column(title, justify="right" if right else "left", no_wrap=True, overflow="ellipsis")
    for r in shot["rows"]:
        word = Text(f" {r['word']} ", style=f"bold white on {COLOURS.get(r['word'], 'blue')}")
        why = f"{r['class']}: {r['why']}" if r["class"] else r["why"]
        table.add_row(r["arm"], word, *(_stop_words(r, c) for c in ("0", "1")), f"{r['since_s']:.0f} s", why)
    rest = shot["arms"] - len(shot["rows"])
    more = [Text(f"and {rest} more", style="dim")] if rest else []
    if shot["notice"]:
        more.append(Text(shot["notice"], style="bold red"))
    return Group(Text(f"{shot['arms']} arms: {counts or 'none has spoken yet'}"), table, *more)


def _stop_words(row: dict[str, object], category: str) -> str:
    stops = row["stops"]
    found = stops.get(category) if isinstance(stops, dict) else None
    return "" if found is None else bound(found["tcp_m"], "mm", 1e3)
