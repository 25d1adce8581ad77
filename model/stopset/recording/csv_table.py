"""A CSV table as tools write it: commas, semicolons or tabs, decimal points or commas, UTF-8 or UTF-16, remarks before its header."""

from __future__ import annotations

import codecs
import csv
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv

LINES = 20  # looked at for how the numbers are written
LONGEST = 1 << 20  # characters of one


def open_csv(
    path: Path, is_signal: Callable[[str], bool], *, signals_alone: bool = False, cut: bool = False
) -> pacsv.CSVStreamingReader:
    """A reader of the table's batches; columns that ``is_signal`` names are doubles, whatever their first rows hold.

    ``signals_alone``: of the others nothing is used, so whatever they hold is text. A last row ``cut`` off is left out.

    Raises `pyarrow.ArrowInvalid`, `OSError`, and `UnicodeDecodeError` where the text is neither UTF-8 nor UTF-16 with its mark.
    """
    with path.open("rb") as file:
        mark = file.read(2)
    encoding = "utf-16" if mark in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8"
    with path.open(encoding="utf-8-sig" if encoding == "utf-8" else encoding) as text:
        lines = list(islice(iter(lambda: text.readline(LONGEST), ""), LINES))
    remarks = next((k for k, line in enumerate(lines) if not line.startswith("#")), 0)
    header, *rows = lines[remarks:]
    separator = max(",;\t", key=header.count)  # of as many the first: a comma
    # a comma that does not part fields is a decimal one, where there are no points
    decimal = "," if separator != "," and any("," in r for r in rows) and not any("." in r for r in rows) else "."
    names = [name.strip() for name in next(csv.reader([header], delimiter=separator, skipinitialspace=True), [])]
    read = pacsv.ReadOptions(encoding=encoding, skip_rows=remarks + 1, column_names=names)
    parse = pacsv.ParseOptions(delimiter=separator)
    whole = path.read_bytes().rpartition(b"\n")[0] if cut else b""

    def source() -> Path | pa.BufferReader:
        return pa.BufferReader(whole) if cut else path

    plain = pacsv.open_csv(source(), read, parse, pacsv.ConvertOptions(decimal_point=decimal))
    types = dict.fromkeys((n for n in names if not is_signal(n)), pa.string()) if signals_alone else {}
    # types are read off the first block: an arm that stands still in it has whole numbers, a channel that is late none
    early = [f.name for f in plain.schema if is_signal(f.name) and (pa.types.is_integer(f.type) or pa.types.is_null(f.type))]
    types |= dict.fromkeys(early, pa.float64())
    if not types:
        return plain
    plain.close()
    return pacsv.open_csv(source(), read, parse, pacsv.ConvertOptions(decimal_point=decimal, column_types=types))
