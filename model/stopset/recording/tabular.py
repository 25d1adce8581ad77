"""Files of other tools with columns of numbers: text of any separator, Parquet, NumPy's ``.npz`` and MATLAB's ``.mat``, opened alike."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from stopset.errors import RecordingError
from stopset.recording.csv_table import open_csv
from stopset.types import Array
from stopset.unpacked import Allowance, TooLargeError, check_zip
from stopset.words import is_number

TEXTS = frozenset({".csv", ".txt", ".tsv", ".dat"})
SUFFIXES = TEXTS | {".parquet", ".npz", ".mat"}
REMARKS = ("#", "%")
LAST = 1 << 16  # bytes at a text's end in which its last row is looked for
MAT_HEAD, PACKED = 128, 15  # bytes of a MATLAB file before its first element, and the type of one that is compressed
PIECE = 1 << 16  # bytes unpacked at once, to count them


@dataclass(frozen=True, slots=True)
class Tabular:
    """A file's columns: their names, none where it has no header, how many, and ``load`` for the numbers of some by their places.

    ``cut``: the last row of a text, where it ends within it; it is left out.
    """

    path: Path
    names: tuple[str, ...]
    width: int
    load: Callable[[Sequence[int]], list[Array]]
    cut: str = ""


def open_table(path: Path) -> Tabular:
    """Raises `RecordingError` for what is none."""
    if path.suffix.lower() in TEXTS:
        return _text(path)
    held = _parquet(path) if path.suffix.lower() == ".parquet" else _arrays(path)
    names = tuple(held)
    return Tabular(path, names, len(names), lambda places: [_numbers(path, names[k], held[names[k]]) for k in places])


def header(path: Path) -> list[str]:
    """The names of a text's columns, as its first line gives them. Raises `RecordingError` for an empty one."""
    return _fields(_begins(path)[1])


def _text(path: Path) -> Tabular:
    """Separated by commas, semicolons or tabs as `open_csv` reads them, or by blanks; a header may be a remark."""
    remark, first = _begins(path)
    marks = re.findall(r"[,;\t]", first.strip())
    split = _fields(first)
    cut = _cut(path, len(split))
    if not is_number(split[0]):
        names = tuple(split)
        if marks:
            return Tabular(path, names, len(names), lambda places: _separated(path, names, places, cut), cut)
        return Tabular(path, names, len(names), lambda places: _plain(path, places, None, cut, headed=True), cut)
    above = tuple(_fields(remark))
    names = above if len(above) == len(split) else ()
    mark = marks[0] if marks else None
    return Tabular(path, names, len(split), lambda places: _plain(path, places, mark, cut, headed=False), cut)


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


def _cut(path: Path, width: int) -> str:
    """The last row of a text that ends within it, with fewer fields than ``width``, as where a logger was killed; else nothing."""
    with path.open("rb") as f:
        f.seek(max(0, path.stat().st_size - LAST))
        last = f.read().decode("utf-8", errors="replace").rpartition("\n")[2]
    return last if last.strip() and len(_fields(last)) < width else ""


def _separated(path: Path, names: Sequence[str], places: Sequence[int], cut: str) -> list[Array]:
    """Columns by their places in a table as `open_csv` reads them."""
    used = {names[k] for k in places}
    try:
        with open_csv(path, used.__contains__, signals_alone=True, cut=bool(cut)) as reader:
            table = reader.read_all()
    except (pa.ArrowInvalid, OSError, UnicodeDecodeError) as e:
        raise RecordingError(
            f"{path} is not a readable table ({str(e).splitlines()[0]}); expected numbers in every row: was the writing cut off?"
        ) from e
    return [_numbers(path, names[k], table.column(k).to_numpy()) for k in places]


def _plain(path: Path, places: Sequence[int], mark: str | None, cut: str, *, headed: bool) -> list[Array]:
    """Columns by their places in a table of plain numbers."""
    with path.open(encoding="utf-8-sig", errors="replace") as f:
        rows = (line for line in f if line.strip() and not line.lstrip().startswith(REMARKS) and line != cut)
        try:
            table = np.loadtxt(islice(rows, int(headed), None), delimiter=mark, usecols=places, ndmin=2)
        except (ValueError, IndexError) as e:
            raise RecordingError(
                f"{path}: {str(e).splitlines()[0]}; expected numbers in every row: was the writing cut off?"
            ) from e
    return list(table.T)


def _parquet(path: Path) -> dict[str, Any]:
    from stopset.recording.files import opened

    schema, batches = opened(path)
    found = list(batches)
    return {n: np.concatenate([b.column(n).to_numpy(zero_copy_only=False) for b in found] or [np.empty(0)]) for n in schema.names}


def _arrays(path: Path) -> dict[str, Any]:
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
    """Arrays of a MATLAB file, those of a struct under both names with a point between."""
    from scipy.io import loadmat

    _count_packed(path)
    found: dict[str, Any] = {}

    def take(name: str, value: Any) -> None:
        if isinstance(value, dict):
            for inner, x in value.items():
                take(f"{name}.{inner}" if name else str(inner), x)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and not name.startswith("__"):
            found[name] = value

    take("", loadmat(str(path), simplify_cells=True))
    return found


def _count_packed(path: Path) -> None:
    """Raises `TooLargeError` where the compressed elements of a MATLAB file (version 5) make more than is taken."""
    data = path.read_bytes()
    allowance, order, at = Allowance.of(len(data)), "<" if data[126:128] == b"IM" else ">", MAT_HEAD
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind == PACKED:
            stream, rest = zlib.decompressobj(), data[at + 8 : at + 8 + size]
            while rest:
                out = stream.decompress(rest, PIECE)
                allowance.take(len(out))
                rest = stream.unconsumed_tail if out else b""
        at += 8 + size


def _numbers(path: Path, name: str, x: Any) -> Array:
    try:
        kind = np.asarray(x)
        return kind.astype("datetime64[ns]").astype(np.int64) if kind.dtype.kind == "M" else np.asarray(x, dtype=np.float64)
    except (ValueError, TypeError) as e:
        raise RecordingError(f"{path}: column {name} holds something else ({str(e)[:80]}); expected numbers: convert it") from e
