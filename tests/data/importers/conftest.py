# SPDX-License-Identifier: Apache-2.0
"""Small samples in the layouts of published datasets, and what became of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from layouts.asl import write_asl, write_euroc, write_png
from rosbags.highlevel import AnyReader

from slamhive.data.importers import import_recording
from slamhive.data.recordings.entries import DatasetEntry

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.model.dataset import Dataset


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
    return write_png


@pytest.fixture
def asl() -> Callable[..., Path]:
    """Write mav0 without calibration: cameras whose images carry the number of their frame, 200 Hz of IMU."""
    return write_asl


@pytest.fixture
def euroc() -> Callable[..., Path]:
    """Write a folder as EuRoC's are."""
    return write_euroc
