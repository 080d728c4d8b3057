# SPDX-License-Identifier: Apache-2.0
"""Runs of a search as its decisions see them: whether each failed, and its figure for each objective."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from slamhive.analysis.flattening import DOCUMENTS, OF_RUN, TIMES, Results, columns_of_runs
from slamhive.analysis.frame import Frame
from slamhive.analysis.measures import BESIDE, CAUSAL, CONFIGURATION, figures
from slamhive.analysis.selection import first_rows
from slamhive.engine import RunSeen
from slamhive.model.errors import InputError, suggestion
from slamhive.model.results import Outcome, Phase, Reason
from slamhive.model.search import SearchMethod

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from slamhive.model.evaluation import EvaluationSettings
    from slamhive.model.results import RunRecord
    from slamhive.model.search import Search


def metrics_of(search: Search) -> list[str]:
    """Return the columns that a search decides by: those of its objectives, or of its failing rule."""
    if search.method is SearchMethod.THRESHOLD:
        return [search.failing.metric] if search.failing.metric else []
    return [objective.metric for objective in search.objectives]


def objective_problems(
    search: Search, evaluation: EvaluationSettings, seen: Collection[str] = ()
) -> list[str]:
    """Return a sentence for each figure that a search decides by and that no evaluation yields.

    Args:
        search: what is asked.
        evaluation: the Sweep's, which says how many relative errors there are.
        seen: columns that results of the same algorithms have, such as those of another evaluator.
    """
    known = [*figures(len(evaluation.rpe)), *(one for one in seen if not one.startswith(CONFIGURATION))]
    problems = []
    for number, name in enumerate(metrics_of(search)):
        threshold = search.method is SearchMethod.THRESHOLD
        where = "spec.search.failing.metric" if threshold else f"spec.search.objectives[{number}].metric"
        plain = BESIDE.sub(r"\2", name.removeprefix(CAUSAL))
        if name.startswith(CONFIGURATION):
            problems.append(f"{where}: {name} is a setting of runs, not a figure that they end with")
        elif plain not in known and not name.startswith("metrics."):  # what a program writes has any name
            problems.append(f"{where}: no evaluation yields {name!r}{suggestion(plain, known)}")
    return problems


def runs_seen(records: Mapping[int, RunRecord], search: Search) -> dict[int, RunSeen]:
    """Return finished runs as the decisions of a search see them, by index.

    Args:
        records: the runs by index; of several results of a run the first one counts.
        search: what is asked.

    Raises:
        InputError: an objective has a value that is no number.
    """
    if not records:
        return {}
    indices = list(records)
    frame = records_frame([records[index] for index in indices])
    return dict(zip(indices, rows_seen(frame, search), strict=True))


def rows_seen(frame: Frame, search: Search) -> list[RunSeen]:
    """Return finished runs of a table as the decisions of a search see them, in the order of their ids.

    Args:
        frame: a row a run and evaluation; of several evaluations of a run the first one counts.
        search: what is asked.

    Raises:
        InputError: an objective has a value that is no number.
    """
    runs = frame.select(first_rows(frame))
    metrics = metrics_of(search)
    values = [runs.column(name).tolist() for name in metrics]
    words = [runs.column(name).tolist() for name in ("phase", "reason", "outcome")]
    return [
        _seen(
            phase,
            reason,
            outcome,
            search,
            [_number(one[row], name) for one, name in zip(values, metrics, strict=True)],
        )
        for row, (phase, reason, outcome) in enumerate(zip(*words, strict=True))
    ]


def records_frame(records: Sequence[RunRecord]) -> Frame:
    """Return a table of records, under the names that results have everywhere."""
    fields = {*OF_RUN.values(), *(document for _, document, _ in DOCUMENTS), "evaluations"}
    plain = [record.model_dump(mode="json", by_alias=True) for record in records]
    runs: dict[str, Sequence[Any]] = {"id": range(len(records)), "labels": [one["labels"] for one in plain]}
    special = {
        "point": [record.index for record in records],
        "algorithm": [record.spec["algorithmRef"]["name"] for record in records],
        "dataset": [record.spec["datasetRef"]["name"] for record in records],
        "evaluations": [() for _ in records],
        **{name: [getattr(record, name) for record in records] for name in TIMES},
    }
    for name in sorted(fields - {"id", "labels"}):
        if name in special:
            runs[name] = special[name]
        elif plain and name in plain[0]:
            runs[name] = [one[name] for one in plain]
        elif name in {"sensors", "repetition", "seed"}:
            runs[name] = [record.spec.get(name) for record in records]
    for name in TIMES & runs.keys():
        runs[name] = [getattr(record, name) for record in records]
    results = [(place, result) for place, record in enumerate(records) for result in record.results[:1]]
    return Frame(*columns_of_runs(runs, Results.of(results)))


def _number(value: Any, name: str) -> float | None:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"search: {name} is {value!r} in a run, an objective needs numbers")
    return float(value)


def _seen(
    phase: str, reason: str | None, word: str | None, search: Search, values: Sequence[float | None]
) -> RunSeen:
    if phase != Phase.SUCCEEDED:
        blameless = reason is not None and Reason(reason).is_infrastructure
        return RunSeen(has_failed=not blameless and phase == Phase.FAILED)
    outcome = Outcome(word) if word is not None else None
    if search.method is SearchMethod.THRESHOLD:
        return _seen_for_threshold(search, outcome, values)
    if outcome is not None and outcome is not Outcome.TRACKED:
        return RunSeen(has_failed=True)
    known = [value for value in values if value is not None]
    return RunSeen(values=tuple(known) if len(known) == len(values) else None)


def _seen_for_threshold(search: Search, outcome: Outcome | None, values: Sequence[float | None]) -> RunSeen:
    rule = search.failing
    if rule.metric is None:
        bad = rule.outcome or [one for one in Outcome if one is not Outcome.TRACKED]
        return RunSeen() if outcome is None else RunSeen(has_failed=outcome in bad, values=())
    value, lost = values[0], outcome is not None and outcome.has_lost_track
    if value is None:  # a lost run may have no error
        return RunSeen(has_failed=lost or outcome is Outcome.PARTIAL)
    over = rule.above is not None and value > rule.above
    under = rule.below is not None and value < rule.below
    return RunSeen(has_failed=lost or over or under, values=(value,))
