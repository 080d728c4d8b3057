# SPDX-License-Identifier: Apache-2.0
"""Real algorithms as ROS nodes, beside themselves in lockstep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from slamhive.archive import Archive
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.folder import Home
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.model.dataset import Dataset
from slamhive.model.results import Reason
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid

if TYPE_CHECKING:
    from slamhive.model.results import RunRecord

pytestmark = pytest.mark.slow

STEREO = {"sensors": ["Stereo"], "durationSeconds": 12, "loops": 0.4, "camera": {"width": 320, "height": 240}}

FRAMES = 180


@pytest.fixture
def home(tmp_path: Path, environments: Path) -> Home:
    """A home of real algorithms."""
    (tmp_path / "environments").symlink_to(environments)
    return Home.at(tmp_path)


def run(home: Home, names: list[str], dataset: str, notes: object, **asked_for: str) -> list[RunRecord]:
    workshop = load_workshop(home)
    small = Dataset.model_validate(
        {"metadata": {"name": "stereo"}, "spec": {"recording": {"synthetic": STEREO}}}
    )
    workshop.add([small], home.path)
    # At half its speed, so that a busy machine keeps up with some of it.
    asked = {"duration": "12s", "rate": 0.5, **asked_for}
    template = {"datasetRef": {"name": dataset}, "input": asked, "timeout": "10m"}
    template["sensors"] = asked.pop("sensors", "lidar")
    axis = {"path": "algorithm", "values": names}
    body = {"metadata": {"name": "real"}, "spec": {"template": {"spec": template}, "matrix": [axis]}}
    sweep = Sweep.model_validate(body)
    with Archive.open(home.archive_url) as archive:
        job = Job(sweep, local_uid(sweep), Plan(sweep, workshop))
        Runner(Workbench(home, workshop, archive), notes, parallelism=1).run([job])  # type: ignore[arg-type]
        found = [archive.get(job.run_uid(index)) for index in range(len(names))]
    records = [record for record in found if record is not None]
    missing = [str(one.message) for one in records if one.reason is Reason.ALGORITHM_UNAVAILABLE]
    if missing:
        pytest.skip(missing[0])
    said = "\n".join(f"{one.phase}, {one.reason}: {one.message}\n{one.log_tail}" for one in records)
    assert [one.phase for one in records] == ["Succeeded"] * len(names), said
    return records


def trajectory(record: RunRecord, name: str = "trajectory.txt") -> np.ndarray:
    return np.loadtxt(Path(record.folder or "") / "run" / "output" / name)


def check_beside(lockstep: RunRecord, played: RunRecord) -> None:
    """Look at a node's poses beside those of the same program in lockstep."""
    assert played.frames is not None
    assert played.frames.offered == 120
    first, second = trajectory(lockstep), trajectory(played)
    assert set(second[:, 0]) <= set(first[:, 0])
    assert len(second) == played.frames.processed
    assert played.metrics["latencySeconds"]["mean"] > 0
    if played.frames.dropped == 0:  # a busy machine drops some, and then the odometry takes another way
        np.testing.assert_allclose(second, first, atol=1e-6)


def test_kiss_icp(ros: None, home: Home, notes: object) -> None:
    check_beside(*run(home, ["kiss-icp", "kiss-icp-ros"], "synthetic-lidar", notes))


@pytest.mark.parametrize(("name", "sensors"), [("kiss-icp", "lidar"), ("rko-lio", "lidar-inertial")])
def test_ros2(name: str, sensors: str, home: Home, notes: object) -> None:
    check_beside(*run(home, [name, f"{name}-ros2"], "synthetic-lidar", notes, sensors=sensors))


@pytest.mark.parametrize(("name", "sensors"), [("kiss-icp", "lidar"), ("rko-lio", "lidar-inertial")])
def test_ros2_frame_by_frame_drops_nothing(name: str, sensors: str, home: Home, notes: object) -> None:
    (lockstep,) = run(home, [name], "synthetic-lidar", notes, sensors=sensors)
    (played,) = run(home, [f"{name}-ros2"], "synthetic-lidar", notes, sensors=sensors, pace="Stepped")
    assert played.frames is not None
    # A scan that comes at its start has its inertial samples behind the next one: two show that.
    more = played.metrics["framesWaitedForInVain"] - (2 if name == "rko-lio" else 0)
    # A machine that is busy enough has a scan take longer than is waited for it.
    assert 0 <= (played.frames.dropped or 0) <= more
    check_beside(lockstep, played)


def test_orb_slam(ros: None, home: Home, notes: object) -> None:
    (played,) = run(home, ["orb-slam3-smallvoc-ros"], "stereo", notes, sensors="stereo")
    assert played.frames is not None
    # A busy machine drops some, however slowly they come.
    assert played.frames.offered == FRAMES
    assert (played.frames.processed or 0) + (played.frames.dropped or 0) == FRAMES
    assert 0 < len(trajectory(played)) <= (played.frames.processed or 0)
    assert played.results[0].values["ate"]["rmse"] < 0.5
    assert len(trajectory(played)) > 20
    assert len(trajectory(played, "trajectory.online.txt")) > 20
    # Where frames were dropped, tracking may have been lost and begun anew just before the end.
    assert played.metrics["keyframes"] > (0 if played.frames.dropped else 1)
