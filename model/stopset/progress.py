"""How long work says how far it is: what it does, and where that is known the share of it that is done."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

T = TypeVar("T")


class Progress(Protocol):
    """Is given each step of long work; ``share``: how much of this step is done, 0 to 1, None where nobody can say."""

    def __call__(self, text: str, share: float | None = None) -> None: ...


def silent(text: str, share: float | None = None) -> None:
    """Whom nobody listens to."""


def counted(items: Iterable[T], total: int | None, what: str, progress: Progress) -> Iterator[T]:
    """Yield the items, reporting before each how many are done; ``total``: how many there will be, None where nobody knows."""
    progress(what)
    for k, item in enumerate(items):
        progress(f"{what}: {k}" + (f" of {total}" if total else ""), min(1.0, k / total) if total else 0.0)
        yield item


def left(seconds: float, share: float | None) -> float | None:
    """Seconds that a step still needs, of which ``share`` took ``seconds``; None where too little is done to say."""
    return None if share is None or share < 0.02 or seconds < 0.5 else seconds * (1.0 - share) / share
