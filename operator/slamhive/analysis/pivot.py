# SPDX-License-Identifier: Apache-2.0
"""Grouping rows and averaging over repetitions, without ever losing sight of what failed.

Means are over tracked runs unless asked otherwise; beside them stand the number of runs, what became
of those that don't count, and the coverage of all. What must never be averaged together (algorithms,
datasets, evaluations, paces, processors) becomes a key by itself where it varies.
"""

from __future__ import annotations

import json
import math
import statistics
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from slamhive.analysis.ordering import sort_key
from slamhive.model.base import Choice
from slamhive.model.results import Outcome, Phase

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    Row = Mapping[str, Any]

FACETS = (
    *("algorithm", "sensors", "dataset", "evaluation", "alignment", "input.pace", "provenance.cpuModel"),
    "usage.includesReader",
)
"""Columns that are never pooled: they become keys where they vary."""

DISTURBED = ("usage.cpu.meanCores", "usage.cpu.maxCores", "usage.wallSeconds")
"""Columns that say nothing where a run shared its cores with other work or was throttled."""

MAX_CONTENDED = 0.1
MAX_THROTTLED = 0.01
"""Shares of the wall time from which a run counts as disturbed."""

CONFIGURATION = ("parameters.", "input.", "dataset.attributes.", "resources.")
"""What the names of settings begin with."""

SUBJECT = ("algorithm", "sensors", "dataset")
"""What a setting is compared within."""

_MOST_NAMES = 6


class Outcomes(Choice):
    """Which runs enter the means."""

    TRACKED = "tracked"
    ALL = "all"


@dataclass(frozen=True)
class Summary:
    """Some numbers in short.

    Attributes:
        n: how many.
        mean: arithmetic mean.
        std: standard deviation of the sample (n − 1 in the denominator), None for one number.
        median, min, max: as their names say.
    """

    n: int
    mean: float
    std: float | None
    median: float
    min: float
    max: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Summary | None:
        """Summarise numbers, None for none; the sums are exact before the last rounding."""
        numbers = [float(value) for value in values]
        if not numbers:
            return None
        mean = math.fsum(numbers) / len(numbers)
        spread = math.fsum((number - mean) ** 2 for number in numbers)
        std = math.sqrt(spread / (len(numbers) - 1)) if len(numbers) > 1 else None
        return cls(len(numbers), mean, std, statistics.median(numbers), min(numbers), max(numbers))


@dataclass(frozen=True)
class Group:
    """What a group of runs came to.

    Attributes:
        keys: the values that its runs share, by column.
        runs: number of runs.
        n: number of runs that enter the means.
        failures: number of runs that weren't tracked, by outcome, reason or phase.
        coverage: coverage of all evaluated runs, tracked or not.
        metrics: summaries by column, None where no run has a number.
    """

    keys: dict[str, Any]
    runs: int
    n: int
    failures: dict[str, int]
    coverage: Summary | None
    metrics: dict[str, Summary | None]


@dataclass(frozen=True)
class PivotTable:
    """Groups of runs.

    Attributes:
        rows: columns whose values tell the rows apart.
        columns: columns whose values lie side by side.
        metrics: columns that were summarised.
        groups: in the order of their keys.
        notes: sentences on what is pooled.
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    metrics: tuple[str, ...]
    groups: list[Group]
    notes: tuple[str, ...] = field(default=())


def table(
    rows: Sequence[Row],
    metrics: Sequence[str],
    by: Sequence[str] | None = None,
    across: Sequence[str] = (),
    outcomes: Outcomes = Outcomes.TRACKED,
) -> PivotTable:
    """Group rows and summarise metrics over each group.

    Args:
        rows: as ``flatten`` makes them, one a run and evaluation.
        metrics: columns of numbers.
        by: columns to group by; None for algorithm, sensors, dataset and what varies between their runs.
        across: further columns to group by, to be laid out side by side.
        outcomes: which runs enter the means.
    """
    rows = _with_facets(rows)
    changing = varying(rows)
    asked = [*SUBJECT, *changing] if by is None else list(by)
    asked = [name for name in dict.fromkeys(asked) if name not in across]
    facets = [name for name in FACETS if name not in {*asked, *across} and _varies(rows, name)]
    if "evaluation" in facets and "alignment" in facets and _determines(rows, "evaluation", "alignment"):
        facets.remove("alignment")
    keys = [*facets, *asked, *across]
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(_hashable(row.get(name)) for name in keys), []).append(row)
    members = sorted(groups.values(), key=lambda group: [sort_key(group[0].get(name)) for name in keys])
    pooled = [name for name in changing if name not in keys]
    if len(pooled) > _MOST_NAMES:
        pooled = [*pooled[:_MOST_NAMES], f"{len(pooled) - _MOST_NAMES} more"]
    notes = [f"averaged over different values of {', '.join(pooled)}"] if pooled else []
    left_out = [name for name in metrics if name in DISTURBED]
    count = sum(map(disturbed, rows)) if left_out else 0
    if count:
        runs = "1 run" if count == 1 else f"{count} runs"
        notes.append(
            f"{runs} shared cores with other work or were throttled: left out of {', '.join(left_out)}"
        )
    return PivotTable(
        tuple(keys[: len(keys) - len(across)]),
        tuple(across),
        tuple(metrics),
        [_group(group, keys, metrics, outcomes) for group in members],
        tuple(notes),
    )


def disturbed(row: Row) -> bool:
    """Tell whether other work on a run's cores, or throttling, falsified its load and wall time."""
    wall = row.get("usage.wallSeconds")
    if not wall:
        return False
    contended, throttled = row.get("usage.contendedSeconds") or 0.0, row.get("usage.throttledSeconds") or 0.0
    return bool(contended > MAX_CONTENDED * wall or throttled > MAX_THROTTLED * wall)


def varying(rows: Sequence[Row]) -> list[str]:
    """Return the columns of the configuration that differ between runs of one algorithm on one dataset."""
    seen: dict[tuple[Any, ...], dict[str, Any]] = {}
    counts: Counter[tuple[Any, ...]] = Counter()
    present: Counter[tuple[tuple[Any, ...], str]] = Counter()
    found: set[str] = set()
    for row in rows:
        subject = tuple(row.get(name) for name in SUBJECT)
        first = seen.setdefault(subject, {})
        counts[subject] += 1
        for name, value in row.items():
            if name.startswith(CONFIGURATION) and name not in found:
                present[subject, name] += 1
                if first.setdefault(name, value) != value:
                    found.add(name)
    # A parameter that only some of a subject's runs have differs from those that lack it.
    found |= {name for (subject, name), count in present.items() if count < counts[subject]}
    return sorted(found - set(FACETS))


def status(row: Row) -> str:
    """Return what became of a row's run in one word: an outcome, or why there is none."""
    if row.get("outcome"):
        return str(row["outcome"])
    if row.get("phase") == Phase.SUCCEEDED.value:
        return "NotEvaluated"
    return str(row.get("reason") or row.get("phase"))


def _with_facets(rows: Sequence[Row]) -> list[Row]:
    """Give failed runs the evaluations that the others have, so that they are counted beside them."""
    evaluations = sorted({str(row["evaluation"]) for row in rows if row.get("evaluation") is not None})
    alignments: dict[tuple[Any, ...], Any] = {}
    for row in rows:
        if row.get("alignment") is not None:
            for key in _likenesses(row, row.get("evaluation")):
                known = alignments.setdefault(key, row["alignment"])
                if known != row["alignment"]:
                    alignments[key] = None
    complete: list[Row] = []
    for row in rows:
        if row.get("outcome"):
            complete.append(row)
            continue
        given: Sequence[Any] = evaluations or [None]
        if row.get("evaluation") is not None:
            given = [row["evaluation"]]
        for evaluation in given:
            found = (alignments.get(key) for key in _likenesses(row, evaluation))
            alignment = next((name for name in found if name is not None), None)
            complete.append({**row, "evaluation": evaluation, "alignment": alignment})
    return complete


def _likenesses(row: Row, evaluation: Any) -> tuple[tuple[Any, ...], ...]:
    """Return what runs share that are aligned alike, the surest first."""
    algorithm, sensors = row.get("algorithm"), row.get("sensors")
    return (evaluation, algorithm, sensors), (evaluation, None, sensors), (evaluation,)


def _varies(rows: Sequence[Row], name: str) -> bool:
    first = rows[0].get(name) if rows else None
    return any(row.get(name) != first for row in rows)


def _determines(rows: Sequence[Row], name: str, other: str) -> bool:
    found: dict[Any, Any] = {}
    return all(found.setdefault(row.get(name), row.get(other)) == row.get(other) for row in rows)


def _group(rows: Sequence[Row], keys: Sequence[str], metrics: Sequence[str], outcomes: Outcomes) -> Group:
    words = [status(row) for row in rows]
    counted = [
        row
        for row, word in zip(rows, words, strict=True)
        if word == Outcome.TRACKED.value or (outcomes is Outcomes.ALL and row.get("outcome"))
    ]
    failures = Counter(word for word in words if word != Outcome.TRACKED.value)
    return Group(
        keys={name: rows[0].get(name) for name in keys},
        runs=len(rows),
        n=len(counted),
        failures=dict(sorted(failures.items())),
        coverage=Summary.of(_numbers(rows, "coverage")),
        metrics={name: Summary.of(_numbers(_sound(counted, name), name)) for name in metrics},
    )


def _sound(rows: Sequence[Row], name: str) -> Sequence[Row]:
    return [row for row in rows if not disturbed(row)] if name in DISTURBED else rows


def _numbers(rows: Iterable[Row], name: str) -> list[float]:
    values = (row.get(name) for row in rows)
    return [
        value
        for value in values
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    ]


def _hashable(value: Any) -> Any:
    return json.dumps(value, sort_keys=True) if isinstance(value, list | dict) else value
