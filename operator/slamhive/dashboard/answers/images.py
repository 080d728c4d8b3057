# SPDX-License-Identifier: Apache-2.0
"""``/api/v1/runs/UID/images``: what a run's cameras saw at a moment, from the recording that it was given."""

from __future__ import annotations

import base64
import importlib
import json
import os
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamhive.dashboard.answering.encoding import Body
from slamhive.dashboard.problems import Missing
from slamhive.model.algorithm import RecordingFormat
from slamhive.model.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.dashboard.sources.archived import Snapshot, Source
    from slamhive.runfiles.artifacts import ArtifactFolder

_VARIANT = re.compile(r"[0-9a-f]{32}")
_NEAR_NS = 1_000_000_000
"""Longest distance of an image from the moment."""

_MOST_CAMERAS = 2
_MOST_JSON = 2**20


@dataclass(frozen=True)
class GivenRecording:
    """The recording that a run was given.

    Attributes:
        path: of the recording.
        form: how it is stored.
    """

    path: Path
    form: RecordingFormat


def prepared(source: Source, uid: str) -> GivenRecording:
    """Return the recording that a run was given.

    Raises:
        Missing: it is not at hand.
    """
    # They take long to be imported, and more memory than a worker has: here, once somebody asks for images.
    importlib.import_module("slamhive.data.recordings.reading")
    importlib.import_module("slamhive.data.recordings.pictures")
    record = source.record(uid) if len(uid) <= 253 else None
    if record is None:
        raise Missing(f"there is no run with the UID {uid[:100]!r}", "uid")
    folder = source.variants()
    place = source.place(record) if folder is not None else None
    if folder is None or place is None:
        raise Missing("the recording is not at hand here: images are shown on the workstation that ran it")
    name = _variant_of(place)
    try:
        told = json.loads((folder / name / "variant.json").read_bytes()[:_MOST_JSON])
        path = folder / name / os.path.basename(told["recording"])  # noqa: PTH119 - no way out of the folder
        form = RecordingFormat(told["format"])
    except (OSError, ValueError, KeyError, TypeError):
        raise Missing(
            "the recording that this run was given is no longer there, or is no bag: the next run of its "
            "sweep prepares it again"
        ) from None
    if not path.exists():
        raise Missing("the recording that this run was given is no longer there")
    return GivenRecording(path, form)


def _variant_of(place: ArtifactFolder) -> str:
    """Return the name of the variant that a run's link leads to; nothing else of the link is heeded."""
    link = place.root.joinpath(*place.parts, "run", "dataset")
    try:
        name = os.path.basename(os.readlink(link))  # noqa: PTH115, PTH119 - its text alone
    except OSError:
        name = ""
    if not _VARIANT.fullmatch(name):
        raise Missing("this run does not say which recording it was given")
    return name


def images(snapshot: Snapshot, given: GivenRecording, moment: float) -> Body:
    """Return the cameras' images nearest to a moment, as JPEG.

    Args:
        snapshot: the data.
        given: the recording.
        moment: sensor time, s.

    Raises:
        Missing: the recording can't be read, or has no image there.
    """
    from slamhive.data.recordings.kinds import COMPRESSED_IMAGE, IMAGE  # noqa: PLC0415
    from slamhive.data.recordings.pictures import jpeg  # noqa: PLC0415
    from slamhive.data.recordings.reading import Recording  # noqa: PLC0415

    at = round(moment * 1e9)
    best: dict[str, tuple[int, bytes, str]] = {}
    try:
        with Recording([given.path], given.form) as recording:
            kinds = {
                name: topic.message_type
                for name, topic in recording.topics.items()
                if topic.message_type in {IMAGE, COMPRESSED_IMAGE}
            }
            chosen = sorted(kinds)[:_MOST_CAMERAS]
            readers = {name: recording.stamp_reader(kinds[name]) for name in chosen}
            for connection, time, raw in recording.messages(chosen, at - _NEAR_NS, at + _NEAR_NS):
                reader = readers[connection.topic]
                stamp = reader(raw) if reader is not None else time
                held = best.get(connection.topic)
                if held is None or abs(stamp - at) < abs(held[0] - at):
                    best[connection.topic] = (stamp, raw, kinds[connection.topic])
            found = [
                {
                    "topic": name,
                    "stamp": stamp / 1e9,
                    "data": base64.b64encode(jpeg(recording.decode(raw, kind), name)).decode("ascii"),
                }
                for name, (stamp, raw, kind) in sorted(best.items())
            ]
    except DataError as error:
        raise Missing(str(error)) from None
    if not found:
        raise Missing("the recording has no image within a second of this moment", "t")
    return Body({"revision": snapshot.revision, "t": moment, "images": found})
