# SPDX-License-Identifier: Apache-2.0
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamhive.data.files import fetching
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.data.store.datasets import materialise
from slamhive.model.dataset import Dataset
from slamhive.model.sensors import Camera

sys.path.insert(0, str(Path(__file__).parent / "datalab"))

from serving import Site, make_certificate, serving

START = 1_600_000_000 * 10**9
CAMERA = {
    "width": 16,
    "height": 12,
    "fx": 20.0,
    "fy": 21.0,
    "cx": 7.4,
    "cy": 5.9,
    "coefficients": [0.1, 0.2, 0, 0, 0],
}
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


def make_dataset(name: Any, recording: Any, sensors: Any = None, **spec: Any) -> Any:
    return Dataset.model_validate(
        {"metadata": {"name": name}, "spec": {"recording": recording, "sensors": sensors or {}, **spec}}
    )


def bag_dataset(path: Any, sensors: Any, **spec: Any) -> Any:
    """Describe a bag as a dataset; sensors by name: (type, topic)."""
    described = {}
    for name, (kind, topic) in sensors.items():
        described[name] = {"type": kind, "topic": topic}
        if kind.endswith("Camera"):
            described[name]["camera"] = {**CAMERA, "depthScale": 1000 if kind == "DepthCamera" else None}
    dataset = make_dataset(path.stem, {"files": [{"path": path.name}]}, described, **spec)
    return DatasetEntry(dataset, path.parent)


def write_streams(path: Path, streams: Any, *, size: Any = (12, 16), imu: Any = ()) -> Path:
    """Write images that carry their index in every pixel, by topic, and IMU samples."""
    camera = Camera.model_validate(CAMERA)
    events = [(int(at), topic, k) for topic, stamps in streams.items() for k, at in enumerate(stamps)]
    events += [(int(at), "", k) for k, at in enumerate(imu)]
    with BagWriter(path) as bag:
        for at, topic, k in sorted(events):
            if not topic:
                bag.imu("/imu", at, "imu", np.zeros(3), np.array([0.0, 0.0, 9.81]))
                continue
            depth = "depth" in topic
            bag.camera_info(topic.rsplit("/", 1)[0] + "/camera_info", at, "cam", camera)
            pixels = np.full(size, k % 250, dtype=np.uint16 if depth else np.uint8)
            bag.image(topic, at, "cam", "16UC1" if depth else "mono8", pixels)
    return path


def ticks(rate: Any, count: Any, *, jitter: Any = 0.0, seed: Any = 1) -> Any:
    """Stamps in ns of a stream with a jitter in s."""
    noise = np.random.default_rng(seed).uniform(-jitter, jitter, count)
    return START + np.rint((np.arange(count) / rate + noise) * 1e9).astype(np.int64)


@pytest.fixture(scope="session")
def lidar_entry(tmp_path_factory: Any) -> Any:
    folder = tmp_path_factory.mktemp("lidar")
    spec = {"durationSeconds": 8, "loops": 0.2, "lidar": {"rings": 8, "columns": 90}}
    return materialise(make_dataset("lidar", {"synthetic": spec}), folder, folder)


def camera_spec(scale: Any) -> Any:
    camera = {"width": 160, "height": 120, "rate": 2, "scale": scale}
    return {
        "sensors": ["Stereo", "Rgbd"],
        "durationSeconds": 7,
        "loops": 0.1,
        "noise": 0,
        "camera": camera,
        "depthOffsetSeconds": 0.02,
    }


@pytest.fixture(scope="session")
def camera_entries(tmp_path_factory: Any) -> Any:
    """The same world at full and at half resolution."""
    folder = tmp_path_factory.mktemp("camera")
    specs = {scale: {"synthetic": camera_spec(scale)} for scale in (1.0, 0.5)}
    return {scale: materialise(make_dataset("camera", spec), folder, folder) for scale, spec in specs.items()}


@pytest.fixture
def frames_of() -> Any:
    """Make a dataset of one camera."""

    def make(
        path: Path, *, rate: float, count: int, jitter: float = 0.0, size: Any = (12, 16)
    ) -> DatasetEntry:
        path.unlink(missing_ok=True)
        write_streams(path, {"/cam/image_raw": ticks(rate, count, jitter=jitter)}, size=size)
        return bag_dataset(path, {"camera": ("Camera", "/cam/image_raw")})

    make.describe = bag_dataset  # type: ignore[attr-defined]
    return make


@pytest.fixture
def bag_with_truth() -> Any:
    """Make a dataset of a LiDAR whose bag carries ground truth, too."""

    def make(folder: Path, *, late: float = 0.0, **spec: Any) -> DatasetEntry:
        path = folder / "walk.bag"
        points = np.ones(5, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
        with BagWriter(path) as bag:
            bag.static_transforms(START, "base_link", {"lidar": np.eye(4)})
            for k, at in enumerate(ticks(10, 30)):
                bag.points("/points", int(at), "lidar", points)
                pose, later = np.array([0.1 * k, 0.0, 0.01 * k]), int(at) + round(late * 1e9)
                bag.planar_odometry("/truth", later, pose, np.zeros(2))
        truth = spec.pop("groundTruth", {"topic": "/truth"})
        return bag_dataset(path, {"lidar": ("Lidar", "/points")}, groundTruth=truth, **spec)

    return make


class RecordedWriter(BagWriter):
    """Records messages at times of their own instead of their stamps."""

    recorded_at: int | None = None

    def _write(self, topic: str, kind: str, stamp: int, message: Any) -> None:
        if self.recorded_at is not None:
            stamp = self.recorded_at
        super()._write(topic, kind, stamp, message)


@pytest.fixture
def bag_writer() -> type[RecordedWriter]:
    return RecordedWriter


@pytest.fixture
def bag_entry() -> Any:
    return bag_dataset


@pytest.fixture(scope="session")
def shared() -> Path:
    if not SHARED.is_dir():
        pytest.skip(f"needs the data in {SHARED}")
    return SHARED


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate: apt-get install openssl")
    return make_certificate(tmp_path_factory.mktemp("certificate"))


@pytest.fixture
def site(tmp_path: Path, certificate: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    """An https server that this process trusts, and that is asked again at once."""
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate[0]))
    for name in ("https_proxy", "HTTPS_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(fetching, "PAUSES", (0.0,) * 5)
    folder = tmp_path / "served"
    folder.mkdir()
    with serving(Site(folder), *certificate) as served:
        yield served
