# SPDX-License-Identifier: Apache-2.0
"""Which pose of the estimate belongs to which pose of the reference, by time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import AssociationError, OptionError

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Association:
    """Pairs of poses.

    Attributes:
        reference: Indices into the reference, shape (m,), never decreasing.
        estimate: Indices into the estimate, shape (m,), never decreasing.
    """

    reference: IndexArray
    estimate: IndexArray

    def __len__(self) -> int:
        return len(self.reference)


def associate(
    reference: Trajectory,
    estimate: Trajectory,
    max_difference_seconds: float = 0.01,
    offset_seconds: float = 0.0,
) -> Association:
    """Pair each pose of the shorter trajectory with the nearest in time of the longer one, as evo does.

    Not unique: a pose of the longer trajectory may serve several. A pair is accepted when the stamps
    differ by at most the tolerance; the lower index wins a tie. Of two trajectories with as many poses
    the estimate counts as the shorter.

    Args:
        reference: Ground truth.
        estimate: What is measured.
        max_difference_seconds: Largest accepted difference in s.
        offset_seconds: Added to the estimate's stamps for matching only.

    Returns:
        The pairs, possibly none.

    Raises:
        OptionError: A tolerance that is negative or not finite, or an offset that isn't finite.
    """
    if not (np.isfinite(max_difference_seconds) and max_difference_seconds >= 0):
        raise OptionError(f"the largest time difference must be ≥ 0 s, not {max_difference_seconds}")
    if not np.isfinite(offset_seconds):
        raise OptionError(f"the time offset must be a finite number of seconds, not {offset_seconds}")
    if len(estimate) > len(reference):
        short, long = _match(reference.stamps, estimate.stamps + offset_seconds, max_difference_seconds)
        return Association(short, long)
    short, long = _match(estimate.stamps, reference.stamps - offset_seconds, max_difference_seconds)
    return Association(long, short)


def nearest(stamps: FloatArray, wanted: FloatArray, max_difference_seconds: float) -> IndexArray:
    """Index of the nearest stamp for each wanted one, -1 where none is close enough.

    Args:
        stamps: Never decreasing, shape (n,), n ≥ 1.
        wanted: In any order, shape (m,).
        max_difference_seconds: Largest accepted difference in s.

    Returns:
        Indices into stamps, shape (m,); of equally near ones the lower, of equal stamps the last.
    """
    above = np.minimum(np.searchsorted(stamps, wanted, side="right"), len(stamps) - 1)
    below = np.maximum(above - 1, 0)
    to_above = stamps[above] - wanted
    to_below = np.where(above > 0, wanted - stamps[below], np.inf)
    best = np.where(to_above < to_below, above, below)
    close = np.minimum(to_above, to_below) <= max_difference_seconds
    # Past the last stamp the distance to it is negative, so the ends need a test of their own.
    close &= wanted >= stamps[0] - max_difference_seconds
    close &= wanted <= stamps[-1] + max_difference_seconds
    return np.where(close, best, -1)


def interpolate(
    trajectory: Trajectory, wanted: FloatArray, max_gap_seconds: float
) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray]:
    """Poses at given times, positions linear and rotations by slerp between the two neighbours.

    Args:
        trajectory: Where the poses come from.
        wanted: Times in s in any order, shape (m,).
        max_gap_seconds: Neighbours further apart than this give no pose between them.

    Returns:
        Which times have a pose, shape (m,); their positions, shape (m, 3), and quaternions, shape (m, 4):
        zero and the identity where there is none.
    """
    stamps = trajectory.stamps
    after = np.searchsorted(stamps, wanted, side="left")
    exact = (after < len(stamps)) & (stamps[np.minimum(after, len(stamps) - 1)] == wanted)
    after = np.minimum(after, len(stamps) - 1)
    before = np.where(exact, after, np.maximum(after - 1, 0))
    span = stamps[after] - stamps[before]
    inside = (wanted >= stamps[0]) & (wanted <= stamps[-1])
    found = inside & (span <= max_gap_seconds)
    share = np.where(span > 0, (wanted - stamps[before]) / np.where(span > 0, span, 1.0), 0.0)
    share = np.where(found, share, 0.0)
    p, q = trajectory.positions, trajectory.quaternions
    positions = p[before] + share[:, np.newaxis] * (p[after] - p[before])
    quaternions = rotation.slerp(q[before], q[after], share)
    positions = np.where(found[:, np.newaxis], positions, 0.0)
    return found, positions, np.where(found[:, np.newaxis], quaternions, (0.0, 0.0, 0.0, 1.0))


def no_overlap(
    reference: Trajectory, estimate: Trajectory, max_difference_seconds: float, offset_seconds: float
) -> AssociationError:
    """The error for two trajectories without a pair, naming both time ranges."""
    shift = f" (stamps shifted by {offset_seconds:g} s)" if offset_seconds else ""
    return AssociationError(
        f"no pose of the estimate, {_time_range(estimate)}{shift}, lies within {max_difference_seconds:g} s "
        f"of a ground-truth pose, {_time_range(reference)}"
    )


def _time_range(trajectory: Trajectory) -> str:
    return f"{trajectory.stamps[0]:.3f} s to {trajectory.stamps[-1]:.3f} s"


def _match(short: FloatArray, long: FloatArray, tolerance: float) -> tuple[IndexArray, IndexArray]:
    partner = nearest(long, short, tolerance)
    matched = np.flatnonzero(partner >= 0)
    return matched, partner[matched]
