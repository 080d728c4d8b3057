# SPDX-License-Identifier: Apache-2.0
"""``/api/v1``: what there is: sweeps, evaluations, algorithms, datasets."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from slamhive import __version__
from slamhive.analysis.grouping import where_equal
from slamhive.analysis.selection import first_rows
from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.problems import BadRequest, Missing
from slamhive.model.base import API_VERSION
from slamhive.model.errors import suggestion
from slamhive.tables.text import as_columns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.analysis.columns import Column, Mask
    from slamhive.analysis.frame import Frame
    from slamhive.archive.records import CatalogEntry, SweepRecord
    from slamhive.dashboard.answering.totals import StoredSweeps
    from slamhive.dashboard.sources.archived import Snapshot, Source

_MAX_NAMES = 200
_LIVE = frozenset({"Pending", "Preparing", "Running"})


def index(snapshot: Snapshot, source: Source) -> Body:
    """Return the contents of the archive in numbers."""
    return Body(state(snapshot, source) | {"version": __version__, "source": source.describe()})


def state(snapshot: Snapshot, source: Source) -> dict[str, Any]:
    """Return the state of the data in short."""
    everything, frame = single(snapshot.frame), current(snapshot.frame)
    runs = single(frame)
    counts = {
        name: len(_names(runs.column(column)))
        for name, column in (("algorithms", "algorithm"), ("datasets", "dataset"))
    }
    counts["sweeps"] = len({*_sweep_names(everything), *snapshot.sweeps, *snapshot.asked})
    counts["evaluations"] = len(_names(frame.column("evaluation")))
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
    return frame.select(first_rows(frame))


def current(frame: Frame) -> Frame:
    """Return the rows of runs that are not superseded."""
    return frame.select(~frame.column("superseded").present)


def tally(column: Column) -> dict[str, int]:
    """Return the count of each value of a column of texts."""
    if column.kind.is_numeric:
        return {}
    counts = np.bincount(column.codes[column.present], minlength=len(column.values)).tolist()
    pairs = zip(map(str, column.values), counts, strict=True)
    return dict(sorted((pair for pair in pairs if pair[1]), key=lambda pair: (-pair[1], pair[0])))


def _names(column: Column) -> list[Any]:
    return list(tally(column))


def _sweep_names(runs: Frame) -> list[tuple[str, str]]:
    """Return the (namespace, name) of the sweeps that runs belong to; no namespace is a workstation."""
    pairs = zip(runs.column("namespace").tolist(), runs.column("sweep").tolist(), strict=True)
    return list(dict.fromkeys((space or "", name) for space, name in pairs if name is not None))


def _of_sweep(frame: Frame, namespace: str, name: str) -> Mask:
    spaces = frame.column("namespace")
    inside = where_equal(frame, "namespace", namespace) if namespace else ~spaces.present
    return where_equal(frame, "sweep", name) & inside


def sweeps(snapshot: Snapshot, stored: StoredSweeps) -> Body:
    """Return the sweeps, the latest first, all versions of one together."""
    runs = single(snapshot.frame)
    known: dict[tuple[str, str], list[SweepRecord]] = {}
    for sweep in stored.records:
        known.setdefault((sweep.namespace or "", sweep.name), []).append(sweep)
    names = dict.fromkeys([*reversed(known), *snapshot.sweeps, *_sweep_names(runs)])
    items = [_sweep(snapshot, runs, name, known.get(name, []), stored.totals) for name in names]
    items.sort(key=lambda item: (not item["live"], -_moment(item["created"] or item["finished"])))
    flat = ("name", "uid", "created", "live", "total", "runs", "started", "finished")
    return Body(
        {"revision": snapshot.revision, "items": items},
        lambda: {name: [item[name] for item in items] for name in flat},
    )


def _moment(text: str | None) -> float:
    return datetime.fromisoformat(text).timestamp() if text else 0.0


def _sweep(
    snapshot: Snapshot,
    runs: Frame,
    address: tuple[str, str],
    records: Sequence[SweepRecord],
    totals: Mapping[str, int | None],
) -> dict[str, Any]:
    namespace, name = address
    everything = runs.select(_of_sweep(runs, namespace, name))
    inside = current(everything)
    rows = current(snapshot.frame.select(_of_sweep(snapshot.frame, namespace, name)))
    live = snapshot.sweeps.get(address) or {}
    record = records[-1] if records else None
    phases = tally(inside.column("phase"))
    total = live.get("total")
    created = live.get("created") or (record.created.isoformat() if record and record.created else None)
    return {
        "name": name,
        "namespace": namespace or None,
        "superseded": len(everything) - len(inside),
        "versions": len({one.uid for one in records} | ({live["uid"]} if live.get("uid") else set())),
        "uid": live.get("uid") or (record.uid if record else None),
        "created": created,
        "live": bool(live.get("live")) or bool(_LIVE & phases.keys()),
        "total": total if total is not None else totals.get(record.uid) if record else None,
        "runs": len(inside),
        "phases": phases | dict(live.get("phases") or {}),
        "statuses": tally(rows.column("status")),
        "algorithms": _names(inside.column("algorithm"))[:_MAX_NAMES],
        "datasets": _names(inside.column("dataset"))[:_MAX_NAMES],
        "started": _end(inside, "started", np.nanmin),
        "finished": _end(inside, "finished", np.nanmax),
        "axes": _axes(live.get("spec") or (record.spec if record else {})),
        "best": list(live.get("best") or ()),
    }


def _end(frame: Frame, name: str, choose: Any) -> str | None:
    column = frame.column(name)
    return str(column.plain(float(choose(column.floats())))) if not column.is_empty else None


def _axes(spec: Mapping[str, Any]) -> list[dict[str, Any]]:
    axes = spec.get("matrix")
    if not isinstance(axes, list):
        return []
    shown = []
    for axis in axes:
        if isinstance(axis, dict):
            values = axis.get("values") or axis.get("points")
            count = len(values) if isinstance(values, list | dict) else (axis.get("range") or {}).get("count")
            shown.append({"name": axis.get("name") or axis.get("path"), "count": count})
    return shown


def sweep(snapshot: Snapshot, stored: StoredSweeps, name: str, namespace: str | None) -> Body:
    """Return one sweep with its spec.

    Args:
        snapshot: the data.
        stored: the sweeps that the archive knows.
        name: the sweep's name.
        namespace: where it is, needed where several sweeps have the name; empty for a workstation.

    Raises:
        Missing: no sweep is called so.
        BadRequest: several are.
    """
    runs = single(snapshot.frame)
    known = {
        *_sweep_names(runs),
        *snapshot.sweeps,
        *((one.namespace or "", one.name) for one in stored.records),
    }
    found = [(space, title) for space, title in known if title == name and namespace in {None, space}]
    if not found:
        names = [title for _, title in known]
        raise Missing(f"unknown sweep {name[:100]!r}{suggestion(name[:100], names)}", "name")
    if len(found) > 1:
        places = ", ".join(sorted(space or "this workstation" for space, _ in found))
        raise BadRequest(
            f"several sweeps are called {name!r}: say in which namespace ({places})", "namespace"
        )
    address = found[0]
    records = [one for one in stored.records if (one.namespace or "", one.name) == address]
    record = records[-1] if records else None
    live = snapshot.sweeps.get(address)
    spec = (live or {}).get("spec") or (record.spec if record else {})
    return Body(
        _sweep(snapshot, runs, address, records, stored.totals)
        | {
            "revision": snapshot.revision,
            "spec": spec,
            "manifest": _manifest("Sweep", name, record.labels if record else {}, spec) if spec else None,
            "evaluation": record.evaluation if record else None,
            "conditions": list((live or {}).get("conditions") or ()),
        }
    )


def _manifest(kind: str, name: str, labels: Mapping[str, str], spec: Mapping[str, Any]) -> str:
    metadata: dict[str, Any] = {"name": name} | ({"labels": dict(labels)} if labels else {})
    body = {"apiVersion": API_VERSION, "kind": kind, "metadata": metadata, "spec": dict(spec)}
    return str(yaml.safe_dump(body, sort_keys=False, allow_unicode=True, width=100))


def evaluations(snapshot: Snapshot) -> Body:
    """Return the evaluations that there are results of."""
    frame = current(snapshot.frame)
    items = []
    for name in _names(frame.column("evaluation")):
        rows = frame.select(where_equal(frame, "evaluation", name))
        items.append(
            {
                "name": name,
                "alignments": _names(rows.column("alignment")),
                "settings": _names(rows.column("settings")),
                "rows": len(rows),
                "outcomes": tally(rows.column("outcome")),
            }
        )
    return Body({"revision": snapshot.revision, "items": items}, lambda: as_columns(items))


def catalog(snapshot: Snapshot, known: Sequence[CatalogEntry], kind: str) -> Body:
    """Return the Algorithms or Datasets that runs used, with what became of those runs."""
    entries = {entry.name: entry for entry in known}
    column = kind.lower()
    names = dict.fromkeys([*_names(single(snapshot.frame).column(column)), *entries])
    items = [_entry(snapshot, column, name, entries.get(name)) for name in names]
    flat = ("name", "description", "runs", "labels", "attributes", "statuses")
    return Body(
        {"revision": snapshot.revision, "items": items},
        lambda: {name: [item[name] for item in items] for name in flat},
    )


def _entry(snapshot: Snapshot, column: str, name: str, entry: CatalogEntry | None) -> dict[str, Any]:
    rows = current(snapshot.frame.select(where_equal(snapshot.frame, column, name)))
    runs = single(rows)
    spec = entry.spec if entry else {}
    return {
        "name": name,
        "description": spec.get("description"),
        "labels": entry.labels if entry else {},
        "attributes": (entry.attributes if entry else {}) or _attributes(runs),
        "runs": len(runs),
        "statuses": tally(rows.column("status")),
        "modes": _names(runs.column("sensors")),
        ("datasets" if column == "algorithm" else "algorithms"): _names(
            runs.column("dataset" if column == "algorithm" else "algorithm")
        )[:_MAX_NAMES],
        "spec": spec,
    }


def _attributes(runs: Frame) -> dict[str, Any]:
    """Return the dataset's attributes as its runs recorded them, where they agree."""
    found = {}
    for name in runs.stored:
        if name.startswith("dataset.attributes."):
            values = runs.column(name).factorized()[1]
            if len(values) == 1 and values[0] is not None:
                found[name.removeprefix("dataset.attributes.")] = values[0]
    return found


def catalog_entry(snapshot: Snapshot, known: Sequence[CatalogEntry], kind: str, name: str) -> Body:
    """Return one Algorithm or Dataset with its manifest."""
    entries = [entry for entry in known if entry.name == name]
    column = kind.lower()
    if not entries and not where_equal(snapshot.frame, column, name).any():
        used = _names(snapshot.frame.column(column))
        raise Missing(f"unknown {column} {name[:100]!r}{suggestion(name[:100], used)}", "name")
    entry = entries[-1] if entries else None
    content = _entry(snapshot, column, name, entry)
    content["manifest"] = _manifest(kind, name, entry.labels, entry.spec) if entry else None
    content["versions"] = len(entries)
    if column == "algorithm":
        content["parameters"] = content["spec"].get("parameters") or {}
    else:
        content["sensors"] = content["spec"].get("sensors") or {}
    return Body({"revision": snapshot.revision, **content})
