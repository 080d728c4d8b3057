# SPDX-License-Identifier: Apache-2.0
"""Perturbed variants beside plain ones of the same sensors and form, in MB/s of the recording.

Run: python tests/bench/bench_perturb.py
"""

from __future__ import annotations

import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.model.algorithm import DataFormat
from slamhive.model.dataset import Dataset
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role

WIDTH, HEIGHT, FRAMES = 752, 480, 100
POINTS, SCANS = 64 * 1024, 50
ROUNDS, WANTED = 3, 0.7
CAMERA = {"width": WIDTH, "height": HEIGHT, "fx": 458.0, "fy": 457.0, "cx": 367.0, "cy": 248.0}
START = 1_600_000_000 * 10**9
OF_IMAGES: dict[str, Any] = {
    "noise 8": {"noise": 8},
    "JPEG 30": {"jpegQuality": 30},
    "gamma 1.5": {"gamma": 1.5},
    "exposure 1 stop": {"exposureStep": 1},
    "blur 8 px": {"blur": 8},
    "motion blur 20 ms": {"motionBlur": 20},
    "occlusion 0.2": {"occlusion": 0.2},
}
OF_SCANS: dict[str, Any] = {
    "range noise 0.05 m": {"rangeNoise": 0.05},
    "rain 0.1": {"rain": 0.1},
    "points dropped 0.3": {"dropPoints": 0.3},
    "sector 90°": {"sector": 90},
}


def record(path: Path) -> None:
    """Write a bag of a camera, an IMU and a LiDAR; images are as smooth, and as noisy, as real ones."""
    drawn = np.random.default_rng(1)
    smooth = cv2.GaussianBlur(drawn.integers(0, 256, (HEIGHT, WIDTH)).astype(np.float32), (0, 0), 6)
    grey = cv2.normalize(smooth, None, 20, 235, cv2.NORM_MINMAX) + drawn.standard_normal((HEIGHT, WIDTH))
    points = np.zeros(POINTS, dtype=[(name, "<f4") for name in ("x", "y", "z", "intensity", "time")])
    for axis in "xyz":
        points[axis] = drawn.uniform(-30, 30, POINTS)
    with BagWriter(path) as bag:
        for k in range(FRAMES * 10):
            stamp = START + k * 5 * 10**6
            bag.imu("/imu", stamp, "imu", np.array([0.3, 0.5, 0.1 + k * 1e-4]), np.array([0.0, 0.0, 9.81]))
            if k % 10 == 0:
                bag.image("/cam", stamp, "cam", "mono8", np.roll(grey, k // 10, 1).astype(np.uint8))
            if k % (FRAMES * 10 // SCANS) == 0:
                bag.points("/points", stamp, "lidar", points)


def describe(path: Path) -> DatasetEntry:
    """Describe the bag as a dataset."""
    sensors = {
        "camera": {"type": "Camera", "topic": "/cam", "camera": CAMERA},
        "imu": {"type": "Imu", "topic": "/imu"},
        "lidar": {"type": "Lidar", "topic": "/points"},
    }
    spec = {"recording": {"files": [{"path": path.name}]}, "sensors": sensors}
    return DatasetEntry(Dataset.model_validate({"metadata": {"name": "bench"}, "spec": spec}), path.parent)


def seconds(entry: DatasetEntry, role: Role, form: DataFormat, perturb: Any, cache: Path) -> float:
    """Return the time to make one variant."""
    begin = time.perf_counter()
    prepare(entry, (role,), InputOptions.model_validate({"perturb": perturb}), [form], cache)
    taken = time.perf_counter() - begin
    shutil.rmtree(cache)
    return taken


def main() -> None:
    """Measure and print; perturbed and plain take turns, so that other work on the machine is in both."""
    kinds: tuple[tuple[Role, str, float, dict[str, Any]], ...] = (
        (Role.CAMERA, "images", FRAMES * WIDTH * HEIGHT / 1e6, OF_IMAGES),
        (Role.LIDAR, "lidar", SCANS * POINTS * 20 / 1e6, OF_SCANS),
    )
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        record(folder / "recording.bag")
        entry = describe(folder / "recording.bag")
        for role, block, size, perturbations in kinds:
            folder_form = DataFormat.EUROC if block == "images" else DataFormat.KITTI
            for form in (folder_form, DataFormat.ROSBAG1):
                recorded = folder / "variants"
                for name, wanted in perturbations.items():
                    pairs = [
                        [seconds(entry, role, form, one, recorded) for one in (None, {block: wanted})]
                        for _ in range(ROUNDS)
                    ]
                    plain, worse = (min(times) for times in zip(*pairs, strict=True))
                    share = statistics.median(one / other for one, other in pairs)
                    print(
                        f"{block} to {form}: {name} · {size / worse:.0f} MB/s, plain {size / plain:.0f} · "
                        f"{share:.2f} of plain (median of {ROUNDS} pairs; wanted {WANTED})",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
