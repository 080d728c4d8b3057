# SPDX-License-Identifier: Apache-2.0
"""A real server: connections that say nothing are closed, one address has not all, health is always told."""

from __future__ import annotations

import socket
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING

import httpx
import pytest
import uvicorn

from slamhive.dashboard.server.app import create_app
from slamhive.dashboard.server.connections import Connection, connections
from slamhive.dashboard.server.serving import Health, _Server, listen
from slamhive.dashboard.sources.archived import Workstation

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

SECONDS = 0.3
MOST = 5


class Running:
    """A server in a thread."""

    def __init__(self, home: Path, protocol: type[Connection]) -> None:
        source = Workstation(f"sqlite:///{home / 'archive.sqlite'}", home)
        app = create_app(source, listeners=MOST // 2)
        self.sockets = listen("127.0.0.1", 0), listen("127.0.0.1", 0)
        self.port, self.health_port = (one.getsockname()[1] for one in self.sockets)
        config = uvicorn.Config(
            app,
            http=protocol,
            log_level="critical",
            lifespan="on",
            ws="none",
            timeout_graceful_shutdown=1,
        )
        self.server = _Server(config, Health(app.state.service.fresh), self.sockets[1])
        self.thread = threading.Thread(target=self.server.run, args=([self.sockets[0]],))
        self.thread.start()

    def connect(self, said: bytes = b"", address: str = "127.0.0.1") -> socket.socket:
        found = socket.create_connection(("127.0.0.1", self.port), timeout=20, source_address=(address, 0))
        found.sendall(said)
        return found

    def stop(self) -> None:
        self.server.should_exit = True
        self.thread.join()


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    found = Running(tmp_path, connections(MOST, SECONDS))
    yield found
    found.stop()


WHOLE = b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


@pytest.mark.parametrize(
    "said",
    [
        b"",
        b"GET /api/v1 HTTP/1.1\r\nHost: 127.0.0.1\r\nX-a: ",
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 10\r\n\r\n",
        WHOLE + b"GET /api/v1 HT",
    ],
    ids=["nothing", "half a request", "no body", "one and a half"],
)
def test_what_never_becomes_a_request_is_closed(running: Running, said: bytes) -> None:
    with running.connect(said) as connection:
        received = b""
        try:
            while part := connection.recv(65536):
                received += part
        except ConnectionResetError:
            pass
    assert (b"200 OK" in received) == said.startswith(b"GET /healthz")


def test_one_address_has_not_all_connections(running: Running) -> None:
    kept = [running.connect() for _ in range(MOST)]
    with running.connect(WHOLE) as refused:
        answer = refused.recv(65536)
    assert answer.startswith(b"HTTP/1.1 503")
    assert b"Retry-After: 5" in answer
    assert b"too many connections" in answer
    with running.connect(WHOLE, "127.0.0.2") as other:
        assert other.recv(65536).startswith(b"HTTP/1.1 200")
    for one in kept:
        one.close()


EVENTS = WHOLE.replace(b"/healthz", b"/api/v1/events")


def test_pages_that_listen_leave_connections_to_the_rest(running: Running) -> None:
    with ExitStack() as kept:
        pages = [kept.enter_context(running.connect(EVENTS)) for _ in range(MOST // 2)]
        assert [one.recv(12) for one in pages] == [b"HTTP/1.1 200"] * len(pages)
        for _ in range(MOST):
            with running.connect(EVENTS) as refused, refused.makefile("rb") as file:
                answer = file.read()
            assert answer.startswith(b"HTTP/1.1 503")
            assert b"connection: close" in answer.lower()
            assert b"ask /api/v1 every few seconds" in answer
        with running.connect(EVENTS, "127.0.0.2") as other, running.connect(WHOLE) as visitor:
            assert (other.recv(12), visitor.recv(12)) == (b"HTTP/1.1 200",) * 2


def test_health_has_a_port_of_its_own(running: Running) -> None:
    kept = [running.connect() for _ in range(MOST)]
    root = f"http://127.0.0.1:{running.health_port}"
    answers = {path: httpx.get(f"{root}{path}") for path in ("/healthz", "/readyz", "/api/v1")}
    assert {path: answer.status_code for path, answer in answers.items()} == {
        "/healthz": 200,
        "/readyz": 200,
        "/api/v1": 404,
    }
    assert answers["/readyz"].text == "ok\n"
    for one in kept:
        one.close()


def test_health_says_what_keeps_it_from_being_ready(tmp_path: Path) -> None:
    (tmp_path / "archive.sqlite").write_bytes(b"no database, but long enough to be taken for one" * 30)
    running = Running(tmp_path, connections(MOST))
    try:
        answer = httpx.get(f"http://127.0.0.1:{running.health_port}/readyz")
        assert answer.status_code == 503
        assert "archive" in answer.text
    finally:
        running.stop()
