# SPDX-License-Identifier: Apache-2.0
"""Writer of comma-separated values: the one for all tables, of the evaluator and of the packages above it.

Numbers have every digit. Texts that a spreadsheet would take for a formula are defused: labels, messages and
names of metrics come from others than those who open the file.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from typing import TextIO

_FORMULA = re.compile(r"'*[=+\-@\t\r\n]")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


class _CsvLines:
    """A stream whose lines end by a line feed; texts with a carriage return are quoted nevertheless."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, line: str) -> int:
        return self._stream.write(line.removesuffix("\r\n") + "\n")


def write_csv(stream: TextIO, columns: Iterable[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table, a line of names first.

    Args:
        stream: where to.
        columns: names, in order.
        rows: values in the same order; None, NaN and infinity become empty, lists and mappings JSON.
    """
    # A name is one line, and no sign in it turns the others around.
    lines = ("".join(sign if sign.isprintable() else " " for sign in defused(name)) for name in columns)
    csv.writer(_CsvLines(stream), lineterminator="\r\n").writerow(lines)
    _write_rows(stream, rows)


def _write_rows(stream: TextIO, rows: Iterable[Sequence[Any]]) -> None:
    csv.writer(_CsvLines(stream), lineterminator="\r\n").writerows(map(_cell, row) for row in rows)


def csv_blocks(columns: Iterable[str], blocks: Iterable[Sequence[Sequence[Any]]]) -> Iterator[str]:
    """Go through a table's text, the line of names first and then some rows at a time; see `write_csv`.

    Args:
        columns: names, in order.
        blocks: the values of some rows, column by column: many times as fast as row by row.
    """
    stream = io.StringIO()
    write_csv(stream, columns, ())
    yield stream.getvalue()
    for values in blocks:
        stream = io.StringIO()
        _write_columns(stream, values)
        yield stream.getvalue()


def _write_columns(stream: TextIO, values: Iterable[Sequence[Any]]) -> None:
    rows = zip(*map(_cells, values), strict=True)
    csv.writer(_CsvLines(stream), lineterminator="\r\n").writerows(rows)


def csv_text(columns: Mapping[str, Sequence[Any]]) -> str:
    """Return columns of equal length, by name, as a table's text; see `write_csv`."""
    stream = io.StringIO()
    write_csv(stream, columns, ())
    _write_columns(stream, columns.values())
    return stream.getvalue()


def defused(text: str) -> str:
    """Return a text that no spreadsheet takes for a formula.

    One that begins with = + - @, a tab or a line's end gets a ``'`` before it, unless it is a number; so does
    one that begins so after such signs. Taking one ``'`` from those gives all texts back.
    """
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


def _cells(values: Sequence[Any]) -> Sequence[Any]:
    """Return the cells of a column: of one type, as nearly all are, they need no look at each."""
    types = set(map(type, values)) - {type(None)}
    if types <= {int, float} and all(math.isfinite(value) for value in values if type(value) is float):
        return values
    if types == {str}:
        known = {value: _cell(value) for value in dict.fromkeys(values)}
        return list(map(known.__getitem__, values))
    return list(map(_cell, values))


def _cell(value: Any) -> Any:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return defused(value)
    return json.dumps(value) if isinstance(value, list | dict) else value
