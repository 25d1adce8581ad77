"""A4 on paper: headings, paragraphs, tables and curves, set by reportlab."""

from __future__ import annotations

import html
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from reportlab.graphics.charts.lineplots import LinePlot
from reportlab.graphics.shapes import Drawing, String
from reportlab.graphics.widgets.markers import makeMarker
from reportlab.lib.colors import Color, black, lightgrey
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import CondPageBreak, Flowable, KeepTogether, Paragraph, SimpleDocTemplate, Spacer, Table

MARGIN = 42.0  # [pt]
PADDING = 6.0  # [pt] that reportlab leaves between a page's margin and its text
WIDTH = A4[0] - 2 * MARGIN  # [pt] of the text
PICTURE = 170.0  # [pt] height of a picture with its words
INKS = (Color(0, 0.45, 0.7), Color(0.84, 0.37, 0), Color(0, 0.62, 0.45), Color(0.8, 0.47, 0.65))
PLAIN, BOLD = "Helvetica", "Helvetica-Bold"


@dataclass(frozen=True, slots=True)
class Plot:
    """Curves (name, x, y) and measured points (x, y), both axes from zero."""

    title: str
    curves: Sequence[tuple[str, Sequence[float], Sequence[float]]]
    points: tuple[Sequence[float], Sequence[float]]
    x_name: str
    y_name: str


class Document:
    """Collects pages from top to bottom; `bytes` gives the file, the same for the same content."""

    def __init__(self, title: str, footer: str) -> None:
        self._title, self._footer = title, footer
        self._story: list[Flowable] = []

    def heading(self, text: str, size: float = 13.0, keep: float = 60.0) -> None:
        """``keep``: height [pt] of what must stand below it on the same page."""
        self._story += [CondPageBreak(3 * size + keep), Spacer(1, 0.6 * size), _words(text, size, BOLD), Spacer(1, 0.3 * size)]

    def text(self, text: str, size: float = 8.5) -> None:
        """A paragraph."""
        self._story.append(_words(text, size))

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[float], size: float = 7.0) -> None:
        """``widths``: shares of the text width. Words go on below in their own cell; every page repeats the head."""
        scale = WIDTH / sum(widths)
        cells = [[_words(c, size, BOLD) for c in head], *([_words(c, size) for c in row] for row in rows)]
        rules = [("LINEBELOW", (0, 0), (-1, -1), 0.3, lightgrey), ("VALIGN", (0, 0), (-1, -1), "TOP")]
        tight = [
            (f"{side}PADDING", (0, 0), (-1, -1), pad)
            for side, pad in zip(("TOP", "BOTTOM", "LEFT", "RIGHT"), (1, 2, 0, 4), strict=True)
        ]
        self._story += [Table(cells, [w * scale for w in widths], repeatRows=1, style=[*rules, *tight]), Spacer(1, size)]

    def plots(self, plots: Sequence[Plot]) -> None:
        """Pictures side by side."""
        drawing = Drawing(WIDTH, PICTURE)
        width = WIDTH / len(plots)
        for k, plot in enumerate(plots):
            _draw(drawing, plot, k * width, width - 14.0)
        self._story.append(KeepTogether([drawing]))

    def bytes(self) -> bytes:
        """The PDF file."""
        out = io.BytesIO()
        edge = MARGIN - PADDING
        SimpleDocTemplate(
            out, pagesize=A4, leftMargin=edge, rightMargin=edge, topMargin=edge, bottomMargin=edge,
            title=self._title, creator="stopset", invariant=1,
        ).build(list(self._story), onFirstPage=self._foot, onLaterPages=self._foot)  # fmt: skip
        return out.getvalue()

    def _foot(self, page: Canvas, document: SimpleDocTemplate) -> None:
        page.setFont(PLAIN, 6.5)
        page.drawString(MARGIN, 24.0, self._footer)
        page.drawRightString(A4[0] - MARGIN, 24.0, str(document.page))


def _words(text: str, size: float, font: str = PLAIN) -> Paragraph:
    # the fonts that every reader of PDF brings know the letters of western Europe
    seen = text.encode("cp1252", "replace").decode("cp1252")
    style = ParagraphStyle("words", fontName=font, fontSize=size, leading=1.25 * size, spaceAfter=0.35 * size, splitLongWords=1)
    return Paragraph(html.escape(seen, quote=False), style)


def _step(top: float) -> float:
    """A round distance of grid lines, four to eight of them up to ``top``."""
    if not 0.0 < top < math.inf:
        return 0.25
    base = 10.0 ** math.floor(math.log10(top / 4.0))
    return base * next(f for f in (1.0, 2.0, 2.5, 5.0, 10.0) if top / (f * base) <= 8.0)


def _draw(drawing: Drawing, plot: Plot, left: float, width: float) -> None:
    """``plot`` into ``drawing`` from ``left`` [pt] on."""
    lines = [list(zip(x, y, strict=True)) for _, x, y in plot.curves]
    points = list(zip(*plot.points, strict=True))
    chart = LinePlot()
    chart.x, chart.y, chart.width, chart.height = left + 34.0, 34.0, width - 34.0, PICTURE - 52.0
    chart.data = [*lines, points] if points else lines or [[(0.0, 0.0)]]
    for axis, k in ((chart.xValueAxis, 0), (chart.yValueAxis, 1)):
        top = max((p[k] for line in chart.data for p in line), default=1.0)
        step = _step(top)
        axis.valueMin, axis.valueStep = 0.0, step
        axis.valueMax = step * max(1, math.ceil(top / step - 1e-9))
        axis.visibleGrid, axis.gridStrokeColor, axis.gridStrokeWidth = True, lightgrey, 0.4
        axis.labels.fontName, axis.labels.fontSize, axis.labelTextFormat = PLAIN, 6.0, lambda v: f"{v:.4g}"
    for k in range(len(lines)):
        chart.lines[k].strokeColor, chart.lines[k].strokeWidth = INKS[k % len(INKS)], 1.2
    if points:
        chart.lines[len(lines)].strokeColor = None
        chart.lines[len(lines)].symbol = makeMarker("Cross", size=3, strokeColor=black, fillColor=black)
    drawing.add(chart)
    drawing.add(_label(left, PICTURE - 10.0, f"{plot.title}: {plot.y_name}", 7.5, fontName=BOLD))
    drawing.add(_label(left + width, 14.0, plot.x_name, 6.5, textAnchor="end"))
    for k, (name, _, _) in enumerate(plot.curves):
        drawing.add(_label(chart.x + 6.0 + 52.0 * k, 14.0, name, 6.5, fillColor=INKS[k % len(INKS)]))


def _label(x: float, y: float, text: str, size: float, **how: Any) -> String:
    return String(x, y, text, fontSize=size, **({"fontName": PLAIN, "fillColor": black} | how))
