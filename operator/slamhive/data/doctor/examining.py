# SPDX-License-Identifier: Apache-2.0
"""Examination of a recording: which watchers look at which sensors, and all that they find."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.data.doctor import clocks
from slamhive.data.doctor.cameras import judge_cameras
from slamhive.data.doctor.examined import Examined
from slamhive.data.doctor.files import judge_files, judge_static_transforms
from slamhive.data.doctor.pictures import Pictures
from slamhive.data.doctor.watching import WatchedSensor, watch
from slamhive.model.sensors import SensorType

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from slamhive.data.doctor.findings import Finding
    from slamhive.data.doctor.watching import MessageWatcher, WatchedRecording
    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.data.recordings.reading import Recording
    from slamhive.model.sensors import Sensor
    from slamhive_eval import Trajectory

WATCHERS: Mapping[SensorType, tuple[Callable[[WatchedSensor], MessageWatcher], ...]] = {
    SensorType.CAMERA: (Pictures,),
    SensorType.DEPTH_CAMERA: (Pictures,),
}
"""Watchers by the kind of sensor whose messages they take."""

BETWEEN: tuple[Callable[[Examined], Iterable[Finding]], ...] = (
    judge_files,
    judge_static_transforms,
    clocks.epochs,
    judge_cameras,
)
"""Judgements between sensors, between them and the truth, and of the recording's files."""


def examine(
    entry: DatasetEntry,
    recording: Recording,
    sensors: Mapping[str, Sensor],
    truth: Trajectory | None,
    progress: Callable[[float], None] | None = None,
) -> tuple[WatchedRecording, list[Finding]]:
    """Read all messages of a dataset's sensors and return their times and what was found.

    Args:
        entry: The dataset.
        recording: Its open recording.
        sensors: Its sensors whose topics are there.
        truth: Its ground truth, where it has poses.
        progress: Called with the share read, 0 to 1.

    Raises:
        DataError: The recording is damaged.
    """
    spec = entry.dataset.spec
    watched_sensors = {
        name: WatchedSensor(name, sensor, topic.message_type, topic.count, spec)
        for name, sensor in sensors.items()
        for topic in (recording.topics[sensor.topic],)
    }
    watchers = {
        name: [make(of) for make in WATCHERS.get(of.sensor.type, ())] for name, of in watched_sensors.items()
    }
    topics = {name: sensor.topic for name, sensor in sensors.items()}
    watched = watch(recording, watchers, topics, progress)
    found = [finding for ones in watchers.values() for one in ones for finding in one.findings()]
    examined = Examined(entry, recording, watched, truth)
    found += [finding for judge in BETWEEN for finding in judge(examined)]
    return watched, found
