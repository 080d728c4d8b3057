# SPDX-License-Identifier: Apache-2.0
"""The only way to the Kubernetes API: what the operator asks of it, in plain JSON."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from slamhive.kube.api.errors import AlreadyExists, ApiError, Conflict, Expired, Forbidden, NotFound
from slamhive.kube.api.events import event_body
from slamhive.kube.api.kinds import Object
from slamhive.kube.api.transport import Request, Transport

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.kube.api.kinds import Key, Kind

Objects = list[Object]

PAGE = 100
"""Objects a page: 500 pods at once cost 50 MiB."""

_MERGE = "application/merge-patch+json"
_METRICS = "/apis/metrics.k8s.io/v1beta1"


class Api(Transport):
    """The Kubernetes API in plain JSON; constructed and connected as ``Transport``.

    Errors are those of ``slamhive.kube.api.errors``.
    """

    async def get(self, key: Key) -> Object:
        """Return an object.

        Raises:
            NotFound: it is not there.
            ApiError: see ``slamhive.kube.api.errors``.
        """
        return await self.json(Request("get", *_named(key), "GET", _path(key)))

    async def list(
        self,
        kind: Kind,
        namespace: str,
        *,
        labels: str | None = None,
        narrow: Callable[[Object], Object] | None = None,
    ) -> tuple[Objects, str]:
        """Return all objects of a kind in a namespace, and the version of that list.

        Args:
            kind: the kind.
            namespace: where.
            labels: label selector as kubectl takes it.
            narrow: applied to each object as it comes, so that a long list is never held whole.
        """
        # A list of many pages can outlive the version that it began with: then it begins anew, at last in
        # one piece.
        for page in (PAGE, PAGE, 0):
            try:
                return await self._pages(kind, namespace, labels, narrow, page)
            except Expired:
                if not page:
                    raise
        raise AssertionError("unreachable")

    async def create(self, kind: Kind, body: Object, namespace: str | None = None) -> Object:
        """Create an object, which must have a name, and return it as the server made it.

        Raises:
            AlreadyExists: the name is taken, maybe by this very call, whose first answer was lost.
            Invalid: the server's sentence about the field.
            Forbidden: a right is missing, or (``is_quota``) the quota is used up.
        """
        metadata = body["metadata"]
        namespace = namespace or metadata["namespace"]
        body = {"apiVersion": kind.api_version, "kind": str(kind)} | body
        target = f"{namespace}/{metadata['name']}"
        request = Request("create", kind.resource, target, "POST", kind.path(namespace), body=body)
        return await self.json(request, again_on=(Conflict,))  # a Conflict here is a quota being counted

    async def patch(self, key: Key, body: Object, *, subresource: str | None = None) -> Object:
        """Change an object by a JSON merge patch and return it.

        Args:
            key: the object.
            body: the patch: lists are replaced, null removes. ``metadata.resourceVersion`` in it makes the
                change valid for that version alone.
            subresource: such as ``status``.

        Raises:
            Conflict: the object is newer than the version in the patch.
            NotFound: the object is gone.
        """
        resource, target = _named(key, subresource or "")
        path = _path(key, subresource or "")
        return await self.json(
            Request("patch", resource, target, "PATCH", path, body=body, content_type=_MERGE)
        )

    async def delete(
        self,
        key: Key,
        *,
        uid: str | None = None,
        resource_version: str | None = None,
        propagation: str = "Background",
        grace_seconds: int | None = None,
    ) -> Object | None:
        """Delete an object; returns it while it still has to end, None when it is gone (or was).

        Args:
            key: the object.
            uid: delete only the object of this uid.
            resource_version: delete only this version.
            propagation: what becomes of what it owns: Background, Foreground or Orphan.
            grace_seconds: time that a pod has to end; default: its own.

        Raises:
            Conflict: the object there has another uid or version.
        """
        wanted = {"uid": uid, "resourceVersion": resource_version}
        preconditions = {name: value for name, value in wanted.items() if value is not None}
        body: Object = {"kind": "DeleteOptions", "apiVersion": "v1", "propagationPolicy": propagation}
        if preconditions:
            body["preconditions"] = preconditions
        if grace_seconds is not None:
            body["gracePeriodSeconds"] = grace_seconds
        try:
            answer = await self.json(Request("delete", *_named(key), "DELETE", _path(key), body=body))
        except NotFound:
            return None
        is_object = "uid" in answer.get("metadata", {})
        return answer if is_object and answer["metadata"].get("deletionTimestamp") else None

    async def logs(
        self,
        namespace: str,
        pod: str,
        container: str,
        *,
        tail_lines: int | None = None,
        limit_bytes: int | None = None,
    ) -> str:
        """Return the log of a container; bytes that are not UTF-8 are replaced."""
        query = {"container": container, "tailLines": tail_lines, "limitBytes": limit_bytes}
        path = f"/api/v1/namespaces/{namespace}/pods/{pod}/log"
        content = await self.call(Request("get", "pods/log", f"{namespace}/{pod}", "GET", path, query=query))
        return content.decode(errors="replace")

    async def pod_metrics(self, namespace: str, labels: str | None = None) -> Objects:
        """Return the metrics API's PodMetrics of a namespace.

        Raises:
            NotFound, ServerFault: the cluster has no metrics API, or it does not answer.
        """
        path = f"{_METRICS}/namespaces/{namespace}/pods"
        request = Request(
            "list", "pods.metrics.k8s.io", namespace, "GET", path, query={"labelSelector": labels}
        )
        answer = await self.json(request, attempts=1)
        return [*(answer.get("items") or ())]

    async def quotas(self, namespace: str) -> Objects:
        """Return the ResourceQuotas of a namespace.

        Raises:
            Forbidden: the account may not see them.
        """
        return await self._others(
            "resourcequotas", f"/api/v1/namespaces/{namespace}/resourcequotas", namespace
        )

    async def nodes(self) -> Objects:
        """Return the cluster's nodes.

        Raises:
            Forbidden: the account may not see them.
        """
        return await self._others("nodes", "/api/v1/nodes", "of the cluster")

    async def priority_classes(self) -> Objects:
        """Return the cluster's PriorityClasses.

        Raises:
            Forbidden: the account may not see them.
        """
        path = "/apis/scheduling.k8s.io/v1/priorityclasses"
        return await self._others("priorityclasses.scheduling.k8s.io", path, "of the cluster")

    async def _others(self, resource: str, path: str, target: str) -> Objects:
        """Return all objects of a kind that the operator doesn't watch; few are expected."""
        answer = await self.json(Request("list", resource, target, "GET", path), attempts=1)
        return [*(answer.get("items") or ())]

    async def served(self, group: str, version: str) -> frozenset[str]:
        """Return the plurals of the resources of a group and version; none when the group is not there."""
        path = f"/apis/{group}/{version}"
        try:
            answer = await self.json(Request("get", "apis", f"{group}/{version}", "GET", path))
        except NotFound:
            return frozenset()
        return frozenset(resource["name"] for resource in answer.get("resources") or ())

    async def workloads(self, namespace: str, job_uid: str) -> Objects:
        """Return Kueue's Workloads of a Job, which is one at most.

        Raises:
            Forbidden, NotFound: the account may not list them, or there is no Kueue.
        """
        path = f"/apis/kueue.x-k8s.io/v1beta2/namespaces/{namespace}/workloads"
        query = {"labelSelector": f"kueue.x-k8s.io/job-uid={job_uid}"}
        request = Request("list", "workloads.kueue.x-k8s.io", namespace, "GET", path, query=query)
        answer = await self.json(request, attempts=1)
        return [*(answer.get("items") or ())]

    async def schemas(self, group: str, version: str) -> dict[str, Object]:
        """Return the schemas of a group's kinds, by kind; none where the account may not see them.

        Whoever may discover what a server has may read them, as each account may by default.
        """
        path = f"/openapi/v3/apis/{group}/{version}"
        try:
            answer = await self.json(Request("get", "openapi", f"{group}/{version}", "GET", path), attempts=1)
        except (Forbidden, NotFound):
            return {}
        found = (answer.get("components") or {}).get("schemas") or {}
        return {
            named["kind"]: schema
            for schema in found.values()
            for named in schema.get("x-kubernetes-group-version-kind") or ()
        }

    async def cluster_uid(self) -> str | None:
        """Return the identity of this cluster among all others; None where the account may not see it.

        It is the uid of the namespace that every cluster has.
        """
        path = "/api/v1/namespaces/kube-system"
        try:
            answer = await self.json(Request("get", "namespaces", "kube-system", "GET", path))
        except (Forbidden, NotFound):
            return None
        return str(answer["metadata"]["uid"])

    async def server_version(self) -> str:
        """Return the server's version, such as v1.34.4."""
        answer = await self.json(Request("get", "version", "of the server", "GET", "/version"))
        return str(answer.get("gitVersion", "unknown"))

    async def event(self, kind: Kind, regarding: Object, event_type: str, reason: str, message: str) -> bool:
        """Attach an Event to an object; the same one again counts up. Returns whether it could be.

        Events are courtesy: no failure to write one is raised.

        Args:
            kind: the object's kind.
            regarding: the object.
            event_type: Normal or Warning.
            reason: one word.
            message: a sentence.
        """
        body = event_body(
            kind, regarding, event_type=event_type, reason=reason, message=message, now=time.time()
        )
        try:
            await self._write_event(body)
        except ApiError:
            return False
        return True

    async def events(self, namespace: str, reason: str, uid: str | None = None) -> Objects:
        """Return the Events that give a reason, the newest last.

        The server goes through all Events of the namespace for it, however few are chosen.

        Args:
            namespace: where.
            reason: one word, such as FailedCreate.
            uid: uid of the object that they are about; None: any.
        """
        path = f"/api/v1/namespaces/{namespace}/events"
        chosen = f"reason={reason}" + (f",involvedObject.uid={uid}" if uid else "")
        items: Objects = []
        following: str | None = None
        while True:
            query = {"fieldSelector": chosen, "limit": PAGE, "continue": following}
            answer = await self.json(Request("list", "events", namespace, "GET", path, query=query))
            items += answer.get("items") or ()
            following = (answer.get("metadata") or {}).get("continue")
            if not following:
                return sorted(
                    items, key=lambda item: item.get("lastTimestamp") or item.get("eventTime") or ""
                )

    async def _write_event(self, body: Object) -> None:
        name, namespace = body["metadata"]["name"], body["metadata"]["namespace"]
        path = f"/api/v1/namespaces/{namespace}/events"
        target = f"{namespace}/{name}"
        try:
            await self.json(Request("create", "events", target, "POST", path, body=body), attempts=2)
        except AlreadyExists:
            present = await self.json(Request("get", "events", target, "GET", f"{path}/{name}"))
            change = {"count": int(present.get("count") or 1) + 1, "lastTimestamp": body["lastTimestamp"]}
            await self.json(
                Request(
                    "patch", "events", target, "PATCH", f"{path}/{name}", body=change, content_type=_MERGE
                ),
                attempts=2,
            )

    async def _pages(
        self,
        kind: Kind,
        namespace: str,
        labels: str | None,
        narrow: Callable[[Object], Object] | None,
        page: int,
    ) -> tuple[Objects, str]:
        items: Objects = []
        following: str | None = None
        while True:
            query = {"labelSelector": labels, "limit": page or None, "continue": following}
            request = Request("list", kind.resource, namespace, "GET", kind.path(namespace), query=query)
            answer = await self.json(request)
            got = answer.get("items") or []
            items += got if narrow is None else map(narrow, got)
            following = answer["metadata"].get("continue")
            if not following:
                return items, str(answer["metadata"].get("resourceVersion", ""))


def _named(key: Key, subresource: str = "") -> tuple[str, str]:
    resource = f"{key.kind.resource}/{subresource}" if subresource else key.kind.resource
    return resource, f"{key.namespace}/{key.name}"


def _path(key: Key, subresource: str = "") -> str:
    return key.kind.path(key.namespace, key.name, subresource)
