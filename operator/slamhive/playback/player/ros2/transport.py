# SPDX-License-Identifier: Apache-2.0
"""Transport that player and node share: shared memory, and UDP on the loopback interface; their domain.

Shared memory with a segment that holds several frames is what loses no cloud of 2 MB whatever the rest is set
to (Fast DDS 2.14 and 3.2); UDP is for discovery, and for peers that have nothing else.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress
from pathlib import Path

from slamhive.playback.protocol import LEAST_SHARED_MEMORY, LOOPBACK, PlayError

SHARED_MEMORY = "/dev/shm"  # noqa: S108 - the place where every Fast DDS has it
_SEGMENT, _MESSAGE, _SOCKET = 32 << 20, 8 << 20, 4 << 20
_NODE_SEGMENT, _NODE_MESSAGE = 8 << 20, 4 << 20
"""Of each process of the node. A segment is written whole when it is made, so it counts as the process's
memory; this one loses no reliable Path of 11 MB, and no best-effort one of 3 MB."""
_FRAMES = 4
"""Of the largest messages, that a segment holds at least."""
_FIRST, _LAST = 1, 100
"""Domains whose ports Linux gives to nobody else; 0 is everybody's."""

_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com">{library}
  <profiles>
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>slamhive_shm</transport_id>
        <type>SHM</type>
        <segment_size>{segment}</segment_size>
        <maxMessageSize>{message}</maxMessageSize>
      </transport_descriptor>
      <transport_descriptor>
        <transport_id>slamhive_udp</transport_id>
        <type>UDPv4</type>
        <sendBufferSize>{socket}</sendBufferSize>
        <receiveBufferSize>{socket}</receiveBufferSize>
        <interfaceWhiteList><address>{loopback}</address></interfaceWhiteList>
      </transport_descriptor>
    </transport_descriptors>
    <participant profile_name="slamhive" is_default_profile="true">
      <rtps>
        <userTransports>
          <transport_id>slamhive_shm</transport_id>
          <transport_id>slamhive_udp</transport_id>
        </userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>{discovery}
        <propertiesPolicy>
          <properties>
            <property><name>fastdds.type_propagation</name><value>disabled</value></property>
          </properties>
        </propertiesPolicy>
      </rtps>
    </participant>
  </profiles>
</dds>
"""
# Otherwise a player's witness would be handed what it should see go over the wire.
_OVER_THE_WIRE = """
  <library_settings><intraprocess_delivery>OFF</intraprocess_delivery></library_settings>"""
# What a node announces as it starts is often not heard: it then meets the player at the player's next word,
# which by default comes each 3 s.
_ANNOUNCED_OFTEN = """
        <builtin>
          <discovery_config>
            <leaseAnnouncement><sec>0</sec><nanosec>200000000</nanosec></leaseAnnouncement>
          </discovery_config>
        </builtin>"""


def profile(largest: int, *, own: bool) -> str:
    """Return the profile of a participant as XML.

    Type information isn't sent: Cyclone DDS refuses to match types with arrays by that of Fast DDS 3.2.

    Args:
        largest: Bytes of the largest message that is played.
        own: Whether it is the player's.
    """
    return _PROFILE.format(
        library=_OVER_THE_WIRE if own else "",
        discovery=_ANNOUNCED_OFTEN if own else "",
        segment=max(_SEGMENT, _FRAMES * largest) if own else _NODE_SEGMENT,
        message=_MESSAGE if own else _NODE_MESSAGE,
        socket=_SOCKET,
        loopback=LOOPBACK,
    )


class Domain:
    """A domain that no other run of this machine has, as long as this object lives.

    It is held by the name of a socket that files know nothing of: it is free again when the process is gone,
    and is the same for all users of one network namespace.

    Args:
        number: The domain; None for one that is free.

    Raises:
        PlayError: It isn't free, or none is.
    """

    def __init__(self, number: int | None) -> None:
        if number is not None:
            numbers = [number]
        else:
            begin, count = os.getpid(), _LAST - _FIRST + 1
            numbers = [_FIRST + (begin + step) % count for step in range(count)]
        for self.number in numbers:
            self._holding = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            with suppress(OSError):
                self._holding.bind(f"\0slamhive-ros2-domain-{self.number}")
                return
            self._holding.close()
        which = f"domain {number} is" if number is not None else f"all domains from {_FIRST} to {_LAST} are"
        raise PlayError(f"{which} taken by other runs on this machine")

    def release(self) -> None:
        """Let others have it."""
        self._holding.close()


def check_room(largest: int) -> None:
    """Make sure that shared memory has room for two participants.

    Args:
        largest: Bytes of the largest message.

    Raises:
        PlayError: It hasn't.
    """
    needed = max(LEAST_SHARED_MEMORY, 3 * _FRAMES * largest)
    try:
        found = os.statvfs(SHARED_MEMORY)
    except OSError as error:
        raise PlayError(
            f"{SHARED_MEMORY} can't be used ({error.strerror}): ROS 2 nodes are played to by shared memory"
        ) from None
    free = found.f_bavail * found.f_frsize
    if not os.access(SHARED_MEMORY, os.W_OK) or free < needed:
        raise PlayError(
            f"{SHARED_MEMORY} has {free >> 20} MiB free, and playing to a ROS 2 node needs "
            f"{needed >> 20} MiB: make room there, or mount a larger one"
        )


def check_rmw(name: str) -> None:
    """Make sure that our ROS 2 has an rmw: rcl ends the whole process where it hasn't.

    Args:
        name: Such as rmw_fastrtps_cpp.

    Raises:
        PlayError: It hasn't, as far as the variable says where it is.
    """
    places = os.environ.get("AMENT_PREFIX_PATH", "")
    if places and not has_rmw(places, name):
        raise PlayError(f"the player's ROS 2 has no {name}, which the Algorithm names (ros2.rmw)")


def has_rmw(places: str, name: str) -> bool:
    """Tell whether a ROS 2 has an rmw.

    Args:
        places: Where its packages are, as in AMENT_PREFIX_PATH.
        name: Such as rmw_cyclonedds_cpp.
    """
    folders = filter(None, places.split(os.pathsep))
    return any(Path(folder, "lib", f"lib{name}.so").exists() for folder in folders)
