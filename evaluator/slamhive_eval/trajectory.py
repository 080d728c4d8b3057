# SPDX-License-Identifier: Apache-2.0
"""A trajectory: stamped poses as three arrays, checked once and never changed afterwards."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from slamhive_eval import rotation
from slamhive_eval.errors import OptionError, TrajectoryError

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive_eval.rotation import FloatArray

StampedBy = Literal["time", "line", "frame"]

SMALLEST_QUATERNION_COMPONENT = 1e-3
"""A quaternion whose components are all below this carries no rotation; in a unit one, one is ≥ 0.5."""

LARGEST_STAMP_SECONDS = 1e12
"""30,000 years: stamps beyond are milliseconds, microseconds or nanoseconds by mistake."""

LARGEST_METRES = 1e30
"""A thousand times the observable universe: squares still fit, only a broken program gets there."""

_COLUMNS = ("time stamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")


class Fault(NamedTuple):
    """Invalid pose of a trajectory: its row, from 0, and what is wrong with it."""

    row: int
    message: str


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of one body over time, each the pose of the body frame in a world frame.

    Stamps are float64 seconds: at epoch time that resolves 0.24 µs, as in evo, far below any
    association tolerance. Equal stamps are allowed (real ground truth has them), decreasing ones aren't.

    Attributes:
        stamps: Time of each pose in s, shape (n,), n ≥ 1, never decreasing.
        positions: In m (or the unit of an unscaled estimate), shape (n, 3).
        quaternions: Unit quaternions xyzw, shape (n, 4); given ones of another norm are normalised.
        rotations: The rotation matrices of a file that holds such, shape (n, 3, 3), as they are: rounding
            leaves them orthonormal to 1e-6 only, and errors that evo takes from them have that in them.
            None where the quaternions are what was given.
        oriented: Whether there were orientations; False for bare positions, with quaternions 0 0 0 1.
        covariances: How wrong the estimator takes the poses to be: of positions in m², shape (n, 3, 3), or of
            x, y, z in m and the rotation about the world's fixed x, y, z in rad (as PoseWithCovariance),
            shape (n, 6, 6), in the world frame. None where it said nothing. Values aren't checked.
        stamped_by: What the stamps are: ``time`` in s; of KITTI poses without times, frames counted from 0:
            the number of the ``line``, or the ``frame`` that the file gives for each pose.
        notes: Sentences on how it was read that belong to every result.
        nan_rows: How many rows of its file held NaN and were left out.

    Raises:
        TrajectoryError: No poses, arrays of unequal length, a value that isn't finite, a decreasing
            stamp or a zero quaternion; the sentence names the pose, counted from 0.
    """

    stamps: FloatArray
    positions: FloatArray
    quaternions: FloatArray
    rotations: FloatArray | None = None
    oriented: bool = True
    covariances: FloatArray | None = None
    stamped_by: StampedBy = "time"
    notes: tuple[str, ...] = ()
    nan_rows: int = 0

    def __post_init__(self) -> None:
        stamps = np.array(self.stamps, dtype=np.float64)
        positions = np.array(self.positions, dtype=np.float64)
        quaternions = np.array(self.quaternions, dtype=np.float64)
        n = len(stamps) if stamps.ndim == 1 else -1
        if n < 0 or positions.shape != (n, 3) or quaternions.shape != (n, 4):
            raise TrajectoryError(
                "a trajectory needs stamps (n,), positions (n, 3) and quaternions (n, 4), "
                f"not {stamps.shape}, {positions.shape} and {quaternions.shape}"
            )
        if n == 0:
            raise TrajectoryError("the trajectory has no poses")
        fault = find_fault(stamps, positions, quaternions)
        if fault is not None:
            raise TrajectoryError(f"pose {fault.row} of {n}: {fault.message}")
        quaternions = rotation.normalize(quaternions / _largest(quaternions)[:, np.newaxis])
        rotations = None if self.rotations is None else np.array(self.rotations, dtype=np.float64)
        if rotations is not None and (rotations.shape != (n, 3, 3) or not np.isfinite(rotations).all()):
            raise TrajectoryError(f"rotations must be finite, ({n}, 3, 3), not of shape {rotations.shape}")
        covariances = None if self.covariances is None else np.array(self.covariances, dtype=np.float64)
        if covariances is not None and covariances.shape not in ((n, 3, 3), (n, 6, 6)):
            raise TrajectoryError(
                f"covariances must be ({n}, 3, 3) or ({n}, 6, 6), not of shape {covariances.shape}"
            )
        self._set(stamps, positions, quaternions, rotations, covariances)

    def _derived(
        self,
        positions: FloatArray,
        quaternions: FloatArray,
        rotations: FloatArray | None,
        stamps: FloatArray | None = None,
        covariances: FloatArray | None = None,
    ) -> Trajectory:
        """One made from this, which alignment may carry beyond the limits of a file."""
        made = object.__new__(type(self))
        made._set(self.stamps if stamps is None else stamps, positions, quaternions, rotations, covariances)
        for name in ("oriented", "stamped_by", "notes", "nan_rows"):
            object.__setattr__(made, name, getattr(self, name))
        return made

    def _set(
        self,
        stamps: FloatArray,
        positions: FloatArray,
        quaternions: FloatArray,
        rotations: FloatArray | None,
        covariances: FloatArray | None,
    ) -> None:
        arrays = {"stamps": stamps, "positions": positions, "quaternions": quaternions}
        for name, given in (("rotations", rotations), ("covariances", covariances)):
            object.__setattr__(self, name, None)
            if given is not None:
                arrays[name] = given
        for name, array in arrays.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.stamps)

    @cached_property
    def distances(self) -> FloatArray:
        """Path length from the first pose to each, in m, shape (n,)."""
        return np.concatenate(([0.0], np.cumsum(rotation.vector_norm(np.diff(self.positions, axis=0)))))

    @property
    def matrices(self) -> FloatArray:
        """Rotation matrices, shape (n, 3, 3): the given ones, else those of the quaternions."""
        return rotation.to_matrix(self.quaternions) if self.rotations is None else self.rotations

    @property
    def path_length(self) -> float:
        """Length of the whole path in m."""
        return float(self.distances[-1])

    def select(self, index: npt.NDArray[np.intp] | slice) -> Trajectory:
        """The poses at the given indices, which must not decrease; repetitions are allowed."""
        rotations = None if self.rotations is None else self.rotations[index]
        covariances = None if self.covariances is None else self.covariances[index]
        return self._derived(
            self.positions[index], self.quaternions[index], rotations, self.stamps[index], covariances
        )

    def orthonormal(self) -> Trajectory:
        """The same with the rotations of the quaternions, which are orthonormal to the last bit."""
        return self._derived(self.positions, self.quaternions, None, covariances=self.covariances)

    def noted(self, note: str) -> Trajectory:
        """The same poses with one more note."""
        made = self._derived(self.positions, self.quaternions, self.rotations, covariances=self.covariances)
        object.__setattr__(made, "notes", (*self.notes, note))
        return made

    def shifted(self, offset_seconds: float) -> Trajectory:
        """The same poses with so many seconds added to their stamps."""
        return self.at(self.stamps + offset_seconds)

    def at(self, stamps: FloatArray) -> Trajectory:
        """The same poses with other stamps, which must not decrease, shape (n,)."""
        return self._derived(self.positions, self.quaternions, self.rotations, stamps, self.covariances)

    def transformed(self, matrix: FloatArray, translation: FloatArray, scale: float = 1.0) -> Trajectory:
        """The same path in another world frame: p' = R·(s·p) + t and R' = R·R_pose.

        Args:
            matrix: Rotation R, shape (3, 3).
            translation: t in m, shape (3,).
            scale: s, applied to positions only.

        Returns:
            The moved trajectory with unchanged stamps.
        """
        positions = rotation.apply_matrix(matrix, scale * self.positions) + translation
        turned = rotation.multiply(rotation.from_matrix(matrix), self.quaternions)
        rotations = None if self.rotations is None else matrix @ self.rotations
        covariances = None if self.covariances is None else _turned(self.covariances, matrix, scale)
        return self._derived(positions, rotation.normalize(turned), rotations, covariances=covariances)

    def moved(self, extrinsic: FloatArray) -> Trajectory:
        """The path of another frame fixed to the body: T_world_sensor = T_world_body · T_body_sensor.

        It has no covariances: a lever arm turns those of the rotation into some of the position.

        Args:
            extrinsic: T_body_sensor, the pose of the sensor in the body frame, shape (4, 4).

        Returns:
            The trajectory of the sensor.

        Raises:
            OptionError: The matrix is no rigid motion.
        """
        matrix = check_rigid(extrinsic)
        turned = rotation.normalize(rotation.multiply(self.quaternions, rotation.from_matrix(matrix[:3, :3])))
        if self.rotations is not None:
            positions = self.positions + self.rotations @ matrix[:3, 3]
            return self._derived(positions, turned, self.rotations @ matrix[:3, :3])
        lever = np.broadcast_to(matrix[:3, 3], self.positions.shape)
        return self._derived(self.positions + rotation.rotate(self.quaternions, lever), turned, None)


def _turned(covariances: FloatArray, matrix: FloatArray, scale: float) -> FloatArray:
    """Covariances in a world that is turned by R, shape (3, 3), and where lengths are s times as long."""
    both = np.zeros(covariances.shape[1:])
    both[:3, :3] = scale * matrix
    if len(both) == 6:
        both[3:, 3:] = matrix
    with np.errstate(all="ignore"):  # values that aren't finite stay so
        turned: FloatArray = both @ covariances @ both.T
    return turned


def _largest(rows: FloatArray) -> FloatArray:
    """Largest absolute component of each row, column by column: rows are too short for a reduction."""
    largest = np.abs(rows[:, 0])
    for k in range(1, rows.shape[1]):
        np.maximum(largest, np.abs(rows[:, k]), out=largest)
    return largest


def find_fault(stamps: FloatArray, positions: FloatArray, quaternions: FloatArray) -> Fault | None:
    """The first thing wrong with stamped poses, or None; shapes (n,), (n, 3) and (n, 4)."""
    with np.errstate(all="ignore"):
        # A sum is finite only of finite numbers, and takes a tenth of the time of looking at each.
        finite = all(np.isfinite(array.sum()) for array in (stamps, positions, quaternions))
    values = np.column_stack((stamps, positions, quaternions)) if not finite else np.empty((0, 8))
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        row = int(bad[0])
        column = int(np.flatnonzero(~np.isfinite(values[row]))[0])
        return Fault(
            row,
            f"{_COLUMNS[column]} is {values[row, column]}; every value must be a finite number "
            "(leave out times without a pose)",
        )
    bad = np.flatnonzero(np.abs(stamps) > LARGEST_STAMP_SECONDS)
    if bad.size:
        row = int(bad[0])
        return Fault(row, f"time stamp {stamps[row]:.10g} is no number of seconds (nanoseconds perhaps?)")
    bad = np.flatnonzero(_largest(positions) > LARGEST_METRES)
    if bad.size:
        row = int(bad[0])
        return Fault(row, f"the position {np.abs(positions[row]).max():.3g} m is beyond {LARGEST_METRES:g} m")
    bad = np.flatnonzero(np.diff(stamps) < 0)
    if bad.size:
        row = int(bad[0]) + 1
        return Fault(
            row,
            f"time stamp {stamps[row]:.9f} s comes before the one above it, {stamps[row - 1]:.9f} s; "
            "stamps must not decrease",
        )
    bad = np.flatnonzero(_largest(quaternions) < SMALLEST_QUATERNION_COMPONENT)
    if bad.size:
        return Fault(int(bad[0]), "the quaternion is zero; it must have norm 1 (order qx qy qz qw)")
    return None


def check_rigid(transform: FloatArray) -> FloatArray:
    """The transform as a (4, 4) array, checked to be a rigid motion to 1e-3 (files round).

    Raises:
        OptionError: Another shape, a value that isn't finite, a last row other than 0 0 0 1, or a
            rotation part that isn't orthonormal with determinant 1.
    """
    matrix = np.asarray(transform, dtype=np.float64)
    if matrix.shape != (4, 4):
        raise OptionError(f"the extrinsic must be a 4×4 matrix, not of shape {matrix.shape}")
    if not (np.abs(matrix) <= LARGEST_METRES).all() or not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
        raise OptionError("the extrinsic must be finite with the last row 0 0 0 1")
    part = matrix[:3, :3]
    if np.abs(part @ part.T - np.eye(3)).max() > 1e-3 or np.linalg.det(part) < 0:
        raise OptionError("the extrinsic's upper left 3×3 part is no rotation (orthonormal, determinant 1)")
    return matrix
