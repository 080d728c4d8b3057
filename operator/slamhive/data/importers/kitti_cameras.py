# SPDX-License-Identifier: Apache-2.0
"""Calibration files of KITTI, and the rectified cameras that their projection matrices describe."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.importers.contents import camera_encoding, camera_pixels, camera_stream
from slamhive.data.importers.scans import mean_rate
from slamhive.model.errors import DataError
from slamhive.model.sensors import Camera, Sensor

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers.contents import SensorStream

    Array = npt.NDArray[np.float64]
    Stamps = npt.NDArray[np.int64]


def read_calibration(path: Path, sizes: Mapping[str, int]) -> dict[str, Array]:
    """Read the lines "key: numbers" of a calibration file.

    Args:
        path: The file.
        sizes: How many numbers there must be, by key; other keys are left out.

    Raises:
        DataError: It is missing, or a key is, or has other numbers.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: {getattr(error, 'strerror', None) or 'not a text file'}") from None
    found: dict[str, Array] = {}
    for line, content in enumerate(text.splitlines(), start=1):
        key, _, rest = content.partition(":")
        key = key.strip()
        if key not in sizes:
            continue
        try:
            numbers = np.array(rest.split(), dtype=np.float64)
        except ValueError:
            numbers = np.empty(0)
        if numbers.size != sizes[key] or not np.isfinite(numbers).all():
            raise DataError(
                f"{path}, line {line}: {key}: {sizes[key]} numbers are needed, found {rest.strip()!r}"
            )
        found[key] = numbers
    missing = [key for key in sizes if key not in found]
    if missing:
        raise DataError(f"{path}: no line {missing[0]!r} in it; needed: {', '.join(sizes)}")
    return found


def camera_names(numbers: Collection[int]) -> dict[int, str]:
    """Return the names of KITTI's cameras by number: 0 and 1 are a grey pair, 2 and 3 a coloured one.

    The first pair that is complete is left and right; without one, the first camera is ``camera``.
    """
    pair = next((pair for pair in ((0, 1), (2, 3)) if {*pair} <= {*numbers}), ())
    names = dict(zip(pair, ("left", "right"), strict=False))
    for number in sorted(numbers):
        names.setdefault(number, f"camera{number}" if names else "camera")
    return names


def kitti_camera(
    number: int,
    name: str,
    projection: Array,
    stamps: Stamps,
    files: Sequence[Path],
    *,
    first: Array,
    source: Path,
    notes: list[str],
    size: tuple[int, int] | None = None,
) -> SensorStream:
    """Return the stream of a rectified camera.

    Args:
        number: 0 to 3.
        name: Of the sensor.
        projection: P, (3, 4): from the rectified frame of camera 0 to pixels, K·[I | t].
        stamps: ns, shape (n,).
        files: Its images, n ≥ 1.
        first: Pose in the body of the rectified frame of camera 0, (4, 4).
        source: The calibration file, for messages.
        notes: To which is added that 16 bits become 8.
        size: Width and height that it states, if it does.

    Raises:
        DataError: The calibration isn't that of the images.
    """
    pixels = camera_pixels(files[0])
    height, width = pixels.shape[:2]
    if size is not None and size != (width, height):
        raise DataError(
            f"{source} says {size[0]}×{size[1]} pixels of camera {number}, but {files[0]} has "
            f"{width}×{height}"
        )
    (fx, _, cx, _), (_, fy, cy, _) = projection[0], projection[1]
    if fx <= 0 or fy <= 0 or not (0 < cx < width and 0 < cy < height):
        raise DataError(
            f"{source}: camera {number}: focal lengths {fx:g}, {fy:g} and principal point ({cx:g}, {cy:g}) "
            f"can't be those of {files[0]} with {width}×{height} pixels"
        )
    offset = np.eye(4)
    offset[:3, 3] = -np.linalg.solve(projection[:, :3], projection[:, 3]) + 0.0
    encoding = camera_encoding(files[0], f"image_{number}", notes)
    camera = {"width": width, "height": height, "encoding": encoding}
    lens = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": "None"}
    declared: dict[str, Any] = {
        "type": "Camera",
        "topic": f"/image_{number}/image_raw",
        "frameId": f"image_{number}",
        "rate": mean_rate(stamps),
        "T_body_sensor": (first @ offset).tolist(),
        "camera": Camera.model_validate(camera | lens),
    }
    return camera_stream(name, Sensor.model_validate(declared), stamps, [*files], source)
