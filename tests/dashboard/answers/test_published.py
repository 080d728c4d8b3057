# SPDX-License-Identifier: Apache-2.0
"""The original paper's runs: what the API says of them is what the reference and ``slamhive results`` say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

from slamhive.cli import results
from slamhive.dashboard.sources.archived import Workstation

if TYPE_CHECKING:
    from collections.abc import Callable

ICRA = Path(__file__).parents[4] / "shared" / "data" / "icra2023"
DESK = "rgbd-dataset-freiburg2-desk"


@pytest.fixture(scope="session")
def home(paper_home: Callable[..., Path]) -> Path:
    return paper_home("sim3")


@pytest.fixture
async def api(home: Path, open_app: Callable[..., Any]) -> Any:
    source = Workstation(f"sqlite:///{home / 'archive.sqlite'}", home)
    async with open_app(source) as client:
        yield client


async def test_errors_are_those_of_the_reference(api: Any) -> None:
    reference = json.loads((ICRA / "reference.json").read_text())["runs"]
    items = {item["run"]: item for item in (await api.get("/runs?limit=1000"))["items"]}
    assert len(items) == len(reference) == 81
    for run in reference:
        item = items[run["id"]]
        assert item["ate.rmse"] == pytest.approx(run["ate_sim3"]["rmse"], rel=1e-9)
        assert item["usage.memory.peakBytes"] / 2**20 == run["memory_max_mib"]
        assert item["coverage"] == pytest.approx(run["coverage"], abs=1e-3)


async def test_a_lost_run_is_drawn_over_all_of_the_ground_truth(api: Any) -> None:
    uid = (await api.get("/runs?where=run == 63&columns=uid"))["items"][0]["uid"]
    drawn = await api.get(f"/runs/{uid}/trajectory")
    lengths = [drawn[part]["t"][-1] - drawn[part]["t"][0] for part in ("estimate", "reference")]
    assert lengths[0] < 0.6 * lengths[1]


@pytest.mark.parametrize("outcomes", ["tracked", "all"])
async def test_groups_are_the_lines_of_slamhive_results(api: Any, home: Path, outcomes: str) -> None:
    metrics = ["ate.rmse", "usage.cpu.meanCores", "usage.memory.peakBytes"]
    words = ["table", "--rows", "parameters.nFeatures", "--outcomes", outcomes, "--format", "json"]
    words += [word for name in metrics for word in ("-m", name)]
    environment = {"SLAMHIVE_HOME": str(home), "SLAMHIVE_ARCHIVE": ""}
    expected = json.loads(CliRunner().invoke(results.app, words, env=environment).stdout)
    query = f"by=parameters.nFeatures&metrics={','.join(metrics)}&outcomes={outcomes}"
    groups = (await api.get(f"/analysis/aggregate?{query}"))["groups"]
    assert len(groups) == len(expected)
    for group, line in zip(groups, expected, strict=True):
        assert group["keys"] == {name: line[name] for name in group["keys"]}
        assert (group["runs"], group["n"], group["failures"]) == (
            line["runs"],
            line["n"],
            line["failures.by"],
        )
        for name in metrics:
            for part in ("n", "mean", "std", "median", "min", "max"):
                assert group["figures"][name][part] == line[f"{name}.{part}"]


async def test_table_four_of_the_paper(api: Any) -> None:
    rows = json.loads((ICRA / "paper_tables.json").read_text())["table_IV"]
    where = f"dataset == '{DESK}' and run not in (124, 139, 140)"
    query = f"where={where}&by=parameters.nFeatures&metrics=ate.rmse,usage.cpu.meanCores&outcomes=all"
    groups = (await api.get(f"/analysis/aggregate?{query}"))["groups"]
    figures = {group["keys"]["parameters.nFeatures"]: group["figures"] for group in groups}
    for row in rows:
        found = figures[row["nFeatures"]]
        assert found["ate.rmse"]["n"] == len(row["runs"])
        assert found["ate.rmse"]["mean"] * 100 == pytest.approx(row["recomputed"][0], rel=1e-9)
        assert found["usage.cpu.meanCores"]["mean"] == pytest.approx(row["recomputed"][2], rel=1e-9)


async def test_what_the_tables_hid_is_seen(api: Any) -> None:
    board = (await api.get("/analysis/leaderboard?sensors=stereo&algorithm=orb-slam3&algorithm=orb-slam2"))[
        "boards"
    ][0]
    entries = {entry["keys"]["algorithm"]: entry for entry in board["entries"]}
    hidden = next(s for s in entries["orb-slam3"]["datasets"] if s["dataset"] == "mh-03-medium")
    assert (hidden["runs"], hidden["n"], hidden["failures"], hidden["medianFailed"]) == (
        2,
        0,
        {"Partial": 2},
        True,
    )
    (item,) = (await api.get("/runs?run=63&columns=ate.rmse,coverage,outcome"))["items"]
    assert item["outcome"] == "Lost"
    assert item["coverage"] < 0.5


async def test_the_calibration_of_the_depth_camera_is_suspect(api: Any) -> None:
    suspects = (await api.get("/analysis/suspects"))["items"]
    assert {(item["keys"].get("dataset"), item["keys"]["sensors"]) for item in suspects} >= {(DESK, "rgbd")}
    assert {item["keys"]["sensors"] for item in suspects} == {"rgbd", "stereo", "stereo-inertial"}


async def test_paths_are_drawn_with_the_errors_of_the_evaluation(api: Any) -> None:
    (item,) = (await api.get("/runs?run=103"))["items"]
    drawn = await api.get(f"/runs/{item['uid']}/trajectory")
    assert drawn["notes"] == []
    errors = [error for error in drawn["estimate"]["error"] if error is not None]
    mean_square = sum(error**2 for error in errors) / len(errors)
    assert mean_square**0.5 == pytest.approx(item["ate.rmse"], rel=1e-9)
    usage = await api.get(f"/runs/{item['uid']}/usage")
    assert usage["samples"] == len(usage["t"])


async def test_over_common_support_a_run_that_broke_off_gains_nothing(api: Any) -> None:
    """Run 063 saw 47 % of its recording; there its error is what it was, and that of the others is theirs."""
    (item,) = (await api.get("/runs?run=63"))["items"]
    (group,) = (await api.get(f"/analysis/common?dataset={item['dataset']}&sensors={item['sensors']}"))[
        "groups"
    ]
    runs = {run["run"]: run for run in group["runs"]}
    assert group["support"]["share"] <= item["coverage"] + 0.02
    assert all(run["problem"] is None for run in runs.values())
    assert runs[63]["common"] == pytest.approx(runs[63]["own"], rel=0.1)
    assert not any("can't be reproduced" in note for note in group["notes"])


async def test_printed_numbers_stand_beside_the_runs_and_not_among_them(api: Any) -> None:
    before = (await api.get(f"/analysis/aggregate?metrics=ate.rmse&by=dataset&dataset={DESK}"))["groups"]
    found = await api.get(f"/analysis/published?dataset={DESK}")
    after = (await api.get(f"/analysis/aggregate?metrics=ate.rmse&by=dataset&dataset={DESK}"))["groups"]
    assert before == after
    assert {item["dataset"] for item in found["items"]} == {DESK}
    first = next(item for item in found["items"] if item["system"].endswith("nFeatures 500"))
    assert first["values"]["ate.rmse"] == pytest.approx(0.00807)
    assert first["where"] == "ICRA 2023, Table IV"
    assert not any("aligned by" in sentence for sentence in found["why"])
