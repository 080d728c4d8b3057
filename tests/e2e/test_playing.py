# SPDX-License-Identifier: Apache-2.0
"""A Sweep over a ROS node: a player beside it, latency and dropped frames as results."""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING, Any

import pytest
from onnode.documents import ROOT
from onnode.lab import FRAMES, manifest

if TYPE_CHECKING:
    from onnode.lab import Lab

IMAGES = {"kiss-icp-ros": "ros1-player", "kiss-icp-ros2": "ros2-player"}


@pytest.fixture(scope="module", params=IMAGES)
def played(lab: Lab, request: pytest.FixtureRequest) -> list[dict[str, Any]]:
    """Runs of a ROS node that is played to slowly: on a machine that has other work it drops nothing."""
    name = request.param
    built = subprocess.run(
        [ROOT / "images" / "build", IMAGES[name], name],
        capture_output=True,
        text=True,
        check=False,
        timeout=1500,
    )
    if built.returncode:
        pytest.skip(f"the images of ROS can't be built: {built.stderr.strip()[-500:]}")
    for line in built.stdout.splitlines():
        lab.cluster.load(f"docker.io/{line.split()[0]}")
    lab.apply_algorithm(ROOT / "images" / "algorithms" / name)
    spec = lab.run("x", name)["spec"]
    spec |= {"resources": {"cpu": "1", "memory": "512Mi"}, "input": {"pace": "Realtime"}}
    sweep = manifest(
        "Sweep",
        f"played-{name}",
        template={"spec": spec},
        matrix=[{"path": "input.rate", "values": [0.2, 0.4]}],
        parallelism=1,
    )
    lab.apply(sweep)
    status = lab.completed(f"played-{name}", 600)
    found = lab.runs(f"played-{name}")
    assert status["succeeded"] == 2, [run["status"].get("message") for run in found]
    return [run | {"status": lab.evaluated(run["metadata"]["name"])} for run in found]


def test_runs_of_a_ros_node_are_tracked(played: list[dict[str, Any]]) -> None:
    for run in played:
        (result,) = run["status"]["results"]
        assert result["outcome"] == "Tracked", (result, run["status"]["frames"], run["status"]["metrics"])
        assert result["ate"]["rmse"] < 0.5


def test_latency_and_dropped_frames_are_in_the_status(played: list[dict[str, Any]]) -> None:
    for run in played:
        frames, latency = run["status"]["frames"], run["status"]["metrics"]["latencySeconds"]
        assert frames["offered"] == FRAMES
        assert frames["processed"] + frames["dropped"] == FRAMES
        assert 0 < latency["median"] <= latency["max"] < 5


def test_the_pod_ends_with_the_algorithm(lab: Lab, played: list[dict[str, Any]]) -> None:
    sweep = played[0]["metadata"]["labels"]["slamhive.io/sweep"]
    pods = lab.get("pods", "-l", f"slamhive.io/sweep={sweep}")["items"]
    assert len(pods) == len(played)
    for pod in pods:
        assert pod["status"]["phase"] == "Succeeded"
        begun = [one["name"] for one in pod["status"]["initContainerStatuses"]]
        assert begun == ["monitor", "player"]
