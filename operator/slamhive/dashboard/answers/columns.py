# SPDX-License-Identifier: Apache-2.0
"""Columns and figures as the API writes them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.columns import ColumnKind, counted
from slamhive.analysis.flattening import OF_RUN
from slamhive.analysis.measures import is_error, measure_of
from slamhive.analysis.metrics import Metric, declared_units
from slamhive.dashboard.answering.encoding import plain
from slamhive.tables.text import PARTS

if TYPE_CHECKING:
    from collections.abc import Collection

    from slamhive.analysis.cells import Figure
    from slamhive.analysis.columns import Column, Floats
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.statistics import Interval, Summary

_MAX_DISTINCT = 200
_MAX_NUMBERS = 40
_ENOUGH_ROWS = 20_000
"""Rows in which different numbers are counted, where they are too many to be told: sorting all takes long."""


def heading(frame: Frame, name: str, among: Collection[str] = ()) -> dict[str, Any]:
    """Return the facts about a column that are needed to show it.

    Args:
        frame: the runs.
        name: of the column.
        among: names of the columns beside it.
    """
    with declared_units(frame.units):
        metric = Metric.parse(name) if ":" not in name else Metric(name, "", 1.0)
        return {
            "name": name,
            "kind": str(frame.glance(name).kind),
            "title": metric.title_among(among),
            "label": metric.label_among(among),
            "unit": metric.unit or None,
            "factor": metric.factor,
            "better": measure_of(name.partition(":")[0]).better or None,
        }


def profile(frame: Frame, name: str) -> dict[str, Any]:
    """Return a column's heading with how many rows have it, its range and its values where they are few.

    Of many different numbers in a large table those of the first rows are counted: as many at least.
    """
    column = frame.glance(name)
    described = heading(frame, name) | {"count": int(column.present.sum()), "group": group_of(name)}
    if column.kind.is_numeric:
        some = column if column.is_coded else column.take(np.arange(min(len(column), _ENOUGH_ROWS)))
        uniques, counts = some.counted()
        if len(uniques) <= _MAX_DISTINCT and len(some) < len(column):
            uniques, counts = column.counted()
        if len(uniques):
            every = uniques if column.is_coded else column.numbers
            low, high = (column.plain(float(end.reduce(every))) for end in (np.fmin, np.fmax))
            described |= {"min": low, "max": high}
        values = [column.plain(value) for value in uniques[:_MAX_DISTINCT].tolist()]
    else:
        used, counts = counted(column.codes[column.present], len(column.values))
        if len(used) <= _MAX_DISTINCT:  # else they are not told, and need no order
            order = sorted(range(len(used)), key=lambda place: str(column.values[used[place]]))
            used, counts = used[order], counts[order]
        values = [column.values[code] for code in used[:_MAX_DISTINCT].tolist()]
    most = _MAX_DISTINCT if column.kind is not ColumnKind.NUMBER else _MAX_NUMBERS
    few = len(counts) <= most
    pairs = zip(values, counts.tolist(), strict=False)
    return described | {
        "distinct": len(counts),
        "values": [{"value": value, "count": count} for value, count in pairs] if few else None,
    }


def group_of(name: str) -> str:
    """Return the part of a run that a column belongs to."""
    for prefix, group in (
        ("parameters.", "parameters"),
        ("input.", "input"),
        ("resources.", "resources"),
        ("dataset.attributes.", "dataset"),
        ("label.", "labels"),
        ("metrics.", "metrics"),
        ("usage.", "usage"),
        ("frames.", "frames"),
        ("provenance.", "provenance"),
        ("trajectory.", "trajectory"),
    ):
        if name.startswith(prefix):
            return group
    if is_error(name):
        return "errors"
    return "run" if name in _OF_RUN else "result"


_OF_RUN = frozenset(OF_RUN) | {"run", "status", "disturbed", "superseded"}


def coded(column: Column, digits: int | None = None) -> dict[str, Any]:
    """Return a column for a chart: its numbers, or codes and what they stand for (-1 is missing)."""
    if column.kind.is_numeric and column.kind is not ColumnKind.BOOLEAN:
        numbers = column.numbers if digits is None else rounded(column.numbers, digits)
        if column.kind is ColumnKind.INTEGER and column.present.all():
            return {"kind": str(column.kind), "values": column.numbers.astype(np.int64)}
        return {"kind": str(column.kind), "values": np.ascontiguousarray(numbers)}
    codes, values = column.factorized()
    if values and values[-1] is None:
        values = values[:-1]
        codes = np.where(codes == len(values), -1, codes).astype(np.int32)
    return {"kind": str(column.kind), "codes": np.ascontiguousarray(codes), "categories": values}


def rounded(numbers: Floats, digits: int) -> Floats:
    """Return numbers rounded to significant digits."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        exponent = digits - 1 - np.floor(np.log10(np.abs(numbers)))
        exponent = np.where(np.isfinite(exponent), np.clip(exponent, -300, 300), 0)
        scale = 10.0 ** np.abs(exponent)
        found = np.where(exponent >= 0, np.round(numbers * scale) / scale, np.round(numbers / scale) * scale)
    return np.where(np.isfinite(found), found, numbers)


def summary_json(summary: Summary | None) -> dict[str, Any] | None:
    """Return a summary."""
    return None if summary is None else {part: getattr(summary, part) for part in PARTS}


def interval_json(interval: Interval | None) -> dict[str, Any] | None:
    """Return an interval, null where it isn't known; null at an end that failed runs reach into."""
    if interval is None or math.isnan(interval.low):
        return None
    return {"low": plain(interval.low), "high": plain(interval.high), "method": interval.method}


def figure_json(figure: Figure) -> dict[str, Any]:
    """Return a figure with its spread and what failed."""
    summary = summary_json(figure.summary) or {part: 0 if part == "n" else None for part in PARTS}
    censored: dict[str, Any] | None = None
    if figure.censored_median is not None:
        median = plain(figure.censored_median)
        censored = {"failed": figure.censored, "median": median, "medianFailed": median is None}
    return summary | {
        "points": list(figure.points),
        "meanInterval": interval_json(figure.mean_interval),
        "medianInterval": interval_json(figure.median_interval),
        "censored": censored,
    }
