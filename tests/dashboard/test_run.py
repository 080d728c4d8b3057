# SPDX-License-Identifier: Apache-2.0
"""One run: what is known of it, its files, its path over the ground truth."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from slamhive.archive import Archive
from slamhive.dashboard.sources import Workstation
from slamhive.model.results import Outcome, Result
from slamhive.model.run import MappingRun
from slamhive_eval import Options, evaluate, read_tum

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.model.results import RunRecord


def write_poses(path: Path, offset: float, count: int = 400) -> None:
    lines = []
    for k in range(count):
        t = k / 10
        x, y, z = math.cos(t / 5) * 5, math.sin(t / 5) * 5, offset * math.sin(t)
        lines.append(f"{t} {x} {y} {z} 0 0 0 1\n")
    path.write_text("".join(lines))


@pytest.fixture
def home(tmp_path: Path, url: str, make_run: Callable[..., RunRecord]) -> Path:
    """A home with the files of one run, whose result is the evaluator's."""
    output = tmp_path / "runs" / "study" / "run-000" / "run" / "output"
    output.mkdir(parents=True)
    write_poses(output / "trajectory.txt", 0.1)
    (tmp_path / "groundtruth").mkdir()
    write_poses(tmp_path / "groundtruth" / "dataset-0.txt", 0.0)
    (output / "usage.csv").write_text(
        "time_seconds,cpu_cores,memory_bytes,anonymous_bytes\n"
        + "".join(f"{k / 10},{k % 2},{k * 100},{k * 50}\n" for k in range(100))
    )
    (output / "leak").symlink_to("/etc/passwd")
    (output / "folder").symlink_to("/etc")
    os.mkfifo(output / "pipe")
    found = evaluate(
        read_tum(tmp_path / "groundtruth" / "dataset-0.txt"), read_tum(output / "trajectory.txt"), Options()
    ).as_dict()
    outcome, coverage = found.pop("outcome"), found.pop("coverage")
    result = Result(evaluation="se3", outcome=Outcome(outcome), coverage=coverage, values=found)
    with Archive.open(url) as archive:
        archive.put_run(make_run(0, folder="/elsewhere/runs/study/run-000", results=[result], log_tail="bye"))
        archive.put_run(make_run(1, folder="/etc/ssh"))
        archive.put_run(make_run(2, folder="../../etc"))
        archive.put_run(make_run(3, folder=str(tmp_path / "runs/study/../../..")))
        archive.put_run(make_run(4))
    return tmp_path


@pytest.fixture
async def api(home: Path, url: str, open_app: Callable[..., Any]) -> Any:
    async with open_app(Workstation(url, home)) as client:
        yield client


async def test_all_that_is_known(api: Any) -> None:
    run = await api.get("/runs/uid-000")
    assert run["configuration"]["parameters"] == {"nFeatures": 500, "loop": True}
    assert run["results"][0]["outcome"] == "Tracked"
    assert run["logTail"] == "bye"
    assert run["files"] is True
    manifest = MappingRun.model_validate(yaml.safe_load(run["manifest"]))
    assert manifest.spec.parameters["nFeatures"] == 500
    download = await api.raw.get("/api/v1/runs/uid-000/manifest")
    assert download.text == run["manifest"]
    assert "run-000.yaml" in download.headers["content-disposition"]


@pytest.mark.parametrize("uid", ["nobody", "%00", "../x", "x" * 3000, "'; DROP TABLE runs; --"])
async def test_unknown_runs_are_404(api: Any, uid: str) -> None:
    answer = await api.raw.get(f"/api/v1/runs/{uid}")
    assert answer.status_code == 404
    assert answer.json()["error"]


async def test_errors_are_those_of_the_evaluation(api: Any) -> None:
    drawn = await api.get("/runs/uid-000/trajectory?points=5000")
    result = (await api.get("/runs/uid-000"))["results"][0]
    errors = np.array(drawn["estimate"]["error"], dtype=float)
    assert drawn["poses"] == drawn["shown"] == len(errors) == 400
    assert math.sqrt((errors**2).mean()) == pytest.approx(result["ate"]["rmse"], rel=1e-9)
    assert drawn["notes"] == []
    assert len(drawn["reference"]["x"]) == 400


async def test_a_thinned_path_keeps_the_worst_pose(api: Any) -> None:
    whole = await api.get("/runs/uid-000/trajectory?points=5000")
    drawn = await api.get("/runs/uid-000/trajectory?points=20")
    assert drawn["shown"] <= 20
    assert max(drawn["estimate"]["error"]) == max(whole["estimate"]["error"])


async def test_unknown_evaluations_are_named(api: Any) -> None:
    answer = await api.get("/runs/uid-000/trajectory?evaluation=sm3", 400)
    assert answer["field"] == "evaluation"


async def test_thinned_usage_keeps_the_peak(api: Any) -> None:
    usage = await api.get("/runs/uid-000/usage?points=10")
    assert usage["samples"] == 100
    assert max(usage["memory"]) == 9900
    assert usage["cpu"] == [0.5] * 10


async def test_only_regular_files_are_listed_and_sent(api: Any) -> None:
    files = (await api.get("/runs/uid-000/files"))["items"]
    assert [item["path"] for item in files] == ["run/output/trajectory.txt", "run/output/usage.csv"]
    answer = await api.raw.get("/api/v1/runs/uid-000/files/run/output/usage.csv")
    assert answer.text.startswith("time_seconds")
    assert answer.headers["content-disposition"].startswith("attachment")


@pytest.mark.parametrize(
    "path",
    [
        "run/output/leak",
        "run/output/folder/passwd",
        "run/output/pipe",
        "run/output",
        "run//output/usage.csv",
        "%2e%2e/%2e%2e/%2e%2e/archive.sqlite",
        "..%2f..%2f..%2farchive.sqlite",
        "run/output/usage.csv%00.txt",
        "%2fetc%2fpasswd",
        "run/output/usage.csv/x",
        "x" * 3000,
    ],
)
async def test_no_path_leads_out(api: Any, path: str) -> None:
    answer = await api.raw.get(f"/api/v1/runs/uid-000/files/{path}")
    assert answer.status_code in {400, 404}
    assert answer.json()["error"]


@pytest.mark.parametrize("number", [1, 2, 3, 4])
async def test_folders_elsewhere_are_not_read(api: Any, number: int) -> None:
    for part in ("files", "trajectory", "usage"):
        answer = await api.get(f"/runs/uid-00{number}/{part}", 404)
        assert "no files" in answer["error"]
    assert (await api.get(f"/runs/uid-00{number}"))["files"] is False


@pytest.mark.parametrize("content", ["", "nothing\n", "1 2\n", "nan nan nan nan nan nan nan nan\n", "\0\0"])
async def test_a_damaged_trajectory_is_a_sentence(api: Any, home: Path, content: str) -> None:
    (home / "runs/study/run-000/run/output/trajectory.txt").write_text(content)
    answer = await api.get("/runs/uid-000/trajectory", 404)
    assert "no pose" in answer["error"]
