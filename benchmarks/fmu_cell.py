"""Draw the cell of tests/fmu_cell.py from above, stopped by the arm's own bound and by a text book's v^2/2a.

Drawn as fmpy runs it; how it goes in Ecos and libcosim is said too.

Run: python benchmarks/fmu_cell.py docs/pictures/fmu-cell.svg
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from fmu_cell import BODY, CYCLE, EDGE, IMPORTERS, LINKS, PERSON, REACH, WALK, Run, cell
from stopset.files import write_text

SIZE, SCALE = 460.0, 150.0  # [px] of a panel, per metre
BASE = (120.0, 345.0)  # [px] of the arm's base in its panel
INK, SAFE, HIT, GREY = "#263238", "#2e7d32", "#b3261e", "#8d99a3"


def place(angle: float, radius: float) -> tuple[float, float]:
    """[px] of a point of the tool's circle; the arm begins to the right and turns to the left."""
    return BASE[0] + SCALE * radius * float(np.cos(angle)), BASE[1] - SCALE * radius * float(np.sin(angle))


def sector(start: float, end: float, colour: str) -> str:
    (a, b), (c, d), r = place(start, REACH), place(end, REACH), SCALE * REACH
    return (
        f'<path d="M{BASE[0]},{BASE[1]} L{a:.1f},{b:.1f} A{r},{r} 0 0 0 {c:.1f},{d:.1f} Z" fill="{colour}" fill-opacity="0.16"/>'
    )


def arm(angle: float, colour: str, width: float) -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in (BASE, place(angle, LINKS[0]), place(angle, REACH)))
    return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-linecap="round"/>'


def text(x: float, y: float, words: str, colour: str = INK, size: int = 13) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{colour}">{words}</text>'


def panel(x: float, title: str, r: Run) -> str:
    """The arm where the stop was asked for, where it ended, and the person."""
    asked, gap = int(np.argmax(r.stop)), float(r.gap.min())
    at, end, colour = float(r.q[asked]), float(r.q.max()), SAFE if gap > 0.0 else HIT
    px, py = place(PERSON, REACH)
    curtain = py - SCALE * WALK
    parts = [f'<g transform="translate({x},0)">', text(14, 24, title, size=15)]
    parts += [sector(float(r.q[0]), at, GREY), sector(at, end, colour)]
    parts += [arm(float(r.q[0]), "#cfd8dc", 5), arm(at, GREY, 7), arm(end, colour, 9)]
    parts.append(f'<circle cx="{BASE[0]}" cy="{BASE[1]}" r="13" fill="{INK}"/>')
    parts.append(
        f'<line x1="20" x2="{SIZE - 30}" y1="{curtain:.1f}" y2="{curtain:.1f}" stroke="#f9a825" stroke-width="3" stroke-dasharray="7 5"/>'
    )
    parts.append(text(SIZE - 140, curtain - 7, "light curtain", "#8a5a00"))
    parts.append(
        f'<line x1="{px:.1f}" x2="{px:.1f}" y1="{curtain:.1f}" y2="{py - 34:.1f}" stroke="{INK}" stroke-dasharray="2 4"/>'
    )
    parts.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="{SCALE * BODY:.1f}" fill="#5c6bc0" fill-opacity="0.75"/>')
    said = (
        f"she is not reached: {100 * gap:.0f} cm are left"
        if gap > 0.0
        else f"she is hit: the tool goes {-100 * gap:.0f} cm into her"
    )
    parts.append(text(14, 378, f"asked for at {at:.2f} rad and {r.dq[asked]:.1f} rad/s, at rest at {end:.2f} rad;"))
    parts.append(text(14, 397, f"she begins at {EDGE:.2f} rad"))
    parts.append(text(14, 420, said, colour, 16))
    return "".join([*parts, "</g>"])


def main() -> None:
    """Run both cells and draw them."""
    target = Path(sys.argv[1])
    with tempfile.TemporaryDirectory() as folder:
        ssps = {"bound of the unit": cell(Path(folder), False), "v^2/2a": cell(Path(folder), True)}
        runs = {(who, name): run(ssp) for who, run in IMPORTERS.items() for name, ssp in ssps.items()}
    for (who, name), r in runs.items():
        asked = int(np.argmax(r.stop))
        said = f"asked for at {r.t[asked]:.2f} s, {r.q[asked]:.3f} rad; at rest at {r.q.max():.3f} rad; gap {r.gap.min():+.3f} m"
        print(f"{who}, {name}: {said}")
    proved, textbook = runs["fmpy", "bound of the unit"], runs["fmpy", "v^2/2a"]
    body = panel(0.0, "stopped by the unit's own bound", proved) + panel(SIZE, "the same logic with v²/2a", textbook)
    note = text(
        14, 452, f"top view; the arm turns to the left; grey: driven, coloured: stopping; cycles of {1e3 * CYCLE:.0f} ms", GREY
    )
    box = f'viewBox="0 0 {2 * SIZE:.0f} 464" font-family="sans-serif" role="img" aria-label="A person beside a stopping arm"'
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" {box}><rect width="100%" height="100%" fill="#fff"/>{body}{note}</svg>\n'
    write_text(target, svg)


if __name__ == "__main__":
    main()
