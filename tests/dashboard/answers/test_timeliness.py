# SPDX-License-Identifier: Apache-2.0
"""Runs of three paces over HTTP: never pooled, causal errors beside final ones, memory of who fell behind."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.dashboard.sources.archived import Workstation
from slamhive.model.results import Outcome, Result, RunRecord

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

ERRORS = {"Lockstep": 0.1, "Realtime": 0.4, "Stepped": 0.2}


def played(make_run: Callable[..., RunRecord], number: int, pace: str) -> RunRecord:
    """Return a run of a pace; in real time a pose was published better later, and its last ones came late."""
    values: dict[str, Any] = {"alignment": "sim3", "scale": 1.25, "ate": {"rmse": ERRORS[pace]}}
    if pace == "Realtime":
        values["beside"] = {"online": {"outcome": "Tracked", "coverage": 0.9, "ate": {"rmse": 0.5}}}
    late = 31.0 if pace == "Realtime" else 0.25
    latencies = {"median": 0.125, "p95": 0.25, "p99": 0.25, "max": late}
    metrics = {"posesPublished": 90, "latencySeconds": latencies, "realTimeFactor": 2.0}
    return make_run(
        number,
        spec={
            "algorithmRef": {"name": "node"},
            "datasetRef": {"name": "hall"},
            "input": {"pace": pace, "rate": 1.0},
        },
        parameters={},
        metrics={} if pace == "Lockstep" else metrics,
        usage={"cpu": {"seconds": 9.0}, "memory": {"peakBytes": 2**27, "kind": "Resident"}},
        results=[Result(evaluation="sim3", outcome=Outcome.TRACKED, coverage=0.95, values=values)],
    )


@pytest.fixture
async def paces(
    tmp_path: Path, make_run: Callable[..., RunRecord], open_app: Callable[..., Any]
) -> AsyncIterator[Any]:
    """The API on five runs of an algorithm on a dataset in each of the three paces."""
    url = f"sqlite:///{tmp_path / 'archive.sqlite'}"
    with Archive.open(url) as archive:
        archive.put_runs([played(make_run, number, pace) for number, pace in enumerate([*ERRORS] * 5)])
    async with open_app(Workstation(url, tmp_path)) as client:
        yield client


async def test_each_pace_has_a_leaderboard_and_what_was_known_when_is_told_beside(paces: Any) -> None:
    answer = await paces.get("/analysis/leaderboard")
    boards = {board["facets"]["input.pace"]: board["entries"][0] for board in answer["boards"]}
    assert {pace: entry["datasets"][0]["median"] for pace, entry in boards.items()} == ERRORS
    timely = answer["timely"]
    assert [metric["title"] for metric in timely["metrics"][:3]] == [
        *("ATE, final [m]", "ATE, causal [m]", "latency p50 [s]")
    ]
    found = {
        group["keys"]["input.pace"]: [
            group["figures"][name]["median"] for name in ("ate.rmse", "beside.online.ate.rmse")
        ]
        for group in timely["groups"]
    }
    assert found == {"Realtime": [0.4, 0.5], "Stepped": [0.2, 0.2]}
    assert "Causal: each pose as it was first published" in timely["words"]


async def test_who_was_never_played_to_is_told_nothing_of_it(paces: Any) -> None:
    answer = await paces.get("/analysis/leaderboard?where=input.pace == 'Lockstep'")
    assert (len(answer["boards"]), answer["timely"]) == (1, None)


@pytest.mark.parametrize(
    ("question", "groups"),
    [
        ("aggregate?by=algorithm&metrics=ate.rmse", lambda answer: answer["groups"]),
        ("pareto?x=usage.cpu.seconds&y=ate.rmse", lambda answer: answer["fronts"]),
        ("repeatability", lambda answer: answer["groups"]),
        ("suspects", lambda answer: answer["items"]),
        ("common", lambda answer: answer["groups"][0]["entries"]),
    ],
)
async def test_no_answer_pools_three_paces(
    paces: Any, question: str, groups: Callable[[Any], list[dict[str, Any]]]
) -> None:
    found = groups(await paces.get(f"/analysis/{question}"))
    keys = [{**group.get("facets", {}), **group.get("keys", {})} for group in found]
    assert sorted(one["input.pace"] for one in keys) == sorted(ERRORS)


async def test_a_chart_of_runs_says_that_paces_are_mixed(paces: Any) -> None:
    answer = await paces.get("/analysis/points?x=ate.rmse&y=beside.online.ate.rmse")
    assert [one["column"] for one in answer["mixed"]] == ["input.pace"]
    assert [answer["axes"][axis]["label"] for axis in "xy"] == ["ATE RMSE, final [m]", "ATE RMSE, causal [m]"]
    told = await paces.get("/analysis/points?x=ate.rmse&y=beside.online.ate.rmse&facet=input.pace")
    assert told["mixed"] == []


async def test_groups_say_whose_memory_holds_frames_that_waited(paces: Any) -> None:
    answer = await paces.get("/analysis/aggregate?metrics=usage.memory.peakBytes")
    late = {group["keys"]["input.pace"]: group["late"] for group in answer["groups"]}
    assert late == {pace: pace == "Realtime" for pace in ERRORS}
    sentence = "poses came up to 31 s late in 5 runs: memory says how far it fell behind, not what it needs"
    assert f"§ {sentence}" in answer["notes"]
    runs = await paces.get("/runs?columns=uid,usage.memory.peakBytes,lateSeconds")
    assert sentence in runs["notes"]
    assert [row["lateSeconds"] for row in runs["items"][:3]] == [None, 31.0, None]
    assert not any("late" in note for note in (await paces.get("/runs?columns=uid,ate.rmse"))["notes"])


@pytest.mark.parametrize(("number", "causal", "late"), [(0, None, False), (1, 0.5, True), (2, 0.2, False)])
async def test_a_run_says_what_was_known_when(
    paces: Any, number: int, causal: float | None, late: bool
) -> None:
    run = await paces.get(f"/runs/uid-{number:03d}")
    (result,) = run["results"]
    online = result.get("beside", {}).get("online")
    assert (online and online["ate"]["rmse"]) == causal
    if causal == 0.2:
        assert (online["outcome"], online["coverage"]) == ("Tracked", 0.95)
    told = "poses came up to 31 s late: memory says how far it fell behind, not what it needs"
    assert (told in run["notes"]) is late


async def test_repetitions_of_a_run_are_those_of_its_pace(paces: Any) -> None:
    answer = await paces.get("/analysis/paths?of=uid-002")
    assert {run["uid"] for group in answer["groups"] for run in group["runs"]} == {
        f"uid-{number:03d}" for number in range(2, 15, 3)
    }
