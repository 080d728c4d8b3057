# SPDX-License-Identifier: Apache-2.0
"""Means over repetitions, and that nothing is lost or mixed on the way."""

from __future__ import annotations

import math
import statistics
from typing import Any

import pytest

from slamhive.analysis import Metric, Outcomes, Summary, order_by, table, varying
from slamhive.model.errors import InputError


def row(rmse: float | None = 1.0, outcome: str | None = "Tracked", **changes: Any) -> dict[str, Any]:
    base = {
        "algorithm": "a",
        "sensors": "lidar",
        "dataset": "d",
        "evaluation": "default" if outcome else None,
        "alignment": "se3" if outcome else None,
        "phase": "Succeeded" if outcome else "Failed",
        "outcome": outcome,
        "coverage": 0.9 if outcome else None,
        "ate.rmse": rmse,
    }
    return base | changes


def test_mean_and_sample_deviation_of_tracked_runs() -> None:
    rows = [
        row(1.0),
        row(2.0),
        row(4.0),
        row(100.0, "Lost", coverage=0.3),
        row(None, None, reason="OutOfMemory"),
    ]
    (group,) = table(rows, ["ate.rmse"]).groups
    ate = group.metrics["ate.rmse"]
    assert ate is not None
    assert (ate.n, ate.mean, ate.std) == (3, 7 / 3, pytest.approx(statistics.stdev([1, 2, 4])))
    assert (ate.median, ate.min, ate.max) == (2.0, 1.0, 4.0)
    assert (group.runs, group.n, group.failures) == (5, 3, {"Lost": 1, "OutOfMemory": 1})
    assert group.coverage is not None
    assert (group.coverage.n, group.coverage.min) == (4, 0.3)


def test_a_disturbed_run_says_nothing_of_load_but_all_else_counts() -> None:
    load = {"usage.wallSeconds": 10.0, "usage.cpu.meanCores": 0.9, "usage.cpu.seconds": 9.0}
    rows = [
        row(1.0, **load, **{"usage.contendedSeconds": 0.5}),
        row(1.0, **load | {"usage.cpu.meanCores": 0.3}, **{"usage.contendedSeconds": 6.0}),
        row(1.0, **load | {"usage.cpu.meanCores": 0.4}, **{"usage.throttledSeconds": 2.0}),
    ]
    found = table(rows, ["usage.cpu.meanCores", "usage.cpu.seconds", "ate.rmse"])
    (group,) = found.groups
    assert group.metrics["usage.cpu.meanCores"] == Summary.of([0.9])
    assert group.metrics["usage.cpu.seconds"] == Summary.of([9.0] * 3)
    assert group.metrics["ate.rmse"] == Summary.of([1.0] * 3)
    assert "2 runs shared cores" in found.notes[-1]


def test_all_evaluated_runs_on_request() -> None:
    rows = [row(1.0), row(3.0, "Partial"), row(None, None)]
    (group,) = table(rows, ["ate.rmse"], outcomes=Outcomes.ALL).groups
    assert group.metrics["ate.rmse"] == Summary.of([1.0, 3.0])
    assert (group.runs, group.n, group.failures) == (3, 2, {"Failed": 1, "Partial": 1})


def test_a_group_without_tracked_runs_stays() -> None:
    (group,) = table([row(5.0, "Diverged")], ["ate.rmse"]).groups
    assert (group.n, group.metrics["ate.rmse"], group.failures) == (0, None, {"Diverged": 1})


def test_runs_that_were_not_evaluated_are_said_to_be() -> None:
    (group,) = table([row(1.0), row(None, None, phase="Succeeded")], ["ate.rmse"]).groups
    assert group.failures == {"NotEvaluated": 1}


@pytest.mark.parametrize(
    "facet", ["algorithm", "dataset", "sensors", "alignment", "input.pace", "provenance.cpuModel"]
)
def test_what_must_not_be_mixed_becomes_a_key(facet: str) -> None:
    rows = [row(1.0, **{facet: "x"}), row(2.0, **{facet: "y"})]
    found = table(rows, ["ate.rmse"], by=["parameters.p"])
    assert facet in found.rows
    assert [group.keys[facet] for group in found.groups] == ["x", "y"]


def test_failed_runs_count_under_each_evaluation() -> None:
    rows = [
        row(1.0, evaluation="se3"),
        row(2.0, evaluation="sim3", alignment="sim3"),
        row(None, None, reason="NoTrajectory"),
    ]
    found = table(rows, ["ate.rmse"])
    assert "alignment" not in found.rows
    assert [(g.keys["evaluation"], g.n, g.failures) for g in found.groups] == [
        ("se3", 1, {"NoTrajectory": 1}),
        ("sim3", 1, {"NoTrajectory": 1}),
    ]


def test_default_rows_are_what_varies() -> None:
    rows = [
        row(k, **{"parameters.n": n, "parameters.same": 1, "input.frameRate": 10})
        for n in (500, 1000)
        for k in (1.0, 3.0)
    ]
    rows += [row(9.0, algorithm="b", **{"parameters.other": 5})]
    found = table(rows, ["ate.rmse"])
    assert found.rows == ("algorithm", "sensors", "dataset", "parameters.n")
    means = [group.metrics["ate.rmse"] for group in found.groups]
    assert [summary and summary.mean for summary in means] == [2.0, 2.0, 9.0]
    assert found.notes == ()


def test_pooling_over_parameters_is_said() -> None:
    rows = [row(1.0, **{"parameters.n": 1}), row(2.0, **{"parameters.n": 2})]
    found = table(rows, ["ate.rmse"], by=["dataset"])
    assert len(found.groups) == 1
    assert found.notes == ("averaged over different values of parameters.n",)


def test_a_parameter_that_some_runs_lack_varies() -> None:
    assert varying([row(**{"parameters.a": 1}), row()]) == ["parameters.a"]
    assert varying([row(**{"parameters.a": 1}), row(algorithm="b")]) == []


def test_columns_lie_across() -> None:
    rows = [row(1.0), row(2.0, dataset="e")]
    found = table(rows, ["ate.rmse"], by=["algorithm"], across=["dataset"])
    assert (found.rows, found.columns) == (("algorithm",), ("dataset",))
    assert [group.keys for group in found.groups] == [
        {"algorithm": "a", "dataset": "d"},
        {"algorithm": "a", "dataset": "e"},
    ]


def test_groups_are_sorted_as_numbers() -> None:
    rows = [row(**{"parameters.n": n}) for n in (1000, 500, None, "auto", 250.5)]
    found = table(rows, [], by=["parameters.n"])
    assert [g.keys["parameters.n"] for g in found.groups] == [250.5, 500, 1000, "auto", None]


def test_values_that_are_no_numbers_stay_out_of_means() -> None:
    rows = [row(value) for value in (1.0, math.nan, math.inf, None, True)] + [row("x")]  # type: ignore[arg-type]
    (group,) = table(rows, ["ate.rmse"]).groups
    assert group.metrics["ate.rmse"] == Summary.of([1.0])


def test_no_rows() -> None:
    assert table([], ["ate.rmse"]).groups == []


def test_missing_values_come_last_either_way() -> None:
    items = [{"a": 1}, {"a": None}, {"a": 3}, {"a": 2, "b": 1}]

    def get(item: dict[str, Any], name: str) -> Any:
        return item.get(name)

    assert [i["a"] for i in order_by(items, ["a"], get)] == [1, 2, 3, None]
    assert [i["a"] for i in order_by(items, ["-a"], get)] == [3, 2, 1, None]
    assert [i["a"] for i in order_by(items, ["b", "-a"], get)] == [2, 3, 1, None]


@pytest.mark.parametrize(
    ("text", "value", "shown", "title"),
    [
        ("ate.rmse", 0.012345, "0.01235", "ATE [m]"),
        ("ate.rmse:cm:.3f", 0.012348, "1.235", "ATE [cm]"),
        ("rpe[1].median:mm", 0.012345, "12.35", "rpe[1].median [mm]"),
        ("usage.memory.peakBytes", 3 * 2**20, "3", "peak memory [MiB]"),
        ("usage.memory.peakBytes:GB:.2f", 3e9, "3.00", "peak memory [GB]"),
        ("coverage:%:.1f", 0.5, "50.0", "coverage [%]"),
        ("usage.wallSeconds:min", 90.0, "1.5", "usage.wallSeconds [min]"),
        ("usage.cpu.meanCores:.2f", None, "–", "CPU [cores]"),
    ],
)
def test_metrics_are_shown_in_units(text: str, value: float | None, shown: str, title: str) -> None:
    metric = Metric.parse(text)
    assert metric.show(value) == shown
    assert metric.title == title


@pytest.mark.parametrize("text", ["ate.rmse:kg", "ate.sse:cm", "coverage:m", "ate.rmse:3f", "ate.rmse:.999f"])
def test_units_that_do_not_fit(text: str) -> None:
    with pytest.raises(InputError, match="is neither a unit of"):
        Metric.parse(text)
