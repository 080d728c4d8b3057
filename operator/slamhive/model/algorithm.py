# SPDX-License-Identifier: Apache-2.0
"""Algorithm: what can be run, on which sensors, with which parameters, and what its poses mean."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, StringConstraints, field_validator, model_validator

from slamhive.contract.posefiles import BY_FRAMES
from slamhive.model.base import (
    HTTPS,
    RELATIVE_PATH,
    Choice,
    Image,
    Model,
    Name,
    RelativePath,
    Resource,
    Scalar,
    SettingsPath,
    Sha256,
    optional,
    worded,
)
from slamhive.model.errors import InputError, UnknownNameError, suggestion
from slamhive.model.formats import DataFormat, RecordingFormat, fitting_formats, misfit
from slamhive.model.posefiles import PoseFile, told_files
from slamhive.model.rosnodes import Ros1, Ros2, RosNode
from slamhive.model.sensors import ROLES, FrameOwner, Role, SensorMode
from slamhive.model.templates import FILES_LIMIT, TEMPLATE_LIMIT, TEMPLATES_LIMIT, read_template

if TYPE_CHECKING:
    from collections.abc import Mapping

_NOT_BOUND = r'/:,"\x00-\x1f'
_BOUND_SEGMENT = rf"([^.{_NOT_BOUND}]|\.[^.{_NOT_BOUND}]|\.\.[^{_NOT_BOUND}])[^{_NOT_BOUND}]*"
AssetName = Annotated[
    str,
    StringConstraints(
        pattern=worded(
            rf"^{_BOUND_SEGMENT}(/{_BOUND_SEGMENT})*$",
            "expected a path below its folder, without . or .. or a colon, comma, quote or line break in it",
        ),
        max_length=1024,
    ),
    Field(
        description="A path below its folder, without colon, comma, quote or line break: containers mount it."
    ),
]
Topic = Annotated[str, StringConstraints(min_length=1, max_length=256)]
TEXT_LIMIT = 16 * 1024
"""Characters of a parameter's text."""
PARAMETERS_LIMIT = 128 * 1024
"""Bytes of a run's parameters as JSON: they reach a container in an annotation of its pod."""


class Pace(Choice):
    """Ways of handing a recording to an algorithm: as fast as it reads, by the clock, or frame by frame."""

    LOCKSTEP = "Lockstep"
    REALTIME = "Realtime"
    STEPPED = "Stepped"

    @property
    def is_played(self) -> bool:
        """Tell whether time passes in it as it did in the recording."""
        return self is not Pace.LOCKSTEP


class ParameterType(Choice):
    """The type of a parameter."""

    NUMBER = "Number"
    INTEGER = "Integer"
    BOOLEAN = "Boolean"
    STRING = "String"


class Parameter(Model):
    """A parameter of an algorithm: type, default and bounds."""

    type: ParameterType = Field(description="Type of the value.")
    default: Scalar = optional("Value where a run gives none.")
    nullable: bool = Field(default=False, description="Whether null is allowed: the algorithm derives it.")
    minimum: float | None = optional("Least value allowed.")
    maximum: float | None = optional("Greatest value allowed.")
    values: list[Scalar] | None = optional("The only values allowed.", min_length=1)
    unit: str | None = optional("Unit of the value.")
    scale: Literal["Linear", "Log"] | None = optional(
        "Whether equal differences or equal ratios of the value matter alike: how a search divides a range."
    )
    when: dict[str, Annotated[list[Scalar], Field(min_length=1)]] | None = optional(
        "Parameters and their values with which this one has an effect; a search sets it with no others.",
        min_length=1,
    )
    description: str = Field(default="", description="Effect of the parameter.")

    @model_validator(mode="after")
    def _default_fits(self) -> Self:
        if self.scale is not None and self.type not in {ParameterType.NUMBER, ParameterType.INTEGER}:
            raise ValueError(f"scale: means nothing to the type {self.type}")
        problem = self.problem(self.default)
        if problem:
            raise ValueError(f"default: {problem}")
        return self

    def problem(self, value: Scalar) -> str | None:
        """Say what is wrong with a value, or return None when it is allowed."""
        if value is None:
            return None if self.nullable else f"null is not allowed, only {self._allowed()}"
        if isinstance(value, str) and len(value) > TEXT_LIMIT:
            return f"{len(value)} characters are too many, at most {TEXT_LIMIT} are allowed"
        if not self._right_type(value) or (self.values is not None and value not in self.values):
            return f"{value!r} is not allowed, only {self._allowed()}"
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if number and self.minimum is not None and value < self.minimum:  # type: ignore[operator]
            return f"{value!r} is below the minimum, allowed: {self._allowed()}"
        if number and self.maximum is not None and value > self.maximum:  # type: ignore[operator]
            return f"{value!r} is above the maximum, allowed: {self._allowed()}"
        return None

    def _right_type(self, value: Scalar) -> bool:
        match self.type:
            case ParameterType.BOOLEAN:
                return isinstance(value, bool)
            case ParameterType.STRING:
                return isinstance(value, str)
            case ParameterType.INTEGER:
                return isinstance(value, int) and not isinstance(value, bool)
            case ParameterType.NUMBER:
                return isinstance(value, int | float) and not isinstance(value, bool)

    def _allowed(self) -> str:
        if self.values is not None:
            return "one of " + ", ".join(repr(value) for value in self.values)
        words = {
            "Number": "a number",
            "Integer": "an integer",
            "Boolean": "true or false",
            "String": "a text",
        }
        text = words[self.type]
        if self.minimum is not None and self.maximum is not None:
            text += f" from {self.minimum:g} to {self.maximum:g}"
        elif self.minimum is not None:
            text += f" of at least {self.minimum:g}"
        elif self.maximum is not None:
            text += f" of at most {self.maximum:g}"
        if self.unit:
            text += f" ({self.unit})"
        return text + (" or null" if self.nullable else "")


class PoseStamp(Choice):
    """The instant that a pose in trajectory.txt belongs to, and that its stamp names."""

    HEADER = "Header"
    RECORD = "Record"
    SCAN_START = "ScanStart"
    SCAN_MID = "ScanMid"
    SCAN_END = "ScanEnd"


class Poses(Choice):
    """Kinds of poses that an algorithm writes: those of all frames, or of keyframes alone."""

    FRAMES = "Frames"
    KEYFRAMES = "Keyframes"


class Output(Model):
    """Meaning of the poses that an algorithm writes, and the files that it writes them into."""

    frame: FrameOwner = Field(description="Whose pose is written: a role's sensor, or the body.")
    stamp: PoseStamp = Field(
        default=PoseStamp.HEADER, description="The instant that a pose and its stamp mean."
    )
    poses: Poses = Field(default=Poses.FRAMES, description="Every frame or keyframes alone.")
    gravity_aligned: bool = Field(default=False, description="Whether the world's z axis points up.")
    scale: bool = Field(default=True, description="Whether the trajectory is metric.")
    trajectory: PoseFile | None = optional(
        "File in which the program writes its final estimate; trajectory.txt is made of it. Default: the "
        "program writes trajectory.txt itself."
    )
    keyframes: PoseFile | None = optional(
        "File in which the program writes its keyframes beside that; trajectory.keyframes.txt is made of it."
    )

    def pose_files(self, frames: str) -> dict[str, Any] | None:
        """Return these files' description for supervisor and sidecar; None where there is nothing to tell.

        Args:
            frames: Where they find the stamps of the recording's frames.
        """
        return told_files(self.trajectory, self.keyframes, frames)

    @property
    def counts_frames(self) -> bool:
        """Tell whether a file has stamps that count from the recording's frames."""
        return any(file and file.told.stamps in BY_FRAMES for file in (self.trajectory, self.keyframes))


class OutputChange(Model):
    """Differences between the output in one sensor mode and the algorithm's usual output."""

    frame: FrameOwner | None = optional("Whose pose is written in this mode.")
    stamp: PoseStamp | None = optional("The instant that a pose and its stamp mean in this mode.")
    poses: Poses | None = optional("Every frame or keyframes alone, in this mode.")
    gravity_aligned: bool | None = optional("Whether the world's z axis points up in this mode.")
    scale: bool | None = optional("Whether the trajectory is metric in this mode.")
    trajectory: PoseFile | None = optional(
        "File of the final estimate in this mode; the mode has then no keyframes but its own."
    )
    keyframes: PoseFile | None = optional("File of the keyframes in this mode.")


class Mode(Model):
    """A sensor mode that an algorithm supports."""

    name: SensorMode = Field(description="Name of the mode.")
    roles: list[Role] = Field(default_factory=list, description="Roles it needs; default: the mode's own.")
    topics: list[Topic] | None = optional(
        "Topics of the recording that it is given beside its sensors', as they are."
    )
    output: OutputChange | None = optional("What differs in this mode.")

    @property
    def needs(self) -> tuple[Role, ...]:
        """Return the roles that a dataset must fill."""
        return tuple(self.roles) or ROLES[self.name]


class Asset(Model):
    """A file that an algorithm needs beside the recording, such as a vocabulary or weights."""

    name: AssetName = Field(
        description="File name under assets/ in the run folder, without colon, comma, quote or line break."
    )
    path: RelativePath | None = optional("File beside the Algorithm's own.")
    url: str | None = optional("Where to get it.", pattern=HTTPS)
    sha256: Sha256 | None = optional("Checksum of the file.")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.path is None) == (self.url is None):
            raise ValueError("give either path or url")
        if self.url is not None and self.sha256 is None:
            raise ValueError("a url needs its sha256")
        return self


class SettingsFile(Model):
    """A settings file that an algorithm reads, rendered from a template before each run."""

    path: SettingsPath = Field(description="Path of the file, below $SLAMHIVE_FILES.")
    template: str = Field(
        max_length=TEMPLATE_LIMIT,
        description="Jinja2 template of its text: see docs/settings-files.md for its names.",
    )

    @field_validator("template")
    @classmethod
    def _is_template(cls, text: str) -> str:
        read_template(text)
        return text


class LocalProgram(Model):
    """Program that runs an algorithm on a workstation without a container, and what it needs."""

    command: list[str] | None = optional(
        "Program in this folder, with its arguments, where it needs no adapter and no Python.", min_length=1
    )
    adapter: RelativePath = Field(default="adapter.py", description="Python program in this folder.")
    requirements: RelativePath = Field(
        default="requirements.txt", description="Python packages of its virtual environment."
    )
    python: str = Field(default=">=3.11", description="Versions of Python that it has packages for.")
    machines: list[str] = Field(default_factory=list, description="Machines, as in uname -m; empty: any.")
    system_packages: list[str] = Field(default_factory=list, description="Debian packages that it links to.")
    libraries: list[str] = Field(default_factory=list, description="Shared libraries that must be loadable.")

    @model_validator(mode="after")
    def _one_program(self) -> Self:
        if self.command is None:
            return self
        fields = type(self).model_fields
        # An API server fills in defaults: what is equal to one may not have been given.
        given = [
            name
            for name in ("adapter", "python", "requirements")
            if getattr(self, name) != fields[name].default
        ]
        if given:
            raise ValueError(f"command: a program of its own has no {', '.join(given)}; leave it out")
        if not re.match(RELATIVE_PATH, self.command[0]):
            raise ValueError(
                f"command: {self.command[0]!r} is no path below the folder of this file, which it must be"
            )
        return self

    @property
    def files(self) -> list[str]:
        """Return the files that have to be there."""
        return [self.adapter, self.requirements] if self.command is None else [self.command[0]]


class RealtimePolicy(Model):
    """Queue and drop policy in real time, for an algorithm that is slower than the sensor."""

    queue: int = Field(default=1, ge=1, description="Messages that wait at most.")
    drop: Literal["Oldest", "Newest"] = Field(
        default="Oldest", description="Message that goes when the queue is full."
    )


class AlgorithmSpec(Model):
    """A SLAM or odometry algorithm."""

    description: str = Field(default="", description="One sentence.")
    homepage: str | None = optional("Where the algorithm lives.")
    license: str | None = optional("Licence as an SPDX expression.")
    version: str | None = optional("Version of the algorithm.")
    image: Image | None = optional("Container image.")
    command: list[str] = Field(
        default_factory=list, description="Program in the container; default: its own."
    )
    local: LocalProgram | None = optional("How to run it without a container.")
    modes: list[Mode] = Field(min_length=1, description="Sensor modes.")
    recording: list[DataFormat] = Field(
        default_factory=lambda: [DataFormat.ROSBAG1], min_length=1, description="Formats it reads."
    )
    parameters: dict[str, Parameter] = Field(default_factory=dict, description="Parameters by name.")
    assets: list[Asset] = Field(default_factory=list, description="Files it needs.")
    files: list[SettingsFile] | None = optional(
        "Settings files that it reads, rendered before each run.", max_length=FILES_LIMIT
    )
    output: Output = Field(description="Meaning of its poses, and the files they are in.")
    paces: list[Pace] = Field(default_factory=lambda: [Pace.LOCKSTEP], min_length=1, description="Paces.")
    realtime: RealtimePolicy | None = optional("Queue and drop policy in real time.")
    ros1: Ros1 | None = optional(
        "In the paces Realtime and Stepped it is a ROS 1 node: how it is played to, where its poses are."
    )
    ros2: Ros2 | None = optional(
        "In the paces Realtime and Stepped it is a ROS 2 node: how it is played to, where its poses are."
    )
    deterministic: Literal["Yes", "No", "Unknown"] = Field(
        default="Unknown", description="Whether equal input and seed give equal output."
    )
    seed: Literal["Ignored", "Used"] = Field(default="Ignored", description="Use that it makes of the seed.")
    includes_reader: bool = Field(
        default=False,
        description="Whether its CPU time holds the reading of the recording, which it can't tell apart. "
        "Otherwise its metrics.json says what reading took; where it doesn't that isn't known.",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.image is None and self.local is None:
            raise ValueError("give an image, or local for a program without a container")
        names = [mode.name for mode in self.modes]
        if len(set(names)) != len(names):
            raise ValueError("modes: each mode may be named once")
        assets = [asset.name for asset in self.assets]
        if len(set(assets)) != len(assets):
            raise ValueError("assets: each name may be used once")
        self._check_files()
        self._check_conditions()
        if Pace.REALTIME in self.paces and self.realtime is None:
            raise ValueError("realtime: needed for the pace Realtime (queue and drop policy)")
        self._check_node()
        self._check_pose_files()
        for mode in self.modes:
            if mode.topics and all(form.is_folder for form in self.recording):
                forms = ", ".join(self.recording)
                raise ValueError(f"modes.topics: only a bag holds topics, and recording names {forms}")
            if not self.formats(mode):
                raise ValueError(f"recording: {misfit(self.recording, mode.needs, f'the mode {mode.name}')}")
        return self

    def _check_conditions(self) -> None:
        for name, parameter in self.parameters.items():
            for other, values in (parameter.when or {}).items():
                where = f"parameters.{name}.when.{other}"
                declared = self.parameters.get(other)
                if declared is None:
                    raise ValueError(
                        f"{where}: unknown parameter {other!r}{suggestion(other, self.parameters)}"
                    )
                problem = next(filter(None, map(declared.problem, values)), None)
                if problem:
                    raise ValueError(f"{where}: {problem}")
            if name in self.conditions(name):
                raise ValueError(f"parameters.{name}.when: depends on {name} itself")

    def conditions(self, name: str) -> set[str]:
        """Return all parameters that a parameter's effect depends on, by way of others too."""
        found: set[str] = set()
        ahead = [name]
        while ahead:
            further = set(self.parameters[ahead.pop()].when or ()) - found
            found |= further
            ahead += further & self.parameters.keys()
        return found

    def has_effect(self, name: str, parameters: Mapping[str, Scalar]) -> bool:
        """Tell whether a parameter has an effect beside others, of which those not given have defaults."""
        for other, values in (self.parameters[name].when or {}).items():
            given = other in parameters and self.has_effect(other, parameters)
            value = parameters[other] if given else self.parameters[other].default
            if (type(value) is bool, value) not in [(type(one) is bool, one) for one in values]:
                return False
        return True

    @property
    def node(self) -> RosNode | None:
        """Return the description of the ROS node that it is, None if it is none."""
        return self.ros1 or self.ros2

    def _check_node(self) -> None:
        name = "ros1" if self.ros1 is not None else "ros2"
        if self.node is None:
            if Pace.STEPPED in self.paces:
                raise ValueError("paces: Stepped is for ROS nodes alone; give ros1 or ros2, or leave it out")
            return
        if self.ros1 is not None and self.ros2 is not None:
            raise ValueError("ros2: an Algorithm is a node of ROS 1 or of ROS 2; leave one of them out")
        if not any(pace.is_played for pace in self.paces):
            raise ValueError(f"{name}: needs the pace Realtime or Stepped among paces")
        played = {"ros1": [DataFormat.ROSBAG1], "ros2": [DataFormat.ROSBAG2, DataFormat.MCAP]}[name]
        if not set(self.recording) <= set(played):
            raise ValueError(f"{name}: needs recording: [{', '.join(played)}], which is what is played")
        if self.ros2 is None:
            return
        paths = [file.path for file in self.files or ()]
        if self.ros2.parameters is not None and self.ros2.parameters not in paths:
            known = ", ".join(paths) or "none"
            raise ValueError(f"ros2.parameters: {self.ros2.parameters!r} is none of files; known: {known}")
        if self.ros2.renames and self.image is not None and not self.command:
            raise ValueError("ros2.arguments: needs command beside image, to which the arguments are added")

    def _check_files(self) -> None:
        paths = [file.path for file in self.files or ()]
        if len(set(paths)) != len(paths):
            raise ValueError("files: each path may be used once")
        folders = {path: other for other in paths for path in paths if other.startswith(f"{path}/")}
        for path, other in folders.items():
            raise ValueError(f"files: {path!r} can't be a file and the folder of {other!r}")
        size = sum(len(file.template.encode("utf-8", "replace")) for file in self.files or ())
        if size > TEMPLATES_LIMIT:
            raise ValueError(
                f"files: the templates have {size} bytes in all, at most {TEMPLATES_LIMIT} are allowed"
            )
        roles = {str(role) for mode in self.modes for role in mode.needs}
        for index, file in enumerate(self.files or ()):
            try:
                read_template(file.template, self.parameters, roles)
            except ValueError as error:
                raise ValueError(f"files.{index}.template: {error}") from None

    @property
    def templates(self) -> list[tuple[str, str]]:
        """Return path and template of each settings file."""
        return [(file.path, file.template) for file in self.files or ()]

    def _check_pose_files(self) -> None:
        name = "ros1" if self.ros1 is not None else "ros2"
        sources = [self.node.poses, self.node.keyframes] if self.node is not None else []
        moved = any(source and source.stamp for source in sources)
        for mode in self.modes:
            output = self.output_of(mode)
            if moved and output.stamp not in (PoseStamp.SCAN_START, PoseStamp.SCAN_MID, PoseStamp.SCAN_END):
                raise ValueError(
                    f"output.stamp: where {name}.poses.stamp says how messages are stamped, expected "
                    f"ScanStart, ScanMid or ScanEnd in the mode {mode.name}, not {output.stamp}"
                )
            if self.node is not None and (output.trajectory or output.keyframes):
                raise ValueError(
                    "output.trajectory: a ROS node's poses are those that it publishes; leave out "
                    f"trajectory and keyframes ({name}.keyframes has theirs), or {name}"
                )
            if Pace.STEPPED in self.paces and output.poses is not Poses.FRAMES:
                raise ValueError(
                    "paces: Stepped waits for the pose of each frame, and in the mode "
                    f"{mode.name} output.poses is {output.poses}"
                )
            if output.counts_frames and output.stamp is not PoseStamp.HEADER:
                raise ValueError(
                    "output.stamp: a frame index means the header stamp of its frame; expected Header in "
                    f"the mode {mode.name}, not {output.stamp}"
                )

    def formats(self, mode: Mode) -> list[DataFormat]:
        """Return the formats that it reads and that hold a mode's sensors, the preferred first."""
        fitting = fitting_formats(self.recording, mode.needs)
        return [form for form in fitting if not (mode.topics and form.is_folder)]

    def plays(self, pace: str) -> RosNode | None:
        """Return the ROS node that a run of a pace is played to, None when it reads by itself."""
        return self.node if Pace(pace).is_played else None

    def mode(self, name: SensorMode | None) -> Mode:
        """Return a mode by name, or the only one.

        Raises:
            InputError: the algorithm has no such mode, or several and none was named.
        """
        if name is None:
            if len(self.modes) == 1:
                return self.modes[0]
            raise InputError(f"sensors: name one of {', '.join(mode.name for mode in self.modes)}")
        for mode in self.modes:
            if mode.name == name:
                return mode
        raise UnknownNameError("sensor mode", name, [mode.name for mode in self.modes], "sensors")

    def output_of(self, mode: Mode) -> Output:
        """Return the output of a mode: the poses and their meaning."""
        if mode.output is None:
            return self.output
        changes = {name: value for name, value in mode.output if value is not None}
        if "trajectory" in changes:
            changes.setdefault("keyframes", None)
        return self.output.replace(**changes)

    def fill(self, parameters: dict[str, Scalar]) -> dict[str, Scalar]:
        """Return all parameters with defaults filled in, sorted by name.

        Raises:
            InputError: a parameter is unknown, its value is not allowed, or they are too long in all.
        """
        for name, value in parameters.items():
            declared = self.parameters.get(name)
            if declared is None:
                raise InputError(
                    f"parameters.{name}: unknown parameter {name!r}{suggestion(name, self.parameters)}"
                )
            problem = declared.problem(value)
            if problem:
                raise InputError(f"parameters.{name}: {problem}")
        filled = {
            name: parameters.get(name, self.parameters[name].default) for name in sorted(self.parameters)
        }
        size = len(json.dumps(filled, ensure_ascii=False).encode())
        if size > PARAMETERS_LIMIT:
            raise InputError(
                f"parameters: they take {size} bytes, at most {PARAMETERS_LIMIT} reach a container"
            )
        return filled


class Algorithm(Resource):
    """The catalog entry of an algorithm."""

    kind: Literal["Algorithm"] = "Algorithm"
    spec: AlgorithmSpec


__all__ = [
    "Algorithm",
    "AlgorithmSpec",
    "DataFormat",
    "Mode",
    "Name",
    "Output",
    "Pace",
    "Parameter",
    "RecordingFormat",
    "RelativePath",
]
