# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/sweeps``: how far each sweep is, how its errors spread, and the single runs together."""

from __future__ import annotations

from collections import Counter
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import where_equal
from slamhive.analysis.metrics import title_of
from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.answers.catalog import MAX_NAMES, chosen, current, names, single, sweep_names, tally
from slamhive.dashboard.problems import BadRequest, Missing
from slamhive.model.errors import suggestion
from slamhive.model.results import Outcome
from slamhive.model.search import SearchMethod
from slamhive.tables.manifests import manifest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.analysis.columns import Mask
    from slamhive.analysis.frame import Frame
    from slamhive.archive.records import SweepRecord
    from slamhive.dashboard.answering.totals import StoredSweeps
    from slamhive.dashboard.sources.archived import Snapshot

_LIVE = frozenset({"Pending", "Preparing", "Running"})
MOST_BEST = 3
MOST_SPREAD = 4
"""Datasets and algorithms of a sweep of which its card says how small the error became."""


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
    addresses = dict.fromkeys([*reversed(known), *snapshot.sweeps, *sweep_names(runs)])
    items = [_sweep(snapshot, runs, one, known.get(one, []), stored.totals) for one in addresses]
    items.sort(key=lambda item: (not item["live"], -_moment(item["created"] or item["finished"])))
    flat = ("name", "uid", "created", "live", "total", "runs", "started", "finished")
    return Body(
        {"revision": snapshot.revision, "items": items, "single": _together(runs, items)},
        lambda: {name: [item[name] for item in items] for name in flat},
    )


def _together(runs: Frame, items: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the single runs as one group: sweeps of one run, and on a cluster what belongs to none."""
    without = current(runs.select(~runs.column("sweep").present))
    alone = [item for item in items if item["single"]]
    statuses = Counter(tally(without.column("status")))
    for item in alone:
        statuses.update(item["statuses"])
    ends = [item["finished"] for item in alone] + [_end(without, "finished", np.nanmax)]
    return {
        "runs": len(alone) + len(without),
        "without": len(without),
        "live": any(item["live"] for item in alone),
        "statuses": dict(statuses.most_common()),
        "finished": max(filter(None, ends), key=_moment, default=None),
    }


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
    everything = chosen(runs, _of_sweep(runs, namespace, name))
    inside = current(everything)
    rows = current(chosen(snapshot.frame, _of_sweep(snapshot.frame, namespace, name)))
    best, spread = _errors(rows)
    live = snapshot.sweeps.get(address) or {}
    record = records[-1] if records else None
    phases = tally(inside.column("phase"))
    asked = live.get("total") if live.get("total") is not None else totals.get(record.uid) if record else None
    spec = live.get("spec") or (record.spec if record else {})
    created = live.get("created") or (record.created.isoformat() if record and record.created else None)
    return {
        "name": name,
        "namespace": namespace or None,
        "superseded": len(everything) - len(inside),
        "versions": len({one.uid for one in records} | ({live["uid"]} if live.get("uid") else set())),
        "uid": live.get("uid") or (record.uid if record else None),
        "created": created,
        "live": bool(live.get("live")) or bool(_LIVE & phases.keys()),
        "total": asked,
        "single": asked == 1 and not spec.get("matrix"),
        "search": method_of(spec),
        "runs": len(inside),
        "phases": phases | dict(live.get("phases") or {}),
        "statuses": tally(rows.column("status")),
        "algorithms": names(inside.column("algorithm"))[:MAX_NAMES],
        "datasets": names(inside.column("dataset"))[:MAX_NAMES],
        "started": _end(inside, "started", np.nanmin),
        "finished": _end(inside, "finished", np.nanmax),
        "axes": _axes(spec),
        "best": list(live.get("best") or ()) or best,
        "spread": spread,
    }


def method_of(spec: Mapping[str, Any]) -> str | None:
    """Return the method of a sweep that is a search; None of one that runs every point."""
    search = spec.get("search")
    method = search.get("method") if isinstance(search, dict) else None
    return str(method) if method not in {None, SearchMethod.GRID.value} else None


def _errors(rows: Frame) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the smallest ATE on each dataset, and how those of each algorithm lie over it.

    Metres of several datasets aren't put in one order, so the second are ratios to the first. Of several
    evaluations, the one that most results are of counts.
    """
    evaluation = next(iter(names(rows.column("evaluation"))), None)
    rows = chosen(rows, where_equal(rows, "evaluation", evaluation))
    tracked = chosen(rows, where_equal(rows, "outcome", Outcome.TRACKED))
    ate = tracked.column("ate.rmse").floats()
    tracked, ate = chosen(tracked, ate > 0), ate[ate > 0]
    ratios, best = np.ones(len(ate)), []
    for dataset in names(tracked.column("dataset")):
        inside = np.flatnonzero(where_equal(tracked, "dataset", dataset))
        least = inside[np.argmin(ate[inside])]
        ratios[inside] = ate[inside] / ate[least]
        name = tracked.column("name").take(np.array([least])).tolist()[0]
        best.append({"name": name, "ate": float(ate[least]), "dataset": dataset})
    spread = []
    for algorithm in names(rows.column("algorithm")):
        found = ratios[where_equal(tracked, "algorithm", algorithm)]
        ends = np.quantile(found, (0, 0.5, 1)).tolist() if len(found) else [None] * 3
        failed = int(where_equal(rows, "algorithm", algorithm).sum()) - len(found)
        values = dict(zip(("low", "median", "high"), ends, strict=True))
        spread.append({"algorithm": algorithm, **values, "failed": failed})
    spread.sort(key=lambda one: (one["median"] is None, one["median"], one["algorithm"]))
    return best[:MOST_BEST], spread[:MOST_SPREAD]


def _end(frame: Frame, name: str, choose: Any) -> str | None:
    column = frame.column(name)
    return str(column.plain(float(choose(column.floats())))) if not column.is_empty else None


def _axes(spec: Mapping[str, Any]) -> list[dict[str, Any]]:
    matrix = spec.get("matrix")
    axes = [axis for axis in matrix if isinstance(axis, dict)] if isinstance(matrix, list) else []
    paths = [axis.get("path") or "" for axis in axes]
    shown = []
    for axis, path in zip(axes, paths, strict=True):
        values = axis.get("values") or axis.get("points")
        count = len(values) if isinstance(values, list | dict) else (axis.get("range") or {}).get("count")
        shown.append({"name": axis.get("name") or title_of(path, "", paths) or None, "count": count})
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
    address, records = find_sweep(snapshot, runs, stored.records, name, namespace)
    record = records[-1] if records else None
    live = snapshot.sweeps.get(address)
    spec = (live or {}).get("spec") or (record.spec if record else {})
    return Body(
        _sweep(snapshot, runs, address, records, stored.totals)
        | {
            "revision": snapshot.revision,
            "spec": spec,
            "manifest": manifest("Sweep", name, record.labels if record else {}, spec) if spec else None,
            "evaluation": record.evaluation if record else None,
            "conditions": list((live or {}).get("conditions") or ()),
            "share": (live or {}).get("share"),
        }
    )


def find_sweep(
    snapshot: Snapshot, runs: Frame, known: Sequence[SweepRecord], name: str, namespace: str | None
) -> tuple[tuple[str, str], list[SweepRecord]]:
    """Return the (namespace, name) of the sweep that is meant, and its versions in the archive.

    Args:
        snapshot: the data.
        runs: its rows, one a run.
        known: the sweeps that the archive knows.
        name: the sweep's name.
        namespace: where it is; None where its name says enough.

    Raises:
        Missing: no sweep is called so.
        BadRequest: several are.
    """
    addresses = {*sweep_names(runs), *snapshot.sweeps, *((one.namespace or "", one.name) for one in known)}
    found = [(space, title) for space, title in addresses if title == name and namespace in {None, space}]
    if not found:
        titles = [title for _, title in addresses]
        raise Missing(f"unknown sweep {name[:100]!r}{suggestion(name[:100], titles)}", "name")
    if len(found) > 1:
        places = ", ".join(sorted(space or "this workstation" for space, _ in found))
        raise BadRequest(
            f"several sweeps are called {name!r}: say in which namespace ({places})", "namespace"
        )
    return found[0], [one for one in known if (one.namespace or "", one.name) == found[0]]
