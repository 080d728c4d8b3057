# SPDX-License-Identifier: Apache-2.0
"""Pairwise relations as ground truth (Kümmerle et al. 2009, "On measuring the accuracy of SLAM algorithms").

A ``.relations`` file holds manually verified relative poses, one a line: ``t1 t2 x y z roll pitch yaw``, the
pose at t2 in the frame of the pose at t1, in s, m and rad. No world frame is needed, hence no alignment:
each relation δ is compared with the estimate's own relative pose, E = δ⁻¹·(P₁⁻¹·P₂).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.association import interpolate, nearest
from slamhive_eval.errors import OptionError, TrajectoryError
from slamhive_eval.formats.textfiles import fault_in_row, parse_table, read_bytes
from slamhive_eval.statistics import Statistics
from slamhive_eval.trajectory import LARGEST_METRES, check_rigid

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.trajectory import Trajectory

DEFAULT_BINS_SECONDS = (0.0, 1.0, 10.0, 100.0, 1000.0)
"""Lower edges of the groups by |t2 − t1|; the last is open."""


@dataclass(frozen=True, eq=False)
class Relations:
    """Relative poses between two times.

    Attributes:
        begin: t1 in s, shape (n,).
        end: t2 in s, shape (n,); may lie before t1.
        positions: Of the pose at t2 in the frame of the pose at t1, in m, shape (n, 3).
        quaternions: Unit quaternions xyzw of the same, shape (n, 4).
    """

    begin: FloatArray
    end: FloatArray
    positions: FloatArray
    quaternions: FloatArray

    def __post_init__(self) -> None:
        n = len(self.begin)
        shapes = (self.end.shape, self.positions.shape, self.quaternions.shape)
        if n == 0 or shapes != ((n,), (n, 3), (n, 4)):
            raise TrajectoryError(
                f"relations need times (n,), positions (n, 3) and quaternions (n, 4), n ≥ 1, not {shapes}"
            )
        values = np.column_stack((self.begin, self.end, self.positions, self.quaternions))
        if not (np.abs(values) <= LARGEST_METRES).all():
            raise TrajectoryError("relations must be finite numbers")

    def __len__(self) -> int:
        return len(self.begin)


@dataclass(frozen=True)
class RelationGroup:
    """Errors of the relations whose times are between two limits apart.

    Attributes:
        from_seconds: Smallest |t2 − t1| in s, included.
        to_seconds: Largest, excluded; None for no limit.
        count: Relations compared.
        translation: Statistics of |t(E)| in m, None for count 0.
        rotation_deg: Statistics of the angle of E in degrees, None for count 0.
    """

    from_seconds: float
    to_seconds: float | None
    count: int
    translation: Statistics | None
    rotation_deg: Statistics | None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data."""
        return {
            "fromSeconds": self.from_seconds,
            "toSeconds": self.to_seconds,
            "count": self.count,
            "translation": self.translation.as_dict() if self.translation else None,
            "rotationDeg": self.rotation_deg.as_dict() if self.rotation_deg else None,
        }


@dataclass(frozen=True, eq=False)
class RelationErrors:
    """Result of `evaluate_relations`: errors of an estimate against pairwise ground truth.

    Attributes:
        relations: Relations in the file.
        used: Which of them the estimate has both poses of, shape (relations,).
        translation_errors: |t(E)| in m of the used ones, shape (count,).
        rotation_errors_deg: Angle of E in degrees of the used ones, shape (count,).
        overall: All used relations.
        by_time: The same by the time between their poses.
    """

    relations: int
    used: npt.NDArray[np.bool_]
    translation_errors: FloatArray
    rotation_errors_deg: FloatArray
    overall: RelationGroup
    by_time: tuple[RelationGroup, ...]

    @property
    def count(self) -> int:
        """Relations compared."""
        return self.overall.count

    @property
    def missing(self) -> int:
        """Relations without a pose of the estimate at one of their times."""
        return self.relations - self.count

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data: counts, overall statistics and groups by time."""
        overall = self.overall.as_dict()
        return {
            "relations": self.relations,
            "count": self.count,
            "missing": self.missing,
            "translation": overall["translation"],
            "rotationDeg": overall["rotationDeg"],
            "byTime": [group.as_dict() for group in self.by_time],
        }


def read_relations(path: str | Path) -> Relations:
    """Read a ``.relations`` file, plain or compressed.

    Raises:
        FileError: The file is missing, empty, no text, or wrong in the line named.
    """
    data = read_bytes(path)
    table = parse_table(path, data, 8, "t1 t2 x y z roll pitch yaw")
    bad = np.flatnonzero(~(np.abs(table) <= LARGEST_METRES).all(axis=1))
    if bad.size:
        raise fault_in_row(path, data, int(bad[0]), "every value must be a finite number")
    return Relations(table[:, 0], table[:, 1], table[:, 2:5], rotation.from_roll_pitch_yaw(table[:, 5:8]))


def evaluate_relations(
    relations: Relations,
    estimate: Trajectory | None,
    *,
    max_difference_seconds: float = 0.01,
    interpolate_gap_seconds: float | None = None,
    extrinsic: FloatArray | None = None,
    bins_seconds: tuple[float, ...] = DEFAULT_BINS_SECONDS,
) -> RelationErrors:
    """Compare an estimate with pairwise ground truth.

    Args:
        relations: The ground truth, between poses of the body.
        estimate: Any world frame, metric scale. None: there is no pose, every relation is missing.
        max_difference_seconds: A pose this near in time stands for the time wanted.
        interpolate_gap_seconds: Interpolate instead, between poses at most this far apart.
        extrinsic: T_body_sensor when the estimate is of a sensor: each relation is moved to the sensor's
            frame, T⁻¹·δ·T. None when the estimate is of the body.
        bins_seconds: Ascending lower edges of the groups by |t2 − t1|.

    Returns:
        The errors; a relation without both poses is counted as missing.

    Raises:
        OptionError: Edges that don't ascend, a negative tolerance, or an extrinsic that is no rigid motion.
    """
    if not bins_seconds or bool(np.any(np.diff(bins_seconds) <= 0)):
        raise OptionError(f"the edges of the groups by time must ascend, not {bins_seconds}")
    if not max_difference_seconds >= 0:
        raise OptionError(f"the largest time difference must be ≥ 0 s, not {max_difference_seconds}")
    found_1, p1, q1 = _poses_at(estimate, relations.begin, max_difference_seconds, interpolate_gap_seconds)
    found_2, p2, q2 = _poses_at(estimate, relations.end, max_difference_seconds, interpolate_gap_seconds)
    used = found_1 & found_2
    p1, q1, p2, q2 = p1[used], q1[used], p2[used], q2[used]
    true_step, true_turn = _in_sensor_frame(relations.positions[used], relations.quaternions[used], extrinsic)
    back = rotation.conjugate(q1)
    translation = rotation.vector_norm(rotation.rotate(back, p2 - p1) - true_step)
    turn = rotation.multiply(rotation.conjugate(true_turn), rotation.multiply(back, q2))
    degrees = np.rad2deg(rotation.angle(turn))
    apart = np.abs(relations.end - relations.begin)[used]
    groups = []
    for low, high in zip(bins_seconds, (*bins_seconds[1:], None), strict=True):
        inside = (apart >= low) & (apart < (np.inf if high is None else high))
        groups.append(_group(low, high, translation[inside], degrees[inside]))
    overall = _group(0.0, None, translation, degrees)
    return RelationErrors(len(relations), used, translation, degrees, overall, tuple(groups))


def _poses_at(
    estimate: Trajectory | None, times: FloatArray, tolerance: float, gap: float | None
) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray]:
    if estimate is None:
        count = len(times)
        return np.zeros(count, dtype=bool), np.zeros((count, 3)), np.zeros((count, 4))
    if gap is not None:
        return interpolate(estimate, times, gap)
    index = nearest(estimate.stamps, times, tolerance)
    return index >= 0, estimate.positions[index], estimate.quaternions[index]


def _in_sensor_frame(
    positions: FloatArray, quaternions: FloatArray, extrinsic: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    if extrinsic is None:
        return positions, quaternions
    matrix = check_rigid(extrinsic)
    mount = rotation.from_matrix(matrix[:3, :3])
    unmount = rotation.conjugate(mount)
    lever = np.broadcast_to(matrix[:3, 3], positions.shape)
    moved = positions + rotation.rotate(quaternions, lever) - lever
    turned = rotation.multiply(rotation.multiply(unmount, quaternions), mount)
    return rotation.rotate(unmount, moved), turned


def _group(low: float, high: float | None, translation: FloatArray, degrees: FloatArray) -> RelationGroup:
    return RelationGroup(low, high, len(translation), Statistics.of(translation), Statistics.of(degrees))
