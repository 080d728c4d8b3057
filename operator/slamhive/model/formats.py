# SPDX-License-Identifier: Apache-2.0
"""Forms of data: bags, which datasets are recorded in, and the folders that programs of the field read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.model.base import Choice
from slamhive.model.sensors import ROLES, Role

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence


class RecordingFormat(Choice):
    """Bag formats in which a recording is stored."""

    ROSBAG1 = "Rosbag1"
    ROSBAG2 = "Rosbag2"
    MCAP = "Mcap"


class DataFormat(Choice):
    """The form in which an algorithm is given its data: a bag, or a folder of files."""

    ROSBAG1 = "Rosbag1"
    ROSBAG2 = "Rosbag2"
    MCAP = "Mcap"
    EUROC = "Euroc"
    TUM = "Tum"
    KITTI = "Kitti"

    @property
    def is_folder(self) -> bool:
        """Tell whether it is a folder of files, not a bag."""
        return self in HELD


FILE_NAMES = {
    DataFormat.ROSBAG1: "recording.bag",
    DataFormat.ROSBAG2: "recording",
    DataFormat.MCAP: "recording.mcap",
    DataFormat.EUROC: "recording",
    DataFormat.TUM: "recording",
    DataFormat.KITTI: "recording",
}
"""Names of recordings: Rosbag1 and Mcap are files, the others are folders."""

FIRST_CAMERAS = (Role.CAMERA, Role.LEFT, Role.COLOR)
"""Roles of which a folder has one, as its first camera."""

HELD: dict[DataFormat, tuple[Role, ...]] = {
    DataFormat.EUROC: (*FIRST_CAMERAS, Role.RIGHT, Role.IMU),
    DataFormat.TUM: (Role.CAMERA, Role.COLOR, Role.DEPTH, Role.IMU),
    DataFormat.KITTI: (*FIRST_CAMERAS, Role.RIGHT, Role.LIDAR),
}
"""Roles that a folder of each form has a place for."""

_EUROC_FILES = {**dict.fromkeys(FIRST_CAMERAS, "mav0/cam0"), Role.RIGHT: "mav0/cam1", Role.IMU: "mav0/imu0"}
_TUM_FILES = {
    **dict.fromkeys(FIRST_CAMERAS, "rgb.txt"),
    Role.DEPTH: "depth.txt",
    Role.IMU: "accelerometer.txt",
}
_KITTI_FILES = {**dict.fromkeys(FIRST_CAMERAS, "image_0"), Role.RIGHT: "image_1", Role.LIDAR: "velodyne"}
_KITTI_COLOR = {"image_0": "image_2", "image_1": "image_3"}


def holds(form: DataFormat, roles: Collection[Role]) -> bool:
    """Tell whether data in a form can hold the sensors of some roles; a bag holds any."""
    if not form.is_folder:
        return True
    first = [role for role in roles if role in FIRST_CAMERAS]
    others = [role for role in roles if role in {Role.RIGHT, Role.DEPTH}]
    frames = bool(first) or (Role.LIDAR in roles and not others)
    return frames and len(first) <= 1 and all(role in HELD[form] for role in roles)


def fitting_formats(formats: Iterable[DataFormat], roles: Collection[Role]) -> list[DataFormat]:
    """Return the forms that can hold the sensors of some roles, in the same order."""
    return [form for form in formats if holds(form, roles)]


def misfit(formats: Sequence[DataFormat], roles: Collection[Role], what: str) -> str:
    """Say that none of some forms can hold the sensors of some roles, and what they can.

    Args:
        formats: the forms.
        roles: the roles.
        what: what needs them, such as ``the mode lidar``.
    """
    allowed = [
        f"{form} holds {', '.join(mode for mode, needed in ROLES.items() if holds(form, needed))}"
        for form in formats
    ]
    needed = ", ".join(str(role) for role in roles)
    return f"{' and '.join(formats)} can't hold {what} (sensors {needed}); {'; '.join(allowed)}"


def folder_files(form: DataFormat, encodings: Mapping[Role, str | None]) -> dict[str, str]:
    """Return the paths of each sensor's data in a folder, and of all else that it has.

    Args:
        form: the form of the folder.
        encodings: of the images of each role's sensor, None of one that has none.

    Returns:
        Paths below the folder, by role or by what they are.
    """
    match form:
        case DataFormat.EUROC:
            return {role: _EUROC_FILES[role] for role in encodings} | {"times": "times.txt"}
        case DataFormat.TUM:
            found = {str(role): _TUM_FILES[role] for role in encodings}
            if Role.DEPTH in encodings:
                found["associations"] = "associations.txt"
            if Role.IMU in encodings:
                found["gyroscope"] = "gyroscope.txt"
            return found
        case DataFormat.KITTI:
            found = {}
            for role, encoding in encodings.items():
                place = _KITTI_FILES[role]
                found[str(role)] = _KITTI_COLOR.get(place, place) if is_color(encoding) else place
            return found | {"times": "times.txt", "calibration": "calib.txt"}
        case _:
            return {}


def is_color(encoding: str | None) -> bool:
    """Tell whether images of an encoding have colours."""
    return encoding is not None and encoding.startswith(("rgb", "bgr", "8UC3", "8UC4"))
