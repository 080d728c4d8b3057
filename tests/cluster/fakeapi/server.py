# SPDX-License-Identifier: Apache-2.0
"""HTTP server that speaks the Kubernetes API for the objects of a fake cluster."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from aiohttp import web
from fakeapi.refusals import Refusal, bad_request, expired, not_found
from fakeapi.resources import PODS, WORKLOADS, Resource, at, resources
from fakeapi.schema import loads
from fakeapi.selectors import selecting

from slamhive.kube.api.kinds import Object

if TYPE_CHECKING:
    from collections.abc import Iterator

    from fakeapi.objects import Change, Objects


Refusing = Callable[[str, str, Object], Refusal | None]

LONGEST_WATCH_SECONDS = 1800.0
BOOKMARK_SECONDS = 60.0
LAST_BOOKMARK_SECONDS = 2.0
"""Time between the last bookmark of a watch and its end, as on a real server."""
_METHODS = {"POST": "create", "PATCH": "patch", "DELETE": "delete"}
_METRICS = "/apis/metrics.k8s.io/"
_KUEUE = f"/apis/{WORKLOADS.group}/"
_VERSION = {"major": "1", "minor": "34", "gitVersion": "v1.34.0-fake"}


class Server:
    """Answers calls.

    Args:
        objects: what there is.
        log: returns what a container of a pod wrote.
        usage: returns the metrics API's PodMetrics by pod name, None where there is no metrics API.

    Attributes:
        refusing: asked before each call with its verb and resource, as roles name them, and its body; a
            Refusal that is returned is the answer.
        has_kueue: whether Kueue's resources are served.
    """

    def __init__(
        self,
        objects: Objects,
        log: Callable[[Object, str], str],
        usage: Callable[[], dict[str, Object] | None],
    ) -> None:
        self._objects = objects
        self._log = log
        self._usage = usage
        self._lists: dict[str, tuple[int, list[Object]]] = {}
        self._tokens = itertools.count(1)
        self._watches: dict[asyncio.Queue[Change | None], None] = {}
        self.has_kueue = False
        self.refusing: Refusing = lambda _verb, _resource, _body: None
        objects.heard.append(self._tell)

    @property
    def application(self) -> web.Application:
        """Return the application."""
        application = web.Application(client_max_size=3 << 20)
        application.router.add_route("*", "/{path:.*}", self._answer)
        return application

    def end(self) -> None:
        """End all watches."""
        for queue in self._watches:
            queue.put_nowait(None)

    def forget_lists(self) -> None:
        """Forget where lists that are under way go on, as a server does after some minutes."""
        self._lists.clear()

    def _tell(self, change: Change) -> None:
        for queue in self._watches:
            queue.put_nowait(change)

    async def _answer(self, request: web.Request) -> web.StreamResponse:
        try:
            return await self._route(request)
        except Refusal as refusal:
            return web.json_response(refusal.status, status=refusal.code)

    async def _route(self, request: web.Request) -> web.StreamResponse:
        if request.path.startswith(_KUEUE) and not self.has_kueue:
            raise Refusal(404, "NotFound", "the server could not find the requested resource")
        if request.path.startswith(_METRICS) and (no := self.refusing("list", "pods.metrics.k8s.io", {})):
            raise no
        known = self._measured() if request.path.startswith(_METRICS) else _discovered(request.path)
        if known is not None:
            return web.json_response(known)
        resource, namespace, name, subresource = _addressed(request.path)
        verb = _METHODS.get(request.method) or ("get" if name else "list")
        if request.query.get("watch") in {"true", "1"}:
            verb = "watch"
        full = f"{resource.plural}/{subresource}" if subresource else resource.plural
        body = await _body(request)
        refusal = self.refusing(verb, f"{full}.{resource.group}" if resource.group else full, body)
        if refusal is not None:
            raise refusal
        if verb == "watch":
            return await self._watch(request, resource, namespace)
        if subresource == "log":
            pod = self._objects.get(resource, namespace, name)
            return web.Response(text=self._log(pod, request.query.get("container", "")))
        if verb == "list":
            return web.json_response(self._list(request, resource, namespace))
        answer = self._carried_out(verb, resource, (namespace, name, subresource), body)
        return web.json_response(answer, status=201 if verb == "create" else 200)

    def _carried_out(
        self, verb: str, resource: Resource, place: tuple[str, str, str], body: Object
    ) -> Object:
        namespace, name, subresource = place
        match verb:
            case "create":
                return _typed(resource, self._objects.create(resource, namespace, body))
            case "patch":
                return _typed(resource, self._objects.patch(resource, namespace, name, body, subresource))
            case "delete":
                return self._deleted(resource, namespace, name, body)
            case _:
                return _typed(resource, self._objects.get(resource, namespace, name))

    def _measured(self) -> Object | None:
        found = self._usage()
        return None if found is None else {"kind": "PodMetricsList", "items": [*found.values()]}

    def _deleted(self, resource: Resource, namespace: str, name: str, options: Object) -> Object:
        last = self._objects.delete(resource, namespace, name, options)
        if resource is PODS or last["metadata"].get("deletionTimestamp"):
            return _typed(resource, last)
        details = {
            "name": name,
            "group": resource.group,
            "kind": resource.plural,
            "uid": last["metadata"]["uid"],
        }
        return {"kind": "Status", "apiVersion": "v1", "metadata": {}, "status": "Success", "details": details}

    def _list(self, request: web.Request, resource: Resource, namespace: str) -> Object:
        following = request.query.get("continue")
        if following:
            if following not in self._lists:
                raise expired(
                    "The provided continue parameter is too old to display a consistent list result."
                )
            version, found = self._lists[following]
        else:
            holds = selecting(request.query.get("labelSelector"), request.query.get("fieldSelector"))
            version = self._objects.version
            found = [obj for obj in self._objects.of(resource, namespace) if holds(obj)]
        limit = int(request.query.get("limit", 0)) or len(found)
        metadata: Object = {"resourceVersion": str(version)}
        if len(found) > limit:
            token = f"page-{next(self._tokens)}"
            self._lists[token] = (version, found[limit:])
            metadata |= {"continue": token, "remainingItemCount": len(found) - limit}
        kind = {"kind": f"{resource.kind}List", "apiVersion": resource.api_version}
        # Like a real server: the items of built-in kinds do not say what they are.
        items = found[:limit] if resource.schema is None else [_typed(resource, obj) for obj in found[:limit]]
        return kind | {"metadata": metadata, "items": items}

    async def _watch(self, request: web.Request, resource: Resource, namespace: str) -> web.StreamResponse:
        query = request.query
        holds = selecting(query.get("labelSelector"), query.get("fieldSelector"))
        stream = _Stream(web.StreamResponse(), resource, namespace, holds)
        begin = int(query.get("resourceVersion") or 0)
        try:
            missed = self._objects.since(begin) if begin else []
        except Refusal as refusal:
            await stream.response.prepare(request)
            await stream.send("ERROR", refusal.status)
            return stream.response
        there = [] if begin else [obj for obj in self._objects.of(resource, namespace) if holds(obj)]
        self._watches[stream.changes] = None
        seconds = float(query.get("timeoutSeconds") or LONGEST_WATCH_SECONDS)
        try:
            await stream.response.prepare(request)
            for obj in there:
                await stream.send("ADDED", _typed(resource, obj))
            for change in missed:
                await stream.tell(change)
            marks = query.get("allowWatchBookmarks") in {"true", "1"}
            await stream.go_on(seconds, (lambda: self._objects.version) if marks else None)
        except ConnectionResetError:
            pass  # whoever watched has gone
        finally:
            del self._watches[stream.changes]
        return stream.response


@dataclass(frozen=True)
class _Stream:
    """The answer to a watch."""

    response: web.StreamResponse
    resource: Resource
    namespace: str
    holds: Callable[[Object], bool]
    changes: asyncio.Queue[Change | None] = field(default_factory=asyncio.Queue)
    """Changes to tell; None ends the watch."""

    async def go_on(self, seconds: float, version: Callable[[], int] | None) -> None:
        """Tell changes as they come; with bookmarks where a function tells the newest version."""
        loop = asyncio.get_running_loop()
        end = loop.time() + seconds
        while (left := end - loop.time()) > 0:
            last = left - LAST_BOOKMARK_SECONDS
            pause = left if version is None or last <= 0 else min(BOOKMARK_SECONDS, last)
            try:
                change = await asyncio.wait_for(self.changes.get(), pause)
            except TimeoutError:
                if version is not None and end > loop.time():
                    await self.send("BOOKMARK", _bookmark(self.resource, version()))
                continue
            if change is None:
                return
            await self.tell(change)

    async def tell(self, change: Change) -> None:
        """Tell a change, if it concerns those who watch."""
        namespace = change.last["metadata"].get("namespace", "")
        if change.resource is not self.resource or self.namespace not in {"", namespace}:
            return
        # An object that comes to be selected, or is so no more, appears or goes for those who watch.
        before = change.before is not None and self.holds(change.before)
        after = change.after is not None and self.holds(change.after)
        words = {(False, True): "ADDED", (True, True): "MODIFIED", (True, False): "DELETED"}
        if (before, after) in words:
            await self.send(words[before, after], _typed(self.resource, change.last))

    async def send(self, word: str, obj: Object) -> None:
        """Send an event."""
        await self.response.write(json.dumps({"type": word, "object": obj}).encode() + b"\n")


def _typed(resource: Resource, obj: Object) -> Object:
    return {"kind": resource.kind, "apiVersion": resource.api_version} | obj


def _bookmark(resource: Resource, version: int) -> Object:
    return _typed(resource, {"metadata": {"resourceVersion": str(version), "creationTimestamp": None}})


async def _body(request: web.Request) -> Object:
    wanted = "application/merge-patch+json" if request.method == "PATCH" else "application/json"
    content = await request.read()
    if not content:
        return {}
    if request.content_type != wanted:
        message = f"the fake API server takes {wanted}, not {request.content_type}"
        raise Refusal(415, "UnsupportedMediaType", message)
    try:
        body = loads(content)
    except ValueError:
        raise bad_request("the body is not JSON") from None
    if not isinstance(body, dict):
        raise bad_request("the body is no object")
    return body


def _addressed(path: str) -> tuple[Resource, str, str, str]:
    """Return resource, namespace, name and subresource of an address; empty where it has none."""
    parts = path.strip("/").split("/")
    group, version, rest = ("", parts[1], parts[2:]) if parts[0] == "api" else (*parts[1:3], parts[3:])
    namespace = ""
    if len(rest) > 2 and rest[0] == "namespaces":
        namespace, rest = rest[1], rest[2:]
    plural, name, subresource = (*rest, "", "", "")[:3]
    resource = at(group, version, plural) if parts[0] in {"api", "apis"} else None
    allowed = {"", "status"} if resource is not None and resource.has_status else {""}
    if resource is None or subresource not in allowed | ({"log"} if resource is PODS else set()):
        raise Refusal(404, "NotFound", "the server could not find the requested resource")
    if resource.namespaced and not namespace and name:
        raise not_found(resource.name, name)
    return resource, namespace, name, subresource


def _discovered(path: str) -> Object | None:
    """Return the server's description of itself under an address; None where objects are meant."""
    groups = {resource.group: resource.version for resource in resources()}
    if path.startswith("/openapi/v3/apis/"):
        group, _, version = path.removeprefix("/openapi/v3/apis/").partition("/")
        return {"components": {"schemas": _schemas(group, version)}}
    if path == "/version":
        return dict(_VERSION)
    if path == "/api":
        return {"kind": "APIVersions", "versions": ["v1"]}
    if path == "/apis":
        named = [_group(group, version) for group, version in groups.items() if group]
        return {"kind": "APIGroupList", "apiVersion": "v1", "groups": named}
    for group, version in groups.items():
        if path == (f"/apis/{group}/{version}" if group else f"/api/{version}"):
            found = [*_served(group)]
            word = f"{group}/{version}" if group else version
            return {"kind": "APIResourceList", "groupVersion": word, "resources": found}
    return None


def _schemas(group: str, version: str) -> Object:
    return {
        f"{group}.{one.kind}": {
            **one.schema,
            "x-kubernetes-group-version-kind": [{"group": group, "version": version, "kind": one.kind}],
        }
        for one in resources()
        if (one.group, one.version) == (group, version) and one.schema is not None
    }


def _group(group: str, version: str) -> Object:
    found = {"groupVersion": f"{group}/{version}", "version": version}
    return {"name": group, "versions": [found], "preferredVersion": found}


def _served(group: str) -> Iterator[Object]:
    for resource in resources():
        if resource.group == group:
            yield from resource.described
