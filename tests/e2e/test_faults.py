# SPDX-License-Identifier: Apache-2.0
"""The operator killed on a node in the middle of a sweep, a sweep deleted in its middle, a run preempted."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import pytest
from onnode.documents import ROOT
from onnode.lab import OPERATOR, RUNS, manifest
from onnode.node import processes
from testcluster.access import until

if TYPE_CHECKING:
    from onnode.lab import Lab

GONE_SECONDS = 240
SLOW, SLOWER = 3, 1.5
"""Frame rates, Hz, that no other test of this installation plays: what prepares them is this test's own."""

HANGING = manifest(
    "Algorithm",
    "hanging",
    version="1",
    image="slamhive/shell-algorithm:1.0.0",
    command=["sleep", "86400"],
    modes=[{"name": "lidar", "roles": ["lidar"]}],
    recording=["Rosbag1"],
    output={"frame": "lidar"},
    paces=["Lockstep"],
)
"""An Algorithm whose runs are at work until somebody ends them."""


@pytest.fixture(autouse=True)
def algorithms(lab: Lab) -> None:
    lab.apply_algorithm(ROOT / "tests" / "images" / "shell-algorithm")
    lab.apply(HANGING)


def test_an_operator_killed_twice_loses_and_doubles_nothing(lab: Lab) -> None:
    speeds = lab.begin("killed", 10, parallelism=3)
    seen: dict[str, str] = {}

    def done(count: int) -> bool:
        runs = lab.runs("killed")
        seen.update({run["metadata"]["name"]: run["metadata"]["uid"] for run in runs})
        return sum((run.get("status") or {}).get("phase") == "Succeeded" for run in runs) >= count

    until(lambda: done(1), "the first run", 240)
    (pod,) = lab.get("pods", *OPERATOR)["items"]
    (process,) = processes(pod["metadata"]["uid"], "slamhive.kube")
    os.kill(process, signal.SIGKILL)
    until(lambda: done(4), "four runs", 240)
    lab.kubectl("delete", "pod", *OPERATOR, "--force", "--grace-period=0")
    runs = lab.end_each_once("killed", speeds)
    assert seen.items() <= {run["metadata"]["name"]: run["metadata"]["uid"] for run in runs}.items()


def left(lab: Lab, sweep: str) -> list[str]:
    """Names of what is left of a Sweep."""
    kinds = f"{RUNS},jobs,pods"
    return [
        f"{item['kind']} {item['metadata']['name']}"
        for item in lab.get(kinds, "-l", f"slamhive.io/sweep={sweep}")["items"]
    ]


def preparations(lab: Lab) -> set[str]:
    return {job["metadata"]["name"] for job in lab.get("jobs", "-l", "slamhive.io/role=prepare")["items"]}


def test_a_sweep_deleted_in_the_middle_leaves_nothing(lab: Lab) -> None:
    """Not even the preparation of a recording that nobody else reads; one that somebody reads stays."""
    before = preparations(lab)
    template = lab.run("x", "hanging", evaluate=False)["spec"]
    template["resources"] = {"cpu": "50m", "memory": "64Mi"}
    lab.apply(
        manifest("MappingRun", "other", **(template | {"input": {"frameRate": SLOW}})),
        manifest(
            "Sweep",
            "deleted",
            template={"spec": template},
            matrix=[
                {"path": "input.frameRate", "values": [SLOW, SLOWER]},
                {"path": "seed", "values": [1, 2]},
            ],
            parallelism=3,
        ),
    )

    def running() -> bool:
        runs = [run for run in lab.get(RUNS)["items"] if (run.get("status") or {}).get("phase") == "Running"]
        rates = {run["spec"]["input"]["frameRate"] for run in runs}
        return rates >= {SLOW, SLOWER} and "other" in {run["metadata"]["name"] for run in runs}

    until(running, "runs on both recordings", 180)
    made = preparations(lab) - before
    assert len(made) == 2
    lab.kubectl("delete", "sweep", "deleted", "--wait=false")
    until(lambda: not left(lab, "deleted"), f"nothing to be left, but {left(lab, 'deleted')}", GONE_SECONDS)
    until(lambda: len(preparations(lab) & made) == 1, "the preparation that nobody needs to go", GONE_SECONDS)
    assert lab.get("mappingrun", "other")["status"]["phase"] == "Running"
    (kept,) = preparations(lab) & made

    def owners() -> list[str]:
        return [owner["name"] for owner in lab.get("job", kept)["metadata"]["ownerReferences"]]

    until(lambda: owners() == ["other"], "the other one to have one owner", GONE_SECONDS)
    lab.kubectl("delete", "mappingrun", "other", "--wait=false")
    until(lambda: not preparations(lab) & made, "the other preparation to go", GONE_SECONDS)


def test_a_run_that_a_higher_class_takes_the_node_from_goes_on_and_is_not_blamed(lab: Lab) -> None:
    (node,) = lab.get("nodes")["items"]
    most = {"cpu": f"{float(node['status']['allocatable']['cpu']) * 0.6:.1f}", "memory": "256Mi"}
    classes = [
        {
            "apiVersion": "scheduling.k8s.io/v1",
            "kind": "PriorityClass",
            "metadata": {"name": f"lab-{name}"},
            "value": value,
        }
        for name, value in (("later", -10), ("sooner", 10))
    ]
    lab.cluster.apply(*classes)

    def at_work(disruptions: int | None = None) -> bool:
        status = lab.get("mappingrun", "later").get("status") or {}
        return (status.get("phase"), status.get("disruptions")) == ("Running", disruptions)

    common = {"resources": most, "evaluate": False}
    lab.apply(lab.run("later", "hanging", priorityClassName="lab-later", **common))
    until(at_work, "the run of the lower class", 180)
    lab.apply(lab.run("sooner", "shell-dead-reckoning", priorityClassName="lab-sooner", **common))
    assert lab.ended("sooner")["phase"] == "Succeeded"
    until(lambda: at_work(1), "the run of the lower class to go on", 180)
    found = lab.get("mappingrun", "later")["status"]
    assert (found["attempts"], found.get("faults")) == (1, None)
    lab.kubectl("delete", "mappingrun", "later", "sooner")
    lab.cluster.kubectl("delete", "priorityclass", *(one["metadata"]["name"] for one in classes))
