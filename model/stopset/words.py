"""Numbers of things, as they are said."""

from __future__ import annotations


def many(count: int, one: str) -> str:
    """``count`` and the thing of which there is ``one``: "1 trial", "0 trials", "12 trials"."""
    return f"{count} {one}{'' if count == 1 else 's'}"


def is_number(text: str) -> bool:
    """Whether a word is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
