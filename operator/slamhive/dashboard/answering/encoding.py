# SPDX-License-Identifier: Apache-2.0
"""Answers as bytes: JSON, CSV, Parquet. Numbers keep every digit; NaN and infinity become null."""

from __future__ import annotations

import importlib
import io
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson

from slamhive.analysis.columns import ColumnKind
from slamhive.dashboard.problems import BadRequest, NotAcceptable
from slamhive.model.base import Choice
from slamhive.model.errors import suggestion
from slamhive_eval.formats.csv_writing import csv_blocks, csv_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from slamhive.analysis.columns import Column
    from slamhive.analysis.frame import Frame

    Columns = Mapping[str, Sequence[Any]]

_OPTIONS = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS


_BLOCK_ROWS = 2000


class Format(Choice):
    """Formats in which the API sends a table."""

    JSON = "json"
    CSV = "csv"
    PARQUET = "parquet"


TYPES = {
    Format.JSON: "application/json",
    Format.CSV: "text/csv; charset=utf-8",
    Format.PARQUET: "application/vnd.apache.parquet",
}


@dataclass(frozen=True)
class Body:
    """Content of an answer of the API: a JSON value, the same as a table, and a link to the next page.

    Attributes:
        content: the JSON value.
        columns: returns the same as a table: values by column; None where the answer is no table.
        link: address of the next page.
    """

    content: Any
    columns: Callable[[], Columns] | None = None
    link: str | None = None


@dataclass(frozen=True)
class Table:
    """Rows that are sent as a file, block by block.

    Attributes:
        frame: the rows.
        names: the columns.
    """

    frame: Frame
    names: Sequence[str]

    def blocks(self) -> Iterator[Frame]:
        """Go through some rows at a time, with nothing kept of those before."""
        for start in range(0, len(self.frame), _BLOCK_ROWS):
            yield self.frame.select(np.arange(start, min(start + _BLOCK_ROWS, len(self.frame))))


def choose_format(given: str | None, accept: str) -> Format:
    """Return the format asked for: by name, else by the header Accept, else JSON.

    Raises:
        BadRequest: there is no format of this name.
    """
    if given is not None:
        if given not in set(Format):
            raise BadRequest(f"unknown format {given[:100]!r}{suggestion(given[:100], Format)}", "format")
        return Format(given)
    for part in accept.split(","):
        kind = part.partition(";")[0].strip()
        for name, type_ in TYPES.items():
            if kind == type_.partition(";")[0]:
                return name
    return Format.JSON


def encode(body: Body, form: Format) -> bytes:
    """Return an answer's bytes.

    Raises:
        NotAcceptable: the answer is no table, or Parquet can't be written here.
    """
    if form is Format.JSON:
        return encode_json(body.content)
    if body.columns is None:
        raise NotAcceptable(f"this is no table: it comes as json, not as {form}", "format")
    return encode_csv(body.columns()) if form is Format.CSV else _encode_parquet(body.columns())


def encode_blocks(table: Table, form: Format) -> Iterator[bytes]:
    """Go through a table's bytes, block by block.

    Raises:
        NotAcceptable: Parquet can't be written here.
    """
    return _parquet_blocks(table) if form is Format.PARQUET else _csv_blocks(table)


def encode_json(value: Any) -> bytes:
    """Return a value as JSON."""
    return orjson.dumps(value, option=_OPTIONS)


def encode_csv(columns: Columns) -> bytes:
    """Return columns as CSV, empty where nothing is known."""
    return csv_text(columns).encode("utf-8", "replace")


def _csv_blocks(table: Table) -> Iterator[bytes]:
    columns = ([part.column(name).tolist() for name in table.names] for part in table.blocks())
    for text in csv_blocks(table.names, columns):
        yield text.encode("utf-8", "replace")


def plain(value: float | None) -> float | None:
    """Return a number, None for one that is not finite."""
    return value if value is not None and math.isfinite(value) else None


def _encode_parquet(columns: Columns) -> bytes:
    arrow, parquet = _parquet_modules()
    table = arrow.table({name: _arrow(arrow, values) for name, values in columns.items()})
    stream = io.BytesIO()
    parquet.write_table(table, stream)
    return stream.getvalue()


def _parquet_modules() -> tuple[Any, Any]:
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ModuleNotFoundError:
        raise NotAcceptable(
            "Parquet needs the package pyarrow, which is not installed where this dashboard runs; "
            "take csv or json, or install slamhive[parquet]",
            "format",
        ) from None


def _parquet_blocks(table: Table) -> Iterator[bytes]:
    arrow, parquet = _parquet_modules()
    columns = {name: table.frame.glance(name) for name in table.names}
    schema = arrow.schema([(name, _arrow_type(arrow, column)) for name, column in columns.items()])
    del columns
    sink = _Sink()
    with parquet.ParquetWriter(sink, schema) as writer:
        for part in table.blocks():
            values = {
                field.name: _arrow_as(arrow, part.column(field.name).tolist(), field.type) for field in schema
            }
            writer.write_table(arrow.table(values, schema=schema))
            yield sink.taken()
    yield sink.taken()


class _Sink(io.RawIOBase):
    """A file that only grows, whose content is taken away as it comes."""

    def __init__(self) -> None:
        super().__init__()
        self._parts: list[bytes] = []
        self._length = 0

    def writable(self) -> bool:
        return True

    def write(self, part: Any) -> int:
        content = bytes(part)
        self._parts.append(content)
        self._length += len(content)
        return len(content)

    def tell(self) -> int:
        return self._length

    def taken(self) -> bytes:
        """Return the bytes that were written since the last time."""
        found = b"".join(self._parts)
        self._parts.clear()
        return found


def _arrow_type(arrow: Any, column: Column) -> Any:
    """Return the Arrow type of all values of a column, whichever block they are in."""
    match column.kind:
        case _ if column.is_empty:
            return arrow.null()
        case ColumnKind.NUMBER:
            return arrow.float64()
        case ColumnKind.INTEGER:
            return arrow.int64()
        case ColumnKind.BOOLEAN:
            return arrow.bool_()
        case ColumnKind.OTHER:
            return _arrow(arrow, column.values).type
        case _:
            return arrow.string()


def _arrow_as(arrow: Any, values: Sequence[Any], kind: Any) -> Any:
    cleaned = [json.dumps(value) if isinstance(value, list | dict) else value for value in values]
    if kind == arrow.string():
        cleaned = [None if value is None else str(value) for value in cleaned]
    return arrow.array(cleaned, kind)


def _arrow(arrow: Any, values: Sequence[Any]) -> Any:
    cleaned = [json.dumps(value) if isinstance(value, list | dict) else value for value in values]
    try:
        return arrow.array(cleaned)
    except (arrow.ArrowInvalid, arrow.ArrowTypeError):
        return arrow.array([None if value is None else str(value) for value in cleaned])
