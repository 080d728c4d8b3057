# SPDX-License-Identifier: Apache-2.0
"""``/api/v1``: what there is in numbers: evaluations, algorithms, datasets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive import __version__
from slamhive.analysis.grouping import where_equal
from slamhive.analysis.selection import first_rows
from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.problems import Missing
from slamhive.model.errors import suggestion
from slamhive.tables.manifests import manifest
from slamhive.tables.text import as_columns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.columns import Column, Mask
    from slamhive.analysis.frame import Frame
    from slamhive.archive.records import CatalogEntry
    from slamhive.dashboard.sources.archived import Snapshot, Source

MAX_NAMES = 200


def index(snapshot: Snapshot, source: Source) -> Body:
    """Return the contents of the archive in numbers."""
    return Body(state(snapshot, source) | {"version": __version__, "source": source.describe()})


def state(snapshot: Snapshot, source: Source) -> dict[str, Any]:
    """Return the state of the data in short."""
    everything, frame = single(snapshot.frame), current(snapshot.frame)
    runs = single(frame)
    counts = {
        name: len(names(runs.column(column)))
        for name, column in (("algorithms", "algorithm"), ("datasets", "dataset"))
    }
    counts["sweeps"] = len({*sweep_names(everything), *snapshot.sweeps, *snapshot.asked})
    counts["evaluations"] = len(names(frame.column("evaluation")))
    counts["superseded"] = len(everything) - len(runs)
    return {
        "revision": snapshot.revision,
        "counts": {"runs": len(runs), "rows": len(frame), **counts, "live": source.live_runs()},
        "statuses": tally(frame.column("status")),
        "phases": tally(runs.column("phase")),
        "problems": list(snapshot.problems),
    }


def single(frame: Frame) -> Frame:
    """Return one row a run."""
    rows = first_rows(frame)
    return frame if len(rows) == len(frame) else frame.select(rows)


def current(frame: Frame) -> Frame:
    """Return the rows of runs that are not superseded."""
    return chosen(frame, ~frame.column("superseded").present)


def chosen(frame: Frame, mask: Mask) -> Frame:
    """Return the rows of a mask; mostly all, which then keep the columns that were looked at."""
    return frame if mask.all() else frame.select(mask)


def tally(column: Column) -> dict[str, int]:
    """Return the count of each value of a column of texts."""
    if column.kind.is_numeric:
        return {}
    counts = np.bincount(column.codes[column.present], minlength=len(column.values)).tolist()
    pairs = zip(map(str, column.values), counts, strict=True)
    return dict(sorted((pair for pair in pairs if pair[1]), key=lambda pair: (-pair[1], pair[0])))


def names(column: Column) -> list[Any]:
    """Return the values of a column of texts, the most frequent first."""
    return list(tally(column))


def sweep_names(runs: Frame) -> list[tuple[str, str]]:
    """Return the (namespace, name) of the sweeps that runs belong to; no namespace is a workstation."""
    (spaces, places), (sweeps, titles) = (runs.column(name).factorized() for name in ("namespace", "sweep"))
    codes, firsts = np.unique(np.int64(spaces) * len(titles) + sweeps, return_index=True)
    pairs = [divmod(code, len(titles)) for code in codes[np.argsort(firsts)].tolist()]
    return [(places[space] or "", titles[name]) for space, name in pairs if titles[name] is not None]


def evaluations(snapshot: Snapshot) -> Body:
    """Return the evaluations that there are results of."""
    frame = current(snapshot.frame)
    items = []
    for name in names(frame.column("evaluation")):
        rows = frame.select(where_equal(frame, "evaluation", name))
        items.append(
            {
                "name": name,
                "alignments": names(rows.column("alignment")),
                "settings": names(rows.column("settings")),
                "rows": len(rows),
                "outcomes": tally(rows.column("outcome")),
            }
        )
    return Body({"revision": snapshot.revision, "items": items}, lambda: as_columns(items))


def catalog(snapshot: Snapshot, known: Sequence[CatalogEntry], kind: str) -> Body:
    """Return the Algorithms or Datasets that runs used, with what became of those runs."""
    entries = {entry.name: entry for entry in known}
    column = kind.lower()
    known_names = dict.fromkeys([*names(single(snapshot.frame).column(column)), *entries])
    items = [_entry(snapshot, column, name, entries.get(name)) for name in known_names]
    flat = ("name", "description", "runs", "labels", "attributes", "statuses")
    return Body(
        {"revision": snapshot.revision, "items": items},
        lambda: {name: [item[name] for item in items] for name in flat},
    )


def _entry(snapshot: Snapshot, column: str, name: str, entry: CatalogEntry | None) -> dict[str, Any]:
    rows = current(snapshot.frame.select(where_equal(snapshot.frame, column, name)))
    runs = single(rows)
    spec = entry.spec if entry else {}
    recorded = _attributes(runs) if column == "dataset" else {}
    return {
        "name": name,
        "description": spec.get("description"),
        "labels": entry.labels if entry else {},
        "attributes": (entry.attributes if entry else {}) or recorded,
        "runs": len(runs),
        "statuses": tally(rows.column("status")),
        "modes": names(runs.column("sensors")),
        ("datasets" if column == "algorithm" else "algorithms"): names(
            runs.column("dataset" if column == "algorithm" else "algorithm")
        )[:MAX_NAMES],
        "spec": spec,
    }


def _attributes(runs: Frame) -> dict[str, Any]:
    """Return the dataset's attributes as its runs recorded them, where they agree."""
    found = {}
    for name in runs.stored:
        if name.startswith("dataset.attributes."):
            values = runs.column(name).unique()
            if len(values) == 1 and values[0] is not None:
                found[name.removeprefix("dataset.attributes.")] = values[0]
    return found


def catalog_entry(snapshot: Snapshot, known: Sequence[CatalogEntry], kind: str, name: str) -> Body:
    """Return one Algorithm or Dataset with its manifest."""
    entries = [entry for entry in known if entry.name == name]
    column = kind.lower()
    if not entries and not where_equal(snapshot.frame, column, name).any():
        used = names(snapshot.frame.column(column))
        raise Missing(f"unknown {column} {name[:100]!r}{suggestion(name[:100], used)}", "name")
    entry = entries[-1] if entries else None
    content = _entry(snapshot, column, name, entry)
    content["manifest"] = manifest(kind, name, entry.labels, entry.spec) if entry else None
    content["versions"] = len(entries)
    if column == "algorithm":
        content["parameters"] = content["spec"].get("parameters") or {}
    else:
        content["sensors"] = content["spec"].get("sensors") or {}
    return Body({"revision": snapshot.revision, **content})
