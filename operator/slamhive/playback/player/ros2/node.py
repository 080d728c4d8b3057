# SPDX-License-Identifier: Apache-2.0
"""The player's nodes of ROS 2: what they publish, who takes it, and who else is there."""

from __future__ import annotations

import resource
import struct
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy  # type: ignore[import-not-found]
from rclpy.context import Context  # type: ignore[import-not-found]
from rclpy.event_handler import PublisherEventCallbacks  # type: ignore[import-not-found]
from rclpy.executors import SingleThreadedExecutor  # type: ignore[import-not-found]
from rclpy.qos import (  # type: ignore[import-not-found]
    DurabilityPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)
from rosgraph_msgs.msg import Clock  # type: ignore[import-not-found]

from slamhive.playback.player.poses import NANOSECONDS, POSE_TYPES
from slamhive.playback.player.ros2.listening import EARS, MESSAGES, Ros2Ears, everything
from slamhive.playback.player.ros2.overrides import overrides, undeclared
from slamhive.playback.player.ros2.parameters import ParameterQuestion
from slamhive.playback.player.ros2.strangers import Strangers
from slamhive.playback.player.ros2.types import forget_errors, is_by_name, message_type
from slamhive.playback.player.wire import Obstacle
from slamhive.playback.protocol import PlayError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from slamhive.playback.player.recorder import Track
    from slamhive.playback.player.ros2.bags import RecordedTopic
    from slamhive.playback.player.ros2.overrides import Overrides
    from slamhive.playback.player.wire import Message
    from slamhive.playback.protocol import PlayRequest, PoseSource

PLAYER = "slamhive_player"
_CLOCK, _LITTLE_ENDIAN = struct.Struct("<4siI"), b"\0\1\0\0"
"""A Clock as CDR."""
_OWN = (PLAYER, EARS)
_ALONE_SECONDS = 0.4
"""Time in which all that are on a domain are seen: participants answer a newcomer at once."""
_MATCH_SECONDS = 1.0
"""Time that a node's side of a match may take after ours."""
_ANSWERED_SECONDS = 0.1
"""The same of a node that answers already: what was announced before the question is known to it."""
_MEANT_SECONDS = 3.0
"""Time after a node in which another one, whose parameters a file has, may start."""
_REMARK_SECONDS = 3.0
"""Time in which nodes are asked for their parameters at the end."""
_BLOCKED_SECONDS = 5.0
_WAITING_BYTES = 600 << 20
"""Of messages that a node doesn't take, until playing to it ends."""
_COMMON = ("/clock", "/parameter_events", "/rosout")


class PlayerNode:
    """The nodes of a player on a domain: one that publishes, one that listens.

    Args:
        request: What to play.
        domain: Where.
        topics: What the recording says of each topic, by the name under which it is played.
        sources: Where poses come from, with who takes them.

    Raises:
        PlayError: rclpy doesn't begin, or a type isn't known.
    """

    def __init__(
        self,
        request: PlayRequest,
        domain: int,
        topics: Mapping[str, RecordedTopic],
        sources: Iterable[tuple[PoseSource, Track]],
    ) -> None:
        self._request = request
        self._domain = domain
        self._topics = topics
        self._refused: dict[str, str] = {}
        self._matched_at: float | None = None
        self._meant: list[Overrides] | None = None
        self._meant_at: float | None = None
        self._guards: dict[str, ParameterQuestion] = {}
        self._slowest = 0.0
        self._context = Context()
        try:
            rclpy.init(args=[], context=self._context, domain_id=domain)
            self._node = rclpy.create_node(
                PLAYER, context=self._context, start_parameter_services=False, enable_rosout=False
            )
            self._begin = time.monotonic()
            kinds = {topic: message_type(one.type, one.digest) for topic, one in topics.items()}
            made = {topic: self._publisher(topic, kind) for topic, kind in kinds.items()}
            self._publishers = {topic: one for topic, one in made.items() if one is not None}
            forget_errors()
            sensors = {topic: kinds[topic] for topic in request.topics.values()}
            self._ears = Ros2Ears(self._context, sources, sensors, hasty=request.stepped)
            forget_errors()
        except PlayError:
            raise
        except Exception as error:  # noqa: BLE001 - rclpy raises its own, and RuntimeError
            raise PlayError(f"ROS 2 doesn't begin: {error}") from None
        self._clock = self._node.create_publisher(Clock, "/clock", QoSProfile(depth=10))
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        heard = dict.fromkeys(_COMMON, False) | dict.fromkeys((*topics, request.poses.topic), True)
        self._strangers = Strangers(self._node, request.algorithm, heard, _OWN)
        self._memory = _resident()

    def _publisher(self, topic: str, kind: type) -> Any:
        asked = self._request.qos.get(topic, {})
        best_effort = asked.get("reliability") == "BestEffort"
        latched = asked.get("durability") == "TransientLocal" or (
            "durability" not in asked and self._topics[topic].latched
        )
        qos = everything(
            ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
            DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )

        def refused(event: Any) -> None:
            self._refused[topic] = qos_policy_name_from_kind(event.last_policy_kind)

        events = PublisherEventCallbacks(incompatible_qos=refused)
        try:
            return self._node.create_publisher(kind, topic, qos, event_callbacks=events)
        except RuntimeError:
            if not is_by_name(kind):
                raise
        # Releases before Kilted can't publish what they know by its name alone.
        package, _, short = self._topics[topic].type.partition("/msg/")
        told = f"{topic} can't be played: install the package {package} of ROS 2, which has its type {short}"
        if topic in self._request.topics.values():
            raise PlayError(told)
        sys.stderr.write(f"{told}\n")
        return None

    def heard(self) -> Mapping[str, int]:
        """Number of messages that the witness heard, by the topic."""
        return self._ears.heard()

    def publish(self, message: Message) -> None:
        """Publish a message.

        Raises:
            PlayError: It took so long that nothing can be played by the clock any more.
        """
        begin = time.monotonic()
        if message.topic in self._publishers:
            self._publishers[message.topic].publish(message.data)
        self._slowest = max(self._slowest, time.monotonic() - begin)

    def tick(self, now: int) -> None:
        """Publish the simulated time, ns."""
        seconds, nanoseconds = divmod(now, NANOSECONDS)
        self._clock.publish(_CLOCK.pack(_LITTLE_ENDIAN, seconds, nanoseconds))

    def numbers(self) -> dict[str, Any]:
        """Return the facts about the node that belong into metrics.json."""
        told = [guard.simulated for guard in self._guards.values() if guard.simulated is not None]
        return {"usesSimulatedTime": any(told)} if told else {}

    def remark(self) -> str:
        """Return a sentence about parameters that are set and no node declares; empty where there are none.

        Asked at the end, when nodes have time to answer and have declared what they do late.
        """
        given, deadline = overrides(self._request.algorithm), time.monotonic() + _REMARK_SECONDS
        declared: dict[str, frozenset[str] | None] = {}
        for name, guard in self._guards.items():
            names = {parameter for one in given if one.is_for(name) for parameter in one.names}
            in_time = bool(names) and time.monotonic() < deadline
            declared[name] = guard.declared(names, self._executor) if in_time else None
        return undeclared(given, declared)

    def others(self, stopped: Callable[[], bool]) -> list[str]:
        """Return the nodes that are on the domain before the algorithm is."""
        while True:
            found = sorted(set(self._nodes()))
            if found or time.monotonic() > self._begin + _ALONE_SECONDS or stopped():
                return found
            self._executor.spin_once(timeout_sec=0.05)

    def _nodes(self) -> list[str]:
        """Return the names of nodes that aren't ours."""
        names = self._node.get_node_names_and_namespaces()
        return [f"{space.rstrip('/')}/{name}" for name, space in names if name not in _OWN]

    @property
    def has_poses(self) -> bool:
        """True if a publisher of poses is there, of the type that was named."""
        return any(
            one.topic_type == MESSAGES[self._request.poses.type]
            for one in self._node.get_publishers_info_by_topic(self._request.poses.topic)
            if one.node_name not in _OWN
        )

    def published(self) -> list[str]:
        """Return the topics of poses that nodes that aren't ours publish, each with its type."""
        found: set[str] = set()
        for name, space in self._node.get_node_names_and_namespaces():
            if name not in _OWN:
                with suppress(RuntimeError):  # it went meanwhile
                    ends = self._node.get_publisher_names_and_types_by_node(name, space)
                    found |= {f"{topic} ({kind})" for topic, kinds in ends for kind in kinds}
        return sorted(one for one in found if one.rpartition("/")[2].rstrip(")") in POSE_TYPES)

    def obstacle(self, begin: int) -> Obstacle | None:
        """Return the obstacle to playing to the node now, None if there is none.

        Args:
            begin: The first moment of the recording, ns: some nodes wait for a time before they subscribe.
        """
        self._executor.spin_once(timeout_sec=0.0)
        if self._clock.get_subscription_count():
            self.tick(begin)
        found = self._not_taken() or self._other_poses()
        if found is not None:
            self._matched_at = None
            return found
        now = time.monotonic()
        if self._matched_at is None:
            self._matched_at = now
        silent = self._not_answering()
        # Who answers is connected, and hears the rest a moment later.
        answers = silent is None and bool(self._guards)
        if now < self._matched_at + (_ANSWERED_SECONDS if answers else _MATCH_SECONDS):
            return Obstacle("was not connected")
        return silent or self._not_meant()

    def _not_taken(self) -> Obstacle | None:
        """Return the fault of the node's subscriptions."""
        silent = []
        for topic in sorted(set(self._request.topics.values())):
            # The witness is one of them.
            if self._publishers[topic].get_subscription_count() > 1:
                continue
            recorded = self._topics[topic].type
            ends = self._node.get_subscriptions_info_by_topic(topic)
            types = sorted({one.topic_type for one in ends if one.node_name not in _OWN} - {recorded})
            if types:
                return Obstacle(
                    f"did not subscribe to {topic} as {recorded}", f"it subscribes as {', '.join(types)}"
                )
            if topic in self._refused:
                return Obstacle(
                    f"did not subscribe to {topic} in a way that fits",
                    f"it asks for a {self._refused[topic].lower()} that isn't offered (ros2.qos in its "
                    "Algorithm)",
                )
            silent.append(topic)
        if not silent:
            return None
        taken = ", ".join(self._taken()) or "nothing"
        return Obstacle(
            f"did not subscribe to {', '.join(silent)}",
            f"it subscribes to {taken} (ros2.topics in its Algorithm has its names)",
        )

    def _taken(self) -> list[str]:
        """Return the topics that nodes that aren't ours subscribe to."""
        found: set[str] = set()
        for name, space in self._node.get_node_names_and_namespaces():
            if name not in _OWN:
                with suppress(RuntimeError):  # it went meanwhile
                    found |= {
                        topic for topic, _ in self._node.get_subscriber_names_and_types_by_node(name, space)
                    }
        return sorted(found.difference(_COMMON))

    def _other_poses(self) -> Obstacle | None:
        """Return the fault of the poses that the node announces."""
        for source in filter(None, (self._request.poses, self._request.keyframes)):
            ends = self._node.get_publishers_info_by_topic(source.topic)
            types = {one.topic_type for one in ends if one.node_name not in _OWN}
            wanted = MESSAGES[source.type]
            if types and wanted not in types:
                return Obstacle(
                    f"did not publish {source.topic} as {wanted}",
                    f"it publishes it as {', '.join(sorted(types))} (ros2.poses in its Algorithm)",
                )
        return None

    def _not_answering(self) -> Obstacle | None:
        """Return the fault of the transport: a node that has services of parameters answers over it."""
        for name in self._nodes():
            if name not in self._guards:
                self._guards[name] = ParameterQuestion(self._node, name)
            if not self._guards[name].is_over():
                return Obstacle(
                    f"{name} did not answer",
                    "it is connected, but nothing reaches it: player and node need one /dev/shm and one user",
                    "SystemFault",
                )
        return None

    def _not_meant(self) -> Obstacle | None:
        """Return the fault of a params file: of one for nodes of other names, ROS 2 takes nothing, silently.

        Raises:
            PlayError: It has been so for as long as further nodes may take to start.
        """
        nodes, file = self._nodes(), self._request.parameters
        if not nodes or file is None:
            return None
        if self._meant is None:
            given = overrides(self._request.algorithm)
            self._meant = [one for one in given if one.source.endswith(f"/{file}")]
        if not self._meant or any(one.is_for(name) for one in self._meant for name in nodes):
            return None
        self._meant_at = self._meant_at or time.monotonic()
        if time.monotonic() > self._meant_at + _MEANT_SECONDS:
            meant = ", ".join(one.section for one in self._meant)
            raise PlayError(
                f"ros2.parameters: the file is for {meant}, and the nodes are "
                f"{', '.join(sorted(set(nodes)))}, which take nothing of it; above ros__parameters stands a "
                "node's name, or /** for any",
                "AlgorithmFailed",
            )
        return Obstacle("took no parameters")

    def check(self) -> None:
        """Make sure that nobody else is on the domain, and that the node takes what is played.

        Raises:
            PlayError: A foreign node is there, or messages pile up.
        """
        foreign = self._strangers.found()
        if foreign:
            raise PlayError(
                f"a node of another program came to the run's ROS 2 domain {self._domain}: "
                f"{', '.join(foreign)}"
            )
        waiting = _resident() - self._memory
        if waiting > _WAITING_BYTES or self._slowest > _BLOCKED_SECONDS:
            what = f"{waiting >> 20} MiB of messages wait for it"
            if self._slowest > _BLOCKED_SECONDS:
                what = f"publishing took {self._slowest:.1f} s"
            raise PlayError(f"the node doesn't take its messages: {what}", "AlgorithmFailed")

    def end(self) -> None:
        """Leave the domain."""
        self._ears.end()
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        self._context.try_shutdown()


def _resident() -> int:
    """Return the memory that this process holds, bytes, files and shared memory left out."""
    resident, shared = Path("/proc/self/statm").read_text(encoding="ascii").split()[1:3]
    return (int(resident) - int(shared)) * resource.getpagesize()
