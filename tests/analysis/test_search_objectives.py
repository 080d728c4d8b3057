# SPDX-License-Identifier: Apache-2.0
"""Figures that a search may decide by: known before anything runs."""

import pytest

from slamhive.analysis.searches.seen import objective_problems
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.search import Search


def problems(metric: str, *, seen: tuple[str, ...] = (), rpe: int = 1) -> list[str]:
    search = Search.model_validate({"method": "TPE", "trials": 9, "objectives": [{"metric": metric}]})
    evaluation = EvaluationSettings.model_validate({"rpe": [{"delta": one + 1} for one in range(rpe)]})
    return objective_problems(search, evaluation, seen)


@pytest.mark.parametrize(
    "metric",
    [
        *(
            "ate.rmse",
            "rpe[0].mean",
            "coverage",
            "usage.cpu.seconds",
            "metrics.anything",
            "ateRotationDeg.max",
        ),
        *("beside.online.ate.rmse", "relations.translation.mean", "metrics.latencySeconds.p95"),
    ],
)
def test_figures_of_evaluations_usage_and_of_the_program_itself(metric: str) -> None:
    assert problems(metric) == []


@pytest.mark.parametrize(
    ("metric", "sentence"),
    [
        ("ate.rsme", "no evaluation yields 'ate.rsme'; did you mean 'ate.rmse'?"),
        ("rpe[1].rmse", "no evaluation yields 'rpe[1].rmse'; did you mean 'rpe[0].rmse'?"),
        ("usage.cpu.second", "no evaluation yields 'usage.cpu.second'; did you mean 'usage.cpu.seconds'?"),
        ("parameters.maxRange", "parameters.maxRange is a setting of runs, not a figure that they end with"),
    ],
)
def test_what_no_run_ends_with(metric: str, sentence: str) -> None:
    assert problems(metric) == [f"spec.search.objectives[0].metric: {sentence}"]


def test_more_relative_errors_and_figures_of_another_evaluator() -> None:
    assert problems("rpe[1].rmse", rpe=2) == problems("own.drift", seen=("own.drift",)) == []


def test_the_failing_rule_of_a_threshold() -> None:
    rule = {"metric": "ate.rsme", "above": 1}
    search = Search.model_validate({"method": "Threshold", "axis": "input.rate", "failing": rule})
    assert objective_problems(search, EvaluationSettings())[0].startswith(
        "spec.search.failing.metric: no evaluation"
    )
