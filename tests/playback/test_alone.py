# SPDX-License-Identifier: Apache-2.0
"""Runs of ROS 2 nodes beside each other, beside foreign nodes, and in shells that tell ROS where to be."""

from __future__ import annotations

import json
import os
import subprocess
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from conftest import Stage
    from slamhive.model.results import RunRecord

pytestmark = pytest.mark.slow

INTRUDER = """
import rclpy, time
rclpy.init()
node = rclpy.create_node("intruder")
publisher = node.create_publisher(__import__("nav_msgs.msg").msg.Odometry, "/actor/poses", 10)
time.sleep(30)
"""
SHELL = {
    "ROS_DOMAIN_ID": "7",
    "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    "ROS_LOCALHOST_ONLY": "1",
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF",
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
    "FASTDDS_DEFAULT_PROFILES_FILE": "/nowhere.xml",
    "CYCLONEDDS_URI": "file:///nowhere.xml",
}


def domain(folder: Path) -> int:
    told = json.loads((folder / "player" / "node.json").read_text())
    return int(told["variables"]["ROS_DOMAIN_ID"])


def trajectory(record: RunRecord) -> np.ndarray:
    return np.loadtxt(Path(record.folder or "") / "run" / "output" / "trajectory.txt")


def is_apart(one: RunRecord, other: RunRecord) -> bool:
    """Tell whether one run was over before the other began."""
    (_, over), (begun, _) = sorted((run.started, run.finished) for run in (one, other))
    return over <= begun


@pytest.mark.parametrize("count", [5, 20])
def test_runs_side_by_side_do_not_meet(stage2: Stage, count: int) -> None:
    records = stage2.run("signed", rate=1.0, count=count)
    assert [(one.message, one.phase) for one in records] == [(None, "Succeeded")] * count
    at = {domain(Path(one.folder or "")): one for one in records}
    for record in records:
        other = at[domain(Path(record.folder or ""))]
        # A domain is free again as soon as its run is over.
        assert other is record or is_apart(other, record)
        rows = trajectory(record)
        assert record.frames is not None
        assert len(rows) == record.frames.processed == record.frames.offered == 30
        assert (rows[:, 2] == record.spec["seed"]).all()


def test_what_a_shell_tells_ros_changes_nothing(stage2: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in SHELL.items():
        monkeypatch.setenv(name, value)
    (record,) = stage2.run("signed")
    assert (record.message, record.phase) == (None, "Succeeded")
    assert domain(Path(record.folder or "")) != int(SHELL["ROS_DOMAIN_ID"])
    assert len(trajectory(record)) == 30


@contextmanager
def intruder(stage: Stage) -> Iterator[None]:
    """Have a foreign node come to the domain of the next run."""
    known = set(stage.home.path.glob("runs/*/*/process.json"))
    started: list[subprocess.Popen[bytes]] = []

    def come() -> None:
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            # There when the algorithm has been started, and all that it needs.
            for process in set(stage.home.path.glob("runs/*/*/process.json")) - known:
                folder = process.parent
                variables = (
                    os.environ | json.loads((folder / "player" / "node.json").read_text())["variables"]
                )
                python = json.loads((folder / "supervisor.json").read_text())["argv"][0]
                started.append(subprocess.Popen([python, "-c", INTRUDER], env=variables))
                return
            time.sleep(0.02)

    thread = threading.Thread(target=come)
    thread.start()
    try:
        yield
    finally:
        thread.join()
        for process in started:
            process.kill()
            process.wait()


def test_a_foreign_node_on_the_domain_ends_the_run(stage2: Stage) -> None:
    with intruder(stage2):
        (record,) = stage2.run("signed", rate=0.25)
    number = domain(Path(record.folder or ""))
    message = f"a node of another program came to the run's ROS 2 domain {number}: /intruder"
    assert (record.message, record.phase, record.reason) == (message, "Failed", "SystemFault")
