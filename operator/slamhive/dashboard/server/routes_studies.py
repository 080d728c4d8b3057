# SPDX-License-Identifier: Apache-2.0
"""Addresses of comparisons, fronts, influences, repetitions, versions and suspicions."""

# FastAPI reads the annotations of these functions, so they are no mere texts here.
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from slamhive.analysis.boards import Window
from slamhive.analysis.comparing import MAX_COMPETITORS
from slamhive.analysis.searches.robustness import RobustnessWish
from slamhive.dashboard.answers import common_support, studies, truth_suspects
from slamhive.dashboard.answers import versions as versions_answer
from slamhive.dashboard.answers.robustness import card_of
from slamhive.dashboard.server.routes import Filters, FormatName, Names, Where, Which, pairs
from slamhive.dashboard.server.service import service_of
from slamhive.tables.queries import split_names

Metric = Annotated[str, Query(max_length=10_000, description="A column of numbers.")]
ERROR = "ate.rmse"
First = Annotated[
    int, Query(ge=1, le=1_000_000, description="Place by mean rank of the first competitor that is shown.")
]

routes = APIRouter(prefix="/api/v1/analysis")


@routes.get("/compare", summary="Competitors two by two, with a paired test over datasets")
async def compare(
    request: Request,
    filters: Filters,
    *,
    metric: Metric = ERROR,
    by: Names = None,
    outcomes: Which = "tracked",
    most: Annotated[
        int | None,
        Query(
            ge=2,
            le=MAX_COMPETITORS,
            description="Competitors that are shown; default: all of up to 40, the 12 best of more.",
        ),
    ] = None,
    first: First = 1,
) -> Response:
    """The p values are exact up to 14 datasets and corrected after Holm for all pairs, shown or not."""
    window = Window(most, first)
    return await service_of(request).answer(
        request, lambda data: studies.compared(data, filters, metric, by, outcomes, window=window)
    )


@routes.get("/pareto", summary="Error against cost: who is beaten by nobody in both")
async def pareto(
    request: Request,
    filters: Filters,
    *,
    x: Metric = "usage.cpu.secondsPerDataSecond",
    y: Metric = ERROR,
    by: Names = None,
    outcomes: Which = "tracked",
) -> Response:
    """One front a dataset, evaluation, pace and processor."""
    return await service_of(request).answer(
        request, lambda data: studies.fronts(data, filters, (x, y), by, outcomes)
    )


@routes.get("/importance", summary="Which settings matter")
async def importance(request: Request, filters: Filters, *, metric: Metric = ERROR) -> Response:
    """Share of the variance of the logarithm that each setting explains; runs of searches left out."""
    return await service_of(request).answer(request, lambda data: studies.influences(data, filters, metric))


@routes.get("/robustness", summary="Up to where on each axis each system still works")
async def robustness(
    request: Request,
    filters: Filters,
    *,
    axes: Names = None,
    failing: Annotated[
        str | None, Query(max_length=10_000, description="Condition on runs that failed.")
    ] = None,
    quantile: Annotated[
        float | None, Query(gt=0, le=1, description="Share of runs that must fail for a value to fail.")
    ] = None,
) -> Response:
    """From searches for thresholds and from grids; axes and rule are those that were sought."""
    service = service_of(request)
    names = tuple(split_names(axes)) if axes else ()
    return await service.answer_with(
        request,
        service.threshold_searches,
        lambda data, searches: card_of(
            data, filters, RobustnessWish(names, failing or None, quantile, searches, "axes")
        ),
    )


@routes.get("/repeatability", summary="Repetitions of each configuration")
async def repeatability(request: Request, filters: Filters, *, metric: Metric = ERROR) -> Response:
    """Equal trajectories count once."""
    return await service_of(request).answer(request, lambda data: studies.repeated(data, filters, metric))


@routes.get("/versions", summary="Before and after: an edited algorithm or dataset, setting by setting")
async def versions(
    request: Request,
    *,
    metric: Metric = ERROR,
    outcomes: Which = "tracked",
    where: Where = None,  # noqa: ARG001
    format: FormatName = None,  # noqa: A002, ARG001
) -> Response:
    """The latest version against each earlier one, with a test; results of earlier versions are meant."""
    filters = pairs(request)
    return await service_of(request).answer(
        request, lambda data: versions_answer.changed(data, filters, metric, outcomes)
    )


@routes.get("/common", summary="Runs of a dataset measured again where all of them have poses")
async def common(
    request: Request, filters: Filters, *, by: Names = None, outcomes: Which = "all"
) -> Response:
    """Errors over the runs' own and over their common support, from their trajectories."""
    return await service_of(request).answer_of_files(
        request, lambda data: common_support.meant(data, filters, by, outcomes), common_support.common
    )


@routes.get("/suspects", summary="Scales that are off by the same factor in all runs")
async def suspects(request: Request, filters: Filters) -> Response:
    """Such a scale is the calibration's, not the algorithm's."""
    return await service_of(request).answer(request, lambda data: studies.suspicions(data, filters))


@routes.get("/suspects/nodes", summary="Nodes that need more CPU time than others of their kind")
async def suspects_of_nodes(request: Request, filters: Filters) -> Response:
    """Ratios of nodes' CPU time for equal runs, with an interval that holds for all of them together."""
    return await service_of(request).answer(request, lambda data: studies.slow_nodes(data, filters))


@routes.get("/suspects/truth", summary="Stretches of ground truth that runs contradict together")
async def suspects_of_truth(request: Request, filters: Filters) -> Response:
    """Stretches in which three algorithms or more agree with each other and not with the truth."""
    return await service_of(request).answer_of_files(
        request, lambda data: truth_suspects.meant(data, filters), truth_suspects.suspicious_truths
    )


@routes.get("/published", summary="Published numbers on the datasets of runs")
async def published(request: Request, filters: Filters) -> Response:
    """Shown beside own runs, never averaged with them; with why own numbers may differ."""
    service = service_of(request)
    home = service.source.home()
    return await service.answer(request, lambda data: studies.published(data, filters, home))
