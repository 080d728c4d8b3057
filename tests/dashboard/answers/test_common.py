# SPDX-License-Identifier: Apache-2.0
"""Runs measured again over what they have in common: who stopped before the hard part gains nothing by it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.archive import Archive
from slamhive.dashboard.sources.archived import Workstation
from slamhive.model.results import Outcome, Result
from slamhive_eval import Options, evaluate, read_tum

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.model.results import RunRecord

SECONDS = 40
HALF = 20.0


def write_poses(path: Path, easy: float, hard: float, until: float = SECONDS) -> None:
    """Write a spiral whose error is so large in its first and its second half."""
    lines = []
    for t in np.arange(0, until, 0.1):
        error = (easy if t < HALF else hard) * math.sin(9 * t)
        lines.append(f"{t} {math.cos(t / 3) * (5 + t / 10)} {math.sin(t / 3) * 5} {error} 0 0 0 1\n")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(lines))


PATHS = {
    "whole": {"easy": 0.01, "hard": 0.5},
    "again": {"easy": 0.012, "hard": 0.5},
    "early": {"easy": 0.05, "hard": 0.0, "until": HALF},
}


@pytest.fixture
def home(tmp_path: Path, url: str, make_run: Callable[..., RunRecord]) -> Path:
    """Runs of which the worst on common ground gave up before the hard part, and so has the least error."""
    truth = tmp_path / "groundtruth" / "dataset-0.txt"
    write_poses(truth, 0.0, 0.0)
    records = []
    for number, (name, given) in enumerate(PATHS.items()):
        output = tmp_path / "runs" / "study" / name / "output"
        write_poses(output / "trajectory.txt", **given)
        found = evaluate(read_tum(truth), read_tum(output / "trajectory.txt"), Options()).as_dict()
        outcome, coverage = Outcome(found.pop("outcome")), found.pop("coverage")
        result = Result(evaluation="se3", outcome=outcome, coverage=coverage, values=found)
        spec = {"datasetRef": {"name": "dataset-0"}, "algorithmRef": {"name": "a" if number < 2 else "b"}}
        folder = f"/runs/study/{name}"
        records.append(make_run(number, name=name, spec=spec, folder=folder, results=[result]))
    lost = make_run(9, name="lost", spec={"datasetRef": {"name": "dataset-0"}})
    with Archive.open(url) as archive:
        archive.put_runs([*records, lost])
    return tmp_path


@pytest.fixture
async def api(home: Path, url: str, open_app: Callable[..., Any]) -> Any:
    async with open_app(Workstation(url, home)) as client:
        yield client


async def test_over_common_support_the_order_turns_round(api: Any, home: Path) -> None:
    (group,) = (await api.get("/analysis/common?run!=lost"))["groups"]
    runs = {run["run"]: run for run in group["runs"]}
    assert group["facets"] == {"dataset": "dataset-0", "evaluation": "se3", "alignment": "se3"}
    assert group["support"]["seconds"] == pytest.approx(HALF - 0.1)
    assert 0.3 < group["support"]["share"] < 0.6
    assert runs["early"]["own"] < runs["whole"]["own"]
    assert runs["early"]["common"] == pytest.approx(runs["early"]["own"], rel=1e-9)
    assert runs["whole"]["common"] < runs["early"]["common"] / 3
    best, last = group["entries"]
    assert (best["keys"]["algorithm"], best["rank"], best["ownRank"]) == ("a", 1, 2)
    assert (last["keys"]["algorithm"], last["rank"], last["ownRank"]) == ("b", 2, 1)
    assert best["common"] == pytest.approx((runs["whole"]["common"] + runs["again"]["common"]) / 2)

    # By the evaluator itself, on the poses of that time.
    poses = read_tum(home / "runs" / "study" / "whole" / "output" / "trajectory.txt")
    inside = poses.select(np.flatnonzero(poses.stamps < HALF - 0.01))
    expected = evaluate(read_tum(home / "groundtruth" / "dataset-0.txt"), inside, Options())
    assert expected.ate is not None
    assert runs["whole"]["common"] == pytest.approx(expected.ate.rmse, rel=1e-9)
    assert runs["whole"]["rpe"] == [pytest.approx(expected.rpe[0].statistics.rmse, rel=1e-9)]


async def test_runs_without_poses_have_failed_and_say_why(api: Any) -> None:
    (group,) = (await api.get("/analysis/common"))["groups"]
    lost = next(run for run in group["runs"] if run["run"] == "lost")
    assert lost["common"] is None
    assert lost["problem"] == "the run has no files here"
    entry = next(one for one in group["entries"] if one["keys"]["algorithm"] == "algorithm-1")
    assert (entry["runs"], entry["n"], entry["common"], entry["rank"]) == (1, 0, None, 3)


async def test_only_tracked_runs_if_asked(api: Any) -> None:
    (group,) = (await api.get("/analysis/common?outcomes=tracked&run!=lost"))["groups"]
    runs = {run["run"]: run for run in group["runs"]}
    assert group["support"]["share"] == pytest.approx(1.0, abs=0.01)
    assert runs["whole"]["common"] == pytest.approx(runs["whole"]["own"], rel=1e-9)
    assert runs["early"]["problem"].endswith("only tracked runs count here")


async def test_little_in_common_is_said(api: Any, home: Path) -> None:
    write_poses(home / "runs" / "study" / "early" / "output" / "trajectory.txt", 0.05, 0.0, 5.0)
    (group,) = (await api.get("/analysis/common?run!=lost"))["groups"]
    few, unlike = group["notes"]
    assert "% of the ground truth's path in common; run early alone covers" in few
    assert unlike.startswith("1 of 3 results can't be reproduced here")


async def test_without_ground_truth(api: Any, home: Path) -> None:
    (home / "groundtruth" / "dataset-0.txt").unlink()
    (group,) = (await api.get("/analysis/common"))["groups"]
    assert group["support"] is None
    assert group["notes"] == ["the ground truth of this dataset is not at hand here"]
    assert {run["common"] for run in group["runs"]} == {None}


async def test_a_table_of_it(api: Any) -> None:
    answer = await api.raw.get("/api/v1/analysis/common?run=early&format=csv")
    head, line = answer.text.splitlines()
    assert head.startswith("dataset,evaluation,alignment,uid,run")
    assert line.startswith("dataset-0,se3,se3,uid-002,early")


async def test_too_many_are_refused(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamhive.dashboard.answers.common_support.MOST_RESULTS", 3)
    answer = await api.get("/analysis/common", status=400)
    assert answer["field"] == "where"
    assert answer["error"].startswith("4 results are selected, and at most 3")
