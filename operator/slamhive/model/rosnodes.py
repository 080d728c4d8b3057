# SPDX-License-Identifier: Apache-2.0
"""Options of an Algorithm that is a ROS node: playing recordings to it, and taking its poses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from slamhive.model.base import Choice, Duration, Model, SettingsPath, optional, worded
from slamhive.model.sensors import Role

if TYPE_CHECKING:
    from collections.abc import Iterable

_WORD = r"[A-Za-z][A-Za-z0-9_]*"
_TOPIC = worded(
    rf"^(/{_WORD})+$", "expected a topic such as /camera/left: a letter after each /, then letters, digits, _"
)
_FRAME = worded(
    r"^[A-Za-z0-9_][A-Za-z0-9_/.-]*$", "expected a frame such as base_link: letters, digits, _ / . and -"
)
RosTopic = Annotated[str, StringConstraints(pattern=_TOPIC, max_length=255)]
_NAME = worded(
    rf"^(~?/)?({_WORD})(/{_WORD})*$",
    "expected a topic such as /points, points or ~/points: a letter after each /, then letters, digits, _",
)
RosName = Annotated[str, StringConstraints(pattern=_NAME, max_length=255)]
RosFrame = Annotated[str, StringConstraints(pattern=_FRAME, max_length=255)]


class PoseMessage(Choice):
    """A message that carries poses."""

    POSE_STAMPED = "PoseStamped"
    POSE_WITH_COVARIANCE_STAMPED = "PoseWithCovarianceStamped"
    ODOMETRY = "Odometry"
    PATH = "Path"
    TF = "TF"


class RosPoses(Model):
    """The topic on which a node publishes its poses."""

    topic: RosTopic = Field(description="The topic; /tf for transforms.")
    type: PoseMessage = Field(
        description="Type of its messages. A Path's last message is the final estimate; TF needs two frames."
    )
    parent: RosFrame | None = Field(default=None, description="TF: the frame of the algorithm's world.")
    frame: RosFrame | None = Field(default=None, description="TF: the frame whose pose is taken.")
    stamp: Literal["ScanStart", "ScanMid", "ScanEnd"] | None = Field(
        default=None,
        description="The instant of a scan that its messages are stamped with, where that isn't "
        "output.stamp: their stamps are moved from the one to the other.",
    )

    @model_validator(mode="after")
    def _frames_for_transforms(self) -> Self:
        given = [self.parent is not None, self.frame is not None]
        if self.type is PoseMessage.TF and not all(given):
            raise ValueError("parent: TF needs parent and frame, the two frames between which the pose is")
        if self.type is not PoseMessage.TF and any(given):
            raise ValueError("parent: parent and frame are for TF alone")
        return self


class RosNode(Model):
    """A ROS node: a player beside it plays the recording and records its poses."""

    ros: ClassVar[int]
    """1 or 2: the ROS that it is of."""

    poses: RosPoses = Field(description="Source of its poses.")
    keyframes: RosPoses | None = optional(
        "Where the poses of its keyframes come from, beside the others: trajectory.keyframes.txt is made of "
        "them."
    )
    ready: Duration = Field(
        default="2m", description="Time that it may take to subscribe to its sensors' topics."
    )
    step: Duration = Field(
        default="2s",
        description="Pace Stepped: time that a frame's pose is waited for before the next frame is played.",
    )
    settle: Duration = Field(
        default="2s", description="Time without a new pose, after the last message, that it counts as done."
    )
    end: Duration = Field(default="30s", description="Time that it may take to end after SIGINT.")


def _check_roles(names: Iterable[str], field: str) -> None:
    known = [str(role) for role in Role]
    for role in names:
        if role not in known:
            raise ValueError(f"{field}: its keys are roles: {', '.join(known)}; not {role!r}")


class Ros1(RosNode):
    """A ROS 1 node: a player beside it plays the recording and records its poses."""

    ros = 1

    topics: dict[str, RosTopic] = Field(
        default_factory=dict,
        description="Topic on which it takes a role's messages, such as lidar: /velodyne_points; default: "
        "the recording's own, as config.yaml names it.",
    )

    @model_validator(mode="after")
    def _known_roles(self) -> Self:
        _check_roles(self.topics, "topics")
        return self


class Reliability(Choice):
    """Reliability that the player offers: every message again until it came, or once."""

    RELIABLE = "Reliable"
    BEST_EFFORT = "BestEffort"


class Durability(Choice):
    """Durability that the player offers: none, or the last message for who comes later."""

    VOLATILE = "Volatile"
    TRANSIENT_LOCAL = "TransientLocal"


class OfferedQos(Model):
    """Quality of service with which the player offers a role's messages."""

    reliability: Reliability = Field(
        default=Reliability.RELIABLE,
        description="Reliable fits every node; BestEffort loses what the node is too slow for.",
    )
    durability: Durability | None = optional("TransientLocal keeps the last message; default: as recorded.")


class RosArguments(Choice):
    """Arguments with which a ROS 2 node is started beside its command's own."""

    NONE = "None"
    ROS = "Ros"


class Ros2(RosNode):
    """A ROS 2 node: a player beside it plays the recording and records its poses."""

    ros = 2

    topics: dict[str, RosName] = Field(
        default_factory=dict,
        description="Name of the topic on which it takes a role's messages, such as lidar: /points; default: "
        "the recording's own, as config.yaml names it. With arguments: Ros the node is told where to look "
        "instead, and its name may be relative or private (~/points).",
    )
    arguments: RosArguments = Field(
        default=RosArguments.NONE,
        description="Ros: its command gets --ros-args with use_sim_time:=true, its topics renamed to the "
        "recording's, and parameters. None: the command as it is; it has to set use_sim_time itself.",
    )
    parameters: SettingsPath | None = optional(
        "One of files, which is passed as --params-file; needs arguments: Ros."
    )
    rmw: str | None = optional(
        "RMW_IMPLEMENTATION of player and node, such as rmw_cyclonedds_cpp, where ROS has it; default: "
        "rmw_fastrtps_cpp.",
        pattern=worded(r"^rmw_[a-z0-9_]+$", "expected the name of an rmw, such as rmw_fastrtps_cpp"),
        max_length=64,
    )
    qos: dict[str, OfferedQos] = Field(
        default_factory=dict,
        description="Quality of service of a role's messages where the default won't do: reliable, all kept, "
        "and latched where it was recorded so.",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _check_roles(self.topics, "topics")
        _check_roles(self.qos, "qos")
        if self.arguments is RosArguments.NONE:
            if self.parameters is not None:
                raise ValueError("parameters: needs arguments: Ros, by which the node is told of the file")
            for role, name in self.topics.items():
                if not name.startswith("/"):
                    raise ValueError(
                        f"topics.{role}: {name!r} is relative, which needs arguments: Ros; "
                        "expected a topic such as /points"
                    )
        return self

    @property
    def renames(self) -> bool:
        """Tell whether the node looks for the recording's topics, not the player for the node's."""
        return self.arguments is RosArguments.ROS
