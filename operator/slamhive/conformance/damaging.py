# SPDX-License-Identifier: Apache-2.0
"""Recordings that lack something: the topic of one sensor, or every message."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from slamhive.contract.posefiles import FRAMES
from slamhive.data.recordings.reading import TF_TYPES, Recording
from slamhive.data.recordings.writing import RecordingWriter
from slamhive.model.formats import FILE_NAMES, RecordingFormat

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.making.preparation import Variant
    from slamhive.model.sensors import Role


@dataclass(frozen=True)
class Damage:
    """Damage to a copy of a recording, for a check: one sensor's topic is left out, or every message.

    Attributes:
        missing: the sensor whose topic isn't there; None: all are there, without a message.
    """

    missing: Role | None = None

    @property
    def name(self) -> str:
        """Return a name for its folder."""
        return f"without-{self.missing}" if self.missing else "empty"


def damaged(variant: Variant, damage: Damage, folder: Path) -> Variant:
    """Return a copy of a prepared recording that lacks something; its description stays as it was.

    Args:
        variant: the recording.
        damage: what it shall lack.
        folder: where the copy is made.
    """
    place = folder / variant.key[:16] / damage.name
    place.mkdir(parents=True)
    path = place / FILE_NAMES[variant.format]
    form = RecordingFormat(variant.format)
    view = variant.sensors[damage.missing] if damage.missing else None
    with Recording([variant.path], form) as source, RecordingWriter(source, path, form) as to:
        kept = [one for one in source.connections if view is None or one.topic != view.topic]
        for connection in kept:
            to.announce(connection)
        wanted = {one.topic for one in kept if view is not None or one.msgtype in TF_TYPES}
        for connection, time, raw in source.messages(wanted):
            to.write(connection, time, raw)
    # The stamps of frames are told as before: what is wrong is the recording alone.
    (place / FRAMES).write_bytes((variant.folder / FRAMES).read_bytes())
    return replace(variant, path=path)
