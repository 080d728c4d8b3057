# SPDX-License-Identifier: Apache-2.0
"""Preparing a bag to half resolution and half rate, in MB/s beside a plain copy of the bag.

Run: python tests/bench/bench_prepare.py
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.model.algorithm import DataFormat
from slamhive.model.dataset import Dataset
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Camera, Role

WIDTH, HEIGHT, FRAMES, RATE, IMU_RATE = 752, 480, 300, 20, 200
ROUNDS = 3


def record(path: Path) -> None:
    """Write a stereo-inertial bag as EuRoC's are."""
    camera = Camera(width=WIDTH, height=HEIGHT, fx=458.0, fy=457.0, cx=367.0, cy=248.0)
    pixels = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    start = 1_600_000_000 * 10**9
    with BagWriter(path) as bag:
        for k in range(FRAMES * IMU_RATE // RATE):
            stamp = start + k * 10**9 // IMU_RATE
            bag.imu("/imu", stamp, "imu", np.zeros(3), np.array([0.0, 0.0, 9.81]))
            if k % (IMU_RATE // RATE) == 0:
                for side in ("left", "right"):
                    bag.camera_info(f"/{side}/camera_info", stamp, side, camera)
                    bag.image(f"/{side}/image_raw", stamp, side, "mono8", pixels)


def describe(path: Path) -> DatasetEntry:
    """Describe the bag as a dataset."""
    camera = {"width": WIDTH, "height": HEIGHT, "fx": 458.0, "fy": 457.0, "cx": 367.0, "cy": 248.0}
    sensors: dict[str, object] = {
        side: {"type": "Camera", "topic": f"/{side}/image_raw", "camera": camera}
        for side in ("left", "right")
    }
    sensors["imu"] = {"type": "Imu", "topic": "/imu"}
    spec = {"recording": {"files": [{"path": path.name}]}, "sensors": sensors}
    return DatasetEntry(Dataset.model_validate({"metadata": {"name": "bench"}, "spec": spec}), path.parent)


def copy(source: Path, target: Path, *, durable: bool) -> None:
    """Copy a file, on request through to the disk, as preparation brings its own."""
    shutil.copyfile(source, target)
    if not durable:
        return
    with target.open("rb") as file:
        os.fsync(file.fileno())


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        bag = folder / "recording.bag"
        record(bag)
        entry = describe(bag)
        size = bag.stat().st_size / 1e6
        cache = folder / "variants"
        roles = (Role.LEFT, Role.RIGHT, Role.IMU)
        options = InputOptions(resolution=0.5, frame_rate=RATE / 2)
        times: dict[str, list[float]] = {
            "plain copy": [],
            "plain copy to the disk": [],
            "preparation to half resolution and half rate": [],
        }
        for number in range(ROUNDS):
            for what, durable in (("plain copy", False), ("plain copy to the disk", True)):
                begin = time.perf_counter()
                copy(bag, folder / "copy", durable=durable)
                times[what].append(time.perf_counter() - begin)
            begin = time.perf_counter()
            prepare(entry, roles, options, [DataFormat.ROSBAG1], cache / str(number))
            times["preparation to half resolution and half rate"].append(time.perf_counter() - begin)
        about = f"stereo-inertial bag of {size:.0f} MB, best of {ROUNDS}"
        for what, seconds in times.items():
            print(f"{what} · {size / min(seconds):.0f} MB/s ({min(seconds):.2f} s) · {about}")


if __name__ == "__main__":
    main()
