# SPDX-License-Identifier: Apache-2.0
"""Options of an Algorithm that is a ROS 1 node: playing recordings to it, and taking its poses."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from slamhive.model.base import Choice, Duration, Model, optional, worded
from slamhive.model.sensors import Role

_WORD = r"[A-Za-z][A-Za-z0-9_]*"
_TOPIC = worded(
    rf"^(/{_WORD})+$", "expected a topic such as /camera/left: a letter after each /, then letters, digits, _"
)
_FRAME = worded(
    r"^[A-Za-z0-9_][A-Za-z0-9_/.-]*$", "expected a frame such as base_link: letters, digits, _ / . and -"
)
RosTopic = Annotated[str, StringConstraints(pattern=_TOPIC, max_length=255)]
RosFrame = Annotated[str, StringConstraints(pattern=_FRAME, max_length=255)]


class PoseMessage(Choice):
    """A message that carries poses."""

    POSE_STAMPED = "PoseStamped"
    POSE_WITH_COVARIANCE_STAMPED = "PoseWithCovarianceStamped"
    ODOMETRY = "Odometry"
    PATH = "Path"
    TF = "TF"


class Ros1Poses(Model):
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


class Ros1(Model):
    """A ROS 1 node: a player beside it plays the recording and records its poses."""

    poses: Ros1Poses = Field(description="Source of its poses.")
    topics: dict[str, RosTopic] = Field(
        default_factory=dict,
        description="Topic on which it takes a role's messages, such as lidar: /velodyne_points; default: "
        "the recording's own, as config.yaml names it.",
    )
    keyframes: Ros1Poses | None = optional(
        "Where the poses of its keyframes come from, beside the others: trajectory.keyframes.txt is made of "
        "them."
    )
    ready: Duration = Field(
        default="2m", description="Time that it may take to subscribe to its sensors' topics."
    )
    settle: Duration = Field(
        default="2s", description="Time without a new pose, after the last message, that it counts as done."
    )
    end: Duration = Field(default="30s", description="Time that it may take to end after SIGINT.")

    @model_validator(mode="after")
    def _known_roles(self) -> Self:
        known = [str(role) for role in Role]
        for role in self.topics:
            if role not in known:
                raise ValueError(f"topics: its keys are roles: {', '.join(known)}; not {role!r}")
        return self
