# SPDX-License-Identifier: Apache-2.0
"""Frames of folders without stamps, taken at an assumed rate, and depth images; dense datasets use it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.importers.contents import (
    SensorStream,
    camera_pixels,
    camera_stream,
    depth_encoding,
    encoding_of,
)
from slamhive.model.errors import DataError
from slamhive.model.sensors import Camera, Sensor

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    import numpy.typing as npt

    Stamps = npt.NDArray[np.int64]
    Pixels = npt.NDArray[Any]

FIRST = 10**9
"""Stamp of the first frame, ns: 0 means that there is no stamp."""


def frame_stamps(count: int, rate: float, notes: list[str]) -> Stamps:
    """Return stamps for frames that have none, ns, shape (count,); a note says so."""
    notes.append(f"there are no time stamps: {rate:g} Hz is assumed, beginning at {FIRST / 1e9:g} s")
    stamps: Stamps = FIRST + np.rint(np.arange(count) * (1e9 / rate)).astype(np.int64)
    return stamps


def require_frames(files: Mapping[str, Sequence[Path]], poses: int, path: Path) -> None:
    """Check that all series of images have a pose for each of theirs.

    Args:
        files: Images of each series by its folder or pattern.
        poses: How many there are.
        path: Their file.

    Raises:
        DataError: A number differs.
    """
    for name, images in files.items():
        if len(images) != poses:
            raise DataError(f"{name}: {len(images)} images, but {path} has {poses} poses")


def view_stream(
    name: str,
    stamps: Stamps,
    files: Sequence[Path],
    lens: Mapping[str, Any],
    *,
    frame: str,
    source: str,
    pose: npt.NDArray[np.float64] | None = None,
    depth: tuple[float, Callable[[Path], Pixels]] | None = None,
) -> SensorStream:
    """Return the stream of a camera without distortion, of colours or of depth.

    Args:
        name: Of the sensor.
        stamps: ns, shape (n,).
        files: Its images, n ≥ 1.
        lens: width, height, fx, fy, cx, cy.
        frame: Name of its frame; topics are named after it.
        source: What states the lens, for messages.
        pose: T_body_sensor, (4, 4); None: the body is the camera.
        depth: Of a depth camera: units per metre, and what reads an image.

    Raises:
        DataError: The first image is missing or of another size.
    """
    rate = float(f"{1e9 / np.diff(stamps).mean():.6g}") if len(stamps) > 1 else None
    pixels = camera_pixels(files[0]) if depth is None else depth[1](files[0])
    if pixels.shape[:2] != (lens["height"], lens["width"]):
        raise DataError(
            f"{files[0]}: {pixels.shape[1]}×{pixels.shape[0]} pixels, but {source} is for "
            f"{lens['width']}×{lens['height']}"
        )
    encoding = encoding_of(pixels) if depth is None else depth_encoding(pixels)
    camera = Camera.model_validate(
        {**lens, "encoding": encoding, "distortion": "None", "depthScale": depth[0] if depth else None}
    )
    sensor = Sensor.model_validate(
        {
            "type": "Camera" if depth is None else "DepthCamera",
            "topic": f"/{frame}/image_raw",
            "frameId": frame,
            "rate": rate,
            "T_body_sensor": (np.eye(4) if pose is None else pose).tolist(),
            "camera": camera,
        }
    )
    read = None if depth is None else depth[1]
    return camera_stream(name, sensor, stamps, [*files], source, read_depth=read)
