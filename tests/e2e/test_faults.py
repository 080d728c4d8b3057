# SPDX-License-Identifier: Apache-2.0
"""The operator killed on a node in the middle of a sweep, and a sweep deleted in its middle."""

from __future__ import annotations

import os
import signal
from collections import Counter
from typing import TYPE_CHECKING

import pytest
from onnode.documents import ROOT
from onnode.lab import OPERATOR, RUNS, manifest, needed_one_attempt
from onnode.node import processes
from testcluster.access import until

if TYPE_CHECKING:
    from onnode.lab import Lab

GONE_SECONDS = 240
SLOW, SLOWER = 3, 1.5
"""Frame rates, Hz, that no other test of this installation plays: what prepares them is this test's own."""


@pytest.fixture(autouse=True)
def reckoning(lab: Lab) -> None:
    lab.apply_algorithm(ROOT / "tests" / "images" / "shell-algorithm")


def test_an_operator_killed_twice_loses_and_doubles_nothing(lab: Lab) -> None:
    speeds = [round(1 + 0.1 * step, 1) for step in range(10)]
    lab.apply(
        manifest(
            "Sweep",
            "killed",
            template={"spec": lab.run("x", "shell-dead-reckoning")["spec"]},
            matrix=[{"path": "parameters.speed", "values": speeds}],
            parallelism=3,
            cachePolicy="Rerun",
        )
    )
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
    lab.completed("killed", 300)
    until(lambda: lab.get("sweep", "killed")["status"].get("evaluated") == len(speeds), "all results", 240)

    status, runs = lab.get("sweep", "killed")["status"], lab.runs("killed")
    assert (status["succeeded"], status["failed"], status["running"]) == (len(speeds), 0, 0)
    assert [run["spec"]["parameters"]["speed"] for run in runs] == speeds
    assert seen.items() <= {run["metadata"]["name"]: run["metadata"]["uid"] for run in runs}.items()
    of_sweep = ("-l", "slamhive.io/sweep=killed,slamhive.io/role=run")
    for kind in ("jobs", "pods"):
        items = lab.get(kind, *of_sweep)["items"]
        each = Counter(item["metadata"]["labels"]["slamhive.io/run"] for item in items)
        assert each == {run["metadata"]["name"]: run["status"]["attempts"] for run in runs}
    for run in runs:
        assert needed_one_attempt(run["status"])
        assert len(run["status"]["results"]) == 1
        folders = [*(lab.results / "runs" / run["metadata"]["uid"]).iterdir()]
        assert len(folders) <= run["status"]["attempts"]
        assert any(str(folder).endswith(run["status"]["folder"]) for folder in folders)


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
    hanging = {
        "version": "1",
        "image": "slamhive/shell-algorithm:1.0.0",
        "command": ["sleep", "86400"],
        "modes": [{"name": "lidar", "roles": ["lidar"]}],
        "recording": ["Rosbag1"],
        "output": {"frame": "lidar"},
        "paces": ["Lockstep"],
    }
    lab.apply(manifest("Algorithm", "hanging", **hanging))
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
