# SPDX-License-Identifier: Apache-2.0
"""A ROS node and its player as two containers of this machine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive import __version__
from slamhive.archive import Archive
from slamhive.local.home.catalog import load_workshop
from slamhive.local.programs.containers import Containers
from slamhive.local.programs.containerwords import HOME_LABEL
from slamhive.local.programs.engines import ContainerChoice
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file
from slamhive.model.results import Phase
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid
from slamhive.playback.protocol import LEAST_SHARED_MEMORY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from slamhive.local.home.folder import Home
    from slamhive.local.programs.engines import Engine
    from slamhive.model.results import RunRecord

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

FRAMES = 100


@pytest.fixture
def play_boxed(home: Home, notes: object, podman: Engine) -> Iterator[Callable[..., list[RunRecord]]]:
    """Runs algorithms in their images, all at once; nothing is left of their containers."""
    workshop = load_workshop(home)
    workshop.add(load_file(home.path / "tiny.yaml"), home.path)

    def run(
        algorithm: Algorithm | str, paces: Sequence[str] = ("Realtime",), **template: Any
    ) -> list[RunRecord]:
        name = algorithm if isinstance(algorithm, str) else algorithm.name
        if isinstance(algorithm, Algorithm):
            workshop.add([algorithm], home.path)
        given = {"algorithmRef": {"name": name}, "datasetRef": {"name": "tiny"}, "timeout": "10m"}
        spec = {
            "template": {"spec": given | template},
            "matrix": [{"path": "input.pace", "values": list(paces)}],
        }
        sweep = Sweep.model_validate({"metadata": {"name": "boxed"}, "spec": spec})
        with Archive.open(home.archive_url) as archive:
            job = Job(sweep, local_uid(sweep), Plan(sweep, workshop))
            bench = Workbench(home, workshop, archive, container=ContainerChoice.PODMAN)
            Runner(bench, notes).run([job])  # type: ignore[arg-type]
            found = [archive.get(job.run_uid(point)) for point in range(len(paces))]
        return [record for record in found if record is not None]

    yield run
    assert podman.labelled(f"{HOME_LABEL}={Containers(home).identity()}") == []


@pytest.mark.parametrize("name", ["kiss-icp-ros", "kiss-icp-ros2"])
def test_a_node_in_its_image_is_played_to_by_the_players(
    play_boxed: Callable[..., list[RunRecord]], name: str
) -> None:
    # At half its speed, so that a busy machine keeps up with some of it.
    (played,) = play_boxed(name, input={"rate": 0.5})
    assert played.phase is Phase.SUCCEEDED, f"{played.message}\n{played.log_tail}"
    frames = played.frames
    assert frames is not None
    # A busy machine drops some, however slowly they come.
    assert frames.offered == FRAMES
    assert (frames.processed or 0) + (frames.dropped or 0) == FRAMES
    assert played.trajectory is not None
    assert 20 < played.trajectory.poses <= (frames.processed or 0)
    assert played.metrics["latencySeconds"]["mean"] > 0
    assert played.provenance.image_id is not None
    assert played.usage is not None
    assert played.usage.source.startswith("cgroup")
    assert played.usage.cpu.total_seconds > 0


SEEING = """
import json
import os
import sys
from pathlib import Path

import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

rclpy.init()
node = rclpy.create_node("seeing")
node.declare_parameter("step", 0.0)
step = node.get_parameter("step").value
poses = node.create_publisher(Odometry, "odometry", 10)
count = 0


def take(cloud):
    global count
    count += 1
    pose = Odometry(header=cloud.header)
    pose.pose.pose.position.x = step * count
    pose.pose.pose.orientation.w = 1.0
    poses.publish(pose)
    if count == 50:
        memory = os.statvfs("/dev/shm")
        seen = dict(os.environ)
        seen["names"] = [name for name, _ in node.get_node_names_and_namespaces()]
        seen["arguments"] = sys.argv[1:]
        seen["user"] = os.getuid()
        seen["room"] = memory.f_blocks * memory.f_frsize
        seen["segments"] = [name for name in os.listdir("/dev/shm") if "port" not in name]
        seen["owners"] = sorted({path.stat().st_uid for path in Path("/dev/shm").iterdir()})
        seen["closed"] = not os.access("/player", os.W_OK)
        Path("/slamhive/output/seen.json").write_text(json.dumps(seen))


node.create_subscription(PointCloud2, "points", take, qos_profile_sensor_data)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
"""A node that keeps up, with the default QoS of sensors, and writes what it sees of the world."""
SEER = {
    # It has rclpy, and no more is needed.
    "image": f"slamhive/ros2-player:{__version__}",
    "command": ["python3", "/slamhive/files/node.py"],
    "modes": [{"name": "lidar"}],
    "output": {"frame": "lidar"},
    "paces": ["Realtime", "Stepped"],
    "realtime": {"queue": 5, "drop": "Oldest"},
    "recording": ["Mcap"],
    "files": [
        {"path": "node.py", "template": SEEING},
        {"path": "node.yaml", "template": "seeing: {ros__parameters: {step: 0.25}}"},
    ],
    "ros2": {
        "poses": {"topic": "/odometry", "type": "Odometry"},
        "topics": {"lidar": "points"},
        "arguments": "Ros",
        "parameters": "node.yaml",
    },
}
OF_A_SHELL = {
    "ROS_DOMAIN_ID": "77",
    "RMW_IMPLEMENTATION": "rmw_none_cpp",
    "FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA",
    "ROS_LOCALHOST_ONLY": "1",
    "ROS_DISCOVERY_SERVER": "192.0.2.1",
}


def test_two_nodes_of_ros_2_at_once_get_all_and_see_nobody_else(
    play_boxed: Callable[..., list[RunRecord]], home: Home, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a domain and a transport of their own, whatever the user's shell says of ROS 2."""
    for name, value in OF_A_SHELL.items():
        monkeypatch.setenv(name, value)
    algorithm = Algorithm.model_validate({"metadata": {"name": "seer"}, "spec": SEER})
    found = play_boxed(algorithm, ("Realtime", "Stepped"), resources={"memory": "128Mi"}, evaluate=False)
    assert len(found) == 2
    for record in found:
        assert record.phase is Phase.SUCCEEDED, f"{record.message}\n{record.log_tail}"
        frames = record.frames
        assert frames is not None
        assert (frames.offered, frames.processed) == (FRAMES, FRAMES)
        seen = json.loads((Path(record.folder or "") / "run" / "output" / "seen.json").read_text())
        assert sorted(seen["names"]) == ["seeing", "slamhive_ears", "slamhive_player"]
        assert seen["arguments"][-2:] == ["--params-file", "/slamhive/files/node.yaml"]
        assert (seen["user"], seen["owners"]) == (65532, [65532])
        assert seen["room"] >= LEAST_SHARED_MEMORY
        assert seen["closed"]
        # One of the player's, one of the node's, beside what finds others.
        assert len(seen["segments"]) >= 2
        assert seen["ROS_DOMAIN_ID"] == "0"
        assert seen["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"
        assert not {"FASTDDS_BUILTIN_TRANSPORTS", "ROS_LOCALHOST_ONLY", "ROS_DISCOVERY_SERVER"} & set(seen)
        poses = (Path(record.folder or "") / "run" / "output" / "trajectory.txt").read_text().splitlines()
        assert float(poses[-1].split()[1]) == 0.25 * FRAMES
