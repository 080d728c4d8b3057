# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/search``: runs by what people remember of them: an algorithm, a dataset, a setting, a number."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.compact.texts import PackedTexts
from slamhive.analysis.grouping import SUBJECT, varying
from slamhive.analysis.measures import CONFIGURATION
from slamhive.analysis.selection import first_rows
from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.answers.columns import heading
from slamhive.dashboard.problems import BadRequest
from slamhive.tables.queries import select
from slamhive.tables.text import as_columns

if TYPE_CHECKING:
    from slamhive.analysis.columns import Column, Mask
    from slamhive.analysis.frame import Frame
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.tables.queries import Pairs

RESERVED = ("words", "limit", "format")
MOST_WORDS = 10
MOST_FOUND = 50
_MOST_SETTINGS = 12
_NAMED = ("uid", "run", "name", "note", "tags", "sweep", "status", "repetition", *SUBJECT)
_SETTINGS = (*CONFIGURATION, "label.")
_WORDS = {"true": 1.0, "false": 0.0}


def search(snapshot: Snapshot, pairs: Pairs, words: str, limit: int) -> Body:
    """Return the runs that all words fit, with the settings by which they differ.

    A word fits a run whose names, note, tags or settings hold it in any spelling, or one of whose numbers it
    is; ``nFeatures=1000`` fits that setting alone.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        words: separated by spaces.
        limit: runs at most.

    Raises:
        BadRequest: there are too many words.
    """
    asked = words.lower().split()
    if len(asked) > MOST_WORDS:
        raise BadRequest(f"words: {len(asked)} are too many, expected {MOST_WORDS} at most", "words")
    chosen = select(snapshot.frame, pairs, RESERVED, each=True)
    frame = chosen.frame.select(first_rows(chosen.frame))
    found = frame
    for word in asked:
        found = found.select(_fits(found, word))
    # The latest come first: they are looked for most.
    shown = found.select(np.arange(len(found))[::-1][:limit])
    names = [*SUBJECT, *varying(shown)[:_MOST_SETTINGS], "repetition"]
    rows = shown.records(["uid", "run", "status", *names])
    items = [
        {name: row[name] for name in ("uid", "run", "status")} | {"keys": {name: row[name] for name in names}}
        for row in rows
    ]
    content = {
        "revision": snapshot.revision,
        "total": len(found),
        "keys": [heading(shown, name) for name in names],
        "items": items,
        "notes": list(chosen.notes),
    }
    return Body(content, lambda: as_columns(rows))


def _fits(frame: Frame, word: str) -> Mask:
    """Tell which runs a word fits, (n,)."""
    fits = np.zeros(len(frame), dtype=bool)
    asked, equals, value = word.partition("=")
    for name in frame.names:
        setting, own = name.startswith(_SETTINGS), name.lower()
        if (not setting and name not in _NAMED) or (equals and not f".{own}".endswith(f".{asked}")):
            continue
        column = frame.glance(name)
        if setting and not equals and word in own.rpartition(".")[2]:
            fits |= column.present
        else:
            fits |= _holding(column, value if equals else word, whole=bool(equals))
    return fits


def _holding(column: Column, word: str, *, whole: bool) -> Mask:
    """Tell which values hold a word, (n,): as a part of a text unless as the whole, numbers as they are."""
    if column.kind.is_numeric:
        return column.equal(_number(word))
    mask: Mask
    if not isinstance(column.values, PackedTexts):
        texts = [str(value).lower() for value in column.values]
        verdicts = [word == text if whole else word in text for text in texts]
        return column.having(np.array([*verdicts, False], dtype=bool))
    # Of fewer rows than there are texts, theirs alone are looked at.
    rows = column.codes if len(column) < len(column.values) else slice(None)
    data, searched = np.strings.lower(column.values.data[rows]), word.encode("utf-8", "replace")
    mask = data == searched if whole else np.strings.find(data, searched) >= 0
    return column.having(np.append(mask, False)) if isinstance(rows, slice) else mask & column.present


def _number(word: str) -> float:
    """Return the number that a word is, NaN where it is none."""
    try:
        return float(_WORDS.get(word, word))
    except ValueError:
        return math.nan
