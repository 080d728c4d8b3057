# SPDX-License-Identifier: Apache-2.0
"""Rotations as quaternions (x, y, z, w), without numpy: what converting a trajectory takes.

slamhive_eval has the same for arrays; here is the standard library alone.
"""

from __future__ import annotations

import math

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]

TOLERANCE = 0.01
"""Tolerance of the products of a rotation matrix's rows, and a quaternion's norm by five times."""


def is_rotation(m: list[float]) -> bool:
    """Tell whether a 3×3 matrix, row by row, is a rotation to TOLERANCE: orthonormal, and no reflection."""
    a, b, c = m[:3], m[3:6], m[6:9]
    products = (_dot(a, a) - 1, _dot(b, b) - 1, _dot(c, c) - 1, _dot(a, b), _dot(a, c), _dot(b, c))
    triple = (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    return max(map(abs, products)) <= TOLERANCE and triple > 0


def from_matrix(m: list[float]) -> Quaternion:
    """Return the unit quaternion of a rotation matrix, row by row, w ≥ 0 where w is its largest component.

    By S. W. Shepperd, "Quaternion from rotation matrix", Journal of Guidance and Control 1(3), 1978: of the
    four ways to solve for it, the one that divides by the largest component.
    """
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = m
    trace = m00 + m11 + m22
    largest = max(trace, m00, m11, m22)
    if largest == trace:
        return normalized((m21 - m12, m02 - m20, m10 - m01, 1 + trace))
    if largest == m00:
        return normalized((1 + m00 - m11 - m22, m01 + m10, m02 + m20, m21 - m12))
    if largest == m11:
        return normalized((m01 + m10, 1 - m00 + m11 - m22, m12 + m21, m02 - m20))
    return normalized((m02 + m20, m12 + m21, 1 - m00 - m11 + m22, m10 - m01))


def normalized(q: Quaternion) -> Quaternion:
    """Return a quaternion of norm 1."""
    x, y, z, w = q
    norm = math.hypot(x, y, z, w)
    return x / norm, y / norm, z / norm, w / norm


def inverse(t: Vector, q: Quaternion) -> tuple[Vector, Quaternion]:
    """Return the inverse of a pose: rotation conj(q), translation −R(conj(q)) t.

    Args:
        t: Translation.
        q: Rotation, of norm 1. A vector v is turned by q = (u, w) into v + 2w (u × v) + 2 u × (u × v).
    """
    (x, y, z), (px, py, pz) = (-q[0], -q[1], -q[2]), t
    w = q[3]
    cx, cy, cz = 2 * (y * pz - z * py), 2 * (z * px - x * pz), 2 * (x * py - y * px)
    turned = (
        px + w * cx + y * cz - z * cy,
        py + w * cy + z * cx - x * cz,
        pz + w * cz + x * cy - y * cx,
    )
    return (-turned[0], -turned[1], -turned[2]), (x, y, z, w)


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
