# SPDX-License-Identifier: Apache-2.0
"""Import of trajectories of TartanAir, versions 1 and 2: image_left, depth_left, pose_left.txt."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slamhive.data.importers.contents import Contents, ImportedTruth, SensorStream, read_pixels
from slamhive.data.importers.frames import frame_stamps, require_frames, view_stream
from slamhive.data.importers.poses import trajectory
from slamhive.data.importers.tables import read_table
from slamhive.model.dataset import GroundTruth
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.importers import ImportOptions
    from slamhive_eval import Trajectory

TITLE = "a trajectory of TartanAir (image_left/, pose_left.txt)"

RATE = 10.0
"""Hz, assumed: the files have no stamps."""
BASELINE = 0.25
"""m between the cameras of a pair, where there are no poses of the right one."""
T_NED_OPTICAL = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Pose of the optical frame (right, down, forward) in the axes of the files (forward, right, down)."""


class TartanAirVersion(NamedTuple):
    """Names of folders and files in one version of TartanAir, and the lens of its cameras.

    Attributes:
        left: Name of the left camera.
        right: Name of the right camera.
        depth: Suffix of depth images.
        lens: Of all cameras.
    """

    left: str
    right: str
    depth: str
    lens: dict[str, float]


VERSIONS = (
    TartanAirVersion(
        "left", "right", ".npy", {"width": 640, "height": 480, "fx": 320, "fy": 320, "cx": 320, "cy": 240}
    ),
    TartanAirVersion(
        "lcam_front",
        "rcam_front",
        ".png",
        {"width": 640, "height": 640, "fx": 320, "fy": 320, "cx": 320, "cy": 320},
    ),
)


def recognises(source: Path) -> bool:
    """Tell whether something has images of the left camera, by the name of either version."""
    return any((source / f"image_{version.left}").is_dir() for version in VERSIONS)


def read(source: Path, options: ImportOptions) -> Contents:  # noqa: ARG001
    """Read a trajectory, such as P000.

    The body is the left camera (right, down, forward). Poses are turned from the files' axes (forward, right,
    down) to those of images, and the world from z down to z up.

    Raises:
        DataError: Something is missing or damaged.
    """
    version = next((known for known in VERSIONS if (source / f"image_{known.left}").is_dir()), None)
    if version is None:
        raise DataError(f"{source}: no folder image_left or image_lcam_front in it")
    left = _files(source / f"image_{version.left}", ".png")
    right = _files(source / f"image_{version.right}", ".png")
    depth = _files(source / f"depth_{version.left}", version.depth)
    if not left:
        raise DataError(f"{source / f'image_{version.left}'}: no images *.png in it")
    path = source / f"pose_{version.left}.txt"
    rows = read_table(path, 7, "tx ty tz qx qy qz qw").values
    series = {f"image_{version.left}": left, f"image_{version.right}": right, f"depth_{version.left}": depth}
    require_frames({str(source / name): files for name, files in series.items() if files}, len(rows), path)
    notes: list[str] = []
    stamps = frame_stamps(len(left), RATE, notes)
    poses = _optical(trajectory(path, stamps, rows[:, :3], rows[:, 3:]))
    source_of_lens = "TartanAir's lens"
    name = "left" if right else "color" if depth else "camera"
    streams = [view_stream(name, stamps, left, version.lens, frame=version.left, source=source_of_lens)]
    if right:
        pose = _right_pose(source / f"pose_{version.right}.txt", poses, notes)
        streams.append(
            view_stream(
                "right", stamps, right, version.lens, frame=version.right, source=source_of_lens, pose=pose
            )
        )
    if depth:
        streams.append(_depth(stamps, depth, version, source_of_lens))
        if right:
            notes.append("for rgbd modes remap the colour camera: input.remap.color: left")
    return Contents(
        description="Imported from a trajectory of TartanAir.",
        streams=streams,
        truth=ImportedTruth(GroundTruth(file="groundtruth.txt"), poses),
        body=version.left,
        gravity_aligned=True,
        notes=notes,
    )


def _files(folder: Path, suffix: str) -> list[Path]:
    return sorted(path for path in folder.glob(f"*{suffix}") if not path.name.startswith("."))


def _optical(poses: Trajectory) -> Trajectory:
    """Return poses of the optical frame in a world whose z points up, of those in the files' axes."""
    return poses.moved(T_NED_OPTICAL).transformed(np.diag([1.0, -1.0, -1.0]), np.zeros(3))


def _right_pose(path: Path, left: Trajectory, notes: list[str]) -> npt.NDArray[np.float64]:
    """Return the pose of the right camera in the left one, (4, 4): they are aligned, a baseline along x."""
    pose = np.eye(4)
    pose[0, 3] = BASELINE
    if not path.is_file():
        notes.append(
            f"no {path.name}: the right camera is assumed {BASELINE:g} m to the right of the left one"
        )
        return pose
    rows = read_table(path, 7, "tx ty tz qx qy qz qw").values
    if len(rows) != len(left):
        raise DataError(f"{path}: {len(rows)} poses, but {len(left)} of the left camera")
    right = _optical(trajectory(path, np.arange(len(rows)), rows[:, :3], rows[:, 3:]))
    offsets = np.einsum("nji,nj->ni", left.matrices, right.positions - left.positions)
    pose[:3, 3] = np.median(offsets, axis=0).round(9) + 0.0
    if pose[0, 3] <= 0 or np.abs(offsets - pose[:3, 3]).max() > 0.01:
        raise DataError(f"{path}: the right camera isn't at one place to the right of the left one")
    return pose


def _depth(
    stamps: npt.NDArray[np.int64], files: list[Path], version: TartanAirVersion, source: str
) -> SensorStream:
    load = _read_npy if version.depth == ".npy" else _read_packed
    frame = f"depth_{version.left}"
    return view_stream("depth", stamps, files, version.lens, frame=frame, source=source, depth=(1.0, load))


def _read_npy(path: Path) -> npt.NDArray[Any]:
    """Return depth in m, float32, shape (height, width), of a file of numpy."""
    try:
        depth = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise DataError(f"{path}: can't be read as numpy's .npy ({error})") from None
    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise DataError(
            f"{path}: {depth.dtype.name} of shape {depth.shape}; depth must be floats by row and column"
        )
    metres: npt.NDArray[Any] = depth.astype(np.float32)
    return metres


def _read_packed(path: Path) -> npt.NDArray[Any]:
    """Return depth in m, float32, shape (height, width), whose four bytes are the channels of a PNG."""
    pixels = read_pixels(path)
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] != 4:
        raise DataError(f"{path}: depth must be a PNG of four channels of 8 bits, the bytes of float32")
    depth: npt.NDArray[Any] = np.ascontiguousarray(pixels).view("<f4")[:, :, 0]
    return depth
