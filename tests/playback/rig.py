# SPDX-License-Identifier: Apache-2.0
"""A recording as heavy as a car's, made in a moment: clouds of 2 MB, IMU at 200 Hz, stereo at 20 Hz."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.archive import Archive
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.local.running.runner import Job, Runner, Watcher
from slamhive.local.running.workbench import Workbench
from slamhive.model.dataset import Dataset
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.home.folder import Home
    from slamhive.model.results import RunRecord

START = 1_600_000_000 * 10**9
POINTS, WIDTH, HEIGHT = 100_000, 752, 480
RATES = {"/points": 10, "/left/image_raw": 20, "/right/image_raw": 20, "/imu": 200}
_KINDS = 5
"""Different clouds and images; they come again, each with a stamp of its own."""


def record(path: Path, seconds: int) -> None:
    """Write the bag, of noise."""
    random = np.random.default_rng(1)
    clouds = []
    for _ in range(_KINDS):
        cloud = np.zeros(POINTS, dtype=[(name, "<f4") for name in ("x", "y", "z", "intensity", "time")])
        for name in ("x", "y", "z"):
            cloud[name] = random.normal(0, 20, POINTS)
        cloud["time"] = np.linspace(0, 0.1, POINTS)
        clouds.append(cloud)
    images = random.integers(0, 256, (_KINDS, HEIGHT, WIDTH), dtype=np.uint8)
    forces = random.normal((0, 0, 9.81), 0.1, (seconds * RATES["/imu"], 3))
    with BagWriter(path) as bag:
        for number, force in enumerate(forces):
            stamp = START + number * 10**9 // RATES["/imu"]
            bag.imu("/imu", stamp, "imu", force[::-1] / 100, force)
            if number % 10 == 0:
                for side in ("left", "right"):
                    bag.image(f"/{side}/image_raw", stamp, side, "mono8", images[number // 10 % _KINDS])
            if number % 20 == 0:
                bag.points("/points", stamp, "lidar", clouds[number // 20 % _KINDS])


def dataset(bag: Path) -> Dataset:
    """Return the dataset "rig" of a bag."""
    camera = {"width": WIDTH, "height": HEIGHT, "fx": 458.0, "fy": 457.0, "cx": 367.0, "cy": 248.0}
    sensors: dict[str, Any] = {
        "lidar": {"type": "Lidar", "topic": "/points"},
        "imu": {"type": "Imu", "topic": "/imu"},
        "left": {"type": "Camera", "topic": "/left/image_raw", "camera": camera},
        "right": {"type": "Camera", "topic": "/right/image_raw", "camera": camera},
    }
    spec = {"recording": {"files": [{"path": bag.name}]}, "sensors": sensors}
    return Dataset.model_validate({"metadata": {"name": "rig"}, "spec": spec})


class Silence(Watcher):
    """A watcher that shows nothing."""


def play(home: Home, workshop: Workshop, algorithm: str, name: str) -> RunRecord:
    """Run an algorithm on the rig's recording, once and without evaluation, and return the run."""
    template = {"algorithmRef": {"name": algorithm}, "datasetRef": {"name": "rig"}, "retries": 0}
    template |= {"evaluate": False, "timeout": "30m"}
    sweep = Sweep.model_validate({"metadata": {"name": name}, "spec": {"template": {"spec": template}}})
    with Archive.open(home.archive_url) as archive:
        job = Job(sweep, local_uid(sweep), Plan(sweep, workshop))
        Runner(Workbench(home, workshop, archive), Silence(), parallelism=1).run([job])
        record = archive.get(job.run_uid(0))
    if record is None:
        raise LookupError(f"{algorithm} left no record")
    return record
