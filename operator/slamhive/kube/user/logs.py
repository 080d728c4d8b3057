# SPDX-License-Identifier: Apache-2.0
"""Logs of runs: read from the pod or, when that is gone, from what was kept."""

from __future__ import annotations

import asyncio
from contextlib import aclosing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slamhive.kube.api.errors import ApiError, Forbidden, NotFound
from slamhive.kube.api.kinds import Kind, Label, Object, Role
from slamhive.kube.builders.common import label_value
from slamhive.kube.status import phase_of
from slamhive.kube.user.queries import find, name_of, status_of
from slamhive.model.base import Choice
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Mapping

    from slamhive.kube.user.connecting import ConnectedCluster


_PAUSE_SECONDS = 1.0
_WAITING = "waiting"


class LogPart(Choice):
    """Kinds of output that reading a log yields: a line of the log, or a remark about it."""

    LINE = "line"
    REMARK = "remark"


@dataclass(frozen=True)
class _Seen:
    """A container as its pod shows it.

    Attributes:
        pod: name of the pod.
        attempt: number of the attempt.
        state: waiting, running or terminated.
        waits_for: why it waits.
    """

    pod: str
    attempt: str
    state: str
    waits_for: str = ""


async def read_log(
    cluster: ConnectedCluster, name: str, container: str, *, follow: bool = False, tail: int | None = None
) -> AsyncGenerator[tuple[LogPart, str], None]:
    """Yield the lines of a run's log, and remarks about where they come from.

    Args:
        cluster: where the run is.
        name: its name.
        container: algorithm, monitor, or player.
        follow: whether to go on, through further attempts, until the run is over.
        tail: only so many of the last lines.

    Raises:
        UnknownNameError: there is no such run.
        InputError: its pod has no such container.
    """
    [(_, run)] = await find(cluster, [name], [Kind.MAPPING_RUN])
    reader = _LogReader(cluster, name, container, follow=follow, tail=tail)
    # A run may have several pods, one an attempt: each look takes the newest, and goes on where it stopped.
    while True:
        seen = await reader.look(run)
        over = phase_of(status_of(run)).is_finished
        if seen is not None and seen.state != _WAITING:
            async with aclosing(reader.read(seen)) as parts:
                async for part in parts:
                    yield part
            if reader.problem is None and (over or not follow):
                return
        elif follow and not over and (text := reader.news(_waiting(run, seen))):
            yield LogPart.REMARK, f"{text}; waiting for it to begin"
        if not follow or over:
            break
        await asyncio.sleep(_PAUSE_SECONDS)
        try:
            run = await cluster.api.get(cluster.key(Kind.MAPPING_RUN, name))
        except NotFound:
            yield LogPart.REMARK, f"{name} was deleted"
            return
    if reader.problem:
        yield LogPart.REMARK, reader.problem
    for part in _kept(run, seen, container):
        yield part


class _LogReader:
    """Reads a container's log, and knows how far."""

    def __init__(
        self, cluster: ConnectedCluster, name: str, container: str, *, follow: bool, tail: int | None
    ) -> None:
        self._cluster = cluster
        self._name = name
        self._container = container
        self._follow = follow
        self._tail = tail
        self._since: dict[str, str] = {}
        self._told = ""
        self.shown: set[str] = set()
        """Pods whose log was read to its end."""
        self.problem: str | None = None
        """Reason that the last log could not be read."""

    def news(self, text: str) -> str:
        """Return a text unless it was the last one."""
        if text == self._told:
            return ""
        self._told = text
        return text

    async def look(self, run: Object) -> _Seen | None:
        """Return the state of the container in the run's newest pod."""
        selector = f"{Label.RUN}={label_value(self._name)},{Label.ROLE}={Role.RUN}"
        pods, _ = await self._cluster.api.list(Kind.POD, self._cluster.namespace, labels=selector)
        created = run["metadata"].get("creationTimestamp", "")
        # Pods of an earlier run of this name may still be ending.
        own = [pod for pod in pods if pod["metadata"].get("creationTimestamp", "") >= created]
        if not own:
            return None
        pod = max(own, key=lambda item: (item["metadata"]["creationTimestamp"], name_of(item)))
        spec, status = pod["spec"], status_of(pod)
        known = [item["name"] for item in (*(spec.get("initContainers") or ()), *spec["containers"])]
        if self._container not in known:
            raise InputError(
                f"--container: {self._name} has no container {self._container!r}; it has {', '.join(known)}"
            )
        shown = [*(status.get("initContainerStatuses") or ()), *(status.get("containerStatuses") or ())]
        found: Mapping[str, Any] = next((item for item in shown if item["name"] == self._container), {})
        states: dict[str, Object] = found.get("state") or {_WAITING: {}}
        state, detail = next(iter(states.items()))
        why = (detail.get("message") or detail.get("reason") or "") if state == _WAITING else ""
        attempt = (pod["metadata"].get("labels") or {}).get(Label.ATTEMPT, "1")
        return _Seen(name_of(pod), attempt, state, why)

    async def read(self, seen: _Seen) -> AsyncGenerator[tuple[LogPart, str], None]:
        """Yield the parts of a container's log that were not read yet; it has begun."""
        self.problem = None
        if seen.pod in self.shown:
            return
        if seen.attempt != "1" and (text := self.news(f"attempt {seen.attempt}")):
            yield LogPart.REMARK, text
        try:
            async with aclosing(self._lines(seen)) as lines:
                async for line in lines:
                    yield LogPart.LINE, line
        except Forbidden:
            raise
        except ApiError as error:  # the pod or its node went away, or the connection broke
            self.problem = str(error)
            return
        if seen.state == "terminated":
            self.shown.add(seen.pod)

    async def _lines(self, seen: _Seen) -> AsyncGenerator[str, None]:
        since = self._since.get(seen.pod)
        found = self._cluster.api.log_lines(
            *(self._cluster.namespace, seen.pod, self._container),
            follow=self._follow,
            since=since,
            tail_lines=self._tail if since is None else None,
        )
        async with aclosing(found) as lines:
            async for stamp, text in lines:
                self._since[seen.pod] = stamp
                yield text


def _waiting(run: Object, seen: _Seen | None) -> str:
    status = status_of(run)
    told = [item for item in status.get("conditions") or () if item["status"] == "False"]
    why = (seen.waits_for if seen else "") or next((item["message"] for item in told if item["message"]), "")
    return f"{name_of(run)}: {phase_of(status)}{f': {why}' if why else ''}"


def _kept(run: Object, seen: _Seen | None, container: str) -> list[tuple[LogPart, str]]:
    """Return the known parts of the log of a run without a pod."""
    status, name = status_of(run), name_of(run)
    phase = phase_of(status)
    if not phase.is_finished:
        return [(LogPart.REMARK, f"{_waiting(run, seen)}; it has written nothing yet (-f waits)")]
    twin = (status.get("provenance") or {}).get("reusedFrom")
    if twin:
        return [(LogPart.REMARK, f"{name} took the result of an equal run, {twin}, and ran nothing itself")]
    parts: list[tuple[LogPart, str]] = []
    tail = status.get("logTail") if container == "algorithm" else None
    if tail:
        parts += [(LogPart.LINE, line) for line in str(tail).splitlines()]
        parts.append((LogPart.REMARK, "the pod is gone; these are the last lines, which were kept"))
    elif status.get("startTime"):
        parts.append((LogPart.REMARK, f"the pod is gone, and the log of its container {container} with it"))
    else:
        why = status.get("message") or ""
        parts.append(
            (LogPart.REMARK, f"{name} never ran: {status.get('reason') or phase}: {why}".rstrip(": "))
        )
    # The status keeps the last lines alone; who needs all of them finds them there.
    if folder := status.get("folder"):
        parts.append((LogPart.REMARK, f"its files are on the results volume, in {folder}/"))
    return parts
