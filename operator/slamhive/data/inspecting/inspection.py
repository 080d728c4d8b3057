# SPDX-License-Identifier: Apache-2.0
"""Inspection of a dataset: what its recording holds, and all its faults at once.

`slamhive dataset check` prints it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.doctor.examining import examine
from slamhive.data.doctor.findings import Severity
from slamhive.data.doctor.stamps import gaps_of
from slamhive.data.recordings.checks import content_findings, stamp_fault
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.posetopics import truth_topic
from slamhive.data.recordings.repairing import open_recording
from slamhive.data.recordings.streams import STATIC_TRANSFORMS, camera_info_topic, sound_sensors
from slamhive.data.recordings.thinning import rate_of
from slamhive.data.store.groundtruth import ground_truth, require_overlap, truth_range
from slamhive.model.dataset import modes_with
from slamhive.model.errors import DataError
from slamhive_eval import Relations, Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.recordings.reading import Recording, Scan
    from slamhive.data.store.groundtruth import GroundTruthPoses
    from slamhive.model.dataset import DatasetSpec
    from slamhive.model.sensors import Sensor

_ELSEWHERE = {"clock.epoch", "stamps.zero", "stamps.gap"}
"""Codes of errors that say of stamps that they are of another time; a gap that is one takes days."""
SMALL_SHARE = 0.9
"""Share of the recording's length below which a sensor is said to cover little of it: a run lasts as long as
its first camera, LiDAR or scanner, and an algorithm needs the others all the time."""
_SHOWN_GAPS = 20
_RATE_TOLERANCE = 0.05


@dataclass(frozen=True)
class MessageGap:
    """A span without messages.

    Attributes:
        start: Sensor time of the message before it, s.
        seconds: Its length.
    """

    start: float
    seconds: float


@dataclass(frozen=True)
class SensorReport:
    """Report on a sensor's messages in a recording: type, number, rate, span of time and gaps.

    Attributes:
        name: The sensor's name.
        type: Kind of device.
        topic: Its topic.
        message_type: Type of the messages; None when the topic is missing.
        messages: Their number.
        rate: Mean rate without gaps, Hz.
        first: Sensor time of the first message, s.
        last: Sensor time of the last message, s.
        gaps: Spans of more than three periods without messages, longest first; the longest 20.
        gap_count: Number of all such spans.
        gap_threshold: What a span is longer than to be one of them, s; None where the rate isn't known.
        covered: Share of the recording's length between its first message and its last.
        size_bytes: Size of the messages.
        content: What the first message is like, in words.
    """

    name: str
    type: str
    topic: str
    message_type: str | None = None
    messages: int = 0
    rate: float | None = None
    first: float | None = None
    last: float | None = None
    gaps: list[MessageGap] = field(default_factory=list)
    gap_count: int = 0
    gap_threshold: float | None = None
    covered: float = 0.0
    size_bytes: int = 0
    content: str = ""


@dataclass(frozen=True)
class TruthReport:
    """Report on a dataset's ground truth: kind, span of time, overlap with the recording, gaps.

    Attributes:
        kind: ``trajectory``, ``positions``, ``points`` or ``relations``.
        count: Number of poses, positions, control points or relations.
        first: First time, s.
        last: Last time, s.
        overlap_seconds: How much of the recording lies between them, s.
        path_metres: Length of the path; None for relations.
        longest_gap: Longest span between poses, s; None for relations.
        usual_gap: Median span between poses, s; None for relations.
    """

    kind: str
    count: int
    first: float
    last: float
    overlap_seconds: float
    path_metres: float | None
    longest_gap: float | None
    usual_gap: float | None = None


@dataclass(frozen=True)
class DatasetReport:
    """Report on a dataset: its length, sensors and ground truth, with all errors and warnings.

    Attributes:
        name: The dataset's name.
        format: How its recording is stored.
        start: Sensor time of the first message of any sensor, s.
        duration_seconds: Time from it to the last one; by the times of recording where there is no sensor.
        sensors: By sensor.
        ground_truth: None when there is none, or it can't be used.
        other_topics: Topics of the recording that no sensor names.
        other_types: Type and number of their messages, by topic.
        errors: What keeps the dataset from being used, a sentence each.
        warnings: What may be wrong, a sentence each.
        findings: All that has a code, errors and warnings among them, the gravest first.
        sampled: Number of messages that were looked at, of a sample; None where all were.
    """

    name: str
    format: str
    start: float | None
    duration_seconds: float | None
    sensors: list[SensorReport]
    ground_truth: TruthReport | None
    other_topics: list[str]
    other_types: dict[str, str]
    errors: list[str]
    warnings: list[str]
    findings: list[Finding] = field(default_factory=list)
    sampled: int | None = None

    @property
    def is_usable(self) -> bool:
        """Tell whether runs can work with the dataset."""
        return not self.errors

    def as_json(self) -> dict[str, Any]:
        """Return the report as plain values."""
        return asdict(self) | {"findings": [finding.as_json() for finding in self.findings]}


def inspect(
    entry: DatasetEntry,
    cache: Path | None = None,
    progress: Callable[[str, float | None], None] = lambda *_: None,
) -> DatasetReport:
    """Read a dataset through and say what it holds; what is wrong is collected, not raised.

    Args:
        entry: The dataset, materialised.
        cache: Folder for converted ground truth.
        progress: Called with what is being done, a step of how many, and the share of it done, 0 to 1; None
            where that isn't known.
    """
    errors: list[str] = []
    warnings: list[str] = []
    findings: list[Finding] = []
    declared, entry = entry.dataset, told_entry(entry)
    spec = entry.dataset.spec
    try:
        with open_recording(declared, entry.root) as recording:
            sound = sound_sensors(recording, spec.sensors, errors)
            contents = content_findings(recording, sound, errors, warnings)
            known, fault = read_truth(entry, cache)
            poses = known.poses if known is not None and isinstance(known.poses, Trajectory) else None
            watched, findings = examine(entry, recording, sound, poses, progress)
            warnings += watched.broken
            sensors = _sensors(spec, recording, watched.scans, contents, warnings)
            used = {sensor.topic for sensor in spec.sensors.values()} | {STATIC_TRANSFORMS}
            used |= {camera_info_topic(recording, sensor.topic) or "" for sensor in spec.sensors.values()}
            used.add((spec.ground_truth and truth_topic(spec.ground_truth.topic)) or "")
            others = {
                name: f"{topic.message_type}, {topic.count}"
                for name, topic in sorted(recording.topics.items())
                if name not in used
            }
            recorded = recording.seconds
    except DataError as error:
        return DatasetReport(
            entry.name, spec.recording.format, None, None, [], None, [], {}, [str(error)], []
        )
    # Stamps of another epoch stretch the recording by years, and their finding says all that matters.
    elsewhere = {
        finding.sensor
        for finding in findings
        if finding.code in _ELSEWHERE and finding.severity is Severity.ERROR
    }
    timed = [sensor for sensor in sensors if sensor.name not in elsewhere]
    firsts = [sensor.first for sensor in timed if sensor.first is not None]
    lasts = [sensor.last for sensor in timed if sensor.last is not None]
    span = (min(firsts), max(lasts)) if firsts else None
    if span is not None:
        sensors = [
            sensor if sensor.name in elsewhere else _covering(sensor, span, warnings) for sensor in sensors
        ]
    truth = None
    try:
        truth = _truth(entry.name, known, span)
    except DataError as error:
        fault = str(error)
    errors += [fault] if fault else []
    if truth is not None and truth.kind == "trajectory":
        warnings += _truth_shares(spec, timed, truth)
    stated, length = spec.recording.duration_seconds, span[1] - span[0] if span else None
    if stated and length is not None and abs(stated - length) > max(_RATE_TOLERANCE * stated, 1.0):
        warnings.append(f"recording.durationSeconds: states {stated:g} s, the messages last {length:.3f} s")
    if spec.ground_truth is None:
        warnings.append("groundTruth: none, so runs on this dataset can't be evaluated")
    findings.sort(key=lambda finding: [*Severity].index(finding.severity))
    errors += [finding.message for finding in findings if finding.severity is Severity.ERROR]
    warnings += [finding.message for finding in findings if finding.severity is Severity.WARNING]
    return DatasetReport(
        name=entry.name,
        format=spec.recording.format,
        start=span[0] if span else None,
        duration_seconds=length if length is not None else recorded,
        sensors=sensors,
        ground_truth=truth,
        other_topics=list(others),
        other_types=others,
        errors=errors,
        warnings=warnings,
        findings=findings,
    )


def _sensors(
    spec: DatasetSpec,
    recording: Recording,
    scans: Mapping[str, Scan],
    contents: Mapping[str, str],
    warnings: list[str],
) -> list[SensorReport]:
    reports = []
    for name, sensor in spec.sensors.items():
        if sensor.topic not in scans:
            reports.append(SensorReport(name, sensor.type, sensor.topic))
            continue
        report = _report(recording, name, sensor, scans[sensor.topic], contents.get(name, ""))
        reports.append(report)
        # A rate by stamps that can't be says nothing.
        if stamp_fault(scans[sensor.topic].stamps) is None:
            warnings += _suspicions(report, sensor)
    return reports


def told_entry(entry: DatasetEntry) -> DatasetEntry:
    """Return a dataset as its repair leaves it: what is judged is what algorithms are given, and told."""
    spec = entry.dataset.spec
    return DatasetEntry(entry.dataset.replace(spec=spec.replace(sensors=spec.told_sensors)), entry.root)


def read_truth(entry: DatasetEntry, cache: Path | None) -> tuple[GroundTruthPoses | None, str | None]:
    """Return the ground truth, and what keeps it from being read."""
    try:
        return ground_truth(entry, cache), None
    except DataError as error:
        return None, str(error)


def _report(recording: Recording, name: str, sensor: Sensor, scan: Scan, content: str) -> SensorReport:
    stamps = np.sort(scan.stamps)
    rate = rate_of(stamps)
    wide, limit = gaps_of(stamps)
    steps = np.diff(stamps)
    longest = wide[np.argsort(-steps[wide], kind="stable")][:_SHOWN_GAPS]
    return SensorReport(
        name=name,
        type=sensor.type,
        topic=sensor.topic,
        message_type=recording.topics[sensor.topic].message_type,
        messages=len(stamps),
        rate=None if rate is None else round(rate, 3),
        first=float(stamps[0] / 1e9) + sensor.time_offset if len(stamps) else None,
        last=float(stamps[-1] / 1e9) + sensor.time_offset if len(stamps) else None,
        gaps=[
            MessageGap(float(stamps[k] / 1e9) + sensor.time_offset, float(steps[k] / 1e9)) for k in longest
        ],
        gap_count=len(wide),
        gap_threshold=None if limit is None else round(limit, 6),
        size_bytes=scan.size_bytes,
        content=content,
    )


def _covering(report: SensorReport, span: tuple[float, float], warnings: list[str]) -> SensorReport:
    """Return a sensor's report with its share of the recording; warn of a small one."""
    length = span[1] - span[0]
    if report.first is None or report.last is None or length <= 0:
        return report
    share = (report.last - report.first) / length
    if share < SMALL_SHARE:
        warnings.append(
            f"sensors.{report.name}: {report.topic} covers {report.last - report.first:.1f} s of the "
            f"recording's {length:.1f} s ({share:.0%}), from {report.first:.3f} s to {report.last:.3f} s; "
            f"said below {SMALL_SHARE:.0%}, as a run with it has no more"
        )
    return replace(report, covered=round(share, 4))


def _truth_shares(spec: DatasetSpec, sensors: list[SensorReport], truth: TruthReport) -> list[str]:
    """Name the sensors that the modes need and that last for little of the ground truth."""
    problems = []
    for report in sensors:
        modes = modes_with(report.name, spec.sensors)
        if not modes or report.first is None or report.last is None or truth.last <= truth.first:
            continue
        both = max(0.0, min(report.last, truth.last) - max(report.first, truth.first))
        share = both / (truth.last - truth.first)
        if share < SMALL_SHARE:
            problems.append(
                f"sensors.{report.name}: {report.topic} lasts for {both:.1f} s of the ground truth's "
                f"{truth.last - truth.first:.1f} s ({share:.0%}); runs with it ({', '.join(modes)}) are "
                "measured on no more than that. Get the whole recording if there is more of it, or choose a "
                "mode without it"
            )
    return problems


def _suspicions(report: SensorReport, sensor: Sensor) -> list[str]:
    problems = []
    if sensor.rate and report.rate and abs(report.rate - sensor.rate) > _RATE_TOLERANCE * sensor.rate:
        problems.append(
            f"sensors.{report.name}.rate: states {sensor.rate:g} Hz, the recording has {report.rate:g} Hz"
        )
    return problems


def _truth(name: str, found: GroundTruthPoses | None, span: tuple[float, float] | None) -> TruthReport | None:
    """Return the report on a dataset's ground truth.

    Raises:
        DataError: It is of another time than the recording, or of none.
    """
    if found is None:
        return None
    truth = found.poses
    first, last = truth_range(truth)
    if span is not None:
        require_overlap(truth, *span, where=f"dataset {name!r}: groundTruth")
    steps = np.array([]) if isinstance(truth, Relations) else np.diff(truth.stamps)
    return TruthReport(
        kind="trajectory" if found.kind == "poses" else found.kind,
        count=len(truth),
        first=first,
        last=last,
        overlap_seconds=max(0.0, min(last, span[1]) - max(first, span[0])) if span else 0.0,
        path_metres=truth.path_length if isinstance(truth, Trajectory) else None,
        longest_gap=float(steps.max()) if steps.size else None,
        usual_gap=float(np.median(steps)) if steps.size else None,
    )
