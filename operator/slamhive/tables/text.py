# SPDX-License-Identifier: Apache-2.0
"""Figures as text and as flat records: the one place that says how a spread, a failure or a key is written.

What people read is rounded and has units; flat records hold stored numbers with every digit.
"""

from __future__ import annotations

import json
import math
from datetime import datetime
from typing import TYPE_CHECKING, Any

from slamhive.analysis.grouping import CHOSEN, CPU, LATE, MARK, MEMORY, READER
from slamhive.analysis.metrics import Metric, name_of, with_unit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from slamhive.analysis.cells import Cell
    from slamhive.analysis.grouping import Aggregate
    from slamhive.analysis.leaderboard import Entry, Standing
    from slamhive.analysis.pareto import Spot
    from slamhive.analysis.statistics import Interval, Summary

PARTS = ("n", "mean", "std", "median", "min", "max")
"""Parts of a summary, in flat records."""

COVERAGE = Metric("coverage", "", 1.0, ".3f")
_AS_STORED = Metric("", "", 1.0, "")

_ROUNDING = 1e-12
"""A spread below this share of the mean is rounding, not a spread."""

_MOST_WORD = 60

_PLAIN = (str, int, bool, type(None))
"""Types of which equal values are written alike."""


def value_text(metric: Metric, value: Any) -> str:
    """Return a value of a column as people read it."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) or (isinstance(value, int) and (metric.format or metric.factor != 1)):
        return metric.show(value)
    return json.dumps(value) if isinstance(value, list | dict) else str(value)


def time_text(value: str | None) -> str:
    """Return a stored time as people read it, on their clock."""
    return "–" if value is None else f"{datetime.fromisoformat(value).astimezone():%Y-%m-%d %H:%M}"


def key_text(value: Any) -> str:
    """Return a key of a group as people read it."""
    kind = type(value)
    if kind is str:  # a large table has millions of keys, nearly all of them plain
        found: str = value
        return found
    if kind is int:
        return str(value)
    return value_text(_AS_STORED, value) if not isinstance(value, float) else repr(value)


def spread_text(metric: Metric, summary: Summary | None) -> str:
    """Return ``mean ± std``, the mean alone for one number."""
    if summary is None:
        return "–"
    mean = metric.show(summary.mean)
    if summary.std is None:
        return mean
    std = summary.std if summary.std > _ROUNDING * abs(summary.mean) else 0.0
    spread = metric.show(std) if metric.format else format(std * metric.factor, ".2g")
    if metric.format == ".0f" and std and not float(spread):
        spread = format(std * metric.factor, ".1g")  # whole MiB would call it none
    return f"{mean} ± {spread}"


def range_text(metric: Metric, summary: Summary | None) -> str:
    """Return the smallest and largest of several numbers."""
    if summary is None or summary.n < 2:
        return "–"
    return f"{metric.show(summary.min)} – {metric.show(summary.max)}"


def coverage_text(summary: Summary | None) -> str:
    """Return the mean coverage, with its spread where there is one to see."""
    return spread_text(COVERAGE, summary).removesuffix(" ± 0.000")


def number_text(value: float | None, shape: str = ".3g") -> str:
    """Return a plain number, a dash for none, the sign of infinity for failures that reach into it."""
    if value is None or math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else format(value, shape)


def interval_text(interval: Interval | None) -> str:
    """Return an interval as text."""
    if interval is None or math.isnan(interval.low):
        return "–"
    return f"{number_text(interval.low)} – {number_text(interval.high)}"


def counts_text(counts: Mapping[str, int]) -> str:
    """Return runs by what became of them."""
    return ", ".join(f"{count} {word[:_MOST_WORD]}" for word, count in counts.items())


def n_text(cell: Cell) -> str:
    """Return the number of results that count, with = where further runs repeat one of them.

    † marks runs on recordings with open findings, ¶ runs that a search chose by its results.
    """
    return f"{cell.n}{' =' if cell.copies else ''}{marked(cell)}"


def n_of_runs(one: Cell | Entry | Standing | Spot) -> str:
    """Return the numbers of results that count and of runs."""
    return f"{one.n} = / {one.runs}" if one.copies else f"{one.n}/{one.runs}"


def marked(cell: Cell) -> str:
    """Return the signs of runs on recordings with open findings, and of runs that a search chose."""
    return (f" {MARK}" if cell.findings else "") + (f" {CHOSEN}" if cell.chosen else "")


def cost_mark(column: str, *, reader: bool, late: bool) -> str:
    """Return the sign of a cost that isn't what it seems, with a space before it; empty for none.

    Args:
        column: of the cost, or of anything else.
        reader: whether CPU holds the reading of the recording, where that of others doesn't.
        late: whether memory holds frames that waited.
    """
    if reader and column.startswith(CPU):
        return f" {READER}"
    return f" {LATE}" if late and column.startswith(MEMORY) else ""


def failures_text(cell: Cell) -> str:
    """Return the ends of the runs that don't count, and of those that do without being tracked."""
    failures = counts_text(cell.failures) or "0"
    return f"{failures}; in n: {counts_text(cell.untracked)}" if cell.untracked else failures


_OF_GROUPS: Mapping[str, Callable[[Cell], str]] = {
    "coverage": lambda cell: coverage_text(cell.coverage),
    "n": n_text,
    "failures": failures_text,
}
"""Columns of a table behind its metrics, by their heads."""


def table_lines(
    found: Aggregate, across: Sequence[str], metrics: Sequence[Metric], left_out: Iterable[str] = ()
) -> tuple[list[str], list[list[str]]]:
    """Return the headings and lines of a table.

    Each group shows its metrics, its coverage, the number of results that count and what became of others.

    Args:
        found: the groups.
        across: keys whose values lie side by side.
        metrics: what is shown.
        left_out: keys that are said elsewhere.
    """
    rows = [name for name in found.keys if name not in {*across, *left_out}]
    shown = [metric.column for metric in metrics]
    parts = [metric.title_among(shown) for metric in metrics] + list(_OF_GROUPS)
    sides = _distinct(tuple(cell.keys[name] for name in across) for cell in found.cells) if across else [()]
    headings = [key_title(name, rows) for name in rows]
    for values in sides:
        prefix = "".join(f"{key_text(value)} " for value in values)
        headings += [prefix + part for part in parts]
    places = [_identity(values) for values in sides]
    rendered = []
    for cells in _lines(found.cells, rows, across):
        first = next(iter(cells.values()))
        line = [key_text(first.keys[name]) for name in rows]
        for place in places:
            line += _cell_texts(cells.get(place), metrics)
        rendered.append(line)
    return headings, rendered


def flat_cells(found: Aggregate) -> list[dict[str, Any]]:
    """Return groups as flat records of unrounded numbers in stored units."""
    rows = []
    has_findings = any(cell.findings for cell in found.cells)
    for cell in found.cells:
        row: dict[str, Any] = {**cell.keys, "runs": cell.runs, "n": cell.n, "copies": cell.copies}
        row |= {"failures": sum(cell.failures.values()), "failures.by": cell.failures}
        row |= {"findings": ", ".join(cell.findings)} if has_findings else {}
        row |= {"reader": cell.reader} if any(one.reader for one in found.cells) else {}
        row |= {"late": cell.late} if any(one.late for one in found.cells) else {}
        row |= {"chosen": cell.chosen} if any(one.chosen for one in found.cells) else {}
        row |= {"untracked.by": cell.untracked, "deterministic": cell.deterministic}
        for name, figure in cell.figures.items():
            row |= flat_summary(name, figure.summary)
        rows.append(row | flat_summary("coverage", cell.coverage))
    return rows


def flat_summary(prefix: str, summary: Summary | None) -> dict[str, Any]:
    """Return a summary as columns of a flat record."""
    return {
        f"{prefix}.{part}": getattr(summary, part) if summary else (0 if part == "n" else None)
        for part in PARTS
    }


def as_columns(rows: Sequence[dict[str, Any]]) -> dict[str, list[Any]]:
    """Return records as columns, names in the order of first being seen."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name) for row in rows] for name in names}


def constants(found: Aggregate, asked: Sequence[str]) -> dict[str, Any]:
    """Return the keys that all groups share and nobody asked for: said once, not on each line."""
    shared = {}
    for name in found.keys:
        if name in asked or len(found.cells) <= 1:
            continue
        first = found.cells[0].keys[name]
        # Nearly all are plain and equal or differ at once; only others need be written to be compared.
        value, kind = _identity([first]), type(first)
        if all(
            (kind in _PLAIN and type(one) is kind and one == first) or _identity([one]) == value
            for cell in found.cells
            for one in (cell.keys[name],)
        ):
            shared[name] = first
    return shared


def implied(found: Aggregate, asked: Sequence[str]) -> set[str]:
    """Return the keys that follow from the algorithm's name and that nobody asked for."""
    modes: dict[Any, Any] = {}
    if "algorithm" not in found.keys or "sensors" in asked:
        return set()
    follows = all(
        modes.setdefault(cell.keys.get("algorithm"), cell.keys.get("sensors")) == cell.keys.get("sensors")
        for cell in found.cells
    )
    return {"sensors"} if follows else set()


def short_name(name: str, names: Sequence[str]) -> str:
    """Return a configuration's column without its prefix, where that is clear among the others."""
    for prefix in ("parameters.", "dataset.attributes.", "input.", "provenance."):
        if name.startswith(prefix):
            short = name.removeprefix(prefix)
            return name if sum(other.endswith(f".{short}") for other in names) > 1 else short
    return name


def key_title(name: str, names: Sequence[str]) -> str:
    """Return the heading of a configuration's column, with the unit of its numbers."""
    return with_unit(short_name(name, names), name_of(name).unit)


def _lines(cells: Sequence[Cell], rows: Sequence[str], across: Sequence[str]) -> Iterable[dict[str, Cell]]:
    """Go through the cells of each line by what lies side by side."""
    if not across:
        whole = _identity([])
        return ({whole: cell} for cell in cells)
    lines: dict[str, dict[str, Cell]] = {}
    for cell in cells:
        row = _identity(cell.keys[name] for name in rows)
        lines.setdefault(row, {})[_identity(cell.keys[name] for name in across)] = cell
    return lines.values()


def _cell_texts(cell: Cell | None, metrics: Sequence[Metric]) -> list[str]:
    if cell is None:
        return ["–"] * (len(metrics) + len(_OF_GROUPS))
    figures = [
        spread_text(metric, cell.figures[metric.column].summary)
        + cost_mark(metric.column, reader=cell.reader, late=cell.late)
        for metric in metrics
    ]
    return [*figures, *(text(cell) for text in _OF_GROUPS.values())]


def _distinct(values: Iterable[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    return list({_identity(value): value for value in values}.values())


def _identity(values: Iterable[Any]) -> str:
    return json.dumps(list(values), sort_keys=True, default=str)
