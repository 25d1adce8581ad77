"""Tables of other tools as recordings: their columns, told by names or stated, in SI units and cut into trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from stopset.errors import RecordingError
from stopset.recording.column_names import TableColumns, asked, by_name, in_blocks, words
from stopset.recording.files import TICKS
from stopset.recording.reader import PLAUSIBLE_ANGLE
from stopset.recording.tabular import SUFFIXES, Tabular, header, open_table
from stopset.recording.types import Meta, Recording
from stopset.types import Array

FEW = 1.6  # periods without a row that are a lost sample
GAP = 5.5  # periods without a row that end a trial
SHORTEST = 10  # rows
CUT_OFF = "; the last row is cut off and left out"
FASTEST, SLOWEST = 1e-4, 0.1  # [s] between two rows of any recording of an arm


@dataclass(frozen=True, slots=True)
class Stated:
    """What a table does not say: its ``columns`` (`asked`, `in_blocks`), the joints' names, units, and the period [s] of one without stamps."""

    columns: str | None = None
    joints: tuple[str, ...] | None = None
    degrees: bool = False
    constants: tuple[float, ...] | None = None  # [N m/A] torque per current of each joint, link side
    period: float | None = None


def is_table(path: Path) -> bool:
    """Whether a file's name is that of a table."""
    return path.suffix.lower() in SUFFIXES


def read_table(paths: Sequence[Path], stated: Stated, effort: str, suite: int) -> tuple[Meta, list[Recording], str]:
    """Metadata, trials and what was taken for what, in words; of several tables the columns stand beside each other, row by row.

    Raises `RecordingError`.
    """
    path = paths[0]
    tables = [open_table(p) for p in paths]
    try:
        names, columns = _named(tables, stated)
    except RecordingError as e:
        beside = f" and {len(paths) - 1} beside it" if len(paths) > 1 else ""
        raise RecordingError(f"{path}{beside}: {e}") from e
    numbers = _loaded(tables, names, columns)

    def block(which: Sequence[str]) -> Array:
        return np.stack([numbers[c] for c in which], axis=1)

    t, unit = _seconds(path, columns, numbers, stated.period, len(numbers[columns.q[0]]))
    q, dq = block(columns.q), block(columns.dq) if columns.dq else None
    degrees = stated.degrees or _says(columns.q, "deg")
    if degrees:
        q = np.radians(q)
    elif np.nanmax(np.abs(q), initial=0.0) > PLAUSIBLE_ANGLE:
        raise RecordingError(
            f"{path}: {columns.q[0]} and others reach {np.nanmax(np.abs(q)):.4g}; expected rad: are they degrees? give --degrees"
        )
    if dq is not None and (_says(columns.dq, "deg") or (degrees and not _says(columns.dq, "rad"))):
        dq = np.radians(dq)
    tau, of = _torque(path, columns, numbers, stated.constants)
    trials = _trials(path, t, q, dq, tau, suite)
    step = np.diff(trials[0].t)
    rate = 1.0 / float(step[step < FEW * np.median(step)].mean())
    meta = Meta(
        joints=columns.joints, effort=effort, velocity="derived" if dq is None else "measured",
        clock="assumed" if columns.t is None else "recorded", rate_hz=rate,
    )  # fmt: skip
    left = [n for n in names if n not in {columns.t, *columns.q, *columns.dq, *columns.tau, *columns.i}]
    said = f"{columns} of {', '.join(columns.joints)}; {unit}{'; angles in degrees' if degrees else ''}{of}"
    said += CUT_OFF if any(x.cut for x in tables) else ""
    return meta, trials, said + (f"; {len(left)} other columns left out" if left else "")


def _says(names: Sequence[str], unit: str) -> bool:
    """Whether columns' names tell their unit, ``deg`` or ``rad``."""
    return unit in {w[:3] for w in words(names[0])}


def columns_of(path: Path, names: Sequence[str]) -> dict[str, Array]:
    """Some columns of a text with a header. Raises `RecordingError`."""
    head = header(path)
    return dict(zip(names, open_table(path).load([head.index(c) for c in names]), strict=True))


def _named(tables: Sequence[Tabular], stated: Stated) -> tuple[list[str], TableColumns]:
    """Names of all columns of tables that stand beside each other, and what they hold."""
    if len(tables) == 1 and ("=" not in (stated.columns or "=") or not tables[0].names):
        return in_blocks(tables[0].width, stated.columns, stated.joints)
    names = [n for t in tables for n in t.names or _after(t)]
    if len(set(names)) < len(names):  # tables that name theirs alike: each after its file, too
        names = [f"{t.path.stem}.{n}" for t in tables for n in t.names or _after(t)]
    return names, by_name(names, stated.joints) if stated.columns is None else asked(names, stated.columns, stated.joints)


def _after(table: Tabular) -> list[str]:
    """Names of the columns of a table without a header, after its file's."""
    return [table.path.stem] if table.width == 1 else [f"{table.path.stem}_{k}" for k in range(1, table.width + 1)]


def _loaded(tables: Sequence[Tabular], names: Sequence[str], columns: TableColumns) -> dict[str, Array]:
    """The numbers of the columns that are used. Raises `RecordingError` for tables of different lengths."""
    used = [*([columns.t] if columns.t else []), *columns.q, *columns.dq, *columns.tau, *columns.i]
    found: dict[str, Array] = {}
    first = 0
    for table in tables:
        mine = [c for c in used if first <= names.index(c) < first + table.width]
        found |= dict(zip(mine, table.load([names.index(c) - first for c in mine]), strict=True)) if mine else {}
        first += table.width
    lengths = {len(x) for x in found.values()}
    if len(lengths) > 1:
        raise RecordingError(
            f"{tables[0].path} and {len(tables) - 1} beside it hold {' and '.join(map(str, sorted(lengths)))} rows; expected as many in each: "
            "were they recorded together?"
        )
    return found


def _seconds(
    path: Path, columns: TableColumns, numbers: Mapping[str, Array], period: float | None, rows: int
) -> tuple[Array, str]:
    """Stamps [s], and of which unit they were taken to be."""
    if columns.t is None:
        if period is None:
            raise RecordingError(
                f"{path}: no column of time; expected one (--columns t=NAME), or the time between two rows: --cycle 0.008"
            )
        return np.arange(rows, dtype=np.float64) * period, f"a row every {period:g} s, as stated"
    raw = numbers[columns.t]
    step = np.diff(raw)
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
    said = next((u for u in TICKS if u in words(columns.t)), None)
    dates = raw.dtype.kind == "i"
    whole = usual >= 1 and bool((np.round(raw) == raw).all())
    fits = [u for u, tick in TICKS.items() if FASTEST <= usual * tick <= SLOWEST]
    unit = "ns" if dates else said or (fits[0] if fits and (whole or fits[0] != "s") else "s")
    at: Array = (raw - raw[0]) * TICKS[unit]
    return at, f"time in {unit}"


def _torque(
    path: Path, columns: TableColumns, numbers: Mapping[str, Array], constants: tuple[float, ...] | None
) -> tuple[Array, str]:
    """Torques [N m], and what they were made of in words."""
    n = len(columns.q)
    if constants is not None and (len(constants) != n or not all(np.isfinite(k) and k != 0 for k in constants)):
        raise RecordingError(
            f"{len(constants)} torque constants ({', '.join(f'{k:g}' for k in constants)}); expected {n} that are not 0, N m/A on the link side: "
            "gear ratio times the motor's constant, below 0 where the current counts against the joint"
        )
    if columns.tau and constants is not None:
        raise RecordingError(
            f"{path}: torque constants are given, and {columns.tau[0]} .. {columns.tau[-1]} are taken for torques; expected currents: name their "
            "columns (--columns q=..,i=..), or leave the constants out"
        )
    if columns.tau:
        return np.stack([numbers[c] for c in columns.tau], axis=1), ""
    if not columns.i or constants is None:
        seen = "currents, but no torque constants" if columns.i else "no torque and no current"
        raise RecordingError(
            f"{path} holds {seen}; expected a torque: name its columns (--columns tau=..), or state --torque-constant K,..,K (N m/A on the link side)"
        )
    return np.stack([numbers[c] for c in columns.i], axis=1) * np.array(
        constants
    ), "; torque is current times the constants given"


def _trials(path: Path, t: Array, q: Array, dq: Array | None, tau: Array, suite: int) -> list[Recording]:
    """Unbroken runs of rows; a row that repeats the stamp before it is left out."""
    new = np.concatenate([[True], np.diff(t) != 0]) if len(t) else np.empty(0, bool)
    t, q, dq, tau = t[new], q[new], None if dq is None else dq[new], tau[new]
    step = np.diff(t)
    if len(t) < SHORTEST or not (step > 0).any():
        raise RecordingError(f"{path}: {len(t)} rows with stamps of their own; expected at least {SHORTEST}: record longer")
    period = float(np.median(step[step > 0]))
    edges = [0, *(np.flatnonzero((step > GAP * period) | (step < 0)) + 1).tolist(), len(t)]
    runs = [(a, b) for a, b in pairwise(edges) if b - a >= SHORTEST]
    if not runs:
        raise RecordingError(
            f"{path}: no {SHORTEST} rows follow one another without a gap; expected a steady clock: record again"
        )
    return [
        Recording(
            "closed_loop", suite, k, k, t[a:b] - t[a], q[a:b],
            np.gradient(q[a:b], t[a:b], axis=0) if dq is None else dq[a:b], tau[a:b],
        )
        for k, (a, b) in enumerate(runs)
    ]  # fmt: skip
