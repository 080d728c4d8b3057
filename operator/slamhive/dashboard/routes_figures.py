# SPDX-License-Identifier: Apache-2.0
"""Addresses of what single pictures need: cumulative shares, runs by what is remembered of them."""

# FastAPI reads the annotations of these functions, so they are no mere texts here.
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from slamhive.dashboard import api_figures, api_search
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

    @routes.get("/search", summary="Runs by words: of their names, their settings, their numbers")
    async def search(
        request: Request,
        *,
        words: Annotated[str, Query(max_length=300, description="Words that must all fit a run.")] = "",
        limit: Annotated[int, Query(ge=1, le=api_search.MOST_FOUND)] = 20,
        where: Where = None,  # noqa: ARG001
        superseded: Superseded = None,  # noqa: ARG001
        format: FormatName = None,  # noqa: A002, ARG001
    ) -> Response:
        """`nFeatures=1000` fits that setting alone; the latest run is the first."""
        asked = pairs(request)
        return await service.answer(
            request,
            lambda data: api_search.search(data, asked, words, limit),
            lambda data: costs_little(data, request.url.query),
        )

    return routes
