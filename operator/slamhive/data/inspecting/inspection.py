# SPDX-License-Identifier: Apache-2.0
"""Inspection of a dataset: what its recording holds, and all its faults at once.

`slamhive dataset check` prints it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.doctor.cameras import calibration_findings
from slamhive.data.doctor.examining import examine
from slamhive.data.doctor.findings import Severity
from slamhive.data.recordings.checks import check_content, check_stamps, content_findings
from slamhive.data.recordings.entries import DatasetEntry, check_sums
from slamhive.data.recordings.posetopics import check_pose_topic, truth_topic
from slamhive.data.recordings.reading import open_recording
from slamhive.data.recordings.streams import STATIC_TRANSFORMS, camera_info_topic, check_topic, sound_sensors
from slamhive.data.recordings.thinning import rate_of
from slamhive.data.store.groundtruth import ground_truth, require_overlap, truth_range
from slamhive.model.dataset import fills, sensor_for
from slamhive.model.errors import DataError
from slamhive.model.sensors import ROLES, SensorType
from slamhive_eval import Relations, Trajectory
from slamhive_eval.coverage import REFERENCE_GAP_SECONDS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.recordings.reading import Recording, Scan
    from slamhive.data.store.groundtruth import GroundTruthPoses
    from slamhive.model.dataset import Dataset, DatasetSpec
    from slamhive.model.sensors import Sensor

GAP_PERIODS = 3.0
"""Periods of a sensor's mean rate without a message that are called a gap."""
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

    @property
    def is_usable(self) -> bool:
        """Tell whether runs can work with the dataset."""
        return not self.errors

    def as_json(self) -> dict[str, Any]:
        """Return the report as plain values."""
        return asdict(self) | {"findings": [finding.as_json() for finding in self.findings]}


def inspect(
    entry: DatasetEntry, cache: Path | None = None, progress: Callable[[float], None] | None = None
) -> DatasetReport:
    """Read a dataset through and say what it holds; what is wrong is collected, not raised.

    Args:
        entry: The dataset, materialised.
        cache: Folder for converted ground truth.
        progress: Called with the share read, 0 to 1.
    """
    errors: list[str] = []
    warnings: list[str] = []
    findings: list[Finding] = []
    spec = entry.dataset.spec
    try:
        with open_recording(entry.dataset, entry.root) as recording:
            sound = sound_sensors(recording, spec.sensors, errors)
            contents = content_findings(recording, sound, errors, warnings)
            known, fault = _read_truth(entry, cache)
            poses = known.poses if known is not None and isinstance(known.poses, Trajectory) else None
            watched, findings = examine(entry, recording, sound, poses, progress)
            warnings += watched.broken
            sensors = _sensors(spec, recording, watched.scans, contents, errors, warnings)
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
    # A sensor of another epoch stretches the recording by years, and its finding says all that matters.
    elsewhere = {finding.sensor for finding in findings if finding.code == "clock.epoch"}
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
    warnings += _sparse_truth(truth)
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


def require_usable(dataset: Dataset, root: Path, cache: Path | None = None) -> list[str]:
    """Refuse a dataset that no run could work with, before it is known.

    What takes reading all messages of the recording is left to `inspect`. Files that are still to be fetched
    are not looked at.

    Args:
        dataset: The dataset as declared.
        root: The folder that its paths start from.
        cache: Folder in which hashes of files are remembered.

    Returns:
        What may be wrong all the same, a sentence each.

    Raises:
        DataError: A file isn't what its checksum says; the recording can't be read, lacks a sensor's topic or
            isn't what is said of it; the ground truth can't be read, or is of another time.
    """
    files = dataset.spec.recording.files
    if not files or any(file.url and not (root / file.path).exists() for file in files):
        return []
    entry = DatasetEntry(dataset, root)
    spec = dataset.spec
    with open_recording(dataset, root) as recording:
        for name, sensor in spec.sensors.items():
            check_topic(recording, name, sensor)
        warnings = check_content(recording, spec.sensors)
        for name, sensor in spec.sensors.items():
            if sensor.type in {SensorType.CAMERA, SensorType.DEPTH_CAMERA}:
                found = calibration_findings(recording, name, sensor)
                warnings += [one.message for one in found if one.severity is not Severity.NOTE]
        if spec.ground_truth is not None and spec.ground_truth.topic is not None:
            check_pose_topic(recording, spec.ground_truth.topic)
        span = _rough_span(recording, spec.sensors)
    if spec.ground_truth is not None and spec.ground_truth.file is not None:
        truth = ground_truth(entry)
        if truth is not None and span is not None:
            require_overlap(truth.poses, *span, where=f"dataset {dataset.name!r}: groundTruth")
    check_sums(entry, cache)
    return warnings


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


def _sensors(  # noqa: PLR0917 - what is known, then what is added to
    spec: DatasetSpec,
    recording: Recording,
    scans: Mapping[str, Scan],
    contents: Mapping[str, str],
    errors: list[str],
    warnings: list[str],
) -> list[SensorReport]:
    reports = []
    for name, sensor in spec.sensors.items():
        if sensor.topic not in scans:
            reports.append(SensorReport(name, sensor.type, sensor.topic))
            continue
        scan = scans[sensor.topic]
        try:
            check_stamps(scan, f"sensors.{name}: {sensor.topic} in {recording.label}")
        except DataError as error:
            errors.append(str(error))
        report = _report(recording, name, sensor, scan, contents.get(name, ""))
        reports.append(report)
        warnings += _suspicions(report, sensor)
    return reports


def _read_truth(entry: DatasetEntry, cache: Path | None) -> tuple[GroundTruthPoses | None, str | None]:
    """Return the ground truth, and what keeps it from being read."""
    try:
        return ground_truth(entry, cache), None
    except DataError as error:
        return None, str(error)


def _report(recording: Recording, name: str, sensor: Sensor, scan: Scan, content: str) -> SensorReport:
    stamps = np.sort(scan.stamps)
    steps = np.diff(stamps)
    rate = rate_of(stamps)
    wide = np.flatnonzero(steps > GAP_PERIODS * 1e9 / rate) if rate else np.array([], dtype=np.intp)
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
        gap_threshold=round(GAP_PERIODS / rate, 6) if rate else None,
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
        modes = _modes_with(spec, report.name)
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


def _modes_with(spec: DatasetSpec, name: str) -> list[str]:
    """Return the modes that the sensors serve and that need the sensor of a name."""
    types = {one: sensor.type for one, sensor in spec.sensors.items()}
    return [
        str(mode)
        for mode, roles in ROLES.items()
        if all(fills(role, types) for role in roles)
        and name in {sensor_for(role, spec.sensors) for role in roles}
    ]


def _suspicions(report: SensorReport, sensor: Sensor) -> list[str]:
    problems = []
    if sensor.rate and report.rate and abs(report.rate - sensor.rate) > _RATE_TOLERANCE * sensor.rate:
        problems.append(
            f"sensors.{report.name}.rate: states {sensor.rate:g} Hz, the recording has {report.rate:g} Hz"
        )
    if report.gap_count:
        longest = report.gaps[0]
        problems.append(
            f"sensors.{report.name}: {report.gap_count} gap{'s' if report.gap_count > 1 else ''} in "
            f"{report.topic}, the longest {longest.seconds:.3f} s at {longest.start:.3f} s; a gap is more "
            f"than {report.gap_threshold:.3g} s, {GAP_PERIODS:g} periods"
        )
    return problems


def _sparse_truth(truth: TruthReport | None) -> list[str]:
    """Warn of ground truth with so much time between poses that few of an estimate's poses would meet one."""
    if truth is None or truth.kind not in ("trajectory", "positions") or truth.count < 2:
        return []
    if truth.usual_gap is None or truth.usual_gap <= REFERENCE_GAP_SECONDS:
        return []
    sentence = (
        f"groundTruth: its {truth.count} poses are {truth.usual_gap:.3g} s apart typically: an estimate "
        "meets few of them within association.maxDifference (10 ms), and spans of more than "
        f"{REFERENCE_GAP_SECONDS:g} s between poses count as holes, so that runs come out Lost; if these are "
        "surveyed points, declare format: ControlPoints, and the estimate is interpolated to them"
    )
    return [sentence]


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
