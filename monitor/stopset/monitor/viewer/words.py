"""Words that came over a bus, as they may be shown: no control sequence, nothing that turns the reading direction, not too long."""

from __future__ import annotations

import unicodedata
from typing import Any

LONGEST = 600  # letters of one text
# controls and escapes, formatting such as direction overrides, surrogates, line and paragraph separators
UNSEEN = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})


def plain(text: str) -> str:
    """``text`` in one line of what can be seen; anything else becomes a space."""
    seen = "".join(" " if unicodedata.category(c) in UNSEEN else c for c in text[: 4 * LONGEST])
    line = " ".join(seen.split())
    return line if len(line) <= LONGEST else line[: LONGEST - 1] + "…"


def cleaned(content: Any) -> Any:
    """The same JSON value with every text in it `plain`, names included."""
    if isinstance(content, str):
        return plain(content)
    if isinstance(content, dict):
        return {plain(str(k)): cleaned(v) for k, v in content.items()}
    if isinstance(content, list):
        return [cleaned(v) for v in content]
    return content
