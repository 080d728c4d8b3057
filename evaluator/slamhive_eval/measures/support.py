# SPDX-License-Identifier: Apache-2.0
"""Support of an estimate: when it has poses, where it breaks off, and the time that several have in common.

An estimate that begins late, loses track or starts again is compared on less, and often easier, ground
than one that doesn't. What it missed is therefore reported beside its errors, several estimates can be
compared on the time they share, and one that started again is measured piece by piece.
"""

from __future__ import annotations

import contextlib
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval import metrics
from slamhive_eval.coverage import FRAME_STEP_SECONDS, KEYFRAME_STEP_SECONDS, is_keyframes
from slamhive_eval.errors import AssociationError, OptionError
from slamhive_eval.evaluation import Evaluation, Options, evaluate
from slamhive_eval.preparing import set_clock
from slamhive_eval.statistics import Statistics

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory


@dataclass(frozen=True)
class Gap:
    """A time in which an estimate has no pose.

    Attributes:
        begin: Stamp of the last pose before it in s.
        end: Stamp of the first pose after it in s.
        metres: Path of the ground truth meanwhile.
    """

    begin: float
    end: float
    metres: float

    @property
    def seconds(self) -> float:
        """Its duration in s."""
        return self.end - self.begin


@dataclass(frozen=True)
class Support:
    """Times at which an estimate has poses.

    Attributes:
        seconds_to_first_pose: From the window's begin to the first pose, ≥ 0.
        seconds_after_last_pose: From the last pose to the window's end, ≥ 0.
        gaps: Between its poses, in the order of time.
    """

    seconds_to_first_pose: float
    seconds_after_last_pose: float
    gaps: tuple[Gap, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data."""
        return {
            "secondsToFirstPose": self.seconds_to_first_pose,
            "secondsAfterLastPose": self.seconds_after_last_pose,
            "gaps": [asdict(gap) for gap in self.gaps],
        }


@dataclass(frozen=True, eq=False)
class Segment:
    """One piece of an estimate, between two restarts.

    Attributes:
        name: Its number in the segments given.
        begin: Stamp of its first pose in s.
        end: Stamp of its last pose in s.
        poses: Poses of the estimate in it.
        metres: Path of the ground truth between its associated poses.
        alone: Its errors when aligned on its own.
        in_main_frame: Statistics of its position errors in m under the alignment of the longest segment;
            None without common poses or without that alignment, or where each segment has found an extrinsic
            of its own.
    """

    name: int
    begin: float
    end: float
    poses: int
    metres: float
    alone: Evaluation
    in_main_frame: Statistics | None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data."""
        return {
            "segment": self.name,
            "begin": self.begin,
            "end": self.end,
            "poses": self.poses,
            "metres": self.metres,
            "ate": self.alone.ate.as_dict() if self.alone.ate else None,
            "scale": self.alone.scale,
            "coverage": self.alone.coverage.share,
            "ateInMainFrame": self.in_main_frame.as_dict() if self.in_main_frame else None,
        }


@dataclass(frozen=True, eq=False)
class SegmentedEvaluation:
    """An estimate in pieces.

    Attributes:
        main: The segment over the longest path, whose evaluation stands for the estimate.
        others: The rest, in the order of their numbers.
        left_out: How many more there are, shorter than these, that weren't measured.
    """

    main: Segment
    others: tuple[Segment, ...]
    left_out: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data: the main segment's evaluation with all segments listed."""
        listed = sorted((self.main, *self.others), key=lambda segment: segment.name)
        return {
            **self.main.alone.as_dict(),
            "mainSegment": self.main.name,
            "segments": [segment.as_dict() for segment in listed],
            "segmentsLeftOut": self.left_out,
        }


def find_support(
    reference: Trajectory,
    estimate: Trajectory,
    *,
    longest_step_seconds: float | None = None,
    window: tuple[float, float] | None = None,
) -> Support:
    """Return the times at which the estimate has poses within the ground truth's time.

    Args:
        reference: Ground truth.
        estimate: On the same clock.
        longest_step_seconds: Longer steps are gaps; None for coverage's limits, 1 s for frames, 5 s for
            keyframes.
        window: First and last time of the run in s; None for those of the ground truth.

    Returns:
        Its begin, end and gaps.
    """
    begin, end = window if window is not None else (reference.stamps[0], reference.stamps[-1])
    stamps = estimate.stamps
    limit = _limit(estimate, longest_step_seconds)
    before = np.flatnonzero(np.diff(stamps) > limit)
    path = np.interp(stamps, reference.stamps, reference.distances)
    gaps = tuple(Gap(float(stamps[k]), float(stamps[k + 1]), float(path[k + 1] - path[k])) for k in before)
    return Support(max(0.0, float(stamps[0] - begin)), max(0.0, float(end - stamps[-1])), gaps)


def common_support(estimates: Sequence[Trajectory], longest_step_seconds: float | None = None) -> FloatArray:
    """Spans of time in which every estimate has poses.

    A span holds poses no further apart than the limit, so that estimates of different rates and stamps
    can share it.

    Args:
        estimates: One or more, on one clock.
        longest_step_seconds: As for find_support.

    Returns:
        First and last time of each span in s, shape (k, 2), ascending.

    Raises:
        AssociationError: There is no such time.
        OptionError: No estimates.
    """
    if not estimates:
        raise OptionError("a common support needs at least one estimate")
    common = _spans(estimates[0], longest_step_seconds)
    for estimate in estimates[1:]:
        other = _spans(estimate, longest_step_seconds)
        begin = np.maximum(common[:, np.newaxis, 0], other[np.newaxis, :, 0])
        end = np.minimum(common[:, np.newaxis, 1], other[np.newaxis, :, 1])
        overlap = begin <= end
        common = np.column_stack((begin[overlap], end[overlap]))
    if not len(common):
        raise AssociationError(f"there is no time at which all {len(estimates)} estimates have poses")
    return common


def within(trajectory: Trajectory, spans: FloatArray) -> Trajectory:
    """The poses of a trajectory inside spans of time.

    Args:
        trajectory: n poses.
        spans: First and last times in s, ascending, shape (k, 2).

    Returns:
        The poses inside.

    Raises:
        AssociationError: None is inside.
    """
    span = np.searchsorted(spans[:, 0], trajectory.stamps, side="right") - 1
    inside = (span >= 0) & (trajectory.stamps <= spans[np.maximum(span, 0), 1])
    if not inside.any():
        raise AssociationError("the trajectory has no pose inside the common support")
    return trajectory.select(np.flatnonzero(inside))


def segment_numbers(estimate: Trajectory, restarts: Sequence[float]) -> IndexArray:
    """Number each pose by the restarts before it: 0 until the first restart, shape (n,).

    Args:
        estimate: n poses.
        restarts: Times in s at which a new segment begins, ascending.
    """
    return np.searchsorted(np.asarray(restarts, dtype=np.float64), estimate.stamps, side="right")


def evaluate_segments(
    reference: Trajectory,
    estimate: Trajectory,
    segments: npt.NDArray[np.integer[Any]],
    options: Options | None = None,
    *,
    most: int | None = None,
) -> SegmentedEvaluation:
    """Measure an estimate that started again, or holds several maps, piece by piece.

    The segment whose associated poses span the longest path of the ground truth is aligned and stands for
    the estimate; its coverage is that of the whole ground truth. Each of the others is aligned on its own,
    and measured under the main segment's alignment too, which shows whether the pieces share a frame.

    Args:
        reference: Ground truth.
        estimate: n poses.
        segments: Number of each pose's segment, shape (n,).
        options: How to evaluate. The offset of the estimate's clock is found for all segments together.
        most: Measure so many segments, those over the longest paths; None for all.

    Returns:
        The main segment and the others.

    Raises:
        OptionError: Another number of segments than poses, or options that aren't allowed.
    """
    if segments.shape != (len(estimate),):
        raise OptionError(f"{len(estimate)} poses need as many segment numbers, not {segments.shape}")
    options = options or Options()
    clock = None
    with contextlib.suppress(AssociationError):  # then each segment's evaluation says why
        estimate, clock = set_clock(reference, estimate, options.preparation)
        options = replace(options, clock="given")
    order = np.argsort(segments, kind="stable")
    ends = np.flatnonzero(np.diff(segments[order])) + 1
    parts = {int(segments[part[0]]): estimate.select(part) for part in np.split(order, ends)}
    spans = {name: _span_metres(reference, part, options) for name, part in parts.items()}
    names = sorted(parts, key=lambda name: (-spans[name], -len(parts[name]), name))[:most]
    main = replace(evaluate(reference, parts[names[0]], options), clock=clock)

    def measured(name: int) -> Segment:
        part, is_main = parts[name], name == names[0]
        return Segment(
            name=name,
            begin=float(part.stamps[0]),
            end=float(part.stamps[-1]),
            poses=len(part),
            metres=spans[name],
            alone=main if is_main else evaluate(reference, part, options),
            in_main_frame=main.ate if is_main else _under(main, reference, part, options),
        )

    others = tuple(measured(name) for name in sorted(names[1:]))
    return SegmentedEvaluation(measured(names[0]), others, len(parts) - len(names))


def _limit(estimate: Trajectory, longest_step_seconds: float | None) -> float:
    if longest_step_seconds is None:
        return KEYFRAME_STEP_SECONDS if is_keyframes(estimate) else FRAME_STEP_SECONDS
    if not longest_step_seconds > 0:
        raise OptionError(
            f"the longest step must be a positive number of seconds, not {longest_step_seconds}"
        )
    return longest_step_seconds


def _spans(estimate: Trajectory, longest_step_seconds: float | None) -> FloatArray:
    breaks = np.flatnonzero(np.diff(estimate.stamps) > _limit(estimate, longest_step_seconds))
    begin = estimate.stamps[np.concatenate(([0], breaks + 1))]
    return np.column_stack((begin, estimate.stamps[np.concatenate((breaks, [len(estimate) - 1]))]))


def _span_metres(reference: Trajectory, part: Trajectory, options: Options) -> float:
    pairs, _, _ = options.preparation.pair_up(reference, part)
    if not len(pairs):
        return 0.0
    return float(reference.distances[pairs.reference[-1]] - reference.distances[pairs.reference[0]])


def _under(main: Evaluation, reference: Trajectory, part: Trajectory, options: Options) -> Statistics | None:
    pairs, truth, kept = options.preparation.pair_up(reference, part)
    if main.alignment is None or not len(pairs) or options.hand_eye:
        return None
    if options.extrinsic is not None:
        truth = truth.moved(options.extrinsic)
    return Statistics.of(metrics.ape_errors(truth, main.alignment.apply(kept)))
