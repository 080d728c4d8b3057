# SPDX-License-Identifier: Apache-2.0
"""Control points as ground truth: surveyed positions at a few instants, with seconds or minutes between them.

A total station, or tags on the ground, give where the platform was now and then, and nothing in between. So
the estimate is interpolated to the points' times, never the points to the estimate's, and what is covered is
a share of the points instead of a path. Runs against such datasets and ``slamhive-eval points`` use this.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.alignment import stands_still, umeyama_scale
from slamhive_eval.association import interpolate, nearest
from slamhive_eval.coverage import KEYFRAME_STEP_SECONDS, is_keyframes
from slamhive_eval.errors import OptionError, TrajectoryError
from slamhive_eval.evaluation import (
    MAX_ATE_SHARE,
    MAX_SCALE,
    MIN_POSES,
    MIN_SCALE,
    MOTION_METRES,
    NO_POSE,
    PARTIAL_COVERAGE,
    Options,
    Outcome,
    alignment_fields,
)
from slamhive_eval.preparing import lay
from slamhive_eval.statistics import Statistics
from slamhive_eval.trajectory import Trajectory

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval.alignment import Alignment, Method
    from slamhive_eval.preparing import Preparation, Prepared
    from slamhive_eval.rotation import FloatArray

MOST_ERRORS = 100
"""Errors of single points that a result holds: the largest of them, where there are more."""
_MOST_GROUPS = 50
"""Groups of points that are left out in turn for the standard error; with fewer points each is one."""
_FITTED = {"se3": 6, "sim3": 7, "yaw": 4}
"""Numbers that an alignment fits."""
_SLIGHT = 0.05
NO_RELATIVE = (
    "the ground truth is control points: relative errors and errors of rotation were left out, as there is "
    "no motion and no orientation between and at the points; drift and jumps between them are not seen"
)


@dataclass(frozen=True, eq=False)
class ControlPoints:
    """Known positions at instants.

    Attributes:
        stamps: In s, shape (n,), n ≥ 1, never decreasing.
        positions: In m, shape (n, 3).

    Raises:
        TrajectoryError: No points, arrays of unequal length, a number that isn't finite, a decreasing stamp.
    """

    stamps: FloatArray
    positions: FloatArray

    def __post_init__(self) -> None:
        checked = _bare(np.asarray(self.stamps, float), np.asarray(self.positions, float))
        object.__setattr__(self, "stamps", checked.stamps)
        object.__setattr__(self, "positions", checked.positions)

    @classmethod
    def of(cls, poses: Trajectory) -> ControlPoints:
        """The positions of poses; their orientations, which often are filler, are dropped."""
        return cls(poses.stamps, poses.positions)

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def trajectory(self) -> Trajectory:
        """The same as a trajectory of bare positions."""
        return _bare(self.stamps, self.positions)

    def select(self, index: npt.NDArray[np.bool_]) -> ControlPoints:
        """The points that are chosen, one at least."""
        return ControlPoints(self.stamps[index], self.positions[index])


@dataclass(frozen=True, eq=False)
class PointErrors:
    """Result of `evaluate_points`: errors of an estimate at control points, and the run's outcome.

    Attributes:
        outcome: Tracked, Partial, Lost or Diverged.
        message: Why, in a sentence; empty for a tracked run.
        points: The control points in the run's time.
        met: Which of them the estimate has a pose at, shape (points,).
        method: The alignment asked for.
        estimate_poses: Poses of the estimate.
        alignment: What laid the estimate onto the points, None where it couldn't be found.
        scale: Of the Sim(3) alignment whatever the method, None where it isn't determined.
        errors: Distance at each point that is met, in m, shape (met,).
        ate: Statistics of them, or None.
        standard_error: Of the RMSE, in m, by the chance of which instants were surveyed, by leaving points
            out in turn. None where fewer than four points are met, or without one of them an alignment isn't
            determined.
        laid: The points that are met and the estimate there, aligned; None where it couldn't be.
        notes: Sentences on what was done and left out.
    """

    outcome: Outcome
    message: str
    points: ControlPoints
    met: npt.NDArray[np.bool_]
    method: Method
    estimate_poses: int
    alignment: Alignment | None = None
    scale: float | None = None
    errors: FloatArray | None = None
    ate: Statistics | None = None
    standard_error: float | None = None
    laid: Prepared | None = field(default=None, repr=False)
    notes: tuple[str, ...] = ()

    @property
    def share(self) -> float:
        """Share of the points that are met: the coverage."""
        return float(self.met.mean())

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data: as of `Evaluation`, with ``points`` and, point by point, ``pointErrors``.

        ``pathLength`` is that of the straight lines from point to point.
        """
        steps = np.diff(self.points.stamps)
        return {
            "outcome": self.outcome.value,
            "message": self.message,
            "coverage": self.share,
            **alignment_fields(self.method, self.alignment, self.scale),
            "estimatePoses": self.estimate_poses,
            "pathLength": float(rotation.vector_norm(np.diff(self.points.positions, axis=0)).sum()),
            "ate": self.ate.as_dict() if self.ate else None,
            "rpe": [],
            "points": {
                "count": len(self.points),
                "met": int(self.met.sum()),
                "missing": int((~self.met).sum()),
                "share": self.share,
                "medianSpacingSeconds": float(np.median(steps)) if len(steps) else None,
                "longestSpacingSeconds": float(steps.max()) if len(steps) else None,
                "rmseStandardError": self.standard_error,
            },
            "pointErrors": self._listed(),
            "notes": list(self.notes),
        }

    def _listed(self) -> list[dict[str, float]]:
        """Time and error of the points that are met, in the order of time."""
        if self.errors is None:
            return []
        stamps = self.points.stamps[self.met]
        chosen = np.sort(np.argsort(-self.errors, kind="stable")[:MOST_ERRORS])
        return [{"time": float(stamps[k]), "error": float(f"{self.errors[k]:.6g}")} for k in chosen]


def evaluate_points(
    points: ControlPoints, estimate: Trajectory | None, options: Options | None = None
) -> PointErrors:
    """Measure an estimate against control points.

    The estimate is taken at each point's time: positions linear, rotations by slerp (Shoemake 1985) between
    the poses before and after it, where these are at most ``max_gap_seconds`` apart (5 s where the estimate
    holds keyframes alone, as for `measure_coverage`), else the pose within ``max_difference_seconds``. What
    is met so is aligned by Umeyama's closed form.

    Args:
        points: Where the frame of the ground truth was.
        estimate: Any world frame; None: it ran to its end and wrote no pose, which is a lost run.
        options: How. With ``extrinsic`` (T_truth_estimate) the points are of another frame than the estimate,
            which is moved there by its own orientation, see `slamhive_eval.preparing.lay`. The clock of the
            estimate is not looked for.

    Returns:
        Errors, share of the points met, and outcome. Fewer than three points met, or points on a line, are a
        lost run with a sentence that says so.

    Raises:
        OptionError: An option that isn't allowed, or a lever arm for an estimate without orientations.
    """
    options = options or Options()
    points = _in_window(points, options)
    nothing = np.zeros(len(points), dtype=np.bool_)
    if estimate is None:
        return PointErrors(Outcome.LOST, NO_POSE, points, nothing, options.alignment, 0)
    keyframes = is_keyframes(estimate) if options.keyframes is None else options.keyframes
    gap = KEYFRAME_STEP_SECONDS if keyframes else options.max_gap_seconds
    met, at_points = _at(estimate, points.stamps - options.offset_seconds, gap, options)
    result = PointErrors(
        outcome=Outcome.LOST,
        message="",
        points=points,
        met=met,
        method=options.alignment,
        estimate_poses=len(estimate),
        notes=(*estimate.notes, NO_RELATIVE),
    )
    if at_points is None or len(at_points) < MIN_POSES:
        return replace(result, message=_too_few(result, gap))
    truth = _bare(points.stamps[met], points.positions[met])
    try:
        laid = lay(truth, at_points, options.preparation)
    except TrajectoryError as error:
        return replace(result, message=f"{error}; {len(truth)} control points were met")
    chance = _standard_error(truth, at_points, options.preparation)
    return _judged(replace(result, standard_error=chance), laid, options)


def require_point_options(options: Options | Preparation) -> None:
    """Check that control points can serve what is asked.

    Raises:
        OptionError: They can't.
    """
    if options.hand_eye or options.clock != "given":
        raise OptionError("--hand-eye and --offset auto or drift need more than control points")


def _standard_error(truth: Trajectory, at_points: Trajectory, how: Preparation) -> float | None:
    """Standard error of the RMSE in m: the delete-a-group jackknife (Shao, Wu 1989), aligned anew each time.

    Points in a row are left out together where there are many, as their errors resemble one another.
    """
    count = len(truth)
    groups = np.array_split(np.arange(count), min(count, _MOST_GROUPS))
    found = []
    for group in groups:
        kept = np.delete(np.arange(count), group)
        if len(kept) < MIN_POSES:
            return None
        try:
            laid = lay(truth.select(kept), at_points.select(kept), how)
        except TrajectoryError:
            return None
        errors = rotation.vector_norm(laid.estimate.positions - laid.reference.positions)
        found.append(float(np.sqrt(np.mean(errors**2))))
    return float(np.sqrt((len(groups) - 1) * np.var(found)))


def _chance(result: PointErrors, rmse: float) -> list[str]:
    """Sentences on how far the RMSE at the points can be from that of the whole drive."""
    notes, count = [], int(result.met.sum())
    if result.standard_error is not None and rmse > 0:
        notes.append(
            f"the RMSE of {rmse:.4g} m at {count} control points has a standard error of "
            f"{result.standard_error:.2g} m ({result.standard_error / rmse:.0%}), by the chance of which "
            "instants were surveyed"
        )
    fitted = _FITTED.get(result.method, 0)
    # Of 3n squares the least-squares fit of m numbers leaves (3n - m) / 3n, if they are independent.
    looks = 1 - np.sqrt(max(1 - fitted / (3 * count), 0))
    if looks > _SLIGHT:
        notes.append(
            f"the alignment fits {fitted} numbers to {count} points, by which the RMSE looks smaller than it "
            f"is: by {looks:.0%} where errors are independent of one another, by less where they change "
            "slowly"
        )
    return notes


def _in_window(points: ControlPoints, options: Options) -> ControlPoints:
    """The points in the run's time: it can't know of others.

    Raises:
        OptionError: There is none.
    """
    if options.window is None:
        return points
    low, high = (
        options.window[0] - options.max_difference_seconds,
        options.window[1] + options.max_difference_seconds,
    )
    kept = (points.stamps >= low) & (points.stamps <= high)
    if not kept.any():
        raise OptionError(
            f"the ground truth has no control point in the run's time, {options.window[0]:.3f} s to "
            f"{options.window[1]:.3f} s"
        )
    return points.select(kept)


def _at(
    estimate: Trajectory, times: FloatArray, gap: float, options: Options
) -> tuple[npt.NDArray[np.bool_], Trajectory | None]:
    """Return a mask of the times with a pose of the estimate, (n,), and these poses; None without any."""
    met, positions, quaternions = interpolate(estimate, times, gap)
    close = nearest(estimate.stamps, times, options.max_difference_seconds)
    beside = ~met & (close >= 0)
    positions[beside] = estimate.positions[close[beside]]
    quaternions[beside] = estimate.quaternions[close[beside]]
    met = met | beside
    if not met.any():
        return met, None
    return met, Trajectory(times[met], positions[met], quaternions[met], oriented=estimate.oriented)


def _bare(stamps: FloatArray, positions: FloatArray) -> Trajectory:
    return Trajectory(stamps, positions, np.tile((0.0, 0.0, 0.0, 1.0), (len(stamps), 1)), oriented=False)


def _too_few(result: PointErrors, gap: float) -> str:
    met, count = int(result.met.sum()), len(result.points)
    return (
        f"{met} of {count} control points lie between poses of the estimate at most {gap:g} s apart; an "
        f"error needs at least {MIN_POSES}"
    )


def _judged(result: PointErrors, laid: Prepared, options: Options) -> PointErrors:
    """The result with errors and outcome; divergence is judged by the path from point to point."""
    truth, estimate, alignment = laid.reference, laid.matched, laid.alignment
    errors = rotation.vector_norm(laid.estimate.positions - truth.positions)
    ate = Statistics.of(errors)
    assert ate is not None  # noqa: S101 - MIN_POSES are there
    scale = umeyama_scale(truth, estimate)
    path, share = truth.path_length, result.share
    seen = f"the estimate meets {int(result.met.sum())} of {len(result.points)} control points"
    outcome, message = Outcome.TRACKED, ""
    moved = float(np.ptp(truth.positions, axis=0).max())
    if share >= PARTIAL_COVERAGE and stands_still(estimate.positions) and moved > MOTION_METRES:
        outcome = Outcome.DIVERGED
        message = f"the estimate stands still while the ground truth moves over {moved:.3g} m"
    elif options.has_scale and scale is not None and not MIN_SCALE <= scale <= MAX_SCALE:
        outcome = Outcome.DIVERGED
        message = f"the scale is {scale:.4g}; it must lie within {MIN_SCALE} and {MAX_SCALE}"
    elif path > 0 and not ate.rmse <= MAX_ATE_SHARE * path:
        outcome = Outcome.DIVERGED
        limit = f"{MAX_ATE_SHARE:.0%} of the {path:.4g} m from point to point"
        message = f"the ATE of {ate.rmse:.4g} m exceeds {limit}"
    elif share < options.min_coverage:
        outcome = Outcome.PARTIAL if share >= PARTIAL_COVERAGE else Outcome.LOST
        message = f"{seen}; {options.min_coverage:.0%} were asked"
    elif options.max_ate is not None and ate.rmse > options.max_ate:
        outcome = Outcome.PARTIAL
        message = f"the ATE of {ate.rmse:.4g} m exceeds the {options.max_ate:g} m asked"
    return replace(
        result,
        outcome=outcome,
        message=message,
        alignment=alignment,
        scale=scale,
        errors=errors,
        ate=ate,
        laid=laid,
        notes=(*result.notes, *_chance(result, ate.rmse), *alignment.notes),
    )
