# SPDX-License-Identifier: Apache-2.0
"""The status of an Evaluation, and notes on runs that could not be measured. Pure.

Such a note stands in an annotation of the run, so that no later operator tries again, by the Evaluation's
name, which is empty for a run's or Sweep's own::

    slamhive.io/not-evaluable: {"NAME": {"of": UID, "settings": HASH, "why": "sentence"}}

It holds for that very Evaluation or Sweep and those settings. Whoever removes it has the run measured again.
"""

from __future__ import annotations

import json
from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.measuring import SETTINGS_KEY
from slamhive.kube.records import NOT_EVALUABLE, problems_noted
from slamhive.kube.routing import may_select
from slamhive.kube.status import condition, holds, phase_of, rmse_of
from slamhive.model.results import Outcome, Phase
from slamhive.model.status import MOST_RESULTS, EvaluationStatus

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from slamhive.kube.api.kinds import Object
    from slamhive.kube.reconciling.evaluation_groups import EvaluationGroup


_MOST_GROUPS = 100
_MOST_NOTES = 16
_SENTENCE_LENGTH = 500
_SHOWN_PROBLEMS = 10


def evaluation_status(
    group: EvaluationGroup, problems: dict[str, str]
) -> tuple[EvaluationStatus, list[Object]]:
    """Return the status, and its conditions.

    Args:
        group: what the Evaluation selects.
        problems: why runs could not be measured, by name.
    """
    measured = [run for run in group.runs if group.has_result(run)]
    done = len(measured) + len(problems) >= group.selected
    sentences = [f"{name}: {problem}" for name, problem in sorted(problems.items())[:_SHOWN_PROBLEMS]]
    if not group.selected:
        word, text = "NoRuns", "no run is selected"
    elif problems:
        word, text = "SomeFailed", "\n".join(sentences)
    else:
        word, text = ("Complete", "") if done else ("Waiting", "runs are not finished or not measured yet")
    complete = bool(group.selected) and done
    status = EvaluationStatus(
        runs=group.selected,
        evaluated=len(measured),
        failed=len(problems),
        summary=_summary(group, measured),
    )
    return status, [condition("Accepted", True, "Accepted"), condition("Complete", complete, word, text)]


def _summary(group: EvaluationGroup, runs: Iterable[Object]) -> Object:
    """Return outcomes, and the ATE of tracked runs by algorithm and dataset."""
    outcomes: dict[str, int] = defaultdict(int)
    errors: dict[tuple[str, str], list[float]] = defaultdict(list)
    counts: dict[tuple[str, str], int] = defaultdict(int)
    for run in runs:
        result = next(item for item in run["status"]["results"] if item["evaluation"] == group.name)
        place = (run["spec"]["algorithmRef"]["name"], run["spec"]["datasetRef"]["name"])
        outcomes[result["outcome"]] += 1
        counts[place] += 1
        error = rmse_of(result)
        if result["outcome"] == Outcome.TRACKED and error is not None:
            errors[place].append(error)
    groups = [
        {"algorithm": algorithm, "dataset": dataset, "runs": counts[algorithm, dataset]}
        | _statistics(errors[algorithm, dataset])
        for algorithm, dataset in sorted(counts)[:_MOST_GROUPS]
    ]
    return {"outcomes": dict(outcomes), "groups": groups}


def _statistics(values: list[float]) -> Object:
    if not values:
        return {"tracked": 0}
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
    ate = {"mean": float(np.mean(values)), "median": float(np.median(values)), "std": spread}
    return {"tracked": len(values), "ate": ate}


def problem_of(group: EvaluationGroup, run: Mapping[str, Any]) -> str | None:
    """Return the reason that a run can't be measured by a group; None when that is not known."""
    if group.has_result(run):
        return None
    if is_full(run, group.name):
        return f"it has results of {MOST_RESULTS} evaluations, the most that are kept of a run"
    found = problems_noted(run).get(group.name or "")
    if not isinstance(found, dict):
        return None
    # Of an Evaluation of the same name that was deleted, or with other settings, the note says nothing.
    same = found.get("of") == group.owner["uid"] and found.get("settings") == group.hash
    return str(found.get("why")) if same else None


def is_missing(group: EvaluationGroup, run: Mapping[str, Any]) -> bool:
    """Tell whether a run is still to be measured by a group."""
    return not group.has_result(run) and problem_of(group, run) is None


def is_owed(run: Object, own: str | None, evaluations: Iterable[Object]) -> bool:
    """Tell whether a run that has ended is still to be measured.

    Args:
        run: the run.
        own: hash of the settings that it is measured by itself; None where it isn't.
        evaluations: Evaluations that may measure it too.
    """
    status = run["status"]
    if phase_of(status) is not Phase.SUCCEEDED or not status.get("trajectory"):
        return False
    results = status.get("results") or ()
    done = {item["evaluation"] for item in results} | problems_noted(run).keys()
    given_up = "" in done or holds(status, "Evaluated") is False
    if own is not None and not given_up and all(item.get(SETTINGS_KEY) != own for item in results):
        return True
    return any(
        may_select(one, run)
        and (name := one["metadata"]["name"]) not in done
        and not one["metadata"].get("deletionTimestamp")
        and holds(one.get("status") or {}, "Accepted") is not False
        and not is_full(run, name)
        for one in evaluations
    )


def is_full(run: Mapping[str, Any], evaluation: str | None) -> bool:
    """Tell whether a run's status has no room for another evaluation's result.

    Args:
        run: the run.
        evaluation: name of the evaluation, whose earlier result is replaced; None: not known.
    """
    names = {result["evaluation"] for result in run["status"].get("results") or ()}
    return len(names) >= MOST_RESULTS and evaluation is not None and evaluation not in names


def with_problem(group: EvaluationGroup, run: Mapping[str, Any], problem: str) -> dict[str, str]:
    """Return the annotation that notes why a run can't be measured by a group."""
    name = group.name or ""
    others = {key: value for key, value in problems_noted(run).items() if key != name}
    # An object's annotations have a limit of their own: of too many Evaluations the earliest notes go.
    kept = dict([*others.items()][1 - _MOST_NOTES :])
    kept[name] = {"of": group.owner["uid"], "settings": group.hash, "why": problem[:_SENTENCE_LENGTH]}
    return {NOT_EVALUABLE: json.dumps(kept, ensure_ascii=False, separators=(",", ":"))}
