# SPDX-License-Identifier: Apache-2.0
"""The client against a server that answers what it is told to."""

from __future__ import annotations

import json
from collections import deque
from typing import TYPE_CHECKING, Any

import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer
from kubernetes.aio.client import ApiClient, Configuration

from slamhive.kube.api import errors
from slamhive.kube.api.client import Api
from slamhive.kube.api.kinds import Key, Kind
from slamhive.kube.api.transport import ATTEMPTS

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Mapping
    from pathlib import Path

RUN = Key(Kind.MAPPING_RUN, "lab", "demo")
BODY = {"metadata": {"name": "demo", "namespace": "lab"}, "spec": {}}
CUT = object()
TOKEN = "a-bearer-token"  # noqa: S105


class Script:
    """Answers in the order given, then the last one for ever; keeps what was asked."""

    def __init__(self) -> None:
        self.answers: deque[Any] = deque()
        self.asked: list[tuple[str, str, Any]] = []
        self.headers: list[Mapping[str, str]] = []
        self.waits: list[float] = []
        self.counted: list[tuple[str, str, str]] = []

    def say(self, status: int, body: Any = None, **headers: str) -> None:
        self.answers.append((status, {} if body is None else body, headers))

    async def handle(self, request: web.Request) -> web.StreamResponse:
        content = await request.read()
        self.asked.append((request.method, request.path_qs, json.loads(content) if content else None))
        self.headers.append(request.headers)
        answer = self.answers.popleft() if len(self.answers) > 1 else self.answers[0]
        if answer is CUT:
            assert request.transport is not None
            request.transport.abort()
            return web.Response()
        status, body, headers = answer
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        return web.Response(status=status, body=content, headers=named)

    async def wait(self, seconds: float) -> None:
        self.waits.append(seconds)


@pytest.fixture
def script() -> Script:
    return Script()


@pytest.fixture
async def server(script: Script) -> AsyncIterator[TestServer]:
    application = web.Application()
    application.router.add_route("*", "/{path:.*}", script.handle)
    async with TestServer(application) as server:
        yield server


@pytest.fixture
async def api(script: Script, server: TestServer) -> AsyncIterator[Api]:
    configuration = Configuration(host=str(server.make_url("")).rstrip("/"))
    configuration.api_key["BearerToken"] = f"Bearer {TOKEN}"
    api = Api(
        ApiClient(configuration),
        sleep=script.wait,
        jitter=lambda: 1.0,
        count=lambda *call: script.counted.append(call),
    )
    yield api
    await api.close()


async def test_get_sends_the_token_and_returns_plain_json(api: Api, script: Script) -> None:
    script.say(200, BODY)
    assert await api.get(RUN) == BODY
    assert script.asked == [("GET", "/apis/slamhive.io/v1alpha1/namespaces/lab/mappingruns/demo", None)]
    assert script.headers[0]["Authorization"] == f"Bearer {TOKEN}"
    assert script.counted == [("get", "mappingruns.slamhive.io", "200")]


@pytest.mark.parametrize(("status", "uid"), [(200, "u-1"), (403, None), (404, None)])
async def test_a_cluster_is_told_by_its_own_namespace_where_that_may_be_seen(
    api: Api, script: Script, status: int, uid: str | None
) -> None:
    script.say(status, {"metadata": {"name": "kube-system", "uid": "u-1"}})
    assert await api.cluster_uid() == uid
    assert script.asked == [("GET", "/api/v1/namespaces/kube-system", None)]


CALLS: dict[str, Callable[[Api], Any]] = {
    "get": lambda api: api.get(RUN),
    "list": lambda api: api.list(Kind.MAPPING_RUN, "lab"),
    "create": lambda api: api.create(Kind.MAPPING_RUN, BODY),
    "patch": lambda api: api.patch(RUN, {"status": {}}, subresource="status"),
    "delete": lambda api: api.delete(RUN),
    "logs": lambda api: api.logs("lab", "pod", "algorithm"),
}
GOOD = {"metadata": {"resourceVersion": "5"}, "items": []}


@pytest.mark.parametrize("call", CALLS)
async def test_faults_that_pass_are_tried_again(api: Api, script: Script, call: str) -> None:
    script.say(429)
    script.say(503)
    script.say(200, GOOD)
    await CALLS[call](api)
    assert len(script.asked) == 3
    assert script.waits == [0.2, 0.4]


@pytest.mark.parametrize("call", CALLS)
async def test_broken_connections_are_tried_again(api: Api, script: Script, call: str) -> None:
    script.answers.extend([CUT, CUT])
    script.say(200, GOOD)
    await CALLS[call](api)
    assert len(script.asked) == 3  # for some methods the HTTP library repeats by itself


@pytest.mark.parametrize("call", ["get", "create"])
@pytest.mark.parametrize(
    ("fault", "error"), [(500, errors.ServerFault), (429, errors.TooManyRequests), (CUT, errors.ServerFault)]
)
async def test_faults_that_stay_are_raised(
    api: Api, script: Script, call: str, fault: Any, error: type[errors.ApiError]
) -> None:
    script.answers.append(fault) if fault is CUT else script.say(fault, {"message": "overloaded"})
    with pytest.raises(error) as caught:
        await CALLS[call](api)
    assert len(script.counted) == ATTEMPTS
    assert caught.value.retryable


@pytest.mark.parametrize("status", [400, 403, 409, 422])
async def test_refusals_are_not_tried_again(api: Api, script: Script, status: int) -> None:
    script.say(status, {"reason": "AlreadyExists"})
    with pytest.raises(errors.ApiError):
        await api.create(Kind.MAPPING_RUN, BODY)
    assert len(script.asked) == 1


async def test_the_server_says_how_long_to_wait(api: Api, script: Script) -> None:
    script.say(429, Retry_After="3")
    script.say(200, BODY)
    await api.get(RUN)
    assert script.waits == [3.0]


async def test_a_wait_too_long_is_left_to_the_queue(api: Api, script: Script) -> None:
    script.say(429, Retry_After="600")
    with pytest.raises(errors.TooManyRequests) as caught:
        await api.get(RUN)
    assert caught.value.retry_after == 600
    assert script.waits == []


async def test_a_list_comes_in_pages(api: Api, script: Script) -> None:
    script.say(200, {"metadata": {"resourceVersion": "7", "continue": "more"}, "items": [{"n": 1}]})
    script.say(200, {"metadata": {"resourceVersion": "7"}, "items": [{"n": 2}]})
    items, version = await api.list(Kind.JOB, "lab", labels="a=b", narrow=lambda obj: {"m": obj["n"]})
    assert (items, version) == ([{"m": 1}, {"m": 2}], "7")
    queries = [path.partition("?")[2] for _, path, _ in script.asked]
    assert queries == ["labelSelector=a%3Db&limit=100", "labelSelector=a%3Db&limit=100&continue=more"]


async def test_a_list_that_expires_begins_anew(api: Api, script: Script) -> None:
    page = {"metadata": {"resourceVersion": "7", "continue": "more"}, "items": [{"n": 1}]}
    script.say(200, page)
    script.say(410, {"reason": "Expired"})
    script.say(200, page)
    script.say(410, {"reason": "Expired"})
    script.say(200, {"metadata": {"resourceVersion": "9"}, "items": [{"n": 1}, {"n": 2}]})
    assert await api.list(Kind.JOB, "lab") == ([{"n": 1}, {"n": 2}], "9")
    assert "limit" not in script.asked[-1][1]


async def test_a_create_whose_answer_was_lost_finds_its_object(api: Api, script: Script) -> None:
    script.answers.append(CUT)
    script.say(409, {"reason": "AlreadyExists", "message": 'mappingruns "demo" already exists'})
    with pytest.raises(errors.AlreadyExists, match="already exists"):
        await api.create(Kind.MAPPING_RUN, BODY)
    assert script.asked[0][2] == {"apiVersion": "slamhive.io/v1alpha1", "kind": "MappingRun", **BODY}


async def test_a_quota_being_counted_is_tried_again(api: Api, script: Script) -> None:
    script.say(409, {"reason": "Conflict", "message": "cannot be fulfilled on resourcequotas"})
    script.say(201, BODY)
    assert await api.create(Kind.MAPPING_RUN, BODY) == BODY


async def test_a_patch_is_a_merge_patch_and_a_conflict_is_told(api: Api, script: Script) -> None:
    script.say(409, {"reason": "Conflict", "message": "modified"})
    change = {"metadata": {"resourceVersion": "3"}, "status": {"phase": "Running"}}
    with pytest.raises(errors.Conflict):
        await api.patch(RUN, change, subresource="status")
    assert script.asked == [
        ("PATCH", "/apis/slamhive.io/v1alpha1/namespaces/lab/mappingruns/demo/status", change)
    ]
    assert script.headers[0]["Content-Type"] == "application/merge-patch+json"


@pytest.mark.parametrize(
    ("status", "answer", "left"),
    [
        (200, {"kind": "Status", "status": "Success", "details": {"uid": "u"}, "metadata": {}}, False),
        (404, {"reason": "NotFound"}, False),
        (200, {"metadata": {"name": "demo", "uid": "u", "deletionTimestamp": "2026-01-01T00:00:00Z"}}, True),
    ],
)
async def test_delete_returns_what_has_still_to_end(
    api: Api, script: Script, status: int, answer: Any, left: bool
) -> None:
    script.say(status, answer)
    result = await api.delete(RUN, uid="u", resource_version="4")
    assert (result is not None) is left
    body = script.asked[0][2]
    assert body["preconditions"] == {"uid": "u", "resourceVersion": "4"}
    assert body["propagationPolicy"] == "Background"


async def test_logs_are_text_even_if_they_are_not(api: Api, script: Script) -> None:
    script.say(200, b"line \xff\n")
    assert await api.logs("lab", "p", "algorithm", tail_lines=5, limit_bytes=100) == "line \ufffd\n"
    assert script.asked[0][1].endswith("/pods/p/log?container=algorithm&tailLines=5&limitBytes=100")


async def test_an_answer_that_is_no_object_is_a_fault(api: Api, script: Script) -> None:
    script.say(200, b"<html>proxy</html>")
    with pytest.raises(errors.ServerFault, match="not a JSON object"):
        await api.get(RUN)


async def test_the_metrics_api_is_asked_once_a_call(api: Api, script: Script) -> None:
    script.say(503)
    with pytest.raises(errors.ServerFault):
        await api.pod_metrics("lab", "slamhive.io/role=run")
    assert len(script.asked) == 1


async def test_faults_can_be_put_before_and_after_each_call(api: Api, script: Script) -> None:
    class Killed(BaseException):
        pass

    moments: list[tuple[str, str, str]] = []

    def kill(*moment: str) -> None:
        moments.append(moment)  # type: ignore[arg-type]
        if moment[0] == "after":
            raise Killed

    api.fault = kill
    script.say(201, BODY)
    with pytest.raises(Killed):
        await api.create(Kind.JOB, BODY)
    assert moments == [("before", "create", "jobs.batch"), ("after", "create", "jobs.batch")]
    assert len(script.asked) == 1


async def test_an_answer_lost_by_the_fault_hook_is_tried_again(api: Api, script: Script) -> None:
    lost = iter([True])

    def lose(moment: str, verb: str, resource: str) -> None:
        if moment == "after" and next(lost, False):
            raise ConnectionResetError

    api.fault = lose
    script.say(201, BODY)
    script.say(409, {"reason": "AlreadyExists"})
    with pytest.raises(errors.AlreadyExists):
        await api.create(Kind.JOB, BODY)
    assert script.counted[-2:] == [("create", "jobs.batch", "201"), ("create", "jobs.batch", "409")]


async def test_an_event_is_written_once_and_counted_then(api: Api, script: Script) -> None:
    script.say(201, {})
    assert await api.event(Kind.SWEEP, BODY, "Warning", "Full", "the volume is full")
    script.answers.clear()
    script.say(409, {"reason": "AlreadyExists"})
    script.say(200, {"count": 4})
    script.say(200, {})
    assert await api.event(Kind.SWEEP, BODY, "Warning", "Full", "the volume is full")
    first, again, _, counted = script.asked
    assert first[2]["metadata"] == again[2]["metadata"]
    assert first[2]["involvedObject"]["kind"] == "Sweep"
    assert counted[2]["count"] == 5


async def test_an_event_that_cannot_be_written_breaks_nothing(api: Api, script: Script) -> None:
    script.say(403)
    assert not await api.event(Kind.SWEEP, BODY, "Normal", "Done", "all runs finished")


async def test_a_missing_group_serves_nothing(api: Api, script: Script) -> None:
    script.say(404)
    assert await api.served("slamhive.io", "v1alpha1") == frozenset()


async def test_without_a_cluster_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(errors.StartError, match=r"no cluster is known: .* set KUBECONFIG"):
        await Api.connect(tmp_path / "none")


@pytest.mark.parametrize(
    "proxies", [{}, {"no_proxy": "*"}, {"https_proxy": "http://127.0.0.1:1", "no_proxy": "*"}]
)
async def test_a_kubeconfig_alone_says_who_calls(
    script: Script,
    server: TestServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    proxies: dict[str, str],
) -> None:
    """Unless there is a proxy, whose way of reading the environment comes along with it."""
    for name in ("http_proxy", "https_proxy", "all_proxy", "no_proxy"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.upper(), raising=False)
    for name, value in proxies.items():
        monkeypatch.setenv(name, value)
    (tmp_path / "netrc").write_text("default login somebody password else\n")
    (tmp_path / "netrc").chmod(0o600)
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    named = {"name": "here", "context": {"cluster": "here", "user": "me"}}
    config = {
        "current-context": "here",
        "clusters": [{"name": "here", "cluster": {"server": str(server.make_url("")).rstrip("/")}}],
        "users": [{"name": "me", "user": {}}],
        "contexts": [named],
    }
    (tmp_path / "config").write_text(json.dumps(config))
    script.say(200, BODY)
    api = await Api.connect(tmp_path / "config")
    assert await api.get(RUN) == BODY
    await api.close()
    assert ("Authorization" in script.headers[0]) is ("https_proxy" in proxies)


async def test_kopf_gets_the_same_access_and_no_token_is_shown(api: Api) -> None:
    access = await api.access()
    assert access.token == TOKEN
    assert TOKEN not in repr(access)
