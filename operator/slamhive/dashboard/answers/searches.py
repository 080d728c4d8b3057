# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/sweeps/NAME/search``: what a search tried, how the best came about, and which settings matter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.analysis.metrics import title_of
from slamhive.archive.records import SweepRecord
from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.answers.catalog import single
from slamhive.dashboard.answers.columns import heading
from slamhive.dashboard.answers.sweeps import find_sweep
from slamhive.dashboard.problems import BadRequest
from slamhive.model.errors import InputError
from slamhive.model.search import SearchRecord
from slamhive.tables.searches import catalog_of, story_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.archive.records import CatalogEntry
    from slamhive.dashboard.sources.archived import Snapshot, Source
    from slamhive.tables.searches import SearchStory


@dataclass(frozen=True)
class SearchMaterial:
    """Knowledge of the archive about sweeps, and about the objects that they named.

    Attributes:
        sweeps: the sweeps that were asked for.
        catalog: Algorithms and Datasets as runs used them.
    """

    sweeps: Sequence[SweepRecord]
    catalog: Sequence[CatalogEntry]

    @classmethod
    def of(cls, source: Source) -> SearchMaterial:
        """Read it."""
        return cls(source.sweeps(), [*source.catalog("Algorithm"), *source.catalog("Dataset")])


def search(snapshot: Snapshot, known: SearchMaterial, name: str, namespace: str | None) -> Body:
    """Return the story of a search.

    Args:
        snapshot: the data.
        known: what the archive has beside.
        name: the sweep's name.
        namespace: where it is, needed where several sweeps have the name; empty for a workstation.

    Raises:
        Missing: no sweep is called so.
        BadRequest: several are, or it is no search.
    """
    address, records = find_sweep(snapshot, single(snapshot.frame), known.sweeps, name, namespace)
    live = snapshot.sweeps.get(address)
    record = records[-1] if records else None
    if live is not None and live.get("spec"):
        record = _live_record(address, live, record)
    if record is None:
        raise BadRequest(f"nothing is known of what {name[:100]!r} searches", "name")
    try:
        story = story_of(record, snapshot.frame, catalog_of(known.catalog))
    except InputError as error:
        raise BadRequest(str(error), "name") from error
    metrics = [one.metric for one in story.search.objectives]
    labels = [label for label, _ in story.axes]
    content = story.as_json() | {
        "revision": snapshot.revision,
        "metrics": [heading(snapshot.frame, metric, metrics) for metric in metrics],
        "titles": [title_of(label, among=labels) for label in labels],
    }
    return Body(content, lambda: _columns(story))


def _live_record(
    address: tuple[str, str], live: Mapping[str, Any], stored: SweepRecord | None
) -> SweepRecord:
    """Return the record of a cluster's Sweep as it is now, or as stored where that is all that is left."""
    told = live.get("search") or {}
    try:
        now = SearchRecord(trials=told.get("trials") or [], spared=told.get("spared") or 0)
    except ValueError as error:
        raise BadRequest(f"its status can't be read: {error}", "name") from error
    if not now.trials and stored is not None and stored.uid == live.get("uid"):
        return stored
    return SweepRecord(
        uid=str(live.get("uid") or ""),
        name=address[1],
        namespace=address[0] or None,
        spec=dict(live["spec"]),
        search=now,
    )


def _columns(story: SearchStory) -> dict[str, list[Any]]:
    """Return the settings as a table."""
    rows = [trial.as_json() for trial in story.trials]
    plain = ("number", "state", "origin", "told", "runs", "spared", "judged", "failed", "dropped", "at")
    columns: dict[str, list[Any]] = {"number": [row["number"] for row in rows]}
    for label, _ in story.axes:
        columns[label] = [row["values"][label] for row in rows]
    for number, objective in enumerate(story.search.objectives):
        columns[objective.metric] = [row["figures"][number] for row in rows]
    return columns | {name: [row[name] for row in rows] for name in plain}
