# SPDX-License-Identifier: Apache-2.0
"""Trajectories out to files, in the formats that they are read from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from slamhive_eval.errors import OptionError

if TYPE_CHECKING:
    from slamhive_eval.rotation import FloatArray
    from slamhive_eval.trajectory import Trajectory

OutputFormat = Literal["tum", "kitti", "euroc", "csv"]
OUTPUT_FORMATS: tuple[OutputFormat, ...] = get_args(OutputFormat)

_EUROC_HEADER = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
)


def write_trajectory(path: str | Path, trajectory: Trajectory, output_format: OutputFormat) -> None:
    """Write a trajectory with every digit that float64 needs to be read back.

    Args:
        path: Where to; what is there is replaced.
        trajectory: What to write.
        output_format: ``tum``: stamp tx ty tz qx qy qz qw. ``kitti``: the 3×4 matrix row by row, without
            stamps. ``euroc``: ns, position, quaternion with qw first. ``csv``: the columns of TUM with
            their names; positions only where there are no orientations.

    Raises:
        OSError: The file can't be written.
        OptionError: An unknown format, or KITTI or EuRoC for positions without orientations.
    """
    if output_format not in OUTPUT_FORMATS:
        raise OptionError(f"unknown format {output_format!r} to write; known are {', '.join(OUTPUT_FORMATS)}")
    if not trajectory.oriented and output_format != "csv":
        raise OptionError(f"{output_format} needs orientations, and there are positions only; write csv")
    stamps, positions, quaternions = trajectory.stamps, trajectory.positions, trajectory.quaternions
    if output_format == "tum":
        lines = ["# timestamp tx ty tz qx qy qz qw"]
        lines += _rows(np.column_stack((stamps, positions, quaternions)), " ")
    elif output_format == "kitti":
        matrices = np.concatenate((trajectory.matrices, positions[:, :, np.newaxis]), axis=2)
        lines = _rows(matrices.reshape(-1, 12), " ")
    elif output_format == "euroc":
        rest = _rows(np.column_stack((positions, quaternions[:, [3, 0, 1, 2]])), ",")
        lines = [_EUROC_HEADER]
        lines += [f"{_nanoseconds(stamp)},{row}" for stamp, row in zip(stamps.tolist(), rest, strict=True)]
    else:
        columns = [stamps, positions] + [quaternions] * trajectory.oriented
        lines = ["timestamp,x,y,z" + ",qx,qy,qz,qw" * trajectory.oriented]
        lines += _rows(np.column_stack(columns), ",")
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _rows(table: FloatArray, separator: str) -> list[str]:
    return [separator.join(map(repr, row)) for row in table.tolist()]


def _nanoseconds(stamp: float) -> int:
    """Whole nanoseconds of a float64 stamp, without another rounding on the way."""
    numerator, denominator = stamp.as_integer_ratio()
    return (numerator * 10**9 + denominator // 2) // denominator
