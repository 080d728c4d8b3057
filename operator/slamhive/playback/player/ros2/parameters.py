# SPDX-License-Identifier: Apache-2.0
"""Questions to a node's services of parameters."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from rcl_interfaces.srv import GetParameters, ListParameters  # type: ignore[import-not-found]

if TYPE_CHECKING:
    from collections.abc import Collection

_ANNOUNCED_SECONDS = 1.0
"""Time after a node in which its services are announced."""
_ANSWER_SECONDS = 1.0


class ParameterQuestion:
    """A question to a node that shows whether data reach it: whether it takes simulated time.

    Args:
        node: Who asks.
        name: Who is asked.
    """

    def __init__(self, node: Any, name: str) -> None:
        self._node, self._name = node, name
        self._client = node.create_client(GetParameters, f"{name}/get_parameters")
        self._answer: Any = None
        self._begin = time.monotonic()
        self.simulated: bool | None = None

    def is_over(self) -> bool:
        """Tell whether it has answered, or has no such service."""
        if self._answer is None:
            if not self._client.service_is_ready():
                # Without the service there is nothing to ask; it may be announced a moment after the node.
                return time.monotonic() > self._begin + _ANNOUNCED_SECONDS and not self._is_announced()
            self._answer = self._client.call_async(GetParameters.Request(names=["use_sim_time"]))
        if not self._answer.done():
            return False
        with suppress(Exception):
            values = self._answer.result().values
            self.simulated = bool(values and values[0].bool_value)
        return True

    def _is_announced(self) -> bool:
        space, _, own = self._name.rpartition("/")
        with suppress(RuntimeError):  # the node went meanwhile
            found = self._node.get_service_names_and_types_by_node(own, space or "/")
            return any(service == self._client.srv_name for service, _ in found)
        return False

    def declared(self, names: Collection[str], executor: Any) -> frozenset[str] | None:
        """Return the parameters that the node has; None if it doesn't tell.

        Args:
            names: Those that matter: a node that takes any has them too.
            executor: Of the node that asks.
        """
        if self.simulated is None:
            return None
        told = self._told(self._client, GetParameters.Request(names=list(names)), executor)
        if told is None or len(told.values) == len(names):
            return None if told is None else frozenset(names)
        lists = self._node.create_client(ListParameters, f"{self._name}/list_parameters")
        known = self._told(lists, ListParameters.Request(), executor)
        return None if known is None else frozenset(known.result.names)

    @staticmethod
    def _told(client: Any, request: Any, executor: Any) -> Any:
        """Return the answer to a request; None if there is none in time."""
        if not client.wait_for_service(_ANSWER_SECONDS):
            return None
        answer = client.call_async(request)
        executor.spin_until_future_complete(answer, _ANSWER_SECONDS)
        return answer.result() if answer.done() else None
