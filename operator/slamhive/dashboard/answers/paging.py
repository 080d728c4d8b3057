# SPDX-License-Identifier: Apache-2.0
"""Pages of a sorted table that stay in place while rows come and go.

A page begins behind the last row of the one before, wherever that row would stand now. Its values of the
sort columns travel in a token, with a check sum over them and the question: a token that was changed, or
belongs to another question, is refused.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
from bisect import bisect_left
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import ColumnKind, sort_key
from slamhive.analysis.selection import complete, direction
from slamhive.dashboard.problems import BadRequest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.columns import Column, Mask
    from slamhive.analysis.frame import Frame

_CHECK_BYTES = 12
_PURPOSE = b"slamhive.page.1"


def rows_behind(frame: Frame, sort: Sequence[str], values: Sequence[Any]) -> Mask:
    """Tell which rows come behind a place in the order, (n,).

    Args:
        frame: the rows.
        sort: as for ``order_rows``.
        values: the place: values of the sort columns and of those of ``UNIQUE``.
    """
    behind = np.zeros(len(frame), dtype=bool)
    equal = np.ones(len(frame), dtype=bool)
    for name, value in zip(complete(sort), values, strict=True):
        column = frame.column(name.removeprefix("-"))
        keys = direction(frame, name)
        place = _place(column, value)
        if name.startswith("-") and np.isfinite(place):
            place = -place
        behind |= equal & (keys > place)
        equal &= keys == place
    return behind


def token(question: str, values: Sequence[Any]) -> str:
    """Return the token of the page behind a row.

    Args:
        question: what was asked for, but for the page.
        values: the row's values of the sort columns and of those of ``UNIQUE``.
    """
    content = json.dumps(list(values), separators=(",", ":")).encode()
    return base64.urlsafe_b64encode(_check(question, content) + content).decode().rstrip("=")


def read_token(text: str, question: str, length: int) -> list[Any]:
    """Return the values in a token.

    Raises:
        BadRequest: it was changed, or belongs to another question.
    """
    try:
        raw = base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
    except (binascii.Error, ValueError):
        raw = b""
    content = raw[_CHECK_BYTES:]
    if raw[:_CHECK_BYTES] != _check(question, content):
        raise BadRequest(
            "not a page of this question: take the address of the next page from the answer before it, "
            "and begin anew when sort, filters or columns change",
            "after",
        )
    values = json.loads(content)
    if not isinstance(values, list) or len(values) != length:
        raise BadRequest("not a page of this question", "after")
    return values


def last_values(frame: Frame, place: int, sort: Sequence[str]) -> list[Any]:
    """Return the values in the token of the page behind a row."""
    names = [name.removeprefix("-") for name in complete(sort)]
    row = frame.row(place, names)
    return [row[name] for name in names]


def _place(column: Column, value: Any) -> float:
    """Return the rank of a value in a column; midway between its neighbours if the value is gone."""
    if value is None:
        return np.inf
    if column.kind is ColumnKind.TIME:
        return _seconds(value)
    if column.kind.is_numeric:
        return float(value) if isinstance(value, int | float) else np.inf
    keys = sorted(sort_key(item) for item in column.values)
    key = sort_key(value)
    place = bisect_left(keys, key)
    return float(place) if place < len(keys) and keys[place] == key else place - 0.5


def _seconds(value: Any) -> float:
    return datetime.fromisoformat(str(value)).timestamp()


def _check(question: str, content: bytes) -> bytes:
    text = question.encode() + b"\0" + content
    return hashlib.blake2b(text, digest_size=_CHECK_BYTES, person=_PURPOSE).digest()
