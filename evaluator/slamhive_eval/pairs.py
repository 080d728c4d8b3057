# SPDX-License-Identifier: Apache-2.0
"""Pairs of poses between which a relative error is computed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import OptionError

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

Unit = Literal["frames", "m", "s", "deg", "rad"]
UNITS: tuple[Unit, ...] = get_args(Unit)

MIN_RANKED_PAIRS = 30
"""A relative error of fewer pairs says too little to rank by."""

MAX_ANGLE_PAIRS = 3_000_000
"""Of all pairs by angle, which may be half the square of the poses: to compare these takes 1 GB."""

_CHUNK = 4_000_000
"""Products held at once when all angles are compared with all (32 MB)."""


def find_pairs(
    trajectory: Trajectory, delta: float, unit: Unit, *, all_pairs: bool, rel_tolerance: float = 0.1
) -> IndexArray:
    """Pairs (i, j), i < j, that are ``delta`` apart, as evo chooses them.

    ======== ================================================= =============================================
    unit     consecutive: each pair starts where the last ended all pairs
    ======== ================================================= =============================================
    frames   j = i + delta                                     the same from every i
    m        j the first with at least delta of path since i   from every i the j whose path is closest
    s        the same of time (evo has no such unit)           the same of time
    deg, rad the same of rotation summed from pose to pose     every j whose direct angle to i is delta
    ======== ================================================= =============================================

    Consecutive pairs start at pose 0. All pairs are accepted within delta · rel_tolerance.

    Args:
        trajectory: Whose path is measured: the aligned estimate, or the reference where asked.
        delta: Distance in the unit, > 0; a whole number of frames.
        unit: ``frames``, ``m``, ``s``, ``deg`` or ``rad``.
        all_pairs: All pairs instead of consecutive ones.
        rel_tolerance: Share of delta by which all pairs in m, s, deg and rad may miss it.

    Returns:
        Indices, shape (k, 2), possibly none.

    Raises:
        OptionError: Unknown unit, a number out of bounds, or more than `MAX_ANGLE_PAIRS` by angle.
    """
    _check(delta, unit, rel_tolerance)
    if unit == "frames":
        step = int(delta)
        start = np.arange(0, max(len(trajectory) - step, 0), 1 if all_pairs else step)
        return np.column_stack((start, start + step))
    if unit in ("deg", "rad"):
        radians = float(np.deg2rad(delta)) if unit == "deg" else delta
        if all_pairs:
            return _all_by_angle(trajectory.quaternions, radians, radians * rel_tolerance)
        q = trajectory.quaternions
        return _consecutive(rotation.angle(rotation.multiply(rotation.conjugate(q[:-1]), q[1:])), radians)
    since_start = trajectory.stamps - trajectory.stamps[0]
    if all_pairs:
        return _all_along(trajectory.distances if unit == "m" else since_start, delta, delta * rel_tolerance)
    if unit == "m":
        return _consecutive(rotation.vector_norm(np.diff(trajectory.positions, axis=0)), delta)
    return _consecutive_along(since_start, delta)


def _check(delta: float, unit: str, rel_tolerance: float) -> None:
    if unit not in UNITS:
        raise OptionError(f"unknown unit {unit!r} of delta; known are {', '.join(UNITS)}")
    if not (np.isfinite(delta) and delta > 0):
        raise OptionError(f"delta must be a positive number, not {delta}")
    if unit == "frames" and delta != int(delta):
        raise OptionError(f"delta must be a whole number of frames, not {delta}")
    largest = {"deg": 180.0, "rad": float(np.pi)}.get(unit)
    if largest is not None and delta > largest:
        raise OptionError(f"delta must be at most {largest:g} {unit}, not {delta}")
    if not (np.isfinite(rel_tolerance) and rel_tolerance >= 0):
        raise OptionError(f"the relative tolerance of delta must be ≥ 0, not {rel_tolerance}")


def _consecutive(steps: FloatArray, delta: float) -> IndexArray:
    # Summed anew from each start, step by step: sums of differences would round otherwise than evo's
    # and move pairs where steps add up to delta exactly. A list of floats keeps the loop cheap.
    ends = [0]
    travelled = 0.0
    for k, step in enumerate(steps.tolist(), start=1):
        travelled += step
        if travelled >= delta:
            ends.append(k)
            travelled = 0.0
    return _chain(ends)


def _consecutive_along(position: FloatArray, delta: float) -> IndexArray:
    ends = [0]
    start = 0.0
    for k, here in enumerate(position.tolist()):
        if here - start >= delta:
            ends.append(k)
            start = here
    return _chain(ends)


def _chain(ends: list[int]) -> IndexArray:
    index = np.array(ends, dtype=np.intp)
    return np.column_stack((index[:-1], index[1:]))


def _all_along(position: FloatArray, delta: float, tolerance: float) -> IndexArray:
    """From every i the j > i for which position[j] − position[i] is closest to delta; the first of equals."""
    n = len(position)
    if n < 2:
        return np.empty((0, 2), dtype=np.intp)
    i = np.arange(n - 1)

    def miss(j: IndexArray) -> FloatArray:
        return np.abs(position[j] - position[i] - delta)

    first_of_equals = np.searchsorted(position, position, side="left")
    above = np.clip(np.searchsorted(position, position[:-1] + delta), i + 1, n - 1)
    below = np.maximum(above - 1, i + 1)
    best = np.where(miss(below) <= miss(above), below, above)
    # Back to the first of equal positions, and of different ones that miss equally after rounding.
    while True:
        before = np.maximum(first_of_equals[np.maximum(best - 1, 0)], i + 1)
        better = (before < best) & (miss(before) <= miss(best))
        if not better.any():
            break
        best = np.where(better, before, best)
    accepted = miss(best) <= tolerance
    return np.column_stack((i[accepted], best[accepted]))


def _all_by_angle(q: FloatArray, delta: float, tolerance: float) -> IndexArray:
    """All (i, j) whose direct angle lies within delta ± tolerance, by |cos(θ/2)| = |q_i · q_j|."""
    n = len(q)
    low, high = max(delta - tolerance, 0.0), min(delta + tolerance, np.pi)
    largest, smallest = np.cos(low / 2.0), np.cos(high / 2.0)
    rows = max(1, _CHUNK // n)
    found = []
    count = 0
    for start in range(0, n, rows):
        # From the block's first pose on: pairs with an earlier one were found there.
        half_cosine = np.abs(q[start : start + rows] @ q[start:].T)
        i, j = np.nonzero(np.triu((half_cosine <= largest) & (half_cosine >= smallest), k=1))
        count += len(i)
        if count > MAX_ANGLE_PAIRS:
            raise OptionError(
                f"more than {MAX_ANGLE_PAIRS:,} pairs of poses are {np.rad2deg(delta):.6g}° apart within "
                f"{np.rad2deg(tolerance):.6g}°; a smaller tolerance, another delta "
                "or consecutive pairs give fewer"
            )
        found.append(np.column_stack((i + start, j + start)))
    return np.concatenate(found)
