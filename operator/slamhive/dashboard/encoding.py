# SPDX-License-Identifier: Apache-2.0
"""Answers as bytes: JSON, CSV, Parquet. Numbers keep every digit; NaN and infinity become null."""

from __future__ import annotations

import csv
import importlib
import io
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import orjson

from slamhive.dashboard.problems import BadRequest, NotAcceptable
from slamhive.model.base import Choice
from slamhive.model.errors import suggestion

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    Columns = Mapping[str, Sequence[Any]]

_OPTIONS = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS


class Format(Choice):
    """How a table is sent."""

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
    """What an answer holds.

    Attributes:
        content: the JSON value.
        columns: returns the same as a table: values by column; None where the answer is no table.
        link: address of the next page.
    """

    content: Any
    columns: Callable[[], Columns] | None = None
    link: str | None = None


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


def encode_json(value: Any) -> bytes:
    """Return a value as JSON."""
    return orjson.dumps(value, option=_OPTIONS)


def encode_csv(columns: Columns) -> bytes:
    """Return columns as CSV, empty where nothing is known."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(map(_csv_cell, values) for values in columns.values()), strict=True))
    return stream.getvalue().encode("utf-8", "replace")


def plain(value: float | None) -> float | None:
    """Return a number, None for one that is not finite."""
    return value if value is not None and math.isfinite(value) else None


def _csv_cell(value: Any) -> Any:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, list | dict) else value


def _encode_parquet(columns: Columns) -> bytes:
    try:
        arrow = importlib.import_module("pyarrow")
        parquet = importlib.import_module("pyarrow.parquet")
    except ModuleNotFoundError:
        raise NotAcceptable(
            "Parquet needs the package pyarrow, which is not installed where this dashboard runs; "
            "take csv or json, or install slamhive[parquet]",
            "format",
        ) from None
    table = arrow.table({name: _arrow(arrow, values) for name, values in columns.items()})
    stream = io.BytesIO()
    parquet.write_table(table, stream)
    return stream.getvalue()


def _arrow(arrow: Any, values: Sequence[Any]) -> Any:
    cleaned = [json.dumps(value) if isinstance(value, list | dict) else value for value in values]
    try:
        return arrow.array(cleaned)
    except (arrow.ArrowInvalid, arrow.ArrowTypeError):
        return arrow.array([None if value is None else str(value) for value in cleaned])
