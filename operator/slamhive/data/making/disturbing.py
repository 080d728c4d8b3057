# SPDX-License-Identifier: Apache-2.0
"""Images and LiDAR scans made worse, each as one function of a message; `perturbing` says of which."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from slamhive.data.recordings.clouds import chosen_points, cloud_points
from slamhive.data.recordings.images import compressed_anew, compressed_pixels, image_pixels, with_pixels
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    from slamhive.model.run import ImagesPerturbation, LidarPerturbation

    Numbers = Callable[..., np.random.Generator]
    Pixels = npt.NDArray[Any]
    Ranges = npt.NDArray[np.float64]
    Ways = npt.NDArray[np.float64]

_BYTE = 255
_VALUES, _PIECE = 2**20, 2**16
"""Numbers of noise that images take pieces of, and the length of a piece."""

STEP_SECONDS = 1.0
"""Time for which an exposure stays as it is, s."""


RAIN_METRES = 5.0
"""Mean range of returns from drops where nothing is behind them, m: chosen, as rains differ."""


@dataclass(frozen=True)
class Weather:
    """Disturbance of the scans of one LiDAR.

    Attributes:
        wanted: What is done to them.
        numbers: Opens the random numbers of a purpose and message.
        nearest: Range from which on it has returns, m.
    """

    wanted: LidarPerturbation
    numbers: Numbers
    nearest: float = 0.0

    @property
    def is_idle(self) -> bool:
        """Tell whether the points stay as they are."""
        one = self.wanted
        return not any((one.range_noise, one.drop_points, one.sector, one.rain))


def disturbed_scan(message: Any, weather: Weather, index: int, where: str) -> Any:
    """Return a PointCloud2 with other ranges, and without some of its points.

    Args:
        message: The scan.
        weather: What is done to it.
        index: Number of the scan.
        where: What it is, for messages.

    Raises:
        DataError: Its points have no positions, or it is damaged.
    """
    points = cloud_points(message, where)
    names = points.dtype.names or ()
    if missing := [axis for axis in "xyz" if axis not in names]:
        raise DataError(f"{where}: points have no field {missing[0]!r}; they have: {', '.join(names)}")
    wanted, numbers = weather.wanted, weather.numbers
    # In the precision of the points themselves, but for those of whole numbers.
    kind = np.result_type(np.float32, *(points.dtype[axis] for axis in "xyz"))
    x, y, z = (points[axis].astype(kind) for axis in "xyz")
    stay = None
    if wanted.sector:
        stay = np.abs(np.arctan2(y, x)) <= math.pi - math.radians(wanted.sector) / 2
    if wanted.drop_points:
        kept = numbers("dropPoints", index=index).random(len(points)) >= wanted.drop_points
        stay = kept if stay is None else stay & kept
    if wanted.rain or wanted.range_noise:
        true = np.sqrt(x * x + y * y + z * z)
        ranges = true
        if wanted.rain:
            ranges = _through_rain(true, wanted.rain, weather.nearest, numbers("rain", index=index))
        if wanted.range_noise:
            drawn = numbers("rangeNoise", index=index).standard_normal(len(points), dtype=np.float32)
            noisy = ranges + drawn * np.float32(wanted.range_noise)
            # What would be behind the sensor stays where it is.
            ranges = np.where(noisy > 0, noisy, ranges)
        # As does what is no return.
        moves = (true > 0) & np.isfinite(true)
        scale = np.where(moves, ranges, 1.0) / np.where(moves, true, 1.0)
        for axis, values in zip("xyz", (x, y, z), strict=True):
            points[axis] = values * scale
    return chosen_points(message, points, stay)


def _through_rain(true: Ranges, share: float, nearest: float, drawn: np.random.Generator) -> Ranges:
    """Return ranges of which a share is that of something in the way.

    Those are distributed as e^(-r / L) between the nearest range and the true one (unexpected objects in
    Thrun, Burgard, Fox, Probabilistic Robotics, 2005, 6.3.1, eq. 6.7 and 6.8).

    Args:
        true: Ranges, m, shape (n,).
        share: Of them that meet something.
        nearest: Range that a return has at least, m.
        drawn: The random numbers.
    """
    chance, place = drawn.random((2, len(true)))
    depth = true - nearest
    wet = (chance < share) & (depth > 0) & np.isfinite(depth)
    # The inverse of the distribution, cut off at the depth.
    nearer = nearest - RAIN_METRES * np.log1p(place * np.expm1(-np.where(wet, depth, 0.0) / RAIN_METRES))
    return np.where(wet, nearer, true)


class Shutter:
    """Disturbance of the images of one camera.

    Args:
        wanted: What is done to them.
        numbers: Opens the random numbers of a purpose and message.
        ways: Way of each image's middle over the exposure, px, shape (n, 2); None: it doesn't move.
    """

    def __init__(self, wanted: ImagesPerturbation, numbers: Numbers, ways: Ways | None = None) -> None:
        self._wanted = wanted
        self._numbers = numbers
        self._ways = ways
        self._tables: dict[bool, Pixels] = {}
        self._making = Lock()
        self._numbers_of_noise: Pixels | None = None

    @property
    def is_idle(self) -> bool:
        """Tell whether the pixels stay as they are."""
        one = self._wanted
        found = (one.blur, one.noise, one.exposure_step, one.jpeg_quality, one.occlusion)
        return not any(found) and one.gamma in {None, 1} and self._ways is None

    def disturbed(self, pixels: Pixels, index: int, nanoseconds: int) -> Pixels:
        """Return an image after all that befalls it: optics first, then the sensor, then the compression.

        Args:
            pixels: Of 8 or 16 bits, (height, width[, channels]).
            index: Number of the image.
            nanoseconds: Time since the camera's first image.
        """
        one, most = self._wanted, int(np.iinfo(pixels.dtype).max)
        if one.occlusion:
            pixels = pixels.copy()
            rows, columns = self._covered(*pixels.shape[:2])
            pixels[rows, columns] = 0
        if one.blur:
            pixels = _smeared(pixels, self._trace)
        if self._ways is not None and np.linalg.norm(self._ways[index]) >= _SHARP:
            pixels = _smeared(pixels, trace_of(*self._ways[index].tolist()))
        brighter = bool(one.exposure_step) and bool(int(nanoseconds / 1e9 // STEP_SECONDS) % 2)
        if brighter or one.gamma not in {None, 1}:
            table = self._table(brighter, pixels.dtype)
            pixels = np.asarray(cv2.LUT(pixels, table)) if most == _BYTE else table[pixels]
        if one.noise:
            pixels = self._noisy(pixels, index)
        if one.jpeg_quality:
            pixels = _through_jpeg(pixels, one.jpeg_quality)
        return pixels

    def _table(self, brighter: bool, kind: np.dtype[Any]) -> Pixels:
        """Return the brightness that each brightness becomes."""
        if brighter not in self._tables:
            one, most = self._wanted, int(np.iinfo(kind).max)
            shares = np.arange(most + 1) / most * (2.0 ** (one.exposure_step or 0.0) if brighter else 1.0)
            table = np.clip(shares, 0.0, 1.0) ** (one.gamma or 1.0)
            self._tables[brighter] = np.rint(table * most).astype(kind)
        return self._tables[brighter]

    def _noisy(self, pixels: Pixels, index: int) -> Pixels:
        """Return an image with noise: pieces of one long row of numbers, from places drawn for each image.

        Drawing numbers for each pixel would take longer than all else that is done to an image.
        """
        noise = self._noise(pixels.dtype)
        drawn = self._numbers("noise", index=index)
        flat = np.ascontiguousarray(pixels).reshape(-1)
        found = np.empty_like(flat)
        depth = cv2.CV_8U if pixels.dtype == np.uint8 else cv2.CV_16U
        for begin in range(0, len(flat), _PIECE):
            piece = flat[begin : begin + _PIECE]
            start = int(drawn.integers(0, len(noise) - _PIECE))
            # Sums are cut off at the ends of the range.
            total = cv2.add(piece[None], noise[None, start : start + len(piece)], dtype=depth)
            found[begin : begin + _PIECE] = np.asarray(total)[0]
        return found.reshape(pixels.shape)

    def _noise(self, kind: np.dtype[Any]) -> Pixels:
        """Return whole numbers that are normally distributed, shape (n,)."""
        with self._making:
            if self._numbers_of_noise is None:
                sigma = (self._wanted.noise or 0.0) * int(np.iinfo(kind).max) / _BYTE
                drawn = self._numbers("noise values").standard_normal(_VALUES, dtype=np.float32)
                whole = np.int16 if kind == np.uint8 else np.int32
                self._numbers_of_noise = np.rint(drawn * np.float32(sigma)).astype(whole)
        return self._numbers_of_noise

    @cached_property
    def _trace(self) -> Ways:
        return trace_of(float(self._wanted.blur or 0.0), 0.0)

    def _covered(self, height: int, width: int) -> tuple[slice, slice]:
        """Return the rows and columns of a rectangle in the image's shape, at the same place in all."""
        side = math.sqrt(self._wanted.occlusion or 0.0)
        rows, columns = round(height * side), round(width * side)
        down, right = self._numbers("occlusion").random(2)
        top, left = round(down * (height - rows)), round(right * (width - columns))
        return slice(top, top + rows), slice(left, left + columns)


_SHARP = 0.01
"""Way over an exposure that leaves no trace in whole numbers, px."""


def trace_of(right: float, down: float) -> Ways:
    """Return weights of neighbours for a motion in a straight line, shape (rows, columns).

    It is linear between pixels. Between places where the line crosses rows or columns of pixels they are of
    degree two, so that Simpson's rule is exact.

    Args:
        right: Length of the motion along the rows, px; the image stands for its middle.
        down: Its length along the columns, px.
    """
    cuts = [np.array([-0.5, 0.5])]
    for way in (right, down):
        reach = math.floor(abs(way) / 2)
        cuts.append(np.arange(-reach, reach + 1) / (way or 1.0))
    ends = np.unique(np.concatenate(cuts))
    steps = np.diff(ends)
    places = np.concatenate([ends[:-1], (ends[:-1] + ends[1:]) / 2, ends[1:]])
    shares = np.concatenate([steps / 6, steps * 4 / 6, steps / 6])
    (rows, up), (columns, left) = (_around(way * places) for way in (down, right))
    sides = [math.ceil(abs(way) / 2) + 1 for way in (down, right)]
    weights = np.zeros([2 * side + 1 for side in sides])
    for i, of_row in ((0, 1 - up), (1, up)):
        for j, of_column in ((0, 1 - left), (1, left)):
            np.add.at(weights, (rows + i + sides[0], columns + j + sides[1]), shares * of_row * of_column)
    return weights


def _around(places: Ways) -> tuple[npt.NDArray[np.intp], Ways]:
    """Return the pixels before some places, and how far beyond them these are, 0 to 1."""
    before = np.floor(places)
    return before.astype(np.intp), places - before


def _smeared(pixels: Pixels, trace: Ways) -> Pixels:
    return np.asarray(cv2.filter2D(pixels, -1, trace, borderType=cv2.BORDER_REPLICATE))


def _through_jpeg(pixels: Pixels, quality: int) -> Pixels:
    if pixels.dtype != np.uint8:
        raise DataError("input.perturb.images.jpegQuality takes images of 8 bits, these have 16")
    encoded = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    decoded: Any = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED)
    return np.asarray(decoded)


_RED_FIRST = ("rgb8", "rgba8", "rgb16")


def disturbed_image(message: Any, shutter: Shutter, index: int, nanoseconds: int, where: str) -> Any:
    """Return an Image or CompressedImage of a camera, disturbed; transparency stays.

    Args:
        message: The image.
        shutter: What is done to it.
        index: Number of the image.
        nanoseconds: Time since the camera's first image.
        where: What it is, for messages.

    Raises:
        DataError: It can't be read, or has no 8 or 16 bits; for JPEG, no 8.
    """
    if shutter.is_idle:
        return message
    is_raw = hasattr(message, "encoding")
    pixels = image_pixels(message, where) if is_raw else compressed_pixels(message, where)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise DataError(
            f"{where}: input.perturb.images takes images of 8 or 16 bits, these are {pixels.dtype}"
        )
    colors = pixels[..., :3] if pixels.ndim == 3 else pixels
    is_red_first = is_raw and message.encoding in _RED_FIRST
    if is_red_first:
        colors = colors[..., ::-1]
    found = shutter.disturbed(np.ascontiguousarray(colors), index, nanoseconds)
    if is_red_first:
        found = found[..., ::-1]
    if found.shape != pixels.shape:
        found = np.dstack([found, pixels[..., 3:]])
    found = np.ascontiguousarray(found)
    return with_pixels(message, found) if is_raw else compressed_anew(message, found)
