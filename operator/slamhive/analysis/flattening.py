# SPDX-License-Identifier: Apache-2.0
"""A record of a run as flat rows, one a run and evaluation, under the names the field uses."""

from __future__ import annotations

import re
import sys
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from datetime import datetime

    from slamhive.model.results import Result, RunRecord

Row = dict[str, Any]

_STATISTICS = ("rmse", "mean", "median", "std", "min", "max", "sse")

CORE_COLUMNS: tuple[str, ...] = (
    *("run", "sweep", "algorithm", "sensors", "dataset", "repetition", "seed"),
    *("phase", "reason", "message", "attempts"),
    *("evaluation", "alignment", "outcome", "coverage", "scale"),
    *(f"ate.{name}" for name in _STATISTICS),
    *(f"rpe[0].{name}" for name in ("delta", "unit", "pairs", "count", *_STATISTICS)),
    *("usage.cpu.meanCores", "usage.cpu.maxCores", "usage.cpu.seconds", "usage.cpu.secondsPerDataSecond"),
    *("usage.memory.peakBytes", "usage.memory.meanBytes", "usage.memory.anonymousPeakBytes"),
    *("usage.wallSeconds", "usage.includesReader", "frames.offered", "frames.processed", "frames.dropped"),
    *("input.pace", "input.frameRate", "input.resolution"),
    *("trajectory.poses", "trajectory.durationSeconds", "provenance.cpuModel"),
    *("name", "uid", "index", "created", "started", "finished", "folder"),
)
"""Columns that every row has, None where nothing is known; others depend on what was run."""

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def flatten(record: RunRecord, evaluation: str | None = None) -> list[Row]:
    """Return a run's rows: one for each evaluation, or a single one without.

    Beside the core columns there are ``parameters.NAME``, ``input.NAME``, ``resources.NAME``,
    ``dataset.attributes.NAME``, ``label.NAME``, ``metrics.NAME``, ``provenance.NAME`` and whatever an
    evaluator found, nested names joined by dots, lists of records numbered as in ``rpe[0].rmse``.
    ``run`` is the label ``run`` where there is one (a number if it looks like one), else the name.

    Args:
        record: the run.
        evaluation: only this evaluation; a run without it gives one row without results.
    """
    base = _of_run(record)
    results = record.results
    if evaluation is not None:
        results = [result for result in results if result.evaluation == evaluation]
        base["evaluation"] = evaluation
    if not results:
        return [base]
    return [_of_result(dict(base), result) for result in results]


def columns_of(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the columns that rows have: the core ones, then the others sorted."""
    known = dict.fromkeys(CORE_COLUMNS)
    others: dict[str, None] = {}
    for row in rows:
        others.update(dict.fromkeys(row.keys() - known.keys()))
    return [*known, *sorted(others)]


def _of_run(record: RunRecord) -> Row:
    row: Row = dict.fromkeys(CORE_COLUMNS)
    spec = record.spec
    row |= {
        "run": number_or_text(record.labels["run"]) if "run" in record.labels else record.name,
        "name": record.name,
        "uid": record.uid,
        "sweep": record.sweep,
        "index": record.index,
        "algorithm": (spec.get("algorithmRef") or {}).get("name"),
        "dataset": (spec.get("datasetRef") or {}).get("name"),
        "sensors": spec.get("sensors"),
        "repetition": spec.get("repetition"),
        "seed": spec.get("seed"),
        "phase": record.phase.value,
        "reason": record.reason.value if record.reason else None,
        "message": record.message,
        "attempts": record.attempts,
        "created": _time(record.created),
        "started": _time(record.started),
        "finished": _time(record.finished),
        "folder": record.folder,
    }
    for prefix, value in (
        ("parameters", spec.get("parameters")),
        ("input", spec.get("input")),
        ("resources", spec.get("resources")),
        ("dataset.attributes", record.attributes),
        ("label", record.labels),
        ("metrics", record.metrics),
        ("usage", record.usage.as_json() if record.usage else None),
        ("frames", record.frames.as_json() if record.frames else None),
        ("trajectory", record.trajectory.as_json() if record.trajectory else None),
        ("provenance", record.provenance.as_json()),
    ):
        if value:
            _spread(row, prefix, value)
    return row


def _of_result(row: Row, result: Result) -> Row:
    message = row["message"]
    for name, value in result.values.items():
        _spread(row, name, value)
    row["evaluation"] = result.evaluation
    row["outcome"] = result.outcome.value
    row["coverage"] = result.coverage
    row["message"] = message or row["message"] or None
    return row


def _spread(row: Row, name: str, value: Any) -> None:
    if isinstance(value, dict):
        for key, item in value.items():
            _spread(row, _join(name, str(key)), item)
    elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
        for number, item in enumerate(value):
            _spread(row, f"{name}[{number}]", item)
    else:
        row[sys.intern(name)] = value


@cache
def _join(prefix: str, name: str) -> str:
    return sys.intern(f"{prefix}.{name}")


def number_or_text(text: str) -> int | float | str:
    """Return a text that looks like a number as one."""
    if not _NUMBER.fullmatch(text):
        return text
    return int(text) if text.lstrip("+-").isdecimal() else float(text)


def _time(value: datetime | None) -> str | None:
    return value.isoformat() if value else None
