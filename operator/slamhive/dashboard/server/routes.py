# SPDX-License-Identifier: Apache-2.0
"""The addresses under /api/v1 and what they take; ``Service`` answers, the modules of ``answers`` compute."""

# FastAPI reads the annotations of these functions, so they are no mere texts here.
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response

from slamhive.analysis.boards import COMPETITORS
from slamhive.dashboard.answering.encoding import Format, choose_format
from slamhive.dashboard.answers import analysis, many_runs
from slamhive.dashboard.server.costs import MOST_COMPETITORS, MOST_PAGED, costs_little
from slamhive.dashboard.server.service import service_of

Where = Annotated[
    str | None,
    Query(
        max_length=10_000,
        description="Condition, as in: run in (126, 141) or scale < 1",
        examples=["coverage >= 0.9"],
    ),
]
Superseded = Annotated[
    str | None,
    Query(max_length=100, description="1 for results of earlier versions too, which are left out otherwise."),
]
Names = Annotated[str | None, Query(max_length=10_000, description="Columns, separated by commas.")]
FormatName = Annotated[str | None, Query(max_length=100, description="json, csv or parquet.")]
Which = Annotated[str, Query(max_length=100, description="Runs that count: tracked or all.")]
ColumnName = Annotated[str | None, Query(max_length=10_000, description="A column.")]


def pairs(request: Request) -> list[tuple[str, str]]:
    """Return the names and values of the query string."""
    return request.query_params.multi_items()


async def takes_format(format: FormatName = None) -> None:  # noqa: A002
    """Declare the parameter by which all lists come as JSON, CSV or Parquet; `Service` reads it."""


FORMATS = [Depends(takes_format)]


async def filters_of(
    request: Request,
    *,
    where: Where = None,  # noqa: ARG001 - declared for the API's description, read with all other filters
    superseded: Superseded = None,  # noqa: ARG001
    format: FormatName = None,  # noqa: A002, ARG001
) -> list[tuple[str, str]]:
    """Return the query string of a table or analysis; all of them take these parameters beside columns."""
    return pairs(request)


Filters = Annotated[list[tuple[str, str]], Depends(filters_of)]

routes = APIRouter(prefix="/api/v1")


@routes.get("/runs", summary="Runs, one item a run and evaluation, page by page")
async def runs(
    request: Request,
    *,
    where: Where = None,  # noqa: ARG001 - read with all other filters
    superseded: Superseded = None,  # noqa: ARG001
    sort: Names = None,
    columns: Names = None,
    limit: Annotated[int | None, Query(ge=1, le=many_runs.MAX_LIMIT)] = None,
    after: Annotated[str | None, Query(max_length=10_000, description="Token of a page.")] = None,
    format: FormatName = None,  # noqa: A002
) -> Response:
    """Any other parameter is a column with a value it must have, as in `algorithm=orb-slam3`.

    Several values of one column are alternatives. Orders are written `coverage>=0.9`. CSV and Parquet
    without a limit hold all rows.
    """
    service = service_of(request)
    form = choose_format(format, request.headers.get("accept", ""))
    filters = pairs(request)
    if form is not Format.JSON and limit is None and after is None:
        return await service.stream(
            request, lambda data: many_runs.whole_table(data, filters, sort=sort, wanted=columns)
        )
    return await service.answer(
        request,
        lambda data: many_runs.runs_page(
            data,
            filters,
            path=request.url.path,
            sort=sort,
            wanted=columns,
            limit=limit or many_runs.DEFAULT_LIMIT,
            after=after,
        ),
        lambda data: costs_little(data, request.url.query, most_rows=MOST_PAGED),
    )


@routes.get("/columns", summary="Columns that there are, with their ranges and values")
async def columns_(request: Request, filters: Filters, *, columns: Names = None) -> Response:
    """Describe columns over the rows that the filters mean."""
    return await service_of(request).answer(
        request, lambda data: many_runs.columns_list(data, filters, columns)
    )


@routes.get("/analysis/points", summary="One point a run for a chart, as columns")
async def points(
    request: Request,
    filters: Filters,
    *,
    x: Annotated[str, Query(max_length=10_000, description="A column.")],
    y: Annotated[str, Query(max_length=10_000, description="A column.")],
    colour: ColumnName = None,
    size: ColumnName = None,
    facet: ColumnName = None,
    digits: Annotated[int | None, Query(ge=2, le=17, description="Significant digits.")] = None,
) -> Response:
    """Runs without a value stay in: they are drawn as failed."""
    axes = {"x": x, "y": y, "colour": colour, "size": size, "facet": facet}
    return await service_of(request).answer(
        request,
        lambda data: analysis.points(data, filters, axes, digits),
        lambda data: costs_little(data, request.url.query),
    )


@routes.get("/analysis/aggregate", summary="Figures over groups of runs")
async def aggregate(
    request: Request,
    filters: Filters,
    *,
    by: Names = None,
    metrics: Names = None,
    outcomes: Which = "tracked",
) -> Response:
    """Return figures over groups of runs; columns that must not be pooled become keys where they vary."""
    return await service_of(request).answer(
        request,
        lambda data: analysis.aggregated(data, filters, by, metrics, outcomes),
        lambda data: by is not None and costs_little(data, request.url.query, by),
    )


@routes.get("/analysis/leaderboard", summary="Ranks over datasets, with their uncertainty")
async def leaderboard(
    request: Request,
    filters: Filters,
    *,
    metric: Annotated[str, Query(max_length=10_000)] = "ate.rmse",
    by: Names = None,
    outcomes: Which = "tracked",
) -> Response:
    """One board for each combination of evaluation, alignment and pace."""
    return await service_of(request).answer(
        request,
        lambda data: analysis.ranked(data, filters, metric, by, outcomes),
        lambda data: costs_little(data, request.url.query, by, COMPETITORS, MOST_COMPETITORS),
    )
