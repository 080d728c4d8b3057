# SPDX-License-Identifier: Apache-2.0
"""A workbench whose algorithms are ROS 1 nodes."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.local.home.catalog import Workshop
from slamhive.local.home.folder import Home
from slamhive.local.running.runner import Job, Runner, Watcher
from slamhive.local.running.workbench import Workbench
from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid
from slamhive.playback.ros import PACKAGES, find_ros

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.results import RunRecord

NODE = Path(__file__).parent / "node.py"
KEYFRAMES = {"topic": "/actor/keyframes", "type": "Path"}
PATIENCE = {"deaf": {"ready": "5s"}, "stubborn": {"end": "1s"}}


@pytest.fixture(scope="session")
def ros() -> None:
    """ROS 1 on this machine."""
    if find_ros() is None:
        pytest.skip(f"no ROS 1 here: apt-get install {' '.join(PACKAGES)}")


def node_spec(act: str, **ros1: Any) -> dict[str, Any]:
    """Return the Algorithm of the node that acts."""
    poses: dict[str, Any] = {"topic": "/actor/poses", "type": "Odometry"}
    if act == "TF":
        poses = {"topic": "/tf", "type": "TF", "parent": "map", "frame": "base"}
    elif act in {"PoseStamped", "PoseWithCovarianceStamped", "Path"}:
        poses["type"] = act
    return {
        "metadata": {"name": f"node-{act.lower()}"},
        "spec": {
            "local": {"adapter": "node.py", "requirements": "requirements.txt"},
            "modes": [{"name": "lidar"}],
            "parameters": {"act": {"type": "String", "default": act}},
            "output": {"frame": "lidar"},
            "paces": ["Realtime"],
            "realtime": {"queue": 1},
            "ros1": {"poses": poses, "keyframes": KEYFRAMES} | PATIENCE.get(act, {}) | ros1,
        },
    }


class Notes(Watcher):
    """A watcher that remembers the records."""

    def __init__(self) -> None:
        self.records: list[RunRecord] = []

    def finished(self, job: Job, record: RunRecord) -> None:
        self.records.append(record)


@pytest.fixture
def notes() -> Notes:
    """A watcher."""
    return Notes()


@pytest.fixture(scope="session")
def play(
    ros: None, tmp_path_factory: pytest.TempPathFactory, environments: Path, tiny: Path
) -> Callable[..., RunRecord]:
    """Runs a node, once, on three seconds of the small recording, at three times their speed."""
    path = tmp_path_factory.mktemp("playing")
    folder = path / "algorithms" / "node"
    folder.mkdir(parents=True)
    (path / "environments").symlink_to(environments)
    (path / "datasets").symlink_to(tiny)
    shutil.copyfile(NODE, folder / "node.py")
    (folder / "requirements.txt").write_text("")
    home = Home.at(path)

    @cache
    def run(act: str) -> RunRecord:
        workshop = Workshop()
        topics = {"lidar": "/elsewhere/points"} if act == "Odometry" else {}  # where node.py looks for them
        algorithm = Algorithm.model_validate(node_spec(act, topics=topics))
        workshop.add([algorithm], folder)
        workshop.add(load_file(tiny / "tiny" / "dataset.yaml"), tiny / "tiny")
        template = {
            "algorithmRef": {"name": algorithm.name},
            "datasetRef": {"name": "tiny"},
            "input": {"duration": "3s", "rate": 3},
            "evaluate": False,
            "retries": 0,
        }
        name = f"play-{act.lower()}"
        sweep = Sweep.model_validate({"metadata": {"name": name}, "spec": {"template": {"spec": template}}})
        with Archive.open(home.archive_url) as archive:
            job, notes = Job(sweep, local_uid(sweep), Plan(sweep, workshop)), Notes()
            Runner(Workbench(home, workshop, archive), notes, parallelism=1).run([job])
        return notes.records[0]

    return run
