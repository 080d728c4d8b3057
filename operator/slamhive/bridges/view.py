# SPDX-License-Identifier: Apache-2.0
"""A run for Rerun's viewer: truth, estimate, error, images and usage on one time line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.bridges.rerun import APPLICATION, LINE, RerunRecorder, layer_of
from slamhive.model.errors import DataError, InputError
from slamhive.model.extras import library
from slamhive.model.formats import RecordingFormat
from slamhive.runfiles.clocks import configuration_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy.typing as npt

    from slamhive.bridges.places import Here
    from slamhive.model.results import RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder

MOST_IMAGES = 600
_WIDE = 640
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
    stream = rr.RecordingStream(APPLICATION, recording_id=record.uid)
    if save is None:
        stream.spawn()
    else:
        stream.save(str(save))
    stream.send_recording_name(record.name)
    notes = _fill(rr, stream, record, here, place)
    stream.flush()
    stream.disconnect()
    return notes


def _fill(rr: Any, stream: Any, record: RunRecord, here: Here, place: ArtifactFolder) -> list[str]:
    """Show what is there of a run; return sentences on what is missing."""
    shown = RerunRecorder(rr, stream)
    layer = layer_of(record, here, place, record.results[0] if record.results else None)
    notes = layer.notes
    if layer.reference is not None:
        shown.truth(layer.reference)
    shown.layer(layer)
    try:
        for stamp, image in _images(place, configuration_of(place)):
            stream.set_time(LINE, timestamp=stamp)
            model = "L" if image.ndim == 2 else "BGR"
            stream.log("camera", rr.Image(image, color_model=model).compress(jpeg_quality=80))
    except DataError as error:
        notes.append(f"no images: {error}")
    shown.document(record, notes)
    return notes


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
