# SPDX-License-Identifier: Apache-2.0
"""Logs as they come, from a server that breaks off and repeats itself as the real one does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer
from kubernetes.aio.client import ApiClient, Configuration

from slamhive.kube.api.errors import Forbidden
from slamhive.kube.api.kinds import Kind, Label
from slamhive.kube.user import logs
from slamhive.kube.user.api import UserApi
from slamhive.kube.user.connecting import ConnectedCluster, Target
from slamhive.kube.user.logs import LogPart, read_log

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator

TIMES = [f"2026-01-01T00:00:0{second}.{part}Z" for second in (1, 2) for part in ("1", "123456789", "5")]
WRITTEN = [f"{stamp} line {number}\n".encode() for number, stamp in enumerate(TIMES)]


class Server:
    """One run whose pod writes six lines; the connection breaks where it is told to."""

    def __init__(self) -> None:
        self.breaks: list[int] = []
        self.phase = "Running"
        self.state: dict[str, Any] = {"running": {}}
        self.attempt = "1"
        self.asked: list[dict[str, str]] = []
        self.refuse = 0

    async def run(self, request: web.Request) -> web.Response:
        meta = {"name": "one", "uid": "u", "creationTimestamp": "2026-01-01T00:00:00Z"}
        return web.json_response({"metadata": meta, "spec": {}, "status": {"phase": self.phase}})

    async def pods(self, request: web.Request) -> web.Response:
        labels = {str(Label.ATTEMPT): self.attempt}
        meta = {"name": f"one-{self.attempt}", "creationTimestamp": "2026-01-01T00:00:00Z", "labels": labels}
        status = {"containerStatuses": [{"name": "algorithm", "state": self.state}]}
        pod = {"metadata": meta, "spec": {"containers": [{"name": "algorithm"}]}, "status": status}
        return web.json_response({"metadata": {"resourceVersion": "1"}, "items": [pod]})

    async def log(self, request: web.Request) -> web.StreamResponse:
        self.asked.append(dict(request.query))
        if self.refuse:
            return web.json_response({"message": "no"}, status=self.refuse)
        since = request.query.get("sinceTime", "")[:19]  # the real server forgets fractions too
        lines = [line for line in WRITTEN if line[:19].decode() >= since]
        answer = web.StreamResponse()
        await answer.prepare(request)
        count = self.breaks.pop(0) if self.breaks else None
        for line in lines[:count]:
            await answer.write(line[:30])
            await answer.write(line[30:])
        if count is not None:
            assert request.transport is not None
            request.transport.close()
            return answer
        self.phase, self.state = "Succeeded", {"terminated": {}}
        return answer


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setattr(logs, "_PAUSE_SECONDS", 0.0)
    return Server()


@pytest.fixture
async def cluster(server: Server) -> AsyncIterator[ConnectedCluster]:
    application = web.Application()
    place = "/namespaces/lab"
    runs = Kind.MAPPING_RUN.path("lab", "one")
    application.router.add_get(runs, server.run)
    application.router.add_get(f"/api/v1{place}/pods", server.pods)
    application.router.add_get(f"/api/v1{place}/pods/{{pod}}/log", server.log)
    async with TestServer(application) as running:
        api = UserApi(ApiClient(Configuration(host=str(running.make_url("")).rstrip("/"))), attempts=1)
        yield ConnectedCluster(api, Target(None, None, "lab"))
        await api.close()


async def lines(cluster: ConnectedCluster, **options: Any) -> list[str]:
    return [
        text async for part, text in read_log(cluster, "one", "algorithm", **options) if part is LogPart.LINE
    ]


async def test_all_lines_come_in_order(cluster: ConnectedCluster) -> None:
    assert await lines(cluster) == [f"line {number}" for number in range(6)]


@pytest.mark.parametrize("breaks", [[1], [2, 3], [0, 4, 1], [5]])
async def test_a_broken_connection_loses_and_repeats_nothing(
    cluster: ConnectedCluster, server: Server, breaks: list[int]
) -> None:
    server.breaks = breaks
    assert await lines(cluster, follow=True) == [f"line {number}" for number in range(6)]


async def test_a_tail_is_asked_for_once(cluster: ConnectedCluster, server: Server) -> None:
    server.breaks = [3]
    await lines(cluster, follow=True, tail=2)
    assert [asked.get("tailLines") for asked in server.asked][:2] == ["2", None]


async def test_further_attempts_are_followed_and_told(cluster: ConnectedCluster, server: Server) -> None:
    server.attempt = "2"
    told = [item async for item in read_log(cluster, "one", "algorithm", follow=True)]
    assert told[0] == (LogPart.REMARK, "attempt 2")
    assert len(told) == 7


async def test_a_log_that_cannot_be_read_is_told(cluster: ConnectedCluster, server: Server) -> None:
    server.refuse, server.phase = 500, "Succeeded"
    told = [text async for _, text in read_log(cluster, "one", "algorithm")]
    assert "cannot get pods/log lab/one-1" in told[0]


async def test_a_right_that_is_missing_is_an_error(cluster: ConnectedCluster, server: Server) -> None:
    server.refuse = 403
    with pytest.raises(Forbidden, match="pods/log"):
        await lines(cluster)
