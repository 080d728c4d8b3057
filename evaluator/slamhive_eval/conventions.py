# SPDX-License-Identifier: Apache-2.0
"""Poses that were written by another convention than the usual one, read as they were meant.

The usual one: a pose takes vectors of the body into the world, its quaternion is written x y z w.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

from slamhive_eval import rotation
from slamhive_eval.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable

Convention = Literal["inverse", "inverse-rotation", "wxyz", "left-handed"]
CONVENTIONS: tuple[Convention, ...] = get_args(Convention)


def read_as(trajectory: Trajectory, convention: Convention) -> Trajectory:
    """The poses in the usual convention.

    Args:
        trajectory: What was read as if it were of the usual one.
        convention: ``inverse``: each pose takes vectors of the world into the body; ``inverse-rotation``: its
            rotation does, the position is the body's in the world; ``wxyz``: the quaternion's scalar stands
            first; ``left-handed``: y points the other way.

    Returns:
        As many poses, without covariances.
    """
    return _READERS[convention](trajectory)


def _inverse(one: Trajectory) -> Trajectory:
    back = rotation.conjugate(one.quaternions)
    return _made(one, -rotation.rotate(back, one.positions), back)


def _inverse_rotation(one: Trajectory) -> Trajectory:
    return _made(one, one.positions, rotation.conjugate(one.quaternions))


def _scalar_first(one: Trajectory) -> Trajectory:
    return _made(one, one.positions, one.quaternions[:, [1, 2, 3, 0]])


def _left_handed(one: Trajectory) -> Trajectory:
    return _made(one, one.positions * (1.0, -1.0, 1.0), one.quaternions * (-1.0, 1.0, -1.0, 1.0))


def _made(one: Trajectory, positions: rotation.FloatArray, quaternions: rotation.FloatArray) -> Trajectory:
    return Trajectory(
        one.stamps,
        positions,
        quaternions,
        oriented=one.oriented,
        stamped_by=one.stamped_by,
        notes=one.notes,
        nan_rows=one.nan_rows,
    )


_READERS: dict[Convention, Callable[[Trajectory], Trajectory]] = {
    "inverse": _inverse,
    "inverse-rotation": _inverse_rotation,
    "wxyz": _scalar_first,
    "left-handed": _left_handed,
}
