# SPDX-License-Identifier: Apache-2.0
"""Table of runs on a site: columns as the API writes those of charts, in blocks of rows that stay.

Pages select, order and draw of it what they otherwise ask /api/v1/runs and /api/v1/analysis/points for
(``static/core/sitetable.js``); figures over groups are answers, and none is computed in a browser.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import Column, ColumnKind
from slamhive.analysis.grouping import OWNERS
from slamhive.analysis.selection import contents, preference
from slamhive.dashboard.answering.encoding import encode_json
from slamhive.dashboard.answers.analysis import mixtures
from slamhive.dashboard.answers.columns import coded, heading
from slamhive.tables.queries import QueryError, condition, select

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from slamhive.analysis.frame import Frame
    from slamhive.dashboard.publishing.folder import SiteFolder

BLOCK = 4096
"""Rows of a block: an update that adds runs writes the last one anew, and no other."""

_INLINE = 160
_FEW = 200
_NAMES = frozenset({"uid", "run", "name", "sweep", "note"})
_LISTS = frozenset({"tags"})
CONTENT, PREFERENCE = ":content", ":preference"


def written(folder: SiteFolder, frame: Frame, conditions: Sequence[str]) -> dict[str, Any]:
    """Write the columns of all runs, and return what tells where they are.

    Args:
        folder: the site's.
        frame: the rows, those of earlier versions among them.
        conditions: that pages put, for which no browser has a reader; those of unknown columns are left out.
    """
    frame = select(frame, [("superseded", "1")], (), each=True).frame
    held = {name: frame.column(name) for name in frame.names}
    columns = {
        name: heading(frame, name)
        | {"blocks": [] if column.is_empty else _blocks(folder, column, len(frame))}
        for name, column in held.items()
        if column.is_empty or _is_shown(column, name)
    }
    for name, numbers in _repeated(frame).items():
        column = Column.of_numbers(numbers.astype(np.float64), ColumnKind.INTEGER)
        columns[name] = {"name": name, "blocks": _blocks(folder, column, len(frame))}
    chosen = select(frame, [], ())
    return {
        "rows": len(frame),
        "block": BLOCK,
        "columns": columns,
        "conditions": dict(_met(folder, frame, conditions)),
        "notes": list(chosen.notes),
        "mixed": [
            {"column": one["column"], "owner": OWNERS.get(one["column"])}
            for one in mixtures(chosen.frame, [])
        ],
    }


def _met(folder: SiteFolder, frame: Frame, conditions: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Go through the conditions, each with the file of the rows that meet it."""
    for text in conditions:
        with suppress(QueryError):
            node = condition(frame, [("where", text)], ())
            if node is not None:
                yield text, folder.keep(np.flatnonzero(node.mask(frame)))


def _is_shown(column: Column, name: str) -> bool:
    """Tell whether a table shows a column: what is no word or number, and hashes, are on the runs' pages."""
    if column.kind is ColumnKind.OTHER and name not in _LISTS:
        return not any(isinstance(one, list | dict) for one in column.values)
    told = column.kind is ColumnKind.TEXT and name not in _NAMES
    return not told or len(column) < _FEW or len(column.unique()) <= len(column) // 2


def _repeated(frame: Frame) -> dict[str, Any]:
    """Return the columns of equal content and of its order of staying; {} where all content is different."""
    groups = contents(frame)
    known = groups[groups >= 0]
    if len(np.unique(known)) == len(known):
        return {}
    places = np.empty(len(frame), dtype=np.int64)
    places[preference(frame)] = np.arange(len(frame))
    return {CONTENT: np.unique(groups, return_inverse=True)[1] - int((groups < 0).any()), PREFERENCE: places}


def _blocks(folder: SiteFolder, column: Column, rows: int) -> list[Any]:
    """Return the place of each block of a column: the name of a file, or itself where that is shorter."""
    found: list[Any] = []
    for start in range(0, rows, BLOCK):
        part = coded(column.take(np.arange(start, min(start + BLOCK, rows))))
        content = encode_json(part)
        found.append(part if len(content) <= _INLINE else folder.keep_text(content))
    return found
