# SPDX-License-Identifier: Apache-2.0
"""Analyses over HTTP: shapes, formats, mistakes."""

from __future__ import annotations

import csv
import io
import json
from typing import Any

import pytest

from slamhive.analysis.columns import Column
from slamhive.analysis.frame import Frame
from slamhive.dashboard.answers.analysis import mixtures
from slamhive.dashboard.answers.columns import profile

ANALYSES = (
    "aggregate",
    "leaderboard",
    "compare",
    "pareto?x=usage.cpu.seconds",
    "importance",
    "repeatability",
    "suspects",
    "suspects/nodes",
    "common",
    "versions",
)


def test_mixtures_are_worded_as_a_site_without_a_server_words_them() -> None:
    smt = "provenance.machine.smt"
    [found] = mixtures(Frame({smt: Column.of([True, False, None])}, 3), [])
    assert "(false, true, unknown)" in found["sentence"]


@pytest.mark.parametrize("few", [True, False])
def test_a_large_column_s_ends_and_few_values_are_those_of_all_rows(few: bool) -> None:
    numbers = [float(k % 150 if few else k) for k in range(30_000)]
    numbers[-3:] = [-5.5, 1e6, None]  # type: ignore[list-item]
    found = profile(Frame({"scale": Column.of(numbers)}, len(numbers)), "scale")
    assert (found["min"], found["max"], found["count"]) == (-5.5, 1e6, 29_999)
    assert found["distinct"] == (152 if few else 20_000)


async def test_points_hold_every_run_failed_or_not(api: Any) -> None:
    answer = await api.get("/analysis/points?x=seed&y=ate.rmse&colour=algorithm&facet=parameters.nFeatures")
    axes = answer["axes"]
    assert answer["count"] == len(axes["x"]["values"]) == len(axes["y"]["values"]) == len(answer["uid"]) == 31
    assert axes["y"]["values"][24] is None
    assert answer["status"]["categories"][answer["status"]["codes"][24]] == "OutOfMemory"
    assert axes["y"]["values"][2] == 0.03
    assert axes["colour"]["categories"] == ["algorithm-0", "algorithm-1"]
    assert axes["facet"]["codes"][28] == -1
    assert [item["column"] for item in answer["mixed"]] == ["evaluation", "alignment"]


@pytest.mark.parametrize(
    ("readers", "axis", "told"),
    [
        ([False, True, None], "usage.cpu.seconds", ["usage.includesReader"]),
        ([False, True, None], "ate.rmse", []),
        ([False, False, None], "usage.cpu.seconds", []),  # the last one was ended before it could say so
    ],
)
def test_readers_are_told_of_where_cpu_is_drawn_of_runs_that_have_one(
    readers: list[bool | None], axis: str, told: list[str]
) -> None:
    columns: dict[str, Any] = {
        "usage.includesReader": readers,
        "usage.cpu.seconds": [1.0, 2.0, 3.0],
        "phase": ["Succeeded", "Succeeded", "Failed"],
    }
    frame = Frame({name: Column.of(values) for name, values in columns.items()}, 3)
    assert [item["column"] for item in mixtures(frame, ["seed", axis])] == told


@pytest.mark.parametrize(
    ("kinds", "axis", "told"),
    [
        (["Resident", "Resident", None], "usage.memory.peakBytes", []),
        (["Resident", "Container", None], "usage.memory.peakBytes", ["usage.memory.kind"]),
        (["Resident", "Container", None], "usage.memory.anonymousPeakBytes", []),
    ],
)
def test_memory_of_different_kinds_is_not_mixed_in_silence(
    kinds: list[str | None], axis: str, told: list[str]
) -> None:
    columns = {"usage.memory.kind": kinds, "usage.memory.peakBytes": [1.0, 2.0, None]}
    frame = Frame({name: Column.of(values) for name, values in columns.items()}, 3)
    assert [item["column"] for item in mixtures(frame, ["seed", axis])] == told


@pytest.mark.parametrize(
    ("versions", "told"), [(["1", "2", "2"], []), (["1", "2", "3"], ["algorithm.version"])]
)
def test_two_algorithms_are_no_mixture_of_versions(versions: list[str], told: list[str]) -> None:
    columns = {"algorithm": ["orb", "icp", "icp"], "algorithm.version": versions}
    frame = Frame({name: Column.of(values) for name, values in columns.items()}, 3)
    assert [item["column"] for item in mixtures(frame, ["seed"])] == told


@pytest.mark.parametrize(("digits", "value"), [("3", 0.333), ("6", 0.333333), ("17", 1 / 3)])
async def test_digits_of_points(api: Any, digits: str, value: float) -> None:
    answer = await api.get(
        f"/analysis/points?x=rpe[0].rmse&y=seed&uid=uid-025&digits={digits}&evaluation=se3"
    )
    assert answer["axes"]["x"]["values"] == [value]


async def test_many_points_are_rounded_and_come_without_uids(
    api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.dashboard.answers.analysis.EXACT", 5)
    answer = await api.get("/analysis/points?x=seed&y=rpe[0].rmse")
    assert (answer["digits"], answer["uid"]) == (6, None)
    assert answer["axes"]["y"]["values"][25] == 0.333333
    assert answer["id"][0] == 1


@pytest.mark.parametrize("analysis", ANALYSES)
async def test_every_analysis_is_json_and_a_table(api: Any, analysis: str) -> None:
    answer = await api.get(f"/analysis/{analysis}")
    assert answer["revision"]
    sign = "&" if "?" in analysis else "?"
    table = await api.raw.get(f"/api/v1/analysis/{analysis}{sign}format=csv")
    assert table.status_code == 200
    assert "NaN" not in json.dumps(answer)
    rows = list(csv.reader(io.StringIO(table.text)))
    assert all(len(row) == len(rows[0]) for row in rows)
    assert not {"nan", "inf"} & {cell for row in rows for cell in row}


@pytest.mark.parametrize("analysis", ANALYSES)
async def test_few_runs_or_none_are_no_fault(api: Any, analysis: str) -> None:
    sign = "&" if "?" in analysis else "?"
    for where in ("seed < 0", "seed == 24", "seed == 3", "outcome is null"):
        await api.get(f"/analysis/{analysis}{sign}where={where}")


@pytest.mark.parametrize(
    ("query", "field", "part"),
    [
        ("points?x=ate.rmse", "y", "required"),
        ("points?x=ate.rms&y=coverage", "x", "did you mean"),
        ("points?x=ate.rmse&y=coverage&facet=a,b", "facet", "unknown column"),
        ("points?x=ate.rmse,coverage&y=coverage", "x", "one column"),
        ("points?x=ate.rmse&y=coverage&digits=99", "digits", "17"),
        ("aggregate?by=algoritm", "by", "did you mean"),
        ("aggregate?metrics=algorithm", "metrics", "numbers"),
        ("aggregate?outcomes=some", "outcomes", "known: all, tracked"),
        ("leaderboard?metric=name", "metric", "numbers"),
        ("pareto?x=nothing", "x", "unknown column"),
        ("importance?metric=ate.rmse&where=)", "where", "character 1"),
        ("leaderboard?metrics=ate.rmse", "metrics", "did you mean 'metric'"),
    ],
)
async def test_mistakes_say_where_they_are(api: Any, query: str, field: str, part: str) -> None:
    answer = await api.get(f"/analysis/{query}", 400)
    assert answer["field"] == field
    assert part in answer["error"]


@pytest.mark.parametrize("asked", ["evaluation=se3", "where=evaluation == 'se3'", "alignment=se3"])
async def test_a_filter_of_evaluations_keeps_the_runs_that_failed(api: Any, asked: str) -> None:
    points = await api.get(f"/analysis/points?x=seed&y=ate.rmse&{asked}")
    statuses = [points["status"]["categories"][code] for code in points["status"]["codes"]]
    assert "OutOfMemory" in statuses
    board = await api.get(f"/analysis/leaderboard?{asked}")
    failures = [
        standing["failures"]
        for part in board["boards"]
        for entry in part["entries"]
        for standing in entry["datasets"]
    ]
    assert any(item.get("OutOfMemory") for item in failures)


async def test_an_evaluation_that_is_only_elsewhere_troubles_nobody(api: Any) -> None:
    failed = await api.get("/runs?columns=uid,status&where=status == 'OutOfMemory'")
    names = ",".join(f"'{row['uid']}'" for row in failed["items"])
    await api.get(f"/analysis/leaderboard?where=uid in ({names}, 'uid-025')")
