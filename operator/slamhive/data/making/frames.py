# SPDX-License-Identifier: Apache-2.0
"""Frames of a prepared recording as files, for a program that makes others of them, and back.

::

    in/sensors.yaml            its sensors by role, with their calibration
    in/ROLE/stamps.txt         header stamps, ns, a line a frame
    in/ROLE/000000.png         image k of a camera; .npy: depth in m as float32, or points by their fields
    out/ROLE/000000.png        what the program makes of it
    out/sensors.yaml           calibration, where the program changes it

A role that the program leaves out stays as it was. Number and stamps of frames are ours: a program can't
change them, as it is given files and not messages.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import yaml
from pydantic import ValidationError

from slamhive.data.files.workers import Workers
from slamhive.data.recordings import kinds
from slamhive.data.recordings.clouds import cloud_dtype, cloud_points
from slamhive.data.recordings.images import compressed_anew, compressed_pixels, image_pixels, with_pixels
from slamhive.data.recordings.reading import Recording
from slamhive.data.recordings.streams import camera_info_topic
from slamhive.data.recordings.writing import RecordingWriter
from slamhive.model.base import explain
from slamhive.model.configuration import SensorView
from slamhive.model.errors import DataError
from slamhive.model.formats import RecordingFormat
from slamhive.model.sensors import ROLE_TYPES, Role, SensorType

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.data.making.preparation import Variant
    from slamhive.model.variant import GivenSensor

    Array = npt.NDArray[Any]

SENSORS, STAMPS = "sensors.yaml", "stamps.txt"
_IMAGES = frozenset({SensorType.CAMERA, SensorType.DEPTH_CAMERA})
_SHOWN = _IMAGES | {SensorType.LIDAR, SensorType.POINT_CLOUD}
_RED_FIRST = ("rgb8", "rgba8", "rgb16")
_SWAPPED = {3: [2, 1, 0], 4: [2, 1, 0, 3]}
_MOST_TOLD = 1 << 20
_MAY_CHANGE = ("camera", "T_body_sensor")


@dataclass(frozen=True)
class ShownFrames:
    """Frames of a sensor that were written as files.

    Attributes:
        view: The sensor.
        count: How many they are.
        ending: End of their files' names.
    """

    view: SensorView
    count: int
    ending: str

    def files(self) -> list[str]:
        """Return the names of their files."""
        return [frame_file(number, self.ending) for number in range(self.count)]


def frame_file(number: int, ending: str) -> str:
    """Return the name of a frame's file."""
    return f"{number:06d}{ending}"


def shown_frames(variant: Variant) -> dict[Role, ShownFrames]:
    """Return the frames of a variant, which is a bag, that are written as files.

    Raises:
        DataError: A message can't be read.
    """
    found = {}
    with Recording([variant.path], RecordingFormat(variant.format)) as recording:
        for role, view in variant.sensors.items():
            if view.type in _SHOWN:
                frame = _frame(recording.first(view.topic), f"{view.topic} in {recording.label}")
                found[role] = ShownFrames(view, recording.topics[view.topic].count, _ending(frame))
    return found


def show_frames(
    variant: Variant, shown: Mapping[Role, ShownFrames], folder: Path, progress: Callable[[float], None]
) -> None:
    """Write the frames of a variant as files.

    Args:
        variant: The variant.
        shown: What `shown_frames` says of it.
        folder: Where to; there is nothing in it.
        progress: Called with the share done, 0 to 1.

    Raises:
        DataError: A message can't be read.
        OSError: The disk refuses.
    """
    by_topic = {one.view.topic: role for role, one in shown.items()}
    told = {str(role): view.as_json() for role, view in variant.sensors.items()}
    (folder / SENSORS).write_text(yaml.safe_dump({"sensors": told}, sort_keys=False), encoding="utf-8")
    seen = dict.fromkeys(shown, 0)
    with Recording([variant.path], RecordingFormat(variant.format)) as recording, Workers() as workers:
        for topic, scan in recording.scan(list(by_topic)).items():
            own = folder / by_topic[topic]
            own.mkdir()
            (own / STAMPS).write_text("".join(f"{stamp}\n" for stamp in scan.stamps.tolist()))
        total = max(sum(recording.topics[topic].count for topic in by_topic), 1)
        for done, (connection, _, raw) in enumerate(recording.messages(set(by_topic))):
            role, where = by_topic[connection.topic], f"{connection.topic} in {recording.label}"
            number = seen[role]
            seen[role] += 1
            progress(done / total)
            frame = _frame(recording.decode(raw, connection.msgtype), where)
            if _ending(frame) != shown[role].ending:
                raise DataError(f"{where}: images change their type after {number} of them")
            workers.later(partial(_write, folder / role / frame_file(number, shown[role].ending), frame))


def take_frames(  # noqa: PLR0917 - progress comes last everywhere
    variant: Variant,
    shown: Mapping[Role, ShownFrames],
    gives: Mapping[Role, GivenSensor],
    folder: Path,
    target: Path,
    progress: Callable[[float], None],
) -> dict[Role, SensorView]:
    """Make a recording of what a program wrote, with all else as it is in the variant.

    Args:
        variant: What it was made of.
        shown: The frames that the program was given.
        gives: Sensors that it is to give.
        folder: What it wrote.
        target: The recording to make, in the variant's format.
        progress: Called with the share done, 0 to 1.

    Returns:
        The sensors of the recording.

    Raises:
        DataError: Frames are missing or too many, or can't be read; the sentence has the program as subject.
        OSError: The disk refuses.
    """
    taken = _taken(shown, gives, folder)
    sensors = _sensors(variant, gives, folder / SENSORS)
    with Recording([variant.path], RecordingFormat(variant.format)) as recording:
        roles = {view.topic: role for role, view in variant.sensors.items()}
        given = {role: gives[role].follows for role in taken if role in gives}
        infos = {
            info: sensors[role]
            for topic, role in roles.items()
            if (info := camera_info_topic(recording, topic)) is not None
            and sensors[role].camera != variant.sensors[role].camera
        }
        numbers = dict.fromkeys(roles, -1)
        total = max(sum(topic.count for topic in recording.topics.values()), 1)
        writer = RecordingWriter(recording, target, RecordingFormat(variant.format))
        with writer, Workers() as workers:

            def read() -> Iterator[tuple[Any, Callable[[], list[tuple[Any, Any]]] | None]]:
                for message in recording.messages(set(recording.topics)):
                    connection, _, raw = message
                    role = roles.get(connection.topic)
                    if role is None:
                        info = infos.get(connection.topic)
                        work = None if info is None else partial(_told, recording, connection, raw, info)
                    else:
                        numbers[connection.topic] += 1
                        number = numbers[connection.topic]
                        own = taken.get(role)
                        others = [(one, taken[one]) for one, leader in given.items() if leader is role]
                        work = partial(_made, recording, connection, raw, number, own, others, sensors)
                        work = work if own or others else None
                    yield message, work

            for done, ((connection, time, raw), made) in enumerate(workers.ahead(read())):
                progress(done / total)
                for one, data in made if made is not None else [(connection, raw)]:
                    writer.write(one, time, data)
    return sensors


def _frame(message: Any, where: str) -> Array:
    """Return the array that a file holds of a message: pixels with blue first, or points."""
    if hasattr(message, "encoding"):
        pixels = image_pixels(message, where)
        swap = message.encoding in _RED_FIRST
        return np.ascontiguousarray(pixels[..., _SWAPPED[pixels.shape[2]]]) if swap else pixels
    return compressed_pixels(message, where) if hasattr(message, "format") else cloud_points(message, where)


def _ending(frame: Array) -> str:
    return ".png" if frame.dtype in (np.uint8, np.uint16) else ".npy"


def _write(path: Path, frame: Array) -> None:
    if path.suffix == ".npy":
        with path.open("wb") as file:
            np.save(file, frame, allow_pickle=False)
    else:
        path.write_bytes(cv2.imencode(".png", frame, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())


@dataclass(frozen=True)
class _TakenFrame:
    """Files of a role that are taken, and whose message is copied for a sensor that is given."""

    folder: Path
    ending: str


def _taken(
    shown: Mapping[Role, ShownFrames], gives: Mapping[Role, GivenSensor], folder: Path
) -> dict[Role, _TakenFrame]:
    """Return the frames that a program wrote by role, each whole.

    Raises:
        DataError: Something is missing, or is there that isn't asked for.
    """
    if folder.is_symlink() or not folder.is_dir():
        raise DataError(f"left no folder {folder.name!r}")
    expected = {str(role): one for role, one in shown.items()}
    for role, given in gives.items():
        if given.follows in shown:
            expected[str(role)] = replace(shown[given.follows], ending=".png")
    entries = sorted(path.name for path in folder.iterdir())
    if others := [name for name in entries if name not in expected and name != SENSORS]:
        allowed = ", ".join([*sorted(expected), SENSORS])
        raise DataError(f"wrote {others[0]!r}, which is none of {allowed}")
    if missing := [str(role) for role in gives if str(role) in expected and str(role) not in entries]:
        raise DataError(f"wrote nothing for {missing[0]!r}, which it is to give")
    if not entries:
        raise DataError(f"wrote nothing; expected frames of {' or '.join(sorted(expected))}")
    found = {}
    for name in entries:
        if name != SENSORS:
            _check_files(folder / name, expected[name])
            found[Role(name)] = _TakenFrame(folder / name, expected[name].ending)
    return found


def _check_files(folder: Path, expected: ShownFrames) -> None:
    if folder.is_symlink() or not folder.is_dir():
        raise DataError(f"wrote {folder.name!r}, which is no folder")
    files, wanted = {path.name for path in folder.iterdir()} - {STAMPS}, expected.files()
    lacking, extra = [name for name in wanted if name not in files], sorted(files - set(wanted))
    if lacking:
        raise DataError(
            f"wrote {len(wanted) - len(lacking)} of {len(wanted)} frames of {folder.name}; the first that is "
            f"missing is {folder.name}/{lacking[0]}"
        )
    if extra:
        raise DataError(
            f"wrote {len(files)} frames of {folder.name}, expected {len(wanted)}; "
            f"{folder.name}/{extra[0]} is none of them"
        )


def _sensors(variant: Variant, gives: Mapping[Role, GivenSensor], path: Path) -> dict[Role, SensorView]:
    """Return the sensors of the recording: the variant's, with the calibration that the program says.

    Raises:
        DataError: It says something else.
    """
    found = dict(variant.sensors)
    for role, given in gives.items():
        if given.follows in found:
            found[role] = _given(role, given, found[given.follows])
    if not path.exists():
        return found
    if path.is_symlink() or not path.is_file() or path.stat().st_size > _MOST_TOLD:
        raise DataError(f"wrote {SENSORS}, which is no file of at most {_MOST_TOLD >> 20} MiB")
    try:
        told = yaml.safe_load(path.read_text(encoding="utf-8"))["sensors"]
        items = {str(name): dict(body) for name, body in told.items()}
    except (
        yaml.YAMLError,
        UnicodeDecodeError,
        TypeError,
        KeyError,
        AttributeError,
        ValueError,
        RecursionError,
    ):
        raise DataError(
            f"wrote {SENSORS} that can't be read; expected 'sensors:' with a mapping by role"
        ) from None
    for name, body in items.items():
        if name not in map(str, found):
            raise DataError(f"wrote {SENSORS} with {name!r}; its sensors are {', '.join(map(str, found))}")
        before = found[Role(name)].as_json()
        changes = {key: body[key] for key in _MAY_CHANGE if key in body}
        try:
            after = SensorView.model_validate(before | changes)
        except ValidationError as error:
            first = error.errors()[0]
            field = ".".join(map(str, first["loc"]))
            raise DataError(f"wrote {SENSORS}: sensors.{name}.{field}: {explain(first)}") from None
        sizes = [(one.camera.width, one.camera.height) for one in (found[Role(name)], after) if one.camera]
        if len(set(sizes)) > 1:
            raise DataError(f"wrote {SENSORS}: sensors.{name}.camera: images keep their size, {sizes[0]}")
        found[Role(name)] = after
    return found


def _given(role: Role, given: GivenSensor, leader: SensorView) -> SensorView:
    is_depth = ROLE_TYPES[role] is SensorType.DEPTH_CAMERA
    camera = leader.camera
    if camera is not None and is_depth:
        camera = camera.replace(encoding="16UC1", depth_scale=given.depth_scale)
    return leader.replace(name=str(role), type=ROLE_TYPES[role], topic=f"/slamhive/{role}", camera=camera)


def _told(recording: Recording, connection: Any, raw: bytes, view: SensorView) -> list[tuple[Any, Any]]:
    """Return a CameraInfo with another calibration."""
    message, camera = recording.decode(raw, connection.msgtype), view.camera
    if camera is None:
        return [(connection, raw)]
    k, p, d = ("K", "P", "D") if hasattr(message, "K") else ("k", "p", "d")
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=np.float64)
    projection = np.reshape(getattr(message, p), (3, 4)).astype(np.float64)
    projection[:, :3] = matrix
    changes = {k: matrix.reshape(-1), p: projection.reshape(-1), d: np.array(camera.coefficients, np.float64)}
    return [(connection, recording.encode(replace(message, **changes), kinds.CAMERA_INFO))]


def _made(  # noqa: PLR0917 - for threads
    recording: Recording,
    connection: Any,
    raw: bytes,
    number: int,
    own: _TakenFrame | None,
    others: list[tuple[Role, _TakenFrame]],
    sensors: Mapping[Role, SensorView],
) -> list[tuple[Any, Any]]:
    """Return the messages of a frame, each with its connection: the sensor's own, and what follows it."""
    message, kind = recording.decode(raw, connection.msgtype), connection.msgtype
    found: list[tuple[Any, Any]] = [(connection, raw)]
    if own is not None:
        found = [(connection, recording.encode(_replaced(message, _read(own, number)), kind))]
    for role, files in others:
        picture = _read(files, number)
        told = connection._replace(topic=sensors[role].topic)
        found.append((told, recording.encode(_beside(message, picture, sensors[role]), kind)))
    return found


def _read(files: _TakenFrame, number: int) -> tuple[Array, str]:
    """Return a frame that the program wrote, and what it is called."""
    path = files.folder / frame_file(number, files.ending)
    name = f"{files.folder.name}/{path.name}"
    if path.is_symlink() or not path.is_file():
        raise DataError(f"wrote {name}, which is no file")
    try:
        if files.ending == ".npy":
            with path.open("rb") as file:
                return np.lib.format.read_array(file, allow_pickle=False), name
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
        pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except (ValueError, EOFError, MemoryError, cv2.error):
        pixels = None
    if pixels is None:
        raise DataError(f"wrote {name}, which can't be read as {files.ending[1:].upper()}")
    return np.asarray(pixels), name


def _replaced(message: Any, frame: tuple[Array, str]) -> Any:
    """Return a message with what the program made of it.

    Raises:
        DataError: It has another size or type.
    """
    found, name = frame
    if hasattr(message, "point_step"):
        return _with_points(message, found, name)
    before = _frame(message, name)
    if (found.shape, found.dtype) != (before.shape, before.dtype):
        raise DataError(f"wrote {name} as {_described(found)}; it was given {_described(before)}")
    if not hasattr(message, "encoding"):
        return compressed_anew(message, found)
    if message.encoding in _RED_FIRST:
        found = found[..., _SWAPPED[found.shape[2]]]
    return with_pixels(message, np.ascontiguousarray(found))


def _with_points(message: Any, found: Array, name: str) -> Any:
    dtype = cloud_dtype(message, name)
    fields = dtype.names or ()
    if found.ndim != 1 or sorted(found.dtype.names or ()) != sorted(fields):
        has = ", ".join(found.dtype.names or ()) or f"an array of shape {found.shape}"
        raise DataError(f"wrote {name} with {has}; expected one row of points with {', '.join(fields)}")
    points = np.zeros(len(found), dtype=dtype)
    for field in fields:
        points[field] = found[field]
    return replace(
        message,
        height=1,
        width=len(points),
        row_step=len(points) * message.point_step,
        data=points.view(np.uint8).reshape(-1),
    )


def _beside(message: Any, frame: tuple[Array, str], view: SensorView) -> Any:
    """Return the message of a picture that the program gives beside a camera's.

    Raises:
        DataError: It has another size or type.
    """
    found, name = frame
    camera = view.camera
    is_depth = view.type is SensorType.DEPTH_CAMERA
    size = (camera.height, camera.width) if camera else _frame(message, name).shape[:2]
    fits = found.ndim == 2 and found.dtype == np.uint16 if is_depth else found.dtype == np.uint8
    if found.shape[:2] != size or not fits:
        wanted = f"{size[1]}×{size[0]} pixels of {'16 bits, one channel' if is_depth else '8 bits'}"
        raise DataError(f"wrote {name} as {_described(found)}; expected {wanted}")
    if not hasattr(message, "encoding"):
        encoding = "16UC1" if is_depth else "bgr8"
        return compressed_anew(replace(message, format=f"{encoding}; png compressed"), found)
    encoding = "16UC1" if is_depth else ("mono8" if found.ndim == 2 else "bgr8")
    return with_pixels(replace(message, encoding=encoding), found)


def _described(found: Array) -> str:
    if found.dtype.names:
        return f"{len(found)} points"
    channels = found.shape[2] if found.ndim == 3 else 1
    size = f"{found.shape[1]}×{found.shape[0]}" if found.ndim >= 2 else f"shape {found.shape}"
    return f"{size} pixels of {found.dtype}, {channels} channel{'' if channels == 1 else 's'}"
