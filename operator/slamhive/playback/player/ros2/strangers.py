# SPDX-License-Identifier: Apache-2.0
"""Nodes on a run's ROS 2 domain that neither its player nor its algorithm started."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any

from slamhive.playback.player.processes import carriers

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

_FAST_DDS = b"\x01\x0f"
_NAMELESS = "_NODE_NAME_UNKNOWN_"
"""The name that the middleware gives a node of which it has seen an endpoint alone."""
_NAME_SECONDS = 2.0
"""Time after its first endpoint in which a node's name comes, on a busy machine too."""


class Strangers:
    """The look for nodes of other programs, as far as they can be told.

    Fast DDS has the process in the identity of each endpoint. One that no process here has may be of a
    process that has ended.

    Args:
        node: The player's node, which sees the endpoints.
        algorithm: What marks the algorithm's processes (`carriers`).
        topics: The topics to look at, and whether those count who only subscribe.
        own: Names of the player's nodes.
    """

    def __init__(self, node: Any, algorithm: str, topics: Mapping[str, bool], own: Collection[str]) -> None:
        self._node, self._algorithm, self._topics, self._own = node, algorithm, topics, own
        self._known: set[int] = {os.getpid() & 0xFFFF}
        self._nameless_at: float | None = None

    def found(self) -> list[str]:
        """Return the names of foreign nodes, sorted; of one without a name yet a moment later."""
        strange = self._endpoints()
        if strange:  # to look at all processes takes long
            self._known |= {process.pid & 0xFFFF for process in carriers(self._algorithm)}
        names = sorted(
            name for name, process in strange.items() if process not in self._known and _runs(process)
        )
        if not any(_NAMELESS in name for name in names):
            return names
        self._nameless_at = self._nameless_at or time.monotonic()
        return names if time.monotonic() > self._nameless_at + _NAME_SECONDS else []

    def _endpoints(self) -> dict[str, int]:
        """Return the nodes with endpoints of processes that aren't known, with the end of its number."""
        strange: dict[str, int] = {}
        for topic, subscribers_too in self._topics.items():
            ends = self._node.get_publishers_info_by_topic(topic)
            if subscribers_too:
                ends = [*ends, *self._node.get_subscriptions_info_by_topic(topic)]
            for one in ends:
                identity = bytes(one.endpoint_gid)
                if identity[:2] == _FAST_DDS and one.node_name not in self._own:
                    process = int.from_bytes(identity[4:6], "little")
                    if process not in self._known:
                        strange[f"{one.node_namespace.rstrip('/')}/{one.node_name}"] = process
        return strange


def _runs(process: int) -> bool:
    """Tell whether a process runs whose number ends in these 16 bits."""
    return any(
        name.isdigit() and int(name) & 0xFFFF == process
        for name in os.listdir("/proc")  # noqa: PTH208
    )
