"""The arm drawn from the side and from above: the axes of its links, its joints, and where the flange may get."""

from __future__ import annotations

import numpy as np
from markupsafe import escape

from stopset.artifact import Model
from stopset.types import Array

SIZE = 300.0  # [px] of each view
VIEWS = (("from the side", (0, 2)), ("from above", (0, 1)))


def drawn_arm(model: Model, q: Array, within: float) -> str:
    """SVG of the arm at ``q`` (n,) [rad] with a circle of radius ``within`` [m] about its flange."""
    points = model.robot.outline(q)
    reach = float(np.abs(points).max()) + within
    scale = 0.46 * SIZE / reach
    parts = []
    for k, (name, (a, b)) in enumerate(VIEWS):
        at = [(SIZE * (k + 0.5) + scale * p[a], SIZE / 2 - scale * p[b]) for p in points]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in at)
        x, y = at[-1]
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{scale * within:.1f}" fill="#f0a202" fill-opacity=".45" stroke="#b58105"/>'
        )
        parts.append(
            f'<polyline points="{line}" fill="none" stroke="#26323d" stroke-width="7" stroke-linejoin="round" stroke-linecap="round"/>'
        )
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#fff" stroke="#26323d" stroke-width="2"/>' for x, y in at[1:-1]]
        parts.append(
            f'<text x="{SIZE * (k + 0.5):.0f}" y="{SIZE - 4:.0f}" text-anchor="middle" font-size="12" fill="#4d5866">{name}</text>'
        )
    metre = 0.1 * 10 ** np.floor(np.log10(reach / 0.1))
    parts.append(
        f'<path d="M8 {SIZE - 14:.0f}h{scale * metre:.1f}" stroke="#4d5866" stroke-width="3"/><text x="8" y="{SIZE - 20:.0f}" '
        f'font-size="11" fill="#4d5866">{metre:.3g} m</text>'
    )
    label = escape(f"{model.robot.name} with the flange within {within:.3g} m")
    return (
        f'<svg viewBox="0 0 {len(VIEWS) * SIZE:.0f} {SIZE:.0f}" width="{len(VIEWS) * SIZE:.0f}" role="img" aria-label="{label}">'
        f"{''.join(parts)}</svg>"
    )
