# SPDX-License-Identifier: Apache-2.0
"""Losses: when an estimate was lost, by what it did over the last second, whatever it had drifted before.

At a pose the *local error* is the relative pose error (Sturm et al. 2012, equations 1 and 2, translation)
from the last pose that is at least ``window`` seconds older, less what all poses have in common (a turn
between the frames of the body, a scale). The estimate is *off* there where that error is above ``share`` of
the true path between the two poses, and above ``metres``. It is off as well between poses that leave the true
path uncovered, as `slamhive_eval.measure_coverage` has it, and after the last one. It is *lost* while it is
off for at least ``lasting`` seconds, breaks of up to a window among them: a single jump, which every window
across it sees, is over sooner.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.coverage import (
    FRAME_STEP_SECONDS,
    KEYFRAME_STEP_SECONDS,
    STEP_METRES,
    course,
    is_keyframes,
)
from slamhive_eval.errors import OptionError, TrajectoryError
from slamhive_eval.evaluation import MAX_LOCAL_SHARE, MIN_POSES, MOTION_METRES

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval.association import Association
    from slamhive_eval.preparing import Prepared
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

    Mask = npt.NDArray[np.bool_]

_ROUNDS, _SETTLED = 20, 1e-9
_ROUNDING_SECONDS = 1e-6
"""Stamps near 1.6e9 s are exact to less: a window of ten frames must not miss its first by rounding."""


@dataclass(frozen=True)
class LossRule:
    """Rule by which an estimate is lost.

    Attributes:
        window: Seconds over which a pose is looked back from.
        share: Of the true path in the window, above which an error is too large.
        metres: Error in m that never is.
        lasting: Seconds that it has to last.
    """

    window: float = 1.0
    share: float = MAX_LOCAL_SHARE
    metres: float = MOTION_METRES
    lasting: float = 2.0

    def __post_init__(self) -> None:
        for name in ("window", "share", "metres", "lasting"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise OptionError(f"{name} of a loss must be a positive number, not {value}")


@dataclass(frozen=True, eq=False)
class LocalErrors:
    """Local errors of an estimate, as states of the times between its poses.

    Attributes:
        begin, end: The times in s, ascending and apart from one another, shape (k,) each.
        known: Whether something can be said of them, shape (k,).
        off: Whether the estimate was off, shape (k,); never where it isn't known.
        errors: Local error at the end of each in m, shape (k,); NaN where there is none.
        rule: What made them so.
    """

    begin: FloatArray
    end: FloatArray
    known: Mask
    off: Mask
    errors: FloatArray
    rule: LossRule

    def losses(self) -> FloatArray:
        """Begin and end of each loss in s, shape (m, 2)."""
        found = stretches(self.begin, self.end, self.off, self.rule.window)
        return found[found[:, 1] - found[:, 0] >= self.rule.lasting - _ROUNDING_SECONDS]


def stretches(begin: FloatArray, end: FloatArray, chosen: Mask, longest_break: float) -> FloatArray:
    """Begin and end of times that follow one another but for short breaks, shape (m, 2).

    Args:
        begin: Of n times, ascending.
        end: Of n times, none after the next one's begin.
        chosen: Which of them count, shape (n,).
        longest_break: Seconds between two that are still taken together.
    """
    begin, end = begin[chosen], end[chosen]
    if not len(begin):
        return np.empty((0, 2))
    apart = np.flatnonzero(begin[1:] - end[:-1] > longest_break + _ROUNDING_SECONDS)
    return np.column_stack((begin[np.r_[0, apart + 1]], end[np.r_[apart, len(end) - 1]]))


def local_errors(
    reference: Trajectory,
    estimate: Trajectory,
    pairs: Association,
    laid: Prepared,
    *,
    keyframes: bool | None = None,
    window: tuple[float, float] | None = None,
    maps: IndexArray | None = None,
    rule: LossRule | None = None,
) -> LocalErrors:
    """Local errors of an estimate.

    The alignment has no part in them. What would make all of a run lost is taken out: one turn between the
    frames of the body, by the half of all directions of motion that it fits best; and where the alignment
    has a scale, for each map the median of the true over the estimated distances. A loss moves neither.

    Args:
        reference: Ground truth.
        estimate: The whole estimate.
        pairs: The m poses that belong together.
        laid: These poses.
        keyframes: Whether the estimate holds keyframes alone; None to tell by its spacing.
        window: First and last time of the run in s; None for all of the ground truth.
        maps: Map of each pose of the estimate, which share no frame, shape (n,); None: all are of one.
        rule: When it is lost.

    Returns:
        The errors, of the times between the m poses, and of that after them where it is uncovered. What
        can't be judged is not known: the first window, and gaps of the ground truth.

    Raises:
        TrajectoryError: There are no orientations, or too few poses.
    """
    rule = rule or LossRule()
    if not (laid.reference.oriented and laid.matched.oriented):
        raise TrajectoryError("losses can't be found without orientations of ground truth and estimate")
    if len(pairs) < MIN_POSES:
        raise TrajectoryError(f"losses can't be found by {len(pairs)} poses that have a ground truth")
    path, clock = course(reference, window)
    stamps, at = laid.reference.stamps, pairs.reference
    limit = KEYFRAME_STEP_SECONDS if _by_keyframes(estimate, keyframes) else FRAME_STEP_SECONDS
    numbers = np.zeros(len(pairs), dtype=np.intp) if maps is None else maps[pairs.estimate]
    older = np.searchsorted(stamps, stamps - rule.window + _ROUNDING_SECONDS, side="right") - 1
    later = np.flatnonzero(older >= 0)
    earlier = older[later]
    errors, bounds = np.full(len(pairs), np.nan), np.full(len(pairs), np.nan)
    errors[later] = _missed(laid, earlier, later, numbers)
    bounds[later] = np.maximum(rule.share * (path[at[later]] - path[at[earlier]]), rule.metres)
    # What the clock stood still for is a gap of the ground truth, or outside of the run.
    took = reference.stamps[at[later]] - reference.stamps[at[earlier]]
    stood = clock[at[later]] - clock[at[earlier]] < took - _ROUNDING_SECONDS
    errors[later[stood]] = np.nan
    apart = np.diff(estimate.stamps[pairs.estimate])
    gap = (apart > limit) & (np.diff(path[at]) > STEP_METRES)
    errors[1:][gap] = np.nan
    other_map = np.zeros(len(pairs), dtype=bool)
    other_map[later] = numbers[earlier] != numbers[later]
    with np.errstate(invalid="ignore"):
        off = gap | ((errors > bounds) | (other_map & np.isfinite(errors)))[1:]
    known = gap | np.isfinite(errors[1:])
    found = LocalErrors(stamps[:-1], stamps[1:], known, off, errors[1:], rule)
    last = float(reference.stamps[-1] if window is None else min(window[1], reference.stamps[-1]))
    if last - stamps[-1] > limit and path[-1] - path[at[-1]] > STEP_METRES:
        found = replace(
            found,
            begin=np.append(found.begin, stamps[-1]),
            end=np.append(found.end, last),
            known=np.append(known, True),
            off=np.append(off, True),
            errors=np.append(found.errors, np.nan),
        )
    return found


def _by_keyframes(estimate: Trajectory, keyframes: bool | None) -> bool:
    return is_keyframes(estimate) if keyframes is None else keyframes


def _missed(laid: Prepared, i: IndexArray, j: IndexArray, numbers: IndexArray) -> FloatArray:
    """Relative errors of translation from poses i to j in m, less what all of them have in common."""
    true, own = (
        rotation.rotate(rotation.conjugate(one.quaternions[i]), one.positions[j] - one.positions[i])
        for one in (laid.reference, laid.matched)
    )
    far, lengths = rotation.vector_norm(true), rotation.vector_norm(own)
    moved = (far > MOTION_METRES) & (lengths > 0)
    if laid.alignment.method in ("sim3", "scale"):
        for number in np.unique(numbers):
            inside = numbers[i] == number
            if (inside & moved).any():
                own[inside] *= np.median((far / np.where(moved, lengths, 1.0))[inside & moved])
    units = [one[moved] / rotation.vector_norm(one[moved])[:, np.newaxis] for one in (true, own)]
    turned: FloatArray = own @ _common_turn(*units).T
    return rotation.vector_norm(turned - true)


def _common_turn(true: FloatArray, own: FloatArray) -> FloatArray:
    """The rotation that turns directions onto others, shape (k, 3) each, by the half that it fits best."""
    turn, kept = np.eye(3), np.arange(len(true))
    for _ in range(_ROUNDS if len(true) else 0):
        before, turn = turn, rotation.nearest_rotation(true[kept].T @ own[kept])
        if np.abs(turn - before).max() < _SETTLED:
            break
        off = rotation.vector_norm(own @ turn.T - true)
        kept = np.argsort(off, kind="stable")[: len(true) // 2 + 1]
    return turn
