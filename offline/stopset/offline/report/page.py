"""A self-contained page: text, tables and figures in one HTML file that loads nothing from elsewhere and runs its own script only."""

from __future__ import annotations

import base64
import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, Template
from markupsafe import Markup

from stopset.files import write_text

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from stopset.artifact import Model

DISCLAIMER = (
    "Monitoring aid. Not a safety function: not developed to IEC 61508 or ISO 13849-1 (no PL, no SIL). Bounds hold only for the "
    "model and the uncertainty sets identified for this arm; conformance is tested, not proved. Stop distances for a risk "
    "assessment must be measured according to ISO 10218-1 and ISO 13855."
)

# one colour per joint, told apart in grey and by most colour-blind eyes too
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#4d4d4d")
SIGNS = {"good": "✓", "bad": "✕", "": ""}

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
    said = [str(c) for c in column if c is not None and str(c) not in ("", "-", "–")]
    if not said:
        return "" in column  # a column of dashes is one of figures
    return 2 * sum(bool(_FIGURE.fullmatch(c)) for c in said) < len(said)


def _cell(value: Any, *, words: bool, shade: int | None = None) -> dict[str, Any]:
    text = number(value)
    return {"text": text, "look": ("" if len(text) > SHORT else "s") if words else "n", "shade": shade}


def _head(text: str, *, words: bool) -> dict[str, Any]:
    # a unit stays in one piece
    return {"text": re.sub(r"\[[^]]*\]", lambda unit: unit[0].replace(" ", "\u00a0"), text), "words": words}


class Page:
    """Collects parts and writes them as one file; ``model``, ``data``: what the page is about, told at its foot."""

    def __init__(self, title: str, model: Model | None = None, data: Sequence[str | Path] = ()) -> None:
        self._title = title
        self._model, self._data = model, tuple(data)
        self._parts: list[dict[str, Any]] = []
        self._figures = 0
        self._said = title  # the last heading, which names what follows

    def _put(self, kind: str, **content: Any) -> None:
        self._parts.append({"kind": kind, **content})

    def heading(self, text: str) -> None:
        self._said = text
        self._put("heading", text=text)

    def text(self, text: str) -> None:
        self._put("text", text=text)

    def points(self, texts: Sequence[str]) -> None:
        """Sentences one below the other, each with a bullet."""
        self._put("points", texts=texts)

    def verdict(self, text: str, kind: str = "") -> None:
        """A sentence that must be seen; ``kind``: '' | 'good' | 'bad'."""
        self._put("verdict", text=text, mood=kind, sign=SIGNS[kind])

    def next(self, text: str) -> None:
        """What to do now."""
        self._put("next", text=text)

    @contextmanager
    def fold(self, title: str) -> Iterator[None]:
        """What is put inside is folded away under ``title``; print shows it."""
        outer, self._parts, self._said = self._parts, [], title
        yield
        outer.append({"kind": "fold", "title": title, "parts": self._parts})
        self._parts = outer

    @contextmanager
    def beside(self) -> Iterator[None]:
        """What is put inside stands side by side where there is room."""
        outer, self._parts = self._parts, []
        yield
        outer.append({"kind": "beside", "parts": self._parts})
        self._parts = outer

    def table(self, head: Sequence[str], rows: Sequence[Sequence[Any]], caption: str = "") -> None:
        """Columns of figures are set to the right, columns of words to the left."""
        words = [_words([row[k] for row in rows]) for k in range(len(head))]
        cells = [[_cell(c, words=w) for c, w in zip(row, words, strict=True)] for row in rows]
        heads = [_head(h, words=w) for h, w in zip(head, words, strict=True)]
        self._put(
            "table",
            head=heads,
            rows=cells,
            caption=caption,
            shaded=False,
            label=caption or self._said,
        )

    def shares(self, rows: Sequence[str], columns: Sequence[str], share: np.ndarray, caption: str = "") -> None:
        """A heat-map of shares (rows, columns), 0 to 1: percents in shaded cells."""
        percent = np.round(100 * share).astype(int)
        cells = [
            [_cell(name, words=True), *(_cell(int(p), words=False, shade=min(int(p), 60)) for p in line)]
            for name, line in zip(rows, percent, strict=True)
        ]
        heads = [_head(h, words=k == 0) for k, h in enumerate(("", *columns))]
        self._put("table", head=heads, rows=cells, caption=caption, shaded=True, label=caption)

    def picture(self, svg: str, caption: str = "") -> None:
        """A drawing of our own making, as SVG text."""
        self._put("picture", svg=svg, caption=caption)

    def figure(self, figure: go.Figure, caption: str = "", least_width: int = 350) -> None:
        """A figure as wide as the page; on a screen narrower than ``least_width`` [px] (by itself: a phone) it is scrolled, not squeezed."""
        self._figures += 1
        margin = {"l": 60, "r": 20, "t": figure.layout.margin.t or 40, "b": 50}
        figure.update_layout(template="plotly_white", margin=margin, font={"family": "system-ui, sans-serif"})
        for trace in figure.data:  # a screen shows no more than single precision
            for axis in ("x", "y"):
                if (values := _single(getattr(trace, axis, None))) is not None:
                    trace[axis] = values
        text = figure.to_json().replace("<", "\\u003c")  # no text in a figure ends its script element
        self._put(
            "figure", id=f"figure{self._figures}", json=text, caption=caption, least=least_width,
            label=self._said,
        )  # fmt: skip

    def html(self) -> str:
        """The whole page."""
        library, script = (_own("plotly-basic.min.js"), _own("page.js")) if self._figures else ("", "")
        return _template().render(
            title=self._title, parts=self._parts, style=_own("page.css"), library=library, script=script, policy=policy(library, script),
            origin=origin(self._model, self._data), version=version("stopset"), disclaimer=DISCLAIMER,
        )  # fmt: skip

    def save(self, path: str | Path) -> None:
        """Write the page, whole or not at all; raises `OutputError`."""
        write_text(path, self.html())


def _single(values: Any) -> Any:
    """Numbers in single precision; None for anything else."""
    if values is None or isinstance(values, str) or len(values) == 0:
        return None
    array = np.asarray(values)
    return array.astype(np.float32) if array.dtype.kind == "f" else None


def policy(*scripts: str) -> str:
    """A content security policy under which these inline scripts run and no other, and nothing is loaded."""
    digests = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts if s)
    allowed = " ".join(f"'sha256-{d}'" for d in digests) or "'none'"
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def origin(model: Model | None, data: Sequence[str | Path]) -> list[tuple[str, str]]:
    """What a page is about: when it was made, of which model with which history, over which recordings."""
    now = os.environ.get("SOURCE_DATE_EPOCH")
    when = datetime.fromtimestamp(int(now), UTC) if now and now.isdecimal() else datetime.now(UTC)
    out = [("made", f"{when:%Y-%m-%d %H:%M} UTC")]
    if model is not None:
        chain = " → ".join(f"{r.number} {r.added or 'first identification'}" for r in model.revisions) or "none"
        out += [("model", f"{model.robot.name}, SHA-256 {model.sha256 or 'not saved yet'}"), ("revisions", chain)]
        files = model.provenance.get("data", {})
        out.append(("identified from", ", ".join(f"{k} ({str(v)[:16]}…)" for k, v in files.items()) or "not recorded"))
    if data:
        out.append(("recordings shown", ", ".join(Path(p).name for p in data)))
    return out


@cache
def _own(name: str) -> str:
    return (resources.files("stopset.offline.report") / name).read_text(encoding="utf-8")


def said(text: str) -> Markup:
    """Words for people, commands in backticks set as such."""
    parts = str(text).split("`")
    return Markup("").join(Markup("<code>{}</code>").format(p) if k % 2 else p for k, p in enumerate(parts))


@cache
def _template() -> Template:
    environment = Environment(autoescape=True, trim_blocks=True)
    environment.filters["said"] = said
    return environment.from_string(_own("page.html.j2"))
