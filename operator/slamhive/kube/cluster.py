# SPDX-License-Identifier: Apache-2.0
"""The cluster as the operator sees it, and all that it writes there.

What watches, lists and answers to our own writes tell enters the store; keys of what that may concern enter
the queue.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

from slamhive.kube.api.errors import Conflict, NotFound
from slamhive.kube.api.kinds import MANAGER, Key, Kind, Label, Object, key_of, labels_of
from slamhive.kube.kueue import Workloads
from slamhive.kube.metrics import Metrics
from slamhive.kube.metricsapi import ENDED, MetricsReader
from slamhive.kube.pods import has_ended
from slamhive.kube.queue import Queue
from slamhive.kube.refused_pods import RefusedPods
from slamhive.kube.routing import is_news, routes
from slamhive.kube.status import patched, status_patch
from slamhive.kube.store import Store
from slamhive.model.status import Status

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from slamhive.kube.api.client import Api
    from slamhive.kube.settings import Settings

MANAGED = f"{Label.MANAGED_BY}={MANAGER}"
"""Label selector of the Jobs and pods that are ours."""

_AMEND_TRIES = 5

_current: ContextVar[Key | None] = ContextVar("slamhive_current_key", default=None)


class Cluster:
    """Store and writes: everything that reconcilers work with.

    Args:
        api: the Kubernetes API.
        settings: the operator's settings.
        clock: returns the time in s since 1970.

    Attributes:
        api: as given.
        settings: as given.
        clock: as given.
        identity: what tells this cluster from every other one in records; None where it can't be seen.
        store: the picture of the cluster.
        queue: the keys that wait to be looked at.
        metrics: what Prometheus gets.
        usage: figures of the metrics API.
        refused_pods: why Jobs have no pods.
        workloads: what suspended Jobs wait for.
        failing: what keeps objects from going on, in a sentence, whether or not it could be written there.
    """

    def __init__(self, api: Api, settings: Settings, clock: Callable[[], float] = time.time) -> None:
        self.api = api
        self.settings = settings
        self.clock = clock
        self.identity: str | None = None
        self.store = Store()
        self.queue = Queue()
        self.metrics = Metrics(run_name_label=settings.metrics.run_name_label)
        self.usage = MetricsReader(api, self.store, self.metrics, settings.namespaces)
        self.refused_pods = RefusedPods(api, clock)
        self.workloads = Workloads(api, clock)
        self.failing: dict[Key, str] = {}
        self._creating: list[tuple[Kind, str | None, Object]] = []
        self._podless: dict[str, str] = {}
        self._finding_pods = asyncio.Lock()
        api.count = self.metrics.count_call
        self.metrics.watch_queue(self.queue)
        self.metrics.watch_phases(self._phases)

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

    def take_list(self, kind: Kind, namespace: str, items: Iterable[Object], version: str) -> None:
        """Take in a full list, narrowed as it came, and queue what it shows to have changed."""
        for key, obj, there in self.store.sync(kind, namespace, items, version):
            if kind is Kind.POD and not there:
                self.usage.forget(obj["metadata"]["uid"])
            if there:
                self._note_podless(kind, obj)
            self._enqueue(routes(key.kind, obj, self.store, new=True))

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
        self.failing.pop(key, None)
        if kind is Kind.POD and uid:
            self.usage.forget(uid)
        self._enqueue(routes(kind, obj, self.store, new=True))

    def _note_podless(self, kind: Kind, obj: Object) -> None:
        uid = obj["metadata"]["uid"]
        if kind is Kind.JOB and has_ended(obj) and not self._has_pods(uid):
            self._podless[uid] = obj["metadata"]["namespace"]

    def _has_pods(self, job_uid: str) -> bool:
        return any(kind is Kind.POD for kind, _ in self.store.owned(job_uid))

    async def find_pods(self) -> None:
        """Ask for the pods of Jobs that have ended without one being seen: the watch of pods may lag behind.

        Without this, their ends would look like lost pods.
        """
        if not self._podless:
            return
        async with self._finding_pods:
            for uid, namespace in list(self._podless.items()):
                if not self._has_pods(uid):
                    labels = f"{MANAGED},batch.kubernetes.io/controller-uid={uid}"
                    for pod in (await self.api.list(Kind.POD, namespace, labels=labels))[0]:
                        self._take(Kind.POD, pod)
                self._podless.pop(uid, None)

    async def pods_of(self, job: Object | None) -> list[Object]:
        """Return the pods of a Job as they are now: it may have ended since the reconciling began."""
        await self.find_pods()
        return self.store.pods_of(job)

    @contextmanager
    def acting_for(self, key: Key) -> Iterator[None]:
        """Note whose reconciler does what follows: its own writes don't queue it again."""
        token = _current.set(key)
        try:
            yield
        finally:
            _current.reset(token)

    def _enqueue(self, keys: Iterable[Key], *, current_too: bool = False) -> None:
        current = None if current_too else _current.get()
        for key in keys:
            if key != current:
                self.queue.add(key)

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
            if place == [kind, namespace] and labels_of(body).get(label) == value
        ]

    async def patch(self, key: Key, body: Object, *, subresource: str | None = None) -> Object:
        """Patch an object; errors as ``Api.patch``. An object found gone leaves the store."""
        try:
            answer = await self.api.patch(key, body, subresource=subresource)
        except NotFound:
            self._found_gone(key)
            raise
        return self.apply(key.kind, answer)

    async def patch_seen(
        self, kind: Kind, seen: Object, body: Object, *, subresource: str | None = None, untold: bool = False
    ) -> Object:
        """Patch the very version of an object that was looked at.

        Of two operators, or two workers, that decided on the same version, one gets a Conflict and looks
        again. Lists need this too: a merge patch replaces them whole.

        Args:
            kind: its kind.
            seen: the object as it was read.
            body: the merge patch.
            subresource: as ``Api.patch`` takes it.
            untold: whether its status is written in the store alone, now and from now on: for what nobody
                reads at the object, as it is archived and deleted at once.

        Raises:
            Conflict: it has changed since.
            NotFound: it is gone.
        """
        if subresource == "status" and (untold or self.store.is_untold(seen)):
            return self._write_untold(kind, seen, body["status"])
        metadata = {**body.get("metadata", {}), "resourceVersion": seen["metadata"]["resourceVersion"]}
        return await self.patch(key_of(kind, seen), {**body, "metadata": metadata}, subresource=subresource)

    def _write_untold(self, kind: Kind, seen: Object, patch: Object) -> Object:
        kept = self.store.keep_untold(kind, seen, patched(seen.get("status") or {}, patch))
        if kept is None:
            raise Conflict(f"{key_of(kind, seen)} has changed since it was looked at", status=409)
        self._enqueue(routes(kind, kept, self.store))
        return kept

    async def write_status(
        self,
        kind: Kind,
        seen: Object,
        status: Status | Object | None = None,
        conditions: Iterable[Object] = (),
        *,
        untold: bool = False,
    ) -> Object | None:
        """Write what is new of an object's status, in one patch with its conditions.

        Args:
            kind: its kind.
            seen: the object as it was read; errors as ``patch_seen``.
            status: the fields that are given in it are written; those that are None are removed. Long lists
                of which hardly anything is new are given as the API holds them.
            conditions: as ``condition`` makes them.
            untold: as ``patch_seen`` takes it.

        Returns:
            The object as it is then; None where nothing was new.
        """
        fields = status.as_patch() if isinstance(status, Status) else status or {}
        patch = status_patch(seen, fields, conditions, self.clock())
        if not patch:
            return None
        return await self.patch_seen(kind, seen, {"status": patch}, subresource="status", untold=untold)

    async def amend(
        self, key: Key, uid: str, change: Callable[[Object], Object], *, subresource: str | None = None
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
            self._found_gone(key)
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

    def _found_gone(self, key: Key) -> None:
        present = self.store.get(key)
        if present is not None:
            self._gone(key.kind, present)

    def _phases(self) -> dict[tuple[str, str], int]:
        counts: dict[tuple[str, str], int] = {}
        for namespace in self.settings.namespaces:
            for run in self.store.of(Kind.MAPPING_RUN, namespace):
                phase = run["status"].get("phase") or "Pending"
                counts[namespace, phase] = counts.get((namespace, phase), 0) + 1
        return counts
