# SPDX-License-Identifier: Apache-2.0
"""HTTP probes for the kubelet: ``/healthz`` (the main loop works), ``/readyz`` (first lists complete)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiohttp import web

if TYPE_CHECKING:
    from slamhive.kube.operator import Operator


def problem(op: Operator) -> str:
    """Return the reason to start the operator again; empty when it is well."""
    if ended := op.failed_tasks:
        return f"ended: {', '.join(ended)}"
    # One object that takes long is its own trouble; when all workers wait, nothing goes on any more.
    stuck = op.loop.stuck
    if op.ready and len(stuck) >= op.cluster.settings.workers:
        return f"all workers are stuck, the first with {stuck[0]}"
    return ""


class HealthServer:
    """Answers the kubelet on the event loop, so that a loop that hangs answers nothing.

    Args:
        op: the operator.
        port: port to listen on; 0 takes a free one.

    Attributes:
        port: the port listened on.
    """

    def __init__(self, op: Operator, port: int) -> None:
        self._op = op
        self.port = port
        self._runner: web.AppRunner | None = None

    async def start(self) -> None:
        """Begin to listen."""
        application = web.Application()
        application.router.add_get("/healthz", self._health)
        application.router.add_get("/readyz", self._readiness)
        self._runner = web.AppRunner(application, access_log=None)
        await self._runner.setup()
        await web.TCPSite(self._runner, "0.0.0.0", self.port).start()  # noqa: S104 - the kubelet is outside
        self.port = self._runner.addresses[0][1]

    async def stop(self) -> None:
        """Listen no more."""
        if self._runner is not None:
            await self._runner.cleanup()
            self._runner = None

    async def _health(self, _: web.Request) -> web.Response:
        found = problem(self._op)
        return web.Response(text=f"{found or 'ok'}\n", status=503 if found else 200)

    async def _readiness(self, _: web.Request) -> web.Response:
        ready = self._op.ready
        text = "ok\n" if ready else "the first listing of all objects is not done\n"
        return web.Response(text=text, status=200 if ready else 503)
