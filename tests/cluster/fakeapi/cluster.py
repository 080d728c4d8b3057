# SPDX-License-Identifier: Apache-2.0
"""A fake cluster: an API server in memory with controllers and played nodes, for tests of the operator.

It runs on a thread and an event loop of its own, as the operator under test ends all tasks of its loop.
It starts in milliseconds and needs neither root nor Go. Tests use it as a real one (testcluster/access.py).
"""

from __future__ import annotations

import asyncio
import json
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Self

from aiohttp import web
from fakeapi.controllers import Garbage, Jobs
from fakeapi.nodes import Nodes, status_of
from fakeapi.objects import Objects
from fakeapi.refusals import Refusal
from fakeapi.resources import EVENTS, NAMESPACES, NODES, PODS, named
from fakeapi.schema import loads
from fakeapi.server import Server
from testcluster.kwok import Play, Pool, node

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from fakeapi.objects import Change
    from fakeapi.server import Refusing
    from testcluster.kwok import Moment

    from slamhive.kube.api.kinds import Object


_PODS_AGAIN_SECONDS = 1.0


class FakeCluster:
    """A cluster that lasts as long as the context.

    Args:
        folder: where its kubeconfig is written.

    Attributes:
        kubeconfig: how it is reached; there when the context is entered.
        log: returns what a container of a pod wrote; nothing by default.
        usage: the metrics API's PodMetrics by pod name; None: there is no metrics API.
    """

    def __init__(self, folder: Path) -> None:
        self.kubeconfig = folder / "kubeconfig"
        self.log: Callable[[Object, str], str] = lambda _pod, _container: ""
        self.usage: dict[str, Object] | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="fake-api-server", daemon=True)
        self._objects = Objects()
        self._objects.heard.append(self._hear)
        self._server = Server(
            self._objects,
            lambda pod, container: self.log(pod, container),  # noqa: PLW0108 - tests replace it
            lambda: self.usage,
        )
        self._nodes = Nodes(self._objects, self._loop.call_later)
        self._jobs = Jobs(self._objects)
        self._garbage = Garbage(self._objects)
        self._unseen: list[Change] = []
        self._asking_again = False
        self._runner = web.AppRunner(self._server.application, access_log=None, shutdown_timeout=1.0)

    def __enter__(self) -> Self:
        self._thread.start()
        asyncio.run_coroutine_threadsafe(self._start(), self._loop).result()
        self.make_namespace("kube-system")
        return self

    def __exit__(self, *error: object) -> None:
        asyncio.run_coroutine_threadsafe(self._stop(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def make_namespace(self, name: str) -> None:
        """Make a namespace."""
        body = {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}}
        self._do(lambda: self._objects.create(NAMESPACES, "", body))

    def apply(self, *objects: Object, namespace: str | None = None) -> None:
        """Create objects, or change those that are there by what is given."""

        def apply() -> None:
            for body in objects:
                resource = named(body["kind"])
                place = body["metadata"].get("namespace") or namespace or ""
                place = place if resource.namespaced else ""
                copied = loads(json.dumps(body))
                try:
                    self._objects.create(resource, place, copied)
                except Refusal as refusal:
                    if refusal.status["reason"] != "AlreadyExists":
                        raise
                    self._objects.patch(resource, place, body["metadata"]["name"], copied)

        self._do(apply)

    def patch(self, kind: str, name: str, change: Object, namespace: str, subresource: str = "") -> None:
        """Change an object by a JSON merge patch."""
        copied = loads(json.dumps(change))
        self._do(lambda: self._objects.patch(named(kind), namespace, name, copied, subresource))

    def delete(self, kind: str, name: str, namespace: str) -> None:
        """Delete an object, without waiting for what it owns."""
        self._do(lambda: self._objects.delete(named(kind), namespace, name))

    def of(self, kind: str, namespace: str) -> list[Object]:
        """Return all objects of a kind."""
        return self._do(lambda: self._objects.of(named(kind), namespace))

    def play_from_now(self, pool: Pool, how: Play) -> None:
        """Have the pods of a pool end otherwise from now on."""
        self._nodes.plays[pool.name] = how

    def end_pod(self, name: str, namespace: str, moment: Moment) -> None:
        """Have a pod that runs end."""

        def end() -> None:
            pod = self._objects.get(PODS, namespace, name)
            self._objects.patch(PODS, namespace, name, {"status": status_of(pod, moment)}, "status")

        self._do(end)

    def ignore_sigterm(self, *, now: bool) -> None:
        """Have pods that are deleted go on, or end all of them."""

        def change() -> None:
            self._nodes.patience = now
            self._nodes.look()

        self._do(change)

    def refuse(self, refusing: Refusing) -> None:
        """Answer calls with a Refusal where the function returns one for verb, resource and body."""
        self._server.refusing = refusing

    def serve_kueue(self, *, now: bool) -> None:
        """Have Kueue's resources served, or no more; its controller is the test's to play."""
        self._server.has_kueue = now

    def end_watches(self) -> None:
        """End all watches that are under way: a server asks for their rights only when they begin."""
        self._do(self._server.end)

    def forget_history(self) -> None:
        """Let all versions so far expire, and the lists that are under way."""
        self._do(self._objects.forget_history)
        self._do(self._server.forget_lists)

    @contextmanager
    def play(self, how: Play | None = None, *, pool: str = "played", nodes: int = 1) -> Iterator[Pool]:
        """Have a pool of nodes whose pods end as asked; arguments as for a real cluster's ``Kwok.play``."""
        names = tuple(f"{pool}-{number}" for number in range(nodes))
        self._nodes.plays[pool] = how or Play()
        self.apply(*(node(name, pool) for name in names))
        yield Pool(pool, names)
        for name in names:
            self._do(lambda name=name: self._objects.delete(NODES, "", name))

    def _do(self, what: Callable[[], Any]) -> Any:
        async def do() -> Any:
            return what()

        return asyncio.run_coroutine_threadsafe(do(), self._loop).result()

    async def _start(self) -> None:
        await self._runner.setup()
        site = web.TCPSite(self._runner, "127.0.0.1", 0)
        await site.start()
        [(_, port)] = self._runner.addresses
        self.kubeconfig.write_text(json.dumps(_kubeconfig(f"http://127.0.0.1:{port}")))

    async def _stop(self) -> None:
        self._server.end()
        connections = [one.transport for one in self._runner.server.connections if one.transport]
        await self._runner.cleanup()
        for transport in connections:
            transport.abort()  # one that nobody reads from any more would never close
        left = asyncio.all_tasks() - {asyncio.current_task()}
        for task in left:
            task.cancel()
        await asyncio.gather(*left, return_exceptions=True)

    def _hear(self, change: Change) -> None:
        if change.resource is EVENTS:
            return  # no controller's business, and a Job whose pod is refused tells of it each time
        if not self._unseen:
            # Not at once: whoever wrote gets its answer first, as on a real cluster.
            self._loop.call_soon(self._control)
        self._unseen.append(change)

    def _control(self) -> None:
        changes, self._unseen = self._unseen, []
        self._garbage.look(changes)
        self._jobs.look()
        self._nodes.look()
        self._ask_again_for_pods()

    def _ask_again_for_pods(self) -> None:
        """Look at Jobs again in a while, if a pod was refused."""

        def again() -> None:
            self._asking_again = False
            self._jobs.look()
            self._ask_again_for_pods()

        if self._jobs.refused and not self._asking_again:
            self._asking_again = True
            self._loop.call_later(_PODS_AGAIN_SECONDS, again)


def _kubeconfig(address: str) -> Object:
    return {
        "apiVersion": "v1",
        "kind": "Config",
        "clusters": [{"name": "fake", "cluster": {"server": address}}],
        "users": [{"name": "fake", "user": {}}],
        "contexts": [{"name": "fake", "context": {"cluster": "fake", "user": "fake"}}],
        "current-context": "fake",
    }
