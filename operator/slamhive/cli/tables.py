# SPDX-License-Identifier: Apache-2.0
"""Rows and pivot tables as text: for a terminal, Markdown, CSV or JSON.

What people read is rounded and has units; CSV and JSON hold stored numbers with every digit.
"""

from __future__ import annotations

import csv
import json
from enum import StrEnum
from typing import TYPE_CHECKING, Any, TextIO

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from slamhive.analysis import Metric

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from slamhive.analysis import Group, PivotTable, Summary

    Row = Mapping[str, Any]

_WIDEST = 10_000
_ROUNDING = 1e-12
"""A spread below this share of the mean is rounding, not a spread."""


class Format(StrEnum):
    """How a table is printed."""

    TABLE = "table"
    CSV = "csv"
    JSON = "json"
    MARKDOWN = "markdown"


def show(console: Console, headings: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Print lines of text as a table, as wide as it needs to be: a number is never broken in two."""
    table = Table(header_style="bold", box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for heading in headings:
        table.add_column(Text(heading.replace(" [", "\n[")), no_wrap=True)
    for line in lines:
        table.add_row(*(Text(cell) for cell in line))
    wide = Console(
        file=console.file, width=_WIDEST, highlight=False, force_terminal=console.is_terminal or None
    )
    wide.print(table)


def write_markdown(stream: TextIO, headings: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Write lines of text as a Markdown table."""
    for line in (headings, ["---"] * len(headings), *lines):
        cells = (cell.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ") for cell in line)
        stream.write(f"| {' | '.join(cells)} |\n")


def write_csv(stream: TextIO, columns: Sequence[str], rows: Iterable[Row]) -> None:
    """Write rows as CSV, numbers with every digit, empty where nothing is known."""
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_csv_cell(row.get(name)) for name in columns] for row in rows)


def write_json(stream: TextIO, rows: Iterable[Row]) -> None:
    """Write rows as a JSON array, one object a line, numbers with every digit."""
    separator = "[\n"
    for row in rows:
        stream.write(separator + json.dumps(row, ensure_ascii=False, allow_nan=False))
        separator = ",\n"
    stream.write("[]\n" if separator == "[\n" else "\n]\n")


def cell(metric: Metric, value: Any) -> str:
    """Return a row's value as people read it."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) or (isinstance(value, int) and (metric.format or metric.factor != 1)):
        return metric.show(value)
    return json.dumps(value) if isinstance(value, list | dict) else str(value)


def mean_and_spread(metric: Metric, summary: Summary | None) -> str:
    """Return ``mean ± std``, the mean alone for one number."""
    if summary is None:
        return "–"
    mean = metric.show(summary.mean)
    if summary.std is None:
        return mean
    std = summary.std if summary.std > _ROUNDING * abs(summary.mean) else 0.0
    spread = metric.show(std) if metric.format else format(std * metric.factor, ".2g")
    return f"{mean} ± {spread}"


def constants(found: PivotTable, asked: Sequence[str]) -> dict[str, Any]:
    """Return the row keys that all groups share and nobody asked for: said once, not on each line."""
    shared = {}
    for name in found.rows:
        values = {_identity([group.keys[name]]) for group in found.groups}
        if name not in asked and len(values) == 1 and len(found.groups) > 1:
            shared[name] = found.groups[0].keys[name]
    return shared


def implied(found: PivotTable, asked: Sequence[str]) -> set[str]:
    """Return the row keys that follow from the algorithm's name and that nobody asked for."""
    modes: dict[Any, Any] = {}
    follows = all(
        modes.setdefault(group.keys.get("algorithm"), group.keys.get("sensors")) == group.keys.get("sensors")
        for group in found.groups
    )
    return {"sensors"} if follows and "algorithm" in found.rows and "sensors" not in asked else set()


def pivot_lines(found: PivotTable, metrics: Sequence[Metric]) -> tuple[list[str], list[list[str]]]:
    """Return a pivot table's headings and lines.

    Each group shows its metrics, its coverage, the number of runs in its means and what became of others.
    """
    parts = [metric.title for metric in metrics] + ["coverage", "n", "failures"]
    across = _distinct(tuple(group.keys[name] for name in found.columns) for group in found.groups)
    headings = [short_name(name, found.rows) for name in found.rows]
    for values in across:
        prefix = "".join(f"{key_text(value)} " for value in values)
        headings += [prefix + part for part in parts]
    lines: dict[str, dict[str, Group]] = {}
    for group in found.groups:
        row = _identity(group.keys[name] for name in found.rows)
        lines.setdefault(row, {})[_identity(group.keys[name] for name in found.columns)] = group
    rendered = []
    for groups in lines.values():
        first = next(iter(groups.values()))
        line = [key_text(first.keys[name]) for name in found.rows]
        for values in across:
            line += _group_cells(groups.get(_identity(values)), metrics)
        rendered.append(line)
    return headings, rendered


def pivot_rows(found: PivotTable) -> list[dict[str, Any]]:
    """Return a pivot table's groups as flat rows of unrounded numbers in stored units."""
    rows = []
    for group in found.groups:
        row: dict[str, Any] = {**group.keys, "runs": group.runs, "n": group.n}
        row["failures"] = sum(group.failures.values())
        row["failures.by"] = group.failures
        for name, summary in {**group.metrics, "coverage": group.coverage}.items():
            for part in ("mean", "std", "n", "median", "min", "max"):
                row[f"{name}.{part}"] = getattr(summary, part) if summary else (0 if part == "n" else None)
        rows.append(row)
    return rows


def short_name(name: str, names: Sequence[str]) -> str:
    """Return a configuration's column without its prefix, where that is clear among the others."""
    for prefix in ("parameters.", "dataset.attributes.", "input.", "provenance."):
        if name.startswith(prefix):
            short = name.removeprefix(prefix)
            return name if sum(other.endswith(f".{short}") for other in names) > 1 else short
    return name


def key_text(value: Any) -> str:
    """Return a key of a group as people read it."""
    return cell(Metric("", "", 1.0, ""), value) if not isinstance(value, float) else repr(value)


def _group_cells(group: Group | None, metrics: Sequence[Metric]) -> list[str]:
    if group is None:
        return ["–"] * (len(metrics) + 3)
    coverage = Metric("coverage", "", 1.0, ".3f")
    failures = ", ".join(f"{count} {word}" for word, count in group.failures.items())
    cells = [mean_and_spread(metric, group.metrics[metric.column]) for metric in metrics]
    covered = mean_and_spread(coverage, group.coverage).removesuffix(" ± 0.000")
    return [*cells, covered, str(group.n), failures or "0"]


def _distinct(values: Iterable[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    return list({_identity(value): value for value in values}.values())


def _identity(values: Iterable[Any]) -> str:
    return json.dumps(list(values), sort_keys=True, default=str)


def _csv_cell(value: Any) -> Any:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, list | dict) else value
