"""The terminal view of a running monitor."""

from __future__ import annotations

import math

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from stopset.monitor.viewer.view import View

# three ways to be red differ: seen in the arm, seen in the monitor, seen nowhere
COLOURS = {
    "OK": "green",
    "DEGRADED": "yellow",
    "VIOLATION": "red",
    "UNKNOWN": "magenta",
    "FAULT": "dark_orange3",
    "NO DATA": "grey37",
}


def number(x: float | None, unit: str, factor: float = 1.0, digits: int = 0) -> str:
    """A bound, rounded up: what is shown never promises more than what was proved."""
    return "not provable" if x is None else f"{math.ceil(x * factor * 10**digits - 1e-9) / 10**digits:.{digits}f} {unit}"


def terminal(view: View) -> RenderableType:
    """The terminal view: state word, stop distances, one row per joint, last events."""
    word, why = view.word()
    shot = view.snapshot()
    twin = shot["twin"]
    head = Text(f" {word} ", style=f"bold white on {COLOURS.get(word, 'blue')}")
    rows: list[RenderableType] = [head, Text(why)]
    if twin is None:
        return Group(*rows)
    stops = twin["stops"] if shot["fresh"] and word != "NO DATA" else {}
    for category, s in stops.items():
        rows.append(
            Text(f"STOP {category:<13} {number(s['time_s'], 'ms', 1e3):>14} {number(s['tcp_m'], 'mm', 1e3):>14}  {s['why'][:90]}")
        )
    table = Table(box=None, pad_edge=False)
    for title in ("joint", "room", "STOP 0 time", "STOP 0 angle", "violations"):
        table.add_column(title)
    bad = {j: sum(v["samples"] for v in twin["violations"] if v["joint"] == j) for j in twin["joints"]}
    for j in twin["joints"]:
        room = (twin["room"] or {}).get(j)
        here = stops.get("0", {}).get("joints", {}).get(j, {})
        angle = max((x for x in (here.get("forward_rad"), here.get("back_rad")) if x is not None), default=None)
        filled = 0 if room is None else max(0, min(20, round(20 * room)))
        table.add_row(
            j,
            "" if room is None else f"{'█' * filled:<20} {room:5.2f}",
            number(here.get("time_s"), "ms", 1e3),
            number(angle, "rad", 1.0, 4),
            Text(str(bad[j]), style="bold red" if bad[j] else ""),
        )
    rows.append(table)
    counts = ", ".join(f"{v} {k.lower()}" for k, v in twin["verdicts"].items() if v)
    rows.append(
        Text(
            f"{counts}; {twin['gaps']} gaps; oldest prediction {twin['oldest_prediction_s']:.2f} s; {shot['lost']} messages lost"
        )
    )
    for e in shot["events"][-4:]:
        rows.append(Text(e["told"][:110] + (f" ({e['count']} times)" if e["count"] > 1 else ""), style="dim"))
    rows.append(Text(twin["notice"], style="dim italic"))
    return Group(*rows)
