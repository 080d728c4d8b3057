# SPDX-License-Identifier: Apache-2.0
"""Images at a lower resolution, and the calibration that goes with them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from slamhive.model.errors import DataError

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.model.sensors import Camera

ENCODINGS: dict[str, tuple[str, int]] = {
    "mono8": ("u1", 1),
    "8UC1": ("u1", 1),
    "rgb8": ("u1", 3),
    "bgr8": ("u1", 3),
    "8UC3": ("u1", 3),
    "rgba8": ("u1", 4),
    "bgra8": ("u1", 4),
    "8UC4": ("u1", 4),
    "mono16": ("u2", 1),
    "16UC1": ("u2", 1),
    "rgb16": ("u2", 3),
    "bgr16": ("u2", 3),
    "32FC1": ("f4", 1),
}
"""Pixel type and channels of the encodings that are read."""


def scaled_size(width: int, height: int, scale: float) -> tuple[int, int]:
    """Return the size in whole pixels of a scaled image."""
    return max(1, round(width * scale)), max(1, round(height * scale))


def scale_matrix(matrix: npt.NDArray[np.float64], sx: float, sy: float) -> npt.NDArray[np.float64]:
    """Scale K (3, 3) or P (3, 4) to another image size.

    The centre of the first pixel is 0, so its left edge, which stays where it is, is at -0.5:
    f' = f·s, Tx' = Tx·s, c' = (c + 0.5)·s - 0.5.

    Args:
        matrix: The matrix.
        sx: New width / old width, of the sizes in whole pixels.
        sy: New height / old height.
    """
    result = np.array(matrix, dtype=np.float64)
    for row, factor in ((0, sx), (1, sy)):
        result[row] *= factor
        result[row, 2] += 0.5 * factor - 0.5
    return result


def scale_camera(camera: Camera, scale: float) -> Camera:
    """Return the intrinsics of a camera whose images are scaled; distortion and mirror stay."""
    width, height = scaled_size(camera.width, camera.height, scale)
    sx, sy = width / camera.width, height / camera.height
    return camera.replace(
        width=width,
        height=height,
        fx=camera.fx * sx,
        fy=camera.fy * sy,
        cx=(camera.cx + 0.5) * sx - 0.5,
        cy=(camera.cy + 0.5) * sy - 0.5,
    )


def scale_camera_info(message: Any, scale: float, where: str) -> Any:
    """Return a CameraInfo (of either ROS) for scaled images: K and P change, D and R stay.

    Raises:
        DataError: It doesn't state the size of the images.
    """
    if message.width == 0 or message.height == 0:
        raise DataError(f"{where}: states no image size (width and height are 0), so it can't be scaled")
    width, height = scaled_size(message.width, message.height, scale)
    sx, sy = width / message.width, height / message.height
    k, p = ("K", "P") if hasattr(message, "K") else ("k", "p")
    matrix, projection = np.reshape(getattr(message, k), (3, 3)), np.reshape(getattr(message, p), (3, 4))
    roi = replace(
        message.roi,
        x_offset=round(message.roi.x_offset * sx),
        y_offset=round(message.roi.y_offset * sy),
        width=round(message.roi.width * sx),
        height=round(message.roi.height * sy),
    )
    changes = {
        # An uncalibrated camera has zeros, which stay zeros.
        k: scale_matrix(matrix, sx, sy).reshape(-1) if matrix.any() else matrix.reshape(-1),
        p: scale_matrix(projection, sx, sy).reshape(-1) if projection.any() else projection.reshape(-1),
    }
    return replace(message, width=width, height=height, roi=roi, **changes)


def resize(pixels: npt.NDArray[Any], scale: float, *, nearest: bool) -> npt.NDArray[Any]:
    """Scale an image (height, width[, channels]).

    Args:
        pixels: The image.
        scale: At most 1.
        nearest: Take the pixel under each new pixel's centre, as depth needs it: a mean of two depths is the
            depth of nothing. Otherwise the mean over each new pixel's area.
    """
    height, width = pixels.shape[:2]
    size = scaled_size(width, height, scale)
    if nearest:
        columns = np.minimum(((np.arange(size[0]) + 0.5) * width / size[0]).astype(np.intp), width - 1)
        rows = np.minimum(((np.arange(size[1]) + 0.5) * height / size[1]).astype(np.intp), height - 1)
        return np.ascontiguousarray(pixels[rows[:, None], columns])
    return cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)


def scale_image(message: Any, scale: float, *, depth: bool, where: str) -> Any:
    """Return a sensor_msgs/Image at a lower resolution.

    Raises:
        DataError: Its encoding can't be scaled, or it is damaged.
    """
    pixels = image_pixels(message, where)
    scaled = resize(pixels, scale, nearest=depth)
    rows = scaled.view(np.uint8).reshape(len(scaled), -1)
    return replace(
        message,
        height=scaled.shape[0],
        width=scaled.shape[1],
        step=rows.shape[1],
        is_bigendian=type(message.is_bigendian)(0),
        data=rows.reshape(-1),
    )


def image_pixels(message: Any, where: str) -> npt.NDArray[Any]:
    """Return the pixels of a sensor_msgs/Image, (height, width[, channels]), in native byte order.

    Raises:
        DataError: Its encoding isn't known, or it is damaged.
    """
    if message.encoding not in ENCODINGS:
        kind = "raw Bayer data" if message.encoding.startswith("bayer") else "of an unknown encoding"
        raise DataError(
            f"{where}: images are {kind} ({message.encoding!r}) and can't be read; allowed: "
            f"{', '.join(ENCODINGS)}"
        )
    letter, channels = ENCODINGS[message.encoding]
    order = ">" if message.is_bigendian else "<"
    used = message.width * channels * int(letter[1])
    if message.step < used or message.data.size < message.step * message.height or used == 0:
        raise DataError(
            f"{where}: an image of {message.width}×{message.height} {message.encoding} has "
            f"{message.data.size} bytes in rows of {message.step}; {used * message.height} are needed"
        )
    rows = message.data[: message.step * message.height].reshape(message.height, message.step)[:, :used]
    pixels = np.ascontiguousarray(rows).view(f"{order}{letter}")
    shape = (message.height, message.width) if channels == 1 else (message.height, message.width, channels)
    return pixels.reshape(shape).astype(letter, copy=False)


def scale_compressed(message: Any, scale: float, *, depth: bool, where: str) -> Any:
    """Return a sensor_msgs/CompressedImage at a lower resolution, compressed without loss (PNG).

    Raises:
        DataError: It can't be decoded.
    """
    scaled = resize(compressed_pixels(message, where), scale, nearest=depth)
    encoded = cv2.imencode(".png", scaled, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    described = message.format.split(";")[0] + "; png compressed" if ";" in message.format else "png"
    return replace(message, format=described, data=encoded.reshape(-1))


def compressed_pixels(message: Any, where: str) -> npt.NDArray[Any]:
    """Return the pixels of a sensor_msgs/CompressedImage, (height, width[, channels]), colours as BGR.

    Raises:
        DataError: It can't be decoded.
    """
    pixels = None
    if "compressedDepth" not in message.format and message.data.size:
        pixels = cv2.imdecode(message.data, cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise DataError(
            f"{where}: a compressed image ({message.format!r}) can't be decoded; allowed: JPEG and PNG"
        )
    return pixels
