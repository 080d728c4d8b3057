# SPDX-License-Identifier: Apache-2.0
"""Nothing is written, nothing foreign runs, nothing is too long."""

from __future__ import annotations

import asyncio
import socket
from itertools import product
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

from slamhive.archive import Archive
from slamhive.cli.main import app
from slamhive.dashboard.server import serving
from slamhive.dashboard.server.app import create_app
from slamhive.dashboard.server.security import Shield
from slamhive.dashboard.server.serving import allowed_hosts
from slamhive.dashboard.sources.archived import Workstation
from slamhive.model.errors import SystemFault

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

METHODS = ("POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "FOO")
PATHS = ("/", "/api/v1", "/api/v1/runs", "/api/v1/runs/x/files/y", "/api/v1/nothing", "/healthz")


async def test_every_other_method_is_405(api: Any) -> None:
    for method, path in product(METHODS, PATHS):
        answer = await api.raw.request(method, path, content=b"{}" if method == "POST" else None)
        assert (answer.status_code, answer.headers["allow"]) == (405, "GET, HEAD"), (method, path)
        assert "GET and HEAD" in answer.json()["error"], (method, path)


def test_no_route_takes_anything_but_get(url: str) -> None:
    document = create_app(Workstation(url)).openapi()
    assert {method for operations in document["paths"].values() for method in operations} == {"get"}


async def test_head_is_get_without_the_body(api: Any) -> None:
    for path in ("/", "/api/v1/runs", "/api/v1/nothing", "/healthz"):
        head, get = await api.raw.head(path), await api.raw.get(path)
        assert (head.status_code, head.content) == (get.status_code, b""), path
        assert head.headers["content-length"] == get.headers["content-length"], path


async def test_every_answer_forbids_what_is_foreign(api: Any) -> None:
    for path in (*PATHS, "/app.js", "/runs/x"):
        headers = (await api.raw.get(path)).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy, path
        assert "frame-ancestors 'none'" in policy, path
        assert "unsafe" not in policy, path
        assert headers["x-content-type-options"] == "nosniff", path
        assert headers["x-frame-options"] == "DENY", path


async def test_embedded_pages_may_be_framed(api: Any) -> None:
    headers = (await api.raw.get("/explore?embed=1")).headers
    assert "frame-ancestors *" in headers["content-security-policy"]
    assert "x-frame-options" not in headers


async def test_bodies_and_long_queries_are_refused(api: Any) -> None:
    assert (await api.raw.request("GET", "/api/v1/runs", content=b"x")).status_code == 413
    assert (await api.raw.get(f"/api/v1/runs?where={'x' * 20_000}")).status_code == 414
    assert (await api.raw.get(f"/api/v1/runs?where={'x' * 10_001}")).status_code == 400
    assert (await api.raw.get(f"/{'x' * 5_000}")).status_code == 414


@pytest.mark.parametrize("listening", ["127.0.0.1", "0.0.0.0"])  # noqa: S104
async def test_only_its_own_names_lead_here(
    assorted: str, open_app: Callable[..., Any], listening: str
) -> None:
    expected = {
        "127.0.0.1:80": 200,
        "localhost": 200,
        "192.0.2.7:8323": 200,
        "[2001:db8::7]:8323": 200,
        "evil.example": 421,
        "192.0.2.7.evil.example": 421,
        "": 421,
    }
    async with open_app(Workstation(assorted), hosts=allowed_hosts(listening)) as client:
        found = {
            host: (await client.raw.get("/api/v1/runs?limit=1", headers={"Host": host})).status_code
            for host in expected
        }
    assert found == expected


def test_a_dashboard_for_others_knows_its_machine_s_names_and_those_allowed() -> None:
    assert socket.gethostname().lower() in allowed_hosts("0.0.0.0")  # noqa: S104
    assert "slam.example" in allowed_hosts("192.0.2.7", ["Slam.example"])
    assert socket.gethostname().lower() not in allowed_hosts("127.0.0.1") - {"localhost"}


@pytest.mark.parametrize(("host", "told"), [("0.0.0.0", True), ("127.0.0.2", False)])  # noqa: S104
def test_who_lets_others_in_is_told_that_there_is_no_login(
    host: str, told: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path))
    monkeypatch.setattr(serving, "serve", lambda _, listening, **__: listening.close())
    result = CliRunner().invoke(app, ["dashboard", "--port", "0", "--host", host])
    assert result.exit_code == 0, result.output
    assert ("the dashboard has no login" in " ".join(result.output.split())) is told


async def test_the_archive_is_opened_for_reading_alone(assorted: str, open_app: Callable[..., Any]) -> None:
    source = Workstation(assorted)
    async with open_app(source) as client:
        await client.get("/runs?limit=1")
        with pytest.raises(SystemFault, match="readonly"):
            source._data.archive().remove_run("uid-001")
    with Archive.open(assorted) as archive:
        assert archive.get("uid-001") is not None


async def test_an_answer_is_remembered_until_the_data_change(api: Any) -> None:
    first = await api.raw.get("/api/v1/runs?limit=1")
    tag = first.headers["etag"]
    again = await api.raw.get("/api/v1/runs?limit=1", headers={"If-None-Match": tag})
    assert (again.status_code, again.content) == (304, b"")
    packed = await api.raw.get("/api/v1/runs", headers={"Accept-Encoding": "gzip"})
    plain = await api.raw.get("/api/v1/runs", headers={"Accept-Encoding": "identity"})
    assert packed.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in plain.headers
    assert packed.json() == plain.json()


async def test_the_description_needs_no_network(api: Any) -> None:
    document = (await api.raw.get("/api/v1/openapi.json")).json()
    assert "/api/v1/analysis/leaderboard" in document["paths"]
    page = (await api.raw.get("/api/v1/docs")).text
    assert "/api/v1/runs/{uid}" in page
    assert "http" not in page.replace("<!doctype html>", "")


async def test_no_answer_tells_the_databases_password(
    open_app: Any, caplog: pytest.LogCaptureFixture
) -> None:
    source = Workstation("postgresql://slam:S3cret-canary@db.example:54 32/slam")
    async with open_app(source) as api:
        answers = [await api.raw.get(path) for path in (*PATHS, "/readyz")]
    assert any("is not a database URL" in answer.text for answer in answers)
    assert "S3cret-canary" not in caplog.text
    for answer in answers:
        assert "S3cret-canary" not in f"{answer.headers}{answer.text}"


async def test_a_question_that_the_end_of_the_server_cuts_off_may_be_asked_again() -> None:
    asked, sent = asyncio.Event(), []

    async def waits(*_: Any) -> None:
        asked.set()
        await asyncio.Event().wait()

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {"type": "http", "method": "GET", "headers": [], "query_string": b"", "raw_path": b"/"}
    request = asyncio.create_task(Shield(waits)(scope, send, send))
    await asked.wait()
    request.cancel()  # as uvicorn does when it waits no longer
    await request
    assert sent[0]["status"] == 503
    assert dict(sent[0]["headers"])[b"retry-after"].isdigit()
    assert b"ask again" in sent[1]["body"]
