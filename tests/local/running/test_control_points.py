# SPDX-License-Identifier: Apache-2.0
"""A run on a dataset with control points: from its manifest to what is printed of it."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.data.making.exporting import export_dataset
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.dataset import Dataset
from slamhive.model.formats import DataFormat
from slamhive.model.loading import load_file
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role
from slamhive.runfiles.ground_truth import DatasetTruths
from slamhive.runfiles.trajectories import Path as Drawn
from slamhive.runfiles.trajectories import drawn
from slamhive_eval import ControlPoints, read_tum

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home

POLE = [0.2, -0.1, 1.4]
"""Position of the surveyed pole in the body, m."""


@pytest.fixture(name="surveyed")
def surveyed_fixture(tiny: Path, tmp_path: Path) -> DatasetEntry:
    """The small recording with the way of a pole, every other second, as its ground truth."""
    folder = tmp_path / "surveyed"
    folder.mkdir()
    source = next(tiny.glob("tiny-*/recording.bag"))
    shutil.copyfile(source, folder / "walk.bag")
    pole = np.eye(4)
    pole[:3, 3] = POLE
    seen = read_tum(source.with_name("groundtruth.txt")).moved(pole)
    every = np.searchsorted(seen.stamps, np.arange(seen.stamps[0] + 0.25, seen.stamps[-1], 2.0))
    rows = zip(seen.stamps[every].tolist(), seen.positions[every].tolist(), strict=True)
    (folder / "points.csv").write_text("".join(f"{t!r},{x!r},{y!r},{z!r}\n" for t, (x, y, z) in rows))
    spec = {
        "recording": {"files": [{"path": "walk.bag"}]},
        "sensors": {"lidar": {"type": "Lidar", "topic": "/points"}},
        "groundTruth": {"file": "points.csv", "format": "ControlPoints", "T_body_frame": pole.tolist()},
    }
    return DatasetEntry(Dataset.model_validate({"metadata": {"name": "surveyed"}, "spec": spec}), folder)


def test_a_run_is_measured_at_the_points(  # noqa: PLR0917 - fixtures
    surveyed: DatasetEntry,
    workshop: Workshop,
    home: Home,
    run_acts: Callable[..., Any],
    run_command: Any,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    workshop.add([surveyed.dataset], surveyed.root)
    _, notes = run_acts(
        ["good"], template={"algorithmRef": {"name": "actor"}, "datasetRef": {"name": "surveyed"}}
    )
    (record,) = notes.records
    (result,) = record.results
    assert (result.outcome, result.coverage, result.evaluation) == ("Tracked", 1.0, "se3")
    assert result.values["points"]["met"] == len(result.values["pointErrors"]) == 5
    assert result.values["ate"]["rmse"] < 1e-5
    monkeypatch.setenv("SLAMHIVE_HOME", str(home.path))
    code, out, err = run_command("results", "show", record.name)
    assert code == 0, err
    printed = " ".join(out.split())
    assert "control points, se3: time" in printed
    assert "drift and jumps between them are not seen" in printed
    assert "moved there by its own orientations" in printed
    code, out, err = run_command("results", "export")
    heads = out.split("\n", 1)[0].split(",")
    assert {"points.count", "points.met", "points.share", "ate.rmse", "ate.max"} <= set(heads)
    assert not [head for head in heads if head.startswith("pointErrors")]
    # What the run's page draws: the points where they were surveyed, with the evaluation's errors.
    known = tmp_path / "other" / "datasets" / "surveyed"
    shutil.copytree(surveyed.root, known)
    (known / "dataset.yaml").write_text(json.dumps(surveyed.dataset.as_json()))
    truth = DatasetTruths(None, tmp_path / "other").find("surveyed")
    assert truth is not None
    path = Drawn(truth.poses, len(truth.poses))
    drawing = drawn(path, result, truth, None, 1000)
    assert drawing["reference"] is None
    assert drawing["points"]["x"].tolist() == truth.poses.positions[:, 0].tolist()
    assert drawing["points"]["error"].tolist() == [one["error"] for one in result.values["pointErrors"]]


@pytest.mark.parametrize("form", ["ControlPoints", "Table"])
def test_an_export_has_the_same_ground_truth(surveyed: DatasetEntry, tmp_path: Path, form: str) -> None:
    if form == "Table":
        body = surveyed.dataset.as_json()
        body["spec"]["groundTruth"] |= {"format": form, "table": {"columns": ["t", "tx", "ty", "tz"]}}
        surveyed = DatasetEntry(Dataset.model_validate(body), surveyed.root)
    found = ground_truth(surveyed)
    assert found is not None
    export_dataset(surveyed, [Role.LIDAR], InputOptions(), DataFormat.MCAP, tmp_path / "out", truth=found)
    (dataset,) = load_file(tmp_path / "out" / "dataset.yaml")
    assert isinstance(dataset, Dataset)
    again = ground_truth(DatasetEntry(dataset, tmp_path / "out"))
    assert again is not None
    assert again.kind == found.kind == ("points" if form == "ControlPoints" else "positions")
    assert isinstance(again.poses, ControlPoints) == (form == "ControlPoints")
    assert again.poses.positions.tolist() == found.poses.positions.tolist()  # type: ignore[union-attr]
    assert again.T_body_frame.tolist() == found.T_body_frame.tolist()
