"""A programmed path as rows of angles in a CSV file."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from stopset.errors import NotCovered
from stopset.types import Array


def path_rows(path: Path, n: int) -> Array:
    """(W, n) [rad] from a CSV file; a first line that is no numbers is a head. Raises `NotCovered`."""
    try:
        lines = [r for r in csv.reader(path.read_text().splitlines()) if r]
    except (OSError, UnicodeDecodeError) as e:
        raise NotCovered(f"{path} cannot be read ({e}); expected a CSV file with {n} angles a row") from e
    try:
        head = 0 if lines and all(_is_number(x) for x in lines[0]) else 1
        values = [[float(x) for x in r] for r in lines[head:]]
    except ValueError as e:
        raise NotCovered(
            f"{path} holds rows that are not {n} numbers ({e}); expected {n} angles [rad] a row: give only these"
        ) from e
    wrong = next((r for r in values if len(r) != n), None)
    if wrong is not None:
        raise NotCovered(f"{path} holds a row of {len(wrong)} numbers; expected {n} angles [rad] a row: give one for every joint")
    return np.array(values).reshape(-1, n)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
