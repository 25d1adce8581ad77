"""A self-contained page: text, tables and figures in one HTML file that loads nothing from elsewhere."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stopset.files import write_text

if TYPE_CHECKING:
    import plotly.graph_objects as go

DISCLAIMER = (
    "Monitoring aid. Not a safety function: not developed to IEC 61508 or ISO 13849-1 (no PL, no SIL). Bounds hold only for the "
    "model and the uncertainty sets identified for this arm; conformance is tested, not proved. Stop distances for a risk "
    "assessment must be measured according to ISO 10218-1 and ISO 13855."
)

STYLE = """
:root{color-scheme:only light}
body{font:15px/1.5 system-ui,sans-serif;color:#1d2733;background:#fff;max-width:1180px;margin:0 auto;padding:1.5rem}
h1{font-size:1.6rem;margin:.2rem 0 1rem}h2{font-size:1.15rem;margin:2rem 0 .5rem;border-bottom:1px solid #d5dce4}
table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums;font-size:.9rem}
td,th{border:1px solid #d5dce4;padding:.25rem .6rem;text-align:left;vertical-align:top}th{background:#f2f5f8;vertical-align:bottom}
.n{text-align:right}td.n,td.s{white-space:nowrap}caption{text-align:left;color:#55606e;padding-bottom:.25rem}.wide{overflow-x:auto}
.big{font-size:1.15rem;padding:.7rem 1rem;border-left:6px solid #2a6f97;background:#f2f7fa}
.bad{border-color:#b3261e;background:#fdf3f2}.good{border-color:#2e7d32;background:#f2f8f2}
footer{margin-top:3rem;font-size:.85rem;color:#55606e;border-top:1px solid #d5dce4;padding-top:.6rem}
"""

# one colour per joint, told apart in grey and by most colour-blind eyes too
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#4d4d4d")


# a number, or several in a range, a share ("9 of 9"), a tolerance
_PART = r"[\[\]±%,;\s\d.eE+\-−–]*"
_FIGURE = re.compile(rf"{_PART}\d{_PART}( of \d+)?|[±+\-]?(inf|nan)")
SHORT = 36  # letters of a cell that is not broken into lines


def number(x: Any, digits: int = 3) -> str:
    """A number for a table cell; a dash where there is none."""
    if x is None:
        return "–"
    return f"{x:.{digits}g}" if isinstance(x, float) else str(x)


def _words(column: Sequence[Any]) -> bool:
    """Whether most cells of a column that say anything are words rather than figures, ranges or shares."""
    told = [str(c) for c in column if c is not None and str(c) not in ("", "-", "–")]
    if not told:
        return "" in column  # a column of dashes is one of figures
    return 2 * sum(bool(_FIGURE.fullmatch(c)) for c in told) < len(told)


def _cell(value: Any, words: bool) -> str:
    text = number(value)
    kind = "" if words and len(text) > SHORT else ' class="s"' if words else ' class="n"'
    return f"<td{kind}>{html.escape(text)}</td>"


class Page:
    """Collects parts and writes them as one file."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._parts: list[str] = []
        self._figures = 0

    def heading(self, text: str) -> None:
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def text(self, text: str) -> None:
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def points(self, texts: Sequence[str]) -> None:
        """Sentences one below the other, each with a bullet."""
        self._parts.append("<ul>" + "".join(f"<li>{html.escape(t)}</li>" for t in texts) + "</ul>")

    def verdict(self, text: str, kind: str = "") -> None:
        """A sentence that must be seen; ``kind``: '' | 'good' | 'bad'."""
        self._parts.append(f'<p class="big {kind}">{html.escape(text)}</p>')

    def table(self, head: Sequence[str], rows: Sequence[Sequence[Any]], caption: str = "") -> None:
        """Columns of figures are set to the right, columns of words to the left."""
        words = [_words([row[k] for row in rows]) for k in range(len(head))]
        # a unit stays in one piece
        names = [re.sub(r"\[[^]]*\]", lambda unit: unit[0].replace(" ", "\u00a0"), h) for h in head]
        top = "".join(
            (f"<th>{html.escape(h)}</th>" if w else f'<th class="n">{html.escape(h)}</th>')
            for h, w in zip(names, words, strict=True)
        )
        body = "".join("<tr>" + "".join(_cell(c, w) for c, w in zip(row, words, strict=True)) + "</tr>" for row in rows)
        title = f"<caption>{html.escape(caption)}</caption>" if caption else ""
        self._parts.append(f'<div class="wide"><table>{title}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>')

    def figure(self, figure: go.Figure, caption: str = "", least_width: int = 560) -> None:
        """A figure as wide as the page; on a screen narrower than ``least_width`` [px] it is scrolled, not squeezed."""
        self._figures += 1
        margin = {"l": 60, "r": 20, "t": figure.layout.margin.t or 40, "b": 50}
        figure.update_layout(template="plotly_white", margin=margin, font={"family": "system-ui, sans-serif"})
        drawn = figure.to_html(
            full_html=False, include_plotlyjs=False, div_id=f"figure{self._figures}",
            config={"displayModeBar": False, "responsive": True},
        )  # fmt: skip
        self._parts.append(f'<div class="wide"><div style="min-width:{least_width}px">{drawn}</div></div>')
        if caption:
            self._parts.append(f"<p><small>{html.escape(caption)}</small></p>")

    def html(self) -> str:
        """The whole page."""
        script = ""
        if self._figures:
            from plotly.offline import get_plotlyjs

            # the library's map attributions are the only links in it; a page that loads nothing should not even offer them
            library = get_plotlyjs().replace('href="http', 'href="#').replace('src="http', 'src="#')
            script = f"<script>{library}</script>"
        return (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width,initial-scale=1"><link rel="icon" href="data:,">'
            f"<title>{html.escape(self._title)}</title><style>{STYLE}</style>{script}</head><body>"
            f"<h1>{html.escape(self._title)}</h1>{''.join(self._parts)}"
            f"<footer>stopset {version('stopset')}. {html.escape(DISCLAIMER)}</footer></body></html>"
        )

    def save(self, path: str | Path) -> None:
        """Write the page, whole or not at all; raises `OutputError`."""
        write_text(path, self.html())
