# SPDX-License-Identifier: Apache-2.0
"""The status of an Evaluation: how far it is, and figures over its runs. Pure."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.kube.status import condition, rmse_of
from slamhive.model.results import Outcome

if TYPE_CHECKING:
    from collections.abc import Iterable

    from slamhive.kube.reconciling.groups import Group

Object = dict[str, Any]

_MOST_GROUPS = 100
_SHOWN_PROBLEMS = 10


def evaluation_status(group: Group, problems: dict[str, str]) -> Object:
    """Return the status, its conditions under ``fresh``.

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
    return {
        "runs": group.selected,
        "evaluated": len(measured),
        "failed": len(problems),
        "summary": _summary(group, measured),
        "fresh": [condition("Accepted", True, "Accepted"), condition("Complete", complete, word, text)],
    }


def _summary(group: Group, runs: Iterable[Object]) -> Object:
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
