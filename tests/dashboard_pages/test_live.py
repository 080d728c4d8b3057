# SPDX-License-Identifier: Apache-2.0
"""A sweep that runs, and a dashboard that goes away and comes back, seen without loading the page again."""

from __future__ import annotations

import asyncio
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import pytest

pytest.importorskip("uvicorn")

import uvicorn
from starlette.responses import JSONResponse

from slamhive.dashboard.server.app import create_app
from slamhive.dashboard.server.serving import listen
from slamhive.dashboard.sources.archived import Snapshot, Workstation

if TYPE_CHECKING:
    import socket
    from collections.abc import Iterator

pytestmark = pytest.mark.browser


class Cluster(Workstation):
    """An archive with a live sweep over it."""

    phases: dict[str, int] = {"Succeeded": 40, "Failed": 8, "Running": 2, "Pending": 10}  # noqa: RUF012
    problems: tuple[str, ...] = ()

    async def fresh(self) -> Snapshot:
        """Return the archive with the sweep as it is now."""
        archived = await super().fresh()
        condition = {
            "type": "Progressing",
            "status": "True",
            "reason": "Running",
            "message": "<b>2 runs</b> are running",
            "lastTransitionTime": "2026-01-01T00:00:00Z",
        }
        best = {"name": "study-0", "index": 0, "ate": 0.0321, "coverage": 1.0, "dataset": "hall"}
        live = {"uid": "study", "live": bool(self.phases.get("Running")), "total": 60, "phases": self.phases}
        sweep = {**live, "conditions": [condition], "best": [best], "spec": {}}
        revision = f"{archived.revision} {self.phases} {self.problems}"
        return replace(archived, sweeps={("", "study"): sweep}, revision=revision, problems=self.problems)


class BusyOnce:
    """A dashboard's application that is too busy for the first question to an address."""

    def __init__(self, app: Any, path: str) -> None:
        self._app = app
        self._path: str | None = path

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        answer = self._app
        if scope.get("path") == self._path:
            self._path = None
            answer = JSONResponse({"error": "too many questions at a time"}, 503)
        await answer(scope, receive, send)


class Served:
    """A dashboard in a thread."""

    def __init__(
        self, source: Workstation, listening: socket.socket, *, busy: str = "", **options: Any
    ) -> None:
        app = create_app(source, **options)
        if busy:
            app.add_middleware(BusyOnce, path=busy)
        config = uvicorn.Config(
            app, log_level="critical", timeout_graceful_shutdown=1, lifespan="on", ws="none"
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=asyncio.run, args=(self._serve(listening),), daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join(50)

    async def _serve(self, listening: socket.socket) -> None:
        await self._server.serve(sockets=[listening])
        # Those of pages that were still being told of changes: uvicorn leaves them open.
        for connection in list(self._server.server_state.connections):
            connection.transport.abort()
        await asyncio.sleep(0)


@pytest.fixture
def cluster(archive_url: str) -> Cluster:
    return Cluster(archive_url, Path(archive_url.removeprefix("sqlite:///")).parent)


@pytest.fixture
def port(cluster: Cluster) -> Iterator[int]:
    listening = listen("127.0.0.1", 0)
    with Served(cluster, listening):
        yield listening.getsockname()[1]


def test_a_live_sweep_goes_on(browser: Any, cluster: Cluster, port: int) -> None:
    browser.open(f"http://127.0.0.1:{port}/")
    browser.wait("document.querySelector('article .live')?.innerText === 'live'")
    assert "smallest ATE (on 1 of 2 datasets): 0.0321 m hall" in browser.text()
    browser.click("article a", "study")
    browser.wait("document.body.innerText.includes('48 of 60 runs finished (80 %)')")
    browser.wait("document.body.innerText.includes('<b>2 runs</b> are running')")
    assert browser.barriers() == []
    cluster.phases = {"Succeeded": 52, "Failed": 8}
    cluster.problems = ("the API server does not answer: timeout",)
    browser.wait("document.body.innerText.includes('60 of 60 runs finished')")
    browser.wait("document.body.innerText.includes('the API server does not answer')")
    browser.wait("!document.querySelector('h1 .live')")
    browser.call("Page.navigate", url="about:blank")


def test_the_page_waits_for_a_dashboard_that_is_away(browser: Any, cluster: Cluster) -> None:
    listening = listen("127.0.0.1", 0)
    port = listening.getsockname()[1]
    with Served(cluster, listening):
        browser.open(f"http://127.0.0.1:{port}/sweeps/study")
        browser.wait("document.body.innerText.includes('48 of 60 runs finished')")
    browser.wait("document.querySelector('.banner')?.innerText.includes('does not answer')")
    assert "48 of 60 runs finished" in browser.text()
    cluster.phases = {"Succeeded": 52, "Failed": 8}
    with Served(cluster, listen("127.0.0.1", port)):
        browser.wait("!document.querySelector('.banner')")
        browser.wait("document.body.innerText.includes('60 of 60 runs finished')")
        browser.call("Page.navigate", url="about:blank")
    browser.complaints[:] = [one for one in browser.complaints if "net::ERR_" not in one]


def test_a_page_that_is_told_nothing_asks(browser: Any, cluster: Cluster) -> None:
    listening = listen("127.0.0.1", 0)
    with Served(cluster, listening, listeners=0):
        browser.open(f"http://127.0.0.1:{listening.getsockname()[1]}/sweeps/study")
        browser.wait("document.body.innerText.includes('This page asks for news every 5 s')")
        cluster.phases = {"Succeeded": 52, "Failed": 8}
        browser.wait("document.body.innerText.includes('60 of 60 runs finished')")
        browser.call("Page.navigate", url="about:blank")
    browser.complaints[:] = [one for one in browser.complaints if "503" not in one]


def test_a_page_asks_again_what_a_busy_dashboard_refused(browser: Any, cluster: Cluster) -> None:
    listening = listen("127.0.0.1", 0)
    with Served(cluster, listening, busy="/api/v1/columns"):
        browser.open(f"http://127.0.0.1:{listening.getsockname()[1]}/leaderboard")
        browser.wait("document.querySelector('select').selectedOptions[0].textContent === 'ATE [m]'")
        browser.call("Page.navigate", url="about:blank")
    browser.complaints[:] = [one for one in browser.complaints if "503" not in one]
