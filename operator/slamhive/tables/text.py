# SPDX-License-Identifier: Apache-2.0
"""Figures as text and as flat records: the one place that says how a spread, a failure or a key is written.

What people read is rounded and has units; flat records hold stored numbers with every digit.
"""

from __future__ import annotations

import json
import math
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import CHOSEN, CPU, LATE, MARK, MEMORY, READER, Groups, follows, varies
from slamhive.analysis.measures import CONFIGURATION
from slamhive.analysis.metrics import Metric, name_of, with_unit

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from slamhive.analysis.cells import Cell, Cells
    from slamhive.analysis.columns import Indices
    from slamhive.analysis.frame import Frame
    from slamhive.analysis.grouping import Aggregate
    from slamhive.analysis.leaderboard import Entry, Standing
    from slamhive.analysis.pareto import Spot
    from slamhive.analysis.statistics import Interval, Summaries, Summary

PARTS = ("n", "mean", "std", "median", "min", "max")
"""Parts of a summary, in flat records."""

COVERAGE = Metric("coverage", "", 1.0, ".3f")
_NO_SPREAD = " ± 0.000"
_AS_STORED = Metric("", "", 1.0, "")

_ROUNDING = 1e-12
"""A spread below this share of the mean is rounding, not a spread."""

_MOST_WORD = 60


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
    return value_text(_AS_STORED, value) if not isinstance(value, float) else repr(value).removesuffix(".0")


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


def spread_texts(metric: Metric, summaries: Summaries) -> list[str]:
    """Return the same of many groups."""
    means = (summaries.mean * metric.factor).tolist()
    show = f"{{:{metric.format or '.4g'}}}".format
    several = summaries.n > 1
    texts = (show(mean) if n else "–" for mean, n in zip(means, summaries.n.tolist(), strict=True))
    known: dict[str, str] = {}  # few are different when rounded: each is held once
    found = [known.setdefault(text, text) for text in texts]
    for group in np.flatnonzero(several).tolist():
        found[group] = spread_text(metric, summaries.of(group))
    return found


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
    return _signs(bool(cell.findings), cell.chosen)


def _signs(faulty: bool, chosen: bool) -> str:
    return (f" {MARK}" if faulty else "") + (f" {CHOSEN}" if chosen else "")


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


def failures_text(failures: Mapping[str, int], untracked: Mapping[str, int]) -> str:
    """Return the ends of the runs that don't count, and of those that do without being tracked."""
    told = counts_text(failures) or "0"
    return f"{told}; in n: {counts_text(untracked)}" if untracked else told


_OF_GROUPS = ("coverage", "n", "failures")
"""Heads of the columns of a table behind its metrics."""


def table_columns(
    found: Aggregate, across: Sequence[str], metrics: Sequence[Metric], left_out: Iterable[str] = ()
) -> tuple[list[str], list[list[str]]]:
    """Return the headings of a table, and the texts of each of its columns.

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
    keys = found.cells.keys
    lines = _numbered(keys, rows) if across else np.arange(len(keys))
    sides = _numbered(keys, across) if across else np.zeros(len(keys), dtype=np.intp)
    _, firsts = np.unique(lines, return_index=True)
    of_lines = keys.select(firsts)
    headings = [key_title(name, rows) for name in rows]
    columns = [_key_texts(of_lines, name) for name in rows]
    texts = [*(_figure_texts(found.cells, metric) for metric in metrics), *_group_texts(found.cells)]
    for side in range(int(sides.max(initial=-1 if across else 0)) + 1):
        inside = np.flatnonzero(sides == side)
        values = [keys.row(int(inside[0]), across)[name] for name in across] if across else []
        prefix = "".join(f"{key_text(value)} " for value in values)
        headings += [prefix + part for part in parts]
        for written in texts:
            if not across:
                columns.append(written)
                continue
            column = ["–"] * len(firsts)
            for line, group in zip(lines[inside].tolist(), inside.tolist(), strict=True):
                column[line] = written[group]
            columns.append(column)
    return headings, columns


def _numbered(frame: Frame, names: Sequence[str]) -> Indices:
    """Return a number for each row by the values of some columns, in the order of being met first, (n,)."""
    of_row = Groups(frame, names).of_row
    _, firsts = np.unique(of_row, return_index=True)
    ranks = np.empty(len(firsts), dtype=np.intp)
    ranks[np.argsort(firsts)] = np.arange(len(firsts))
    return ranks[of_row]


def _key_texts(frame: Frame, name: str) -> list[str]:
    codes, values = frame.column(name).factorized()
    texts = [key_text(value) for value in values]
    return [texts[code] for code in codes.tolist()]


def _figure_texts(cells: Cells, metric: Metric) -> list[str]:
    """Return the means of all groups, marked where they aren't what they seem."""
    held, order = cells.columns, cells.order
    found = spread_texts(metric, held.figures[metric.column].summaries.taken(order))
    for group in np.flatnonzero((held.reader | held.late)[order]).tolist():
        place = order[group]
        found[group] += cost_mark(metric.column, reader=bool(held.reader[place]), late=bool(held.late[place]))
    return found


def _group_texts(cells: Cells) -> list[list[str]]:
    """Return the columns of `_OF_GROUPS` of all groups."""
    held, order = cells.columns, cells.order
    coverage = spread_texts(COVERAGE, held.coverage.taken(order))
    places = order.tolist()
    signs = [
        f"{' =' if copies else ''}{_signs(bool(held.findings.get(place)), chosen)}"
        for place, copies, chosen in zip(
            places, held.copies[order].tolist(), held.chosen[order].tolist(), strict=True
        )
    ]
    failures = [
        failures_text(held.failures.get(place, {}), held.untracked.get(place, {})) for place in places
    ]
    counts = [f"{n}{sign}" if sign else str(n) for n, sign in zip(held.n[order].tolist(), signs, strict=True)]
    return [[text.removesuffix(_NO_SPREAD) for text in coverage], counts, failures]


def flat_cells(found: Aggregate) -> Iterator[dict[str, Any]]:
    """Go through groups as flat records of unrounded numbers in stored units, all of the same names."""
    held = found.cells.columns
    has_findings, reader, late, chosen = map(
        bool, (held.findings, *map(np.any, (held.reader, held.late, held.chosen)))
    )
    for cell in found.cells:
        row: dict[str, Any] = {**cell.keys, "runs": cell.runs, "n": cell.n, "copies": cell.copies}
        row |= {"failures": sum(cell.failures.values()), "failures.by": cell.failures}
        row |= {"findings": ", ".join(cell.findings)} if has_findings else {}
        row |= {"reader": cell.reader} if reader else {}
        row |= {"late": cell.late} if late else {}
        row |= {"chosen": cell.chosen} if chosen else {}
        row |= {"untracked.by": cell.untracked, "deterministic": cell.deterministic}
        for name, figure in cell.figures.items():
            row |= flat_summary(name, figure.summary)
        yield row | flat_summary("coverage", cell.coverage)


def flat_summary(prefix: str, summary: Summary | None) -> dict[str, Any]:
    """Return a summary as columns of a flat record."""
    return {
        f"{prefix}.{part}": getattr(summary, part) if summary else (0 if part == "n" else None)
        for part in PARTS
    }


def as_columns(records: Iterable[dict[str, Any]]) -> dict[str, list[Any]]:
    """Return records as columns, names in the order of first being seen."""
    rows = list(records)
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [row.get(name) for row in rows] for name in names}


def constants(found: Aggregate, asked: Sequence[str]) -> dict[str, Any]:
    """Return the keys that all groups share and nobody asked for: said once, not on each line."""
    keys = found.cells.keys
    if len(keys) <= 1:
        return {}
    first = keys.row(0, found.keys)
    return {name: first[name] for name in found.keys if name not in asked and not varies(keys, name)}


def implied(found: Aggregate, asked: Sequence[str]) -> set[str]:
    """Return the keys that follow from the algorithm's name and that nobody asked for."""
    if "algorithm" not in found.keys or "sensors" not in found.keys or "sensors" in asked:
        return set()
    return {"sensors"} if follows(found.cells.keys, "sensors", "algorithm") else set()


def spare_settings(found: Aggregate, most: int, left_out: Iterable[str]) -> list[str]:
    """Return settings that tell no more rows apart than those before them do, where there are more than some.

    Args:
        found: the groups.
        most: settings that are shown however little they tell.
        left_out: keys that are not shown anyway.
    """
    keys, told = found.cells.keys, [name for name in found.keys if name not in set(left_out)]
    settings = [name for name in told if name.startswith(CONFIGURATION)]
    if len(settings) <= most:
        return []
    shown = [name for name in told if name not in settings]
    count = Groups(keys, shown).count if shown else 1
    spare = []
    for name in settings:
        more = Groups(keys, [*shown, name]).count
        if more > count:
            shown.append(name)
            count = more
        else:
            spare.append(name)
    # Where few tell all apart there is room for the first of the others.
    room = max(0, most - (len(settings) - len(spare)))
    return spare[room:]


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
