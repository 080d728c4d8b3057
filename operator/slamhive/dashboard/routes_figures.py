# SPDX-License-Identifier: Apache-2.0
"""Addresses of what single pictures need: cumulative shares."""

# FastAPI reads the annotations of these functions, so they are no mere texts here.
from fastapi import APIRouter, Request, Response

from slamhive.dashboard import api_figures
from slamhive.dashboard.costs import costs_little
from slamhive.dashboard.routes import FormatName, Names, Superseded, Where, Which, pairs
from slamhive.dashboard.routes_studies import ERROR, Metric
from slamhive.dashboard.service import Service


def router(service: Service) -> APIRouter:
    """Return the routes."""
    routes = APIRouter(prefix="/api/v1")

    @routes.get("/analysis/ecdf", summary="Share of the runs whose figure is at most so much")
    async def ecdf(
        request: Request,
        *,
        metric: Metric = ERROR,
        by: Names = None,
        over: Names = None,
        outcomes: Which = "tracked",
        where: Where = None,  # noqa: ARG001 - read with all other filters
        superseded: Superseded = None,  # noqa: ARG001
        format: FormatName = None,  # noqa: A002, ARG001
    ) -> Response:
        """Runs that failed of themselves are among those that the share is of, and never reach a value."""
        asked = pairs(request)
        return await service.answer(
            request,
            lambda data: api_figures.ecdf(data, asked, metric, (by, over), outcomes),
            lambda data: costs_little(data, request.url.query, by, ("algorithm",)),
        )

    return routes
