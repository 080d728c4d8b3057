# SPDX-License-Identifier: Apache-2.0
"""Streams: the topics of a recording that belong to the wanted sensors, and a check that their types fit."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from slamhive.data.recordings.kinds import CAMERA_INFO, KINDS
from slamhive.data.recordings.reading import TF_TYPES
from slamhive.model.errors import DataError, suggestion
from slamhive.model.sensors import FOLLOWS, Role, SensorType

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.data.recordings.reading import Recording, Topic
    from slamhive.model.configuration import SensorView
    from slamhive.model.sensors import Sensor

STATIC_TRANSFORMS = "/tf_static"


class TopicKind(Enum):
    """Kinds of topics in a variant, by how their messages are thinned and cut."""

    FRAMES = "frames"  # of the sensor that sets the pace: thinned and cut
    PARTNER = "partner"  # frames kept together with those of another sensor
    INFO = "info"  # camera_info: kept with its images
    SAMPLES = "samples"  # never thinned, cut with a margin
    TOPIC = "topic"  # no sensor's, asked for by its name: cut with a margin
    STATIC = "static"  # kept whole


@dataclass(frozen=True)
class Stream:
    """A topic that a variant holds.

    Attributes:
        topic: Its name.
        message_type: Type of its messages.
        kind: What is done with it.
        sensor: Name of the sensor, for sensors' topics.
        follows: Topic whose frames decide about this one's.
        depth: Whether its images (or those that it describes) are depth.
        time_offset: Seconds to add to header stamps to get sensor time.
        declared: The sensor as the dataset declares it, for sensors' topics.
    """

    topic: str
    message_type: str
    kind: TopicKind
    sensor: str | None = None
    follows: str | None = None
    depth: bool = False
    time_offset: float = 0.0
    declared: SensorView | None = None


def check_topic(recording: Recording, name: str, sensor: Sensor) -> None:
    """Check that a sensor's topic exists, has messages, and of a type that fits.

    Args:
        recording: The recording.
        name: The sensor's name, for messages.
        sensor: The sensor.

    Raises:
        DataError: It doesn't.
    """
    where = f"sensors.{name}.topic"
    topic = recording.topics.get(sensor.topic)
    allowed = KINDS[sensor.type].messages
    if topic is None and sensor.topic in recording.foreign:
        raise DataError(
            f"{where}: {sensor.topic} in {recording.label} is no channel of ROS 2 "
            f"({recording.foreign[sensor.topic]}): its type and its definition aren't known; record it as "
            "ROS 2 does"
        )
    if topic is None:
        fitting = [item.name for item in recording.topics.values() if item.message_type in allowed]
        raise DataError(
            f"{where}: no topic {sensor.topic!r} in {recording.label}"
            f"{suggestion(sensor.topic, fitting or recording.topics)}"
        )
    if topic.message_type not in allowed:
        raise DataError(
            f"{where}: {sensor.topic} has messages of type {topic.message_type}; a sensor of type "
            f"{sensor.type} needs {' or '.join(allowed)}"
        )
    if topic.count == 0:
        raise DataError(f"{where}: {sensor.topic} has no messages in {recording.label}")
    _check_defined(recording, topic, where)


def _check_defined(recording: Recording, topic: Topic, where: str) -> None:
    undefined = recording.undefined(topic.message_type)
    if undefined is not None:
        raise DataError(
            f"{where}: {topic.name} in {recording.label} has messages of type {topic.message_type}, and "
            f"there is no definition of {undefined} in it, as ROS 2 records them since Iron: play it on a "
            "machine that has the package, and record it anew there"
        )


def sound_sensors(
    recording: Recording, sensors: Mapping[str, Sensor], problems: list[str]
) -> dict[str, Sensor]:
    """Return the sensors whose topics can be read.

    Args:
        recording: The recording.
        sensors: All that a dataset names.
        problems: What is wrong with the others is added, a sentence each.
    """
    sound: dict[str, Sensor] = {}
    for name, sensor in sensors.items():
        try:
            check_topic(recording, name, sensor)
            sound[name] = sensor
        except DataError as error:
            problems.append(str(error))
    return sound


def streams_of(
    recording: Recording,
    sensors: Mapping[Role, SensorView],
    truth_topic: str | None,
    topics: Sequence[str] = (),
) -> list[Stream]:
    """Return the topics that a variant holds, those that set the pace first.

    Args:
        recording: The recording.
        sensors: The wanted sensors by role, as the dataset declares them, in the order of the roles.
        truth_topic: Topic with ground truth, which is never among them.
        topics: Topics that are asked for by their names.

    Raises:
        DataError: A topic is missing or doesn't fit its sensor.
    """
    result: dict[str, Stream] = {}
    # Where nothing has frames, the messages of the first sensor stand for them.
    alone = None if any(one.type.has_frames for one in sensors.values()) else next(iter(sensors.values()))
    for role, sensor in sensors.items():
        check_topic(recording, sensor.name, sensor)
        if sensor.topic == truth_topic:
            raise DataError(
                f"sensors.{sensor.name}.topic: {sensor.topic} is the ground truth, which no algorithm may see"
            )
        leader = sensors.get(FOLLOWS.get(role, role)) if role in FOLLOWS else None
        if leader is not None:
            kind = TopicKind.PARTNER
        else:
            kind = TopicKind.FRAMES if sensor.type.has_frames or sensor is alone else TopicKind.SAMPLES
        result.setdefault(
            sensor.topic,
            Stream(
                topic=sensor.topic,
                message_type=recording.topics[sensor.topic].message_type,
                kind=kind,
                sensor=sensor.name,
                follows=leader.topic if leader else None,
                depth=sensor.type is SensorType.DEPTH_CAMERA,
                time_offset=sensor.time_offset,
                declared=sensor,
            ),
        )
    for stream in list(result.values()):
        info = camera_info_topic(recording, stream.topic)
        if stream.declared and stream.declared.camera and info and info != truth_topic:
            result.setdefault(
                info, Stream(info, CAMERA_INFO, TopicKind.INFO, follows=stream.topic, depth=stream.depth)
            )
    transforms = recording.topics.get(STATIC_TRANSFORMS)
    if transforms and transforms.message_type in TF_TYPES and truth_topic != STATIC_TRANSFORMS:
        result[STATIC_TRANSFORMS] = Stream(STATIC_TRANSFORMS, transforms.message_type, TopicKind.STATIC)
    for topic in topics:
        result.setdefault(topic, _asked_for(recording, topic, truth_topic))
    return sorted(result.values(), key=lambda stream: list(TopicKind).index(stream.kind))


def _asked_for(recording: Recording, name: str, truth_topic: str | None) -> Stream:
    topic = recording.topics.get(name)
    if name == truth_topic:
        raise DataError(f"modes.topics: {name} is the ground truth, which no algorithm may see")
    if topic is None:
        raise DataError(
            f"modes.topics: no topic {name!r} in {recording.label}{suggestion(name, recording.topics)}"
        )
    _check_defined(recording, topic, "modes.topics")
    # What is said once holds for all of it, as a map does.
    return Stream(name, topic.message_type, TopicKind.STATIC if topic.count == 1 else TopicKind.TOPIC)


def camera_info_topic(recording: Recording, image_topic: str) -> str | None:
    """Return the topic with the CameraInfo of an image topic: ``camera_info`` beside it."""
    parts = image_topic.split("/")
    for depth in (1, 2):
        candidate = "/".join([*parts[:-depth], "camera_info"])
        topic = recording.topics.get(candidate)
        if topic is not None and topic.message_type == CAMERA_INFO and topic.count:
            return candidate
    return None
