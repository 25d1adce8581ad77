"""What held-out motions promise, explained once: the bound over the number of motions, and where this model stands on it."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from stopset.artifact import Model
from stopset.offline.report.page import COLOURS, Page


def guarantee(out: Page, model: Model) -> None:
    """The guarantee in words beside the curve of what so many motions can show at best."""
    g = model.guarantee
    out.heading("How often a new motion may leave the sets")
    out.text(g.text)
    if g.motions < 1:
        return
    most = max(60, 2 * g.motions)
    tried = np.arange(1, most + 1)
    # with none outside, the bound of Clopper and Pearson has this closed form
    best = 100.0 * (1.0 - (1.0 - g.confidence) ** (1.0 / tried))
    figure = go.Figure(
        [
            go.Scatter(x=tried, y=best, mode="lines", name="none of them outside", line={"color": COLOURS[0]}),
            go.Scatter(
                x=[g.motions], y=[100.0 * g.upper_bound], mode="markers", name=f"this model: {g.violated} of {g.motions} outside",
                marker={"size": 12, "color": COLOURS[1], "symbol": "diamond"},
            ),
        ]
    )  # fmt: skip
    figure.update_xaxes(title_text="held-out motions", rangemode="tozero")
    figure.update_yaxes(title_text="at most [%]", range=[0, 100])
    figure.update_layout(height=300, legend={"orientation": "h", "y": 1.12})
    needed = int(np.ceil(np.log(1.0 - g.confidence) / np.log(0.95)))
    out.figure(
        figure,
        f"Probability that a new motion leaves the sets, at {g.confidence:.0%} confidence. Few motions can promise little however "
        f"well they fit: at most 5 % takes {needed} held-out motions with none outside.",
    )
