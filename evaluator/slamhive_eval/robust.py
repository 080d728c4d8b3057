# SPDX-License-Identifier: Apache-2.0
"""Alignments that a few wrong poses don't move: a jump, a lost stretch, a false loop closure.

Least squares lets one pose a hundred metres off turn the whole estimate. ``trimmed`` minimises the squared
errors of the best-fitting share of the poses (least trimmed squares, Rousseeuw 1984; concentration steps,
Rousseeuw and Van Driessen 2006). ``huber`` starts there and gives each pose the weight of Huber's loss
(1964), so that good poses that trimming left out count again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.alignment import Alignment, Method, align
from slamhive_eval.errors import OptionError

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray, IndexArray
    from slamhive_eval.trajectory import Trajectory

Loss = Literal["huber", "trimmed"]
LOSSES: tuple[Loss, ...] = get_args(Loss)

DEFAULT_KEEP = 0.75
_STARTS = 16
"""Stretches of the trajectory that are aligned alone to start from."""
_SAMPLE = 2000
"""Poses, evenly chosen, that decide between the starts."""
_STEPS = 50
_HUBER = 2.5
"""Standard deviations from which errors weigh less: nine of ten normal errors in three axes don't."""
_MEDIAN_OF_NORM = 1.5382
"""Median length of a vector of three standard normal numbers."""


def align_robustly(
    reference: Trajectory,
    estimate: Trajectory,
    method: Method,
    loss: Loss = "trimmed",
    keep: float = DEFAULT_KEEP,
) -> Alignment:
    """Align associated trajectories, pose k to pose k, heeding outliers little or not at all.

    Args:
        reference: m poses.
        estimate: m poses, associated with those of the reference.
        method: ``se3``, ``sim3``, ``scale`` or ``yaw``; see `align`.
        loss: ``trimmed`` or ``huber``.
        keep: Share of the poses that ``trimmed`` fits, within 0.5 and 1.

    Returns:
        The alignment; its notes say how many poses counted less or not at all.

    Raises:
        OptionError: Another method or loss, or a share out of bounds.
        TrajectoryError: As for align.
    """
    if loss not in LOSSES:
        raise OptionError(f"unknown robust loss {loss!r}; known are {', '.join(LOSSES)}")
    if method in ("none", "origin"):
        raise OptionError(f"the alignment {method} fits no positions, so that it can't be robust")
    if not 0.5 <= keep <= 1.0:
        raise OptionError(f"the share of poses to keep must lie within 0.5 and 1, not {keep}")
    if method == "scale":
        found = align_robustly(reference, estimate, "sim3", loss, keep)
        return Alignment(method, np.eye(3), np.zeros(3), found.scale, found.notes)
    if loss == "huber":
        keep = 0.5
    n = len(reference)
    chosen = np.unique(np.linspace(0, n - 1, min(n, _SAMPLE)).astype(np.intp))
    found = _best_start(reference.select(chosen), estimate.select(chosen), method, keep)
    found, kept = _concentrated(reference, estimate, found, keep)
    if loss == "trimmed":
        left_out = n - len(kept)
        return _noted(found, f"{left_out} of {n} poses that fit worst were left out of the alignment")
    found, weights = _reweighted(reference, estimate, found)
    less = int(np.count_nonzero(weights < 1.0))
    return _noted(found, f"{less} of {n} poses counted less in the alignment, the last {weights.min():.2g}")


def _noted(found: Alignment, note: str) -> Alignment:
    return replace(found, notes=(*found.notes, note))


def _errors(reference: Trajectory, estimate: Trajectory, found: Alignment) -> FloatArray:
    return rotation.vector_norm(found.apply(estimate).positions - reference.positions)


def _best_start(reference: Trajectory, estimate: Trajectory, method: Method, keep: float) -> Alignment:
    """Of the alignments of all and of each stretch, the one whose best share of errors is least."""
    n = len(reference)
    stretches = [part for part in np.array_split(np.arange(n), min(_STARTS, max(n // 6, 1))) if len(part)]
    found: list[tuple[float, int, Alignment]] = []
    for part in (np.arange(n), *stretches):
        start = align(reference.select(part), estimate.select(part), method)
        better, kept = _concentrated(reference, estimate, start, keep, steps=5)
        errors = _errors(reference, estimate, better)[kept]
        found.append((float(np.sum(errors**2)), len(found), better))
    return min(found)[2]


def _kept(n: int, keep: float) -> int:
    return min(n, max(int(np.ceil(keep * n)), min(n, 3)))


def _concentrated(
    reference: Trajectory, estimate: Trajectory, start: Alignment, keep: float, steps: int = _STEPS
) -> tuple[Alignment, IndexArray]:
    """Align the poses that fit best, again and again: the sum of their squares can only fall."""
    count = _kept(len(reference), keep)
    found = start
    before: IndexArray | None = None
    for _ in range(steps):
        errors = _errors(reference, estimate, found)
        kept = np.sort(np.argsort(errors, kind="stable")[:count])
        if before is not None and np.array_equal(kept, before):
            break
        found = align(reference.select(kept), estimate.select(kept), start.method)
        before = kept
    return found, kept


def _reweighted(
    reference: Trajectory, estimate: Trajectory, start: Alignment
) -> tuple[Alignment, FloatArray]:
    """Iteratively reweighted least squares; the scale of the errors is that of the start."""
    found = start
    errors = _errors(reference, estimate, found)
    smallest = 1e-12 * max(float(np.abs(reference.positions).max()), 1.0)
    limit = max(_HUBER * float(np.median(errors)) / _MEDIAN_OF_NORM, smallest)
    weights = np.ones(len(errors))
    for _ in range(_STEPS):
        weights = limit / np.maximum(errors, limit)
        found = align(reference, estimate, start.method, weights=weights)
        before, errors = errors, _errors(reference, estimate, found)
        if np.abs(errors - before).max() <= 1e-9 * limit + smallest:
            break
    return found, weights
