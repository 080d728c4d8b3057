# SPDX-License-Identifier: Apache-2.0
"""Association by time: pairs each pose of an estimate with a pose of the reference.

Every comparison begins with it.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import AssociationError, OptionError
from slamhive_eval.trajectory import Trajectory

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray, IndexArray

Matching = Literal["nearest", "unique", "forward", "interpolate"]
MATCHINGS: tuple[Matching, ...] = get_args(Matching)
DEFAULT_GAP_SECONDS = 1.0
"""Ground truth is interpolated between poses at most this far apart."""


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
    """Pair each pose of the shorter trajectory with the nearest in time of the longer one, one to one.

    These are evo's pairs where each has a pose to itself. Of several that share one, which evo keeps, only
    the closest stays: one pose must not count as many. A pair is accepted when the stamps differ by at most
    the tolerance; the lower index wins a tie. Of two trajectories with as many poses the estimate counts as
    the shorter.

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
    _check(max_difference_seconds, offset_seconds)
    if len(estimate) > len(reference):
        short, long = _match(reference.stamps, estimate.stamps + offset_seconds, max_difference_seconds)
        return Association(short, long)
    short, long = _match(estimate.stamps, reference.stamps - offset_seconds, max_difference_seconds)
    return Association(long, short)


def associate_uniquely(
    reference: Trajectory,
    estimate: Trajectory,
    max_difference_seconds: float = 0.02,
    offset_seconds: float = 0.0,
) -> Association:
    """Pair poses one to one, the closest in time first, as the TUM tools and rpg_trajectory_evaluation do.

    Of all pairs that are left the one with the smallest difference is taken, then the earlier reference
    pose, then the earlier estimated one, until none is below the tolerance.

    Args:
        reference: Ground truth.
        estimate: What is measured.
        max_difference_seconds: Differences must be less than this, in s (0.02 in those tools).
        offset_seconds: Added to the estimate's stamps for matching only.

    Returns:
        The pairs in the order of time, possibly none.

    Raises:
        OptionError: A tolerance that is negative or not finite, or an offset that isn't finite.
    """
    _check(max_difference_seconds, offset_seconds)
    n = len(reference)
    stamps = np.concatenate((reference.stamps, estimate.stamps + offset_seconds))
    order = np.argsort(stamps, kind="stable").tolist()
    time = stamps.tolist()
    # The closest two are neighbours in the common order of time, and stay so as others are taken out.
    before, after = _neighbours(order)
    heap: list[tuple[float, float, float, int, int]] = []

    def offer(left: int, right: int) -> None:
        if left < 0 or right < 0 or (left < n) == (right < n):
            return
        a, b = (left, right) if left < n else (right, left)
        difference = abs(time[a] - time[b])
        if difference < max_difference_seconds:
            heap.append((difference, time[a], time[b], a, b))

    for left, right in itertools.pairwise(order):
        offer(left, right)
    heapq.heapify(heap)
    taken = bytearray(len(order))
    pairs = []
    while heap:
        _, _, _, a, b = heapq.heappop(heap)
        if taken[a] or taken[b]:
            continue
        taken[a] = taken[b] = 1
        pairs.append((a, b - n))
        left, right = _unlink(before, after, a, b)
        count = len(heap)
        offer(left, right)
        if len(heap) > count:
            heapq.heappush(heap, heap.pop())
    index = np.array(sorted(pairs), dtype=np.intp).reshape(-1, 2)
    return Association(index[:, 0], index[:, 1])


def associate_forward(
    reference: Trajectory,
    estimate: Trajectory,
    max_difference_seconds: float = 0.02,
    offset_seconds: float = 0.0,
) -> Association:
    """Pair poses one to one in a single pass, as OpenVINS does.

    Each estimated pose in turn takes the nearest reference pose after all those looked at before, even where
    a later estimated pose would be nearer to it.

    Args:
        reference: Ground truth.
        estimate: What is measured.
        max_difference_seconds: Differences must be less than this, in s (0.02 there).
        offset_seconds: Added to the estimate's stamps for matching only.

    Returns:
        The pairs, possibly none.

    Raises:
        OptionError: A tolerance that is negative or not finite, or an offset that isn't finite.
    """
    _check(max_difference_seconds, offset_seconds)
    truth = reference.stamps.tolist()
    pairs = []
    k = 0
    for i, stamp in enumerate((estimate.stamps + offset_seconds).tolist()):
        while k < len(truth) and stamp - truth[k] > max_difference_seconds:
            k += 1
        least, best = max_difference_seconds, -1
        while k < len(truth) and abs(truth[k] - stamp) < least:
            least, best = abs(truth[k] - stamp), k
            k += 1
        if best >= 0:
            pairs.append((best, i))
    index = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return Association(index[:, 0], index[:, 1])


def pair_up(
    reference: Trajectory,
    estimate: Trajectory,
    matching: Matching = "nearest",
    *,
    max_difference_seconds: float = 0.01,
    offset_seconds: float = 0.0,
    max_gap_seconds: float = DEFAULT_GAP_SECONDS,
) -> tuple[Association, Trajectory, Trajectory]:
    """Return the pairs of a match, none where no poses belong together, and the poses of those that do.

    Returns:
        The pairs, of the reference pose nearest in time where the ground truth is interpolated; and the m
        poses of each, m ≥ 0.

    Raises:
        OptionError: An unknown matching or a number out of bounds.
    """
    if matching not in MATCHINGS:
        raise OptionError(f"unknown matching {matching!r}; known are {', '.join(MATCHINGS)}")
    if matching == "interpolate":
        _check(max_gap_seconds, offset_seconds, "gap of the ground truth")
        wanted = estimate.stamps + offset_seconds
        found, positions, quaternions = interpolate(reference, wanted, max_gap_seconds)
        index = np.flatnonzero(found)
        pairs = Association(nearest(reference.stamps, wanted[index], np.inf), index)
        if not len(index):
            return pairs, reference.select(index), estimate.select(index)
        truth = Trajectory(wanted[index], positions[index], quaternions[index], oriented=reference.oriented)
        return pairs, truth, estimate.select(index)
    find = {"nearest": associate, "unique": associate_uniquely, "forward": associate_forward}[matching]
    pairs = find(reference, estimate, max_difference_seconds, offset_seconds)
    truth, kept = reference.select(pairs.reference), estimate.select(pairs.estimate)
    return pairs, truth, kept.at(truth.stamps) if matching == "forward" else kept


def match(
    reference: Trajectory,
    estimate: Trajectory,
    matching: Matching = "nearest",
    *,
    max_difference_seconds: float = 0.01,
    offset_seconds: float = 0.0,
    max_gap_seconds: float = DEFAULT_GAP_SECONDS,
) -> tuple[Trajectory, Trajectory]:
    """The poses of both trajectories that belong together, pose k to pose k.

    Args:
        reference: Ground truth.
        estimate: What is measured.
        matching: ``nearest`` (evo), ``unique`` (TUM, rpg), ``forward`` (OpenVINS, where the estimate
            gets the reference's stamps), or ``interpolate``: the ground truth at the estimate's stamps,
            positions linear, rotations by slerp.
        max_difference_seconds: Largest time difference in s of the first three.
        offset_seconds: Added to the estimate's stamps for matching only.
        max_gap_seconds: Nothing is interpolated between ground-truth poses further apart than this, in s.

    Returns:
        m poses of each.

    Raises:
        AssociationError: No two belong together.
        OptionError: An unknown matching or a number out of bounds.
    """
    pairs, truth, kept = pair_up(
        reference,
        estimate,
        matching,
        max_difference_seconds=max_difference_seconds,
        offset_seconds=offset_seconds,
        max_gap_seconds=max_gap_seconds,
    )
    if not len(pairs):
        limit = max_gap_seconds if matching == "interpolate" else max_difference_seconds
        raise no_overlap(reference, estimate, limit, offset_seconds)
    return truth, kept


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


def equal_stamps_notes(estimate: Trajectory) -> list[str]:
    """Return a sentence on poses of an estimate that have the stamp of another one, if there are such."""
    repeated = int(np.count_nonzero(np.diff(estimate.stamps) == 0))
    if not repeated:
        return []
    has = "1 pose of the estimate has" if repeated == 1 else f"{repeated} poses of the estimate have"
    return [f"{has} the stamp of the one before"]


def no_overlap(
    reference: Trajectory, estimate: Trajectory, max_difference_seconds: float, offset_seconds: float
) -> AssociationError:
    """The error for two trajectories without a pair, naming both time ranges."""
    shift = f" (stamps shifted by {offset_seconds:g} s)" if offset_seconds else ""
    return AssociationError(
        f"no pose of the estimate, {_time_range(estimate)}{shift}, lies within {max_difference_seconds:g} s "
        f"of a ground-truth pose, {_time_range(reference)}"
    )


def _check(limit_seconds: float, offset_seconds: float, what: str = "time difference") -> None:
    if not (np.isfinite(limit_seconds) and limit_seconds >= 0):
        raise OptionError(f"the largest {what} must be ≥ 0 s, not {limit_seconds}")
    if not np.isfinite(offset_seconds):
        raise OptionError(f"the time offset must be a finite number of seconds, not {offset_seconds}")


def _neighbours(order: list[int]) -> tuple[list[int], list[int]]:
    before, after = [-1] * len(order), [-1] * len(order)
    for left, right in itertools.pairwise(order):
        after[left], before[right] = right, left
    return before, after


def _unlink(before: list[int], after: list[int], *taken: int) -> tuple[int, int]:
    """Take two neighbours out; what stands left and right of them then."""
    left = right = -1
    for one in taken:
        left, right = before[one], after[one]
        if left >= 0:
            after[left] = right
        if right >= 0:
            before[right] = left
    return left, right


def _time_range(trajectory: Trajectory) -> str:
    return f"{trajectory.stamps[0]:.3f} s to {trajectory.stamps[-1]:.3f} s"


def _match(short: FloatArray, long: FloatArray, tolerance: float) -> tuple[IndexArray, IndexArray]:
    partner = nearest(long, short, tolerance)
    matched = np.flatnonzero(partner >= 0)
    partner = partner[matched]
    if (np.diff(partner) > 0).all():
        return matched, partner
    order = np.lexsort((np.abs(long[partner] - short[matched]), partner))
    partner, firsts = np.unique(partner[order], return_index=True)
    return matched[order[firsts]], partner
