# SPDX-License-Identifier: Apache-2.0
"""Groups of runs and their figures: the one table behind commands, pages, reports and data frames.

Figures are over tracked runs unless asked otherwise; beside them stand the number of runs, what became of
those that don't count, and the coverage. What must never be averaged together (algorithms, datasets,
evaluations, settings, paces, processors, versions) becomes a key by itself where it varies.
docs/results.md, "What counts", says the same in words.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.cells import Cell, Figure, Places, figures
from slamhive.analysis.columns import Column, renumbered
from slamhive.analysis.measures import BESIDE, CONFIGURATION, Better, follows_trajectory, is_error, measure_of
from slamhive.analysis.statistics import edges
from slamhive.model.base import Choice
from slamhive.model.results import Outcome, Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    import numpy.typing as npt

    from slamhive.analysis.columns import Floats, Indices, Mask
    from slamhive.analysis.frame import Frame

SUBJECT = ("algorithm", "sensors", "dataset")
"""Columns whose values are equal where a setting is compared."""

FACETS = (
    *SUBJECT,
    "evaluation",
    "alignment",
    "settings",
    "input.pace",
    "algorithm.version",
    "dataset.version",
)
"""Columns that are never pooled: they become keys where they vary."""

LOAD_FACETS = ("provenance.cpuModel", "usage.includesReader")
"""Columns that are never pooled where a figure of load is asked for."""

MEMORY_FACETS = ("usage.memory.kind",)
"""Columns that are never pooled where a figure of memory is asked for: what its bytes are."""

OWNERS = {
    "alignment": "evaluation",
    "settings": "evaluation",
    "algorithm.version": "algorithm",
    "dataset.version": "dataset",
}
"""Facets that need not be told where they follow from another one."""

LOAD = "usage."
MEMORY = "usage.memory."
"""Beginnings of the names of figures of load, and of memory."""

_LATE_SECONDS = 1.0
"""Latency of a pose from which a program holds more frames than it works on."""
DISTURBED = ("usage.cpu.meanCores", "usage.cpu.maxCores", "usage.wallSeconds")
"""Columns that say nothing where a run shared its cores with other work or was throttled."""

FAILED_OF_ITSELF = frozenset(
    {
        Reason.OUT_OF_MEMORY.value,
        Reason.DEADLINE_EXCEEDED.value,
        Reason.ALGORITHM_FAILED.value,
        Reason.OUTPUT_TOO_LARGE.value,
        Reason.NO_TRAJECTORY.value,
        Reason.INVALID_TRAJECTORY.value,
    }
)
"""Reasons that are the algorithm's own. What the machine or the user ended says nothing of it."""

_MOST_NAMES = 6


class Outcomes(Choice):
    """Choices of the runs that enter the figures: tracked ones, or all that were evaluated."""

    TRACKED = "tracked"
    ALL = "all"


@dataclass(frozen=True)
class Aggregate:
    """Groups of runs in the order of their keys.

    Attributes:
        keys: columns that tell them apart: facets that vary, then those asked for.
        facets: those of the keys that nobody asked for.
        metrics: what was summarised.
        cells: the groups.
        members: places of the rows of each.
        notes: sentences on what is pooled and left out.
    """

    keys: tuple[str, ...]
    facets: tuple[str, ...]
    metrics: tuple[str, ...]
    cells: list[Cell]
    members: list[Indices]
    notes: tuple[str, ...] = field(default=())


class Groups:
    """Rows by the values of some columns.

    Args:
        frame: the rows.
        names: the columns.
    """

    def __init__(self, frame: Frame, names: Sequence[str]) -> None:
        self.frame = frame
        self.names = tuple(names)
        combined: npt.NDArray[np.int64] = np.zeros(len(frame), dtype=np.int64)
        count = 1
        for name in names:
            codes, values = frame.column(name).factorized()
            if len(values) > 1:
                used, combined = renumbered(combined * len(values) + codes, count * len(values))
                count = len(used)
        self.of_row: npt.NDArray[np.intp] = combined.astype(np.intp)
        self.count = count if len(frame) else 0
        # Numbers of 16 bits are sorted several times as fast: by radix.
        short = self.of_row.astype(np.uint16) if self.count <= 1 << 16 else self.of_row
        self.order: Indices = np.argsort(short, kind="stable")
        self.edges = edges(self.of_row[self.order], self.count)

    @cached_property
    def keys(self) -> list[dict[str, Any]]:
        """The values that the rows of each group share, by column."""
        firsts = np.array([self.order[begin] for begin, _ in self.edges], dtype=np.intp)
        return self.frame.select(firsts).records(self.names)

    def members(self) -> Iterator[Indices]:
        """Go through the rows of each group, in their order."""
        for begin, end in self.edges:
            yield self.order[begin:end]


def aggregate(
    frame: Frame,
    metrics: Sequence[str],
    by: Sequence[str] | None = None,
    outcomes: Outcomes = Outcomes.TRACKED,
    across: Sequence[str] = (),
) -> Aggregate:
    """Group rows and summarise metrics over each group; never pools what must not be pooled.

    Args:
        frame: one row a run and evaluation.
        metrics: columns of numbers.
        by: columns to group by; None for algorithm, sensors, dataset and what varies between their runs.
        outcomes: which runs enter the figures.
        across: further columns to group by, which come last.
    """
    changing = varying(frame)
    asked = [
        name for name in dict.fromkeys([*SUBJECT, *changing] if by is None else by) if name not in across
    ]
    asked += across
    frame, facets = apart(frame, asked, metrics)
    groups = Groups(frame, [*facets, *asked])
    members = list(groups.members())
    cells = _cells(groups, metrics, outcomes)
    pooled = [name for name in changing if name not in groups.names]
    notes = [*pooling_notes(pooled), *disturbance_notes(frame, metrics)]
    same = sum(cell.deterministic for cell in cells)
    if same and any(map(follows_trajectory, metrics)):
        rows = "1 row is" if same == 1 else f"{same} rows are"
        notes.append(f"{rows} deterministic: one result, n equal runs")
    return Aggregate(groups.names, tuple(facets), tuple(metrics), cells, members, tuple(notes))


def pooling_notes(pooled: Sequence[str]) -> list[str]:
    """Say which settings are averaged over."""
    if not pooled:
        return []
    named = list(pooled[:_MOST_NAMES])
    if len(pooled) > _MOST_NAMES:
        named.append(f"{len(pooled) - _MOST_NAMES} more")
    return [f"averaged over different values of {', '.join(named)}"]


def disturbance_notes(frame: Frame, metrics: Sequence[str]) -> list[str]:
    """Say how many runs are left out of the figures on load, and how many fell behind in those on memory."""
    notes = []
    left_out = [name for name in metrics if name in DISTURBED]
    count = int(np.nansum(frame.column("disturbed").floats())) if left_out else 0
    if count:
        runs = "1 run" if count == 1 else f"{count} runs"
        notes.append(
            f"{runs} shared cores with other work or were throttled: left out of {', '.join(left_out)}"
        )
    if any(name.startswith(MEMORY) for name in metrics):
        latest = frame.column("metrics.latencySeconds.max").floats()
        late = latest[latest > _LATE_SECONDS]
        if late.size:
            runs = "1 run" if late.size == 1 else f"{late.size} runs"
            notes.append(
                f"{runs} fell up to {late.max():.0f} s behind in real time: their memory holds what waited"
            )
    return notes


def direction_notes(metrics: Iterable[str]) -> list[str]:
    """Say of which figures nobody knows which way is good, where they are ranked by."""
    return [
        f"{name}: whether small or large is good isn't known: ranked from small to large"
        for name in metrics
        if measure_of(name).better is Better.NONE
    ]


def counting(frame: Frame, outcomes: Outcomes) -> Mask:
    """Tell which rows enter the figures, (n,): tracked ones, or all that were evaluated."""
    if outcomes is Outcomes.ALL:
        return frame.column("outcome").present
    return where_equal(frame, "status", Outcome.TRACKED.value)


def failing(frame: Frame, outcomes: Outcomes) -> Mask:
    """Tell which rows failed of themselves, (n,): they rank behind all numbers.

    Runs that the machine or the user ended, or that nothing measured, say nothing of the algorithm.
    """
    status = frame.column("status")
    words = FAILED_OF_ITSELF
    if outcomes is Outcomes.TRACKED:
        words = words | {Outcome.PARTIAL.value, Outcome.LOST.value, Outcome.DIVERGED.value}
    verdicts = np.array([value in words for value in (*status.values, None)], dtype=bool)
    failed: Mask = verdicts[status.codes]
    return failed


def falling_short(frame: Frame, metric: str) -> Mask:
    """Tell which rows' metric is of a trajectory beside the run's own that is no tracked one, (n,)."""
    beside = BESIDE.fullmatch(metric)
    if beside is None:
        return np.zeros(len(frame), dtype=bool)
    name = f"beside.{beside[1]}.outcome"
    return frame.column(name).present & ~where_equal(frame, name, Outcome.TRACKED.value)


def worst(frame: Frame, metric: str, outcomes: Outcomes) -> Mask:
    """Tell which rows rank behind all numbers of a metric, (n,).

    Those that failed of themselves, or whose trajectory that the metric is of did; and where all evaluated
    runs count, those that lost their way so that they have no error at all.
    """
    last, short = failing(frame, outcomes), falling_short(frame, metric)
    if outcomes is Outcomes.TRACKED:
        return last | short
    if is_error(metric):
        without = np.isnan(frame.column(metric).floats()) & frame.column("outcome").present
        last = last | (without & (short | ~where_equal(frame, "status", Outcome.TRACKED.value)))
    return last


def covered(frame: Frame) -> Floats:
    """Return the coverage that each row stands for, (n,): 0 where a run failed of itself, NaN if unknown."""
    coverage = frame.column("coverage").floats()
    return np.where(np.isnan(coverage) & failing(frame, Outcomes.ALL), 0.0, coverage)


def unranked_notes(frame: Frame, outcomes: Outcomes) -> list[str]:
    """Say which runs have no rank: those that the machine or the user ended, and those not measured."""
    unranked = ~(counting(frame, outcomes) | failing(frame, outcomes))
    if not unranked.any():
        return []
    status = frame.column("status")
    words = [f"{count} {word}" for word, count in tally(status.values, status.codes[unranked]).items()]
    return [f"{', '.join(words)}: no rank, as the algorithm is not to blame"]


def where_equal(frame: Frame, name: str, value: Any) -> Mask:
    """Tell which rows have a value in a column of texts, (n,)."""
    column = frame.column(name)
    if column.kind.is_numeric or value not in column.values:
        return np.zeros(len(frame), dtype=bool)
    equal: Mask = column.codes == column.values.index(value)
    return equal


def sound(frame: Frame, name: str, outcomes: Outcomes = Outcomes.TRACKED) -> Mask:
    """Tell which rows' figure of a name counts, (n,), where the run itself does."""
    if name not in DISTURBED:
        return np.ones(len(frame), dtype=bool) if outcomes is Outcomes.ALL else ~falling_short(frame, name)
    return ~(frame.column("disturbed").floats() > 0)


def varying(frame: Frame) -> list[str]:
    """Return the columns of the configuration that differ between runs of one algorithm on one dataset."""
    if not len(frame):
        return []
    groups = Groups(frame, SUBJECT)
    firsts = np.empty(groups.count, dtype=np.intp)
    firsts[groups.of_row[::-1]] = np.arange(len(frame))[::-1]
    example = firsts[groups.of_row]
    names = (name for name in frame.stored if name.startswith(CONFIGURATION) and name not in FACETS)
    return sorted(name for name in names if _differs(frame.glance(name), example))


def apart(frame: Frame, asked: Iterable[str], metrics: Iterable[str]) -> tuple[Frame, list[str]]:
    """Return the rows, and the columns by which they must be kept apart beside those asked for.

    A value that isn't known does not keep a row apart: where all rows like it have the same one, it takes
    that. A missing evaluation is told apart all the same: such a run belongs to no other's.

    Args:
        frame: the rows.
        asked: columns that tell them apart already.
        metrics: what is asked of them.
    """
    given = list(dict.fromkeys(asked))
    names = list(metrics)
    candidates = [
        *FACETS,
        *(LOAD_FACETS if any(name.startswith(LOAD) for name in names) else ()),
        *(MEMORY_FACETS if any(name.startswith(MEMORY) for name in names) else ()),
    ]
    facets = [name for name in candidates if name not in given and _differ(frame, name)]
    filled = _filled(frame, given, facets)
    kept = []
    for name in facets:
        owner = OWNERS.get(name)
        if owner is not None and (owner in facets or owner in given) and follows(filled, name, owner):
            continue
        kept.append(name)
    return filled, kept


def _differ(frame: Frame, name: str) -> bool:
    column = frame.column(name)
    if name == "evaluation":
        return varies(frame, name)
    known = column.numbers[column.present] if column.kind.is_numeric else column.codes[column.codes >= 0]
    return len(known) > 0 and bool((known != known[0]).any())


def follows(frame: Frame, name: str, owner: str) -> bool:
    """Tell whether a column has one value wherever another one has: a version, where an algorithm has one."""
    return Groups(frame, (owner, name)).count == Groups(frame, (owner,)).count


def _filled(frame: Frame, asked: Sequence[str], facets: Sequence[str]) -> Frame:
    """Return the rows with facets that they lack taken from rows like them, where those agree."""
    partly = [name for name in facets if name != "evaluation" and not frame.column(name).present.all()]
    if not partly:
        return frame
    whole = [name for name in facets if name not in partly]
    same = list(dict.fromkeys([*asked, *whole, "evaluation"]))
    groups, alike = Groups(frame, [*same, *partly]), Groups(frame, same)
    first = np.array([group[0] for group in groups.members()], dtype=np.intp)
    values = {name: _places(frame.column(name))[first] for name in partly}
    of_alike = alike.of_row[first]
    taken = {name: places.copy() for name, places in values.items()}
    members: dict[int, list[int]] = {}
    for group, number in enumerate(of_alike.tolist()):
        members.setdefault(number, []).append(group)
    lacking = np.flatnonzero(np.logical_or.reduce([places < 0 for places in values.values()]))
    for group in lacking.tolist():
        others = np.array(members[int(of_alike[group])])
        agree = np.ones(len(others), dtype=bool)
        for places in values.values():
            theirs = places[others]
            agree &= (places[group] < 0) | (theirs < 0) | (theirs == places[group])
        for name, places in values.items():
            known = set(places[others[agree]].tolist()) - {-1}
            if places[group] < 0 and len(known) == 1:
                taken[name][group] = known.pop()
    columns = {}
    for name in partly:
        codes, values_of = taken[name][groups.of_row], _values(frame.column(name))
        columns[name] = Column.of([values_of[code] if code >= 0 else None for code in codes.tolist()])
    return frame.replaced(columns)


def _places(column: Column) -> npt.NDArray[np.int64]:
    """Return the place of each value among those of a column, -1 where missing, (n,)."""
    if not column.kind.is_numeric:
        return column.codes.astype(np.int64)
    uniques = np.unique(column.numbers[column.present])
    return np.where(column.present, np.searchsorted(uniques, column.numbers), -1)


def _values(column: Column) -> list[Any]:
    if not column.kind.is_numeric:
        return list(column.values)
    return [column.plain(number) for number in np.unique(column.numbers[column.present]).tolist()]


def varies(frame: Frame, name: str) -> bool:
    """Tell whether a column has more than one value, a missing one counted as a value."""
    return len(frame) > 0 and _differs(frame.column(name), np.zeros(len(frame), dtype=np.intp))


def _differs(column: Column, example: Indices) -> bool:
    if not column.kind.is_numeric:
        return bool((column.codes != column.codes[example]).any())
    other = column.numbers[example]
    same = (column.numbers == other) | (np.isnan(column.numbers) & np.isnan(other))
    return not same.all()


def _cells(groups: Groups, metrics: Sequence[str], outcomes: Outcomes) -> list[Cell]:
    """Return the cell of each group: its runs, failures and figures."""
    frame, places = groups.frame, Places(groups.order, groups.edges)
    status = frame.column("status")
    codes = status.codes.astype(np.intp)
    counted = counting(frame, outcomes)
    coverage = covered(frame)
    trajectory = frame.column("trajectory.sha256")
    same = [False] * places.count
    if not trajectory.kind.is_numeric:
        same = places.agree(trajectory.codes.astype(np.intp), counted).tolist()
    shown = [_figures(frame, places, name, counted=counted, outcomes=outcomes, same=same) for name in metrics]
    lists = zip(
        groups.keys,
        places.counts(np.ones(len(frame), dtype=bool)).tolist(),
        places.counts(counted).tolist(),
        places.tallies(status.values, codes, ~counted),
        places.tallies(status.values, codes, counted),
        places.numbers(coverage, ~np.isnan(coverage)).summaries(),
        zip(*shown, strict=True) if shown else [()] * places.count,
        same,
        strict=True,
    )
    found = []
    for keys, runs, n, failures, untracked, covering, row, deterministic in lists:
        untracked.pop(Outcome.TRACKED.value, None)
        by_name = dict(zip(metrics, row, strict=True))
        found.append(Cell(keys, runs, n, failures, untracked, covering, by_name, deterministic))
    return found


def _figures(
    frame: Frame, places: Places, name: str, *, counted: Mask, outcomes: Outcomes, same: Sequence[bool]
) -> list[Figure]:
    inside = counted & sound(frame, name, outcomes)
    numbers = places.numbers(frame.column(name).floats(), inside)
    if not is_error(name):
        return figures(numbers)
    single = same if follows_trajectory(name) else [False] * len(same)
    return figures(numbers, places.counts(worst(frame, name, outcomes)), single, measure_of(name).sign)


def tally(words: Sequence[str], codes: npt.NDArray[np.int32]) -> dict[str, int]:
    """Return the count of each word, by their codes, the words sorted."""
    counts = np.bincount(codes, minlength=len(words)).tolist()
    return dict(sorted((word, count) for word, count in zip(words, counts, strict=True) if count))


def ranked_errors(numbers: Floats, inside: Mask, failed: Mask) -> Floats:
    """Return the errors of the runs that count, sorted, with those that failed as +inf behind all others."""
    values = numbers[inside & ~np.isnan(numbers)]
    return np.sort(np.concatenate([values, np.full(int(np.count_nonzero(failed)), np.inf)]))
