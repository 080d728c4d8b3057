# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/analysis/versions``: what an edited Algorithm or Dataset changed."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from slamhive.analysis.versions import before_and_after
from slamhive.dashboard.answering.encoding import Body, plain
from slamhive.dashboard.answers.columns import heading
from slamhive.tables.queries import number_column, outcomes, select
from slamhive.tables.text import as_columns

if TYPE_CHECKING:
    from slamhive.analysis.versions import Change, Side, Version, VersionSetting
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.tables.queries import Pairs

RESERVED = ("metric", "outcomes", "format")
MAX_SETTINGS = 200
MAX_VALUES = 6


def changed(snapshot: Snapshot, pairs: Pairs, metric: str, which: str) -> Body:
    """Return each version against the ones before it; superseded runs are always meant.

    Args:
        snapshot: the data.
        pairs: the query string: filters.
        metric: column to compare by.
        which: tracked or all.
    """
    number_column(snapshot.frame, metric, "metric")
    chosen = select(snapshot.frame, pairs, RESERVED, always=True)
    found, notes = before_and_after(chosen.frame, metric, outcomes(which))
    if any(len(change.settings) > MAX_SETTINGS for change in found):
        notes.append(f"of each change the first {MAX_SETTINGS} settings are shown; the CSV has all")
    content = {
        "revision": snapshot.revision,
        "rows": len(chosen.frame),
        "metric": heading(chosen.frame, metric),
        "changes": [_change_json(change) for change in found],
        "notes": [*chosen.notes, *notes],
    }
    return Body(content, lambda: as_columns([row for change in found for row in _rows(change)]))


def _change_json(change: Change) -> dict[str, Any]:
    tested = change.test is not None
    return {
        "changed": change.changed,
        "keys": change.keys,
        "before": _version_json(change.before),
        "after": _version_json(change.after),
        "current": change.current,
        "n": len(change.settings),
        "settings": [_setting_json(setting) for setting in change.settings[:MAX_SETTINGS]],
        "unpaired": change.unpaired,
        "ratio": plain(change.ratio),
        "wins": dict(zip(("better", "worse", "same"), change.wins, strict=True)),
        "deterministic": change.deterministic,
        "test": change.test,
        "p": change.p if tested else None,
        "pHolm": change.p_holm if tested else None,
        "leastP": change.least_p if tested else None,
        "differences": [
            {"column": one.column, "before": one.before[:MAX_VALUES], "after": one.after[:MAX_VALUES]}
            for one in change.differences
        ],
        "sentence": change.sentence,
    }


def _version_json(version: Version) -> dict[str, Any]:
    times = {"first": version.first, "last": version.last}
    return {"version": version.version, "runs": version.runs} | {
        name: None if moment is None else datetime.fromtimestamp(moment, UTC).isoformat()
        for name, moment in times.items()
    }


def _setting_json(setting: VersionSetting) -> dict[str, Any]:
    return {
        "keys": setting.keys,
        "before": _side_json(setting.before),
        "after": _side_json(setting.after),
        "ratio": plain(setting.ratio),
    }


def _side_json(side: Side) -> dict[str, Any]:
    return {
        "runs": side.runs,
        "n": side.n,
        "failures": side.failures,
        "median": plain(side.median),
        "medianFailed": math.isinf(side.median),
        "points": list(side.points),
        "deterministic": side.same,
    }


def _rows(change: Change) -> list[dict[str, Any]]:
    """Return a line for each setting, one for a change without any."""
    shared = {
        "changed": change.changed,
        **change.keys,
        "version.before": change.before.version,
        "version.after": change.after.version,
        "settings": len(change.settings),
        "ratio": change.ratio,
        "better": change.wins[0],
        "worse": change.wins[1],
        "test": change.test,
        "p": change.p if change.test else None,
        "p.holm": change.p_holm if change.test else None,
        "sentence": change.sentence,
    }
    return [
        {
            **shared,
            **setting.keys,
            **{
                f"{when}.{name}": value
                for when, side in (("before", setting.before), ("after", setting.after))
                for name, value in _side_json(side).items()
                if name != "points"
            },
            "setting.ratio": setting.ratio,
        }
        for setting in change.settings
    ] or [shared]
