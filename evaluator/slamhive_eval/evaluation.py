# SPDX-License-Identifier: Apache-2.0
"""One estimate against its ground truth, from association to outcome: what every caller uses.

The workstation's executor, the evaluator container and the importer call ``evaluate`` and store
``Evaluation.as_dict()``. What an algorithm did badly is a result with a sentence, never an exception.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from slamhive_eval import metrics
from slamhive_eval.alignment import METHODS, Alignment, Method, stands_still, umeyama_scale
from slamhive_eval.association import (
    DEFAULT_GAP_SECONDS,
    Association,
    Matching,
    equal_stamps_notes,
    no_overlap,
)
from slamhive_eval.coverage import Coverage, measure_coverage, no_coverage
from slamhive_eval.errors import AssociationError, OptionError
from slamhive_eval.pairs import MIN_RANKED_PAIRS, Unit, find_pairs
from slamhive_eval.preparing import Clock, Preparation, Prepared, lay, set_clock
from slamhive_eval.statistics import STATISTICS, Statistics

if TYPE_CHECKING:
    from slamhive_eval.robust import Loss
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.timing import TimeOffset
    from slamhive_eval.trajectory import Trajectory

VERSION = 2
"""Version of the figures, raised where the same input gives others than before.

2: poses are paired one to one, rows of NaN are left out and counted, KITTI's segments begin and end at frames
of the ground truth.
"""
MIN_POSES = 3
"""Fewer associated poses than this have no error worth the name."""
MIN_SCALE, MAX_SCALE = 0.5, 2.0
MAX_ATE_SHARE = 0.1
"""An ATE above this share of the ground truth's path is a diverged run."""
MAX_LOCAL_SHARE = 0.25
"""A relative error above this share of a short way is out of proportion; what stands still has 1."""
PARTIAL_COVERAGE = 0.5
NO_POSE = "the algorithm wrote no pose"
MOTION_METRES = 0.1
"""Ground truth that extends further than this has moved; what stands still meanwhile has diverged."""


class Outcome(StrEnum):
    """Outcomes of a run by its evaluation, from best to worst."""

    TRACKED = "Tracked"
    PARTIAL = "Partial"
    LOST = "Lost"
    DIVERGED = "Diverged"


@dataclass(frozen=True)
class RpeOptions:
    """One relative pose error.

    Attributes:
        delta: Distance between the poses of a pair, in the unit.
        unit: ``frames``, ``m``, ``s``, ``deg`` or ``rad``.
        pairs: ``all`` or ``consecutive``.
        rel_tolerance: Share of delta by which all pairs may miss it.
    """

    delta: float = 1.0
    unit: Unit = "m"
    pairs: Literal["all", "consecutive"] = "all"
    rel_tolerance: float = 0.1

    def __post_init__(self) -> None:
        if self.pairs not in ("all", "consecutive"):
            raise OptionError(f"pairs must be 'all' or 'consecutive', not {self.pairs!r}")


@dataclass(frozen=True, eq=False)
class Options:
    """Options of an evaluation: matching, alignment, errors to compute and thresholds of the outcome.

    Attributes:
        alignment: ``none``, ``origin``, ``se3``, ``sim3``, ``scale`` or ``yaw``.
        extrinsic: T_body_sensor, (4, 4), when the estimate is of a sensor: the ground truth is moved there.
            None leaves it.
        max_difference_seconds: Largest time difference of an associated pair in s.
        offset_seconds: Added to the estimate's stamps for association.
        rpe: Relative errors to compute.
        min_coverage: Coverage from which a run counts as tracked.
        max_ate: Largest ATE rmse in m of a tracked run; None for no limit.
        keyframes: Whether the estimate holds keyframes only; None to tell by its spacing.
        has_scale: Whether the sensors give metric scale: then a scale outside [0.5, 2] is divergence.
        window: First and last time of the run in s; the ground truth outside doesn't count for coverage.
        matching: How poses are matched, with its gap; see `slamhive_eval.Preparation`, as for what follows.
        max_gap_seconds: Largest gap in s of ground truth that is interpolated.
        clock: ``given``, or find the ``offset`` or ``drift`` of the estimate's clock.
        hand_eye: Find the extrinsic.
        first_poses: Align by so many poses only.
        robust: ``huber`` or ``trimmed``.
        keep: Share of the poses that ``trimmed`` fits.
    """

    alignment: Method = "se3"
    extrinsic: FloatArray | None = None
    max_difference_seconds: float = 0.01
    offset_seconds: float = 0.0
    rpe: tuple[RpeOptions, ...] = (RpeOptions(),)
    min_coverage: float = 0.9
    max_ate: float | None = None
    keyframes: bool | None = None
    has_scale: bool = True
    window: tuple[float, float] | None = None
    matching: Matching = "nearest"
    max_gap_seconds: float = DEFAULT_GAP_SECONDS
    clock: Clock = "given"
    hand_eye: bool = False
    first_poses: int | None = None
    robust: Loss | None = None
    keep: float = 0.75

    @property
    def preparation(self) -> Preparation:
        """Settings for matching the trajectories and laying them onto one another.

        Raises:
            OptionError: Options that contradict one another.
        """
        return Preparation(
            matching=self.matching,
            max_difference_seconds=self.max_difference_seconds,
            max_gap_seconds=self.max_gap_seconds,
            clock=self.clock,
            offset_seconds=self.offset_seconds,
            extrinsic=self.extrinsic,
            hand_eye=self.hand_eye,
            alignment=self.alignment,
            first_poses=self.first_poses,
            robust=self.robust,
            keep=self.keep,
        )

    def __post_init__(self) -> None:
        if self.alignment not in METHODS:
            raise OptionError(f"unknown alignment {self.alignment!r}; known are {', '.join(METHODS)}")
        if not 0.0 <= self.min_coverage <= 1.0:
            raise OptionError(f"the smallest coverage must lie within 0 and 1, not {self.min_coverage}")
        if self.max_ate is not None and not self.max_ate > 0:
            raise OptionError(f"the largest ATE must be a positive number of metres, not {self.max_ate}")


@dataclass(frozen=True, eq=False)
class RelativeError:
    """One RPE: what was asked, the pairs and their errors.

    Attributes:
        options: What was asked.
        pairs: Indices (i, j) into the associated poses, shape (k, 2).
        errors: Translation errors in m, shape (k,).
        rotation_errors_deg: Rotation angles in degrees, shape (k,).
        statistics: Of errors, None without pairs.
        rotation_deg: Of rotation_errors_deg, None without pairs.
    """

    options: RpeOptions
    pairs: IndexArray
    errors: FloatArray
    rotation_errors_deg: FloatArray
    statistics: Statistics | None
    rotation_deg: Statistics | None

    @property
    def ranked(self) -> bool:
        """True if there are enough pairs of poses to rank by."""
        return len(self.pairs) >= MIN_RANKED_PAIRS

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data: delta, unit, pairs, relTolerance, count, ranked, the statistics, rotationDeg."""
        asked = self.options
        return {
            "delta": float(asked.delta),
            "unit": asked.unit,
            "pairs": asked.pairs,
            "relTolerance": float(asked.rel_tolerance),
            "count": len(self.pairs),
            "ranked": self.ranked,
            **(self.statistics.as_dict() if self.statistics else dict.fromkeys(STATISTICS)),
            "rotationDeg": self.rotation_deg.as_dict() if self.rotation_deg else None,
        }


@dataclass(frozen=True, eq=False)
class Poses:
    """The compared poses and their errors, one entry a pair, for plots.

    Attributes:
        association: Indices into the trajectories given.
        reference: Associated ground truth in the estimate's frame, m poses.
        estimate: Associated estimate, aligned, m poses.
        errors: Distances in m, shape (m,).
        rotation_errors_deg: Rotation angles in degrees, shape (m,); (0,) where one has no orientations.
    """

    association: Association
    reference: Trajectory
    estimate: Trajectory
    errors: FloatArray
    rotation_errors_deg: FloatArray


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Result of `evaluate`: outcome, coverage, alignment and errors of an estimate.

    Attributes:
        outcome: Tracked, Partial, Lost or Diverged.
        message: Why, in a sentence; empty for a tracked run.
        coverage: Coverage of the ground truth's path.
        alignment_method: The alignment asked for.
        matched: Number of associated poses.
        reference_poses: Poses of the ground truth.
        estimate_poses: Poses of the estimate.
        alignment: The alignment found, None when too few poses were associated or they overflow.
        scale: Scale of the Sim(3) alignment whatever the method, None where it isn't determined.
        ate: Statistics of the aligned distances in m, or None.
        ate_rotation_deg: Statistics of the rotation angles in degrees, or None.
        rpe: One entry for each asked, empty without alignment or without orientations.
        poses: The compared poses and their errors, or None.
        notes: Sentences on how the estimate was read and on what degenerate input left undetermined.
        clock: The offset of the estimate's clock, None where it wasn't asked for or found.
        nan_rows: Rows of the estimate's file that held NaN and were left out.
    """

    outcome: Outcome
    message: str
    coverage: Coverage
    alignment_method: Method
    matched: int
    reference_poses: int
    estimate_poses: int
    alignment: Alignment | None = None
    scale: float | None = None
    ate: Statistics | None = None
    ate_rotation_deg: Statistics | None = None
    rpe: tuple[RelativeError, ...] = ()
    poses: Poses | None = field(default=None, repr=False)
    notes: tuple[str, ...] = ()
    clock: TimeOffset | None = None
    nan_rows: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data under the project's field names; a number that isn't finite becomes null."""
        return {
            "outcome": self.outcome.value,
            "message": self.message,
            "coverage": self.coverage.share,
            "keyframes": self.coverage.keyframes,
            **alignment_fields(self.alignment_method, self.alignment, self.scale),
            "poses": self.matched,
            "referencePoses": self.reference_poses,
            "estimatePoses": self.estimate_poses,
            "pathLength": self.coverage.path_length,
            "coveredLength": self.coverage.covered_length,
            "ate": self.ate.as_dict() if self.ate else None,
            "ateRotationDeg": self.ate_rotation_deg.as_dict() if self.ate_rotation_deg else None,
            "rpe": [error.as_dict() for error in self.rpe],
            "notes": list(self.notes),
            **({} if self.clock is None else {"clock": self.clock.as_dict()}),
            **({"nanRows": self.nan_rows} if self.nan_rows else {}),
        }


def alignment_fields(method: Method, alignment: Alignment | None, scale: float | None) -> dict[str, Any]:
    """Scale, method and transform as plain JSON data; a number that isn't finite becomes null."""
    transform = alignment.transform if alignment else None
    finite = transform is not None and bool(np.isfinite(transform).all())
    return {
        "scale": scale if scale is not None and np.isfinite(scale) else None,
        "alignment": method,
        "transform": transform.tolist() if transform is not None and finite else None,
    }


def evaluate(
    reference: Trajectory, estimate: Trajectory | None, options: Options | None = None
) -> Evaluation:
    """Measure an estimate against ground truth.

    Args:
        reference: Ground truth of the body.
        estimate: What an algorithm wrote, of the body or, with an extrinsic, of a sensor. None: it ran to its
            end and wrote no pose, which is a lost run.
        options: How; SE(3), no extrinsic and RPE over 1 m by default.

    Returns:
        Errors, coverage and outcome. Too few common poses make a lost run, with a sentence that says why.

    Raises:
        OptionError: An option that isn't allowed, or a lever arm where neither has orientations.
    """
    options = options or Options()
    if estimate is None:
        return Evaluation(
            outcome=Outcome.LOST,
            message=NO_POSE,
            coverage=no_coverage(reference, keyframes=options.keyframes, window=options.window),
            alignment_method=options.alignment,
            matched=0,
            reference_poses=len(reference),
            estimate_poses=0,
        )
    how = options.preparation
    problem, clock = "", None
    try:
        estimate, clock = set_clock(reference, estimate, how)
        pairs, truth, kept = how.pair_up(reference, estimate)
    except AssociationError as error:  # the clock's offset can't be found
        nothing = np.empty(0, dtype=np.intp)
        problem, pairs = str(error), Association(nothing, nothing)
    coverage = measure_coverage(
        reference, estimate, pairs, keyframes=options.keyframes, window=options.window
    )
    result = Evaluation(
        outcome=Outcome.LOST,
        message=problem,
        coverage=coverage,
        alignment_method=options.alignment,
        matched=len(pairs),
        reference_poses=len(reference),
        estimate_poses=len(estimate),
        notes=(*estimate.notes, *equal_stamps_notes(estimate)),
        clock=clock,
        nan_rows=estimate.nan_rows,
    )
    if len(pairs) < MIN_POSES:
        return replace(result, message=problem or _too_few(reference, estimate, pairs, options))
    return _measured(result, pairs, lay(truth, kept, how), options)


def judge(coverage: Coverage, ate: Statistics, scale: float | None, options: Options) -> tuple[Outcome, str]:
    """The outcome and why.

    Diverged comes first: a scale outside [0.5, 2] where the sensors have scale, or an ATE above a tenth of
    the path. Then coverage decides.

    Args:
        coverage: Of the ground truth.
        ate: Aligned errors in m.
        scale: Of the Sim(3) alignment, None where it isn't determined.
        options: The limits.

    Returns:
        The outcome and a sentence, empty for a tracked run.
    """
    path, share = coverage.path_length, coverage.share
    if options.has_scale and scale is not None and not MIN_SCALE <= scale <= MAX_SCALE:
        return Outcome.DIVERGED, f"the scale is {scale:.4g}; it must lie within {MIN_SCALE} and {MAX_SCALE}"
    if path > 0 and not ate.rmse <= MAX_ATE_SHARE * path:
        limit = f"{MAX_ATE_SHARE:.0%} of the path of {path:.4g} m"
        return Outcome.DIVERGED, f"the ATE of {ate.rmse:.4g} m exceeds {limit}"
    if share < PARTIAL_COVERAGE:
        return Outcome.LOST, f"the estimate covers {share:.1%} of the ground truth's path"
    if share < options.min_coverage:
        asked = f"{options.min_coverage:.0%} were asked"
        return Outcome.PARTIAL, f"the estimate covers {share:.1%} of the ground truth's path; {asked}"
    if options.max_ate is not None and ate.rmse > options.max_ate:
        return Outcome.PARTIAL, f"the ATE of {ate.rmse:.4g} m exceeds the {options.max_ate:g} m asked"
    return Outcome.TRACKED, ""


def _too_few(reference: Trajectory, estimate: Trajectory, pairs: Association, options: Options) -> str:
    limit = options.max_gap_seconds if options.matching == "interpolate" else options.max_difference_seconds
    if not len(pairs):
        return str(no_overlap(reference, estimate, limit, options.offset_seconds))
    return (
        f"{len(pairs)} of {len(estimate)} poses of the estimate have a ground-truth pose of their own within "
        f"{limit:g} s; an error needs at least {MIN_POSES}"
    )


def _measured(result: Evaluation, pairs: Association, laid: Prepared, options: Options) -> Evaluation:
    """The result with alignment, errors and outcome of associated trajectories."""
    alignment, reference, aligned, estimate = laid.alignment, laid.reference, laid.estimate, laid.matched
    errors = metrics.ape_errors(reference, aligned)
    notes, rpe, rotation_errors = result.notes + alignment.notes, options.rpe, np.empty(0)
    if reference.oriented and aligned.oriented:
        rotation_errors = metrics.ape_errors(reference, aligned, "angle_deg")
    else:
        rpe = ()
        notes += ("there are no orientations: rotation errors and relative errors were left out",)
    ate = Statistics.of(errors)
    assert ate is not None  # noqa: S101 - MIN_POSES are there
    scale = umeyama_scale(reference, estimate)
    outcome, message = judge(result.coverage, ate, scale, options)
    moved = float(np.ptp(reference.positions, axis=0).max())
    if outcome is not Outcome.LOST and stands_still(estimate.positions) and moved > MOTION_METRES:
        outcome = Outcome.DIVERGED
        message = f"the estimate stands still while the ground truth moves over {moved:.3g} m"
    return replace(
        result,
        outcome=outcome,
        message=message,
        alignment=alignment,
        scale=scale,
        ate=ate,
        ate_rotation_deg=Statistics.of(rotation_errors),
        rpe=tuple(_relative(reference, aligned, asked) for asked in rpe),
        poses=Poses(pairs, reference, aligned, errors, rotation_errors),
        notes=notes,
    )


def _relative(reference: Trajectory, aligned: Trajectory, asked: RpeOptions) -> RelativeError:
    every = asked.pairs == "all"
    pairs = find_pairs(aligned, asked.delta, asked.unit, all_pairs=every, rel_tolerance=asked.rel_tolerance)
    errors = metrics.rpe_errors(reference, aligned, pairs)
    degrees = metrics.rpe_errors(reference, aligned, pairs, "angle_deg")
    return RelativeError(asked, pairs, errors, degrees, Statistics.of(errors), Statistics.of(degrees))
