# SPDX-License-Identifier: Apache-2.0
"""Maps against a reference, and how sharp a map is without one; the kd-tree is scipy's or small_gicp's.

Nearest points take either, small_gicp's where both are installed, for it takes half the time; neighbours
within a radius take scipy's. Both are extras.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval.errors import EvaluationError, OptionError
from slamhive_eval.statistics import Statistics

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive_eval.rotation import FloatArray, IndexArray

MIN_NEIGHBOURS = 5
"""A covariance of fewer points than this says nothing about a surface."""
_PAIRS = 1_000_000
"""Neighbours held at once (some 100 MB)."""
_FLOOR_SQUARE_METRES = 1e-12
"""Added to covariances (1 µm): points exactly in a plane have no logarithm of their volume otherwise."""


@dataclass(frozen=True, eq=False)
class MapErrors:
    """A map against a reference.

    Attributes:
        threshold: Distance in m up to which a point counts as right.
        to_reference: From each point of the map to the nearest of the reference in m, shape (n,).
        to_estimate: From each point of the reference to the nearest of the map in m, shape (m,).
    """

    threshold: float
    to_reference: FloatArray
    to_estimate: FloatArray

    @property
    def precision(self) -> float:
        """Share of the map's points within the threshold of the reference."""
        return float(np.mean(self.to_reference <= self.threshold))

    @property
    def recall(self) -> float:
        """Share of the reference's points within the threshold of the map."""
        return float(np.mean(self.to_estimate <= self.threshold))

    @property
    def f_score(self) -> float:
        """Harmonic mean of precision and recall, 0 where both are."""
        total = self.precision + self.recall
        return 2.0 * self.precision * self.recall / total if total else 0.0

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data: statistics in m of accuracy and completeness, and the shares."""
        accuracy, completeness = Statistics.of(self.to_reference), Statistics.of(self.to_estimate)
        assert accuracy is not None  # noqa: S101 - compare_maps refuses empty maps
        assert completeness is not None  # noqa: S101
        return {
            "threshold": self.threshold,
            "accuracy": accuracy.as_dict(),
            "completeness": completeness.as_dict(),
            "precision": self.precision,
            "recall": self.recall,
            "fScore": self.f_score,
            "chamfer": accuracy.mean + completeness.mean,
        }


@dataclass(frozen=True)
class MapEntropy:
    """Mean map entropy, a measure of how blurred a map is.

    Attributes:
        mean: Mean entropy in nats; smaller is sharper. None where no point has neighbours enough.
        used: Points with enough neighbours.
        points: All points.
        radius: Of the neighbourhoods in m.
    """

    mean: float | None
    used: int
    points: int
    radius: float

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data."""
        return {
            "meanMapEntropy": self.mean,
            "usedPoints": self.used,
            "points": self.points,
            "radius": self.radius,
        }


def compare_maps(reference: FloatArray, estimate: FloatArray, threshold: float = 0.05) -> MapErrors:
    """Accuracy, completeness and F-score (Knapitsch et al. 2017, section 5).

    Args:
        reference: Points in m, shape (m, 3), spread evenly: a dense part would outweigh the rest.
        estimate: Points in m in the reference's frame, shape (n, 3), spread evenly too; see thin_out.
        threshold: Distance up to which a point counts as right, in m.

    Returns:
        Distances both ways.

    Raises:
        OptionError: No points, or a threshold that isn't positive.
        EvaluationError: Neither scipy nor small_gicp is installed.
    """
    if not (np.isfinite(threshold) and threshold > 0):
        raise OptionError(f"the threshold must be a positive number of metres, not {threshold}")
    for points, name in ((reference, "reference"), (estimate, "map")):
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            raise OptionError(f"the {name} must be points of shape (n, 3), n ≥ 1, not {points.shape}")
    nearest = _nearest()
    return MapErrors(float(threshold), nearest(reference, estimate), nearest(estimate, reference))


def mean_map_entropy(points: FloatArray, radius: float = 0.3) -> MapEntropy:
    """Mean map entropy (Droeschel et al. 2014; Razlaw et al. 2015, eq. 2 and 3).

    h(p) = ½·ln|2πe·Σ(p)| with the covariance Σ of the points within the radius of p, averaged over points
    with at least five of them. Compare maps of equal density and radius only.

    Args:
        points: In m, shape (n, 3).
        radius: Of a neighbourhood in m.

    Returns:
        The entropy.

    Raises:
        OptionError: A radius that isn't positive.
        EvaluationError: scipy isn't installed.
    """
    if not (np.isfinite(radius) and radius > 0):
        raise OptionError(f"the radius must be a positive number of metres, not {radius}")
    centred = points - points.mean(axis=0)
    tree = _kd_tree()(centred)
    counts = np.asarray(tree.query_ball_point(centred, radius, return_length=True))
    chosen = np.flatnonzero(counts >= MIN_NEIGHBOURS)
    parts = np.split(chosen, np.flatnonzero(np.diff(np.cumsum(counts[chosen]) // _PAIRS)) + 1)
    total = sum(_entropies(centred, tree, part, radius) for part in parts if len(part))
    used = len(chosen)
    return MapEntropy(total / used if used else None, used, len(points), float(radius))


def _entropies(points: FloatArray, tree: Any, chosen: IndexArray, radius: float) -> float:
    """Sum of the entropies of the chosen points' neighbourhoods."""
    lists = tree.query_ball_point(points[chosen], radius)
    sizes = np.array([len(one) for one in lists])
    starts = np.concatenate(([0], np.cumsum(sizes)[:-1]))
    away = points[np.concatenate(lists).astype(np.intp)] - np.repeat(points[chosen], sizes, axis=0)
    mean = np.add.reduceat(away, starts) / sizes[:, np.newaxis]
    square = np.add.reduceat(away[:, :, np.newaxis] * away[:, np.newaxis, :], starts)
    covariance = square / sizes[:, np.newaxis, np.newaxis] - mean[:, :, np.newaxis] * mean[:, np.newaxis, :]
    spread = np.maximum(np.linalg.eigvalsh(covariance), 0.0) + _FLOOR_SQUARE_METRES
    return float(np.sum(0.5 * np.log(2.0 * np.pi * np.e * spread)))


def thin_out(points: FloatArray, voxel: float) -> FloatArray:
    """The mean of the points in each cube of a grid, which makes their density even.

    Args:
        points: In m, shape (n, 3).
        voxel: Edge of a cube in m.

    Returns:
        One point a cube that holds any, shape (k, 3).

    Raises:
        OptionError: An edge that isn't positive, or so small that the cubes can't be numbered.
    """
    if not (np.isfinite(voxel) and voxel > 0):
        raise OptionError(f"the edge of a voxel must be a positive number of metres, not {voxel}")
    cells = np.floor((points - points.min(axis=0)) / voxel)
    if cells.max() >= 2**20:
        raise OptionError(
            f"voxels of {voxel:g} m are too small for a map of {np.ptp(points, axis=0).max():g} m"
        )
    sizes = 2**21
    keys = (cells[:, 0].astype(np.int64) * sizes + cells[:, 1].astype(np.int64)) * sizes
    _, which, counts = np.unique(keys + cells[:, 2].astype(np.int64), return_inverse=True, return_counts=True)
    sums = [np.bincount(which, weights=points[:, axis]) for axis in range(3)]
    return np.column_stack(sums) / counts[:, np.newaxis]


def _nearest() -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return a function that finds the distance in m from each of some points to the nearest of others."""
    try:
        build = importlib.import_module("small_gicp").KdTree
    except ImportError:
        tree = _kd_tree("maps need a kd-tree: pip install scipy, or small_gicp")
        return lambda points, wanted: np.asarray(tree(points).query(wanted)[0], dtype=np.float64)
    return lambda points, wanted: np.sqrt(
        np.asarray(build(points).batch_nearest_neighbor_search(wanted)[1], dtype=np.float64)
    )


def _kd_tree(missing: str = "mean map entropy needs scipy's kd-tree: pip install scipy") -> Any:
    try:
        return importlib.import_module("scipy.spatial").cKDTree
    except ImportError as error:
        raise EvaluationError(missing) from error
