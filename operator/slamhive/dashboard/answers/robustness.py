# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/analysis/robustness``: up to where on each axis each system still works."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.analysis.searches.robustness import robustness
from slamhive.dashboard.answering.encoding import Body, plain
from slamhive.dashboard.answers.columns import heading
from slamhive.model.errors import InputError
from slamhive.tables.queries import QueryError, select

if TYPE_CHECKING:
    from slamhive.analysis.searches.robustness import RobustnessWish
    from slamhive.analysis.searches.thresholds import Threshold
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.tables.queries import Pairs

RESERVED = ("axes", "failing", "quantile", "format")


def card_of(snapshot: Snapshot, pairs: Pairs, wish: RobustnessWish) -> Body:
    """Return the robustness card of the runs that are meant."""
    chosen = select(snapshot.frame, pairs, RESERVED, each=True)
    try:
        card = robustness(chosen.frame, wish)
    except InputError as error:
        raise QueryError(str(error), error.argument or None) from None
    content = {
        "revision": snapshot.revision,
        "rows": len(chosen.frame),
        "axes": [heading(chosen.frame, axis) for axis in card.axes],
        "systems": [
            {"keys": dict(key), "cells": [None if cell is None else _cell(cell) for cell in cells]}
            for key, cells in zip(card.rows, card.cells, strict=True)
        ],
        "notes": [*chosen.notes, *card.notes],
    }
    return Body(content, card.columns)


def _cell(cell: Threshold) -> dict[str, Any]:
    return {
        "status": str(cell.status),
        "falls": cell.falls,
        "passing": cell.passing,
        "failing": cell.failing,
        "sure": list(cell.sure),
        "sentence": cell.sentence,
        "runs": cell.runs,
        "values": [
            {"value": one.value, "failed": one.failed, "known": one.known, "share": plain(one.share)}
            for one in cell.tallies
        ],
    }
