# SPDX-License-Identifier: Apache-2.0
"""Findings in words: what won among groups of runs, who is as good, and at what cost."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.analysis.metrics import Metric
from slamhive.model.base import plural
from slamhive.reporting.titles import keys_text
from slamhive.tables.text import constants, implied

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.cells import Cell
    from slamhive.analysis.grouping import Aggregate

NEAR = 1.05
"""Ratio up to which errors or costs on one recording are called equal: the next one would turn them round."""

_MOST = 3


@dataclass(frozen=True)
class _Rival:
    """A group of runs that has an error.

    Attributes:
        name: what it is, in words.
        error: median, failed runs last.
        ends: range of the runs' errors; fewer than two where there is one result.
        told: the error in words.
        cost: mean; None where unknown.
    """

    name: str
    error: float
    ends: tuple[float, ...]
    told: str
    cost: float | None

    def is_near(self, other: _Rival) -> bool:
        """Tell whether one with a larger error is larger by less than one recording can tell."""
        return other.error <= NEAR * self.error

    def is_among(self, other: _Rival) -> bool:
        """Tell whether runs of one with a larger error were as good as some of these."""
        return len(self.ends) > 1 and len(other.ends) > 1 and other.ends[0] <= self.ends[1]


def conclusion(found: Aggregate, error: str, cost: str) -> list[str]:
    """Return sentences on what won, on each of the first datasets, and on how far that holds.

    Args:
        found: groups of runs, one a setting and dataset.
        error: column among its metrics that is ranked by, small is good.
        cost: column among them that is paid, small is good.
    """
    same = {"dataset", *constants(found, ()), *implied(found, ())}
    names = [name for name in found.keys if name not in same and name != "algorithm"]
    datasets: dict[str, list[Cell]] = {}
    for cell in found.cells:
        datasets.setdefault(str(cell.keys["dataset"]), []).append(cell)
    sentences: list[str] = []
    for dataset, cells in list(datasets.items())[:_MOST]:
        rivals = [one for cell in cells if (one := _rival(cell, names, Metric.parse(error), cost))]
        rivals.sort(key=lambda one: one.error)
        sentences += _ranked(dataset, rivals, Metric.parse(cost))
        if rivals and len(rivals) < len(cells):
            sentences.append(_unranked([one for one in cells if _middle(one, error) is None], names))
    if len(datasets) > _MOST:
        sentences.append(f"The table has {plural(len(datasets) - _MOST, 'more dataset')}.")
    elif len(datasets) == 1 and rivals:
        sentences.append("That is one recording: on another the order may differ.")
    return sentences


def _rival(cell: Cell, names: Sequence[str], error: Metric, cost: str) -> _Rival | None:
    figure, price = cell.figures[error.column], cell.figures[cost].summary
    if (middle := _middle(cell, error.column)) is None:
        return None
    name = _name(cell, names)
    told = f"{error.title.partition(' [')[0]} {error.show(middle)} {error.unit}"
    return _Rival(name, middle, figure.ends, told, price.mean if price else None)


def _middle(cell: Cell, error: str) -> float | None:
    """Return a group's median, None where half of what counts failed."""
    middle = cell.figures[error].middle
    return None if middle is None or math.isinf(middle) else middle


def _name(cell: Cell, names: Sequence[str]) -> str:
    settings = keys_text({name: cell.keys[name] for name in names if cell.keys[name] is not None})
    return f"{cell.keys['algorithm']} with {settings}" if settings else str(cell.keys["algorithm"])


def _unranked(cells: Sequence[Cell], names: Sequence[str]) -> str:
    """Return the sentence on groups that are not ranked: who, and what became of how many of their runs."""
    told = [f"{_name(cell, names)} ({_became(cell)})" for cell in cells]
    return f"Not ranked, for runs that did not track: {_first(told)}."


def _first(told: Sequence[str]) -> str:
    """Return the first of some, and how many more there are."""
    more = f" and {len(told) - _MOST} more" if len(told) > _MOST else ""
    return ", ".join(told[:_MOST]) + more


def _became(cell: Cell) -> str:
    found = {**cell.failures, **cell.untracked}
    if not found:
        return "without an error"
    if len(found) == 1 and sum(found.values()) == cell.runs:
        return f"{next(iter(found))} in {'its run' if cell.runs == 1 else f'all {cell.runs} runs'}"
    return f"{', '.join(f'{word} in {count}' for word, count in found.items())} of {plural(cell.runs, 'run')}"


def _ranked(dataset: str, rivals: Sequence[_Rival], cost: Metric) -> list[str]:
    """Return sentences on the groups of a dataset, which come with the smallest error first."""
    if not rivals:
        return [f"On {dataset} nothing won: no setting tracked in most of its runs."]
    best, others = rivals[0], rivals[1:]
    if not others:
        return [f"On {dataset} {best.name} alone tracked: {best.told}."]
    sentences = [f"On {dataset} {best.name} has the smallest error: {best.told}{_price(best, rivals, cost)}."]
    near = [one for one in others if best.is_near(one)]
    among = [one for one in others if best.is_among(one) and one not in near]
    for how, some in (
        (f"within {100 * (NEAR - 1):.0f} %", near),
        (f"with a best run no worse than the worst of {best.name}", among),
    ):
        if some:
            told = [f"{one.name} ({one.told})" for one in some]
            sentences.append(f"As good, {how}: {_first(told)}.")
    return sentences


def _price(best: _Rival, rivals: Sequence[_Rival], cost: Metric) -> str:
    """Return the cost of the best beside the least, as the end of a sentence."""
    known = [(one.cost, one) for one in rivals if one.cost]
    if not best.cost or not known:
        return ""
    word = cost.title.partition(" [")[0]
    least, cheapest = min(known, key=lambda one: one[0])
    if best.cost <= NEAR * least:
        return f", and no other takes less {word}"
    times = f"{best.cost / least:.2g} times the {word}"
    return f", for {times} of the cheapest, {cheapest.name} ({cheapest.told})"
