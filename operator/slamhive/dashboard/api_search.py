# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/search``: runs by what people remember of them: an algorithm, a dataset, a setting, a number."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import CONFIGURATION, SUBJECT, varying
from slamhive.analysis.selection import first_rows
from slamhive.dashboard.encoding import Body
from slamhive.dashboard.problems import BadRequest
from slamhive.dashboard.tables import heading
from slamhive.tables.queries import select
from slamhive.tables.text import as_columns

if TYPE_CHECKING:
    from slamhive.analysis.columns import Column, Mask
    from slamhive.analysis.frame import Frame
    from slamhive.dashboard.sources import Snapshot
    from slamhive.tables.queries import Pairs

RESERVED = ("words", "limit", "format")
MOST_WORDS = 10
MOST_FOUND = 50
_MOST_SETTINGS = 12
_NAMED = ("uid", "run", "name", "sweep", "status", "repetition", *SUBJECT)
_SETTINGS = (*CONFIGURATION, "label.")


def search(snapshot: Snapshot, pairs: Pairs, words: str, limit: int) -> Body:
    """Return the runs that all words fit, with the settings by which they differ.

    A word fits a run whose names or settings hold it in any spelling, or one of whose numbers it is;
    ``nFeatures=1000`` fits that setting alone.

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
    fitting = np.ones(len(frame), dtype=bool)
    for word in asked:
        fitting &= _fits(frame, word)
    found = frame.select(fitting)
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
    name, equals, value = word.partition("=")
    for column in frame.names:
        setting = column.startswith(_SETTINGS)
        if not setting and column not in _NAMED:
            continue
        own = column.lower()
        if equals:
            if own == name or own.endswith(f".{name}"):
                fits |= _holding(frame.glance(column), value, whole=True)
            continue
        held = frame.glance(column)
        if setting and word in own.rpartition(".")[2]:
            fits |= held.present
        fits |= _holding(held, word)
    return fits


def _holding(column: Column, word: str, *, whole: bool = False) -> Mask:
    """Tell which values hold a word, (n,): as a part of a text unless as the whole, numbers as they are."""
    codes, values = column.factorized()
    verdicts = np.array([_is(value, word, whole=whole) for value in values], dtype=bool)
    mask: Mask = verdicts[codes] if len(values) else np.zeros(len(codes), dtype=bool)
    return mask


def _is(value: Any, word: str, *, whole: bool) -> bool:
    if value is None:
        return False
    if isinstance(value, str):
        return value.lower() == word if whole else word in value.lower()
    if isinstance(value, bool):
        return word == str(value).lower()
    try:
        return float(word) == float(value)
    except (TypeError, ValueError):
        return False
