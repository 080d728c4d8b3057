# SPDX-License-Identifier: Apache-2.0
"""`dataset check` of a recording of 2 GB, in CPU seconds beside a pass that deserialises each message.

Run: python tests/bench/bench_check.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from bench_export import HEIGHT, START, WIDTH

from slamhive.data.recordings.rosmessages import BagWriter

FOCAL = 458.0
SECONDS, CAMERA, LIDAR, IMU, POINTS = 75, 20, 10, 200, 60_000
MOST_RATIO, MOST_MIB, ROUNDS = 3.0, 300, 2
DESERIALISING = """
import sys
from pathlib import Path
from rosbags.highlevel import AnyReader
with AnyReader([Path(sys.argv[1]) / "recording.bag"]) as reader:
    for connection, _, raw in reader.messages():
        reader.deserialize(raw, connection.msgtype)
"""
CHECK = """
import sys
from pathlib import Path
from slamhive.data.inspecting.inspection import inspect
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.model.loading import load_file
folder = Path(sys.argv[1])
report = inspect(DatasetEntry(load_file(folder / "dataset.yaml")[0], folder))
sys.exit(0 if report.is_usable else "; ".join(report.errors))
"""
UPRIGHT = "[[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]"
"""Turn of a camera that looks ahead."""
LENS = "{width: 752, height: 480, fx: 458.0, fy: 457.0, cx: 367.0, cy: 248.0}"
MANIFEST = f"""
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {{name: bench}}
spec:
  recording: {{format: Rosbag1, files: [{{path: recording.bag}}]}}
  sensors:
    left: {{type: Camera, topic: /left, camera: {LENS}, T_body_sensor: {UPRIGHT}}}
    right:
      type: Camera
      topic: /right
      camera: {LENS}
      T_body_sensor: {UPRIGHT.replace("0, 0], [0, -1", "0, -0.1], [0, -1")}
    lidar: {{type: Lidar, topic: /lidar, lidar: {{timeField: time, timesSince: Header}}}}
    imu: {{type: Imu, topic: /imu}}
  groundTruth: {{file: truth.txt}}
"""


def record(folder: Path) -> dict[str, float]:
    """Write a bag of a stereo camera, a LiDAR and an IMU that turn, and return the MB of each."""
    random = np.random.default_rng(3)
    scene = cv2.GaussianBlur(random.normal(0, 400, (HEIGHT, 2 * WIDTH)), (0, 0), 6) + 110
    scene = np.clip(scene + random.normal(0, 2, scene.shape), 0, 255).astype(np.uint8)
    # It is seen from the axis of a cylinder, so that a turn is what images show.
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    across = FOCAL * np.arctan((u - 367) / FOCAL).astype(np.float32) + 367
    down = (v - 248) / np.hypot(1, (u - 367) / FOCAL) + 248
    cloud = np.zeros(POINTS, dtype=[(name, "<f4") for name in ("x", "y", "z", "intensity", "time")])
    for name in ("x", "y", "z"):
        cloud[name] = random.normal(0, 8, POINTS)
    side = random.integers(0, 4, POINTS)  # of a square room with things in it
    for axis, wall in (("x", 0), ("y", 2)):
        cloud[axis] = np.select([side == wall, side == wall + 1], [12.0, -12.0], cloud[axis] % 24.0 - 12.0)
    cloud["time"] = np.arange(POINTS) / POINTS / LIDAR
    seen = cloud.copy()
    truth = []
    with BagWriter(folder / "recording.bag") as bag:
        for k in range(SECONDS * IMU):
            seconds, stamp = k / IMU, START + k * 10**9 // IMU
            rates = np.array([0.0, 0.0, 0.5 * np.sin(seconds)])
            forces = np.array([np.sin(seconds), np.cos(seconds), 9.81])
            bag.imu("/imu", stamp, "imu", rates + random.normal(0, 1e-3, 3), forces)
            turn = 0.5 * (1 - np.cos(seconds))
            if k % 2 == 0:
                truth.append(f"{stamp / 1e9:.6f} 0 0 0 0 0 {np.sin(turn / 2):.9f} {np.cos(turn / 2):.9f}\n")
            if k % (IMU // CAMERA) == 0:
                image = cv2.remap(scene, across + np.float32(FOCAL * (1 - turn)), down, cv2.INTER_LINEAR)
                bag.image("/left", stamp, "left", "mono8", image)
                bag.image("/right", stamp, "right", "mono8", np.roll(image, 8, axis=1))
            if k % (IMU // LIDAR) == 0:
                turns = 0.5 * (1 - np.cos(seconds + cloud["time"]))
                sine, cosine = np.sin(turns), np.cos(turns)
                seen["x"], seen["y"] = (
                    cosine * cloud["x"] + sine * cloud["y"],
                    cosine * cloud["y"] - sine * cloud["x"],
                )
                bag.points("/lidar", stamp, "lidar", seen)
    (folder / "truth.txt").write_text("".join(truth))
    (folder / "dataset.yaml").write_text(MANIFEST)
    image = 2 * SECONDS * CAMERA * WIDTH * HEIGHT
    return {"images": image / 1e6, "clouds": SECONDS * LIDAR * POINTS * 20 / 1e6}


def spent(program: str, folder: Path) -> tuple[float, float]:
    """Return CPU seconds and the most memory (MiB) of a program in a process of its own."""
    alone = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # as the command has it
    process = subprocess.Popen([sys.executable, "-c", program, str(folder)], env=alone)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"exit status {status}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        shares = record(folder)
        size = (folder / "recording.bag").stat().st_size / 1e6
        passes, checks = [], []
        for _ in range(ROUNDS):
            passes.append(spent(DESERIALISING, folder))
            checks.append(spent(CHECK, folder))
        peer, ours = min(passes)[0], min(checks)[0]
        kinds = ", ".join(f"{name} {value / size:.0%}" for name, value in shares.items())
        print(
            f"dataset check, {size / 1e3:.1f} GB ({kinds}) · {ours:.1f} CPU s, {ours / peer:.2f} of it; "
            f"{max(most for _, most in checks):.0f} MiB · a pass with rosbags {peer:.1f} CPU s; at most "
            f"{MOST_RATIO:g} of it with clocks and frames, {MOST_MIB} MiB · best of {ROUNDS}"
        )


if __name__ == "__main__":
    main()
