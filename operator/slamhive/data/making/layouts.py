# SPDX-License-Identifier: Apache-2.0
"""Layouts of folders: where frames lie in each form, and the lists and calibration beside them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import ExitStack
from typing import TYPE_CHECKING, Self

import numpy as np

from slamhive.data.recordings.rectifying import baseline
from slamhive.model.formats import DataFormat, folder_files
from slamhive.model.sensors import Role
from slamhive.templating.numbers import number

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path
    from typing import TextIO

    import numpy.typing as npt

    from slamhive.model.configuration import SensorView
    from slamhive.model.sensors import Camera

    Stamps = npt.NDArray[np.int64]
    Vector = tuple[float, float, float]

DEPTH_FACTOR = 5000.0
"""Units per metre of depth that was recorded in floating point: that of the TUM benchmark."""

_DISTORTIONS = {"RadialTangential": "radial-tangential", "Equidistant": "equidistant", "None": "none"}
_MODELS = {"Pinhole": "pinhole", "Mei": "omni"}
_LENS_NUMBERS = 4


class Layout(ABC):
    """A form of folders.

    Args:
        root: The folder.
        name: Of the dataset, for remarks.
        stamps: Sensor times of each role's messages, ns, shape (n,).
        primary: Role whose frames are counted.
    """

    form: DataFormat

    def __init__(self, root: Path, name: str, stamps: Mapping[Role, Stamps], primary: Role) -> None:
        self.root = root
        self.name = name
        self.stamps = stamps
        self.primary = primary
        self._files: dict[str, TextIO] = {}
        self._open = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    @abstractmethod
    def place(self, role: Role, index: int, *, color: bool = False) -> Path:
        """Return the file of a frame."""

    def sample(self, stamp: int, rate: Vector, force: Vector) -> None:  # noqa: B027 - not every form has an IMU
        """Write what the IMU measured at a time (ns): rad/s, m/s²."""

    @abstractmethod
    def finish(self, views: Mapping[Role, SensorView]) -> None:
        """Write lists and calibration; views are the sensors as they are in the folder."""

    def listed(self, path: str, head: str) -> TextIO:
        """Return a file that stays open, begun with some lines."""
        if path not in self._files:
            place = self.root / path
            place.parent.mkdir(parents=True, exist_ok=True)
            file = self._open.enter_context(place.open("w", encoding="utf-8", newline="\n"))
            file.write(head)
            self._files[path] = file
        return self._files[path]

    def text(self, path: str, lines: Iterable[str]) -> None:
        """Write a file of lines."""
        with (self.root / path).open("w", encoding="utf-8", newline="\n") as file:
            file.writelines(f"{line}\n" for line in lines)


class Euroc(Layout):
    """ASL folder of the EuRoC MAV dataset.

    Images are named by the ns of their frame, that is of the first camera: programs look for those of the
    second one by the same name. The times of each camera stand in its data.csv.
    """

    form = DataFormat.EUROC

    def __enter__(self) -> Self:
        places = folder_files(self.form, dict.fromkeys(self.stamps))
        self._places = {role: places[role] for role in self.stamps}
        self._names = self.stamps[self.primary].tolist()
        for role, place in self._places.items():
            (self.root / place if role is Role.IMU else self.root / place / "data").mkdir(parents=True)
        return self

    def place(self, role: Role, index: int, *, color: bool = False) -> Path:  # noqa: ARG002
        """Return the file of a frame."""
        return self.root / self._places[role] / "data" / f"{self._names[index]}.png"

    def sample(self, stamp: int, rate: Vector, force: Vector) -> None:
        """Write what the IMU measured."""
        head = ",".join(
            ["#timestamp [ns]", *(f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz")]
            + [f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"]
        )
        file = self.listed(f"{self._places[Role.IMU]}/data.csv", f"{head}\n")
        file.write(f"{stamp},{','.join(map(_number, (*rate, *force)))}\n")

    def finish(self, views: Mapping[Role, SensorView]) -> None:
        """Write lists and calibration."""
        self.text("times.txt", map(str, self._names))
        for role, place in self._places.items():
            view = views[role]
            if role is not Role.IMU:
                rows = zip(self.stamps[role].tolist(), self._names, strict=True)
                lines = (f"{stamp},{name}.png" for stamp, name in rows)
                self.text(f"{place}/data.csv", ["#timestamp [ns],filename", *lines])
            self.text(f"{place}/sensor.yaml", _sensor_yaml(self.name, view))


class Tum(Layout):
    """Folder of the TUM RGB-D benchmark.

    Programs skip the three lines on top of a list, and expect none in associations.txt.
    """

    form = DataFormat.TUM

    def __enter__(self) -> Self:
        self._places = {role: "depth" if role is Role.DEPTH else "rgb" for role in self.stamps}
        self._places.pop(Role.IMU, None)
        for place in self._places.values():
            (self.root / place).mkdir()
        return self

    def place(self, role: Role, index: int, *, color: bool = False) -> Path:  # noqa: ARG002
        """Return the file of a frame."""
        return self.root / self._path(role, int(self.stamps[role][index]))

    def sample(self, stamp: int, rate: Vector, force: Vector) -> None:
        """Write what the IMU measured."""
        about = f"# file: '{self.name}'\n"
        accelerometer = f"# accelerometer data\n{about}# timestamp ax ay az\n"
        gyroscope = f"# gyroscope data\n{about}# timestamp wx wy wz\n"
        for path, head, values in (
            ("accelerometer.txt", accelerometer, force),
            ("gyroscope.txt", gyroscope, rate),
        ):
            self.listed(path, head).write(f"{_seconds(stamp)} {' '.join(map(_number, values))}\n")

    def finish(self, views: Mapping[Role, SensorView]) -> None:
        """Write lists and calibration."""
        heads = {"rgb": "# color images", "depth": "# depth maps"}
        rows = {
            role: [f"{_seconds(stamp)} {self._path(role, stamp)}" for stamp in self.stamps[role].tolist()]
            for role in self._places
        }
        for role, place in self._places.items():
            camera = views[role].camera
            factor = camera.depth_scale if role is Role.DEPTH and camera else None
            unit = f", 16-bit PNG, {_number(factor)} per metre, 0 is unknown" if factor else ""
            head = [heads[place], f"# file: '{self.name}'{unit}", "# timestamp filename"]
            self.text(f"{place}.txt", [*head, *rows[role]])
        if Role.DEPTH in rows:
            first = next(role for role in rows if role is not Role.DEPTH)
            pairs = zip(rows[first], rows[Role.DEPTH], strict=True)
            self.text("associations.txt", (f"{one} {other}" for one, other in pairs))

    def _path(self, role: Role, stamp: int) -> str:
        return f"{self._places[role]}/{_seconds(stamp)}.png"


class Kitti(Layout):
    """Folder of a sequence of KITTI odometry: rectified images, in image_2 and image_3 those with colours."""

    form = DataFormat.KITTI

    def place(self, role: Role, index: int, *, color: bool = False) -> Path:
        """Return the file of a frame."""
        place = self.root / folder_files(self.form, {role: "bgr8" if color else None})[role]
        if index == 0:
            place.mkdir()
        return place / f"{index:06}.{'bin' if role is Role.LIDAR else 'png'}"

    def finish(self, views: Mapping[Role, SensorView]) -> None:
        """Write lists and calibration."""
        times = self.stamps[self.primary]
        self.text("times.txt", (_seconds(int(stamp - times[0])) for stamp in times))
        self.text("calib.txt", _calibration(views))


def _calibration(views: Mapping[Role, SensorView]) -> Iterable[str]:
    """Yield P0 to P3 and Tr, matrices (3, 4) by rows.

    A row for a camera that isn't there is that of the one at its side; without cameras they are [I | 0], and
    Tr the identity.
    """
    first = next((role for role in views if role not in {Role.RIGHT, Role.LIDAR}), None)
    camera = views[first].camera if first else None
    left, right, to_first = np.eye(3, 4), np.eye(3, 4), np.eye(4)
    if first is not None and camera is not None:
        left[:2, :3] = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy]]
        right = left.copy()
        if Role.RIGHT in views:
            right[0, 3] = -camera.fx * baseline(views, first)
        if Role.LIDAR in views:
            to_first = np.linalg.inv(views[first].T_body_sensor) @ np.array(views[Role.LIDAR].T_body_sensor)
    rows = {"P0": left, "P1": right, "P2": left, "P3": right, "Tr": to_first[:3]}
    for name, matrix in rows.items():
        yield f"{name}: {' '.join(f'{number:.17e}' for number in matrix.reshape(-1))}"


def _sensor_yaml(name: str, view: SensorView) -> Iterable[str]:
    """Yield the lines of an ASL sensor.yaml."""
    pose = [number for row in view.T_body_sensor for number in row]
    yield f"sensor_type: {'imu' if view.camera is None else 'camera'}"
    yield f"comment: {view.name} of {name}"
    yield "T_BS:"
    yield from ("  cols: 4", "  rows: 4", f"  data: {_numbers(pose)}")
    if view.rate is not None:
        yield f"rate_hz: {_number(view.rate)}"
    if view.camera is not None:
        yield from _lens(view.camera)
    if view.imu is not None:
        yield f"gyroscope_noise_density: {_number(view.imu.gyroscope_noise)}"
        yield f"gyroscope_random_walk: {_number(view.imu.gyroscope_random_walk)}"
        yield f"accelerometer_noise_density: {_number(view.imu.accelerometer_noise)}"
        yield f"accelerometer_random_walk: {_number(view.imu.accelerometer_random_walk)}"


def _lens(camera: Camera) -> Iterable[str]:
    coefficients = [] if camera.distortion == "None" else list(camera.coefficients)
    coefficients += [0.0] * (_LENS_NUMBERS - len(coefficients))
    # EuRoC has four; more are written where they say something.
    while len(coefficients) > _LENS_NUMBERS and coefficients[-1] == 0:
        coefficients.pop()
    mirror = [camera.xi or 0.0] if camera.model == "Mei" else []
    yield f"resolution: [{camera.width}, {camera.height}]"
    yield f"camera_model: {_MODELS[camera.model]}"
    yield f"intrinsics: {_numbers([*mirror, camera.fx, camera.fy, camera.cx, camera.cy])}"
    yield f"distortion_model: {_DISTORTIONS[camera.distortion]}"
    yield f"distortion_coefficients: {_numbers(coefficients)}"


def _numbers(values: Iterable[float]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _number(value: float) -> str:
    return number(float(value))


def _seconds(nanoseconds: int) -> str:
    whole, rest = divmod(nanoseconds, 10**9)
    return f"{whole}.{rest:09}"


LAYOUTS: dict[DataFormat, Callable[[Path, str, Mapping[Role, Stamps], Role], Layout]] = {
    DataFormat.EUROC: Euroc,
    DataFormat.TUM: Tum,
    DataFormat.KITTI: Kitti,
}
