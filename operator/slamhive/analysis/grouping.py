# SPDX-License-Identifier: Apache-2.0
"""Groups of runs and their figures: the one table behind commands, pages, reports and data frames.

Figures are over tracked runs unless asked otherwise; beside them stand the number of runs, what became of
those that don't count, and the coverage. What must never be averaged together (algorithms, datasets,
evaluations, settings, paces, processors and their clocks, versions) becomes a key by itself where it varies.
docs/results.md, "What counts", says the same in words.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.cells import CellColumns, Cells, GroupFigures, Places, again
from slamhive.analysis.columns import FIRST_THEN_ALL, Column, renumbered
from slamhive.analysis.measures import (
    BESIDE,
    CONFIGURATION,
    LATE_SECONDS,
    Better,
    follows_trajectory,
    is_error,
    measure_of,
)
from slamhive.model.algorithm import Pace
from slamhive.model.base import Choice, plural
from slamhive.model.results import Outcome, Phase, Reason

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
    "evaluationVersion",
    "input.pace",
    "algorithm.version",
    "dataset.version",
)
"""Columns that are never pooled: they become keys where they vary."""

ORIGIN = "origin"
"""Column of whose runs are, in tables that hold runs of somebody else."""

PROCESSOR = "provenance.cpuModel"
"""Column of the model of a run's processor."""

CONDITIONS = (
    PROCESSOR,
    *(f"provenance.machine.{name}" for name in ("smt", "governor", "turbo", "exclusiveCores")),
)
"""Columns of what says what a CPU second is: `engine.LoadConditions`."""

LOAD_FACETS = (*CONDITIONS, "usage.includesReader", ORIGIN)
"""Columns that are never pooled where a figure of load is asked for."""

MEMORY_FACETS = ("usage.memory.kind",)
"""Columns that are never pooled where a figure of memory is asked for: what its bytes are."""

OWNERS = {
    "alignment": "evaluation",
    "settings": "evaluation",
    "evaluationVersion": "evaluation",
    "algorithm.version": "algorithm",
    "dataset.version": "dataset",
    **dict.fromkeys(CONDITIONS[1:], PROCESSOR),
}
"""Facets that need not be told where they follow from another one."""

LOAD = "usage."
CPU = "usage.cpu."
MEMORY = "usage.memory."
"""Beginnings of the names of figures of load, of CPU, and of memory."""

FINDINGS = "prepared.findings"
"""Column of the codes of what was known to be wrong with a run's recording."""
MARK = "†"
"""Sign of figures of such runs."""

READER = "‡"
"""Sign of figures of CPU that hold the reading of the recording, or may, beside others that don't."""

COPIED = "(=)"
"""Sign of numbers of results that more runs than those have."""

LATE = "§"
"""Sign of figures of memory of runs whose poses came late, so that frames waited in it."""

SEARCHED = "search"
"""Column of the method by whose results a run was chosen."""
CHOSEN = "¶"
"""Sign of figures of such runs."""

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
_SHORT = 1 << 31
"""Above all numbers of 32 bits."""
_MOST_COMBINED = 1 << 16
"""Combinations of values up to which it isn't looked for those that occur before the last column."""


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
        groups: the rows of each, as they are.
        notes: sentences on what is pooled and left out.
    """

    keys: tuple[str, ...]
    facets: tuple[str, ...]
    metrics: tuple[str, ...]
    cells: Cells
    groups: Groups
    notes: tuple[str, ...] = field(default=())

    @property
    def members(self) -> Iterator[Indices]:
        """The places of the rows of each group, in the order of their keys."""
        return self.groups.members()


class Groups:
    """Rows by the values of some columns.

    Args:
        frame: the rows.
        names: the columns.
    """

    def __init__(self, frame: Frame, names: Sequence[str]) -> None:
        self.frame = frame
        self.names = tuple(names)
        combined: npt.NDArray[Any] = np.zeros(len(frame), dtype=np.int32)
        count = bound = 1
        for name in names:
            codes, values = frame.column(name).factorized()
            if len(values) > 1:
                if bound * len(values) > _MOST_COMBINED:
                    used, combined = renumbered(combined, bound)
                    bound = len(used)
                bound *= len(values)
                # Half as long while they can be: most of the time goes into memory.
                short: type[np.signedinteger[Any]] = np.int32 if bound < _SHORT else np.int64
                combined = combined.astype(short, copy=False) * len(values) + codes
        if bound > 1:
            used, combined = renumbered(combined, bound)
            count = len(used)
        self.of_row: npt.NDArray[np.intp] = combined.astype(np.intp, copy=False)
        self.count = count if len(frame) else 0

    @cached_property
    def order(self) -> Indices:
        """The places of the rows, group by group, (n,)."""
        # Numbers of 16 bits are sorted several times as fast: by radix.
        short = self.of_row.astype(np.uint16) if self.count <= 1 << 16 else self.of_row
        return np.argsort(short, kind="stable")

    @cached_property
    def sizes(self) -> Indices:
        """The number of rows of each group, (groups,)."""
        return np.bincount(self.of_row, minlength=self.count)

    @cached_property
    def keys(self) -> list[dict[str, Any]]:
        """The values that the rows of each group share, by column."""
        return self.frame.select(self.firsts).records(self.names)

    @cached_property
    def firsts(self) -> Indices:
        """The place of the first row of each group, (groups,)."""
        found = np.empty(self.count, dtype=np.intp)
        found[self.of_row[::-1]] = np.arange(len(self.of_row))[::-1]
        return found

    @cached_property
    def starts(self) -> Indices:
        """The place in the order where each group begins, (groups,)."""
        return np.cumsum(self.sizes) - self.sizes

    def members(self, groups: Indices | slice = slice(None)) -> Iterator[Indices]:
        """Go through the rows of each group, or of each of some, in their order."""
        parts = zip(self.starts[groups].tolist(), self.sizes[groups].tolist(), strict=True)
        for begin, size in parts:
            yield self.order[begin : begin + size]


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
    cells = _cells(groups, metrics, outcomes)
    pooled = [name for name in changing if name not in groups.names]
    notes = [*pooling_notes(pooled), *idle_notes(frame, pooled)]
    notes += [*disturbance_notes(frame, metrics), *finding_notes(frame)]
    notes += copy_notes(int(cells.columns.copies.sum()), metrics) + reader_notes(frame, metrics)
    notes += chosen_notes(frame) + origin_notes(frame)
    return Aggregate(groups.names, tuple(facets), tuple(metrics), cells, groups, tuple(notes))


def condition_words(names: Sequence[str]) -> str:
    """Return the words for runs whose load some columns tell apart: ``of different processors``."""
    unlike = [name for name in CONDITIONS if name in names]
    if PROCESSOR in unlike:
        return "of different processors"
    return f"with different {' and '.join(measure_of(name).text for name in unlike)}" if unlike else ""


def pooling_notes(pooled: Sequence[str]) -> list[str]:
    """Say which settings are averaged over."""
    if not pooled:
        return []
    return [f"averaged over different values of {', '.join(_first(pooled))}"]


def idle_notes(frame: Frame, pooled: Sequence[str]) -> list[str]:
    """Say which settings change nothing though averaged over: trajectories are equal at all values."""
    tracks = frame.column("trajectory.sha256")
    if not pooled or tracks.kind.is_numeric:
        return []
    groups = Groups(frame, SUBJECT)
    # Without a trajectory none is equal.
    first = np.maximum(tracks.codes[groups.firsts], 0)
    for part in FIRST_THEN_ALL:
        of_row = groups.of_row[part]
        unlike = of_row[tracks.codes[part] != first[of_row]]
        equal = np.bincount(unlike, minlength=groups.count) == 0
        if not equal.any():
            return []
    members = list(zip(groups.keys, groups.members(), strict=True))
    able = {key["algorithm"] for (key, _), same in zip(members, equal, strict=True) if same} - {None}
    idle: set[tuple[Any, str]] = set()
    moved: set[tuple[Any, str]] = set()
    for (key, rows), same in zip(members, equal, strict=True):
        if key["algorithm"] in able:
            inside = frame.select(rows)
            (idle if same else moved).update((key["algorithm"], one) for one in pooled if varies(inside, one))
    told = [f"{name.rpartition('.')[2]} changes nothing for {whom}" for whom, name in sorted(idle - moved)]
    return [f"{'; '.join(_first(told))}: equal trajectories at all values"] if told else []


def disturbance_notes(frame: Frame, metrics: Sequence[str]) -> list[str]:
    """Say how many runs are left out of the figures on load, how many fell behind, and whose load is none."""
    notes = []
    left_out = [name for name in metrics if name in DISTURBED]
    count = frame.count_runs(frame.column("disturbed").floats() > 0) if left_out else 0
    if count:
        notes.append(
            f"{plural(count, 'run')} shared cores with other work or were throttled: left out of "
            f"{', '.join(left_out)}"
        )
    timed = where_equal(frame, "input.pace", Pace.REALTIME.value)
    others = [pace.value for pace in Pace if where_equal(frame, "input.pace", pace.value)[~timed].any()]
    if left_out and others and timed.any():
        whose = f"{', '.join(left_out)} of runs in {' and '.join(others)}"
        notes.append(
            f"{whose} say how fast a program was, not what a robot needs, as those in Realtime do: compare "
            "usage.cpu.secondsPerDataSecond"
        )
    return [*notes, *(f"{LATE} {note}" for note in late_notes(frame, metrics))]


def late_notes(frame: Frame, metrics: Iterable[str]) -> list[str]:
    """Say what memory means of runs whose poses came late, where it is shown."""
    count = frame.count_runs(falls_behind(frame, metrics))
    if not count:
        return []
    late = frame.column(LATE_SECONDS).floats()
    runs = "" if len(frame) == 1 else f" in {plural(count, 'run')}"
    return [late_words(float(np.nanmax(late)), runs)]


def falls_behind(frame: Frame, metrics: Iterable[str]) -> Mask:
    """Tell of which rows memory is shown that holds frames that waited, (n,)."""
    if any(name.startswith(MEMORY) for name in metrics):
        return frame.column(LATE_SECONDS).present
    return np.zeros(len(frame), dtype=bool)


def late_words(seconds: float, runs: str = "") -> str:
    """Return the remark on memory where poses came late, of some runs: `` in 3 runs``."""
    return (
        f"poses came up to {seconds:.2g} s late{runs}: memory says how far it fell behind, not what it needs"
    )


def copy_notes(copies: int, metrics: Iterable[str]) -> list[str]:
    """Say how many runs repeat a result, and that it counts once."""
    if not copies:
        return []
    names = list(metrics)
    told = "1 run repeats" if copies == 1 else f"{copies} runs repeat"
    whole = "; loads are of all runs" if not all(map(follows_trajectory, names)) else ""
    return [f"equal results count once {COPIED}, in n and in errors: {told} another's trajectory{whole}"]


def shows_cpu(frame: Frame) -> Mask:
    """Tell of which rows CPU is shown: not of runs that were ended, whatever they say of it, (n,)."""
    # Records of others can have the mean load alone.
    told = frame.column("usage.cpu.seconds").present | frame.column("usage.cpu.meanCores").present
    return told & where_equal(frame, "phase", Phase.SUCCEEDED.value)


def holds_reader(frame: Frame, metrics: Iterable[str]) -> Mask:
    """Tell of which rows CPU is shown that holds reading, or may, where that of others doesn't, (n,)."""
    told = frame.column("usage.includesReader").floats()
    measured = shows_cpu(frame)
    if not any(name.startswith(CPU) for name in metrics) or not (told == 0).any():
        measured = np.zeros_like(measured)
    found: Mask = measured & (told != 0)
    return found


def reader_notes(frame: Frame, metrics: Iterable[str]) -> list[str]:
    """Say whose CPU holds the reading of the recording where that of others doesn't."""
    rows = holds_reader(frame, metrics)
    if not rows.any():
        return []
    names = sorted({str(name) for name in frame.select(rows).column("algorithm").tolist()})
    whose = f"{READER} the CPU of {', '.join(_first(names))}"
    return [f"{whose} holds the reading of the recording, or may: it can't be compared with that of others"]


def finding_notes(frame: Frame) -> list[str]:
    """Say what was known to be wrong with which datasets, where their runs are marked."""
    found: dict[str, set[str]] = {}
    words, codes = _findings(frame)
    datasets = frame.column("dataset").tolist() if words else []
    for row in np.flatnonzero(codes >= 0).tolist():
        found.setdefault(str(datasets[row]), set()).update(words[codes[row]])
    if not found:
        return []
    told = [f"{name}: {', '.join(sorted(found[name]))}" for name in sorted(found)]
    return [f"{MARK} the recording has open findings ({'; '.join(_first(told))})"]


def chosen_notes(frame: Frame) -> list[str]:
    """Say how many runs a search chose by its results, where they are marked."""
    column = frame.column(SEARCHED)
    if column.is_empty:
        return []
    count, rest = frame.count_runs(column.present), frame.count_runs()
    share = "all runs were" if count == rest else f"{plural(count, 'run')} of {rest:,} were"
    return [f"{CHOSEN} {share} chosen by a search for its results ({_methods(frame)}): no fair sample"]


def origin_notes(frame: Frame) -> list[str]:
    """Say which algorithms' runs somebody else made, and how many of them were repeated here."""
    if frame.column("origin.kind").is_empty:
        return []
    foreign = frame.select(frame.column("origin.kind").present)
    told = []
    groups = Groups(foreign, ("algorithm", "origin.source"))
    for keys, rows in zip(groups.keys, groups.members(), strict=True):
        mine = foreign.select(rows)
        words = mine.column(ORIGIN).unique()
        runs = plural(mine.count_runs(), "run")
        word = " and ".join(sorted({str(one).partition(" (")[0] for one in words}))
        told.append(f"{keys['algorithm']}: {word} ({runs} from {keys['origin.source']})")
    return _first(told)


def without_chosen(frame: Frame) -> tuple[Frame, list[str]]:
    """Return the runs without those that a search chose by its results, and say how many these are.

    They say how well a setting can do, not how a system does: who was searched longest would win. Where all
    runs are such, they stay, and that is said.
    """
    column = frame.column(SEARCHED)
    if column.is_empty:
        return frame, []
    chosen = column.present
    if chosen.all():
        return frame, chosen_notes(frame)
    count = frame.count_runs(chosen)
    verb = "is" if count == 1 else "are"
    told = f"{plural(count, 'run')} that a search chose by results ({_methods(frame)}) {verb} left out"
    return frame.select(~chosen), [told]


def _methods(frame: Frame) -> str:
    column = frame.column(SEARCHED)
    return ", ".join(
        sorted({str(column.values[code]) for code in set(column.codes[column.present].tolist())})
    )


def _first(told: Sequence[str]) -> list[str]:
    """Return the first of some words, and how many more there are."""
    more = len(told) - _MOST_NAMES
    return [*told[:_MOST_NAMES], *([f"{more} more"] if more > 0 else [])]


def _findings(frame: Frame) -> tuple[list[list[str]], Indices]:
    """Return the codes that rows may have, and which of these each has, -1 for none."""
    column = frame.column(FINDINGS)
    if column.kind.is_numeric:
        return [], np.full(len(frame), -1, dtype=np.intp)
    words = [
        [str(one) for one in value] if isinstance(value, list) else [str(value)] for value in column.values
    ]
    return words, column.codes.astype(np.intp)


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
    return status.among(words)


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
    ids = frame.column("id").floats()[unranked]
    codes = status.codes[unranked]
    each = np.unique(np.stack([ids, codes]), axis=1, return_index=True)[1]  # a run once, however measured
    words = [f"{count} {word}" for word, count in tally(status.values, codes[each]).items()]
    return [f"{', '.join(words)}: no rank, as the algorithm is not to blame"]


class Copies:
    """Finder of runs that repeat the result of an earlier one of their group: a result counts once.

    Equal trajectories are one result. So are equal failures of one setting without a trajectory, where the
    program is deterministic as far as the group shows: trajectories came again, and no setting ended in two
    ways. Else repetitions that failed would outweigh those that were tracked.

    Args:
        frame: the rows.
        outcomes: which runs enter the figures.
    """

    def __init__(self, frame: Frame, outcomes: Outcomes) -> None:
        self._frame = frame
        self._counted = counting(frame, outcomes)
        self._judged = self._counted | failing(frame, outcomes)
        tracks = frame.column("trajectory.sha256")
        self._tracks = np.full(len(frame), -1) if tracks.kind.is_numeric else tracks.codes

    @cached_property
    def _settings(self) -> Indices:
        # Only who was measured has a version of the evaluation: by it, no setting would end in two ways.
        facets = [name for name in FACETS if name != "evaluationVersion"]
        return Groups(self._frame, [*facets, *varying(self._frame)]).of_row

    def among(self, of_row: Indices, of_wider: Indices | None = None) -> Mask:
        """Tell which rows are such copies, (n,).

        Args:
            of_row: the group of each row, (n,).
            of_wider: groups that may show more of the program, (n,); default: the same.
        """
        wider = of_row if of_wider is None else of_wider
        found: Mask = np.zeros(len(of_row), dtype=bool)
        known = np.flatnonzero(self._judged & (self._tracks >= 0))
        tracks = self._tracks[known]
        known = known[np.bincount(tracks)[tracks] > 1]
        found[known] = again(of_row[known], self._tracks[known], self._counted[known])
        if not found.any():
            return found
        # Failures without a trajectory, in groups in which trajectories came again.
        lacking = self._judged & (self._tracks < 0) & ~self._counted
        rows = np.flatnonzero(self._judged & np.isin(wider, np.intersect1d(wider[found], wider[lacking])))
        ends = np.where(self._tracks < 0, -1 - self._frame.column("status").codes, self._tracks)[rows]
        if len(rows):
            settings = self._settings[rows]
            unlike = again(wider[rows], settings) & ~again(wider[rows], settings, ends)
            steady = ~np.isin(wider[rows], wider[rows][unlike])
            found[rows] |= steady & lacking[rows] & again(of_row[rows], settings, ends)
        return found


def where_equal(frame: Frame, name: str, value: Any) -> Mask:
    """Tell which rows have a value in a column of texts, (n,)."""
    return frame.column(name).among((value,))


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
    example = groups.firsts[groups.of_row]
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
    return varies(frame, name) if name == "evaluation" else frame.column(name).distinct() > 1


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
    first = groups.firsts
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
    if column.is_coded and not (column.held != column.held[0]).any():
        return False
    return any(differing(column, example, rows).any() for rows in FIRST_THEN_ALL)


def differing(column: Column, example: Indices, rows: slice) -> Mask:
    """Tell which of some rows have another value than an example of each, (rows,).

    Args:
        column: of all rows.
        example: the place of the row that each is compared with, (n,).
        rows: those that are asked about.
    """
    mine, other = column.held[rows], column.held[example[rows]]
    unlike: Mask = mine != other
    return unlike if column.is_coded else unlike & ~(np.isnan(mine) & np.isnan(other))


def _cells(groups: Groups, metrics: Sequence[str], outcomes: Outcomes) -> Cells:
    """Return the cell of each group: its runs, failures and figures."""
    frame, places = groups.frame, Places(groups.sizes, groups.order)
    status = frame.column("status")
    codes = status.codes.astype(np.intp)
    counted = counting(frame, outcomes)
    once = ~Copies(frame, outcomes).among(groups.of_row)
    results = counted & once if any(map(follows_trajectory, metrics)) else counted
    words, faults = _findings(frame)
    faulty = places.tallies([" ".join(one) for one in words], faults, faults >= 0)
    untracked = counted & ~where_equal(frame, "status", Outcome.TRACKED.value)
    columns = CellColumns(
        frame.select(groups.firsts),
        groups.names,
        places.sizes,
        places.counts(results),
        places.counts(counted & ~results),
        places.tallies(status.values, codes, ~counted),
        places.tallies(status.values, codes, untracked),
        places.numbers(covered(frame), once).summaries(),
        {
            name: _figures(frame, places, name, counted=counted, once=once, outcomes=outcomes)
            for name in metrics
        },
        {
            group: tuple(sorted({code for one in wrong for code in one.split()}))
            for group, wrong in faulty.items()
        },
        places.counts(holds_reader(frame, metrics)) > 0,
        places.counts(falls_behind(frame, metrics)) > 0,
        places.counts(frame.column(SEARCHED).present) > 0,
    )
    return Cells(columns, np.arange(groups.count))


def _figures(
    frame: Frame, places: Places, name: str, *, counted: Mask, once: Mask, outcomes: Outcomes
) -> GroupFigures:
    meant = once if follows_trajectory(name) else np.ones_like(once)
    inside = counted & meant & sound(frame, name, outcomes)
    numbers = places.numbers(frame.column(name).floats(), inside)
    if not is_error(name):
        return GroupFigures(numbers)
    return GroupFigures(numbers, places.counts(worst(frame, name, outcomes) & meant), measure_of(name).sign)


def tally(words: Sequence[str], codes: npt.NDArray[np.int32]) -> dict[str, int]:
    """Return the count of each word, by their codes, the words sorted."""
    counts = np.bincount(codes, minlength=len(words)).tolist()
    return dict(sorted((word, count) for word, count in zip(words, counts, strict=True) if count))


def ranked_errors(numbers: Floats, inside: Mask, failed: Mask) -> Floats:
    """Return the errors of the runs that count, sorted, with those that failed as +inf behind all others."""
    values = numbers[inside & ~np.isnan(numbers)]
    return np.sort(np.concatenate([values, np.full(int(np.count_nonzero(failed)), np.inf)]))
