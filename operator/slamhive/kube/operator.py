# SPDX-License-Identifier: Apache-2.0
"""Operator main loop: watch events update the store and queue keys; workers reconcile the queued objects.

Nothing is reconciled before the first full LIST; another every ``relistSeconds`` finds what the watches
missed. A reconciler that fails is tried again; it never ends the operator.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping
from contextvars import ContextVar
from functools import partial
from typing import TYPE_CHECKING, Any

from slamhive.kube.api.errors import ApiError, Conflict, Forbidden, NotFound, StartError, Unauthorized
from slamhive.kube.api.kinds import MANAGER, OUR_KINDS, Key, Kind, Label, Object, key_of
from slamhive.kube.ending import end_tasks
from slamhive.kube.failing import tell_failure, tell_recovery
from slamhive.kube.metrics import Metrics
from slamhive.kube.metricsapi import ENDED, MetricsReader
from slamhive.kube.pods import has_completed, has_failed
from slamhive.kube.queue import Queue
from slamhive.kube.refused_pods import RefusedPods
from slamhive.kube.routing import is_news, routes
from slamhive.kube.status import status_patch
from slamhive.kube.store import Store
from slamhive.model.base import GROUP, VERSION
from slamhive.model.errors import InputError, SlamHiveError

if TYPE_CHECKING:
    from slamhive.archive import Archive
    from slamhive.kube.api.client import Api
    from slamhive.kube.settings import Settings
    from slamhive.model.status import Status

Reconcile = Callable[["Operator", Key], Awaitable[float | None]]

MANAGED = f"{Label.MANAGED_BY}={MANAGER}"
"""Label selector of the Jobs and pods that are ours."""

SLOW_RETRY_SECONDS = 300.0
FAILURES_TOLD = 5
"""Failures in a row from which on an object says so itself; what waiting can't mend is told at once."""
STUCK_SECONDS = 300.0
_SECOND_LIST_SECONDS = 10.0
_AMEND_TRIES = 5
_LONGEST_START_WAIT = 30.0
_RECOVERY_SECONDS = 15.0

_log = logging.getLogger("slamhive.operator")
_current: ContextVar[Key | None] = ContextVar("slamhive_current_key", default=None)


class Operator:
    """Everything that reconcilers work with.

    Args:
        api: the Kubernetes API.
        settings: the operator's settings.
        reconcilers: by kind, what brings an object to where it should be; returns after how many seconds to
            look again, None for not before something changes.
        archive: where finished runs are kept, if anywhere.
        clock: returns the time in s since 1970.
        queue: the work queue; default: one on the event loop's clock.
        sleep: waits some seconds.

    Attributes:
        api: as given.
        settings: as given.
        archive: as given.
        cluster: what tells this cluster from every other one in records; None where it can't be seen.
        clock: as given.
        store: the picture of the cluster.
        queue: the keys that wait.
        metrics: what Prometheus gets.
        usage: figures of the metrics API.
        refused_pods: why Jobs have no pods.
        ready: whether the first LIST is done.
        broken: set when a part of the operator ends that never should.
    """

    def __init__(
        self,
        api: Api,
        settings: Settings,
        reconcilers: Mapping[Kind, Reconcile],
        archive: Archive | None = None,
        *,
        clock: Callable[[], float] = time.time,
        queue: Queue | None = None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self.api = api
        self.settings = settings
        self.archive = archive
        self.cluster: str | None = None
        self.clock = clock
        self.store = Store()
        self._creating: list[tuple[Kind, str | None, Object]] = []
        self.queue = queue or Queue()
        self.metrics = Metrics(run_name_label=settings.metrics.run_name_label)
        self.usage = MetricsReader(api, self.store, self.metrics, settings.namespaces)
        self.refused_pods = RefusedPods(api, clock)
        self.ready = False
        self._sleep = sleep
        self._reconcilers = dict(reconcilers)
        self.broken = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []
        self._told: dict[Key, str] = {}
        self._failures: dict[Key, int] = {}
        self._failures_told: set[Key] = set()
        self._busy_since: dict[Key, float] = {}
        self._podless: dict[str, str] = {}
        self._finding_pods = asyncio.Lock()
        api.count = self.metrics.count_call
        self.metrics.watch_queue(self.queue)
        self.metrics.watch_phases(self._phases)

    # What is seen.

    def observe(self, kind: Kind, event_type: str | None, obj: Object) -> None:
        """Take in what a watch reports: ADDED, MODIFIED, DELETED, or None from a listing."""
        if event_type == "DELETED":
            self._gone(kind, obj)
        else:
            self._take(kind, obj)

    def apply(self, kind: Kind, obj: Object) -> Object:
        """Take in the answer to a write of our own, which need not wait for the watch; returns it.

        The key being reconciled is not queued again by this: its reconciler knows what it wrote.
        """
        self._take(kind, obj)
        return obj

    def forget(self, kind: Kind, obj: Object) -> None:
        """Take out an object whose deletion the API has confirmed."""
        self._gone(kind, obj)

    def _take(self, kind: Kind, obj: Object, *, current_too: bool = False) -> None:
        before = self.store.get(key_of(kind, obj))
        if self.store.put(kind, obj):
            if kind is Kind.POD and (obj.get("status") or {}).get("phase") in ENDED:
                self.usage.ended(obj["metadata"]["uid"])
            self._note_podless(kind, obj)
            if is_news(kind, before, obj):
                keys = routes(kind, obj, self.store, new=before is None)
                self._enqueue(keys, current_too=current_too)

    def _gone(self, kind: Kind, obj: Object) -> None:
        key = key_of(kind, obj)
        uid = obj["metadata"].get("uid")
        self.store.remove(kind, key.namespace, key.name, uid)
        if kind is Kind.POD and uid:
            self.usage.forget(uid)
        self._told.pop(key, None)
        self._failures.pop(key, None)
        self._failures_told.discard(key)
        self._enqueue(routes(kind, obj, self.store, new=True))

    def _note_podless(self, kind: Kind, obj: Object) -> None:
        uid = obj["metadata"]["uid"]
        if kind is Kind.JOB and (has_failed(obj) or has_completed(obj)) and not self._has_pods(uid):
            self._podless[uid] = obj["metadata"]["namespace"]

    def _has_pods(self, job_uid: str) -> bool:
        return any(kind is Kind.POD for kind, _ in self.store.owned(job_uid))

    async def _find_pods(self) -> None:
        """Ask for the pods of Jobs that have ended without one being seen: the watch of pods may lag behind.

        Without this, their ends would look like lost pods.
        """
        async with self._finding_pods:
            for uid, namespace in list(self._podless.items()):
                if not self._has_pods(uid):
                    labels = f"{MANAGED},batch.kubernetes.io/controller-uid={uid}"
                    for pod in (await self.api.list(Kind.POD, namespace, labels=labels))[0]:
                        self._take(Kind.POD, pod)
                self._podless.pop(uid, None)

    def _enqueue(self, keys: Iterable[Key], *, current_too: bool = False) -> None:
        current = None if current_too else _current.get()
        for key in keys:
            if key.kind in self._reconcilers and key != current:
                self.queue.add(key)

    # Writes whose answers enter the store.

    async def create(self, kind: Kind, body: Object, namespace: str | None = None) -> Object:
        """Create an object; errors as ``Api.create``."""
        entry = (kind, namespace or body["metadata"].get("namespace"), body)
        self._creating.append(entry)
        try:
            return self.apply(kind, await self.api.create(kind, body, namespace))
        finally:
            self._creating.remove(entry)

    def being_created(self, kind: Kind, namespace: str, label: str, value: str) -> list[Object]:
        """Return the objects with a label whose creation is under way: the store doesn't have them yet."""
        return [
            body
            for *place, body in self._creating
            if place == [kind, namespace] and (body["metadata"].get("labels") or {}).get(label) == value
        ]

    async def patch(self, key: Key, body: Object, *, subresource: str | None = None) -> Object:
        """Patch an object; errors as ``Api.patch``. An object found gone leaves the store."""
        try:
            answer = await self.api.patch(key, body, subresource=subresource)
        except NotFound:
            present = self.store.get(key)
            if present is not None:
                self._gone(key.kind, present)
            raise
        return self.apply(key.kind, answer)

    async def patch_seen(
        self, kind: Kind, seen: Object, body: Object, *, subresource: str | None = None
    ) -> Object:
        """Patch the very version of an object that was looked at.

        Of two operators, or two workers, that decided on the same version, one gets a Conflict and looks
        again. Lists need this too: a merge patch replaces them whole.

        Args:
            kind: its kind.
            seen: the object as it was read.
            body: the merge patch.
            subresource: as ``Api.patch`` takes it.

        Raises:
            Conflict: it has changed since.
            NotFound: it is gone.
        """
        metadata = {**body.get("metadata", {}), "resourceVersion": seen["metadata"]["resourceVersion"]}
        return await self.patch(key_of(kind, seen), {**body, "metadata": metadata}, subresource=subresource)

    async def write_status(
        self,
        kind: Kind,
        seen: Object,
        status: Status | None = None,
        conditions: Iterable[Object] = (),
    ) -> Object | None:
        """Write what is new of an object's status, in one patch with its conditions.

        Args:
            kind: its kind.
            seen: the object as it was read; errors as ``patch_seen``.
            status: the fields that are given in it are written; those that are None are removed.
            conditions: as ``condition`` makes them.

        Returns:
            The object as it is then; None where nothing was new.
        """
        fields = status.as_patch() if status is not None else {}
        patch = status_patch(seen, fields, conditions, self.clock())
        if not patch:
            return None
        return await self.patch_seen(kind, seen, {"status": patch}, subresource="status")

    async def amend(
        self,
        key: Key,
        uid: str,
        change: Callable[[Object], Object],
        *,
        subresource: str | None = None,
    ) -> Object | None:
        """Patch an object by what follows from its newest version, whatever else writes there meanwhile.

        Args:
            key: the object.
            uid: its uid; a later object of the name is left alone.
            change: returns the merge patch for an object, empty for none.
            subresource: as ``Api.patch`` takes it.

        Returns:
            The object as it is then; None where it is gone or nothing was new.

        Raises:
            Conflict: it changed each time.
        """
        for _ in range(_AMEND_TRIES):
            seen = self.store.get(key)
            body = change(seen) if seen is not None and seen["metadata"]["uid"] == uid else None
            if seen is None or not body:
                return None
            try:
                return await self.patch_seen(key.kind, seen, body, subresource=subresource)
            except Conflict:
                await self.refresh(key)
            except NotFound:
                return None
        raise Conflict(f"{key}: it keeps changing", status=409)

    async def refresh(self, key: Key) -> Object | None:
        """Read an object anew, as after a Conflict; None when it is gone."""
        try:
            found = await self.api.get(key)
        except NotFound:
            present = self.store.get(key)
            if present is not None:
                self._gone(key.kind, present)
            return None
        # News here is somebody else's doing. Who is reconciling may have decided by what was before, and the
        # watch, for which it is no news any more, queues nobody.
        self._take(key.kind, found, current_too=True)
        return found

    async def delete(self, key: Key, *, uid: str | None = None, **options: Any) -> Object | None:
        """Delete an object, by default exactly the one in the store; returns it while it has still to end.

        Errors as ``Api.delete``, but another object of that name counts as gone.
        """
        present = self.store.get(key)
        # By uid: a later object of the same name is somebody else's.
        uid = uid or (present["metadata"].get("uid") if present else None)
        try:
            answer = await self.api.delete(key, uid=uid, **options)
        except Conflict:
            if options.get("resource_version") is not None:
                raise
            there = await self.refresh(key)
            if there is not None and there["metadata"]["uid"] == uid:
                raise
            answer = None
        if answer is not None:
            return self.apply(key.kind, answer)
        if present is not None and present["metadata"].get("uid") == uid:
            self._gone(key.kind, present)
        return None

    # Life.

    async def start(self) -> None:
        """Check that the operator can work here, list everything, and begin to work.

        Raises:
            StartError: CRDs or rights are missing; the sentence says how to have them.
        """
        await self._list_first()
        self.ready = True
        self.queue_all()
        parts: dict[str, Coroutine[Any, Any, None]] = {
            f"worker-{number}": self._work() for number in range(self.settings.workers)
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

    async def _list_first(self) -> None:
        wait = 1.0
        while True:
            try:
                await self._check_crds()
                self.cluster = await self.api.cluster_uid() or self.settings.cluster_name or None
                await self.relist()
            except Forbidden as error:
                raise StartError(
                    f"{error}; the operator needs the right to {error.verb} {error.resource} in each of its "
                    f"namespaces ({', '.join(self.settings.namespaces)}): the chart's Role grants it"
                ) from None
            except ApiError as error:
                if not error.retryable or isinstance(error, Unauthorized):
                    raise StartError(str(error)) from None
                _log.warning("cannot begin yet, again in %.0f s: %s", wait, error)
                await self._sleep(wait)
                wait = min(2 * wait, _LONGEST_START_WAIT)
            else:
                return

    async def stop(self) -> None:
        """End all work; what is being reconciled is broken off, which is safe at any point."""
        await end_tasks(self._tasks)
        self._tasks = []

    def queue_all(self) -> None:
        """Have every object looked at."""
        for kind in self._reconcilers:
            for namespace in self.settings.namespaces:
                for obj in self.store.of(kind, namespace):
                    self.queue.add(key_of(kind, obj))

    async def relist(self) -> None:
        """List everything and act on what the watches missed."""
        for kind in Kind:
            for namespace in self.settings.namespaces:
                await self._relist_one(kind, namespace)

    async def _relist_one(self, kind: Kind, namespace: str) -> None:
        labels = None if kind.is_ours else MANAGED
        items, version = await self.api.list(
            kind, namespace, labels=labels, narrow=partial(self.store.narrowed, kind)
        )
        self.take_list(kind, namespace, items, version)

    def take_list(self, kind: Kind, namespace: str, items: Iterable[Object], version: str) -> None:
        """Take in a full list, narrowed as it came, and queue what it shows to have changed."""
        for key, obj, there in self.store.sync(kind, namespace, items, version):
            if kind is Kind.POD and not there:
                self.usage.forget(obj["metadata"]["uid"])
            if there:
                self._note_podless(kind, obj)
            self._enqueue(routes(key.kind, obj, self.store, new=True))

    async def _check_crds(self) -> None:
        served = await self.api.served(GROUP, VERSION)
        missing = [kind.resource for kind in OUR_KINDS if kind.plural not in served]
        if missing:
            raise StartError(
                f"the cluster does not know {', '.join(missing)} ({GROUP}/{VERSION}): install the CRDs "
                "first, with `helm install slamhive-crds helm/slamhive-crds` or `kubectl apply -f crds/`"
            )

    async def _relist_forever(self) -> None:
        # The second list comes soon: what was deleted between the first one and the watches' beginning is
        # told by nobody.
        wait = min(_SECOND_LIST_SECONDS, self.settings.relist_seconds)
        while True:
            await self._sleep(wait)
            wait = self.settings.relist_seconds
            try:
                await self.relist()
            except ApiError as error:
                _log.warning("listing failed, the watches go on: %s", error)
            except Exception:  # noqa: BLE001
                self.metrics.count_error("relist", "unforeseen")
                _log.exception("listing failed in an unforeseen way")

    async def _read_metrics_forever(self) -> None:
        while True:
            try:
                if await self.usage.read():
                    self._enqueue_sweeps()
            except Exception:  # noqa: BLE001
                self.metrics.count_error("metrics-api", "unforeseen")
                _log.exception("reading the metrics API failed in an unforeseen way")
            await self._sleep(self.settings.metrics.interval_seconds)

    def _enqueue_sweeps(self) -> None:
        # Sweeps say in a condition whether live figures are to be had.
        for namespace in self.settings.namespaces:
            self._enqueue(key_of(Kind.SWEEP, sweep) for sweep in self.store.of(Kind.SWEEP, namespace))

    # Work.

    async def _work(self) -> None:
        while True:
            key = await self.queue.get()
            try:
                await self.handle(key)
            finally:
                self.queue.done(key)

    async def handle(self, key: Key) -> None:
        """Reconcile one object and queue what follows from how that went."""
        token = _current.set(key)
        started = time.monotonic()
        self._busy_since[key] = started
        outcome = "ok"
        try:
            if self._podless:
                await self._find_pods()
            again = await self._reconcilers[key.kind](self, key)
        except SlamHiveError as error:
            outcome = error.reason
            self._failed(key, error)
            ordinary = error.retryable or isinstance(error, Conflict | NotFound)
            await self._count_failure(key, error, passes=ordinary)
        except Exception as error:  # noqa: BLE001 - no single object ends the operator
            outcome = "unforeseen"
            self.metrics.count_error(str(key.kind), outcome)
            delay = self.queue.retry(key)
            _log.exception("%s: reconciling failed in an unforeseen way; again in %.1f s", key, delay)
            await self._count_failure(key, error, passes=True)
        else:
            self.queue.forget(key)
            self._told.pop(key, None)
            self._failures.pop(key, None)
            if await tell_recovery(self, key, told=key in self._failures_told):
                self._failures_told.discard(key)
            else:
                again = min(_RECOVERY_SECONDS, again or _RECOVERY_SECONDS)
            if again is not None:
                self.queue.add(key, again)
        finally:
            _current.reset(token)
            self._busy_since.pop(key, None)
            self.metrics.observe_reconcile(str(key.kind), outcome, time.monotonic() - started)

    async def _count_failure(self, key: Key, error: Exception, *, passes: bool) -> None:
        """Have an object say what keeps it from going on, once that doesn't look like passing."""
        self._failures[key] = self._failures.get(key, 0) + 1
        if not passes or self._failures[key] >= FAILURES_TOLD:
            self._failures_told.add(key)
            await tell_failure(self, key, error)

    def _failed(self, key: Key, error: SlamHiveError) -> None:
        self.metrics.count_error(str(key.kind), error.reason)
        if isinstance(error, Conflict | NotFound):
            # Ordinary: someone else wrote or deleted first, and the watch is about to tell.
            delay = self.queue.retry(key)
            _log.debug("%s: %s; again in %.1f s", key, error, delay)
            return
        if error.retryable:
            delay = self.queue.retry(key)
        else:
            delay = SLOW_RETRY_SECONDS
            self.queue.add(key, delay)
        message = str(error)
        # What is tried again every few minutes is logged when its message changes, not each time.
        if self._told.get(key) != message:
            self._told[key] = message
            level = logging.ERROR if isinstance(error, InputError) else logging.WARNING
            _log.log(level, "%s: %s; again in %.1f s", key, message, delay)

    @property
    def stuck(self) -> list[Key]:
        """Return the keys that have been reconciled for suspiciously long."""
        now = time.monotonic()
        return [key for key, since in self._busy_since.items() if now - since > STUCK_SECONDS]

    @property
    def failed_tasks(self) -> list[str]:
        """Return the names of tasks that ended though they never should."""
        return [task.get_name() for task in self._tasks if task.done()]

    def _phases(self) -> dict[tuple[str, str], int]:
        counts: dict[tuple[str, str], int] = {}
        for namespace in self.settings.namespaces:
            for run in self.store.of(Kind.MAPPING_RUN, namespace):
                phase = run["status"].get("phase") or "Pending"
                counts[namespace, phase] = counts.get((namespace, phase), 0) + 1
        return counts
