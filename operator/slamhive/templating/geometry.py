# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms for templates: 4×4 matrices by rows, T_a_b with p_a = T_a_b p_b, metres.

Without numpy, which takes longer to be loaded than a template to be rendered.
"""

from __future__ import annotations

import math
from typing import Any

from slamhive.templating.numbers import HelperProblem, Matrix, rows_of, shown


def inverse(transform: Any) -> Matrix:
    """Return T_b_a of T_a_b: the transposed rotation R, and −R t."""
    T = checked(transform, "inverse")
    R = [[T[column][row] for column in range(3)] for row in range(3)]
    t = [-sum(R[row][k] * T[k][3] for k in range(3)) for row in range(3)]
    # 0.0 is added so that no -0.0 is printed.
    return [[*(item + 0.0 for item in R[row]), t[row] + 0.0] for row in range(3)] + [[0.0, 0.0, 0.0, 1.0]]


def product(first: Matrix, second: Matrix) -> Matrix:
    """Return T_a_c of T_a_b and T_b_c."""
    return [
        [sum(first[row][k] * second[k][column] for k in range(4)) + 0.0 for column in range(4)]
        for row in range(4)
    ]


def rotation(transform: Any) -> Matrix:
    """Return R_a_b of T_a_b, 3×3: it turns vectors from b's axes into a's."""
    return [row[:3] for row in checked(transform, "rotation")[:3]]


def translation(transform: Any) -> list[float]:
    """Return the translation of T_a_b in metres: where b's origin is in a."""
    return [row[3] for row in checked(transform, "translation")[:3]]


def quaternion(transform: Any, order: str = "xyzw") -> list[float]:
    """Return the rotation of T_a_b as a unit quaternion (Hamilton) with w ≥ 0.

    By the largest of its four components, which is exact for every rotation (Shepperd, J. Guidance and
    Control 1, 1978).

    Args:
        transform: T_a_b, or R_a_b.
        order: ``xyzw`` as TUM files, ROS and Eigen's coefficients have it, or ``wxyz`` as EuRoC and Ceres.
    """
    if order not in {"xyzw", "wxyz"}:
        raise HelperProblem(f"quaternion: the order must be 'xyzw' or 'wxyz', not {shown(order)}")
    R = rows_of(transform, "quaternion")
    if len(R) == 4:
        R = rotation(R)
    if len(R) != 3 or len(R[0]) != 3:
        raise HelperProblem(f"quaternion: expected a 4×4 or 3×3 matrix, found {shown(transform)}")
    trace = R[0][0] + R[1][1] + R[2][2]
    squares = [1 + 2 * R[0][0] - trace, 1 + 2 * R[1][1] - trace, 1 + 2 * R[2][2] - trace, 1 + trace]
    largest = max(range(4), key=squares.__getitem__)
    root = math.sqrt(max(squares[largest], 0.0))
    if root == 0.0:
        raise HelperProblem("quaternion: the matrix is no rotation")
    if largest == 3:
        q = [R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1], squares[3]]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q = [0.0] * 4
        q[i], q[j], q[k] = squares[i], R[i][j] + R[j][i], R[i][k] + R[k][i]
        q[3] = R[k][j] - R[j][k]
    norm = math.sqrt(sum(item * item for item in q))
    sign = -1.0 if q[3] < 0 else 1.0
    x, y, z, w = (sign * item / norm + 0.0 for item in q)
    return [x, y, z, w] if order == "xyzw" else [w, x, y, z]


def checked(transform: Any, who: str) -> Matrix:
    """Return a rigid transform, after checking its shape and last row."""
    T = rows_of(transform, who)
    if len(T) != 4 or len(T[0]) != 4 or T[3] != [0.0, 0.0, 0.0, 1.0]:
        raise HelperProblem(
            f"{who}: expected a 4×4 matrix with the last row 0 0 0 1, found {shown(transform)}"
        )
    return T
