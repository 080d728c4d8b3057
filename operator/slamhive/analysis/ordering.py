# SPDX-License-Identifier: Apache-2.0
"""The order of values of any kind, and sorting by several columns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from slamhive.analysis.columns import sort_key

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from slamhive.analysis.columns import Floats, Indices
    from slamhive.analysis.frame import Frame

T = TypeVar("T")

UNIQUE = ("id", "evaluation")
"""Columns that every order ends with, so that no two rows are equal in it."""


def order_by(items: Iterable[T], columns: Iterable[str], get: Callable[[T, str], Any]) -> list[T]:
    """Return items sorted by columns, the first one slowest.

    Args:
        items: what to sort; equal ones keep their order.
        columns: names; a dash before one turns its order round. What is missing comes last either way.
        get: returns an item's value of a column.
    """
    found = list(items)
    for column in reversed(list(columns)):
        name = column.removeprefix("-")
        present = [item for item in found if get(item, name) is not None]
        absent = [item for item in found if get(item, name) is None]
        present.sort(key=lambda item: sort_key(get(item, name)), reverse=column.startswith("-"))
        found = present + absent
    return found


def order_rows(frame: Frame, sort: Sequence[str]) -> Indices:
    """Return the places of the rows in the order of some columns.

    Args:
        frame: the rows.
        sort: names; a dash before one turns its order round. What is missing comes last either way.
    """
    keys = [direction(frame, name) for name in complete(sort)]
    return np.lexsort(keys[::-1])


def complete(sort: Sequence[str]) -> list[str]:
    """Return the columns of an order, with those that leave no two rows equal in it."""
    return [*sort, *UNIQUE]


def direction(frame: Frame, name: str) -> Floats:
    """Return numbers, (n,), in the order of a column, turned round by a dash; +inf where missing."""
    ranks = frame.column(name.removeprefix("-")).ranks()
    return np.where(np.isinf(ranks), np.inf, -ranks) if name.startswith("-") else ranks
