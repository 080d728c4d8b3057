# SPDX-License-Identifier: Apache-2.0
"""Rotations as arrays of unit quaternions (x, y, z, w), many at once.

Everything here works element by element, without BLAS: equal poses then give bitwise equal results,
which keeps ties between poses of a standing robot ties.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IndexArray = npt.NDArray[np.intp]


def multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """Hamilton product a ⊗ b, the rotation b followed by a.

    Args:
        a: Quaternions xyzw, shape (..., 4).
        b: Quaternions xyzw, shape (..., 4); the shapes broadcast.

    Returns:
        The products, shape (..., 4).
    """
    ax, ay, az, aw = (a[..., k] for k in range(4))
    bx, by, bz, bw = (b[..., k] for k in range(4))
    return np.stack(
        (
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ),
        axis=-1,
    )


def conjugate(q: FloatArray) -> FloatArray:
    """Inverse of unit quaternions, shape (..., 4)."""
    inverse: FloatArray = q * np.array((-1.0, -1.0, -1.0, 1.0))
    return inverse


def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Rotate vectors by unit quaternions: v + 2w(u × v) + 2u × (u × v).

    Args:
        q: Unit quaternions xyzw, shape (..., 4).
        v: Vectors, shape (..., 3).

    Returns:
        The rotated vectors, shape (..., 3).
    """
    x, y, z, w = (q[..., k] for k in range(4))
    vx, vy, vz = (v[..., k] for k in range(3))
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return np.stack(
        (
            vx + w * tx + (y * tz - z * ty),
            vy + w * ty + (z * tx - x * tz),
            vz + w * tz + (x * ty - y * tx),
        ),
        axis=-1,
    )


def apply_matrix(matrix: FloatArray, v: FloatArray) -> FloatArray:
    """One 3×3 matrix times many vectors, shape (n, 3), element by element."""
    x, y, z = v[:, 0], v[:, 1], v[:, 2]
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in matrix], axis=-1)


def angle(q: FloatArray) -> FloatArray:
    """Rotation angle in radians within [0, π], accurate near both ends; shape (...)."""
    return 2.0 * np.arctan2(vector_norm(q), np.abs(q[..., 3]))


def vector_norm(q: FloatArray) -> FloatArray:
    """Norm of the first three components of vectors or quaternions, |sin(θ/2)| for the latter."""
    x, y, z = q[..., 0], q[..., 1], q[..., 2]
    norm: FloatArray = np.sqrt(x * x + y * y + z * z)
    return norm


def to_matrix(q: FloatArray) -> FloatArray:
    """Rotation matrices of unit quaternions: (..., 4) to (..., 3, 3)."""
    x, y, z, w = (q[..., k] for k in range(4))
    flat = np.stack(
        (
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - z * w),
            2.0 * (x * z + y * w),
            2.0 * (x * y + z * w),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - x * w),
            2.0 * (x * z - y * w),
            2.0 * (y * z + x * w),
            1.0 - 2.0 * (x * x + y * y),
        ),
        axis=-1,
    )
    return flat.reshape(*q.shape[:-1], 3, 3)


def from_matrix(matrix: FloatArray) -> FloatArray:
    """Unit quaternions of rotation matrices (Shepperd 1978: divide by the largest component).

    Args:
        matrix: Rotation matrices, shape (..., 3, 3); small departures from orthonormality are averaged out.

    Returns:
        Quaternions xyzw with w ≥ 0 wherever w is the largest component, shape (..., 4).
    """
    m = matrix.reshape(-1, 3, 3)
    m00, m11, m22 = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    trace = m00 + m11 + m22
    largest = np.argmax(np.stack((m00, m11, m22, trace)), axis=0)
    q = np.empty((len(m), 4))
    for axis in range(3):
        rows = np.flatnonzero(largest == axis)
        i, j, k = axis, (axis + 1) % 3, (axis + 2) % 3
        part = m[rows]
        q[rows, i] = 1.0 + part[:, i, i] - part[:, j, j] - part[:, k, k]
        q[rows, j] = part[:, j, i] + part[:, i, j]
        q[rows, k] = part[:, k, i] + part[:, i, k]
        q[rows, 3] = part[:, k, j] - part[:, j, k]
    rows = np.flatnonzero(largest == 3)
    part = m[rows]
    q[rows, 0] = part[:, 2, 1] - part[:, 1, 2]
    q[rows, 1] = part[:, 0, 2] - part[:, 2, 0]
    q[rows, 2] = part[:, 1, 0] - part[:, 0, 1]
    q[rows, 3] = 1.0 + trace[rows]
    return normalize(q).reshape(*matrix.shape[:-2], 4)


def normalize(q: FloatArray) -> FloatArray:
    """Quaternions scaled to unit norm, shape (..., 4)."""
    x, y, z, w = (q[..., k] for k in range(4))
    unit: FloatArray = q / np.sqrt(x * x + y * y + z * z + w * w)[..., np.newaxis]
    return unit


def from_roll_pitch_yaw(rpy: FloatArray) -> FloatArray:
    """Quaternions of R = Rz(yaw)·Ry(pitch)·Rx(roll).

    Args:
        rpy: Roll, pitch and yaw in radians, shape (n, 3).

    Returns:
        Quaternions xyzw, shape (n, 4).
    """
    half_sin, half_cos = np.sin(rpy / 2.0), np.cos(rpy / 2.0)
    about = np.zeros((3, len(rpy), 4))
    for axis in range(3):
        about[axis, :, axis] = half_sin[:, axis]
        about[axis, :, 3] = half_cos[:, axis]
    return multiply(about[2], multiply(about[1], about[0]))


def slerp(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Spherical interpolation along the shorter way (Shoemake 1985).

    Args:
        a: Unit quaternions at share 0, shape (n, 4).
        b: Unit quaternions at share 1, shape (n, 4).
        share: Where between them, within [0, 1], shape (n,).

    Returns:
        Unit quaternions, shape (n, 4).
    """
    dot = np.sum(a * b, axis=1)
    b = np.where(dot[:, np.newaxis] < 0.0, -b, b)
    theta = angle(multiply(conjugate(a), b)) / 2.0
    small = theta < 1e-9
    sine = np.where(small, 1.0, np.sin(theta))
    weight_a = np.where(small, 1.0 - share, np.sin((1.0 - share) * theta) / sine)
    weight_b = np.where(small, share, np.sin(share * theta) / sine)
    return normalize(weight_a[:, np.newaxis] * a + weight_b[:, np.newaxis] * b)


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """The rotation R that maximises trace(Rᵀ·matrix), 3×3 (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(matrix)
    sign = np.diag((1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))))
    rotation: FloatArray = u @ sign @ vt
    return rotation


def orthonormalize(matrices: FloatArray) -> FloatArray:
    """The rotations nearest to matrices that are rotations up to rounding.

    Newton's iteration for the polar factor, X ← X·(3·I − Xᵀ·X)/2 (Higham 1986): errors of 1e-2 are below
    rounding after four steps.

    Args:
        matrices: Shape (n, 3, 3), orthonormal to a few per cent.

    Returns:
        Rotation matrices, shape (n, 3, 3).
    """
    found = matrices
    for _ in range(4):
        gram = np.swapaxes(found, -1, -2) @ found
        found = found @ (1.5 * np.eye(3) - 0.5 * gram)
    return found
