# SPDX-License-Identifier: Apache-2.0
"""Workbenches whose algorithms are ROS nodes."""

from __future__ import annotations

import itertools
import json
import shutil
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
from slamhive.playback.ros2 import WHEELS, wheels_fault

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.model.results import RunRecord

HERE = Path(__file__).parent
KEYFRAMES = {"topic": "/actor/keyframes", "type": "Path"}
PATIENCE = {
    "deaf": {"ready": "15s"},  # a busy machine takes 5 s until a node of Python subscribes to anything
    "picture": {"ready": "15s"},
    "latched": {"ready": "15s"},
    "stubborn": {"end": "1s"},
}
TOPICS = {"Odometry": "/elsewhere/points", "PoseStamped": "~/cloud", "Path": "cloud"}
"""Topics on which nodes look for scans, /points else; those of ROS 1 know the first alone."""
EVALUATED = {"wall", "stampless"}
SECTION = {
    "slow": ("actor", "delay"),
    "stranger": ("slam", "delay"),
    "misspelt": ("/**", "delayy"),
    "liberal": ("actor", "delayy"),
}
"""Nodes that the params file of an act is for, and what it sets; the node is actor, and declares delay."""


@pytest.fixture(scope="session")
def ros() -> None:
    """ROS 1 on this machine."""
    if find_ros() is None:
        pytest.skip(f"no ROS 1 here: apt-get install {' '.join(PACKAGES)}")


def node_spec(act: str, version: int) -> dict[str, Any]:
    """Return the Algorithm of the node that acts."""
    poses: dict[str, Any] = {"topic": "/actor/poses", "type": "Odometry"}
    if act == "TF":
        poses = {"topic": "/tf", "type": "TF", "parent": "map", "frame": "base"}
    elif act in {"PoseStamped", "PoseWithCovarianceStamped", "Path"}:
        poses["type"] = act
    elif act == "astray":
        poses["topic"] = "/actor/elsewhere"
    spec: dict[str, Any] = {
        "local": {"adapter": "node.py", "requirements": "requirements.txt"},
        "modes": [{"name": "lidar"}],
        "parameters": {"act": {"type": "String", "default": act}},
        "output": {"frame": "lidar"},
        "paces": ["Realtime", "Stepped"],
        "realtime": {"queue": 1},
    }
    node: dict[str, Any] = {"poses": poses, "keyframes": KEYFRAMES} | PATIENCE.get(act, {})
    if act in TOPICS and (version == 2 or act == "Odometry"):
        node["topics"] = {"lidar": TOPICS[act]}
    if version == 2:
        spec |= {"recording": ["Mcap"]}
        if act not in {"Odometry", "forgetful", "wall"}:
            node["arguments"] = "Ros"
        if act in SECTION:
            text = "{}:\n  ros__parameters:\n    {}: 0.06\n".format(*SECTION[act])
            spec["files"] = [{"path": "node.yaml", "template": text}]
            node["parameters"] = "node.yaml"
    name = f"node{version}-{act.lower()}"
    return {"metadata": {"name": name}, "spec": spec | {f"ros{version}": node}}


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


class Stage:
    """A home in which nodes are played to.

    Args:
        path: its folder, with environments and datasets.
        version: 1 or 2: the ROS of the nodes.
    """

    def __init__(self, path: Path, version: int) -> None:
        self.home = Home.at(path)
        self.version = version
        self._folder = path / "algorithms" / "node"
        self._folder.mkdir(parents=True)
        self._numbers = itertools.count()
        self._known: dict[tuple[str, str], RunRecord] = {}
        if version == 1:
            shutil.copyfile(HERE / "node.py", self._folder / "node.py")
            (self._folder / "requirements.txt").write_text("")
            return
        shutil.copyfile(HERE / "node2.py", self._folder / "node.py")
        shutil.copyfile(HERE / "transforms.py", self._folder / "transforms.py")
        shutil.copyfile(WHEELS, self._folder / "requirements.txt")

    def declare(self, act: str, **node: Any) -> Algorithm:
        """Write the Algorithm of a node where commands find it.

        Args:
            act: what the node does.
            node: what its ros1 or ros2 says besides.
        """
        spec = node_spec(act, self.version)
        spec["spec"][f"ros{self.version}"] |= node
        head = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Algorithm"}
        (self._folder / "algorithm.yaml").write_text(json.dumps(head | spec))
        return Algorithm.model_validate(spec)

    def run(self, act: str, pace: str = "Realtime", *, rate: float = 3.0, count: int = 1) -> list[RunRecord]:
        """Run a node so many times side by side on three seconds of the small recording."""
        workshop = Workshop()
        algorithm = Algorithm.model_validate(node_spec(act, self.version))
        workshop.add([algorithm], self._folder)
        datasets = self.home.path / "datasets" / "tiny"
        workshop.add(load_file(datasets / "dataset.yaml"), datasets)
        template = {
            "algorithmRef": {"name": algorithm.name},
            "datasetRef": {"name": "tiny"},
            "input": {"duration": "3s", "rate": rate, "pace": pace},
            "resources": {"cpu": "100m", "memory": "1Gi"},
            "evaluate": act in EVALUATED,
            "retries": 0,
        }
        name = f"play-{act.lower()}-{pace.lower()}-{count}-{next(self._numbers)}"
        body = {"metadata": {"name": name}, "spec": {"template": {"spec": template}, "repetitions": count}}
        sweep = Sweep.model_validate(body)
        with Archive.open(self.home.archive_url) as archive:
            job, notes = Job(sweep, local_uid(sweep), Plan(sweep, workshop)), Notes()
            Runner(Workbench(self.home, workshop, archive), notes, parallelism=count).run([job])
        return notes.records

    def play(self, act: str, pace: str = "Realtime") -> RunRecord:
        """Run a node once, however often it is asked for."""
        if (act, pace) not in self._known:
            self._known[act, pace] = self.run(act, pace)[0]
        return self._known[act, pace]


def _stage(version: int, path: Path, environments: Path, tiny: Path) -> Stage:
    (path / "environments").symlink_to(environments)
    (path / "datasets").symlink_to(tiny)
    return Stage(path, version)


@pytest.fixture(scope="session")
def stage1(ros: None, tmp_path_factory: pytest.TempPathFactory, environments: Path, tiny: Path) -> Stage:
    """A home of ROS 1 nodes."""
    return _stage(1, tmp_path_factory.mktemp("playing"), environments, tiny)


@pytest.fixture(scope="session")
def stage2(tmp_path_factory: pytest.TempPathFactory, environments: Path, tiny: Path) -> Stage:
    """A home of ROS 2 nodes, which are on the wheels, as their player is."""
    fault = wheels_fault()
    if fault is not None:
        pytest.skip(fault)
    return _stage(2, tmp_path_factory.mktemp("playing"), environments, tiny)


@pytest.fixture(params=[pytest.param(1, marks=pytest.mark.ros), pytest.param(2, marks=pytest.mark.slow)])
def play(request: pytest.FixtureRequest) -> Callable[..., RunRecord]:
    """Runs a node, once: of ROS 1, and of ROS 2."""
    stage: Stage = request.getfixturevalue(f"stage{request.param}")
    return stage.play
