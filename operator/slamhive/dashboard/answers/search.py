# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/search``: runs by what people remember of them: an algorithm, a dataset, a setting, a number."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

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
    found = frame.select(_fitting(frame, asked))
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


def _fitting(frame: Frame, words: list[str]) -> Mask:
    """Tell which runs all words fit, (n,)."""
    fits = [np.zeros(len(frame), dtype=bool) for _ in words]
    for name in frame.names:
        setting = name.startswith(_SETTINGS)
        if not setting and name not in _NAMED:
            continue
        own = name.lower()
        column = frame.glance(name)
        texts = None if column.kind.is_numeric else _lower(column.values)
        for fit, word in zip(fits, words, strict=True):
            asked, equals, value = word.partition("=")
            if equals:
                if own == asked or own.endswith(f".{asked}"):
                    np.logical_or(fit, _holding(column, texts, value, whole=True), out=fit)
                continue
            if setting and word in own.rpartition(".")[2]:
                np.logical_or(fit, column.present, out=fit)
            np.logical_or(fit, _holding(column, texts, word, whole=False), out=fit)
    found: Mask = np.logical_and.reduce(fits) if fits else np.ones(len(frame), dtype=bool)
    return found


def _lower(values: Any) -> Any:
    if isinstance(values, PackedTexts):
        return np.strings.lower(values.data)
    return [str(value).lower() for value in values]


def _holding(column: Column, texts: Any, word: str, *, whole: bool) -> Mask:
    """Tell which values hold a word, (n,): as a part of a text unless as the whole, numbers as they are."""
    mask: Mask
    if texts is None:
        mask = column.numbers == _number(word)
        return mask
    verdicts: Any
    if isinstance(texts, np.ndarray):
        searched = word.encode("utf-8", "replace")
        verdicts = texts == searched if whole else np.strings.find(texts, searched) >= 0
    else:
        verdicts = [word == text if whole else word in text for text in texts]
    mask = np.array([*verdicts, False], dtype=bool)[column.codes]
    return mask


def _number(word: str) -> float:
    """Return the number that a word is, NaN where it is none."""
    try:
        return float(_WORDS.get(word, word))
    except ValueError:
        return math.nan
