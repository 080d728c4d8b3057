# SPDX-License-Identifier: Apache-2.0
"""The dashboard as an ASGI application."""

from __future__ import annotations

import logging
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException

from slamhive import __version__
from slamhive.dashboard.answering.encoding import encode_json
from slamhive.dashboard.problems import RETRY_SECONDS, Problem, told
from slamhive.dashboard.server import routes, routes_catalog, routes_figures, routes_studies
from slamhive.dashboard.server.events import MAX_LISTENERS, Events
from slamhive.dashboard.server.pages import Pages, docs_page
from slamhive.dashboard.server.security import Shield
from slamhive.dashboard.server.service import Service
from slamhive.model.base import explain
from slamhive.model.errors import InputError, SystemFault
from slamhive.runfiles.errors import RunFileError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Collection, Mapping

    from slamhive.dashboard.sources.archived import Source


_log = logging.getLogger("slamhive.dashboard")


def create_app(
    source: Source, *, hosts: Collection[str] | None = None, listeners: int = MAX_LISTENERS
) -> FastAPI:
    """Return the application.

    Args:
        source: where the data come from.
        hosts: names that it may be called by; None for any.
        listeners: how many of one address are told of changes.
    """
    return application(Service(source), hosts=hosts, listeners=listeners)


def application(
    service: Service, *, hosts: Collection[str] | None = None, listeners: int = MAX_LISTENERS
) -> FastAPI:
    """Return the application over a service that there is; the rest as for ``create_app``."""
    events = Events(service, listeners)

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        await service.start()
        try:
            yield
        finally:
            await events.stop()
            await service.stop()

    app = FastAPI(
        title="SLAM Hive",
        version=__version__,
        description="Runs, sweeps and analyses, read-only.",
        openapi_url="/api/v1/openapi.json",
        docs_url=None,
        redoc_url=None,
        lifespan=life,
    )
    app.state.service = service
    app.state.events = events
    for part in (routes, routes_studies, routes_figures, routes_catalog):
        app.router.routes.extend(part.routes.routes)  # include_router would read all their annotations again
    _describe(app, service)
    pages = Pages()

    @app.get("/{path:path}", include_in_schema=False)
    async def page(request: Request, path: str) -> Response:  # noqa: ARG001
        return pages.answer(request)

    _answer_problems(app)
    app.add_middleware(Shield, hosts=hosts)
    return app


def _describe(app: FastAPI, service: Service) -> None:
    @app.get("/api/v1/docs", include_in_schema=False)
    async def docs() -> Response:
        return Response(docs_page(app.openapi()), media_type="text/html; charset=utf-8")

    @app.get("/healthz", include_in_schema=False)
    async def healthy() -> Response:
        return Response("ok\n", media_type="text/plain")

    @app.get("/readyz", include_in_schema=False)
    async def ready() -> Response:
        await service.fresh()
        return Response("ok\n", media_type="text/plain")


def _answer_problems(app: FastAPI) -> None:
    async def foreseen(_: Request, error: Exception) -> Response:
        found = told(error)
        if found is None:
            raise error
        status, body = found
        retry = getattr(error, "retry_after", None) or (RETRY_SECONDS if status == 503 else None)
        # Who is to come back later holds none of its address's connections until then.
        return _json(body, status, {"Retry-After": str(retry), "Connection": "close"} if retry else {})

    for kind in (Problem, RunFileError, InputError, SystemFault):
        app.add_exception_handler(kind, foreseen)

    @app.exception_handler(RequestValidationError)
    async def invalid(_: Request, error: RequestValidationError) -> Response:
        first = error.errors()[0]
        field = str(first["loc"][-1])
        return _json({"error": f"{field}: {explain(first)}", "field": field}, 400)

    @app.exception_handler(Exception)
    async def mistake(_: Request, error: Exception) -> Response:
        _log.error("an error in the dashboard itself", exc_info=error)
        sentence = f"an error in the dashboard itself ({type(error).__name__}); its log says more"
        return _json({"error": sentence, "field": None}, 500)

    @app.exception_handler(HTTPException)
    async def other(request: Request, error: HTTPException) -> Response:
        sentence = str(error.detail)
        if error.status_code == 404:
            sentence = f"there is nothing at {request.url.path[:200]}"
        return _json({"error": sentence, "field": None}, error.status_code)


def _json(content: Any, status: int, headers: Mapping[str, str] | None = None) -> Response:
    return Response(
        encode_json(content),
        status_code=status,
        media_type="application/json",
        headers={"Cache-Control": "no-store", **(headers or {})},
    )
