# SPDX-License-Identifier: Apache-2.0
"""Pictures of messages, to be looked at: images as small JPEGs, clouds and scans from above.

Run pages and overviews of datasets show them. Depths and 16 bits lose their digits here: nothing is measured.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from slamhive.data.recordings.clouds import cloud_points
from slamhive.data.recordings.images import compressed_pixels, image_pixels

if TYPE_CHECKING:
    import numpy.typing as npt


def jpeg(message: Any, where: str, *, widest: int = 640, quality: int = 80) -> bytes:
    """Return an image (raw or compressed) as JPEG of 8 bits.

    Args:
        message: A sensor_msgs/Image or CompressedImage.
        where: What it is, for sentences.
        widest: Width that it has at most, px.
        quality: Of the JPEG, 0 to 100.

    Raises:
        DataError: It can't be read.
    """
    raw = hasattr(message, "encoding")
    pixels: npt.NDArray[Any] = image_pixels(message, where) if raw else compressed_pixels(message, where)
    if raw and message.encoding in {"rgb8", "rgba8"}:
        pixels = pixels[..., :3][..., ::-1]
    elif pixels.ndim == 3 and pixels.shape[2] == 4:
        pixels = pixels[..., :3]
    if pixels.dtype != np.uint8:
        # Depths have no brightness of their own: the farthest is the brightest.
        known = np.nan_to_num(pixels.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        pixels = (255 * known / max(float(known.max()), 1e-9)).astype(np.uint8)
    height, width = pixels.shape[:2]
    if width > widest:
        size = (widest, max(1, round(height * widest / width)))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", np.ascontiguousarray(pixels), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return bytes(encoded.tobytes())


def from_above(message: Any, where: str, most: int) -> npt.NDArray[np.float64]:
    """Return x and y of the points of a cloud or scan in its own frame, m, shape (n, 2).

    Args:
        message: A sensor_msgs/PointCloud2 or LaserScan.
        where: What it is, for sentences.
        most: Points to return at most, evenly chosen.

    Raises:
        DataError: It is damaged.
    """
    if hasattr(message, "ranges"):
        ranges = np.asarray(message.ranges, dtype=np.float64)
        angles = message.angle_min + np.arange(len(ranges)) * message.angle_increment
        ranges = np.where((ranges >= message.range_min) & (ranges <= message.range_max), ranges, np.nan)
        found = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles)))
    else:
        points = cloud_points(message, where)
        names = points.dtype.names or ()
        if "x" not in names or "y" not in names:
            return np.empty((0, 2))
        found = np.column_stack((points["x"].astype(np.float64), points["y"].astype(np.float64)))
    found = found[np.isfinite(found).all(axis=1)]
    chosen: npt.NDArray[np.float64] = found[:: max(1, -(-len(found) // most))]
    return chosen
