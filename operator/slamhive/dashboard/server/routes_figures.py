# SPDX-License-Identifier: Apache-2.0
"""Addresses of what single pictures need: cumulative shares, runs by what is remembered of them."""

# FastAPI reads the annotations of these functions, so they are no mere texts here.
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from slamhive.analysis.boards import Window
from slamhive.dashboard.answers import distributions
from slamhive.dashboard.answers import images as images_answer
from slamhive.dashboard.answers import paths as paths_answer
from slamhive.dashboard.answers import search as search_answer
from slamhive.dashboard.answers import timeline as timeline_answer
from slamhive.dashboard.server.costs import costs_little
from slamhive.dashboard.server.routes import Filters, Names, Which
from slamhive.dashboard.server.routes_studies import ERROR, First, Metric
from slamhive.dashboard.server.service import service_of
from slamhive.dashboard.sources.archived import Snapshot

Moment = Annotated[float | None, Query(ge=0, le=1e11, allow_inf_nan=False)]

routes = APIRouter(prefix="/api/v1")


@routes.get("/analysis/ecdf", summary="Share of the runs whose figure is at most so much")
async def ecdf(
    request: Request,
    filters: Filters,
    *,
    metric: Metric = ERROR,
    by: Names = None,
    over: Names = None,
    outcomes: Which = "tracked",
    most: Annotated[
        int | None,
        Query(
            ge=1,
            le=distributions.MOST_CURVES,
            description="Competitors that are shown; default: all, the 12 best of more than 200 curves.",
        ),
    ] = None,
    first: First = 1,
) -> Response:
    """Runs that failed of themselves are among those that the share is of, and never reach a value."""
    window = Window(most, first)
    return await service_of(request).answer(
        request,
        lambda data: distributions.ecdf(data, filters, metric, (by, over), outcomes, window=window),
        lambda data: costs_little(data, request.url.query, by, ("algorithm",)),
    )


@routes.get("/analysis/surface", summary="A figure over two settings")
async def surface(
    request: Request,
    filters: Filters,
    *,
    x: Annotated[str, Query(max_length=10_000, description="A column.")],
    y: Annotated[str, Query(max_length=10_000, description="Another column.")],
    metric: Metric = ERROR,
    outcomes: Which = "tracked",
) -> Response:
    """Medians, failed runs last; of more than 24 values of a setting, neighbours are taken together."""
    return await service_of(request).answer(
        request, lambda data: distributions.surface(data, filters, (x, y), metric, outcomes)
    )


@routes.get("/analysis/slices", summary="A figure over each setting that varies")
async def slices(
    request: Request, filters: Filters, *, metric: Metric = ERROR, outcomes: Which = "tracked"
) -> Response:
    """Quartiles for each value, whatever the other settings are, failed runs last."""
    return await service_of(request).answer(
        request, lambda data: distributions.slices(data, filters, metric, outcomes)
    )


@routes.get("/analysis/paths", summary="Paths of several runs over their ground truth")
async def paths(
    request: Request,
    filters: Filters,
    *,
    of: Annotated[
        str | None, Query(max_length=1000, description="A run whose repetitions are meant.")
    ] = None,
    points: Annotated[int, Query(ge=3, le=1000, description="Poses of each path at most.")] = 400,
) -> Response:
    """Runs without a path stay in the list, with the reason."""
    return await service_of(request).answer_of_files(
        request,
        lambda data: paths_answer.meant(data, filters, of),
        lambda data, given: paths_answer.paths(data, given, points),
    )


@routes.get("/analysis/timeline", summary="Which node and core did what, and when")
async def timeline(
    request: Request,
    filters: Filters,
    *,
    low: Annotated[Moment, Query(alias="from", description="Begin, in s since 1970.")] = None,
    high: Annotated[Moment, Query(alias="to", description="End, in s since 1970.")] = None,
) -> Response:
    """Up to 1,500 runs one by one; of more, shares of time, ends and failures in 240 parts of it."""
    return await service_of(request).answer(
        request,
        lambda data: timeline_answer.timeline(data, filters, (low, high)),
        lambda data: costs_little(data, request.url.query),
    )


@routes.get("/runs/{uid}/images", summary="What a run's cameras saw at a moment")
async def images(
    request: Request,
    uid: str,
    t: Annotated[float, Query(ge=0, le=1e11, allow_inf_nan=False, description="Sensor time, s.")],
) -> Response:
    """JPEG in base64, from the recording as the run was given it; on a workstation alone."""
    service = service_of(request)

    async def given(_: Snapshot) -> images_answer.GivenRecording:
        return await service.run(lambda: images_answer.prepared(service.source, uid))

    return await service.answer_with(
        request, given, lambda data, recording: images_answer.images(data, recording, t)
    )


@routes.get("/search", summary="Runs by words: of their names, their settings, their numbers")
async def search(
    request: Request,
    filters: Filters,
    *,
    words: Annotated[str, Query(max_length=300, description="Words that must all fit a run.")] = "",
    limit: Annotated[int, Query(ge=1, le=search_answer.MOST_FOUND)] = 20,
) -> Response:
    """`nFeatures=1000` fits that setting alone; the latest run is the first."""
    return await service_of(request).answer(
        request,
        lambda data: search_answer.search(data, filters, words, limit),
        lambda data: costs_little(data, request.url.query),
    )
