# SPDX-License-Identifier: Apache-2.0
"""Coverage: the share of the ground truth for which an estimate has poses.

An error says nothing about an estimate that stopped halfway: coverage stands beside every error and
decides, with the scale and the error itself, what a run's outcome is called.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import OptionError

if TYPE_CHECKING:
    from slamhive_eval.association import Association
    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.trajectory import Trajectory

REFERENCE_GAP_SECONDS = 1.0
"""Steps of the ground truth longer than this belong neither to the path nor to what is covered."""
KEYFRAME_SPACING_SECONDS = 0.2
"""An estimate whose median spacing exceeds this counts as keyframes unless its algorithm says otherwise."""
FRAME_STEP_SECONDS = 1.0
KEYFRAME_STEP_SECONDS = 5.0
STEP_METRES = 0.5
"""Consecutive associated poses at most this far apart in time or on the path cover what is between."""


_courses: WeakKeyDictionary[Trajectory, tuple[FloatArray, FloatArray]] = WeakKeyDictionary()


@dataclass(frozen=True)
class Coverage:
    """Share and length of the ground truth's path that an estimate covers.

    Attributes:
        share: Covered share of the path within [0, 1]; of the time where the ground truth stands still.
        path_length: Ground-truth path in the window, without gaps, in m.
        covered_length: The part of it that is covered, in m.
        keyframes: Whether the estimate was judged as keyframes.
    """

    share: float
    path_length: float
    covered_length: float
    keyframes: bool


def is_keyframes(estimate: Trajectory) -> bool:
    """Tell whether the poses are spaced like keyframes: median spacing above 0.2 s."""
    return len(estimate) > 1 and bool(np.median(np.diff(estimate.stamps)) > KEYFRAME_SPACING_SECONDS)


def measure_coverage(
    reference: Trajectory,
    estimate: Trajectory,
    association: Association,
    *,
    keyframes: bool | None = None,
    window: tuple[float, float] | None = None,
) -> Coverage:
    """Share of the ground truth's path that lies between close consecutive associated poses.

    Close are poses at most 1 s apart (keyframes: 5 s) or at most 0.5 m of that path. Steps of the ground
    truth over more than 1 s count neither as path nor as covered.

    Args:
        reference: Ground truth in its own frame.
        estimate: The whole estimate.
        association: Their pairs, possibly none.
        keyframes: Whether the estimate holds keyframes only; None to tell by its spacing.
        window: First and last time of the run in s of the reference's clock; None for all of it.

    Returns:
        The coverage.

    Raises:
        OptionError: A window that ends before it begins.
    """
    if keyframes is None:
        keyframes = is_keyframes(estimate)
    path, clock = course(reference, window)
    begin, end = association.reference[:-1], association.reference[1:]
    limit = KEYFRAME_STEP_SECONDS if keyframes else FRAME_STEP_SECONDS
    apart = np.diff(estimate.stamps[association.estimate])
    close = (apart <= limit) | (path[end] - path[begin] <= STEP_METRES)
    covered = float(np.sum((path[end] - path[begin])[close]))
    total = float(path[-1])
    if total > 0:
        share = covered / total
    elif clock[-1] > 0:
        share = float(np.sum((clock[end] - clock[begin])[close]) / clock[-1])
    else:
        share = 0.0
    return Coverage(min(share, 1.0), total, min(covered, total), keyframes)


def no_coverage(
    reference: Trajectory, *, keyframes: bool | None = None, window: tuple[float, float] | None = None
) -> Coverage:
    """The coverage of an estimate without a pose: none, of the path that there is; see measure_coverage."""
    path, _ = course(reference, window)
    return Coverage(0.0, float(path[-1]), 0.0, bool(keyframes))


def course(reference: Trajectory, window: tuple[float, float] | None) -> tuple[FloatArray, FloatArray]:
    """Path in m and time in s from the first pose to each, standing still over gaps and outside the window.

    That of the whole is kept for the next estimate with this reference.
    """
    if window is not None and not window[0] <= window[1]:
        raise OptionError(f"the window must begin before it ends, not ({window[0]}, {window[1]})")
    if window is None and reference in _courses:
        return _courses[reference]
    duration = np.diff(reference.stamps)
    counted = duration <= REFERENCE_GAP_SECONDS
    if window is not None:
        counted &= (reference.stamps[:-1] >= window[0]) & (reference.stamps[1:] <= window[1])
    steps = np.where(counted, rotation.vector_norm(np.diff(reference.positions, axis=0)), 0.0)
    path = np.concatenate(([0.0], np.cumsum(steps)))
    clock = np.concatenate(([0.0], np.cumsum(np.where(counted, duration, 0.0))))
    if window is None:
        _courses[reference] = path, clock
    return path, clock
