# SPDX-License-Identifier: Apache-2.0
"""Covariances in columns of a table: which names stand for which entries, and the matrices they make.

Known are ``cov_xx``, ``cov_x_y``, ``cov_roll_yaw`` or ``cov_rx_rz``; ``pose.covariance0`` to 35, row by
row, as ``rostopic echo -p`` writes them; and OpenVINS' ``Pr11`` … ``Pr33`` and ``Pt11`` … ``Pt33``.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from slamhive_eval import rotation

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive_eval.rotation import FloatArray

Entry = tuple[int, int]
"""Row and column among x, y, z and the rotation about x, y, z."""

_AXES = {"x": 0, "y": 1, "z": 2, "rx": 3, "ry": 4, "rz": 5, "roll": 3, "pitch": 4, "yaw": 5}
_AXIS = "(rx|ry|rz|roll|pitch|yaw|x|y|z)"
_NAMED = re.compile(rf"cov(?:ariance)?[_. ]?{_AXIS}[_. ]?{_AXIS}$")
_NUMBERED = re.compile(r"covariance[_. \[]?(\d{1,2})\]?$")
_OPENVINS = re.compile(r"p([rt])([123])([123])$")


def find_columns(names: Sequence[str]) -> tuple[dict[Entry, int], bool]:
    """The columns that hold entries of a pose's covariance.

    Args:
        names: Of all columns.

    Returns:
        Column by entry, none unless there are the variances of all axes, each once; and whether those of the
        rotation are about the axes of the body, as OpenVINS' are, not of the world.
    """
    columns: dict[Entry, int] = {}
    of_body = False
    for k, name in enumerate(names):
        word = re.sub(r"[\[(]\D.*", "", name.strip().strip("\"'").lower()).strip()
        if "twist" in word or "vel" in word:
            continue
        entry = _entry(word)
        if entry is None:
            continue
        if entry in columns:
            return {}, False
        columns[entry] = k
        of_body |= word.startswith("pr")
    variances = {row for row, column in columns if row == column}
    axes = {axis for entry in columns for axis in entry}
    return (columns, of_body) if variances >= {0, 1, 2} and variances == axes else ({}, False)


def _entry(word: str) -> Entry | None:
    named, numbered, openvins = (one.search(word) for one in (_NAMED, _NUMBERED, _OPENVINS))
    if named:
        return _AXES[named.group(1)], _AXES[named.group(2)]
    if numbered and int(numbered.group(1)) < 36:
        row, column = divmod(int(numbered.group(1)), 6)
        return row, column
    if openvins:
        first = 3 if openvins.group(1) == "r" else 0
        return first + int(openvins.group(2)) - 1, first + int(openvins.group(3)) - 1
    return None


def assemble(
    entries: Mapping[Entry, FloatArray], quaternions: FloatArray | None, *, of_body: bool
) -> FloatArray | None:
    """Covariance matrices of columns; an entry without a column equals the one across the diagonal, or is 0.

    Args:
        entries: Values, shape (n,), by entry; with all of the diagonal.
        quaternions: Orientations xyzw, any norm, shape (n, 4); None for bare positions.
        of_body: Whether those of the rotation are about the body's axes: they are turned into the world's.

    Returns:
        Shape (n, 3, 3), or (n, 6, 6) where there are those of rotations too; None where all are zero.
    """
    size = 6 if max(max(entry) for entry in entries) > 2 else 3
    n = len(next(iter(entries.values())))
    made = np.zeros((n, size, size))
    for (row, column), values in entries.items():
        made[:, row, column] = values
        if (column, row) not in entries:
            made[:, column, row] = values
    if not made.any():
        return None
    if quaternions is None:
        return made[:, :3, :3]
    if of_body and size == 6:
        with np.errstate(all="ignore"):  # values that aren't finite stay so
            norm = np.sqrt(np.sum(quaternions * quaternions, axis=1, keepdims=True))
            turn = rotation.to_matrix(quaternions / np.where(norm > 0, norm, 1.0))
            both = np.zeros((n, 6, 6))
            both[:, :3, :3], both[:, 3:, 3:] = np.eye(3), turn
            made = both @ made @ both.transpose(0, 2, 1)
    return made
