# SPDX-License-Identifier: Apache-2.0
"""Errors over segments of fixed lengths, as the KITTI odometry benchmark defines them (Geiger et al. 2012).

The devkit's evaluate_odometry.cpp: segments start at every tenth frame of the ground truth and end at the
first frame whose distance along it exceeds the start's by more than the length; E is the estimate's motion
compared with the true one, its translation and rotation are divided by the nominal length and averaged
over all segments. The devkit computes in float32, this in float64: the two differ by some 1e-5 relative
over kilometres, and a segment may end one frame apart where a distance equals a length to seven digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval import metrics
from slamhive_eval.association import associate, no_overlap
from slamhive_eval.errors import OptionError

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

KITTI_LENGTHS = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
"""The benchmark's lengths in m."""
KITTI_STEP = 10
FRAME_SECONDS = 0.1
"""Duration of a frame in the devkit, s; used where poses have numbers instead of times."""
SPEEDS = tuple(float(speed) for speed in range(2, 25, 2))
"""Centres of the devkit's groups by speed in m/s."""
SPEED_WIDTH = 2.0
"""A segment belongs to each group whose centre is nearer than this: the groups overlap, as the devkit's."""
OVERSHOOT = 0.1
"""Share of a segment within which a later pose serves where the estimate lacks the one that ends it."""


@dataclass(frozen=True, eq=False)
class Segments:
    """The segments compared, one entry each, in the devkit's order.

    Attributes:
        begin: Index of the first pose among the associated ones, shape (k,).
        end: Index of the last pose, shape (k,).
        lengths: Nominal length in m, shape (k,).
        speeds: Nominal length by duration in m/s, shape (k,).
        translation: Translation error by length, 0.01 being 1 %, shape (k,).
        rotation: Rotation error by length in rad/m, shape (k,).
    """

    begin: IndexArray
    end: IndexArray
    lengths: FloatArray
    speeds: FloatArray
    translation: FloatArray
    rotation: FloatArray

    def __len__(self) -> int:
        return len(self.begin)


@dataclass(frozen=True)
class SegmentGroup:
    """Mean errors of the segments of one length or about one speed.

    Attributes:
        value: The length in m or the speed in m/s.
        count: Segments; the devkit draws groups of three or more.
        translation_percent: Mean translation error in %, None for count 0.
        rotation_deg_per_m: Mean rotation error in degrees per metre, None for count 0.
    """

    value: float
    count: int
    translation_percent: float | None
    rotation_deg_per_m: float | None


@dataclass(frozen=True, eq=False)
class KittiErrors:
    """Result of `kitti_errors`: errors over segments of the path, as the KITTI odometry benchmark has them.

    Attributes:
        segments: All segments with their errors.
        missing: Segments of the ground truth whose begin or end the estimate has no pose for.
        overall: Means over all segments; its value is 0.
        by_length: One group a length asked for, in the order asked.
        by_speed: One group a speed of the devkit, those without segments left out.
        poses: Associated poses.
        missing_frames: Frames of the ground truth that the estimate has no pose for; None where the stamps
            are times, and the ground truth may have more poses than there are frames.
    """

    segments: Segments
    missing: int
    overall: SegmentGroup
    by_length: tuple[SegmentGroup, ...]
    by_speed: tuple[SegmentGroup, ...]
    poses: int
    missing_frames: int | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data: means in % and deg/m, counts, groups by length and speed."""
        return {
            **_fields(self.overall),
            "missing": self.missing,
            "poses": self.poses,
            **({} if self.missing_frames is None else {"missingFrames": self.missing_frames}),
            "byLength": [{"length": group.value, **_fields(group)} for group in self.by_length],
            "bySpeed": [{"speed": group.value, **_fields(group)} for group in self.by_speed],
        }


def kitti_errors(
    reference: Trajectory,
    estimate: Trajectory,
    *,
    lengths: tuple[float, ...] = KITTI_LENGTHS,
    step: int = KITTI_STEP,
    max_difference_seconds: float = 0.01,
    offset_seconds: float = 0.0,
    scale: float = 1.0,
    frame_seconds: float | None = None,
) -> KittiErrors:
    """Segment errors of the KITTI benchmark over any lengths.

    The world frames may differ: relative motions are compared. Lengths are measured along the whole ground
    truth. An estimate that lacks poses is measured on those it has; a segment whose begin or end it lacks is
    counted as missing, but where the stamps are times the next pose within a tenth of the length ends it.

    Args:
        reference: Ground truth.
        estimate: Of the same body; poses without times pair by index.
        lengths: Segment lengths in m, each > 0.
        step: A segment starts at every so many frames of the ground truth, where the stamps are frames, and
            at every so many associated poses otherwise.
        max_difference_seconds: Largest accepted time difference of an associated pair in s.
        offset_seconds: Added to the estimate's stamps for matching only.
        scale: Factor on the estimate's positions: that of a Sim(3) alignment for monocular estimates.
        frame_seconds: Duration of a frame in s for the speeds, which the devkit takes for 0.1 s and counts
            one frame more than steps. None: from the stamps, and as the devkit where these are frames.

    Returns:
        The errors, possibly of no segment where the ground truth is shorter than the lengths.

    Raises:
        OptionError: A length, step, scale or duration that isn't positive.
        AssociationError: No common pose.
    """
    _check(lengths, step, scale, frame_seconds)
    pairs = associate(reference, estimate, max_difference_seconds, offset_seconds)
    if not len(pairs):
        raise no_overlap(reference, estimate, max_difference_seconds, offset_seconds)
    numbered = reference.stamped_by != "time" or np.array_equal(reference.stamps, np.arange(len(reference)))
    if frame_seconds is None and numbered:
        frame_seconds = FRAME_SECONDS
    starts = np.arange(0, len(reference), step) if numbered else pairs.reference[::step]
    # Of frames the devkit's own one ends a segment, or none; times may be those of keyframes.
    overshoot = 0.0 if numbered else OVERSHOOT
    begin, end, nominal, missing = _ends(reference.distances, pairs.reference, starts, lengths, overshoot)
    # The devkit inverts matrices, it doesn't transpose them as rpe_errors does: only orthonormal ones agree.
    truth = reference.select(pairs.reference).orthonormal()
    found = estimate.select(pairs.estimate).orthonormal()
    if scale != 1.0:
        found = found.transformed(np.eye(3), np.zeros(3), scale)
    index = np.column_stack((begin, end))
    if frame_seconds is None:
        duration = truth.stamps[end] - truth.stamps[begin]
    else:
        counted = truth.stamps if numbered else pairs.reference.astype(np.float64)
        duration = frame_seconds * (counted[end] - counted[begin] + 1.0)
    segments = Segments(
        begin,
        end,
        nominal,
        nominal / np.where(duration > 0, duration, np.inf),
        metrics.rpe_errors(truth, found, index) / nominal,
        metrics.rpe_errors(truth, found, index, "angle_rad") / nominal,
    )
    by_speed = (_group(segments, v, np.abs(segments.speeds - v) < SPEED_WIDTH) for v in SPEEDS)
    return KittiErrors(
        segments=segments,
        missing=missing,
        overall=_group(segments, 0.0, np.ones(len(segments), dtype=bool)),
        by_length=tuple(_group(segments, length, segments.lengths == length) for length in lengths),
        by_speed=tuple(group for group in by_speed if group.count),
        poses=len(pairs),
        missing_frames=len(reference) - len(np.unique(pairs.reference)) if numbered else None,
    )


def _check(lengths: tuple[float, ...], step: int, scale: float, frame_seconds: float | None) -> None:
    if not lengths or not all(np.isfinite(length) and length > 0 for length in lengths):
        raise OptionError(f"the lengths of segments must be positive numbers of metres, not {lengths}")
    if len(set(lengths)) != len(lengths):
        raise OptionError(f"each length of a segment may be given once only, not {lengths}")
    if step < 1:
        raise OptionError(f"the step between segments must be at least 1 pose, not {step}")
    if not (np.isfinite(scale) and scale > 0):
        raise OptionError(f"the scale must be a positive number, not {scale}")
    if frame_seconds is not None and not (np.isfinite(frame_seconds) and frame_seconds > 0):
        raise OptionError(f"a frame must take a positive number of seconds, not {frame_seconds}")


def _ends(
    distances: FloatArray,
    associated: IndexArray,
    starts: IndexArray,
    lengths: tuple[float, ...],
    overshoot: float,
) -> tuple[IndexArray, IndexArray, FloatArray, int]:
    """Begin and end among the associated poses, nominal length, and how many segments lack one of the two."""
    start = np.repeat(starts, len(lengths))
    nominal = np.tile(np.array(lengths, dtype=np.float64), len(starts))
    goal = distances[start] + nominal
    true_end = np.searchsorted(distances, goal, side="right")
    exists = true_end < len(distances)
    begin = np.minimum(np.searchsorted(associated, start), len(associated) - 1)
    end = np.searchsorted(distances[associated], goal, side="right")
    clipped = np.minimum(end, len(associated) - 1)
    near = distances[associated[clipped]] <= goal + overshoot * nominal
    # The devkit takes the first frame beyond the length however far it is; only later ones must be near.
    near |= associated[clipped] <= true_end
    found = exists & (associated[begin] == start) & (end < len(associated)) & near
    missing = int(np.count_nonzero(exists & ~found))
    return begin[found], end[found], nominal[found], missing


def _group(segments: Segments, value: float, chosen: Any) -> SegmentGroup:
    count = int(np.count_nonzero(chosen))
    if not count:
        return SegmentGroup(value, 0, None, None)
    translation = float(np.mean(segments.translation[chosen])) * 100.0
    return SegmentGroup(value, count, translation, float(np.rad2deg(np.mean(segments.rotation[chosen]))))


def _fields(group: SegmentGroup) -> dict[str, Any]:
    return {
        "count": group.count,
        "translationPercent": group.translation_percent,
        "rotationDegPerM": group.rotation_deg_per_m,
    }
