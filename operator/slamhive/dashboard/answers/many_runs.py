# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/runs``: the table of runs, page by page, and its columns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

from slamhive.analysis.grouping import late_notes, varies, varying
from slamhive.analysis.selection import complete, order_rows
from slamhive.dashboard.answering.encoding import Body, Table
from slamhive.dashboard.answers import paging
from slamhive.dashboard.answers.columns import heading, profile
from slamhive.dashboard.problems import TooLarge
from slamhive.tables.queries import columns, select, split_names
from slamhive.tables.words import disproportion_notes, meanings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.frame import Frame
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.tables.queries import Pairs

DEFAULT_COLUMNS = (
    *("id", "uid", "run", "name", "sweep", "algorithm", "sensors", "dataset", "repetition"),
    *("phase", "status", "reason", "evaluation", "alignment", "outcome", "coverage"),
    *("ate.rmse", "rpe[0].rmse", "scale", "usage.cpu.meanCores", "usage.cpu.secondsPerDataSecond"),
    *("usage.memory.peakBytes", "usage.wallSeconds", "input.pace", "provenance.cpuModel", "finished"),
)
DEFAULT_LIMIT = 100
MAX_LIMIT = 1000
MAX_CELLS = 20_000_000
"""Rows times columns of a whole table: it is sent as it is made, in some 10 s for each 5 million."""

MAX_PAGE_CELLS = 200_000
"""The same of a page, which is made whole before it is sent."""

RESERVED = ("sort", "columns", "limit", "after", "format")


def chosen(snapshot: Snapshot, pairs: Pairs, reserved: Sequence[str]) -> tuple[Frame, list[str]]:
    """Return the selected rows, each run by itself, and sentences on what is left out."""
    found = select(snapshot.frame, pairs, reserved, each=True)
    return found.frame, list(found.notes)


def runs_page(
    snapshot: Snapshot,
    pairs: Pairs,
    *,
    path: str,
    sort: str | None,
    wanted: str | None,
    limit: int,
    after: str | None,
) -> Body:
    """Return a page of the table of runs.

    Args:
        snapshot: the data.
        pairs: the query string.
        path: address without it, for the next page's.
        sort: list of columns, a dash before one turns it round; default: the order of storing.
        wanted: list of columns; default: DEFAULT_COLUMNS.
        limit: rows at most.
        after: token of the page.
    """
    frame, left_out = chosen(snapshot, pairs, RESERVED)
    order = columns(snapshot.frame, sort, "sort")
    shown = columns(snapshot.frame, wanted, "columns", DEFAULT_COLUMNS)
    question = _question(pairs)
    total = len(frame)
    notes = [*meanings(frame, shown), *left_out, *late_notes(frame, shown), *disproportion_notes(frame)]
    same = [name for name in shown if total > 1 and not varies(frame, name)]
    if after is not None:
        place = paging.read_token(after, question, len(complete(order)))
        frame = frame.select(paging.rows_behind(frame, order, place))
    left = len(frame)
    frame = frame.select(order_rows(frame, order)[:limit])
    cells(len(frame), len(shown), MAX_PAGE_CELLS, "columns")
    link = None
    if left > limit:
        token = paging.token(question, paging.last_values(frame, len(frame) - 1, order))
        kept = [(name, value) for name, value in pairs if name != "after"]
        link = f"{path}?{urlencode([*kept, ('after', token)])}"
    return _table(snapshot, frame, shown, {"total": total, "next": link, "same": same, "notes": notes}, link)


def whole_table(snapshot: Snapshot, pairs: Pairs, *, sort: str | None, wanted: str | None) -> Table:
    """Return all rows that the filters mean, to be sent as one file.

    Raises:
        TooLarge: rows times columns are more than MAX_CELLS.
    """
    frame, _ = chosen(snapshot, pairs, RESERVED)
    order = columns(snapshot.frame, sort, "sort")
    shown = columns(snapshot.frame, wanted, "columns", DEFAULT_COLUMNS)
    cells(len(frame), len(shown), MAX_CELLS, "columns")
    return Table(frame.select(order_rows(frame, order)), shown)


def cells(rows: int, columns: int, most: int, field: str) -> None:
    """Refuse a table that is too large.

    Raises:
        TooLarge: rows times columns are more than may be.
    """
    if rows * columns > most:
        raise TooLarge(
            f"{rows:,} rows of {columns:,} columns are {rows * columns:,} values, and an answer has at most "
            f"{most:,}: choose fewer columns or rows",
            field,
        )


def _table(
    snapshot: Snapshot, frame: Frame, shown: list[str], more: dict[str, Any], link: str | None
) -> Body:
    def content() -> dict[str, list[Any]]:
        return {name: frame.column(name).tolist() for name in shown}

    return Body(
        {
            "revision": snapshot.revision,
            **more,
            "columns": [heading(frame, name, shown) for name in shown],
            "items": frame.records(shown),
        },
        content,
        link,
    )


def _question(pairs: Pairs) -> str:
    """Return the question that a page belongs to: all but which page it is and how it is shown."""
    kept = [(name, value) for name, value in pairs if name not in {"after", "limit", "columns", "format"}]
    return urlencode(sorted(kept))


def columns_list(snapshot: Snapshot, pairs: Pairs, wanted: str | None) -> Body:
    """Return the facts about the columns: kinds, ranges, and values where they are few.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        wanted: list of columns; default: all that hold something.
    """
    frame, left_out = chosen(snapshot, pairs, ("columns", "format"))
    columns(snapshot.frame, wanted, "columns")
    listed = split_names(wanted) or [
        name for name in snapshot.frame.names if not snapshot.frame.column(name).is_empty
    ]
    items = [profile(frame, name) for name in listed]
    flat = {
        key: [item.get(key) for item in items]
        for key in ("name", "kind", "title", "unit", "group", "count", "distinct", "min", "max")
    }
    content = {
        "revision": snapshot.revision,
        "rows": len(frame),
        "items": items,
        "varied": varying(frame) if wanted is None else [],
        "notes": left_out,
    }
    return Body(content, lambda: flat)
