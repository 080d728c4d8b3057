# SPDX-License-Identifier: Apache-2.0
"""kopf, and what follows runs, Jobs and pods, on a server that lists and streams what it is told to."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
from typing import TYPE_CHECKING, Any

import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer
from anyio.from_thread import start_blocking_portal
from kubernetes.aio.client import ApiClient, Configuration

from slamhive.kube import handlers
from slamhive.kube.api.client import Api
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.cluster import Cluster
from slamhive.kube.operator import Operator
from slamhive.kube.settings import Settings

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator

SETTINGS = Settings.model_validate(
    {
        "namespaces": ["lab"],
        "image": "slamhive",
        "volumes": {"results": {"claim": "r"}, "data": {"claim": "d"}},
    }
)
RUNS = Kind.MAPPING_RUN.path("lab")
GROUPS = [
    {
        "name": kind.group,
        "preferredVersion": {"version": kind.version},
        "versions": [{"version": kind.version}],
    }
    for kind in (Kind.JOB, Kind.SWEEP)
]
PODS = Kind.POD.path("lab")


def thing(name: str, version: int) -> dict[str, Any]:
    metadata = {"name": name, "namespace": "lab", "uid": f"uid-{name}", "resourceVersion": str(version)}
    return {"metadata": metadata, "spec": {}, "status": {}}


class Server:
    """Discovery, lists and watches; each watch streams the next of its kind's ``streams``, then ends."""

    def __init__(self) -> None:
        self.listed: dict[str, list[dict[str, Any]]] = {}
        self.streams: dict[str, list[list[dict[str, Any]]]] = {}
        self.asked: list[tuple[str, str, dict[str, str]]] = []

    async def handle(self, request: web.Request) -> web.StreamResponse:
        self.asked.append((request.method, request.path, dict(request.query)))
        if "namespaces" not in request.path:
            return web.json_response(_discovered(request.path))
        if request.query.get("watch") != "true":
            items = self.listed.get(request.path, [])
            return web.json_response({"metadata": {"resourceVersion": "10"}, "items": items})
        response = web.StreamResponse()
        await response.prepare(request)
        streams = self.streams.get(request.path)
        if streams:
            for event in streams.pop(0):
                await response.write(json.dumps(event).encode() + b"\n")
            return response
        await asyncio.Event().wait()
        return response


def _discovered(path: str) -> dict[str, Any]:
    kinds = [kind for kind in Kind if path in {f"/apis/{kind.api_version}", f"/api/{kind.api_version}"}]
    verbs = ["get", "list", "watch", "patch"]
    named = [
        {"name": kind.plural, "singularName": "", "kind": str(kind), "namespaced": True, "verbs": verbs}
        for kind in kinds
    ]
    spaces = {
        "name": "namespaces",
        "singularName": "",
        "kind": "Namespace",
        "namespaced": False,
        "verbs": verbs,
    }
    if path == "/api/v1":
        named.append(spaces)
    return {"resources": named, "versions": ["v1"], "groups": GROUPS}


@pytest.fixture
def server() -> Server:
    return Server()


@pytest.fixture
def address(server: Server) -> Iterator[str]:
    """Address of the server, which has a loop of its own: kopf ends younger tasks, even of who accepts."""
    application = web.Application()
    application.router.add_route("*", "/{path:.*}", server.handle)
    with (
        start_blocking_portal() as portal,
        portal.wrap_async_context_manager(TestServer(application)) as listening,
    ):
        yield str(listening.make_url("")).rstrip("/")


@contextlib.asynccontextmanager
async def watching(address: str) -> AsyncIterator[Operator]:
    """Let kopf watch. It ends all tasks younger than itself, so this is no fixture."""
    api = Api(ApiClient(Configuration(host=address)))
    op = Operator(Cluster(api, SETTINGS), {})
    task = asyncio.create_task(handlers.watch(op))
    try:
        yield op
    finally:
        task.cancel()
        await asyncio.wait([task])
        await api.close()


async def eventually(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(50):
        while not condition():  # noqa: ASYNC110 - what happens is behind a connection
            await asyncio.sleep(0.01)


@pytest.mark.parametrize("kind", [Kind.SWEEP, Kind.MAPPING_RUN, Kind.JOB, Kind.POD])
async def test_what_is_listed_and_watched_enters_the_store_even_when_watches_are_cut(
    server: Server, address: str, kind: Kind
) -> None:
    path = kind.path("lab")
    server.listed[path] = [thing("listed", 5)]
    server.streams[path] = [
        [{"type": "ADDED", "object": thing("added", 11)}],
        [{"type": "DELETED", "object": thing("listed", 12)}],
        [{"type": "ERROR", "object": {"kind": "Status", "code": 410}}],
    ]
    async with watching(address) as op:
        await eventually(lambda: names_of(op, kind) == {"added"})
        server.listed[path] = [thing("added", 11), thing("after", 20)]
        await eventually(lambda: names_of(op, kind) == {"added", "after"})


def names_of(op: Operator, kind: Kind) -> set[str]:
    return {obj["metadata"]["name"] for obj in op.cluster.store.of(kind, "lab")}


async def test_only_our_pods_are_watched_and_nothing_is_written(server: Server, address: str) -> None:
    async with watching(address):
        await eventually(lambda: any(path == PODS and "watch" in query for _, path, query in server.asked))
    for method, path, query in server.asked:
        assert method == "GET"
        if path == PODS:
            assert query["labelSelector"] == "app.kubernetes.io/managed-by=slamhive"
        if path == RUNS:
            assert "labelSelector" not in query


async def test_nobody_is_killed_minutes_after_the_watching_ended(
    server: Server, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, timers = asyncio.get_running_loop(), []
    call_later = loop.call_later

    def noting(delay: float, callback: Callable[..., Any], *args: Any, **options: Any) -> Any:
        timers.append(callback)
        return call_later(delay, callback, *args, **options)

    monkeypatch.setattr(loop, "call_later", noting)
    async with watching(address):
        await eventually(lambda: any(path == PODS and "watch" in query for _, path, query in server.asked))
    assert timers, "kopf sets some"
    assert signal.pthread_kill not in timers


def test_kopf_keeps_its_hands_off() -> None:
    settings = handlers.settings_for_kopf()
    assert settings.scanning.disabled
    assert not settings.posting.enabled
    assert settings.watching.server_timeout == 600
    assert 60 < settings.watching.inactivity_timeout < 120
    assert isinstance(settings.persistence.diffbase_storage, handlers.NoDiffs)


@pytest.fixture
async def unconnected() -> AsyncIterator[Cluster]:
    api = Api(ApiClient(Configuration(host="http://none")))
    yield Cluster(api, SETTINGS)
    await api.close()


async def test_no_handler_asks_for_a_finalizer(unconnected: Cluster) -> None:
    registry = handlers.registry_for(unconnected)
    assert len([*registry._watching.get_all_handlers()]) == len(handlers.WATCHED)
    for unwanted in (registry._changing, registry._spawning, registry._indexing):
        assert not [*unwanted.get_all_handlers()]


async def test_each_kind_is_handed_over_as_itself(unconnected: Cluster) -> None:
    for handler in handlers.registry_for(unconnected)._watching.get_all_handlers():
        await handler.fn(event={"type": None, "object": thing(f"of-{handler.id}", 3)})  # type: ignore[call-arg, misc]
    for kind in handlers.WATCHED:
        assert unconnected.store.get(Key(kind, "lab", f"of-{kind.plural}")) is not None
