# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamhive.data.importers import ImportOptions, import_recording, layout_of
from slamhive.data.inspecting.inspection import inspect
from slamhive.data.recordings.clouds import cloud_points
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.images import image_pixels
from slamhive.data.recordings.repairing import open_recording
from slamhive.model.dataset import Dataset


class Imported:
    """A dataset that was imported, and what is in its bag."""

    def __init__(self, dataset: Dataset, folder: Path, notes: list[str]) -> None:
        self.spec = dataset.spec
        self.entry = DatasetEntry(dataset, folder)
        self.notes = " | ".join(notes)

    def messages(self, sensor: str) -> list[tuple[int, Any]]:
        """Return a sensor's messages as stamp in ns and pixels, points or (rate, force)."""
        topic = self.spec.sensors[sensor].topic
        found = []
        with open_recording(self.entry.dataset, self.entry.root) as recording:
            for connection, _, raw in recording.messages([topic]):
                message = recording.decode(raw, connection.msgtype)
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                found.append((stamp, self._content(message)))
        return found

    def stamps(self, sensor: str) -> list[int]:
        return [stamp for stamp, _ in self.messages(sensor)]

    @staticmethod
    def _content(message: Any) -> Any:
        if hasattr(message, "angular_velocity"):
            vectors = message.angular_velocity, message.linear_acceleration
            return [[vector.x, vector.y, vector.z] for vector in vectors]
        return (
            image_pixels(message, "image") if hasattr(message, "encoding") else cloud_points(message, "scan")
        )


@pytest.fixture
def take_in(tmp_path: Path) -> Callable[..., Imported]:
    """Import a folder, whose layout must be recognised, and let the check of datasets look at the result."""

    def take(source: Path, layout: str, sequence: str | None = None) -> Imported:
        assert layout_of(source) == layout
        out = tmp_path / f"imported-{len([*tmp_path.glob('imported-*')])}"
        dataset, notes = import_recording(source, out, "a", layout, options=ImportOptions(sequence=sequence))
        found = Imported(dataset, out, notes)
        assert inspect(found.entry).errors == []
        return found

    return take


@pytest.fixture
def rotation() -> Callable[..., Any]:
    """Make a rotation about an axis, by degrees."""

    def turn(axis: int, degrees: float) -> Any:
        matrix, angle = np.eye(3), np.radians(degrees)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        matrix[i, i] = matrix[j, j] = np.cos(angle)
        matrix[j, i], matrix[i, j] = np.sin(angle), -np.sin(angle)
        return matrix

    return turn
