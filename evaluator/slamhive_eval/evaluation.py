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
from slamhive_eval.alignment import METHODS, Alignment, Method, align, stands_still, umeyama_scale
from slamhive_eval.association import associate, no_overlap
from slamhive_eval.coverage import Coverage, measure_coverage
from slamhive_eval.errors import OptionError
from slamhive_eval.metrics import Statistics
from slamhive_eval.pairs import Unit, find_pairs

if TYPE_CHECKING:
    from slamhive_eval.association import Association
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

MIN_POSES = 3
"""Fewer associated poses than this have no error worth the name."""
MIN_SCALE, MAX_SCALE = 0.5, 2.0
MAX_ATE_SHARE = 0.1
"""An ATE above this share of the ground truth's path is a diverged run."""
PARTIAL_COVERAGE = 0.5
_LARGEST_POSITION = 1e100
"""Beyond this squares overflow; such an estimate has diverged, whatever its error would be."""


class Outcome(StrEnum):
    """What became of a run, in falling order."""

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
    """How to evaluate.

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

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data: delta, unit, pairs, relTolerance, count, the statistics, rotationDeg."""
        asked = self.options
        return {
            "delta": float(asked.delta),
            "unit": asked.unit,
            "pairs": asked.pairs,
            "relTolerance": float(asked.rel_tolerance),
            "count": len(self.pairs),
            **(self.statistics.as_dict() if self.statistics else dict.fromkeys(Statistics.__match_args__)),
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
        rotation_errors_deg: Rotation angles in degrees, shape (m,).
    """

    association: Association
    reference: Trajectory
    estimate: Trajectory
    errors: FloatArray
    rotation_errors_deg: FloatArray


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What evaluate found.

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
        rpe: One entry for each asked, empty without alignment.
        poses: The compared poses and their errors, or None.
        notes: Sentences on what degenerate input left undetermined.
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

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data under the project's field names; a number that isn't finite becomes null."""
        transform = self.alignment.transform if self.alignment else None
        finite = transform is not None and bool(np.isfinite(transform).all())
        return {
            "outcome": self.outcome.value,
            "message": self.message,
            "coverage": self.coverage.share,
            "keyframes": self.coverage.keyframes,
            "scale": self.scale if self.scale is not None and np.isfinite(self.scale) else None,
            "alignment": self.alignment_method,
            "transform": transform.tolist() if transform is not None and finite else None,
            "poses": self.matched,
            "referencePoses": self.reference_poses,
            "estimatePoses": self.estimate_poses,
            "pathLength": self.coverage.path_length,
            "coveredLength": self.coverage.covered_length,
            "ate": self.ate.as_dict() if self.ate else None,
            "ateRotationDeg": self.ate_rotation_deg.as_dict() if self.ate_rotation_deg else None,
            "rpe": [error.as_dict() for error in self.rpe],
            "notes": list(self.notes),
        }


def evaluate(reference: Trajectory, estimate: Trajectory, options: Options | None = None) -> Evaluation:
    """Measure an estimate against ground truth.

    Args:
        reference: Ground truth of the body.
        estimate: What an algorithm wrote, of the body or, with an extrinsic, of a sensor.
        options: How; SE(3), no extrinsic and RPE over 1 m by default.

    Returns:
        Errors, coverage and outcome. Too few common poses make a lost run, with a sentence that says why.

    Raises:
        OptionError: An option that isn't allowed.
    """
    options = options or Options()
    pairs = associate(reference, estimate, options.max_difference_seconds, options.offset_seconds)
    coverage = measure_coverage(
        reference, estimate, pairs, keyframes=options.keyframes, window=options.window
    )
    result = Evaluation(
        outcome=Outcome.LOST,
        message="",
        coverage=coverage,
        alignment_method=options.alignment,
        matched=len(pairs),
        reference_poses=len(reference),
        estimate_poses=len(estimate),
    )
    failure = _unusable(reference, estimate, pairs, options)
    if failure is not None:
        return replace(result, outcome=failure[0], message=failure[1])
    associated = reference.select(pairs.reference)
    if options.extrinsic is not None:
        associated = associated.moved(options.extrinsic)
    return _measured(result, pairs, associated, estimate.select(pairs.estimate), options)


def judge(coverage: Coverage, ate: Statistics, scale: float | None, options: Options) -> tuple[Outcome, str]:
    """The outcome and why.

    Diverged comes first: no scale at all (the estimate stands still while the ground truth moves), a scale
    outside [0.5, 2] where the sensors have scale, or an ATE above a tenth of the path. Then coverage decides.
    """
    share = coverage.share
    divergence = _divergence(coverage.path_length, ate.rmse, scale, has_scale=options.has_scale)
    if divergence:
        return Outcome.DIVERGED, divergence
    if share < PARTIAL_COVERAGE:
        return Outcome.LOST, f"the estimate covers {share:.1%} of the ground truth's path"
    if share < options.min_coverage:
        asked = f"{options.min_coverage:.0%} were asked"
        return Outcome.PARTIAL, f"the estimate covers {share:.1%} of the ground truth's path; {asked}"
    if options.max_ate is not None and ate.rmse > options.max_ate:
        return Outcome.PARTIAL, f"the ATE of {ate.rmse:.4g} m exceeds the {options.max_ate:g} m asked"
    return Outcome.TRACKED, ""


def _unusable(
    reference: Trajectory, estimate: Trajectory, pairs: Association, options: Options
) -> tuple[Outcome, str] | None:
    """Outcome and sentence for an estimate that no error can be computed for."""
    if not len(pairs):
        error = no_overlap(reference, estimate, options.max_difference_seconds, options.offset_seconds)
        return Outcome.LOST, str(error)
    if len(pairs) < MIN_POSES:
        found = f"{len(pairs)} of {len(estimate)} poses of the estimate have a ground-truth pose within"
        needed = f"an error needs at least {MIN_POSES}"
        return Outcome.LOST, f"{found} {options.max_difference_seconds:g} s; {needed}"
    largest = float(np.abs(estimate.positions).max())
    if largest > _LARGEST_POSITION:
        return Outcome.DIVERGED, f"the estimate reaches {largest:.3g} m from its origin"
    return None


def _divergence(path: float, rmse: float, scale: float | None, *, has_scale: bool) -> str:
    """Why the estimate has diverged, empty when it hasn't."""
    if scale is None:
        return "the estimate stands still while the ground truth moves"
    if has_scale and not MIN_SCALE <= scale <= MAX_SCALE:
        return f"the scale is {scale:.4g}; it must lie within {MIN_SCALE} and {MAX_SCALE}"
    if path > 0 and not rmse <= MAX_ATE_SHARE * path:
        return f"the ATE of {rmse:.4g} m exceeds {MAX_ATE_SHARE:.0%} of the path of {path:.4g} m"
    return ""


def _measured(
    result: Evaluation, pairs: Association, reference: Trajectory, estimate: Trajectory, options: Options
) -> Evaluation:
    """The result with alignment, errors and outcome of associated trajectories."""
    alignment = align(reference, estimate, options.alignment)
    aligned = alignment.apply(estimate)
    errors = metrics.ape_errors(reference, aligned)
    rotation_errors = metrics.ape_errors(reference, aligned, "angle_deg")
    ate = Statistics.of(errors)
    assert ate is not None  # noqa: S101 - MIN_POSES are there
    moves = not stands_still(reference.positions)
    scale = umeyama_scale(reference, estimate) if moves else None
    outcome, message = judge(result.coverage, ate, scale if moves else 1.0, options)
    return replace(
        result,
        outcome=outcome,
        message=message,
        alignment=alignment,
        scale=scale,
        ate=ate,
        ate_rotation_deg=Statistics.of(rotation_errors),
        rpe=tuple(_relative(reference, aligned, asked) for asked in options.rpe),
        poses=Poses(pairs, reference, aligned, errors, rotation_errors),
        notes=alignment.notes,
    )


def _relative(reference: Trajectory, aligned: Trajectory, asked: RpeOptions) -> RelativeError:
    every = asked.pairs == "all"
    pairs = find_pairs(aligned, asked.delta, asked.unit, all_pairs=every, rel_tolerance=asked.rel_tolerance)
    errors = metrics.rpe_errors(reference, aligned, pairs)
    degrees = metrics.rpe_errors(reference, aligned, pairs, "angle_deg")
    return RelativeError(asked, pairs, errors, degrees, Statistics.of(errors), Statistics.of(degrees))
