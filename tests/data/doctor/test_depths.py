# SPDX-License-Identifier: Apache-2.0
"""Unit of depth, told by how far the camera moved against how far the ground truth did."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from spoiling import found_in, spoil

from slamhive.data.doctor.findings import sensor_repair
from slamhive.data.store.datasets import materialise
from slamhive.model.dataset import Dataset

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.recordings.entries import DatasetEntry

DEPTH = "/camera/depth/image_raw"


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> DatasetEntry:
    """A camera whose depth is in millimetres, as is stated."""
    folder = tmp_path_factory.mktemp("moving")
    camera = {"width": 240, "height": 180, "rate": 10}
    made = {"sensors": ["Rgbd"], "durationSeconds": 8, "loops": 0.15, "camera": camera}
    dataset = {"metadata": {"name": "moving"}, "spec": {"recording": {"synthetic": made}}}
    return materialise(Dataset.model_validate(dataset), folder, folder)


def stored(entry: DatasetEntry, folder: Path, times: float, stated: float) -> dict[str, Finding]:
    """Return the findings where depth is so many times as large, and is stated in other units a metre."""

    def change(topic: str, message: Any) -> Any:
        if topic == DEPTH:
            pixels = np.rint(message.data.view("<u2") * times).astype("<u2")
            message.data = pixels.view(np.uint8)
        return message

    sensors = entry.dataset.as_json()["spec"]["sensors"]
    sensors["depth"]["camera"]["depthScale"] = stated
    found: dict[str, Finding] = found_in(spoil(entry, folder, change, {"sensors": sensors}))
    return found


@pytest.mark.parametrize(
    ("units", "ratio", "proposed"),
    [((1.0, 5000.0), 0.2, 1000.0), ((5.0, 1000.0), 5.0, 5000.0), ((0.5, 1000.0), 0.5, None)],
)
def test_another_unit_is_told(
    moving: DatasetEntry, tmp_path: Path, units: tuple[float, float], ratio: float, proposed: float | None
) -> None:
    found = stored(moving, tmp_path, *units)["depth.unit"]
    assert found.value == pytest.approx(ratio, rel=0.05)
    assert found.severity == "warning"
    assert found.repair == (sensor_repair("depth", depthScale=proposed) if proposed else {})


def test_the_stated_one_is_left_alone(moving: DatasetEntry, tmp_path: Path) -> None:
    assert "depth.unit" not in stored(moving, tmp_path, 5.0, 5000.0)
