# SPDX-License-Identifier: Apache-2.0
"""Questions that are known to cost little before they are computed, in seconds and in memory.

They are answered in the dashboard itself (``Workers.compute_inside``). All others are a worker's, which is
ended when they cost too much.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from slamhive.tables.queries import split_names

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.dashboard.sources.archived import Snapshot

MOST_ROWS = 200_000
MOST_PAGED = 2_000_000
"""Rows up to which those of a page are chosen and sorted, which takes some 30 ms a million."""

MOST_TEXT = 300
"""Characters of a query string: they bound its conditions, of which each goes over all rows once."""

MOST_GROUPS = 400
MOST_COMPETITORS = 40


def costs_little(
    data: Snapshot,
    query: str,
    by: str | None = None,
    default: Sequence[str] = (),
    most: int = MOST_GROUPS,
    *,
    most_rows: int = MOST_ROWS,
) -> bool:
    """Tell whether filtering, sorting and grouping are some tenths of a second of CPU at most.

    Args:
        data: the data.
        query: the whole query string.
        by: list of columns to group by.
        default: those when no list is given.
        most: groups at most, were all combinations of their values there.
        most_rows: of the table at most.
    """
    frame = data.frame
    told = [name for name in (split_names(by) or default) if name in frame.names]
    if len(frame) > most_rows or len(query) > MOST_TEXT:
        return False
    return math.prod(len(frame.column(name).unique()) for name in told) <= most
