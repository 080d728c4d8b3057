# SPDX-License-Identifier: Apache-2.0
"""Small samples in the layouts of published datasets, and what became of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from slamhive.data.entries import DatasetEntry
from slamhive.data.importers import import_recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.model.dataset import Dataset

START = 1_520_530_308_199_447_626


class Imported:
    """A dataset made of a sample, its notes, and what is in its bag."""

    def __init__(self, dataset: Dataset, notes: list[str], root: Path) -> None:
        self.dataset, self.root = dataset, root
        self.notes = "\n".join(notes)
        self.sensors = dataset.spec.sensors
        self.entry = DatasetEntry(dataset, root)

    def messages(self, sensor: str, bag: Path | None = None) -> list[tuple[int, Any]]:
        """Return stamps (ns) and messages of a sensor."""
        found = []
        with AnyReader([bag or self.root / "recording.bag"]) as reader:
            chosen = [one for one in reader.connections if one.topic == self.sensors[sensor].topic]
            for one, _, raw in reader.messages(chosen):
                message = reader.deserialize(raw, one.msgtype)
                stamp = message.header.stamp
                found.append((stamp.sec * 10**9 + stamp.nanosec, message))
        return found

    def stamps(self, sensor: str) -> list[int]:
        return [stamp for stamp, _ in self.messages(sensor)]

    def pixels(self, sensor: str) -> list[np.ndarray]:
        found = []
        for _, message in self.messages(sensor):
            kind = np.uint16 if message.encoding in {"16UC1", "mono16"} else np.uint8
            rows = np.asarray(message.data).view(kind).reshape(message.height, message.width, -1)
            found.append(rows[..., 0] if rows.shape[2] == 1 else rows)
        return found

    def first_pixels(self, sensor: str) -> list[int]:
        return [int(pixels.flat[0]) for pixels in self.pixels(sensor)]


@pytest.fixture
def imported(tmp_path: Path) -> Callable[..., Imported]:
    def run(source: Path, layout: str, name: str = "sample") -> Imported:
        dataset, notes = import_recording(source, tmp_path / f"out-{name}", name, layout)
        return Imported(dataset, notes, tmp_path / f"out-{name}")

    return run


@pytest.fixture
def png() -> Callable[..., None]:
    """Write an image whose pixels are all of one value."""

    def write(path: Path, value: int, size: tuple[int, int] = (6, 8), dtype: Any = np.uint8) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), np.full(size, value, dtype=dtype))

    return write


@pytest.fixture
def asl(png: Any) -> Callable[..., Path]:
    """Write mav0 without calibration: cameras whose images carry the number of their frame, 200 Hz of IMU."""

    def write(
        folder: Path, *, frames: int = 8, dtype: Any = np.uint8, missing: Any = (), base: str = "mav0"
    ) -> Path:
        for n in range(2):
            rows = ["#timestamp [ns],filename"]
            for k in range(frames):
                if (n, k) in missing:
                    continue
                stamp = START + 50_000_000 * k + 1000 * n
                value = (k + 1) * 256 + 99 if dtype == np.uint16 else k + 1
                png(folder / base / f"cam{n}" / "data" / f"{stamp}.png", value, dtype=dtype)
                rows.append(f"{stamp},{stamp}.png")
            (folder / base / f"cam{n}" / "data.csv").write_text("\n".join(rows) + "\n")
        (folder / base / "imu0").mkdir()
        head = "#timestamp [ns],w_RS_S_x [rad s^-1],w y,w z,a_RS_S_x [m s^-2],a y,a z\n"
        rows = [f"{START + 5_000_000 * k},0.1,0.2,0.3,0.4,0.5,{9 + k}" for k in range(10 * frames)]
        (folder / base / "imu0" / "data.csv").write_text(head + "\n".join(rows) + "\n")
        return folder

    return write


ASL_CAMERA = """%YAML:1.0
T_BS:
  cols: 4
  rows: 4
  data: [1, 0, 0, {x}, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
rate_hz: 20
resolution: [8, 6]
camera_model: pinhole
intrinsics: [5, 5.5, 3, 2]
distortion_model: radial-tangential
distortion_coefficients: [0.1, 0.2, 0.3, 0.4]
"""
ASL_IMU = """%YAML:1.0
T_BS: {cols: 4, rows: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}
rate_hz: 200
gyroscope_noise_density: 1.7e-04
"""


@pytest.fixture
def euroc(asl: Any) -> Callable[..., Path]:
    """Write a folder as EuRoC's are."""

    def write(folder: Path, **options: Any) -> Path:
        asl(folder, **options)
        for n in range(2):
            (folder / "mav0" / f"cam{n}" / "sensor.yaml").write_text(ASL_CAMERA.replace("{x}", str(0.1 * n)))
        (folder / "mav0" / "imu0" / "sensor.yaml").write_text(ASL_IMU)
        return folder

    return write
