# SPDX-License-Identifier: Apache-2.0
"""A run for Rerun's viewer: truth, estimate, error, images and usage on one time line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.model.errors import DataError, InputError
from slamhive.model.extras import library
from slamhive.model.formats import RecordingFormat
from slamhive.runfiles.clocks import configuration_of, sensor_times
from slamhive.runfiles.errors import FileMissingError, FileTooLargeError
from slamhive.runfiles.trajectories import drawn, extrinsic_of, read_poses, usage_columns

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.bridges.places import Here
    from slamhive.model.results import RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder

MOST_POSES = 20_000
"""Poses and samples of usage that are shown."""
MOST_IMAGES = 600
_WIDE = 640
_LINE = "sensor time"
_SINCE = "since start"
_TRUTH, _ESTIMATE = (120, 120, 120), (230, 120, 20)
_CAMERAS = ("left", "camera", "color")


def view(record: RunRecord, here: Here, save: Path | None) -> list[str]:
    """Show a run in Rerun's viewer, or write what it shows into a file.

    Args:
        record: the run.
        here: where its files are.
        save: a file for ``rerun FILE.rrd``; None opens the viewer.

    Returns:
        Sentences on what is missing.

    Raises:
        InputError: the library isn't installed, or nothing of the run is here.
    """
    rr = library("rerun", "rerun", "slamhive view")
    place = here.place(record)
    if place is None:
        raise InputError(f"run {record.name}: its files are not here, so there is nothing to show")
    stream = rr.RecordingStream("slamhive", recording_id=record.uid)
    if save is None:
        stream.spawn()
    else:
        stream.save(str(save))
    stream.send_recording_name(record.name)
    shown = _RerunRecorder(rr, stream)
    notes = _fill(shown, record, here, place)
    shown.document(record)
    stream.flush()
    stream.disconnect()
    return notes


def _fill(shown: _RerunRecorder, record: RunRecord, here: Here, place: ArtifactFolder) -> list[str]:
    """Show what is there of a run; return sentences on what is missing."""
    notes: list[str] = []
    configuration = configuration_of(place)
    truth = here.truth(record)
    result = record.results[0] if record.results else None
    try:
        extrinsic = extrinsic_of(record, configuration, here.algorithms(), truth)
        found = drawn(read_poses(place), result, truth, extrinsic, MOST_POSES)
        shown.paths(found)
        notes += found["notes"]
    except (FileMissingError, FileTooLargeError) as error:
        notes.append(str(error))
    try:
        usage = usage_columns(place, MOST_POSES)
        shown.usage(usage, sensor_times(usage["t"], record, place, configuration))
    except (FileMissingError, FileTooLargeError) as error:
        notes.append(str(error))
    try:
        shown.images(_images(place, configuration))
    except DataError as error:
        notes.append(f"no images: {error}")
    return notes


class _RerunRecorder:
    """Puts what is found of a run into a recording of Rerun's."""

    def __init__(self, rr: Any, stream: Any) -> None:
        self._rr = rr
        self._stream = stream

    def paths(self, found: dict[str, Any]) -> None:
        """Show paths as lines, and the estimate's poses and errors over time."""
        rr, stream = self._rr, self._stream
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for name, key, colour in (("truth", "reference", _TRUTH), ("estimate", "estimate", _ESTIMATE)):
            columns = found[key]
            if columns is None:
                continue
            points = np.stack([columns[axis] for axis in "xyz"], axis=1)
            stream.log(f"world/{name}", rr.LineStrips3D([points], colors=[colour]), static=True)
            stream.send_columns(
                f"world/{name}/pose",
                indexes=[self._times(columns["t"])],
                columns=rr.Points3D.columns(positions=points),
            )
            look = rr.Points3D.from_fields(colors=[colour], radii=[0.05])
            stream.log(f"world/{name}/pose", look, static=True)
        known = ~np.isnan(found["estimate"]["error"])
        if known.any():
            self._series("error_metres", found["estimate"]["t"][known], found["estimate"]["error"][known])

    def usage(self, usage: dict[str, Any], stamps: npt.NDArray[np.float64] | None) -> None:
        """Show load and memory: by sensor time where that is known, else since the program's start."""
        times, line = (usage["t"], _SINCE) if stamps is None else (stamps, _LINE)
        self._series("usage/cpu_cores", times, usage["cpu"], line)
        self._series("usage/memory_mebibytes", times, usage["memory"] / 2**20, line)

    def images(self, images: Iterator[tuple[float, npt.NDArray[np.uint8]]]) -> None:
        """Show pictures, grey ones or blue, green and red."""
        for stamp, image in images:
            self._stream.set_time(_LINE, timestamp=stamp)
            model = "L" if image.ndim == 2 else "BGR"
            self._stream.log("camera", self._rr.Image(image, color_model=model).compress(jpeg_quality=80))

    def document(self, record: RunRecord) -> None:
        """Show what the run was."""
        spec = record.spec
        rows = [
            ("sweep", record.sweep),
            ("dataset", (spec.get("datasetRef") or {}).get("name")),
            ("algorithm", (spec.get("algorithmRef") or {}).get("name")),
            ("sensors", spec.get("sensors")),
            *(spec.get("parameters") or {}).items(),
            ("repetition", spec.get("repetition")),
            ("uid", record.uid),
        ]
        for result in record.results:
            ate = result.values.get("ate") or {}
            rows.append((f"ATE, {result.evaluation} [m]", ate.get("rmse")))
        text = "\n".join(f"| {name} | {value} |" for name, value in rows)
        table = f"| {record.name} | |\n|---|---|\n{text}"
        document = self._rr.TextDocument(table, media_type="text/markdown")
        self._stream.log("run", document, static=True)

    def _series(self, name: str, times: Any, values: Any, line: str = _LINE) -> None:
        self._stream.send_columns(
            name, indexes=[self._times(times, line)], columns=self._rr.Scalars.columns(scalars=values)
        )

    def _times(self, times: Any, line: str = _LINE) -> Any:
        if line == _LINE:
            return self._rr.TimeColumn(line, timestamp=np.asarray(times, dtype=np.float64))
        return self._rr.TimeColumn(line, duration=np.asarray(times, dtype=np.float64))


def _images(
    place: ArtifactFolder, configuration: dict[str, Any]
) -> Iterator[tuple[float, npt.NDArray[np.uint8]]]:
    """Yield times and small pictures of the first camera of a run's prepared recording, a few of many.

    Raises:
        DataError: there are none, or they can't be read.
    """
    import cv2  # noqa: PLC0415 - readers of recordings take a second to import

    from slamhive.data.recordings.images import compressed_pixels, image_pixels  # noqa: PLC0415
    from slamhive.data.recordings.reading import Recording  # noqa: PLC0415

    sensors = configuration.get("sensors") or {}
    topics = [str(sensors[role]["topic"]) for role in _CAMERAS if role in sensors]
    if not topics:
        raise DataError("the run was given no camera")
    given = (configuration.get("dataset") or {}).get("recording") or {}
    form = str(given.get("format"))
    if form not in set(RecordingFormat):
        raise DataError(f"its recording was a folder in the layout of {form}, and only bags are shown")
    # What a run was told may have been written by the run: only what was prepared for it is opened.
    folder = place.root.joinpath(*place.parts, "run", "dataset").resolve()
    path = folder / str(given.get("path")).rpartition("/")[2]
    if not folder.is_relative_to((place.root.parent / "variants").resolve()) or not path.exists():
        raise DataError("its prepared recording is gone (slamhive run makes it again)")
    with Recording([path], RecordingFormat(form)) as recording:
        if topics[0] not in recording.topics:
            raise DataError(f"no topic {topics[0]!r} in {path.name}")
        every = -(-recording.topics[topics[0]].count // MOST_IMAGES) or 1
        for number, (connection, _, raw) in enumerate(recording.messages(topics[:1])):
            if number % every:
                continue
            message = recording.decode(raw, connection.msgtype)
            read = compressed_pixels if hasattr(message, "format") else image_pixels
            pixels = read(message, topics[0])
            if pixels.dtype != np.uint8:
                raise DataError(f"{topics[0]}: pictures of {pixels.dtype} are not shown")
            scale = min(1.0, _WIDE / pixels.shape[1])
            small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            colour = getattr(message, "encoding", "bgr8")
            if small.ndim == 3 and not str(colour).startswith(("bgr", "bayer")):
                small = small[:, :, 2::-1]
            stamp = message.header.stamp
            yield stamp.sec + stamp.nanosec * 1e-9, np.ascontiguousarray(small)
