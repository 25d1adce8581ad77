"""How trials are handed on: never all at once, and anew at every call."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from stopset.recording import Recording
from stopset.types import Array

Source = Callable[[], Iterable[Recording]]
Pairs = Callable[[], Iterable[tuple[int, Recording, Array]]]  # (independent motion, trial on the grid, its input u)
