# SPDX-License-Identifier: Apache-2.0
"""Turning of a camera or LiDAR between its frames, by what it sees.

Of a camera corners are followed from image to image (Lucas and Kanade 1981), and the turn is that of the
essential matrix (Nister 2004), refined on all that fit. Of a LiDAR the points of a scan are laid onto planes
of the scan before (Chen and Medioni 1992), which are taken from cells of space.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from slamhive.data.doctor.turning import SPAN, Turns, cross_of, exp_of, log_of
from slamhive.data.recordings.clouds import cloud_points, point_times
from slamhive.data.recordings.images import compressed_pixels, image_pixels
from slamhive.model.errors import DataError
from slamhive.model.sensors import SensorType, TimesSince

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from slamhive.data.doctor.turning import Array, Turning
    from slamhive.data.recordings.reading import Recording, Scan
    from slamhive.model.sensors import Camera, Sensor

_PAIRS = {SensorType.CAMERA: 200, SensorType.LIDAR: 100}
"""Pairs of frames of a sensor that are looked at, which bounds what a long recording takes; half as many
where there are several sensors of its kind."""
_STRETCHES = 5
"""Parts of a recording from each of which its most turning stretch is taken."""
_LONGEST = 1.0
"""Seconds between frames above which they show too little of the same."""
_WIDTH = 480
"""Pixels of an image's width at which corners are followed."""
FEWEST_CORNERS, _CORNERS = 20, 100
_TRIES, _MISSES = 100, 20
"""Samples of corners that are tried, as most that are followed are right, and pairs of images in a row that
tell nothing, after which a stretch is given up."""
SEEN = 1.0
"""Pixels that a corner may be off where it must go."""
_POINTS, _MOST_POINTS = 1200, 6000
_SCANS = 6
"""Scans that a scan is laid onto: by the last one alone, errors of each pair would add up to a slow drift."""
_FEWEST_POINTS = 200
_FEWEST_PLANES = 6
_CELL_SHARE, _CELLS = 0.2, (0.4, 3.0)
"""Size of cells, of the median range, and in m: a wall is in many of them, of a room or of a street."""
_LEAST_IN_CELL = {1: 6, 2: 18}
"""Points of a plane in a cell, and in one of twice the size: of fewer, few rings would seem to tell."""
_FLAT, _LINE = 0.05, 0.05
"""Shares of a cell's variances: thinner than the one is a plane, narrower than the other a single ring."""
_ROUNDS = 6
_SCAN_ROUNDS = {2: 2, 1: 4}
"""Rounds at each size of cells: the larger are but to begin near enough."""
_ACROSS = [3, 4]
_MIDDLE = 2**20
_EVEN = sum((2**21 - 2) << place for place in (0, 21, 42))
_MIDDLE_HALVED = sum((_MIDDLE // 2) << place for place in (0, 21, 42))
"""Number of the cell at zero; what cuts the last digit of all three; and what moves them back when halved."""
_ROWS, _COLUMNS = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]
_SETTLED = 2e-4
"""Rad, and m, below which another round changes nothing."""


def turns_of(  # noqa: PLR0917 - what is looked at, then how
    recording: Recording,
    sensor: Sensor,
    scan: Scan,
    reference: Turning,
    alike: int = 1,
    progress: Callable[[float], None] = lambda _: None,
) -> Turns | None:
    """Return the turns of a camera or LiDAR from frame to frame, where it turned most.

    Args:
        recording: The open recording.
        sensor: The sensor.
        scan: Times of its messages.
        reference: Turning by which stretches are chosen.
        alike: Sensors of its kind.
        progress: Called with the share of the frames that are looked at, 0 to 1.

    Returns:
        None where its frames can't tell.
    """
    if len(scan.stamps) < 2 or (sensor.type is SensorType.CAMERA and not _is_known(sensor.camera)):
        return None
    spans: list[tuple[float, float, Array]] = []
    most = _PAIRS[sensor.type] // min(alike, 2)
    for frames in _stretches(recording, sensor, scan, reference, most, progress):
        try:
            spans += _seen(frames, sensor) if sensor.type is SensorType.CAMERA else _scanned(frames, sensor)
        except (DataError, cv2.error):
            # What can't be decoded is told of by the judgements of images and points.
            continue
    if not spans:
        return None
    begin, end, rates = (np.array(column) for column in zip(*spans, strict=True))
    return Turns(begin, end, rates)


def _stretches(  # noqa: PLR0917 - as `turns_of`
    recording: Recording,
    sensor: Sensor,
    scan: Scan,
    reference: Turning,
    most: int,
    progress: Callable[[float], None],
) -> Iterator[Iterator[tuple[float, Any]]]:
    """Yield stretches of frames, each with its time in s, of as many pairs as may be looked at."""
    seconds = scan.stamps / 1e9 + sensor.time_offset
    period = float(np.median(np.diff(np.sort(seconds))))
    count = len(seconds)
    stride = max(1, round(SPAN / max(period, 1e-3) * 0.75)) if sensor.type is SensorType.CAMERA else 1
    length = most * stride
    parts = [(0, count)]
    if count > length:
        length //= _STRETCHES
        _, rates = reference.over(seconds, seconds + max(period, 1e-3))
        power = np.concatenate(([0.0], np.cumsum(np.sum((rates - np.median(rates, axis=0)) ** 2, axis=1))))
        edges = np.linspace(0, count, _STRETCHES + 1).astype(np.intp)
        parts = []
        for low, high in pairwise(edges.tolist()):
            begins = np.arange(low, max(low + 1, high - length))
            ends = np.minimum(begins + length, count)
            best = int(np.argmax(power[ends] - power[begins]))
            parts.append((int(begins[best]), int(ends[best])))
    kind = recording.topics[sensor.topic].message_type

    def frames(low: int, high: int, before: int) -> Iterator[tuple[float, Any]]:
        # By record time; others that have the first one's come with it.
        number = int(np.searchsorted(scan.times, scan.times[low]))
        for _, _, raw in recording.messages(
            {sensor.topic}, int(scan.times[low]), int(scan.times[high - 1]) + 1
        ):
            if low <= number < high and (number - low) % stride == 0:
                progress((before + number - low) / total)
                yield float(seconds[number]), recording.decode(raw, kind)
            number += 1

    before, total = 0, sum(high - low for low, high in parts)
    for low, high in parts:
        yield frames(low, high, before)
        before += high - low


def _is_known(camera: Camera | None) -> bool:
    return camera is not None and camera.model == "Pinhole"


def _seen(frames: Iterator[tuple[float, Any]], sensor: Sensor) -> Iterator[tuple[float, float, Array]]:
    """Yield spans between images and the camera's mean turning rates over them."""
    camera = sensor.camera
    if camera is None:
        return
    spans, views = [], []
    before: tuple[float, Array] | None = None
    missed, scale = 0, 1.0
    for time, message in frames:
        image, scale = grey_of(message, sensor, camera)
        if before is not None and 0 < time - before[0] < _LONGEST:
            view = _view_between(before[1], image, camera, scale)
            missed = missed + 1 if view is None else 0
            if view is not None:
                spans.append((before[0], time))
                views.append(view)
            if missed == _MISSES:
                break
        before = time, image
    limit = SEEN * scale / camera.fx
    for (begin, end), matrix in zip(spans, _refined(views, limit) if views else (), strict=True):
        yield begin, end, -log_of(matrix) / (end - begin)


def grey_of(message: Any, sensor: Sensor, camera: Camera) -> tuple[Any, float]:
    """Return an image in grey, 8 bits, no wider than corners are followed in, and pixels in one of it."""
    read = image_pixels if hasattr(message, "encoding") else compressed_pixels
    pixels = read(message, sensor.topic)
    stated, shrink = camera.width / pixels.shape[1], -(-pixels.shape[1] // _WIDTH)
    if shrink > 1:
        # By a whole number, a tenth of the work of another one.
        height, width = (length // shrink for length in pixels.shape[:2])
        whole = pixels[: height * shrink, : width * shrink]
        pixels = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    if pixels.ndim == 3:
        pixels = pixels[:, :, 1] if pixels.shape[2] > 1 else pixels[:, :, 0]
    if pixels.dtype != np.uint8:
        pixels = (pixels / max(float(pixels.max()), 1.0) * 255.0).astype(np.uint8)
    return np.ascontiguousarray(pixels), stated * shrink


class _ImagePair(NamedTuple):
    """Corners in two images as directions (x, y, 1), shape (n, 2), and how the camera went, about."""

    first: Array
    second: Array
    matrix: Array
    shift: Array


def _view_between(one: Any, other: Any, camera: Camera, scale: float) -> _ImagePair | None:
    """Return the corners of two images of a camera, `scale` of whose pixels are in one of theirs."""
    followed = followed_corners(one, other)
    if followed is None:
        return None
    first, second = (undistorted(points, camera, scale) for points in followed)
    limit = SEEN * scale / camera.fx
    essential, inliers = cv2.findEssentialMat(
        first, second, np.eye(3), cv2.RANSAC, 0.999, limit, maxIters=_TRIES
    )
    if essential is None or essential.shape != (3, 3):
        return None
    fit = inliers.ravel() == 1
    if np.count_nonzero(fit) < FEWEST_CORNERS:
        return None
    decompose: Any = cv2.decomposeEssentialMat
    a, b, shift = decompose(essential)
    # The other one of the two is turned by half a turn about the way between.
    turn = min((a, b), key=lambda matrix: float(np.linalg.norm(log_of(matrix))))
    return _ImagePair(first[fit], second[fit], turn, shift.ravel())


def followed_corners(one: Any, other: Any) -> tuple[Array, Array] | None:
    """Return corners of a grey image, and where they are in another, pixels, (n, 2); None of too few."""
    if one.shape != other.shape:
        return None
    follow: Any = cv2.calcOpticalFlowPyrLK
    corners = cv2.goodFeaturesToTrack(one, _CORNERS, 0.01, max(6.0, one.shape[1] / 40.0))
    if corners is None or len(corners) < FEWEST_CORNERS:
        return None
    found, status, _ = follow(one, other, corners, None, winSize=(17, 17), maxLevel=3)
    kept = status.ravel() == 1
    if np.count_nonzero(kept) < FEWEST_CORNERS:
        return None
    return corners[kept].reshape(-1, 2), found[kept].reshape(-1, 2)


def undistorted(points: Any, camera: Camera, scale: float) -> Array:
    """Return corners of a scaled image as directions (x, y, 1), shape (n, 2)."""
    full = ((points.astype(np.float64) + 0.5) * scale - 0.5).reshape(-1, 1, 2)
    matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    if camera.distortion == "Equidistant":
        given = np.array([*camera.coefficients[:4], *[0.0] * (4 - len(camera.coefficients[:4]))])
        return np.asarray(cv2.fisheye.undistortPoints(full, matrix, given), dtype=np.float64).reshape(-1, 2)
    given = (
        np.zeros(4) if camera.distortion == "None" else np.array([*camera.coefficients, 0.0, 0.0, 0.0, 0.0])
    )
    given = given[: 8 if len(given) >= 8 else 5 if len(given) >= 5 else 4]
    return np.asarray(cv2.undistortPoints(full, matrix, given), dtype=np.float64).reshape(-1, 2)


def _refined(views: Sequence[_ImagePair], limit: float) -> Array:
    """Return rotations that bring epipolar distances down, from near ones (Gauss-Newton, 5 unknowns each).

    Args:
        views: n views.
        limit: Distance that a corner may be off, as a direction.

    Returns:
        Shape (n, 3, 3).
    """
    most, number = max(len(view.first) for view in views), np.arange(len(views))
    one, other = np.ones((2, len(views), most, 3))
    there = np.zeros((len(views), most))
    for k, view in enumerate(views):
        there[k, : len(view.first)] = 1.0
        one[k, : len(view.first), :2], other[k, : len(view.first), :2] = view.first, view.second
    matrix = np.stack([view.matrix for view in views])
    shift = np.stack([view.shift / max(float(np.linalg.norm(view.shift)), 1e-12) for view in views])
    corners = there.sum(axis=1)
    for _ in range(_ROUNDS):
        turned = one @ matrix.transpose(0, 2, 1)
        line = np.cross(shift[:, np.newaxis], turned)
        size = np.maximum(np.hypot(line[:, :, 0], line[:, :, 1]), 1e-9)
        missed = np.sum(other * line, axis=2) / size
        weight = there / (1.0 + (missed / (0.5 * limit)) ** 2)
        # Growth of x2 · (t × R x1) with a turn of R x1, and with t across itself.
        least = np.argmin(np.abs(shift), axis=1)
        across = cross_of(shift)
        across = np.stack([across[number, (least + k) % 3] for k in (1, 2)], axis=1)
        table = np.empty((*there.shape, 5))
        along = np.sum(turned * shift[:, np.newaxis], axis=2, keepdims=True)
        table[:, :, :3] = other * along - np.sum(turned * other, axis=2, keepdims=True) * shift[:, np.newaxis]
        table[:, :, 3:] = np.cross(turned, other) @ across.transpose(0, 2, 1)
        table /= size[:, :, np.newaxis]
        pulled = (table * weight[:, :, np.newaxis]).transpose(0, 2, 1)
        normal = pulled @ table + 1e-12 * np.eye(5)
        # Without a way between the images its direction is open, and must not run away.
        normal[:, _ACROSS, _ACROSS] += 1e-6 * limit**2 * corners[:, np.newaxis]
        change = -np.linalg.solve(normal, pulled @ missed[:, :, np.newaxis])[:, :, 0]
        matrix = np.stack([exp_of(turn) for turn in np.clip(change[:, :3], -0.05, 0.05)]) @ matrix
        shift = shift + np.sum(np.clip(change[:, 3:, np.newaxis], -0.3, 0.3) * across, axis=1)
        shift = shift / np.linalg.norm(shift, axis=1, keepdims=True)
        if np.abs(change[:, :3]).max() < _SETTLED / 10.0:
            break
    return matrix


def _scanned(frames: Iterator[tuple[float, Any]], sensor: Sensor) -> Iterator[tuple[float, float, Array]]:
    """Yield spans between scans and the LiDAR's mean turning rates over them."""
    before: _TimedPoints | None = None
    matrix, place, motion, size = np.eye(3), np.zeros(3), np.zeros(6), _CELLS[0]
    seen: list[tuple[Any, Array]] = []
    for stamp, message in frames:
        after = _scan_of(stamp, message, sensor)
        length = after.time - before.time if before else 0.0
        found = _moved(seen, size, after, (matrix, place, motion, length)) if 0 < length < _LONGEST else None
        if found is None:
            # The scan's frame is that of all cells until the next one that is lost.
            matrix, place, motion, seen = np.eye(3), np.zeros(3), np.zeros(6), []
            middle = np.median(np.linalg.norm(after.points, axis=1)) if len(after.points) else 0.0
            size = float(np.clip(_CELL_SHARE * middle, *_CELLS))
        else:
            yield after.time - length, after.time, found[:3] / length
            motion = found
            matrix, place = matrix @ exp_of(motion[:3]), matrix @ motion[3:] + place
        still = _stilled(after, motion / max(length, 1e-3))
        seen = [*seen[1 - _SCANS :], _cells(still @ matrix.T + place, size)]
        before = after


class _TimedPoints(NamedTuple):
    """Scan of a LiDAR: the mean time of its points, s; they, m, (n, 3); how much later each is, s, (n,)."""

    time: float
    points: Array
    late: Array


def _scan_of(stamp: float, message: Any, sensor: Sensor) -> _TimedPoints:
    cloud = cloud_points(message, sensor.topic)
    cloud = cloud[:: max(1, len(cloud) // (3 * _MOST_POINTS))]
    lidar = sensor.lidar
    xyz = np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=1)
    ranges = np.linalg.norm(xyz, axis=1)
    kept = np.isfinite(ranges) & (ranges > max(lidar.min_range if lidar else 0.0, 0.3))
    timed = lidar is not None and lidar.time_field in (cloud.dtype.names or ())
    if lidar is not None and timed and np.isfinite(cloud[lidar.time_field]).any():
        kept &= np.isfinite(cloud[lidar.time_field])
    chosen = np.flatnonzero(kept & (ranges < (lidar.max_range if lidar else np.inf)))
    chosen = chosen[:: max(1, len(chosen) // _MOST_POINTS)]
    share, period = sensor.stamp.share, 1.0 / sensor.rate if sensor.rate else 0.1
    late, mean = np.zeros(len(chosen)), 0.0 if share is None else (0.5 - share) * period
    if lidar is not None and timed and lidar.times_since in {None, TimesSince.HEADER} and chosen.size:
        told = point_times(cloud[chosen], str(lidar.time_field), round((stamp - sensor.time_offset) * 1e9))
        if told is not None and 0.2 * period < np.ptp(told[0]) < 2.0 * period:
            mean = float(told[0].mean())
            late = told[0] - mean
        else:
            # Of another unit, as is told elsewhere; laid on as it is, it would seem to be of another time.
            chosen, late = chosen[:0], late[:0]
    return _TimedPoints(stamp + mean, xyz[chosen], late)


def _moved(
    seen: Sequence[tuple[Any, Array]],
    size: float,
    after: _TimedPoints,
    from_: tuple[Array, Array, Array, float],
) -> Array | None:
    """Return rotation vector and translation, (6,), from a scan's frame to that of the one before it.

    Args:
        seen: Cells of the scans before it.
        size: Theirs, m.
        after: The scan.
        from_: Turn and place of the scan before it in the frame of the cells, the motion that is expected, as
            returned, and the time between the scans, s.
    """
    matrix, place, motion, length = from_
    if not seen or len(after.points) < _FEWEST_POINTS:
        return None
    stride = max(1, len(after.points) // _POINTS)
    some = _TimedPoints(after.time, after.points[::stride], after.late[::stride])
    for times, rounds in _SCAN_ROUNDS.items():
        planes = _planes(seen, times)
        if len(planes[0]) < _FEWEST_PLANES:
            return None
        # It is put together as of one instant by the motion as known.
        points = _stilled(some, motion / length)
        turned, moved = matrix @ exp_of(motion[:3]), matrix @ motion[3:] + place
        for _ in range(rounds):
            change = _nearer(planes, points @ turned.T + moved, size * times)
            if change is None:
                return None
            turn = exp_of(change[:3])
            turned, moved = turn @ turned, turn @ moved + change[3:]
            if np.abs(change).max() < _SETTLED:
                break
        motion = np.concatenate((log_of(matrix.T @ turned), matrix.T @ (moved - place)))
    return motion


def _stilled(scan: _TimedPoints, speed: Array) -> Array:
    """Return a scan's points as seen at its mean time, under a constant turning rate and velocity, (6,)."""
    rate = float(np.linalg.norm(speed[:3]))
    axis = speed[:3] / max(rate, 1e-12)
    angle = (rate * scan.late)[:, np.newaxis]
    turned = (
        scan.points * np.cos(angle)
        + _cross(axis, scan.points) * np.sin(angle)
        + np.outer(scan.points @ axis, axis) * (1.0 - np.cos(angle))
    )
    return np.asarray(turned + scan.late[:, np.newaxis] * speed[3:])


def _nearer(planes: tuple[Any, Array, Array], points: Array, cell: float) -> Array | None:
    """Return the turn and shift, (6,), that bring points nearer to the planes of their cells."""
    keys, means, normals = planes
    wanted = _keys(points, cell)
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    met = keys[place] == wanted
    if np.count_nonzero(met) < _FEWEST_POINTS // 4:
        return None
    point, normal = points[met], normals[place[met]]
    missed = np.sum((point - means[place[met]]) * normal, axis=1)
    scale = max(3.0 * float(np.median(np.abs(missed))), 0.01)
    weight = 1.0 / (1.0 + (missed / scale) ** 2)
    table = np.column_stack((_cross(point, normal), normal))
    pulled = table * weight[:, np.newaxis]
    return np.asarray(-np.linalg.solve(table.T @ pulled + 1e-3 * np.eye(6), pulled.T @ missed))


def _cross(a: Array, b: Array) -> Array:
    """Return cross products of vectors, shape (n, 3) or (3,); numpy's takes ten times as long on a few."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), axis=-1)


def _keys(points: Array, cell: float) -> Any:
    number = np.floor(points / cell).astype(np.int64) + _MIDDLE
    return (number[:, 0] << 42) | (number[:, 1] << 21) | number[:, 2]


def _cells(points: Array, size: float) -> tuple[Any, Array]:
    """Return the keys of cells with points, and their numbers and sums: 1, x, all products; shape (k, 10)."""
    # Numbers are those of rooms, so that differences of sums keep digits.
    table = np.hstack((np.ones((len(points), 1)), points, points[:, _ROWS] * points[:, _COLUMNS]))
    return _summed(_keys(points, size), table)


def _summed(keys: Any, table: Array) -> tuple[Any, Array]:
    """Return increasing keys and the sums of the rows of each."""
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    first = np.flatnonzero(np.diff(keys, prepend=-1))
    return keys[first], np.add.reduceat(table[order], first) if len(first) else table


def _planes(seen: Sequence[tuple[Any, Array]], times: int) -> tuple[Any, Array, Array]:
    """Return the keys of cells whose points lie in a plane, their means (k, 3) and normals (k, 3).

    Args:
        seen: Cells of scans.
        times: Of whose size cells are wanted, 1 or 2.
    """
    keys = np.concatenate([one for one, _ in seen])
    if times > 1:
        keys = ((keys & _EVEN) >> 1) + _MIDDLE_HALVED
    keys, sums = _summed(keys, np.concatenate([table for _, table in seen]))
    many = sums[:, 0] >= _LEAST_IN_CELL[times]
    keys, means = keys[many], sums[many, 1:] / sums[many, :1]
    spread = np.empty((len(means), 3, 3))
    spread[:, _ROWS, _COLUMNS] = means[:, 3:] - means[:, _ROWS] * means[:, _COLUMNS]
    spread[:, _COLUMNS, _ROWS] = spread[:, _ROWS, _COLUMNS]
    means = means[:, :3]
    values, vectors = np.linalg.eigh(spread)
    good = (values[:, 0] < _FLAT * values[:, 1]) & (values[:, 1] > _LINE * values[:, 2])
    return keys[good], means[good], vectors[good][:, :, 0]
