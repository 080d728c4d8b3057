# SPDX-License-Identifier: Apache-2.0
"""Answers of ``/api/v1/analysis/suspects/truth``: ground truth that runs of different systems contradict."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.answers.common_support import Meant
from slamhive.runfiles.suspecting import MOST_RUNS, TRACKED_COLUMNS, LocatedRun, suspects_of, tracked_systems
from slamhive.tables.queries import select
from slamhive.tables.text import as_columns
from slamhive_eval.measures.suspects import LEAST_SYSTEMS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.dashboard.answers.common_support import ResultMaterial
    from slamhive.dashboard.sources.archived import Snapshot
    from slamhive.runfiles.suspecting import DatasetSuspects
    from slamhive.tables.queries import Pairs

RESERVED = ("format",)
MOST_COMPARED = 60
"""Runs whose paths one question reads at most: each takes some 50 ms."""


def meant(snapshot: Snapshot, pairs: Pairs) -> Meant:
    """Return the runs whose paths are compared: where enough algorithms tracked, a few of each.

    Args:
        snapshot: The data.
        pairs: The query string: filters.
    """
    chosen = select(snapshot.frame, pairs, RESERVED)
    notes, groups, few, count = list(chosen.notes), [], 0, 0
    beyond: list[str] = []
    rows = chosen.frame.records(list(TRACKED_COLUMNS))
    for dataset, systems in sorted(tracked_systems(rows).items()):
        group = [
            {"dataset": dataset, "algorithm": name, "uid": uid, "scaled": scaled}
            for name, runs in systems.items()
            for uid, scaled in list(runs.items())[:MOST_RUNS]
        ]
        if len(systems) < LEAST_SYSTEMS:
            few += 1
        elif count + len(group) > MOST_COMPARED:
            beyond.append(dataset)
        else:
            count += len(group)
            groups.append(group)
    if few:
        notes.append(
            f"fewer than {LEAST_SYSTEMS} algorithms tracked on {few} of {few + len(groups) + len(beyond)} "
            "datasets, which are not compared: two agree by chance"
        )
    if beyond:
        more = f" and {len(beyond) - 5} more" if len(beyond) > 5 else ""
        notes.append(
            f"at most {MOST_COMPARED} runs are compared at a time; choose by dataset for "
            f"{', '.join(beyond[:5])}{more}"
        )
    return Meant(groups, ["algorithm"], tracked=True, notes=notes)


def suspicious_truths(snapshot: Snapshot, given: ResultMaterial) -> Body:
    """Return the suspects of each dataset's ground truth."""
    found = [_suspects(given, rows, number) for number, rows in enumerate(given.meant.rows)]
    content = {
        "revision": snapshot.revision,
        "rows": sum(one.runs for one in found),
        "items": [one.as_json() for one in found],
        "notes": given.meant.notes,
    }
    return Body(content, lambda: as_columns([row for one in found for row in _flat(one)]))


def _suspects(given: ResultMaterial, rows: list[dict[str, Any]], number: int) -> DatasetSuspects:
    systems: dict[str, list[LocatedRun]] = {}
    for row in rows:
        uid = row["uid"]
        if uid in given.records:
            place, absence = given.places.get(uid), given.absences.get(uid)
            run = LocatedRun(given.records[uid], place, row["scaled"], absence)
            systems.setdefault(row["algorithm"], []).append(run)
    return suspects_of(rows[0]["dataset"], given.truths[number], systems, given.algorithms)


def _flat(one: DatasetSuspects) -> Iterator[dict[str, Any]]:
    """Yield a row for each stretch of a dataset; the only one of a dataset without any says why."""
    known = {"dataset": one.dataset, "runs": one.runs, "why": one.why}
    names = ("begin", "end", "metres", "spread", "ratio")
    stretches = one.found.stretches if one.found is not None else ()
    for part in stretches:
        yield known | {name: getattr(part, name) for name in names}
    if not stretches:
        yield known | dict.fromkeys(names)
