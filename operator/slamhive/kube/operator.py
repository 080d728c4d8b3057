# SPDX-License-Identifier: Apache-2.0
"""The operator's life: it checks that it can work here, lists everything, and keeps its parts going.

Nothing is reconciled before the first full LIST; another every ``relistSeconds`` finds what the watches
missed.
"""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from functools import partial
from socket import gethostname
from typing import TYPE_CHECKING, Any

from slamhive.kube.api.errors import ApiError, Forbidden, StartError, Unauthorized
from slamhive.kube.api.kinds import OUR_KINDS, Key, Kind, key_of
from slamhive.kube.api.transport import NAMESPACE_OF_POD
from slamhive.kube.cluster import MANAGED
from slamhive.kube.ending import end_tasks
from slamhive.kube.loop import Loop
from slamhive.kube.served import what_crds_lack
from slamhive.model.base import GROUP, VERSION

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Coroutine, Mapping

    from slamhive.kube.cluster import Cluster
    from slamhive.kube.loop import Reconcile

_SECOND_LIST_SECONDS = 10.0
_LONGEST_START_WAIT = 30.0

_log = logging.getLogger("slamhive.operator")


class Operator:
    """Start, relist and stop.

    Args:
        cluster: the cluster.
        reconcilers: by kind, what is called for an object.
        sleep: waits some seconds.

    Attributes:
        cluster: as given.
        loop: the workers.
        ready: whether the first LIST is done.
        broken: set when a part of the operator ends that never should.
    """

    def __init__(
        self,
        cluster: Cluster,
        reconcilers: Mapping[Kind, Reconcile],
        *,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self.cluster = cluster
        self.loop = Loop(cluster, reconcilers)
        self.ready = False
        self.broken = asyncio.Event()
        self._sleep = sleep
        self._tasks: list[asyncio.Task[None]] = []
        self._crds: str | None = ""

    async def start(self) -> None:
        """Check that the operator can work here, list everything, and begin to work.

        Raises:
            StartError: CRDs or rights are missing; the sentence says how to have them.
        """
        await self._list_first()
        self.ready = True
        self.queue_all()
        parts: dict[str, Coroutine[Any, Any, None]] = {
            f"worker-{number}": self.loop.work() for number in range(self.cluster.settings.workers)
        }
        parts |= {"relist": self._relist_forever(), "metrics-api": self._read_metrics_forever()}
        self._tasks = [asyncio.create_task(part, name=name) for name, part in parts.items()]
        for task in self._tasks:
            task.add_done_callback(self.note_end)

    def note_end(self, task: asyncio.Task[None]) -> None:
        """Note the end of a part that never should end: the process begins anew."""
        if not task.cancelled():
            _log.critical("%s ended, which it never should", task.get_name(), exc_info=task.exception())
            self.broken.set()

    async def stop(self) -> None:
        """End all work; what is being reconciled is broken off, which is safe at any point."""
        await end_tasks(self._tasks)
        self._tasks = []

    @property
    def failed_tasks(self) -> list[str]:
        """Return the names of tasks that ended though they never should."""
        return [task.get_name() for task in self._tasks if task.done()]

    def queue_all(self, kinds: tuple[Kind, ...] = OUR_KINDS) -> None:
        """Have every object of some kinds looked at."""
        for kind in kinds:
            for namespace in self.cluster.settings.namespaces:
                for obj in self.cluster.store.of(kind, namespace):
                    self.cluster.queue.add(key_of(kind, obj))

    async def relist(self) -> None:
        """List everything and act on what the watches missed.

        Raises:
            Forbidden: the right to list a kind is missing; all others were listed.
        """
        cluster, refused = self.cluster, None
        for kind in Kind:
            labels = None if kind.is_ours else MANAGED
            narrow = partial(cluster.store.narrowed, kind)
            for namespace in cluster.settings.namespaces:
                try:
                    items, version = await cluster.api.list(kind, namespace, labels=labels, narrow=narrow)
                except Forbidden as error:
                    refused = refused or error
                else:
                    cluster.take_list(kind, namespace, items, version)
        if refused is not None:
            raise refused

    async def _list_first(self) -> None:
        wait, cluster = 1.0, self.cluster
        while True:
            try:
                await self._check_crds()
                await self._compare_crds()
                cluster.identity = await cluster.api.cluster_uid() or cluster.settings.cluster_name or None
                await self.relist()
            except Forbidden as error:
                raise StartError(
                    f"{error}; the operator needs the right to {error.verb} {error.resource} in each of its "
                    f"namespaces ({', '.join(cluster.settings.namespaces)}): the chart's Role grants it"
                ) from None
            except ApiError as error:
                if not error.retryable or isinstance(error, Unauthorized):
                    raise StartError(str(error)) from None
                _log.warning("cannot begin yet, again in %.0f s: %s", wait, error)
                await self._sleep(wait)
                wait = min(2 * wait, _LONGEST_START_WAIT)
            else:
                return

    async def _check_crds(self) -> None:
        served = await self.cluster.api.served(GROUP, VERSION)
        missing = [kind.resource for kind in OUR_KINDS if kind.plural not in served]
        if missing:
            raise StartError(
                f"the cluster does not know {', '.join(missing)} ({GROUP}/{VERSION}): install the CRDs "
                "first, with `helm install slamhive-crds helm/slamhive-crds` or `kubectl apply -f crds/`"
            )

    async def _compare_crds(self) -> None:
        """Say in the log and at the operator's pod that CRDs are older than this version; it works on."""
        try:
            told = await what_crds_lack(self.cluster.api)
        except ApiError as error:
            _log.debug("the schemas of the CRDs can't be read now: %s", error)
            return
        if told == self._crds:
            return
        self._crds = told
        if not told:
            known = "can't be seen by this account" if told is None else "are known to the CRDs now"
            _log.info("all fields and words of this version %s", known)
            return
        _log.warning("%s", told)
        with suppress(OSError, ApiError):  # outside a pod there is nothing to tell it at
            pod = Key(Kind.POD, NAMESPACE_OF_POD.read_text(encoding="utf-8").strip(), gethostname())
            body = await self.cluster.api.get(pod)
            await self.cluster.api.event(Kind.POD, body, "Warning", "OldCRDs", told)

    async def _relist_forever(self) -> None:
        # The second list comes soon: what was deleted between the first one and the watches' beginning is
        # told by nobody.
        wait = min(_SECOND_LIST_SECONDS, self.cluster.settings.relist_seconds)
        while True:
            await self._sleep(wait)
            wait = self.cluster.settings.relist_seconds
            try:
                await self._compare_crds()
                await self.relist()
            except ApiError as error:
                _log.warning("listing failed, the watches go on: %s", error)
            except Exception:  # noqa: BLE001
                self.cluster.metrics.count_error("relist", "unforeseen")
                _log.exception("listing failed in an unforeseen way")

    async def _read_metrics_forever(self) -> None:
        while True:
            try:
                if await self.cluster.usage.read():
                    self.queue_all((Kind.SWEEP,))  # they say whether live figures are to be had
            except Exception:  # noqa: BLE001
                self.cluster.metrics.count_error("metrics-api", "unforeseen")
                _log.exception("reading the metrics API failed in an unforeseen way")
            await self._sleep(self.cluster.settings.metrics.interval_seconds)
