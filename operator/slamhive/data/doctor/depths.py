# SPDX-License-Identifier: Apache-2.0
"""Judgement of the unit of depth by motion: what a camera sees move against how far the ground truth moved.

Corners of a colour image, with their depth, and where they are in a later one give the camera's way between
the two in the unit of the depth (perspective from n points, Lepetit 2009). The ground truth's is in metres.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.doctor.mountings import pose_in_body
from slamhive.data.doctor.pictures import DEPTHS, SCALES, Pictures
from slamhive.data.doctor.sighting import FEWEST_CORNERS, SEEN, followed_corners, grey_of, undistorted
from slamhive.data.recordings.images import compressed_pixels, image_pixels
from slamhive.model.errors import DataError
from slamhive.model.sensors import Role
from slamhive.model.variant import TRUTH
from slamhive_eval import interpolate

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

    from slamhive.data.doctor.examined import Examined
    from slamhive.data.recordings.reading import Recording, Scan
    from slamhive.model.sensors import Camera, Sensor

    Array = npt.NDArray[np.float64]

_PAIRS, _FEWEST_PAIRS = 24, 8
"""Pairs of images that are looked at, one of each part of the way, and how many must tell."""
_TRIED = 20
"""Images of a part from which the quickest way is taken."""
_WAYS = (0.1, 0.03)
"""Metres between two images: as far as both still see the same, and farther than a pixel's noise."""
_LONGEST = 1.0
_GAP_SECONDS = 0.2
"""Spans between two images, and between poses of the truth, above which neither tells of the way."""
_APART_SECONDS = 0.05
"""Time between a colour image and its depth at most."""
_WRONG = 1.5
"""Ratio from which a unit is wrong: calibrations, and truths that are a little late, are off by far less."""
_STEADY = 1.3
"""Ratio of the quartiles of all pairs up to which they agree; of noise alone it is 1.8."""
_NEAR = 0.12
"""Share that a usual unit may be off from what was found."""
_SHORT_SECONDS = 9.0


class _CameraImages(NamedTuple):
    """Images of a camera, their times, and its intrinsics."""

    recording: Recording
    sensor: Sensor
    scan: Scan
    camera: Camera

    @property
    def seconds(self) -> Array:
        """Return sensor times, s, shape (n,)."""
        return np.asarray(self.scan.stamps / 1e9 + self.sensor.time_offset, dtype=np.float64)

    def message(self, number: int) -> Any:
        """Return a message by its number.

        Raises:
            DataError: It can't be read.
        """
        time = int(self.scan.times[number])
        for skipped, (connection, _, raw) in enumerate(
            self.recording.messages({self.sensor.topic}, time, time + 1)
        ):
            if skipped == number - int(np.searchsorted(self.scan.times, time)):
                return self.recording.decode(raw, connection.msgtype)
        raise DataError(f"{self.sensor.topic}: no message at {time} ns")


class _Way(NamedTuple):
    """Way between two colour images: their numbers, and how far the ground truth moved, m."""

    first: int
    second: int
    metres: float


def judge_depth(examined: Examined) -> Iterator[Finding]:
    """Yield a unit of depth by which the camera moved otherwise than the ground truth."""
    streams = _streams(examined)
    # Of a unit that gives depths of no room or road, the watcher of its images tells.
    if streams is None or examined.truth is None or any(one.has_odd_unit for one in _pictures(examined)):
        return
    color, depth = streams
    ways = _ways(examined, color)
    ratios = [ratio for way in ways for ratio in (_ratio(color, depth, way),) if ratio is not None]
    low, ratio, high = np.percentile(ratios, (25, 50, 75)) if ratios else (0.0, 0.0, 0.0)
    if len(ratios) < _FEWEST_PAIRS or high > _STEADY * low:
        # That depth can't be read at all is told elsewhere.
        if np.ptp(color.seconds) >= _SHORT_SECONDS and np.isfinite(_typical(examined)):
            yield Finding(
                "depth.unit",
                Severity.NOTE,
                "sensors.depth: camera.depthScale can't be told from this motion: too few pairs of images "
                f"({len(ratios)} of {len(ways)}) show how far the camera moved against the ground truth, or "
                "they don't agree",
                Role.DEPTH,
            )
        return
    if 1.0 / _WRONG < ratio < _WRONG:
        return
    yield _finding(examined, depth, float(ratio), (len(ratios), float(high - low)))


def _finding(examined: Examined, depth: _CameraImages, ratio: float, told: tuple[int, float]) -> Finding:
    """Return the finding of a ratio of ways, of so many pairs whose quartiles are so far apart."""
    scale = float(depth.camera.depth_scale or 1.0)
    count, spread = told
    found, usual = scale * ratio, SCALES["f" if depth.camera.encoding == "32FC1" else "u"]
    better = min(usual, key=lambda one: abs(np.log(one / found)))
    typical = _typical(examined) / found
    known = abs(better / found - 1.0) < _NEAR and DEPTHS[0] < typical < DEPTHS[1]
    helps = f"; {better:g} would make it {ratio * scale / better:.2f} times" if known else (
        "; no usual unit fits: look at the unit of the depth, and at that of the ground truth"
    )  # fmt: skip
    return Finding(
        "depth.unit",
        Severity.WARNING,
        f"sensors.depth: camera.depthScale: with {scale:g} units a metre the camera moves "
        f"{ratio:.3g} ± {3.0 * 0.93 * spread / count**0.5:.2g} times as far as {TRUTH}, by {count} pairs of "
        f"images: runs with it come out Diverged, by their scale{helps}",
        Role.DEPTH,
        value=ratio,
        unit="times",
        repair=sensor_repair(Role.DEPTH, depthScale=better) if known else {},
    )


def _streams(examined: Examined) -> tuple[_CameraImages, _CameraImages] | None:
    """Return the colour images and their depth; None where pixels of the two aren't those of one another."""
    spec, found = examined.entry.dataset.spec, []
    for name in (Role.COLOR, Role.DEPTH):
        sensor = spec.sensors.get(name)
        scan = examined.watched.scans.get(sensor.topic) if sensor is not None else None
        if sensor is None or scan is None or len(scan.stamps) < 2 or sensor.camera is None:
            return None
        found.append(_CameraImages(examined.recording, sensor, scan, sensor.camera))
    color, depth = found
    sizes = {(one.camera.width, one.camera.height) for one in found}
    is_same = np.allclose(color.sensor.T_body_sensor, depth.sensor.T_body_sensor, atol=1e-3)
    is_known = color.camera.model == "Pinhole" and depth.camera.depth_scale is not None
    return (color, depth) if len(sizes) == 1 and is_same and is_known else None


def _pictures(examined: Examined) -> Iterator[Pictures]:
    return (one for one in examined.watched.watchers.get(Role.DEPTH, ()) if isinstance(one, Pictures))


def _typical(examined: Examined) -> float:
    """Return the typical depth, in units of the images."""
    return float(np.median([depth for one in _pictures(examined) for depth in one.depths] or [np.nan]))


def _ways(examined: Examined, color: _CameraImages) -> list[_Way]:
    """Return ways between images, the quickest of each part of the way that the ground truth went."""
    spec, truth = examined.entry.dataset.spec, examined.truth
    if truth is None:
        return []
    if truth.oriented:
        truth = truth.moved(np.linalg.inv(pose_in_body(spec, TRUTH)) @ pose_in_body(spec, Role.COLOR))
    seconds = color.seconds
    known, places, _ = interpolate(truth, seconds, _GAP_SECONDS)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1) * (known[1:] & known[:-1])
    went = np.concatenate(([0.0], np.cumsum(steps)))
    # Most of a recording may be a standstill, which tells nothing.
    edges = np.searchsorted(went, np.linspace(0.0, went[-1], _PAIRS + 1)[1:-1])
    found: list[_Way] = []
    for least in _WAYS:
        found = []
        for part in np.split(np.arange(len(seconds)), edges):
            best: tuple[float, _Way] | None = None
            for first in part[:: max(1, len(part) // _TRIED)].tolist():
                later = slice(first + 1, first + 1 + int(np.sum(seconds[first + 1 :] <= seconds[first] + 1)))
                metres = np.linalg.norm(places[later] - places[first], axis=1)
                far = np.flatnonzero(known[later] & (metres >= least))
                if not known[first] or not far.size:
                    continue
                second = first + 1 + int(far[0])
                took = float(seconds[second] - seconds[first])
                if 0 < took <= _LONGEST and (best is None or took < best[0]):
                    best = took, _Way(first, second, float(metres[far[0]]))
            if best is not None:
                found.append(best[1])
        if len(found) >= _FEWEST_PAIRS:
            break
    return found


def _ratio(color: _CameraImages, depth: _CameraImages, way: _Way) -> float | None:
    """Return the ratio of the camera's way in the unit of the depth to the truth's; None if untold."""
    apart = np.abs(depth.seconds - color.seconds[way.first])
    if apart.min() > _APART_SECONDS:
        return None
    try:
        greys = [grey_of(color.message(number), color.sensor, color.camera) for number in way[:2]]
        message = depth.message(int(np.argmin(apart)))
        read = image_pixels if hasattr(message, "encoding") else compressed_pixels
        depths = read(message, depth.sensor.topic)
        followed = followed_corners(greys[0][0], greys[1][0])
    except (DataError, cv2.error):
        return None
    if followed is None or depths.shape[:2] != (depth.camera.height, depth.camera.width):
        return None
    size = greys[0][1]
    column, row = np.rint((followed[0].T + 0.5) * size - 0.5).astype(np.intp)
    z = depths[np.clip(row, 0, len(depths) - 1), np.clip(column, 0, depths.shape[1] - 1)].astype(np.float64)
    z = np.where(np.isfinite(z), z, 0.0) / float(depth.camera.depth_scale or 1.0)
    seen = z > 0
    if np.count_nonzero(seen) < FEWEST_CORNERS:
        return None
    first, second = (undistorted(points[seen], color.camera, size) for points in followed)
    points = np.column_stack((first, np.ones(len(first)))) * z[seen, np.newaxis]
    moved = _moved(points / np.median(z[seen]), second, 2.0 * SEEN * size / color.camera.fx)
    return None if moved is None else float(moved * np.median(z[seen]) / way.metres)


def _moved(points: Array, seen: Array, limit: float) -> float | None:
    """Return the length of the way of a camera that saw points, (n, 3), now in directions, (n, 2)."""
    solve: Any = cv2.solvePnPRansac
    method = cv2.SOLVEPNP_EPNP
    try:
        found, turn, shift, inliers = solve(
            points,
            seen,
            np.eye(3),
            None,
            iterationsCount=200,
            reprojectionError=limit,
            flags=method,
        )
        if not found or inliers is None or len(inliers) < FEWEST_CORNERS:
            return None
        fit = inliers.ravel()
        _, shift = cv2.solvePnPRefineLM(points[fit], seen[fit], np.eye(3), np.zeros(4), turn, shift)
    except cv2.error:
        return None
    return float(np.linalg.norm(shift))
