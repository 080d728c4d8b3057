# SPDX-License-Identifier: Apache-2.0
"""Files in which a program writes its poses in its own way, as an Algorithm declares them."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from slamhive.contract import posefiles
from slamhive.model.base import Choice, Model, RelativePath, optional

ColumnName = Annotated[str, StringConstraints(min_length=1, max_length=200)]
_TAKEN = (
    *("trajectory.txt", "trajectory.online.txt", "trajectory.keyframes.txt"),
    *("metrics.json", "segments.csv", "usage.csv", "health.csv", "covariances.csv"),
)


class PoseFormat(Choice):
    """Formats of files in which a program writes its poses."""

    TUM = posefiles.TUM
    EUROC = posefiles.EUROC
    KITTI = posefiles.KITTI
    CSV = posefiles.CSV


class PoseColumns(Model):
    """Names that the first line of a CSV file has for what a pose consists of."""

    timestamp: ColumnName = Field(default="timestamp", description="Time stamp or frame index.")
    tx: ColumnName = Field(default="tx", description="Position along x, m.")
    ty: ColumnName = Field(default="ty", description="Position along y, m.")
    tz: ColumnName = Field(default="tz", description="Position along z, m.")
    qx: ColumnName = Field(default="qx", description="x of the rotation's quaternion.")
    qy: ColumnName = Field(default="qy", description="y of the rotation's quaternion.")
    qz: ColumnName = Field(default="qz", description="z of the rotation's quaternion.")
    qw: ColumnName = Field(default="qw", description="w of the rotation's quaternion, its real part.")


class PoseFile(Model):
    """A file in which a program writes its poses: what its numbers mean."""

    path: RelativePath = Field(description="The file in the output folder.")
    format: PoseFormat = Field(
        description="Tum: t tx ty tz qx qy qz qw. Euroc: t, tx, ty, tz, qw, qx, qy, qz and more. Kitti: the "
        "3×4 pose matrix row by row. Csv: a table with commas, semicolons, tabs or spaces, whose first line "
        "names the columns."
    )
    columns: PoseColumns | None = optional(
        "Csv: the names of its columns, where they are others than timestamp, tx, ty, tz, qx, qy, qz, qw."
    )
    header: list[ColumnName] | None = optional(
        "Csv: the names of all its columns from the first on, where no first line of the file has them.",
        min_length=8,
        max_length=1000,
    )
    inverted: bool = Field(
        default=False, description="Whether it has the world's pose in the sensor's frame: it is inverted."
    )
    stamps: Literal["s", "ns", "frame-index", "s-since-first"] | None = optional(
        "What stamps count: seconds, nanoseconds, frames of the mode's first sensor from 0 on, or seconds "
        "since the first of them, as times.txt of a Kitti folder does; default: s of Tum and Csv, ns of "
        "Euroc, frame-index of Kitti."
    )

    @model_validator(mode="after")
    def _readable(self) -> Self:
        if self.columns is not None and self.format is not PoseFormat.CSV:
            raise ValueError("columns: only the format Csv takes it")
        if self.header is not None:
            self._check_header(self.header)
        if self.path in _TAKEN:
            raise ValueError(
                f"path: {self.path} is the contract's own file; have the program write another, which is "
                "kept beside it"
            )
        if not self.path.isprintable():
            raise ValueError("path: expected printable characters alone")
        return self

    def _check_header(self, header: list[str]) -> None:
        if self.format is not PoseFormat.CSV:
            raise ValueError("header: only the format Csv takes it")
        for name in (self.columns or PoseColumns()).model_dump().values():
            if header.count(name) != 1:
                found = "no column" if name not in header else f"{header.count(name)} columns"
                raise ValueError(f"header: it has {found} {name!r}, of which one is needed")

    @property
    def told(self) -> posefiles.DeclaredPoseFile:
        """Return its description for supervisor and sidecar."""
        columns = None
        if self.format is PoseFormat.CSV:
            columns = (self.columns or PoseColumns()).model_dump()
        stamps = self.stamps or posefiles.USUAL_STAMPS[self.format]
        header = None if self.header is None else tuple(self.header)
        return posefiles.DeclaredPoseFile(self.path, str(self.format), stamps, self.inverted, columns, header)


def told_files(trajectory: PoseFile | None, keyframes: PoseFile | None, frames: str) -> dict[str, Any] | None:
    """Return the description of a program's files for supervisor and sidecar; None for no files.

    Args:
        trajectory: The file with the final estimate.
        keyframes: The file with keyframes.
        frames: Where they find the stamps of the recording's frames.
    """
    if trajectory is None and keyframes is None:
        return None
    told, beside = (None if file is None else file.told for file in (trajectory, keyframes))
    return posefiles.PoseFiles(told, beside, frames).as_json()
