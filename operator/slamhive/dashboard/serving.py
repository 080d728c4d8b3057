# SPDX-License-Identifier: Apache-2.0
"""Serving the application: the sockets and what uvicorn is told."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

import uvicorn

from slamhive.dashboard.app import create_app
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from slamhive.dashboard.sources import Source

CONNECTIONS = 512
_LOCAL = frozenset({"localhost", "127.0.0.1", "[::1]", "::1"})


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens.

    Raises:
        InputError: the address is taken or not ours.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    taken = socket.socket(family, socket.SOCK_STREAM)
    try:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind((host, port))
        taken.listen(CONNECTIONS)
    except (OSError, OverflowError) as error:
        taken.close()
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"--port: cannot listen on {host} port {port}: {reason}") from None
    return taken


def allowed_hosts(host: str) -> Collection[str] | None:
    """Return the names that a dashboard may be called by: on a loop-back address only its own."""
    return _LOCAL | {host.lower()} if host in _LOCAL or host.startswith("127.") else None


def serve(
    source: Source,
    listening: socket.socket,
    *,
    hosts: Collection[str] | None,
    announce: Callable[[], None] | None = None,
) -> None:
    """Answer requests until a signal comes.

    Args:
        source: where the data come from.
        listening: the socket.
        hosts: names that it may be called by; None for any.
        announce: called when it answers.
    """
    config = uvicorn.Config(
        create_app(source, hosts=hosts),
        log_level="warning",
        access_log=False,
        limit_concurrency=CONNECTIONS,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=2,
        server_header=False,
        date_header=True,
        lifespan="on",
        ws="none",
        proxy_headers=False,
    )
    if announce is not None:
        announce()
    uvicorn.Server(config).run(sockets=[listening])
