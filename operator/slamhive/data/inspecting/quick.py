# SPDX-License-Identifier: Apache-2.0
"""Quick look into a dataset, of a sample of its messages: before it is known, and before a run.

`slamhive dataset check --quick` and `slamhive dataset add` print it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.data.doctor.examining import examine
from slamhive.data.doctor.findings import Severity
from slamhive.data.doctor.sampling import FIRST
from slamhive.data.inspecting.inspection import DatasetReport, SensorReport, read_truth, told_entry
from slamhive.data.recordings.checks import check_content, content_findings
from slamhive.data.recordings.entries import DatasetEntry, check_sums
from slamhive.data.recordings.posetopics import check_pose_topic
from slamhive.data.recordings.repairing import open_recording
from slamhive.data.recordings.streams import check_topic, sound_sensors
from slamhive.data.recordings.thinning import rate_of
from slamhive.data.store.groundtruth import require_overlap
from slamhive.model.errors import DataError
from slamhive_eval import Trajectory

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.doctor.watching import WatchedRecording
    from slamhive.data.recordings.reading import Recording, Scan
    from slamhive.data.store.groundtruth import GroundTruthPoses
    from slamhive.model.dataset import Dataset
    from slamhive.model.sensors import Sensor


def glance(entry: DatasetEntry) -> DatasetReport:
    """Look into a sample of a dataset's messages; what is wrong is collected, not raised.

    Of rates, gaps, ends and most of the ground truth it says nothing: these take all messages (`inspect`).

    Args:
        entry: The dataset, materialised.
    """
    spec = entry.dataset.spec
    errors: list[str] = []
    warnings: list[str] = []
    truth = _truth(entry)
    try:
        with open_recording(entry.dataset, entry.root) as recording:
            sound = sound_sensors(recording, spec.told_sensors, errors)
            frames = {name: sensor for name, sensor in sound.items() if sensor.type.has_frames}
            contents = content_findings(recording, frames, errors, warnings)
            watched, found = _examined(entry, recording, sound, truth[0])
            warnings += watched.broken
            sensors = [
                _report(recording, name, sensor, watched.scans[sensor.topic], contents.get(name, ""))
                for name, sensor in sound.items()
            ]
            seconds, span = recording.seconds, _rough_span(recording, sound)
    except DataError as error:
        return DatasetReport(
            entry.name, spec.recording.format, None, None, [], None, [], {}, [str(error)], []
        )
    try:
        _require_truth(entry.name, truth, span)
    except DataError as error:
        errors.append(str(error))
    found.sort(key=lambda finding: [*Severity].index(finding.severity))
    return DatasetReport(
        name=entry.name,
        format=spec.recording.format,
        start=span[0] if span else None,
        duration_seconds=seconds,
        sensors=sensors,
        ground_truth=None,
        other_topics=[],
        other_types={},
        errors=errors + [one.message for one in found if one.severity is Severity.ERROR],
        warnings=warnings + [one.message for one in found if one.severity is Severity.WARNING],
        findings=found,
        sampled=sum(len(scan.stamps) for scan in watched.scans.values()),
    )


def quick_findings(entry: DatasetEntry) -> list[Finding]:
    """Return the findings of a sample of a dataset's messages.

    Raises:
        DataError: The recording can't be read.
    """
    with open_recording(entry.dataset, entry.root) as recording:
        sound = sound_sensors(recording, entry.dataset.spec.told_sensors, [])
        return _examined(entry, recording, sound, _truth(entry)[0])[1]


def require_usable(
    dataset: Dataset, root: Path, cache: Path | None = None
) -> tuple[list[Finding], list[str]]:
    """Refuse a dataset that no run could work with, before it is known.

    What takes reading all messages of the recording is left to `inspect`. Files that are still to be fetched
    are not looked at.

    Args:
        dataset: The dataset as declared.
        root: The folder that its paths start from.
        cache: Folder in which hashes of files are remembered.

    Returns:
        The findings, errors among them, and what else may be wrong, a sentence each.

    Raises:
        DataError: A file isn't what its checksum says; the recording can't be read, lacks a sensor's topic or
            isn't what is said of it; the ground truth can't be read, or is of another time.
    """
    files = dataset.spec.recording.files
    if not files or any(file.url and not (root / file.path).exists() for file in files):
        return [], []
    entry, spec = DatasetEntry(dataset, root), dataset.spec
    sensors, truth = spec.told_sensors, _truth(entry)
    found: list[Finding] = []
    with open_recording(dataset, root) as recording:
        for name, sensor in sensors.items():
            check_topic(recording, name, sensor)
        warnings = check_content(recording, sensors)
        if spec.ground_truth is not None and spec.ground_truth.topic is not None:
            check_pose_topic(recording, spec.ground_truth.topic)
        span = _rough_span(recording, sensors)
        try:
            watched, found = _examined(entry, recording, sensors, truth[0])
            warnings += watched.broken
        except DataError as error:  # damaged somewhere: a run that needs no more than what is before may work
            warnings.append(str(error))
    _require_truth(entry.name, truth, span)
    check_sums(entry, cache)
    return found, warnings


def _examined(
    entry: DatasetEntry, recording: Recording, sensors: Mapping[str, Sensor], truth: GroundTruthPoses | None
) -> tuple[WatchedRecording, list[Finding]]:
    """Return the times of a sample of messages, and what was found."""
    poses = truth.poses if truth is not None and isinstance(truth.poses, Trajectory) else None
    return examine(told_entry(entry), recording, sensors, poses, quick=True)


def _truth(entry: DatasetEntry) -> tuple[GroundTruthPoses | None, str | None]:
    """Return the ground truth where it is a file, as that of a topic takes reading it, and what hinders."""
    truth = entry.dataset.spec.ground_truth
    return (None, None) if truth is None or truth.file is None else read_truth(entry, None)


def _require_truth(
    name: str, truth: tuple[GroundTruthPoses | None, str | None], span: tuple[float, float] | None
) -> None:
    """Check that the ground truth of a dataset could be read and is of the recording's time.

    Raises:
        DataError: It can't, or isn't.
    """
    known, fault = truth
    if fault is not None:
        raise DataError(fault)
    if known is not None and span is not None:
        require_overlap(known.poses, *span, where=f"dataset {name!r}: groundTruth")


def _rough_span(recording: Recording, sensors: Mapping[str, Sensor]) -> tuple[float, float] | None:
    """Return the begin of the sensors' messages and, by the times of recording, their latest end, s."""
    begins = []
    for sensor in sensors.values():
        stamp_of = recording.stamp_reader(recording.topics[sensor.topic].message_type)
        if stamp_of is None:
            continue
        _, _, raw = next(iter(recording.messages({sensor.topic})))
        begins.append(stamp_of(raw) / 1e9 + sensor.time_offset)
    return (min(begins), max(begins) + recording.seconds) if begins else None


def _report(recording: Recording, name: str, sensor: Sensor, scan: Scan, content: str) -> SensorReport:
    topic, stamps = recording.topics[sensor.topic], scan.stamps
    rate = rate_of(np.sort(stamps[:FIRST]))
    return SensorReport(
        name=name,
        type=sensor.type,
        topic=sensor.topic,
        message_type=topic.message_type,
        messages=topic.count,
        rate=None if rate is None else round(rate, 3),
        first=float(stamps[0] / 1e9) + sensor.time_offset if len(stamps) else None,
        content=content,
    )
