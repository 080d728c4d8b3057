# SPDX-License-Identifier: Apache-2.0
"""Checker of a Sweep that is over: each point once, nothing lost, and its figures by the definition.

What counts is what the archive and the live objects hold together. The figures of the archive are reckoned
by the definition of every number (tests/honest/reckoning.py) and compared with the project's own table.
"""

from __future__ import annotations

import math
import statistics
from collections import Counter
from typing import TYPE_CHECKING, Any

import reckoning
from scaling.points import POINT, error_at, point_of
from sqlalchemy import create_engine

from slamhive.archive import Archive

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    Object = Mapping[str, Any]

CPU_SECONDS = 8.0
"""CPU time of a played run, s: see ``testcluster.kwok.run_message``."""


def problems(url: str, sweep: Object, live: Sequence[Object], count: int, retained: int) -> list[str]:
    """Return the faults of a Sweep that is over, a sentence each.

    Args:
        url: the archive.
        sweep: the Sweep.
        live: its runs that have objects.
        count: how many points it has.
        retained: how many finished runs keep their objects.
    """
    found = figures(url, sweep["metadata"]["uid"], live)
    status = sweep["status"]
    expected = {
        "points": count,
        "runs": count,
        "tracked": count,
        "cpuSeconds": CPU_SECONDS * count,
        "meanAte": round(statistics.fmean(error_at(value) for value in range(1, count + 1)), 9),
    }
    told = {
        "succeeded": status.get("succeeded"),
        "failed": status.get("failed"),
        "evaluated": status.get("evaluated"),
        "running": status.get("running"),
        "pending": status.get("pending"),
    }
    wanted = {"succeeded": count, "failed": 0, "evaluated": count, "running": 0, "pending": 0}
    wrong = [
        f"{name}: {found[name]}, not {value}" for name, value in expected.items() if found[name] != value
    ]
    wrong += [
        f"status.{name}: {told[name]}, not {value}" for name, value in wanted.items() if told[name] != value
    ]
    if len(live) != min(count, retained):
        wrong.append(f"{len(live)} runs have objects, not {min(count, retained)}")
    if not math.isclose(status.get("cpuSeconds") or 0.0, CPU_SECONDS * count, rel_tol=1e-6):
        wrong.append(f"status.cpuSeconds is {status.get('cpuSeconds')}, not {CPU_SECONDS * count}")
    best = [entry["ate"] for entry in status.get("best") or ()]
    least = sorted(error_at(value) for value in range(1, count + 1))[: len(best)]
    if not best or best != least:
        wrong.append(f"status.best has {best}, not {least}")
    return [*wrong, *_twice(url, sweep["metadata"]["uid"], live)]


def figures(url: str, sweep_uid: str, live: Iterable[Object]) -> dict[str, Any]:
    """Return counts and averages over a Sweep's runs, by the definition, from archive and live objects."""
    rows = _rows(url, sweep_uid)
    archived = {str(row["uid"]) for row in rows}
    others = [run for run in live if run["metadata"]["uid"] not in archived]
    errors = [float(row["ate.rmse"]) for row in rows if row["status"] == "Tracked"]
    errors += [
        float(result["ate"]["rmse"]) for run in others for result in run["status"].get("results") or ()
    ]
    seconds = [float(row["usage.cpu.seconds"]) for row in rows]
    seconds += [float(run["status"]["usage"]["cpu"]["seconds"]) for run in others]
    points = {int(row[f"parameters.{POINT}"]) for row in rows} | {point_of(run) for run in others}
    return {
        "points": len(points),
        "runs": len(rows) + len(others),
        "tracked": len(errors),
        "cpuSeconds": math.fsum(seconds),
        "meanAte": round(statistics.fmean(errors), 9) if errors else None,
    }


def _rows(url: str, sweep_uid: str) -> list[dict[str, Any]]:
    engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    try:
        tables = reckoning.read(engine)
    finally:
        engine.dispose()
    ours = [run for run in tables["runs"] if run["sweep_uid"] == sweep_uid]
    ids = {run["id"] for run in ours}
    results = [result for result in tables["results"] if result["run_id"] in ids]
    return reckoning.all_rows(tables | {"runs": ours, "results": results})


def _twice(url: str, sweep_uid: str, live: Iterable[Object]) -> list[str]:
    """Return the points that two runs did; one run may be in the archive and live for a moment."""
    runs = {run["metadata"]["uid"]: point_of(run) for run in live}
    with Archive.open(url, read_only=True) as archive:
        for record in archive.runs({"sweep_uid": sweep_uid}):
            runs[record.uid] = int(record.spec["parameters"][POINT])
    doubled = sorted(value for value, times in Counter(runs.values()).items() if times > 1)
    return [f"points {doubled[:10]} were done by several runs, {len(doubled)} in all"] if doubled else []
