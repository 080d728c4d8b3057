# SPDX-License-Identifier: Apache-2.0
"""Published numbers in tables for papers: a block of columns beside that of own ones."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from slamhive.analysis import Metric
from slamhive.reporting.papertables import TableNumber
from slamhive.tables.published import published_on

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence

    from slamhive.analysis.frame import Frame
    from slamhive.model.published import PublishedNumbers
    from slamhive.reporting.papertables import PaperTable, TableCell
    from slamhive.tables.published import Published

_PREFIX = "published."


class PublishedMetric(Metric):
    """A metric as somebody else published it."""

    @classmethod
    def beside(cls, metric: Metric) -> PublishedMetric:
        """Return the metric beside an own one, in its unit; digits are those that were published."""
        return cls(_PREFIX + metric.column, metric.unit, metric.factor)

    def title_among(self, names: Container[str]) -> str:  # noqa: ARG002
        """Return the metric's name for people, with the unit."""
        own = Metric(self.column.removeprefix(_PREFIX), self.unit, self.factor)
        return (
            f"{own.title.partition(' [')[0]} published [{own.unit}]" if own.unit else f"{own.title} published"
        )


def with_published(
    table: PaperTable, frame: Frame, known: Sequence[PublishedNumbers]
) -> tuple[PaperTable, list[str]]:
    """Add what was published for the same system on the same sequence, measured alike, to each own number.

    Of several published numbers the one over the most repetitions is shown.

    Args:
        table: own numbers.
        frame: the runs that they are of.
        known: all published numbers.

    Returns:
        The table, and remarks on what can't stand beside own numbers.
    """
    names = (*table.keys, *table.layout.columns)
    rows: dict[str, list[int]] = {}
    for at, values in enumerate(zip(*(frame.column(name).tolist() for name in names), strict=True)):
        rows.setdefault(_identity(values), []).append(at)
    found = {
        place: _beside(frame, rows.get(_identity((*row, *column)), []), known)
        for i, row in enumerate(table.rows)
        for j, column in enumerate(table.columns)
        if table.places[i][j] is not None and (place := (i, j))
    }
    metrics, notes, remarks = [], [], []
    shown: dict[tuple[int, int], list[TableNumber]] = {place: [] for place in found}
    for metric in table.metrics:
        best = {place: _most_repeated(items, metric.column) for place, items in found.items()}
        if any(best.values()):
            metrics.append(PublishedMetric.beside(metric))
            notes.append(f"{metrics[-1].title.partition(' [')[0]}: {_sources(best.values())}")
            for place, item in best.items():
                value = item.values[metric.column] * metric.factor if item else None
                shown[place].append(TableNumber(value, published=True))
        remarks += _left_out(found.values(), metric)
    places = tuple(
        tuple(_extended(cell, shown.get((i, j), [])) for j, cell in enumerate(line))
        for i, line in enumerate(table.places)
    )
    if not metrics:
        remarks.append("no published number is comparable with these runs: slamhive published list")
    return (
        replace(table, metrics=(*table.metrics, *metrics), places=places, notes=(*table.notes, *notes)),
        list(dict.fromkeys(remarks)),
    )


def _identity(values: Iterable[Any]) -> str:
    return json.dumps(list(values), sort_keys=True, default=str)


def _beside(frame: Frame, rows: list[int], known: Sequence[PublishedNumbers]) -> list[Published]:
    found = published_on(frame.select(rows), known) if rows else []  # type: ignore[arg-type]
    return [one for one in found if not one.is_unrun]


def _most_repeated(items: Sequence[Published], column: str) -> Published | None:
    fitting = [one for one in items if column in one.verdicts and one.verdicts[column].is_alike]
    return max(fitting, key=lambda one: one.table.runs or 0, default=None)


def _sources(items: Iterable[Published | None]) -> str:
    return "; ".join(dict.fromkeys(one.where for one in items if one is not None))


def _left_out(found: Iterable[Sequence[Published]], metric: Metric) -> list[str]:
    """Say which published numbers of systems that were run here can't stand beside own ones, and why."""
    counts = Counter(
        (one.where, judged.sentence)
        for items in found
        for one in items
        if (judged := one.verdicts.get(metric.column)) is not None and not judged.is_alike
    )
    return [
        f"{where}, {count} number{'s' if count != 1 else ''}: {sentence}"
        for (where, sentence), count in counts.items()
    ]


def _extended(cell: TableCell | None, figures: Sequence[TableNumber]) -> TableCell | None:
    return None if cell is None else replace(cell, figures=(*cell.figures, *figures))
