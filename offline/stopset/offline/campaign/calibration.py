"""Which motions the sets are fitted to and calibrated on, and which are held out to judge them (P8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

HELD_OUT_EVERY = 4
FEWEST_MOTIONS = 8  # below, nothing can be held out and calibrated at once


@dataclass(frozen=True, slots=True)
class Split:
    """Motions for fitting and calibrating, and held out."""

    used: tuple[int, ...]
    held: tuple[int, ...]


def split(motions: Sequence[int]) -> Split:
    """Every fourth motion held out where there are at least `FEWEST_MOTIONS`."""
    ordered = sorted(motions)
    if len(ordered) < FEWEST_MOTIONS:
        return Split(tuple(ordered), ())
    held = tuple(ordered[HELD_OUT_EVERY - 1 :: HELD_OUT_EVERY])
    return Split(tuple(m for m in ordered if m not in held), held)
