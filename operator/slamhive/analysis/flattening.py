# SPDX-License-Identifier: Apache-2.0
"""Columns from records of runs: one row a run and evaluation, under the names the field uses.

The archive's reader and the dashboard's live runs both come through here, so a column that is added here is
there for commands, pages, reports and data frames.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from slamhive.analysis.columns import Column, times
from slamhive.analysis.compact.shapes import MOST_ITEMS, Constant, turned
from slamhive_eval.statistics import STATISTICS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from slamhive.analysis.columns import Indices

    Values = Sequence[Any] | Column
    from slamhive.analysis.compact.shapes import Names
    from slamhive.model.results import Result

    Document = Mapping[str, Any]
    Part = tuple[dict[str, Column], int]

CORE_COLUMNS: tuple[str, ...] = (
    *("run", "sweep", "algorithm", "sensors", "dataset", "repetition", "seed"),
    *("phase", "reason", "message", "attempts", "note", "tags"),
    *("evaluation", "alignment", "outcome", "coverage", "scale"),
    *(f"ate.{name}" for name in STATISTICS),
    *(f"rpe[0].{name}" for name in ("delta", "unit", "pairs", "count", *STATISTICS)),
    *("usage.cpu.meanCores", "usage.cpu.maxCores", "usage.cpu.seconds", "usage.cpu.secondsPerDataSecond"),
    *("usage.memory.peakBytes", "usage.memory.meanBytes", "usage.memory.kind"),
    *("usage.memory.anonymousPeakBytes", "usage.memory.workingSetPeakBytes"),
    *("usage.wallSeconds", "usage.includesReader", "frames.offered", "frames.processed", "frames.dropped"),
    *("input.pace", "input.frameRate", "input.resolution"),
    *("trajectory.poses", "trajectory.durationSeconds", "provenance.node", "provenance.cpuModel"),
    *(f"provenance.machine.{name}" for name in ("cores", "smt", "governor", "turbo", "exclusiveCores")),
    *("name", "uid", "index", "created", "started", "finished", "folder"),
)
"""Columns that every table has, of nothing where nothing is known; others depend on what was run."""

OF_RUN: Mapping[str, str] = {
    "index": "point",
    "sweep.uid": "sweep_uid",
    **{
        name: name
        for name in (
            *("id", "uid", "name", "sweep", "namespace", "cluster", "algorithm", "dataset", "sensors"),
            *("repetition", "seed", "phase", "reason", "message", "attempts", "folder"),
            *("created", "started", "finished", "note", "tags"),
        )
    },
}
"""Columns by the name of what the archive holds of each run."""

DOCUMENTS: tuple[tuple[str, str, str | None], ...] = (
    ("parameters", "spec", "parameters"),
    ("input", "spec", "input"),
    ("input", "provenance", "effective"),
    ("asked", "provenance", "asked"),
    ("prepared", "provenance", "prepared"),
    ("origin", "provenance", "origin"),
    ("resources", "spec", "resources"),
    ("dataset.attributes", "attributes", None),
    ("usage", "usage", None),
    ("frames", "frames", None),
    ("trajectory", "trajectory", None),
    ("provenance", "provenance", None),
    ("label", "labels", None),
    ("metrics", "metrics", None),
)
"""(prefix of the columns, JSON document of the archive, field of it): nested names are joined by dots.

Where two say the same, the later one holds: what took effect stands before what was asked. Last come those
whose names are anybody's choice: they are what MAX_COLUMNS leaves out.
"""

_TOLD_ELSEWHERE = {"provenance": frozenset({"effective", "asked", "prepared", "origin", "subject"})}

TIMES = frozenset({"created", "started", "finished"})

MAX_COLUMNS = 1500
"""Columns that a table has at most; an evaluator that invents a name for each run fills no memory."""

LEFT_OUT = frozenset({"transform", "notes", "pointErrors", "healthLosses", "healthWarnings"})
"""Names of results that are no figures."""

_KEPT = frozenset({"id", "uid", "name", "note", "tags", "evaluation", "outcome", "coverage"})
"""Columns that an evaluator's own names never replace."""

_FIRST = re.compile(r"[^.\[]*")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_EMPTY: dict[str, Any] = {}
_DOCUMENT = {dict, type(None)}
_CONTAINERS = {dict, list}
_NAMES = 4096


@dataclass(frozen=True)
class Spread:
    """Documents of rows as columns or lists of values by joined names.

    Attributes:
        columns: values by name.
        length: number of rows.
    """

    columns: Mapping[str, Values]
    length: int

    @classmethod
    def of(
        cls, documents: Sequence[Any], shapes: Mapping[int, Names], left_out: frozenset[str] = frozenset()
    ) -> Self:
        """Return documents of which the archive holds the values alone, and others as they are.

        Args:
            documents: each a JSON object, a shape's number and values, or None.
            shapes: names of the shapes by number.
            left_out: fields that are passed over.

        Raises:
            MissingShapeError: a shape is not there.
        """
        columns: dict[str, Values] = {}
        divided: Sequence[int] = range(len(documents))
        if set(map(type, documents)) != {list}:
            divided = [place for place, item in enumerate(documents) if type(item) is list]
        if len(divided) < len(documents):
            spread(columns, "", [item if type(item) is dict else None for item in documents], left_out)
        for places, values in turned([documents[place] for place in divided], shapes) if divided else ():
            rows = divided if places is None else [divided[place] for place in places]
            for name, held in values.items():
                if _parted(name)[0] in left_out or (name not in columns and len(columns) >= MAX_COLUMNS):
                    continue
                _spread_values(columns, name, _placed(held, rows, len(documents)))
        return cls(columns, len(documents))

    def below(self, key: str | None, left_out: frozenset[str]) -> Iterator[tuple[str, Values]]:
        """Yield the rest of the names and the values of what is below a field.

        Args:
            key: the field; None for all.
            left_out: fields that are passed over.
        """
        for name, values in self.columns.items():
            first, rest = _parted(name)
            if key is None and first not in left_out:
                yield name, values
            elif key == first and rest:
                yield rest.removeprefix("."), values


def _placed(values: Sequence[Any] | Constant, rows: Sequence[int], length: int) -> Values:
    """Return the values of some rows as those of all: a column, unless there are objects or lists in it."""
    if isinstance(values, Constant):
        if type(values.value) not in _CONTAINERS:
            whole = len(rows) == length
            return Column.repeated(values.value, length, None if whole else np.array(rows, dtype=np.intp))
        values = [values.value] * len(rows)
    found: Sequence[Any] = values
    if len(rows) != length:
        found = [None] * length
        for row, value in zip(rows, values, strict=True):
            found[row] = value
    types = set(map(type, found))
    return found if types & _CONTAINERS or types == {type(None)} else Column.of(found, types)


@lru_cache(_NAMES)
def _parted(name: str) -> tuple[str, str]:
    """Return the first field of a joined name, and the rest."""
    found = _FIRST.match(name)
    end = found.end() if found else len(name)
    return name[:end], name[end:]


class Results(NamedTuple):
    """Results of runs, one a run and evaluation, in any order.

    Attributes:
        runs: the id of each one's run.
        evaluations: their names.
        outcomes: what became of the runs.
        coverages: shares of the ground truth's path.
        values: what the evaluator found, as documents, or as columns of the first of them.
        more: what was found in those that come behind the columns.
    """

    runs: list[int]
    evaluations: list[str]
    outcomes: list[str | None]
    coverages: list[float | None]
    values: list[Any] | Spread
    more: list[Any] = []  # noqa: RUF012 - of a tuple, whose lists are never changed

    @classmethod
    def of(cls, found: Iterable[tuple[int, Result]]) -> Self:
        """Return the results of runs by their ids."""
        pairs = list(found)
        return cls(
            [run for run, _ in pairs],
            [result.evaluation for _, result in pairs],
            [result.outcome.value for _, result in pairs],
            [result.coverage for _, result in pairs],
            [result.values for _, result in pairs],
        )


def columns_of_runs(runs: Mapping[str, Any], results: Results, left_out: frozenset[str] = LEFT_OUT) -> Part:
    """Return the rows of some runs as columns, with their number.

    A run has a row for each of its results, and for each evaluation that it was meant to be measured by and
    was not; one that has neither has a single row. ``run`` is the label ``run`` where there is one (a number
    if it looks like one), else the name.

    Args:
        runs: by the names that the archive has for them, values of each run; JSON documents as objects or
            spread, but for labels and intended evaluations.
        results: of these runs.
        left_out: names of results that make no columns.
    """
    found: dict[str, Values] = {}
    for prefix, document, key in DOCUMENTS:
        held = runs[document]
        if isinstance(held, Spread):
            elsewhere = frozenset() if key else _TOLD_ELSEWHERE.get(document, frozenset())
            for name, values in held.below(key, elsewhere):
                if len(found) < MAX_COLUMNS:
                    _spread_values(found, f"{prefix}.{name}", values)
        else:
            spread(found, prefix, [item and item.get(key) for item in held] if key else _rest(document, held))
    columns = {name: Column.of(values) for name, values in found.items()}
    for name, of_archive in OF_RUN.items():
        if of_archive in runs:
            values = runs[of_archive]
            columns[name] = times(values) if name in TIMES else Column.of(values)
    columns["run"] = columns["name"]
    if any(labels and "run" in labels for labels in runs["labels"]):
        names = columns["name"].tolist()
        columns["run"] = Column.of(
            [_label_of_run(labels, name) for labels, name in zip(runs["labels"], names, strict=True)]
        )
    places = {run: place for place, run in enumerate(runs["id"])}
    complete = _with_intended(runs, results)
    have = np.array([places[run] for run in complete.runs], dtype=np.intp)
    without = np.setdiff1d(np.arange(len(runs["id"])), have)
    return _joined(columns, np.concatenate([have, without]), complete, left_out)


def _list(values: Values) -> Sequence[Any]:
    return values.tolist() if isinstance(values, Column) else values


def _rest(document: str, held: Sequence[Document | None]) -> Sequence[Document | None]:
    """Return documents without the fields that have columns of their own."""
    elsewhere = _TOLD_ELSEWHERE.get(document)
    if elsewhere is None or not any(item and not elsewhere.isdisjoint(item) for item in held):
        return held
    return [item and {key: value for key, value in item.items() if key not in elsewhere} for item in held]


def _with_intended(runs: Mapping[str, Any], results: Results) -> Results:
    """Return results, with an empty one for each intended evaluation that has no result."""
    measured = set(zip(results.runs, results.evaluations, strict=True))
    complete = results._replace(
        runs=list(results.runs),
        evaluations=list(results.evaluations),
        outcomes=list(results.outcomes),
        coverages=list(results.coverages),
        more=list(results.more),
    )
    for run, intended in zip(runs["id"], runs["evaluations"], strict=True):
        for item in intended or ():
            if (run, item["evaluation"]) not in measured:
                complete.runs.append(run)
                complete.evaluations.append(item["evaluation"])
                complete.outcomes.append(None)
                complete.coverages.append(None)
                complete.more.append({name: item.get(name) for name in ("alignment", "settings")})
    return complete


def _joined(columns: dict[str, Column], places: Indices, results: Results, left_out: frozenset[str]) -> Part:
    """Return rows of runs beside those of their results.

    Args:
        columns: of the runs.
        places: the run of each row, (n,): first the rows with results, then those of runs without.
        results: of the first rows.
        left_out: names of results that make no columns.
    """
    padding = [None] * (len(places) - len(results.evaluations))
    below = [Column.missing(len(padding))] if padding else []
    found = _values(results, left_out)
    each_once = np.array_equal(places, np.arange(len(places)))  # nearly always: nothing is to be moved
    joined = columns if each_once else {name: column.take(places) for name, column in columns.items()}
    messages = [item or None for item in _list(found.pop("message", ()))]
    for name, items in found.items():
        if name in _KEPT:
            continue
        column = Column.concatenate([Column.of(items), *below])
        joined[name] = _first(column, joined[name]) if name in joined else column
    if any(messages):
        joined["message"] = _first(joined["message"], Column.of([*messages, *padding]))
    for name, values in (
        ("evaluation", results.evaluations),
        ("outcome", results.outcomes),
        ("coverage", results.coverages),
    ):
        joined[name] = Column.of([*values, *padding])
    if each_once:
        return joined, len(places)
    order = np.argsort(places, kind="stable")
    return {name: column.take(order) for name, column in joined.items()}, len(places)


def _values(results: Results, left_out: frozenset[str]) -> dict[str, Values]:
    """Return the values that evaluators found, by joined names."""
    found: dict[str, Values] = {}
    if not isinstance(results.values, Spread):
        spread(found, "", [*results.values, *results.more], left_out)
        return found
    found.update(results.values.below(None, left_out))
    if results.more:
        added: dict[str, Values] = {}
        spread(added, "", results.more, left_out)
        before, behind = Column.missing(results.values.length), Column.missing(len(results.more))
        for name in dict.fromkeys([*found, *added]):
            parts = [Column.of(found.get(name, before)), Column.of(added.get(name, behind))]
            found[name] = Column.concatenate(parts)
    return found


def _first(column: Column, other: Column) -> Column:
    """Return a column's values, another one's where it has none."""
    if other.is_empty or column.present.all():
        return column
    pairs = zip(column.tolist(), other.tolist(), strict=True)
    return Column.of([second if first is None else first for first, second in pairs])


def stack(parts: list[Part]) -> Part:
    """Return columns one below the other, with their length; takes the parts to pieces to save memory.

    Args:
        parts: columns by name and their length.
    """
    length = sum(count for _, count in parts)
    stacked: dict[str, Column] = {}
    for name in dict.fromkeys(name for columns, _ in parts for name in columns):
        pieces = [columns.pop(name) if name in columns else Column.missing(count) for columns, count in parts]
        stacked[name] = Column.concatenate(pieces)
    return stacked, length


def spread(
    found: dict[str, Any],
    prefix: str,
    documents: Sequence[Document | None],
    left_out: frozenset[str] = LEFT_OUT,
) -> None:
    """Write nested documents, one a row, as lists of values by joined names.

    Args:
        found: gets the lists; a name that is there keeps its values where the new ones are None.
        prefix: put in front of the names.
        documents: JSON objects; None where a row has none.
        left_out: names that are passed over where there is no prefix.
    """
    shapes = set(map(tuple, filter(None, documents)))
    if not shapes:
        return
    if len(shapes) == 1:
        # Nearly always: the documents are turned round without a look-up for each value.
        (names,) = shapes
        nothing = dict.fromkeys(names)
        turned: Iterable[Sequence[Any]] = zip(
            *[(document or nothing).values() for document in documents], strict=True
        )
    else:
        filled = [document or _EMPTY for document in documents]
        names = _commonest(filled, MAX_COLUMNS)
        # One by one: made for all names at once they would be all that the limit below is there to avoid.
        turned = ([document.get(name) for document in filled] for name in names)
    for name, values in zip(names, turned, strict=True):
        if not prefix and name in left_out:
            continue
        if len(found) >= MAX_COLUMNS:
            return
        _spread_values(found, f"{prefix}.{name}" if prefix else name, values)


def _commonest(documents: Sequence[Document], most: int) -> tuple[str, ...]:
    """Return the names in documents, those that most of them have where there are too many."""
    shapes = Counter(tuple(document) for document in documents)
    names = dict.fromkeys(chain(*sorted(shapes)))
    if len(names) > most:
        counts: Counter[str] = Counter()
        for shape, times in shapes.items():
            counts.update(dict.fromkeys(shape, times))
        kept = {name for name, _ in counts.most_common(most)}
        names = {name: None for name in names if name in kept}
    return tuple(names)


def bound(parts: Sequence[Part], known: Iterable[str], most: int) -> list[str]:
    """Leave out the columns that are too many, and return their names.

    Args:
        parts: columns by name and their length.
        known: columns that stay in any case.
        most: others that may stay: those that most rows have.
    """
    names = {name for columns, _ in parts for name in columns}
    if len(names) <= most:
        return []
    counts: Counter[str] = Counter(dict.fromkeys(sorted(names - {*known, *CORE_COLUMNS, *OF_RUN}), 0))
    for columns, _ in parts:
        counts.update({name: int(columns[name].present.sum()) for name in columns if name in counts})
    dropped = [name for name, _ in counts.most_common()[most:]]
    for columns, _ in parts:
        for name in dropped:
            columns.pop(name, None)
    return dropped


def _spread_values(found: dict[str, Any], name: str, values: Values) -> None:
    if isinstance(values, Column):
        earlier = found.get(name)
        found[name] = values if earlier is None else _first(values, Column.of(earlier))
        return
    types = set(map(type, values))
    if types <= _DOCUMENT:
        spread(found, name, values)
        return
    if dict in types:
        spread(found, name, [value if type(value) is dict else None for value in values])
        values = [None if type(value) is dict else value for value in values]
    if list in types:
        values = _spread_lists(found, name, values)
        types = set(map(type, values))
    if types <= {type(None)}:
        return
    earlier = found.get(name)
    if earlier is not None:
        values = [old if new is None else new for old, new in zip(_list(earlier), values, strict=True)]
    found[name] = values


def _spread_lists(found: dict[str, Any], name: str, values: Sequence[Any]) -> list[Any]:
    """Write lists of records item by item; return what is no such list."""
    records = [
        value if type(value) is list and value and all(type(item) is dict for item in value) else ()
        for value in values
    ]
    for number in range(min(max(map(len, records)), MOST_ITEMS)):
        items = [held[number] if number < len(held) else None for held in records]
        spread(found, f"{name}[{number}]", items)
    return [None if held or value == [] else value for held, value in zip(records, values, strict=True)]


def _label_of_run(labels: Mapping[str, str] | None, name: str) -> int | float | str:
    return number_or_text(labels["run"]) if labels and "run" in labels else name


def number_or_text(text: str) -> int | float | str:
    """Return a text that looks like a number as one."""
    if not _NUMBER.fullmatch(text):
        return text
    return int(text) if text.lstrip("+-").isdecimal() else float(text)
