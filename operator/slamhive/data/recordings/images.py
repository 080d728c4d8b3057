# SPDX-License-Identifier: Apache-2.0
"""Images: their pixels, raw or compressed, and images at a lower resolution with their calibration."""

from __future__ import annotations

import struct
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
_TO_BGR = {
    # OpenCV names a pattern by the second pixels of its second row.
    "bayer_rggb": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg": cv2.COLOR_BayerGB2BGR,
}
BAYER = {f"{pattern}{bits}": (f"u{bits // 8}", 1) for pattern in _TO_BGR for bits in (8, 16)}
"""Pixel type and channels of raw data of sensors with colour filters; colours are made of it."""
_DEPTH_HEAD = struct.Struct("<iff")
"""Head of a compressedDepth image: a number of its form, and A and B of the quantisation of 32FC1."""
_MOST_PIXELS = 2**24
"""Pixels of a depth image at most: a few bytes of RVL could ask for all memory."""


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
        encoding=_scaled_encoding(camera.encoding),
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
    return with_pixels(message, resize(image_pixels(message, where), scale, nearest=depth))


def with_pixels(message: Any, pixels: npt.NDArray[Any]) -> Any:
    """Return a sensor_msgs/Image with other pixels, as `image_pixels` returns them: Bayer data as colours."""
    rows = pixels.view(np.uint8).reshape(len(pixels), -1)
    return replace(
        message,
        encoding=_scaled_encoding(message.encoding),
        height=pixels.shape[0],
        width=pixels.shape[1],
        step=rows.shape[1],
        is_bigendian=type(message.is_bigendian)(0),
        data=rows.reshape(-1),
    )


def _scaled_encoding(encoding: str) -> str:
    """Return the encoding of scaled images: Bayer data becomes colours."""
    return ("bgr16" if encoding.endswith("16") else "bgr8") if encoding in BAYER else encoding


def image_pixels(message: Any, where: str) -> npt.NDArray[Any]:
    """Return the pixels of a sensor_msgs/Image, (height, width[, channels]), in native byte order.

    Bayer data becomes colours, as BGR. Rows of 0 bytes, as some drivers state, are rows without padding.

    Raises:
        DataError: Its encoding isn't known, or it is damaged.
    """
    known = ENCODINGS | BAYER
    if message.encoding not in known:
        raise DataError(
            f"{where}: images are of an unknown encoding ({message.encoding!r}) and can't be read; allowed: "
            f"{', '.join(known)}"
        )
    letter, channels = known[message.encoding]
    order = ">" if message.is_bigendian else "<"
    used = message.width * channels * int(letter[1])
    step = message.step or used
    if step < used or message.data.size < step * message.height or used == 0:
        raise DataError(
            f"{where}: an image of {message.width}×{message.height} {message.encoding} has "
            f"{message.data.size} bytes in rows of {message.step}; {used * message.height} are needed"
        )
    rows = message.data[: step * message.height].reshape(message.height, step)[:, :used]
    pixels = np.ascontiguousarray(rows).view(f"{order}{letter}")
    shape = (message.height, message.width) if channels == 1 else (message.height, message.width, channels)
    pixels = pixels.reshape(shape).astype(letter, copy=False)
    pattern = message.encoding[: len("bayer_rggb")]
    return cv2.cvtColor(pixels, _TO_BGR[pattern]) if pattern in _TO_BGR else pixels


def scale_compressed(message: Any, scale: float, *, depth: bool, where: str) -> Any:
    """Return a sensor_msgs/CompressedImage at a lower resolution, compressed without loss (PNG).

    A compressedDepth image stays one, with its quantisation; at scale 1 this is a change from RVL to PNG.

    Raises:
        DataError: It can't be decoded.
    """
    if is_compressed_depth(message):
        stored = resize(_stored_depth(message, where), scale, nearest=True)
        head, described = message.data[: _DEPTH_HEAD.size], f"{depth_encoding(message)}; compressedDepth png"
    else:
        return compressed_anew(message, resize(compressed_pixels(message, where), scale, nearest=depth))
    encoded = cv2.imencode(".png", stored, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    return replace(message, format=described, data=np.concatenate((head, encoded.reshape(-1))))


def compressed_anew(message: Any, pixels: npt.NDArray[Any]) -> Any:
    """Return a sensor_msgs/CompressedImage with other pixels, compressed without loss (PNG)."""
    described = message.format.split(";")[0] + "; png compressed" if ";" in message.format else "png"
    encoded = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    return replace(message, format=described, data=encoded.reshape(-1))


def compressed_pixels(message: Any, where: str) -> npt.NDArray[Any]:
    """Return the pixels of a sensor_msgs/CompressedImage, (height, width[, channels]), colours as BGR.

    Depth of compressedDepth is what was compressed: uint16 of 16UC1, float32 in m of 32FC1, quantised by
    compressed_depth_image_transport as A / depth + B; 0 is no depth.

    Raises:
        DataError: It can't be decoded.
    """
    if is_compressed_depth(message):
        stored = _stored_depth(message, where)
        if depth_encoding(message) != "32FC1":
            return stored
        _, a, b = _DEPTH_HEAD.unpack_from(message.data)
        # A 0 in A would make all depths 0, which says that there are none.
        if not a > 0 or not np.isfinite((a, b)).all():
            raise DataError(f"{where}: depth ({message.format!r}) is quantised by A = {a:g}, B = {b:g}")
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = a / (stored - np.float64(b))
        return np.where((stored > 0) & np.isfinite(depth), depth, 0).astype(np.float32)
    pixels = cv2.imdecode(message.data, cv2.IMREAD_UNCHANGED) if message.data.size else None
    if pixels is None:
        raise DataError(
            f"{where}: a compressed image ({message.format!r}) can't be decoded; allowed: JPEG and PNG"
        )
    return pixels


def is_compressed_depth(message: Any) -> bool:
    """Tell whether a message is a CompressedImage of compressed_depth_image_transport."""
    return "compressedDepth" in getattr(message, "format", "")


def is_rvl(message: Any) -> bool:
    """Tell whether a message is depth compressed as RVL, which few programs read."""
    return is_compressed_depth(message) and message.format.strip().endswith("rvl")


def depth_encoding(message: Any) -> str:
    """Return the encoding of what a compressed depth image was made of, such as 16UC1."""
    return str(message.format.split(";")[0].strip())


def _stored_depth(message: Any, where: str) -> npt.NDArray[np.uint16]:
    """Return the numbers that a compressedDepth image holds, (height, width), 32FC1 as quantised.

    Raises:
        DataError: It is damaged, or compressed in another way than as PNG or RVL.
    """
    body = message.data[_DEPTH_HEAD.size :]
    try:
        if is_rvl(message):
            return _rvl(body)
        stored = cv2.imdecode(body, cv2.IMREAD_UNCHANGED) if body.size else None
    except ValueError as error:
        raise DataError(f"{where}: depth ({message.format!r}) is damaged: {error}") from None
    if stored is None or stored.dtype != np.uint16 or stored.ndim != 2:
        raise DataError(
            f"{where}: depth ({message.format!r}) can't be decoded; allowed: PNG of 16 bits, and RVL, each "
            f"after a head of {_DEPTH_HEAD.size} bytes"
        )
    return stored.astype(np.uint16, copy=False)


def _rvl(data: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint16]:
    """Decode depth of run lengths and variable lengths (Wilson, Fast Lossless Depth Image Compression, 2017).

    Numbers are groups of 4 bits, the lowest first, each 3 bits and one that says that another follows; eight
    groups are in a 32-bit word, the first in its highest bits. Numbers of pixels without and with depth take
    turns; after the latter come the differences of those depths, 0, -1, 1, -2 … as 0, 1, 2, 3 …

    Args:
        data: Width and height as int32, then the words.

    Raises:
        ValueError: Pixels are missing or too many.
    """
    width, height = struct.unpack_from("<ii", data.tobytes()) if data.size >= 8 else (0, 0)
    if not (width > 0 and height > 0 and width * height <= _MOST_PIXELS):
        raise ValueError(f"an image of {width}×{height} pixels")
    words = np.frombuffer(data[8 : 8 + (data.size - 8) // 4 * 4].tobytes(), dtype="<u4")
    groups = (words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32) & 15).reshape(-1).astype(np.int64)
    ends = np.flatnonzero(groups < 8)
    starts = np.concatenate(([0], ends[:-1] + 1)) if ends.size else ends
    groups = groups[: ends[-1] + 1] if ends.size else groups[:0]
    place = np.arange(len(groups)) - np.repeat(starts, ends - starts + 1)
    # A number has at most 6 groups: 17 bits of a difference, or the number of pixels.
    numbers = np.add.reduceat((groups & 7) << 3 * np.minimum(place, 10), starts) if starts.size else groups
    steps, known = np.zeros(width * height, dtype=np.int64), np.zeros(width * height, dtype=bool)
    at = k = 0
    while at < len(steps):
        if k + 1 >= len(numbers):
            raise ValueError(f"it ends after {at} of {len(steps)} pixels")
        at, count = at + int(numbers[k]), int(numbers[k + 1])
        coded = numbers[k + 2 : k + 2 + count]
        if at + count > len(steps) or len(coded) < count:
            raise ValueError(f"a run of {count} pixels after {at} of {len(steps)}")
        steps[at : at + count], known[at : at + count] = coded >> 1 ^ -(coded & 1), True
        at, k = at + count, k + 2 + count
    steps[known] = np.cumsum(steps[known])
    return steps.astype(np.uint16).reshape(height, width)
