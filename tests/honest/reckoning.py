# SPDX-License-Identifier: Apache-2.0
"""The definition of every number: from the archive's raw rows, in plain Python, to be read from the top.

Nothing of the project is used but the names of the archive's tables, so that no mistake of the project can be
made here too. It is slow, and meant to be: each rule stands here as docs/results.md says it in words.
"""

from __future__ import annotations

import hashlib
import math
import statistics
from collections import Counter, defaultdict
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from sqlalchemy import select

from slamhive.archive import schema
from slamhive.archive.documents import all_raw, opened

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from sqlalchemy import Engine

    Row = dict[str, Any]

INFRASTRUCTURE = {
    *("NodeLost", "SystemFault", "ImagePullFailed", "AlgorithmUnavailable", "DatasetMissing"),
    *("PreparationFailed", "Disrupted"),
}
"""Reasons for which the machine is to blame."""

OF_ITSELF = {
    *("OutOfMemory", "DeadlineExceeded", "AlgorithmFailed", "OutputTooLarge", "NoTrajectory"),
    "InvalidTrajectory",
}
"""Reasons for which the algorithm is to blame: such a run covered nothing, and is worse than any number."""

FACETS = (
    *("algorithm", "sensors", "dataset", "evaluation", "alignment", "settings", "evaluationVersion"),
    *("input.pace", "algorithm.version", "dataset.version"),
)
"""Columns that are never pooled."""

OWNERS = {
    "alignment": "evaluation",
    "settings": "evaluation",
    "evaluationVersion": "evaluation",
    "algorithm.version": "algorithm",
    "dataset.version": "dataset",
}
"""Facets that tell nothing apart where they follow from another column that does."""

FACETS_OF_LOAD = ("provenance.cpuModel", "usage.includesReader")
"""Columns that are never pooled where a figure of load is shown."""

FACETS_OF_MEMORY = ("usage.memory.kind",)
"""Columns that are never pooled where a figure of memory is shown."""

SETTINGS = ("parameters.", "input.", "dataset.attributes.", "resources.")
"""Beginnings of the names of settings."""

ERRORS = ("ate.", "rpe[", "relations.", "ateRotationDeg.")
"""Beginnings of the names of errors."""

DISTURBED = ("usage.cpu.meanCores", "usage.cpu.maxCores", "usage.wallSeconds")
"""Columns that say nothing where a run shared its cores with other work or was throttled."""

ALGORITHM_CHANGED, DATASET_CHANGED, SWEEP_EDITED = "algorithm changed", "dataset changed", "sweep edited"


@dataclass(frozen=True)
class Question:
    """Question to an archive: which runs to choose, how to group them, and which metrics to summarise.

    Attributes:
        sweeps: only runs of these, by name; none for all.
        evaluation: only this one.
        condition: (column, operator, value), the operator one of ``==``, ``!=``, ``<``, ``>=``, ``in``,
            ``is null`` and ``is not null``.
        superseded: whether superseded runs are meant too.
        reused: whether rows of equal content are all meant.
        outcomes: ``tracked`` or ``all``: which rows enter the figures.
        metrics: columns of numbers.
        by: columns to group by; None for algorithm, sensors, dataset and the settings that vary.
        competitors: columns that tell competitors apart.
    """

    sweeps: tuple[str, ...] = ()
    evaluation: str | None = None
    condition: tuple[str, str, Any] | None = None
    superseded: bool = False
    reused: bool = False
    outcomes: str = "tracked"
    metrics: tuple[str, ...] = ("ate.rmse",)
    by: tuple[str, ...] | None = None
    competitors: tuple[str, ...] = ("algorithm", "sensors")


# ---- Rows: one a run and evaluation


def read(engine: Engine) -> dict[str, list[Row]]:
    """Return the archive's rows by table, their documents whole."""
    tables = (schema.sweeps, schema.runs, schema.results)
    with engine.connect() as connection:
        rows = {
            table.name: [
                dict(row) for row in connection.execute(select(*all_raw(connection, table))).mappings()
            ]
            for table in tables
        }
        wrong = opened(connection, *((table, rows[table.name]) for table in tables))
    if any(map(any, wrong)):
        raise ValueError(f"a row that can't be read: {wrong}")
    return rows


def all_rows(tables: dict[str, list[Row]]) -> list[Row]:
    """Return one row a run and evaluation, in the order of storing."""
    results = defaultdict(list)
    for result in tables["results"]:
        results[result["run_id"]].append(result)
    reasons = superseded(tables)
    rows = []
    known = {name for run in tables["runs"] for name, value in run["provenance"].items() if value is not None}
    for run in sorted(tables["runs"], key=lambda run: run["id"]):
        base = _of_run(run, known) | {"superseded": reasons.get(run["id"])}
        measured = {result["evaluation"]: result for result in results[run["id"]]}
        meant = {one["evaluation"]: one for one in run["evaluations"] or []}
        for name in sorted(measured.keys() | meant.keys()) or [None]:
            if name in measured:
                row = base | _of_result(measured[name])
            elif name in meant:
                row = base | {
                    "evaluation": name,
                    "alignment": meant[name].get("alignment"),
                    "settings": meant[name].get("settings"),
                }
            else:
                row = dict(base)
            rows.append(row | {"status": _status(row)})
    return rows


def _of_run(run: Row, known: set[str]) -> Row:
    spec, provenance = run["spec"], run["provenance"]
    row = {
        "id": run["id"],
        "uid": run["uid"],
        "name": run["name"],
        "run": run["name"],
        "sweep": run["sweep"],
        "namespace": run["namespace"],
        "algorithm": run["algorithm"],
        "dataset": run["dataset"],
        "sensors": run["sensors"],
        "repetition": run["repetition"],
        "phase": run["phase"],
        "reason": run["reason"],
        "created": run["created"],
        "algorithm.version": _version(provenance, known, ("algorithmHash", "environment")),
        "dataset.version": _version(provenance, known, ("datasetSha256", "preparation")),
    }
    for name, document in (
        ("parameters", spec.get("parameters")),
        ("input", spec.get("input")),
        ("resources", spec.get("resources")),
        ("dataset.attributes", run["attributes"]),
        ("usage", run["usage"]),
        ("trajectory", run["trajectory"]),
        ("provenance", provenance),
    ):
        row |= flat(name, document or {})
    if row.get("usage.includesReader") is False and row.get("usage.readerCpuSeconds") is None:
        row["usage.includesReader"] = None  # nothing was taken out: whether it is in there isn't known
    return row


def _version(provenance: Row, known: set[str], names: Sequence[str]) -> str | None:
    """Return 8 digits that tell versions apart; None where something isn't known that other runs have."""
    parts = [provenance.get(name) for name in names if name in known]
    if not parts or None in parts:
        return None
    return hashlib.sha256("\0".join(map(str, parts)).encode()).hexdigest()[:8]


def _of_result(result: Row) -> Row:
    row: Row = {"evaluationVersion": 1}  # the first version didn't name itself
    for name, value in result["values"].items():
        row |= flat(name, value)
    return row | {name: result[name] for name in ("evaluation", "outcome", "coverage")}


def flat(name: str, value: Any) -> Row:
    """Return a nested value under names joined by dots, records of a list numbered: ``rpe[0].rmse``."""
    found: Row = {}
    if isinstance(value, dict):
        for key, item in value.items():
            found |= flat(f"{name}.{key}", item)
    elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
        for number, item in enumerate(value):
            found |= flat(f"{name}[{number}]", item)
    else:
        found[name] = value
    return found


def _status(row: Row) -> str:
    if row.get("outcome"):
        return str(row["outcome"])
    if row["phase"] == "Succeeded":
        return "NotEvaluated"
    return str(row["reason"] or row["phase"])


# ---- Superseded runs


def superseded(tables: dict[str, list[Row]]) -> dict[int, str]:
    """Return the reasons for superseded runs, by their id; the others are not there."""
    found = {}
    # Once each: 80,000 runs that are each compared with all others take hours.
    latest = {
        (kind, key): _latest(tables["runs"], kind, key) for kind, keys in _VERSIONS.items() for key in keys
    }
    for run in tables["runs"]:
        for reason, changed in (
            (ALGORITHM_CHANGED, _changed(latest, run, "algorithm")),
            (DATASET_CHANGED, _changed(latest, run, "dataset")),
            (SWEEP_EDITED, _edited(tables, run)),
        ):
            if changed:
                found[run["id"]] = reason
                break
    return found


_VERSIONS = {"algorithm": ("algorithmHash", "environment"), "dataset": ("datasetSha256", "preparation")}
"""Keys of the provenance that say which version of an algorithm or dataset a run had."""


def _latest(runs: Sequence[Row], kind: str, key: str) -> dict[tuple[Any, ...], Row]:
    """Return the latest run of each algorithm or dataset in each place of which a key is known."""
    found: dict[tuple[Any, ...], Row] = {}
    for run in sorted(runs, key=lateness):
        if run["provenance"].get(key) is not None:
            found[_like(run, kind, key)] = run
    return found


def _like(run: Row, kind: str, key: str) -> tuple[Any, ...]:
    """Return a key that versions of the same share: environments and images are none."""
    return (_place(run), run[kind], _from_image(run) if key == "environment" else None)


def _changed(latest: dict[tuple[str, str], dict[tuple[Any, ...], Row]], run: Row, kind: str) -> bool:
    """Tell whether the latest run of an algorithm or dataset in a place has another value of a key."""
    for key in _VERSIONS[kind]:
        mine = run["provenance"].get(key)
        if mine is None or run[kind] is None:
            continue
        if latest[kind, key][_like(run, kind, key)]["provenance"][key] != mine:
            return True
    return False


def _from_image(run: Row) -> bool:
    return run["provenance"].get("imageID") is not None


def _edited(tables: dict[str, list[Row]], run: Row) -> bool:
    """Tell whether a later version of a run's sweep was asked for."""
    mine = next((one for one in tables["sweeps"] if one["uid"] == run["sweep_uid"]), None)
    if mine is None:
        return False
    versions = [
        one for one in tables["sweeps"] if one["name"] == mine["name"] and _place(one) == _place(mine)
    ]
    return max(versions, key=lambda one: (_time(one["created"]), one["uid"])) is not mine


def _place(row: Row) -> tuple[str | None, str | None]:
    return row["cluster"], row["namespace"]


def lateness(run: Row) -> tuple[float, int]:
    """Return a key to order runs from the first to the latest."""
    return _time(run["created"]), run["id"]


def _time(value: Any) -> float:
    return -math.inf if value is None else float(value.timestamp())


# ---- What is chosen


@dataclass
class Chosen:
    """Rows that a question means.

    Attributes:
        rows: in the order of storing.
        superseded: ids of runs left out because they are superseded.
        reused: ids of runs a row of which was left out because its equal stands for it.
    """

    rows: list[Row]
    superseded: set[int] = field(default_factory=set)
    reused: set[int] = field(default_factory=set)


def choose(rows: Iterable[Row], question: Question) -> Chosen:
    """Return the rows that a question means, and what was left out."""
    kept = list(rows)
    if question.sweeps:
        kept = [row for row in kept if row["sweep"] in question.sweeps]
    if question.evaluation is not None:
        kept = [row for row in kept if row.get("evaluation") == question.evaluation]
    if question.condition is not None:
        kept = [row for row in kept if meets(row, question.condition)]
    chosen = Chosen([])
    if not question.superseded:
        chosen.superseded = {row["id"] for row in kept if row["superseded"]}
        kept = [row for row in kept if not row["superseded"]]
    if not question.reused:
        once = _once(kept)
        chosen.reused = {row["id"] for row in kept if not any(row is other for other in once)}
        kept = once
    chosen.rows = kept
    return chosen


def meets(row: Row, condition: tuple[str, str, Any]) -> bool:
    """Tell whether a row meets a condition; a missing value equals nothing and is neither less nor more."""
    column, operator, wanted = condition
    value = row.get(column)
    tests: dict[str, Callable[[], bool]] = {
        "is null": lambda: value is None,
        "is not null": lambda: value is not None,
        "==": lambda: value is not None and value == wanted,
        "!=": lambda: value != wanted,
        "<": lambda: value is not None and value < wanted,
        ">=": lambda: value is not None and value >= wanted,
        "in": lambda: value in wanted,
    }
    return tests[operator]()


def _once(rows: Sequence[Row]) -> list[Row]:
    """Return rows without those of equal content, evaluation and settings as another one that stays.

    One that the latest version of the evaluation measured goes before the others.
    """

    def worth(row: Row) -> tuple[Any, ...]:
        blameless = row["reason"] not in INFRASTRUCTURE and row["phase"] != "Cancelled"
        measured, computed = row.get("outcome") is not None, row.get("provenance.reusedFrom") is None
        return measured, row.get("evaluationVersion") or 0, blameless, computed, *lateness(row)

    def identity(row: Row) -> tuple[Any, ...]:
        return row.get("provenance.contentHash"), row.get("evaluation"), row.get("settings")

    stays: dict[tuple[Any, ...], Row] = {}
    for row in rows:
        key = identity(row)
        stays[key] = max(stays.get(key, row), row, key=worth)
    return [row for row in rows if row.get("provenance.contentHash") is None or stays[identity(row)] is row]


# ---- Groups


def varying(rows: Sequence[Row]) -> list[str]:
    """Return the settings that differ between rows of one algorithm, sensor mode and dataset.

    A setting that only some of them have differs from those that lack it.
    """
    subjects = defaultdict(list)
    for row in rows:
        subjects[row["algorithm"], row["sensors"], row["dataset"]].append(row)
    names = {name for row in rows for name in row if name.startswith(SETTINGS) and row[name] is not None}
    return sorted(
        name
        for name in names - set(FACETS)
        if any(len({_hashable(row.get(name)) for row in inside}) > 1 for inside in subjects.values())
    )


def facets_of(rows: Sequence[Row], asked: Sequence[str], question: Question) -> list[str]:
    """Return the columns that tell rows apart though nobody asked for them."""
    names = [*FACETS]
    if any(metric.startswith("usage.") for metric in question.metrics):
        names += FACETS_OF_LOAD
    if any(metric.startswith("usage.memory.") for metric in question.metrics):
        names += FACETS_OF_MEMORY
    found = []
    for name in names:
        values = {_hashable(row.get(name)) for row in rows}
        if name != "evaluation":
            values -= {None}
        if len(values) > 1 and name not in asked:
            found.append(name)
    return found


def filled(rows: Sequence[Row], asked: Sequence[str], facets: Sequence[str]) -> list[Row]:
    """Return rows with the facets that they lack, where only one value can be meant."""
    exact = [*asked, "evaluation"]
    found = []
    for row in rows:
        given = {}
        for facet in facets:
            if facet == "evaluation" or row.get(facet) is not None:
                continue
            others = [name for name in facets if name not in {*exact, facet}]
            values = {
                _hashable(other[facet])
                for other in rows
                if other.get(facet) is not None
                and all(other.get(name) == row.get(name) for name in exact)
                and all(_agree(other.get(name), row.get(name)) for name in others)
            }
            if len(values) == 1:
                (given[facet],) = values
        found.append(row | given)
    return found


def _agree(one: Any, other: Any) -> bool:
    return one is None or other is None or one == other


def split(rows: Iterable[Row], names: Sequence[str]) -> dict[tuple[Any, ...], list[Row]]:
    """Return rows by their values of some columns."""
    found = defaultdict(list)
    for row in rows:
        found[tuple(_hashable(row.get(name)) for name in names)].append(row)
    return dict(found)


def _hashable(value: Any) -> Any:
    return repr(value) if isinstance(value, list | dict) else value


# ---- Figures of a group


@dataclass(frozen=True)
class Figure:
    """Some numbers in short.

    Attributes:
        n: how many.
        mean, median, min, max: None for no number.
        std: None for less than two numbers.
    """

    n: int
    mean: float | None = None
    std: float | None = None
    median: float | None = None
    min: float | None = None
    max: float | None = None


@dataclass(frozen=True)
class Group:
    """Group of rows that share the values of some columns, with counts and figures over them.

    Attributes:
        keys: the values that they share, by column.
        rows: the rows.
        runs: their number.
        n: number of those that count; where errors are asked for, of different results among them.
        copies: number of those that count and are left out of n.
        failures: those that don't, by status.
        untracked: rows that count and were not tracked, by status.
        deterministic: whether all that count are one result, several times.
        coverage: of those of which it is known.
        figures: by metric.
    """

    keys: Row
    rows: tuple[Row, ...]
    runs: int
    n: int
    copies: int
    failures: dict[str, int]
    untracked: dict[str, int]
    deterministic: bool
    coverage: Figure
    figures: dict[str, Figure]


def groups(rows: Sequence[Row], question: Question) -> list[Group]:
    """Return the groups of the rows chosen."""
    asked = list(question.by or ())
    if question.by is None:
        asked = ["algorithm", "sensors", "dataset", *varying(rows)]
    facets = facets_of(rows, asked, question)
    names = [*facets, *asked]
    parts = split(filled(rows, asked, facets), names)
    return [group_of(inside, dict(zip(names, keys, strict=True)), question) for keys, inside in parts.items()]


def group_of(rows: Sequence[Row], keys: Row, question: Question) -> Group:
    """Return the figures of a group's rows."""
    counting = [row for row in rows if counts(row, question.outcomes)]
    once = distinct(rows, question.outcomes)
    results = [row for row in once if counts(row, question.outcomes)]
    n = len(results) if any(map(is_error, question.metrics)) else len(counting)
    return Group(
        keys=keys,
        rows=tuple(rows),
        runs=len(rows),
        n=n,
        copies=len(counting) - n,
        failures=dict(Counter(row["status"] for row in rows if not counts(row, question.outcomes))),
        untracked=dict(Counter(row["status"] for row in counting if row["status"] != "Tracked")),
        deterministic=n == 1 < len(counting),
        coverage=figure(number for row in once if (number := covered(row)) is not None),
        figures={name: figure_of(results if is_error(name) else counting, name) for name in question.metrics},
    )


def distinct(rows: Sequence[Row], outcomes: str) -> list[Row]:
    """Return the rows of a group without those that repeat the result of an earlier one.

    Equal trajectories are one result. Failures without a trajectory are, where their setting and status are
    equal, if the program is deterministic for all that the group shows.
    """
    judged = [row for row in rows if counts(row, outcomes) or failed(row, outcomes)]
    ends, results = defaultdict(set), {}
    for row in judged:
        ends[setting(row)].add(row.get("trajectory.sha256") or row["status"])
    tracks = [(row["trajectory.sha256"], counts(row, outcomes)) for row in judged if has_track(row)]
    steady = len(set(tracks)) < len(tracks) and all(len(found) == 1 for found in ends.values())
    for row in judged:
        if has_track(row):
            results[id(row)] = (row["trajectory.sha256"], counts(row, outcomes))
        elif steady and not counts(row, outcomes):
            results[id(row)] = (setting(row), row["status"])
    firsts = {result: key for key, result in reversed(results.items())}
    return [row for row in rows if id(row) not in results or firsts[results[id(row)]] == id(row)]


def has_track(row: Row) -> bool:
    """Tell whether a row's trajectory is known."""
    return row.get("trajectory.sha256") is not None


def setting(row: Row) -> tuple[Any, ...]:
    """Return the settings and the measurement of a row, whichever repetition it is.

    The version of the evaluation is that of a result, which not all ends have.
    """
    names = sorted(name for name in row if name.startswith(SETTINGS) and row[name] is not None)
    facets = [_hashable(row.get(name)) for name in FACETS if name != "evaluationVersion"]
    return (*facets, *((name, _hashable(row[name])) for name in names))


def is_error(name: str) -> bool:
    """Tell whether a metric is an error, which follows from the trajectory."""
    return name.startswith(ERRORS)


def counts(row: Row, outcomes: str) -> bool:
    """Tell whether a row enters the figures."""
    return row.get("outcome") is not None if outcomes == "all" else row["status"] == "Tracked"


def failed(row: Row, outcomes: str) -> bool:
    """Tell whether a row that doesn't count failed of itself."""
    return not counts(row, outcomes) and (row.get("outcome") is not None or row["status"] in OF_ITSELF)


def figure_of(counting: Sequence[Row], name: str) -> Figure:
    """Return the figure of a metric over the rows that count."""
    return figure(number for row in counting if (number := number_of(row, name)) is not None)


def number_of(row: Row, name: str) -> float | None:
    """Return a row's number of a metric; None where there is none to be believed."""
    value = row.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return None if name in DISTURBED and is_disturbed(row) else float(value)


def is_disturbed(row: Row) -> bool:
    """Tell whether other work on a run's cores, or throttling, falsified its load."""
    wall = row.get("usage.wallSeconds")
    if wall is None:
        return False
    contended, throttled = row.get("usage.contendedSeconds") or 0, row.get("usage.throttledSeconds") or 0
    return bool(contended > 0.1 * wall or throttled > 0.01 * wall)


def covered(row: Row) -> float | None:
    """Return the share of the ground truth that a row covered; None where nobody knows."""
    if row.get("coverage") is not None:
        return float(row["coverage"])
    return 0.0 if row.get("outcome") is None and row["status"] in OF_ITSELF else None


def figure(values: Iterable[float]) -> Figure:
    """Return numbers in short."""
    numbers = sorted(values)
    if not numbers:
        return Figure(0)
    n = len(numbers)
    mean = math.fsum(numbers) / n
    std = math.sqrt(math.fsum((number - mean) ** 2 for number in numbers) / (n - 1)) if n > 1 else None
    return Figure(n, mean, std, statistics.median(numbers), numbers[0], numbers[-1])


# ---- Ranks


@dataclass
class Standing:
    """A competitor on a dataset.

    Attributes:
        group: its rows.
        median: infinite where it is a failed run; None where nothing can be ranked.
        rank: from 1; None where nothing can be ranked, and for who never succeeded on the board.
        unranked: rows left out of the median, by status.
    """

    group: Group
    median: float | None
    rank: float | None
    unranked: dict[str, int]


@dataclass
class Board:
    """Competitors that can be compared.

    Attributes:
        facets: the values that all rows share.
        standings: by competitor and dataset.
        scores: by competitor, 0 for the best of all.
        ranks: by competitor, in the order of scores, from 1.
    """

    facets: Row
    standings: dict[tuple[tuple[Any, ...], Any], Standing]
    scores: dict[tuple[Any, ...], Fraction]
    ranks: dict[tuple[Any, ...], float]


def boards(rows: Sequence[Row], question: Question) -> list[Board]:
    """Return competitors ranked by the first metric of a question, small is good.

    They are compared where all facets are equal, with those that they share datasets with.
    """
    asked = [*question.competitors, *(["dataset"] if "dataset" not in question.competitors else [])]
    facets = facets_of(rows, asked, question)
    rows = filled(rows, asked, facets)
    told = {*asked, *facets}
    facets = [name for name in facets if OWNERS.get(name) not in told or not _follows(rows, name)]
    if "algorithm" in question.competitors and "algorithm.version" in facets:
        # Versions of an algorithm compete with each other, and with all others.
        facets.remove("algorithm.version")
        question = replace(question, competitors=(*question.competitors, "algorithm.version"))
    found = []
    for keys, inside in split(rows, facets).items():
        for part in _linked(inside, question):
            found.append(_board(part, dict(zip(facets, keys, strict=True)), question))  # noqa: PERF401
    return found


def _follows(rows: Sequence[Row], name: str) -> bool:
    """Tell whether a facet has one value for each value of the column that owns it."""
    return len(split(rows, [OWNERS[name], name])) == len(split(rows, [OWNERS[name]]))


def _linked(rows: Sequence[Row], question: Question) -> list[list[Row]]:
    """Return the rows of competitors that share datasets, if need be by way of others."""
    parts: list[tuple[set[Any], set[Any], list[Row]]] = []
    for row in rows:
        competitor = _competitor(row, question)
        joined = ({competitor}, {row["dataset"]}, [row])
        apart = []
        for part in parts:
            if competitor in part[0] or row["dataset"] in part[1]:
                joined = (joined[0] | part[0], joined[1] | part[1], part[2] + joined[2])
            else:
                apart.append(part)
        parts = [*apart, joined]
    return [part for _, _, part in parts]


def _competitor(row: Row, question: Question) -> tuple[Any, ...]:
    return tuple(_hashable(row.get(name)) for name in question.competitors)


def _board(rows: Sequence[Row], facets: Row, question: Question) -> Board:
    standings = {}
    for (competitor, dataset), inside in _by_standing(rows, question).items():
        keys = dict(zip(question.competitors, competitor, strict=True)) | {"dataset": dataset}
        once = distinct(inside, question.outcomes) if is_error(question.metrics[0]) else inside
        ranked = [rankable(row, question) for row in once]
        numbers = [number for number in ranked if number is not None]
        standings[competitor, dataset] = Standing(
            group=group_of(inside, facets | keys, question),
            median=statistics.median(numbers) if numbers else None,
            rank=None,
            unranked=dict(
                Counter(row["status"] for row, number in zip(once, ranked, strict=True) if number is None)
            ),
        )
    shares = defaultdict(list)
    metric = question.metrics[0]
    succeeded = {who for (who, _), one in standings.items() if one.group.figures[metric].n}
    for (competitor, dataset), standing in standings.items():
        if standing.median is None or competitor not in succeeded:
            continue
        rivals = [
            other.median
            for (rival, there), other in standings.items()
            if there == dataset and rival != competitor and other.median is not None and rival in succeeded
        ]
        better = sum(median < standing.median for median in rivals)
        equal = sum(median == standing.median for median in rivals)
        standing.rank = 1 + better + equal / 2
        shares[competitor].append(Fraction(2 * better + equal, 2 * max(len(rivals), 1)))
    # Exact, as equal scores share a rank.
    scores = {competitor: sum(parts, Fraction()) / len(parts) for competitor, parts in shares.items()}
    return Board(facets, standings, scores, _ranks(scores))


def _by_standing(rows: Sequence[Row], question: Question) -> dict[tuple[Any, Any], list[Row]]:
    found = defaultdict(list)
    for row in rows:
        found[_competitor(row, question), row["dataset"]].append(row)
    return dict(found)


def rankable(row: Row, question: Question) -> float | None:
    """Return the number that a row is ranked by: infinite where it failed, None where it says nothing."""
    metric = question.metrics[0]
    if counts(row, question.outcomes):
        number = number_of(row, metric)
        lost = number is None and row["status"] != "Tracked" and metric.startswith(ERRORS)
        return math.inf if lost else number
    return math.inf if failed(row, question.outcomes) else None


def _ranks(scores: dict[tuple[Any, ...], Fraction]) -> dict[tuple[Any, ...], float]:
    """Return places by score, equal ones the mean of theirs."""
    places = sorted(scores.values())
    return {
        competitor: 1 + places.index(score) + (places.count(score) - 1) / 2
        for competitor, score in scores.items()
    }
