# SPDX-License-Identifier: Apache-2.0
"""The algorithm of docs/algorithms.md that adds up what wheels measure, from its manifest to its errors."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from slamhive.archive import Archive
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.local.home.catalog import Workshop
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.model.loading import load_file
from slamhive.model.results import Outcome, Phase, RunRecord
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid

from .sweeps import Notes

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.folder import Home

DOCUMENT = Path(__file__).parents[3] / "docs" / "algorithms.md"
SHARED = Path(__file__).parents[4] / "shared" / "data" / "bags"
SWEEP = {"algorithmRef": {"name": "wheels"}, "datasetRef": {"name": "ground"}}


@pytest.fixture
def roll(home: Home, tmp_path: Path) -> Callable[..., tuple[RunRecord, dict[str, Any]]]:
    """Runs the documented algorithm on a dataset; returns the run's record and configuration."""
    folder = tmp_path / "wheels"
    folder.mkdir()
    for language, name, text in re.findall(
        r"```(\w+)\n# wheels/(\S+)\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL
    ):
        assert language in {"yaml", "text", "python"}
        (folder / name).write_text(text)

    def run(spec: dict[str, Any], *changes: tuple[str, str]) -> tuple[RunRecord, dict[str, Any]]:
        for file in folder.iterdir():
            text = file.read_text()
            for before, after in changes:
                text = text.replace(before, after)
            file.write_text(text)
        described = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Dataset", "metadata": {"name": "ground"}}
        (tmp_path / "ground.yaml").write_text(yaml.safe_dump(described | {"spec": spec}))
        workshop = Workshop()
        workshop.add(load_file(folder / "algorithm.yaml"), folder)
        workshop.add(load_file(tmp_path / "ground.yaml"), tmp_path)
        sweep = Sweep.model_validate({"metadata": {"name": "rolling"}, "spec": {"template": {"spec": SWEEP}}})
        notes = Notes()
        with Archive.open(home.archive_url) as archive:
            job = Job(sweep, local_uid(sweep), Plan(sweep, workshop))
            Runner(Workbench(home, workshop, archive), notes, parallelism=1).run([job])
        record = notes.records[0]
        told = Path(record.folder or "") / "run" / "config.yaml"
        return record, yaml.safe_load(told.read_text()) if told.is_file() else {}

    return run


@pytest.mark.parametrize(("noise", "limit"), [(0, 0.02), (1, 0.1)])
def test_wheels_find_their_way(roll: Any, noise: float, limit: float) -> None:
    synthetic = {"sensors": ["Odometry"], "durationSeconds": 12, "loops": 0.25, "motion": 0, "noise": noise}
    record, told = roll({"recording": {"synthetic": synthetic}})
    assert record.phase is Phase.SUCCEEDED, record.message
    result = record.results[0]
    assert result.outcome is Outcome.TRACKED
    assert result.values["ate"]["rmse"] < limit
    assert (result.coverage, record.provenance.prepared.frames) == (pytest.approx(1.0), 601)
    assert list(told["sensors"]) == ["odometry"]
    wheels = told["sensors"]["odometry"]
    assert (wheels["type"], wheels["topic"], wheels["rate"]) == ("Odometry", "/odom", 50.0)
    assert wheels["T_body_sensor"][0][3] == -0.21


def test_a_topic_that_no_sensor_names_is_given_to_one_who_asks(roll: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "ground.bag") as bag:
        for k in range(100):
            at, pose = 10**18 + k * 10**8, np.array([0.1 * k, 0.0, 0.0])
            bag.planar_odometry("/still", at, pose, np.zeros(2))
            bag.planar_odometry("/odom", at, pose, np.array([1.0, 0.0]))
            bag.planar_odometry("/truth", at, pose, np.zeros(2))
    spec = {
        "recording": {"files": [{"path": "ground.bag"}]},
        "sensors": {"odometry": {"type": "Odometry", "topic": "/still"}},
        "groundTruth": {"topic": "/truth"},
    }
    record, _ = roll(
        spec, ("{name: odometry}", "{name: odometry, topics: [/odom]}"), ('odometry["topic"]', '"/odom"')
    )
    assert record.results[0].values["ate"]["rmse"] < 1e-6


def test_wheels_of_a_real_robot(roll: Any, tmp_path: Path) -> None:
    if not SHARED.is_dir():
        pytest.skip(f"needs the data in {SHARED}")
    (tmp_path / "nav2_turtlebot.mcap").symlink_to(SHARED / "nav2_turtlebot.mcap")
    record, _ = roll(
        {
            "recording": {"format": "Mcap", "files": [{"path": "nav2_turtlebot.mcap"}]},
            "sensors": {"odometry": {"type": "Odometry", "topic": "/odom"}},
            "groundTruth": {"topic": "/tf:odom.base_link"},
        }
    )
    assert record.results[0].values["ate"]["rmse"] < 0.2
