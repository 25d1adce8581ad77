"""How objects show themselves in a notebook: one sentence and one table, every text escaped."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any


def shown(title: str, sentence: str, head: Sequence[str] = (), rows: Sequence[Sequence[Any]] = ()) -> str:
    """HTML of an object; numbers to four digits and to the right, a dash where there is none."""
    cells = "".join(f"<tr>{''.join(_cell(c) for c in row)}</tr>" for row in rows)
    heads = "".join(f"<th>{escape(h)}</th>" for h in head)
    table = f"<table><thead><tr>{heads}</tr></thead><tbody>{cells}</tbody></table>" if rows else ""
    return f"<div><b>{escape(title)}</b><p>{escape(sentence)}</p>{table}</div>"


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return f"<td style='text-align:left'>{escape(value)}</td>"
    text = "–" if value is None else str(value) if isinstance(value, int) else f"{float(value):.4g}"
    return f"<td style='text-align:right'>{text}</td>"
