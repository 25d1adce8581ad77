"""Tables of other tools as recordings: text with or without a header, Parquet, NumPy's ``.npz`` and MATLAB's ``.mat``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from stopset.errors import RecordingError
from stopset.recording.column_names import TableColumns, asked, by_name, in_blocks, words
from stopset.recording.csv_table import open_csv
from stopset.recording.types import Meta, Recording
from stopset.types import Array
from stopset.unpacked import Allowance, TooLargeError, check_zip

TEXTS = frozenset({".csv", ".txt", ".tsv", ".dat"})
SUFFIXES = TEXTS | {".parquet", ".npz", ".mat"}
GAP = 5.5  # periods without a row that end a trial
SHORTEST = 10  # rows
TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # [s]
FASTEST, SLOWEST = 1e-4, 0.1  # [s] between two rows of any recording of an arm
TURNS = 8 * np.pi  # [rad] beyond which a number is in degrees
REMARKS = ("#", "%")


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


def read_table(path: Path, stated: Stated, effort: str, suite: int) -> tuple[Meta, list[Recording], str]:
    """Metadata, trials and what was taken for what, in words. Raises `RecordingError`."""
    try:
        names, numbers, columns = _opened(path, stated)
    except RecordingError as e:
        raise e if str(path) in str(e) else RecordingError(f"{path}: {e}") from e

    def block(which: Sequence[str]) -> Array:
        return np.stack([numbers[c] for c in which], axis=1)

    t, unit = _seconds(path, columns, numbers, stated.period, len(numbers[columns.q[0]]))
    q, dq = block(columns.q), block(columns.dq) if columns.dq else None
    degrees = stated.degrees or "deg" in {w[:3] for w in words(columns.q[0])}
    if degrees:
        q, dq = np.radians(q), None if dq is None else np.radians(dq)
    elif np.nanmax(np.abs(q), initial=0.0) > TURNS:
        raise RecordingError(
            f"{path}: {columns.q[0]} and others reach {np.nanmax(np.abs(q)):.4g}; expected rad: are they degrees? give --degrees"
        )
    tau, of = _torque(path, columns, numbers, stated.constants)
    trials = _trials(path, t, q, dq, tau, suite)
    rate = 1.0 / float(np.median(np.diff(trials[0].t)))
    meta = Meta(
        joints=columns.joints, effort=effort, velocity="derived" if dq is None else "measured",
        clock="assumed" if columns.t is None else "recorded", rate_hz=rate,
    )  # fmt: skip
    left = [n for n in names if n not in {columns.t, *columns.q, *columns.dq, *columns.tau, *columns.i}]
    said = f"{columns} of {', '.join(columns.joints)}; {unit}{'; angles in degrees' if degrees else ''}{of}"
    return meta, trials, said + (f"; {len(left)} other columns left out" if left else "")


def header(path: Path) -> list[str]:
    """The names of a text's columns, as its first line gives them. Raises `RecordingError` for an empty one."""
    return _fields(_begins(path)[1])


def columns_of(path: Path, names: Sequence[str]) -> dict[str, Array]:
    """Some columns of a text with a header. Raises `RecordingError`."""
    head, marks = header(path), re.findall(r"[,;\t]", _begins(path)[1].strip())
    return _separated(path, names) if marks else _plain(path, [head.index(c) for c in names], names, None, headed=True)


def _opened(path: Path, stated: Stated) -> tuple[list[str], dict[str, Array], TableColumns]:
    """Names of all columns, the numbers of those that are asked for, and which they are."""
    if path.suffix.lower() in TEXTS:
        return _text(path, stated)
    table = _parquet(path) if path.suffix.lower() == ".parquet" else _arrays(path)
    names = list(table)
    columns = _columns(names, stated)
    return names, {c: _numbers(c, table[c]) for c in _used(columns)}, columns


def _columns(names: list[str], stated: Stated) -> TableColumns:
    return by_name(names, stated.joints) if stated.columns is None else asked(names, stated.columns, stated.joints)


def _used(columns: TableColumns) -> list[str]:
    return [*([columns.t] if columns.t else []), *columns.q, *columns.dq, *columns.tau, *columns.i]


def _text(path: Path, stated: Stated) -> tuple[list[str], dict[str, Array], TableColumns]:
    """Separated by commas, semicolons or tabs as `open_csv` reads them, or by blanks."""
    remark, first = _begins(path)
    marks = re.findall(r"[,;\t]", first.strip())
    split = _fields(first)
    headed = not _is_number(split[0])
    names = split if headed else _fields(remark)
    if len(names) == len(split) and (stated.columns is None or "=" in stated.columns):
        columns = _columns(names, stated)
    else:
        names, columns = in_blocks(len(split), stated.columns, stated.joints)
    used = _used(columns)
    if headed and marks:
        return names, _separated(path, used), columns
    return names, _plain(path, [names.index(c) for c in used], used, marks[0] if marks else None, headed=headed), columns


def _begins(path: Path) -> tuple[str, str]:
    """The last remark of a text before its first line, and that line."""
    remark = ""
    with path.open(encoding="utf-8-sig", errors="replace") as f:
        for line in f:
            if line.lstrip().startswith(REMARKS):
                remark = line.strip().lstrip("#% ")
            elif line.strip():
                return remark, line
    raise RecordingError(f"{path} holds no row; expected a table of numbers: export it again")


def _fields(line: str) -> list[str]:
    marks = re.findall(r"[,;\t]", line.strip())
    return [x.strip(' "') for x in line.strip().split(marks[0])] if marks else line.split()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _separated(path: Path, used: Sequence[str]) -> dict[str, Array]:
    """Columns by their names in a table as `open_csv` reads them."""
    try:
        with open_csv(path, used.__contains__) as reader:
            table = reader.read_all().select(list(used))
    except (pa.ArrowInvalid, OSError, UnicodeDecodeError) as e:
        raise RecordingError(
            f"{path} is not a readable table ({str(e).splitlines()[0]}); expected numbers in every row: was the writing cut off?"
        ) from e
    return {c: _numbers(c, table.column(c).to_numpy()) for c in used}


def _plain(path: Path, places: Sequence[int], used: Sequence[str], mark: str | None, *, headed: bool) -> dict[str, Array]:
    """Columns by their places in a table of plain numbers."""
    with path.open(encoding="utf-8-sig", errors="replace") as f:
        rows = (line for line in f if line.strip() and not line.lstrip().startswith(REMARKS))
        try:
            table = np.loadtxt(islice(rows, int(headed), None), delimiter=mark, usecols=places, ndmin=2)
        except (ValueError, IndexError) as e:
            raise RecordingError(
                f"{path}: {str(e).splitlines()[0]}; expected numbers in every row: was the writing cut off?"
            ) from e
    return {c: table[:, k] for k, c in enumerate(used)}


def _parquet(path: Path) -> Mapping[str, Any]:
    from stopset.recording.files import opened

    schema, batches = opened(path)
    found = list(batches)
    return {n: np.concatenate([b.column(n).to_numpy(zero_copy_only=False) for b in found] or [np.empty(0)]) for n in schema.names}


def _arrays(path: Path) -> Mapping[str, Any]:
    """Columns of the arrays in a file; those of one with a row each sample are numbered after its name."""
    try:
        held = _npz(path) if path.suffix.lower() == ".npz" else _mat(path)
    except TooLargeError as e:
        raise RecordingError(f"{path} {e}") from e
    except NotImplementedError as e:
        raise RecordingError(
            f"{path} is a MATLAB file of version 7.3; expected version 5 to 7: save(..., '-v7') or export a CSV"
        ) from e
    except Exception as e:  # whatever readers of a damaged file raise
        why = f"{type(e).__name__}: {str(e)[:200]}".splitlines()[0]
        raise RecordingError(f"{path} is not readable ({why}); expected arrays of numbers: export it again") from e
    shapes = [x.shape for x in held.values() if x.ndim in (1, 2) and x.size]
    rows = max((max(s) for s in shapes), default=0)
    columns: dict[str, Any] = {}
    for name, x in held.items():
        if x.ndim == 2 and rows in x.shape:
            wide = x if x.shape[0] == rows else x.T
            columns |= {name if wide.shape[1] == 1 else f"{name}_{k}": wide[:, k - 1] for k in range(1, wide.shape[1] + 1)}
        elif x.shape == (rows,):
            columns[name] = x
    return columns


def _npz(path: Path) -> dict[str, Any]:
    check_zip(path)
    with np.load(path, allow_pickle=False) as f:
        return {name: f[name] for name in f.files}


def _mat(path: Path) -> dict[str, Any]:
    """Arrays of a MATLAB file, those of structs under both names."""
    from scipy.io import loadmat, whosmat

    allowed = Allowance.of(path.stat().st_size)
    for _, shape, _ in whosmat(str(path)):
        allowed.take(8 * int(np.prod(shape, dtype=float)))
    found: dict[str, Any] = {}

    def take(prefix: str, value: Any) -> None:
        if isinstance(value, dict):
            for name, x in value.items():
                if not name.startswith("__"):
                    take(f"{prefix}{name}", x) if not isinstance(x, dict) else take(f"{prefix}{name}.", x)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
            found[prefix] = value

    take("", loadmat(str(path), simplify_cells=True))
    return found


def _numbers(name: str, x: Any) -> Array:
    try:
        kind = np.asarray(x)
        return kind.astype("datetime64[ns]").astype(np.int64) if kind.dtype.kind == "M" else np.asarray(x, dtype=np.float64)
    except (ValueError, TypeError) as e:
        raise RecordingError(f"column {name} holds something else ({str(e)[:80]}); expected numbers: convert it") from e


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
    if constants is not None and (len(constants) != n or not all(np.isfinite(k) and k > 0 for k in constants)):
        raise RecordingError(
            f"{len(constants)} torque constants ({', '.join(f'{k:g}' for k in constants)}); expected {n} above 0, N m/A on the link side: gear "
            "ratio times the motor's constant"
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
