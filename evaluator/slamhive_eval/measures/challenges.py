# SPDX-License-Identifier: Apache-2.0
"""Scores of public challenges, by the rules that they have published.

Sources: KITTI odometry: Geiger et al. 2012 and its devkit. Hilti 2022: ``evaluation-2022`` of
Hilti-Research/hilti-slam-challenge-2022. Hilti 2023: README and ``evaluation-2023`` of
Hilti-Research/hilti-slam-challenge-2023. LaMAria: ``lamaria/utils/metrics.py`` of cvg/lamaria.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from slamhive_eval.errors import OptionError, did_you_mean
from slamhive_eval.evaluation import MIN_POSES, Options
from slamhive_eval.measures.kitti import kitti_errors
from slamhive_eval.measures.points import evaluate_points

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive_eval.measures.kitti import KittiErrors
    from slamhive_eval.measures.points import ControlPoints, PointErrors
    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.trajectory import Trajectory


@dataclass(frozen=True)
class PointRule:
    """A rule that gives each control point a score by the error there.

    Attributes:
        limits: Errors in m, ascending, shape (k,).
        scores: At these errors, or below them where the rule is in bands.
        banded: Whether an error below a limit gets that limit's score; else scores are linear between limits.
        alignment: Of the estimate onto the control points.
        horizontal: Whether heights don't count.
        recalls: Distances in m within which the share of the points is told.
        nearest_seconds: A point is met by the pose nearest in time, at most so far away; None: the estimate
            is interpolated.
        tip: Where in the frame of the estimates the surveyed point is, m, if nothing else is said.
        doubled: What the names of sequences begin with that count twice.
        uncounted: Sequences that are in no sum, as their ground truth was public during the challenge.
        note: What differs from the challenge's own computation.
    """

    limits: tuple[float, ...]
    scores: tuple[float, ...]
    banded: bool
    alignment: Literal["se3", "sim3"]
    horizontal: bool = False
    recalls: tuple[float, ...] = ()
    nearest_seconds: float | None = None
    tip: tuple[float, float, float] | None = None
    doubled: str | None = None
    uncounted: tuple[str, ...] = ()
    note: str = ""

    def scores_of(self, errors: FloatArray) -> FloatArray:
        """The score of each error in m, shape (n,)."""
        if not self.banded:
            return np.interp(errors, self.limits, self.scores, right=0.0)
        band = np.searchsorted(self.limits, errors, side="right")
        return np.append(self.scores, 0.0)[band]

    def weight(self, sequence: str) -> int:
        """Return the weight of a sequence in its score: 0, 1 or 2."""
        if sequence in self.uncounted:
            return 0
        return 2 if self.doubled is not None and sequence.startswith(self.doubled) else 1

    def extrinsic(self, points: str) -> FloatArray | None:
        """Pose of the estimates' frame in the surveyed one, by the name of the points: (4, 4).

        None where they are of one frame, as those are whose name ends in ``_imu``, and where the rule
        doesn't know.
        """
        if self.tip is None or points.lower().endswith("_imu") or "robot" in points:
            return None
        pose = np.eye(4)
        pose[:3, 3] = [-at for at in self.tip]
        return pose


_HILTI_TIP = (0.059, -0.00855, 0.1964)
"""Tip of the pole of the handheld device of 2022 and 2023, in its IMU, m."""
_HILTI_SECONDS = 2.0

POINT_RULES: dict[str, PointRule] = {
    "hilti2022": PointRule(
        limits=(0.01, 0.03, 0.06, 0.1),
        scores=(10, 6, 3, 1),
        banded=True,
        alignment="se3",
        nearest_seconds=_HILTI_SECONDS,
        tip=_HILTI_TIP,
        uncounted=(
            "exp04_construction_upper_level",
            "exp05_construction_upper_level_2",
            "exp06_construction_upper_level_3",
        ),
        note="as evaluation-2022 computes it: the pose nearest in time counts, at most 2 s from a point; "
        "estimates are of the IMU and moved to the pole's tip",
    ),
    "hilti2023": PointRule(
        limits=(0.005, 0.01, 0.03, 0.06, 0.1, 0.4),
        scores=(20, 10, 6, 5, 3, 1),
        banded=True,
        alignment="se3",
        nearest_seconds=_HILTI_SECONDS,
        tip=_HILTI_TIP,
        doubled="site3",
        note="as evaluation-2023 computes it: the pose nearest in time counts, at most 2 s from a point; "
        "estimates are of the IMU and moved to the pole's tip, those of the robot only by --extrinsic; "
        "sequences of site 3 count twice",
    ),
    "lamaria": PointRule(
        limits=(0.0, 0.05, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0),
        scores=(20, 20, 18, 15, 12, 8, 4, 0),
        banded=False,
        alignment="sim3",
        horizontal=True,
        recalls=(1.0, 5.0),
        note="the challenge triangulates tags in its images and aligns to them robustly; here the "
        "estimate is aligned by Sim(3) least squares to control points that are positions at instants",
    ),
}
CHALLENGES = ("kitti", *POINT_RULES)


def find_rule(name: str) -> PointRule | None:
    """The rule of a challenge, None for KITTI's, which isn't by points.

    Raises:
        OptionError: A challenge that isn't known.
    """
    if name not in CHALLENGES:
        known = ", ".join(CHALLENGES)
        raise OptionError(f"unknown challenge {name!r}{did_you_mean(name, CHALLENGES)}; known: {known}")
    return POINT_RULES.get(name)


def score_points(
    rule: PointRule, points: ControlPoints, estimate: Trajectory, extrinsic: FloatArray | None = None
) -> dict[str, Any]:
    """Score an estimate by a rule about control points.

    Args:
        rule: The challenge's.
        points: Where the surveyed frame was.
        estimate: Perhaps of another frame.
        extrinsic: Pose of the estimate's frame in the surveyed one, shape (4, 4).

    Returns:
        Plain JSON data: ``score`` within 0 and 100, ``points``, ``met``, ``sum``, ``largest``, ``recall`` by
        distance, ``rmse`` in m and ``message``. Points that aren't met score 0 and are in no recall.
    """
    options = Options(alignment=rule.alignment, extrinsic=extrinsic)
    if rule.nearest_seconds is not None:
        options = replace(
            options, max_gap_seconds=0.0, max_difference_seconds=rule.nearest_seconds, keyframes=False
        )
    found = evaluate_points(points, estimate, options)
    errors = _errors(found, horizontal=rule.horizontal)
    total, largest = float(rule.scores_of(errors).sum()), max(rule.scores) * len(points)
    return {
        "score": 100.0 * total / largest,
        "sum": total,
        "largest": float(largest),
        "points": len(points),
        "met": len(errors),
        "recall": {f"{limit:g}m": float((errors <= limit).sum() / len(points)) for limit in rule.recalls},
        "rmse": float(np.sqrt(np.mean(errors**2))) if len(errors) else None,
        "message": "" if found.errors is not None else _missing(found, rule),
    }


def _missing(found: PointErrors, rule: PointRule) -> str:
    if rule.nearest_seconds is None or found.met.sum() >= MIN_POSES:
        return found.message
    return (
        f"{found.met.sum()} of {len(found.points)} control points have a pose within "
        f"{rule.nearest_seconds:g} s; an error needs at least {MIN_POSES}"
    )


def _errors(found: PointErrors, *, horizontal: bool) -> FloatArray:
    if found.laid is None:
        return np.empty(0)
    apart = found.laid.estimate.positions - found.laid.reference.positions
    errors: FloatArray = np.linalg.norm(apart[:, :2] if horizontal else apart, axis=1)
    return errors


def score_kitti(reference: Trajectory, estimate: Trajectory) -> KittiErrors:
    """Segment errors as KITTI's devkit defines them: 100 to 800 m, from every tenth frame."""
    return kitti_errors(reference, estimate)


def total_kitti(found: Mapping[str, KittiErrors]) -> dict[str, Any]:
    """The mean over the segments of all sequences, which the benchmark ranks by.

    Returns:
        Plain JSON data: ``translationPercent``, ``rotationDegPer100m``, ``segments``, and ``sequences``.
    """
    translation = np.concatenate([one.segments.translation for one in found.values()])
    rotation = np.concatenate([one.segments.rotation for one in found.values()])
    return {
        **_kitti_means(translation, rotation),
        "sequences": {
            name: _kitti_means(one.segments.translation, one.segments.rotation) for name, one in found.items()
        },
    }


def _kitti_means(translation: FloatArray, rotation: FloatArray) -> dict[str, Any]:
    count = len(translation)
    return {
        "translationPercent": 100 * float(translation.mean()) if count else None,
        "rotationDegPer100m": 100 * float(np.rad2deg(rotation.mean())) if count else None,
        "segments": count,
    }
