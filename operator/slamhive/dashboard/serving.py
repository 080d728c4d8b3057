# SPDX-License-Identifier: Apache-2.0
"""Server of the application: its sockets, and uvicorn's settings."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

import uvicorn

from slamhive.dashboard.app import create_app
from slamhive.dashboard.connections import connections
from slamhive.dashboard.health import Health
from slamhive.model.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from slamhive.dashboard.sources import Source

CONNECTIONS = 512
CONNECTIONS_PER_ADDRESS = 128
_LOCAL = frozenset({"localhost", "127.0.0.1", "[::1]", "::1"})


def listen(host: str, port: int, field: str = "--port") -> socket.socket:
    """Return a socket that listens.

    Args:
        host: address.
        port: port; 0 for a free one.
        field: what the port was given by.

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
        raise InputError(f"{field}: cannot listen on {host} port {port}: {reason}") from None
    return taken


def lets_others_in(host: str) -> bool:
    """Tell whether other machines reach what listens on an address."""
    return host not in _LOCAL and not host.startswith("127.")


def allowed_hosts(host: str, others: Collection[str] = ()) -> frozenset[str]:
    """Return the names that a workstation's dashboard may be called by, beside addresses in digits.

    Args:
        host: where it listens; where others reach it, the machine's own names lead to it too.
        others: names that were allowed besides.
    """
    own = {socket.gethostname(), socket.getfqdn()} if lets_others_in(host) else set()
    return _LOCAL | {name.lower() for name in (host, *own, *others)}


def serve(
    source: Source,
    listening: socket.socket,
    *,
    hosts: Collection[str] | None,
    health: socket.socket | None = None,
    connections_per_address: int = CONNECTIONS_PER_ADDRESS,
    announce: Callable[[], None] | None = None,
) -> None:
    """Answer requests until a signal comes.

    Args:
        source: where the data come from.
        listening: the socket.
        hosts: names that it may be called by; None for any.
        health: a socket that answers /healthz and /readyz alone; None for none.
        connections_per_address: how many one address may have.
        announce: called when it answers.
    """
    app = create_app(source, hosts=hosts)
    config = uvicorn.Config(
        app,
        http=connections(connections_per_address),
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
    _Server(config, Health(app.state.service.fresh), health).run(sockets=[listening])


class _Server(uvicorn.Server):
    """Answers on two ports in one loop: while that turns, it is alive."""

    def __init__(self, config: uvicorn.Config, health: Health, listening: socket.socket | None) -> None:
        super().__init__(config)
        self._health = health
        self._listening = listening

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self._listening is not None:
            await self._health.start(self._listening)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._health.stop()
        await super().shutdown(sockets)
