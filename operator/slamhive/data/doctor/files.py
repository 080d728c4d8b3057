# SPDX-License-Identifier: Apache-2.0
"""Files of a recording: what was noticed when they were opened, and messages stated against messages read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.doctor.findings import Finding, Severity
from slamhive.data.recordings.posetopics import static_poses

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from slamhive.data.doctor.examined import Examined
    from slamhive.data.recordings.reading import Recording

_GRAVE = {"files.count"}
"""Codes of notices that are warnings, as messages are lost. With the others all is read as it should be, or
it can't be told whether more belongs to the recording."""
_SAME_METRES, _SAME_RADIANS = 1e-6, 1e-6
"""Differences of one transform that are rounding: calibrations are published with 6 digits or more."""


def judge_files(examined: Examined) -> Iterable[Finding]:
    """Yield oddities of the files, and topics of which fewer or more messages were read than stated."""
    recording = examined.recording
    for notice in recording.notices:
        severity = Severity.WARNING if notice.code in _GRAVE else Severity.NOTE
        yield Finding(notice.code, severity, f"recording.files: {notice.text}", count=notice.number)
    if examined.is_sample or any(notice.code == "files.overlap" for notice in recording.notices):
        return  # What is in two files is stated twice.
    for topic, scan in examined.watched.scans.items():
        stated, found = recording.topics[topic].count, len(scan.times)
        if stated != found:
            yield Finding(
                "files.count",
                Severity.WARNING,
                f"recording.files: the index states {stated} messages of {topic}, {found} were read: a run "
                "gets no more than those; copy the recording again",
                count=abs(stated - found),
                value=float(found),
                unit="messages",
            )


def judge_static_transforms(examined: Examined) -> Iterable[Finding]:
    """Yield each frame of which /tf_static states different poses."""
    return static_contradictions(examined.recording)


def static_contradictions(recording: Recording) -> Iterator[Finding]:
    """Yield each frame of which /tf_static states different poses, with two of them."""
    for (parent, child), (first, *others) in static_poses(recording).items():
        for other in others:
            apart = float(np.linalg.norm(np.subtract(first[:3], other[:3])))
            lengths = np.linalg.norm(first[3:]) * np.linalg.norm(other[3:])
            turn = 2 * float(np.arccos(min(1.0, abs(np.dot(first[3:], other[3:])) / (lengths or 1.0))))
            if apart <= _SAME_METRES and turn <= _SAME_RADIANS:
                continue
            both = " and ".join(f"({', '.join(f'{value:.6g}' for value in one)})" for one in (first, other))
            yield Finding(
                "frames.contradiction",
                Severity.WARNING,
                f"/tf_static: {child} in {parent} has several poses, {both} (x, y, z, quaternion x to w), "
                f"{apart:.3g} m and {np.degrees(turn):.3g}° apart; dataset add takes the last one, and a "
                "wrong one bends what joins two sensors: check T_body_sensor of the sensors in this frame",
                value=apart,
                unit="m",
            )
            break
