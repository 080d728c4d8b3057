# SPDX-License-Identifier: Apache-2.0
"""Protocol with the player: its request, and the files in which it reports. Standard library alone."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any, Self

VARIABLE = "SLAMHIVE_PLAYER"
"""Variable that holds a request, or the path of a file with one."""

NODE_FILE, READY_FILE = "node.json", "ready"
"""In the player's folder: the variables by which a node finds the player; there when one may be started."""

PROFILE_FILE = "fastdds.xml"
"""In the player's folder: the transport of ROS 2 that player and node share."""

LEAST_SHARED_MEMORY = 96 << 20
"""Bytes of /dev/shm that a ROS 2 node and its player need; the player's segment takes a third of that."""

LOOPBACK = "127.0.0.1"
"""Nodes answer there alone, so that nothing outside the machine, or the pod, reaches them."""

REPORT_FILE = "playback.json"
"""In the output folder: how far playing has come, and what went wrong."""


@dataclass(frozen=True)
class PoseSource:
    """Source of the poses that a ROS node publishes: topic, message type, frames, shift of stamps.

    Attributes:
        topic: The topic.
        type: PoseStamped, PoseWithCovarianceStamped, Odometry, Path or TF.
        parent: Of TF: the frame of the world.
        frame: Of TF: the frame whose pose is taken.
        moved: To add to stamps beside the sensor's offset, so that they name the instant that poses mean, s.
    """

    topic: str
    type: str
    parent: str | None = None
    frame: str | None = None
    moved: float = 0.0


@dataclass(frozen=True)
class FrameSource:
    """The messages that count as frames, for latency and drops.

    Attributes:
        topic: The topic as the algorithm takes it.
        period: Time between two of them, s.
        match: Which frame a pose belongs to. At: the one of its stamp. After: its stamp lies after the
            frame's, as that of a scan's end does; Before: the other way round.
        time_offset: To add to header stamps to get sensor time, s.
        every: Whether each frame is to have a pose, so that one without has been dropped.
    """

    topic: str
    period: float
    match: str = "At"
    time_offset: float = 0.0
    every: bool = True


@dataclass(frozen=True)
class PlayRequest:
    """Request to the player: the recording, the algorithm's topics and poses, speed and time limits.

    Attributes:
        recording: Path of the bag.
        ros: 1 or 2: the ROS that the node is of.
        output: The run's output folder.
        folder: A folder of the player's own.
        algorithm: NAME=VALUE that the algorithm's processes, and no others, have in their environment.
        topics: The topics of sensors, by their name in the bag: the name under which they are played. The
            node must take all of these before the recording is played.
        remap: More topics to rename, such as a camera's calibration.
        poses: Where poses come from.
        frames: What counts as a frame.
        keyframes: Where the poses of keyframes come from, beside the others.
        rate: Speed of playing.
        stepped: Whether time stands before each frame until the pose of the last one has come.
        step_seconds: How long it stands at most.
        qos: Of ROS 2: by the name of a topic as it is played, `reliability` and `durability` as an Algorithm
            has them, where the default won't do.
        rmw: Of ROS 2: the RMW_IMPLEMENTATION of player and node.
        parameters: Of ROS 2: the node's params file, below the folder of settings files; None where it has
            none.
        domain: Of ROS 2: the domain to meet in; None for one of this machine that is free.
        data_seconds: Length of the recording.
        port: Of the ROS master; 0 for any that is free.
        ready_seconds: How long the node may take to be ready.
        settle_seconds: How long without a pose means that it is done.
        end_seconds: How long it may take to end when asked.
        stay: Whether to stay, when all is done, until asked to go.
    """

    recording: str
    ros: int
    output: str
    folder: str
    algorithm: str
    topics: dict[str, str]
    poses: PoseSource
    frames: FrameSource
    keyframes: PoseSource | None = None
    remap: dict[str, str] = field(default_factory=dict)
    rate: float = 1.0
    stepped: bool = False
    step_seconds: float = 2.0
    qos: dict[str, dict[str, str]] = field(default_factory=dict)
    rmw: str = "rmw_fastrtps_cpp"
    parameters: str | None = None
    domain: int | None = None
    data_seconds: float | None = None
    port: int = 0
    ready_seconds: float = 120.0
    settle_seconds: float = 2.0
    end_seconds: float = 30.0
    stay: bool = False

    def to_json(self) -> str:
        """Return the request as JSON."""
        return json.dumps(asdict(self), separators=(",", ":"))

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Read a request.

        Raises:
            ValueError: It is none.
        """
        try:
            values: dict[str, Any] = json.loads(text)
            parts = {"poses": PoseSource(**values["poses"]), "frames": FrameSource(**values["frames"])}
            if values.get("keyframes") is not None:
                parts["keyframes"] = PoseSource(**values["keyframes"])
            return cls(**{**values, **parts})
        except (TypeError, KeyError) as error:
            raise ValueError(
                f"no request for this player, whose image may be older than slamhive: {error}"
            ) from None


class PlayError(Exception):
    """Playing failed; the message is the sentence that the run ends with.

    Args:
        message: What went wrong.
        reason: AlgorithmFailed if the node is to blame, SystemFault if the machine is.
    """

    def __init__(self, message: str, reason: str = "SystemFault") -> None:
        super().__init__(message)
        self.reason = reason


def ros1_variables(uri: str, folder: str) -> dict[str, str]:
    """Return the variables with which a node finds the master, and nobody else finds the node.

    Args:
        uri: Where the master answers.
        folder: One that is there for ROS to write into: what it makes itself it wants to own like its parent.
    """
    return {
        "ROS_MASTER_URI": uri,
        "ROS_IP": LOOPBACK,
        "ROS_HOSTNAME": LOOPBACK,
        "ROS_HOME": folder,
        "ROS_LOG_DIR": folder,
    }


def ros2_variables(domain: int, profile: str, rmw: str, folder: str) -> dict[str, str]:
    """Return the variables with which a node meets the player, and nobody else.

    Args:
        domain: The domain.
        profile: Path of the transport's profile, as the node sees it.
        rmw: Its RMW_IMPLEMENTATION.
        folder: One that is there for ROS to write into.
    """
    return {
        "ROS_DOMAIN_ID": str(domain),
        # The profile allows the loopback interface alone; other makes than Fast DDS are told by this.
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_STATIC_PEERS": "",
        # The second is the name that Fast DDS of Jazzy and older reads.
        "FASTDDS_DEFAULT_PROFILES_FILE": profile,
        "FASTRTPS_DEFAULT_PROFILES_FILE": profile,
        "RMW_IMPLEMENTATION": rmw,
        "ROS_LOG_DIR": folder,
    }
