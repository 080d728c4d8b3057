# SPDX-License-Identifier: Apache-2.0
"""Files in which a program writes its poses, as its Algorithm declares them to supervisor and sidecar."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

TUM, EUROC, KITTI, CSV = FORMATS = ("Tum", "Euroc", "Kitti", "Csv")
SECONDS, NANOSECONDS, FRAME_INDEX, SINCE_FIRST = STAMPS = ("s", "ns", "frame-index", "s-since-first")
BY_FRAMES = (FRAME_INDEX, SINCE_FIRST)
"""Stamps that mean something only beside those of the recording's frames."""
USUAL_STAMPS = {TUM: SECONDS, EUROC: NANOSECONDS, KITTI: FRAME_INDEX, CSV: SECONDS}
FRAMES = "frames.txt"
"""In the folder of a prepared recording: stamps of the frames that indices count, ns of sensor time, a line
a frame."""
COLUMNS = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
"""Columns that a table of poses has to hold."""


@dataclass(frozen=True, slots=True)
class DeclaredPoseFile:
    """A file with poses.

    Attributes:
        path: In the output folder.
        format: One of FORMATS.
        stamps: One of STAMPS.
        inverted: Its poses are those of the world in the sensor's frame.
        columns: Of a CSV file, the name in its first line of each of COLUMNS.
        header: Of a CSV file without such a line, the names that it would have.
    """

    path: str
    format: str
    stamps: str
    inverted: bool = False
    columns: Mapping[str, str] | None = None
    header: Sequence[str] | None = None

    def __post_init__(self) -> None:
        parts = self.path.split("/") if isinstance(self.path, str) else [""]
        if not all(parts) or {".", ".."} & {*parts} or "\0" in self.path:
            raise ValueError(f"path must lead below the output folder, not {self.path!r}")
        if self.format not in FORMATS or self.stamps not in STAMPS or not isinstance(self.inverted, bool):
            raise ValueError(f"format, stamps or inverted of {self.path} is none that is known")
        names = self.columns
        if names is not None and not (
            isinstance(names, dict)
            and {*names} == {*COLUMNS}
            and all(isinstance(x, str) for x in names.values())
        ):
            raise ValueError(f"columns of {self.path} must name {', '.join(COLUMNS)}")
        header = self.header
        if header is not None and not (
            isinstance(header, (list, tuple)) and all(isinstance(x, str) for x in header)
        ):
            raise ValueError(f"header of {self.path} must be a list of names")

    def as_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        told: dict[str, Any] = {"path": self.path, "format": self.format}
        told |= {"stamps": self.stamps, "inverted": self.inverted}
        if self.columns is not None:
            told["columns"] = dict(self.columns)
        if self.header is not None:
            told["header"] = list(self.header)
        return told


@dataclass(frozen=True, slots=True)
class PoseFiles:
    """Pose files that a program writes in formats of its own, beside the contract's own files.

    Attributes:
        trajectory: Its final estimate, None where that is trajectory.txt itself.
        keyframes: Its keyframes, None for none.
        frames: File with the stamps of the recording's frames, None where no file counts from them.
    """

    trajectory: DeclaredPoseFile | None = None
    keyframes: DeclaredPoseFile | None = None
    frames: str | None = None

    @property
    def counts_frames(self) -> bool:
        """Tell whether a file has stamps that count from the recording's frames."""
        return any(file and file.stamps in BY_FRAMES for file in (self.trajectory, self.keyframes))

    def as_json(self) -> dict[str, Any]:
        """Return them as plain values."""
        files = {"trajectory": self.trajectory, "keyframes": self.keyframes}
        told: dict[str, Any] = {name: file.as_json() for name, file in files.items() if file}
        return {**told, "frames": self.frames} if self.counts_frames else told

    @classmethod
    def from_json(cls, values: object) -> Self:
        """Read what `as_json` gave.

        Raises:
            ValueError: It did not.
        """
        if not isinstance(values, dict) or values.keys() - {"trajectory", "keyframes", "frames"}:
            raise ValueError("expected an object with trajectory, keyframes and frames")
        try:
            files = {
                name: DeclaredPoseFile(**values[name])
                for name in ("trajectory", "keyframes")
                if name in values
            }
        except TypeError as error:
            raise ValueError(str(error)) from None
        found = cls(**files, frames=values.get("frames"))
        if found.counts_frames and not (isinstance(found.frames, str) and found.frames.startswith("/")):
            raise ValueError("frames must be an absolute path where a file counts from frames")
        return found
