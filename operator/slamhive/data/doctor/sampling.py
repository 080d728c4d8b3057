# SPDX-License-Identifier: Apache-2.0
"""Sample of a recording: the first messages of each sensor, and some of moments all over it.

It takes seconds whatever the recording's size, and shows what is wrong with all messages or with the first.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from slamhive.data.doctor.findings import BY_NUMBER

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from rosbags.interfaces import Connection

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.recordings.reading import Recording
    from slamhive.model.sensors import Sensor

FIRST = 30
"""Messages from the first on: a sensor that starts badly does so for a second or two."""
_MOMENTS, _EACH = 6, 5
SAMPLED = FIRST + _MOMENTS * _EACH
"""Messages of one sensor that are looked at, at most."""
_OF_ALL = ("stamps.", "clock.offset", "clock.drift", "imu.rate", "imu.noise", "frames.rotation", "truth.")
"""Beginnings of the codes that only all messages can tell: rates, gaps, what turns by and by."""


def sampled(recording: Recording, sensors: Mapping[str, Sensor]) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield some messages of each sensor: its first, and a few from each of some moments of the recording.

    Args:
        recording: The recording.
        sensors: Those whose topics are there.

    Raises:
        DataError: The recording is damaged where it is read.
    """
    moments = [recording.start_ns + int(1e9 * recording.seconds * k / _MOMENTS) for k in range(1, _MOMENTS)]
    moments.append(recording.start_ns + int(1e9 * recording.seconds * 0.95))
    for topic in dict.fromkeys(sensor.topic for sensor in sensors.values()):
        if recording.topics[topic].count <= SAMPLED:
            yield from recording.messages({topic})
            continue
        last = recording.start_ns
        for start, count in ((None, FIRST), *((moment, _EACH) for moment in moments)):
            begin = None if start is None else max(start, last + 1)
            for message in islice(recording.messages({topic}, begin), count):
                last = message[1]
                yield message


def of_sample(found: Iterable[Finding]) -> Iterator[Finding]:
    """Yield the findings that a sample is enough for, without repairs that count messages."""
    for finding in found:
        if finding.code.startswith(_OF_ALL):
            continue
        sensors = finding.repair.get("repair", {}).get("sensors", {})
        is_counting = any(key in BY_NUMBER for repair in sensors.values() for key in repair)
        yield replace(finding, repair={}) if is_counting else finding
