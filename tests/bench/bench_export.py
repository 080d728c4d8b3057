# SPDX-License-Identifier: Apache-2.0
"""Export to folders of files and to a bag, in MB of the recording per second beside a copy of the same bytes.

Run: python tests/bench/bench_export.py
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from slamhive.data.files.once import settle
from slamhive.data.making.exporting import export_dataset
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.model.algorithm import DataFormat
from slamhive.model.dataset import Dataset
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role

WIDTH, HEIGHT, FRAMES, RATE, POINTS = 752, 480, 200, 20, 60_000
ROUNDS = 3
START = 1_600_000_000 * 10**9
STEREO, RGBD, LIDAR = (Role.LEFT, Role.RIGHT), (Role.COLOR, Role.DEPTH), (Role.LIDAR,)


def views(count: int) -> list[np.ndarray]:
    """Return images with the detail and the noise of a camera's."""
    random = np.random.default_rng(1)
    found = []
    for _ in range(count):
        scene = cv2.GaussianBlur(random.normal(0, 400, (HEIGHT, WIDTH)), (0, 0), 6) + 110
        found.append(np.clip(scene + random.normal(0, 2, scene.shape), 0, 255).astype(np.uint8))
    return found


def record(folder: Path, roles: tuple[Role, ...]) -> DatasetEntry:
    """Write a bag of a mode's sensors and describe it."""
    lens = {"width": WIDTH, "height": HEIGHT, "fx": 458.0, "fy": 457.0, "cx": 367.0, "cy": 248.0}
    lens |= {"distortion": "RadialTangential", "coefficients": [-0.28, 0.07, 0.0002, 0.00002, 0.0]}
    images = views(8)
    cloud = np.random.default_rng(2).normal(size=(POINTS, 4)).astype(np.float32)
    points = cloud.view([(name, "<f4") for name in ("x", "y", "z", "intensity")])[:, 0]
    path = folder / "recording.bag"
    with BagWriter(path) as bag:
        for k in range(FRAMES):
            stamp, image = START + k * 10**9 // RATE, images[k % len(images)]
            for role in roles:
                match role:
                    case Role.LIDAR:
                        bag.points("/lidar", stamp, "lidar", points)
                    case Role.DEPTH:
                        bag.image("/depth", stamp, "depth", "16UC1", image.astype(np.uint16) * 16)
                    case Role.COLOR:
                        bag.image("/color", stamp, "color", "bgr8", np.dstack([image] * 3))
                    case _:
                        bag.image(f"/{role}", stamp, role, "mono8", image)
    sensors = {}
    for role in roles:
        kind = {Role.LIDAR: "Lidar", Role.DEPTH: "DepthCamera"}.get(role, "Camera")
        sensors[str(role)] = {"type": kind, "topic": f"/{role}"}
        if role is not Role.LIDAR:
            sensors[str(role)]["camera"] = lens | {"depthScale": 1000.0}
    if Role.RIGHT in roles:
        sensors["right"]["T_body_sensor"] = [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    spec = {"recording": {"files": [{"path": path.name}]}, "sensors": sensors}
    return DatasetEntry(Dataset.model_validate({"metadata": {"name": "bench"}, "spec": spec}), folder)


def copied(source: Path, target: Path) -> float:
    """Return the seconds that a copy takes, through to the disk as an export goes."""
    begin = time.perf_counter()
    target.mkdir()
    shutil.copyfile(source, target / source.name)
    settle(target, read_only=False)
    elapsed = time.perf_counter() - begin
    shutil.rmtree(target)
    return elapsed


def main() -> None:
    """Measure and print."""
    cases = [
        (DataFormat.EUROC, STEREO),
        (DataFormat.TUM, RGBD),
        (DataFormat.KITTI, STEREO),
        (DataFormat.KITTI, LIDAR),
        (DataFormat.MCAP, STEREO),
    ]
    for form, roles in cases:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            entry = record(folder, roles)
            size = (folder / "recording.bag").stat().st_size / 1e6
            exports, copies, cpu, written = [], [], [], 0.0
            for number in range(ROUNDS):
                out = folder / str(number)
                copies.append(copied(folder / "recording.bag", folder / "copy"))
                begin, spent = time.perf_counter(), time.process_time()
                export_dataset(entry, roles, InputOptions(), form, out)
                exports.append(time.perf_counter() - begin)
                cpu.append(time.process_time() - spent)
                files = [path for path in out.rglob("*") if path.is_file()]
                written = sum(path.stat().st_size for path in files) / 1e6
                shutil.rmtree(out)
            print(
                f"{form} with {', '.join(roles)} · {size / min(exports):.0f} MB/s, a copy "
                f"{size / min(copies):.0f} MB/s · {size / min(cpu):.0f} MB per CPU second · "
                f"{size:.0f} MB become {written:.0f} MB in {len(files)} files · best of {ROUNDS}"
            )


if __name__ == "__main__":
    main()
