# SPDX-License-Identifier: Apache-2.0
"""Rules of the CRDs beyond the models' types: CEL expressions and bounds.

The rules are those of the models' own validators, in the words of the API server. CEL knows no typeless
values, such as those of an axis: what can be said of them without CEL is in EXTRA, the rest is checked by
`slamhive validate` and by the operator. Objects whose fields are free, such as parameters, it can compare but
not look into.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic.alias_generators import to_camel

from slamhive.model.algorithm import TEXT_LIMIT, Pace
from slamhive.model.formats import FIRST_CAMERAS, HELD, DataFormat, holds
from slamhive.model.run import OF_ROLES
from slamhive.model.search import SearchMethod
from slamhive.model.sensors import ROLES, Role, SensorMode
from slamhive.model.sweep import MAX_POINTS
from slamhive.model.synthetic import NOMINAL_LAP_METRES, REST_SECONDS, SyntheticSensor

if TYPE_CHECKING:
    from collections.abc import Iterable

Rule = tuple[str, str]

_ROLES = ", ".join(f"'{role}'" for role in Role)
MAX_SPEED = 6.0
"""Greatest speed of a synthetic recording's platform, m/s."""
_SELECTABLE = "'algorithm', 'dataset', 'algorithmRef.name', 'datasetRef.name'"


def _texts(items: Iterable[str]) -> str:
    """Return a list of texts in CEL."""
    return "[" + ", ".join(f"'{item}'" for item in items) + "]"


def _holding(form: DataFormat) -> str:
    """Return in CEL that a folder of this form holds the sensors of the mode m: ``formats.holds``."""
    modes = _texts(mode for mode, roles in ROLES.items() if holds(form, roles))
    cameras = f"m.roles.filter(role, role in {_texts(FIRST_CAMERAS)}).size()"
    lidar_alone = "'lidar' in m.roles && !('right' in m.roles) && !('depth' in m.roles)"
    roles = f"m.roles.all(role, role in {_texts(HELD[form])})"
    return (
        f"(form == '{form}' && (size(m.roles) == 0 ? m.name in {modes}"
        f" : {roles} && ({cameras} == 1 || ({cameras} == 0 && {lidar_alone}))))"
    )


_BAGS = _texts(form for form in DataFormat if not form.is_folder)
_FOLDERS = " || ".join(_holding(form) for form in DataFormat if form.is_folder)

_SAMPLED = f"self.method in {_texts(method for method in SearchMethod if method.is_sampled)}"
_KEYS_ARE_ROLES = f"its keys are roles: {_ROLES.replace(chr(39), '')}"
_OF_ROLES = [to_camel(field) for field in OF_ROLES]
_NODE = "has(self.ros1) || has(self.ros2)"

RULES: dict[str, tuple[Rule, ...]] = {
    "AlgorithmSpec": (
        ("has(self.image) || has(self.local)", "image: needed, or local for a program without a container"),
        (
            "!self.paces.exists(pace, pace == 'Realtime') || has(self.realtime)",
            "realtime: needed for the pace Realtime (queue and drop policy)",
        ),
        ("!has(self.ros1) || !has(self.ros2)", "ros2: a node of ROS 1 or of ROS 2, not of both"),
        (
            f"!({_NODE}) || self.paces.exists(pace, pace != 'Lockstep')",
            "paces: a ROS node (ros1, ros2) needs Realtime or Stepped among them",
        ),
        (
            f"{_NODE} || !self.paces.exists(pace, pace == 'Stepped')",
            "paces: Stepped is for ROS nodes alone (ros1, ros2)",
        ),
        (
            "!has(self.ros1) || self.recording == ['Rosbag1']",
            "ros1: needs recording: [Rosbag1], which is what is played",
        ),
        (
            "!has(self.ros2) || self.recording.all(form, form in ['Rosbag2', 'Mcap'])",
            "ros2: needs recording: [Rosbag2, Mcap], which is what is played",
        ),
        (
            f"!({_NODE}) || (!has(self.output.trajectory) && !has(self.output.keyframes))",
            "output.trajectory: a ROS node's poses are those that it publishes",
        ),
        (
            (
                f"self.recording.exists(form, form in {_BAGS})"
                " || self.modes.all(m, !has(m.topics) || size(m.topics) == 0)"
            ),
            "modes: only a bag holds topics, and recording names none",
        ),
        (
            f"self.modes.all(m, self.recording.exists(form, form in {_BAGS} || {_FOLDERS}))",
            "recording: none of its forms can hold the sensors of a mode",
        ),
    ),
    "PoseFile": (("!has(self.columns) || self.format == 'Csv'", "columns: only the format Csv takes it"),),
    "RosPoses": (
        (
            "self.type == 'TF' ? has(self.parent) && has(self.frame) : !has(self.parent) && !has(self.frame)",
            "parent: parent and frame are needed for TF, and for TF alone",
        ),
    ),
    "Ros1": (
        (
            f"self.topics.all(role, role in [{_ROLES}])",
            f"topics: {_KEYS_ARE_ROLES}",
        ),
    ),
    "Ros2": (
        (
            f"self.topics.all(role, role in [{_ROLES}])",
            f"topics: {_KEYS_ARE_ROLES}",
        ),
        (
            f"self.qos.all(role, role in [{_ROLES}])",
            f"qos: {_KEYS_ARE_ROLES}",
        ),
        (
            "self.arguments == 'Ros' || !has(self.parameters)",
            "parameters: needs arguments: Ros, by which the node is told of the file",
        ),
        (
            "self.arguments == 'Ros' || self.topics.all(role, self.topics[role].startsWith('/'))",
            "topics: a relative name needs arguments: Ros",
        ),
    ),
    "Asset": (
        ("has(self.path) != has(self.url)", "path: give either path or url"),
        ("!has(self.url) || has(self.sha256)", "sha256: needed with a url"),
    ),
    "DataFile": (("!has(self.url) || has(self.sha256)", "sha256: needed with a url"),),
    "Recording": (
        ("size(self.files) == 0 || !has(self.synthetic)", "files: give either files or synthetic"),
    ),
    "GroundTruth": (
        ("has(self.file) != has(self.topic)", "file: give either file or topic"),
        (
            "!has(self.table) || self.format in ['Table', 'ControlPoints']",
            "table: only the formats Table and ControlPoints take it",
        ),
        ("self.format != 'Table' || has(self.table)", "table: the format Table needs it"),
    ),
    "DatasetSpec": (
        (
            (
                "has(self.catalogue) || (has(self.recording)"
                " && (size(self.recording.files) > 0 || has(self.recording.synthetic)))"
            ),
            "recording: give either files or synthetic, or a sequence as catalogue",
        ),
        (
            (
                "!has(self.groundTruth) || size(self.sensors) == 0 || has(self.groundTruth.T_body_frame)"
                " || self.groundTruth.frame == 'body' || self.groundTruth.frame in self.sensors"
            ),
            "groundTruth.frame: must be body or the name of a sensor, or T_body_frame must be given",
        ),
    ),
    "Sensor": (
        (
            "!has(self.camera) || self.type == 'Camera' || self.type == 'DepthCamera'",
            "camera: only a sensor of type Camera or DepthCamera takes it",
        ),
        ("!has(self.lidar) || self.type == 'Lidar'", "lidar: only a sensor of type Lidar takes it"),
        ("!has(self.imu) || self.type == 'Imu'", "imu: only a sensor of type Imu takes it"),
        (
            "size(self.T_body_sensor) != 4 || self.T_body_sensor[3] == [0.0, 0.0, 0.0, 1.0]",
            "T_body_sensor: the last row must be 0 0 0 1",
        ),
    ),
    "SyntheticLidar": (("self.minRange < self.maxRange", "maxRange: must be greater than minRange"),),
    "SyntheticCamera": (
        (
            "self.exposureSeconds * self.rate <= 1.0",
            "exposureSeconds: at most the time of a frame, 1 / rate, is possible",
        ),
    ),
    "SyntheticVibration": (
        ("self.minFrequency <= self.maxFrequency", "maxFrequency: must not be less than minFrequency"),
    ),
    "SyntheticRecording": (
        (
            "!has(self.vibration) || self.vibration.maxFrequency * 4.0 <= self.imu.rate",
            "vibration: maxFrequency must be at most a quarter of imu.rate",
        ),
        (
            "!has(self.speed) || !has(self.durationSeconds)",
            "speed: excludes durationSeconds; with loops, one gives the other",
        ),
        (
            (
                f"!has(self.durationSeconds) || self.loops * {NOMINAL_LAP_METRES}"
                f" <= {MAX_SPEED} * (self.durationSeconds - {2 * REST_SECONDS})"
            ),
            f"durationSeconds: too short for so many loops; at most {MAX_SPEED:g} m/s are possible",
        ),
    ),
    "LidarInput": (
        (
            "!has(self.minRange) || !has(self.maxRange) || self.minRange < self.maxRange",
            "maxRange: must be greater than minRange",
        ),
    ),
    "Perturbation": tuple(
        (f"self.{field}.all(role, role in [{_ROLES}])", f"{field}: {_KEYS_ARE_ROLES}") for field in _OF_ROLES
    ),
    "InputOptions": (
        (
            f"self.remap.all(role, role in [{_ROLES}])",
            f"remap: its keys are roles: {_ROLES.replace(chr(39), '')}",
        ),
    ),
    "RunSelector": (
        (
            "size(self.names) > 0 || has(self.sweepRef) || size(self.matchLabels) > 0",
            "runs: name runs by names, sweepRef or matchLabels",
        ),
    ),
    "Range": (
        ("!has(self.step) || !has(self.count)", "step: give either step or count"),
        (
            "self.scale != 'Log' || (!has(self.step) && self.from > 0.0 && self.to > 0.0)",
            "scale: Log needs count, and from and to above zero",
        ),
        ("has(self.count) || self.to >= self.from", "to: must not be below from"),
    ),
    "TrialRepetitions": (("self.first <= self.promote", "promote: must not be less than first"),),
    "Failing": (
        (
            "has(self.metric) || (!has(self.above) && !has(self.below))",
            "metric: needed beside above and below",
        ),
        ("!has(self.metric) || !has(self.outcome)", "outcome: give either outcome or metric"),
        (
            "!has(self.metric) || has(self.above) != has(self.below)",
            "above: a metric needs either above or below",
        ),
    ),
    "Search": (
        (f"!({_SAMPLED}) || has(self.trials)", "trials: needed by this method"),
        (f"!({_SAMPLED}) || size(self.objectives) > 0", "objectives: needed by this method"),
        (f"{_SAMPLED} || !has(self.trials)", "trials: means nothing to this method"),
        (f"{_SAMPLED} || size(self.objectives) == 0", "objectives: means nothing to this method"),
        ("self.method == 'Threshold' || !has(self.axis)", "axis: only the method Threshold takes it"),
        ("self.method != 'Threshold' || has(self.axis)", "axis: needed by the method Threshold"),
    ),
    "SweepSpec": (
        (
            f"!({_SAMPLED.replace('self', 'self.search')}) || self.repetitions == 1",
            "repetitions: a search has its own, search.repetitions; give them in one place alone",
        ),
        (
            "self.search.method == 'Grid' || size(self.include) == 0",
            "include: a search adds no points; make them values of an axis",
        ),
    ),
    "Axis": (
        ("has(self.path) || has(self.points)", "path: needed with values, range and selector"),
        (
            "!has(self.points) || (has(self.name) && !has(self.path))",
            "points: an axis of points has a name and no path",
        ),
        (
            f"!has(self.selector) || (has(self.path) && self.path in [{_SELECTABLE}])",
            "selector: selects algorithms or datasets, so path must be algorithm or dataset",
        ),
    ),
}
"""Rules by the name of the model; each message begins with the field."""

_AXIS_SOURCES = ("values", "range", "selector", "points")
EXTRA: dict[str, dict[str, Any]] = {
    "Axis": {
        "oneOf": [{"required": [source]} for source in _AXIS_SOURCES],
        "description": "One dimension of the matrix: exactly one of values, range, selector and points.",
    },
    "AlgorithmSpec.modes": {"x-kubernetes-list-type": "map", "x-kubernetes-list-map-keys": ["name"]},
    "AlgorithmSpec.assets": {"x-kubernetes-list-type": "map", "x-kubernetes-list-map-keys": ["name"]},
    "AlgorithmSpec.files": {"x-kubernetes-list-type": "map", "x-kubernetes-list-map-keys": ["path"]},
    "Parameter.default": {"maxLength": TEXT_LIMIT},
    "Parameter.values[]": {"maxLength": TEXT_LIMIT},
    "SyntheticRecording.sensors": {"x-kubernetes-list-type": "set"},
}
"""Schema to add to a model, or to a field of one."""

_SMALL = 64
LENGTHS: dict[str, int] = {
    "Axis.values": MAX_POINTS,
    "Axis.path": 512,
    "AlgorithmSpec.paces": len(Pace),
    "AlgorithmSpec.modes": len(SensorMode),
    "AlgorithmSpec.recording": 6,
    "AlgorithmSpec.parameters": 1000,
    "Axis.points": 10_000,
    "DatasetSpec.sensors": _SMALL,
    "InputOptions.remap": len(Role),
    "Mode.roles": len(Role),
    "Mode.topics": _SMALL,
    "Parameter.values": 1000,
    **{f"Perturbation.{field}": len(Role) for field in _OF_ROLES},
    "Recording.files": 1000,
    "Ros1.topics": len(Role),
    "Ros2.qos": len(Role),
    "Ros2.topics": len(Role),
    "RunSelector.names": 10_000,
    "SyntheticRecording.sensors": len(SyntheticSensor),
    "GroundTruth.holes": 1000,
}
"""Greatest length of a field; the API server must know one to bound the cost of rules."""
TEXT_LENGTH, PATTERN_LENGTH, LIST_LENGTH, MAP_LENGTH = 4096, 1024, 256, 256
"""Greatest lengths where neither the model nor LENGTHS has one."""
