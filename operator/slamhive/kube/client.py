# SPDX-License-Identifier: Apache-2.0
"""The only way to the Kubernetes API: plain JSON in and out over one pool of connections.

All calls pass through ``Api._call``: there they are counted, repeated where that is safe, and broken on
purpose by tests. A call whose answer was lost may have been carried out. Repeating it is safe: a create then
finds the name taken (``AlreadyExists``), a checked patch finds a newer object (``Conflict``), a delete finds
nothing.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import random
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import aiohttp
from kubernetes.aio.client import ApiClient, Configuration
from kubernetes.aio.config import ConfigException, load_incluster_config, load_kube_config

from slamhive.kube.errors import (
    AlreadyExists,
    ApiError,
    Conflict,
    Expired,
    NotFound,
    ServerFault,
    StartError,
    TooManyRequests,
    from_answer,
)

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping
    from pathlib import Path

    from slamhive.kube.kinds import Key, Kind

Object = dict[str, Any]
Objects = list[Object]

PAGE = 500
ATTEMPTS = 5
FIRST_BACKOFF_SECONDS = 0.2
LAST_BACKOFF_SECONDS = 10.0
LONGEST_WAIT_SECONDS = 30.0
TIMEOUT_SECONDS = 30.0
CONNECT_SECONDS = 10.0
CONNECTIONS = 32

_MERGE = "application/merge-patch+json"
_JSON = "application/json"
_METRICS = "/apis/metrics.k8s.io/v1beta1"
_LONGEST_NOTE = 1024


@dataclass(frozen=True)
class _Request:
    """One call: how roles name it, and how HTTP does."""

    verb: str
    resource: str
    target: str
    method: str
    path: str
    query: Mapping[str, Any] | None = None
    body: Object | None = None
    content_type: str = _JSON


class Api:
    """The Kubernetes API in plain JSON.

    Args:
        client: the official client, which knows address, certificates and tokens.
        fault: called with ("before" | "after", verb, resource) around each attempt of each call; what it
            raises is treated like a fault of the connection if it is one (OSError), and passes otherwise.
        count: called with (verb, resource, status or reason) after each attempt.
        sleep: waits some seconds.
        jitter: returns a number in [0, 1).
        attempts: times that a call is tried.
    """

    def __init__(
        self,
        client: ApiClient,
        *,
        fault: Callable[[str, str, str], None] | None = None,
        count: Callable[[str, str, str], None] | None = None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
        jitter: Callable[[], float] = random.random,
        attempts: int = ATTEMPTS,
    ) -> None:
        self._client = client
        self.fault = fault
        self.count = count
        self._sleep = sleep
        self._jitter = jitter
        self._attempts = attempts

    @classmethod
    async def connect(cls, kubeconfig: Path | None = None, context: str | None = None, **options: Any) -> Api:
        """Return the API of the cluster this program runs in or, else, of a kubeconfig.

        Args:
            kubeconfig: file to use even inside a cluster; default: the KUBECONFIG variable or ~/.kube/config.
            context: context of the kubeconfig; default: its current one.
            options: as for the class.

        Raises:
            StartError: neither is there.
        """
        configuration = Configuration()
        configuration.connection_pool_maxsize = CONNECTIONS
        try:
            if kubeconfig is None and context is None:
                try:
                    load_incluster_config(client_configuration=configuration)  # type: ignore[no-untyped-call]
                    return cls(ApiClient(configuration), **options)
                except ConfigException:
                    pass
            file = str(kubeconfig) if kubeconfig else os.environ.get("KUBECONFIG")
            await load_kube_config(  # type: ignore[no-untyped-call]
                config_file=file, context=context, client_configuration=configuration
            )
        except (ConfigException, OSError) as error:
            raise StartError(
                f"no cluster is known: this is not a pod of one, and there is no usable kubeconfig ({error}); set "
                " KUBECONFIG or write ~/.kube/config"
            ) from None
        return cls(ApiClient(configuration), **options)

    async def close(self) -> None:
        """Close all connections."""
        await self._client.close()  # type: ignore[no-untyped-call]

    async def get(self, key: Key) -> Object:
        """Return an object.

        Raises:
            NotFound: it is not there.
            ApiError: see ``slamhive.kube.errors``.
        """
        return await self._json(_Request("get", *_named(key), "GET", _path(key)))

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
        request = _Request("create", kind.resource, target, "POST", kind.path(namespace), body=body)
        return await self._json(request, again_on=(Conflict,))  # a Conflict here is a quota being counted

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
        return await self._json(
            _Request("patch", resource, target, "PATCH", path, body=body, content_type=_MERGE)
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
        """Delete an object; returns it if it has still to end, None when it is gone (or was).

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
            answer = await self._json(_Request("delete", *_named(key), "DELETE", _path(key), body=body))
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
        """Return what a container wrote; bytes that are not UTF-8 are replaced."""
        query = {"container": container, "tailLines": tail_lines, "limitBytes": limit_bytes}
        path = f"/api/v1/namespaces/{namespace}/pods/{pod}/log"
        content = await self._call(
            _Request("get", "pods/log", f"{namespace}/{pod}", "GET", path, query=query)
        )
        return content.decode(errors="replace")

    async def pod_metrics(self, namespace: str, labels: str | None = None) -> Objects:
        """Return the metrics API's PodMetrics of a namespace.

        Raises:
            NotFound, ServerFault: the cluster has no metrics API, or it does not answer.
        """
        path = f"{_METRICS}/namespaces/{namespace}/pods"
        request = _Request(
            "list", "pods.metrics.k8s.io", namespace, "GET", path, query={"labelSelector": labels}
        )
        answer = await self._json(request, attempts=1)
        return [*(answer.get("items") or ())]

    async def served(self, group: str, version: str) -> frozenset[str]:
        """Return the plurals of the resources of a group and version; none when the group is not there."""
        path = f"/apis/{group}/{version}"
        try:
            answer = await self._json(_Request("get", "apis", f"{group}/{version}", "GET", path))
        except NotFound:
            return frozenset()
        return frozenset(resource["name"] for resource in answer.get("resources") or ())

    async def server_version(self) -> str:
        """Return the server's version, such as v1.34.4."""
        answer = await self._json(_Request("get", "version", "of the server", "GET", "/version"))
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
        metadata = regarding["metadata"]
        message = message[:_LONGEST_NOTE]
        identity = "\0".join([metadata.get("uid", ""), event_type, reason, message])
        name = f"{metadata['name'][:230]}.{hashlib.sha256(identity.encode()).hexdigest()[:16]}"
        now = datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
        body = {
            "apiVersion": "v1",
            "kind": "Event",
            "metadata": {"name": name, "namespace": metadata["namespace"]},
            "involvedObject": {
                "apiVersion": kind.api_version,
                "kind": str(kind),
                "namespace": metadata["namespace"],
                "name": metadata["name"],
                "uid": metadata.get("uid", ""),
            },
            "type": event_type,
            "reason": reason,
            "message": message,
            "source": {"component": "slamhive"},
            "reportingComponent": "slamhive.io/operator",
            "firstTimestamp": now,
            "lastTimestamp": now,
            "count": 1,
        }
        try:
            await self._write_event(body)
        except ApiError:
            return False
        return True

    async def _write_event(self, body: Object) -> None:
        name, namespace = body["metadata"]["name"], body["metadata"]["namespace"]
        path = f"/api/v1/namespaces/{namespace}/events"
        target = f"{namespace}/{name}"
        try:
            await self._json(_Request("create", "events", target, "POST", path, body=body), attempts=2)
        except AlreadyExists:
            present = await self._json(_Request("get", "events", target, "GET", f"{path}/{name}"))
            change = {"count": int(present.get("count") or 1) + 1, "lastTimestamp": body["lastTimestamp"]}
            await self._json(
                _Request(
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
            request = _Request("list", kind.resource, namespace, "GET", kind.path(namespace), query=query)
            answer = await self._json(request)
            got = answer.get("items") or []
            items += got if narrow is None else map(narrow, got)
            following = answer["metadata"].get("continue")
            if not following:
                return items, str(answer["metadata"].get("resourceVersion", ""))

    async def _json(
        self, request: _Request, *, attempts: int | None = None, again_on: tuple[type[ApiError], ...] = ()
    ) -> Object:
        content = await self._call(request, attempts=attempts, again_on=again_on)
        try:
            answer = json.loads(content)
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            raise ServerFault(
                f"cannot {request.verb} {request.resource} {request.target}: the answer is not a JSON object",
                verb=request.verb,
                resource=request.resource,
            )
        return answer

    async def _call(
        self, request: _Request, *, attempts: int | None = None, again_on: tuple[type[ApiError], ...] = ()
    ) -> bytes:
        """Carry out a call, again where it failed in passing."""
        left = self._attempts if attempts is None else attempts
        wait = FIRST_BACKOFF_SECONDS
        while True:
            left -= 1
            try:
                return await self._attempt(request)
            except ApiError as error:
                if not isinstance(error, (TooManyRequests, ServerFault, *again_on)):
                    raise
                asked = getattr(error, "retry_after", None)
                if left <= 0 or (asked or 0.0) > LONGEST_WAIT_SECONDS:
                    raise
                await self._sleep(max(asked or 0.0, wait * (0.5 + 0.5 * self._jitter())))
                wait = min(2 * wait, LAST_BACKOFF_SECONDS)

    async def _attempt(self, request: _Request) -> bytes:
        code = "failed"
        try:
            self._break("before", request)
            status, content, headers = await self._send(request)
            code = str(status)
            self._break("after", request)
        except (aiohttp.ClientError, TimeoutError, OSError) as error:
            said = str(error) or type(error).__name__
            raise ServerFault(
                f"cannot {request.verb} {request.resource} {request.target}: no answer: {said}",
                verb=request.verb,
                resource=request.resource,
            ) from error
        finally:
            if self.count is not None:
                self.count(request.verb, request.resource, code)
        if status >= 400:
            raise from_answer(status, content, headers, request.verb, request.resource, request.target)
        return content

    def _break(self, moment: str, request: _Request) -> None:
        if self.fault is not None:
            self.fault(moment, request.verb, request.resource)

    async def _send(self, request: _Request) -> tuple[int, bytes, Mapping[str, str]]:
        configuration = self._client.configuration
        headers = {"Accept": _JSON, "User-Agent": "slamhive", "Content-Type": request.content_type}
        await self._client.update_params_for_auth(
            headers, [], ["BearerToken"], request.path, request.method, request.body
        )
        query = {name: value for name, value in (request.query or {}).items() if value is not None}
        address = configuration.host + request.path + (f"?{urlencode(query)}" if query else "")
        timeout = aiohttp.ClientTimeout(total=TIMEOUT_SECONDS, connect=CONNECT_SECONDS)
        answer = await self._client.rest_client.request(  # type: ignore[no-untyped-call]
            request.method, address, headers=headers, body=request.body, _request_timeout=timeout
        )
        content: bytes = await answer.read()
        return answer.status, content, answer.headers


def _named(key: Key, subresource: str = "") -> tuple[str, str]:
    resource = f"{key.kind.resource}/{subresource}" if subresource else key.kind.resource
    return resource, f"{key.namespace}/{key.name}"


def _path(key: Key, subresource: str = "") -> str:
    return key.kind.path(key.namespace, key.name, subresource)
