# SPDX-License-Identifier: Apache-2.0
"""Ground truth that different algorithms contradict together, as the page *Suspects* has it."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.archive import Archive
from slamhive.dashboard.sources.archived import Workstation
from slamhive.model.results import Outcome, Result
from slamhive_eval import Options, Trajectory, evaluate, write_tum

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.model.results import RunRecord

SECONDS = 40
WRONG = (15.0, 19.0)


def path(noise: float, seed: int, lifted: float = 0.0) -> Trajectory:
    """Return a spiral with some noise of its own, lifted for a while."""
    t = np.arange(0, SECONDS, 0.1)
    positions = np.column_stack([np.cos(t / 3) * (5 + t / 10), np.sin(t / 3) * 5, np.sin(t / 2)])
    positions += np.random.default_rng(seed).normal(0.0, noise, positions.shape) if noise else 0.0
    positions[(t > WRONG[0]) & (t < WRONG[1]), 2] += lifted
    return Trajectory(t, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))


@pytest.fixture
async def api(
    tmp_path: Path, url: str, make_run: Callable[..., RunRecord], open_app: Callable[..., Any]
) -> Any:
    """Four algorithms on a dataset with a truth that is lifted for a while, and two on another."""
    records = []
    for dataset, algorithms in (("lifted", "abcd"), ("few", "ab")):
        truth = path(0.0, 0, lifted=0.3)
        (tmp_path / "groundtruth").mkdir(exist_ok=True)
        write_tum(tmp_path / "groundtruth" / f"{dataset}.txt", truth)
        for name in algorithms:
            estimate, number = path(0.02, len(records)), len(records)
            folder = f"/runs/study/{dataset}-{name}"
            (tmp_path / folder[1:] / "output").mkdir(parents=True)
            write_tum(tmp_path / folder[1:] / "output" / "trajectory.txt", estimate)
            found = evaluate(truth, estimate, Options()).as_dict()
            outcome, coverage = Outcome(found.pop("outcome")), found.pop("coverage")
            result = Result(evaluation="se3", outcome=outcome, coverage=coverage, values=found)
            spec = {"datasetRef": {"name": dataset}, "algorithmRef": {"name": name}}
            records.append(
                make_run(number, name=f"{dataset}-{name}", spec=spec, folder=folder, results=[result])
            )
    with Archive.open(url) as archive:
        archive.put_runs(records)
    async with open_app(Workstation(url, tmp_path)) as client:
        yield client


async def test_a_stretch_that_all_contradict_is_named_with_figures_without_it(api: Any) -> None:
    answer = await api.get("/analysis/suspects/truth")
    (item,) = answer["items"]
    assert (item["dataset"], item["runs"], item["why"]) == ("lifted", 4, None)
    (stretch,) = item["found"]["stretches"]
    assert (stretch["begin"], stretch["end"]) == (
        pytest.approx(WRONG[0], abs=0.2),
        pytest.approx(WRONG[1], abs=0.2),
    )
    assert stretch["metres"] == pytest.approx(0.3, abs=0.05)
    for system in "abcd":
        assert item["found"]["rmse"][system] > 2 * item["found"]["rmseWithout"][system]
    drawn = np.array(item["found"]["profile"])
    assert drawn[np.argmax(drawn[:, 1]), 0] == pytest.approx(17.0, abs=2.1)
    assert answer["notes"] == [
        "fewer than 3 algorithms tracked on 1 of 2 datasets, which are not compared: two agree by chance"
    ]


async def test_runs_without_files_are_named_and_a_table_has_a_row_for_each_stretch(
    api: Any, tmp_path: Path
) -> None:
    (tmp_path / "runs/study/lifted-d/output/trajectory.txt").unlink()
    (item,) = (await api.get("/analysis/suspects/truth"))["items"]
    assert item["runs"] == 3
    assert item["leftOut"] == ["lifted-d: the run has no trajectory.txt here"]
    answer = await api.raw.get("/api/v1/analysis/suspects/truth?format=csv")
    (row,) = csv.DictReader(io.StringIO(answer.text))
    assert (row["dataset"], float(row["metres"])) == ("lifted", pytest.approx(0.3, abs=0.05))


async def test_too_many_runs_are_left_for_a_question_of_their_own(
    api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamhive.dashboard.answers.truth_suspects.MOST_COMPARED", 3)
    answer = await api.get("/analysis/suspects/truth")
    assert answer["items"] == []
    assert answer["notes"][1] == "at most 3 runs are compared at a time; choose by dataset for lifted"
