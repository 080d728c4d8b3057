# SPDX-License-Identifier: Apache-2.0
"""Examination of a recording: which watchers look at which sensors, and all that they find."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from slamhive.data.doctor import clocks
from slamhive.data.doctor.bodies import judge_bodies
from slamhive.data.doctor.cameras import judge_cameras
from slamhive.data.doctor.depths import judge_depth
from slamhive.data.doctor.examined import Examined
from slamhive.data.doctor.files import judge_files, judge_static_transforms
from slamhive.data.doctor.fixes import Fixes
from slamhive.data.doctor.imus import Samples, judge_imus
from slamhive.data.doctor.offsets import judge_turning
from slamhive.data.doctor.pictures import Pictures
from slamhive.data.doctor.points import ScanPoints
from slamhive.data.doctor.pointtimes import ScanTimes
from slamhive.data.doctor.repeats import judge_repeats
from slamhive.data.doctor.sampling import SAMPLED, of_sample, sampled
from slamhive.data.doctor.stamps import judge_stamps
from slamhive.data.doctor.truthrows import judge_truth_rows
from slamhive.data.doctor.truths import judge_truth
from slamhive.data.doctor.voting import SEEING
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
    SensorType.IMU: (Samples,),
    SensorType.LIDAR: (ScanPoints, ScanTimes),
    SensorType.GNSS: (Fixes,),
}
"""Watchers by the kind of sensor whose messages they take."""

BETWEEN: tuple[Callable[[Examined], Iterable[Finding]], ...] = (
    judge_files,
    judge_static_transforms,
    clocks.epochs,
    judge_cameras,
    judge_repeats,
    judge_truth,
    judge_stamps,
    judge_imus,
    judge_bodies,
    judge_truth_rows,
    judge_depth,
    judge_turning,
)
"""Judgements between sensors, between them and the truth, and of the recording's files."""

OF_SAMPLES = frozenset(
    {judge_files, judge_static_transforms, clocks.epochs, judge_cameras, judge_repeats, judge_imus}
)
"""Those of them that a sample is enough for."""


def examine(
    entry: DatasetEntry,
    recording: Recording,
    sensors: Mapping[str, Sensor],
    truth: Trajectory | None,
    progress: Callable[[str, float | None], None] = lambda *_: None,
    *,
    quick: bool = False,
) -> tuple[WatchedRecording, list[Finding]]:
    """Read all messages of a dataset's sensors and return their times and what was found.

    Args:
        entry: The dataset.
        recording: Its open recording.
        sensors: Its sensors whose topics are there.
        truth: Its ground truth, where it has poses.
        progress: Called with what is being done, a step of how many, and the share of it done, 0 to 1; None
            where that isn't known.
        quick: Whether a sample of the messages is read, some of each sensor, in seconds.

    Raises:
        DataError: The recording is damaged.
    """
    spec = entry.dataset.spec
    watched_sensors = {
        name: WatchedSensor(name, sensor, topic.message_type, count, spec)
        for name, sensor in sensors.items()
        for topic in (recording.topics[sensor.topic],)
        for count in (min(topic.count, SAMPLED) if quick else topic.count,)
    }
    watchers = {
        name: [make(of) for make in WATCHERS.get(of.sensor.type, ())] for name, of in watched_sensors.items()
    }
    topics = {name: sensor.topic for name, sensor in sensors.items()}
    messages = sampled(recording, sensors) if quick else None
    turned = {name: f"how {name} turned" for name, sensor in sensors.items() if sensor.type in SEEING}
    steps = ["reading", "judging", *turned.values()]

    def tell(step: str, share: float | None) -> None:
        progress(f"step {steps.index(step) + 1} of {len(steps)}, {step}", share)

    watched = watch(recording, watchers, topics, partial(tell, "reading"), messages)
    tell("judging", None)
    found = [finding for ones in watchers.values() for one in ones for finding in one.findings()]
    examined = Examined(
        entry,
        recording,
        watched,
        truth,
        is_sample=quick,
        progress=lambda name, share: tell(turned[name], share),
    )
    judges = [judge for judge in BETWEEN if not quick or judge in OF_SAMPLES]
    found += [finding for judge in judges for finding in judge(examined)]
    return watched, [*of_sample(found)] if quick else found
