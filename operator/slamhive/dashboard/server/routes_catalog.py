# SPDX-License-Identifier: Apache-2.0
"""Addresses of what there is: sweeps, evaluations, the catalog, single runs and their files, live events."""

# FastAPI reads the annotations of these functions, so they are no mere texts here.
import os
from collections.abc import Awaitable, Callable, Iterable, Iterator
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import APIRouter, Path, Query, Request, Response
from starlette.responses import StreamingResponse

from slamhive.archive.records import CatalogEntry
from slamhive.dashboard.answers import catalog, one_run, recordings, searches
from slamhive.dashboard.answers import sweeps as sweeps_answer
from slamhive.dashboard.server.costs import costs_little
from slamhive.dashboard.server.routes import FORMATS
from slamhive.dashboard.server.service import Service, client_of, service_of
from slamhive.dashboard.sources.archived import Snapshot
from slamhive.runfiles.artifacts import ArtifactFolder
from slamhive.tables.manifests import run_manifest

Name = Annotated[str, Path(max_length=10_000)]
Most = Annotated[int, Query(ge=10, le=20_000, description="Points at most.")]
_CHUNK = 2**18

routes = APIRouter(prefix="/api/v1")


def _little(data: Snapshot) -> bool:
    return costs_little(data, "")


@routes.get("", summary="What there is, in numbers")
async def index(request: Request) -> Response:
    """Return counts, the source and what does not answer at present."""
    service = service_of(request)
    return await service.answer(request, lambda data: catalog.index(data, service.source), _little)


@routes.get("/sweeps", summary="Sweeps, the live ones first", dependencies=FORMATS)
async def sweeps(request: Request) -> Response:
    """Return each sweep with its progress."""
    service = service_of(request)
    return await service.answer_with(request, service.asked_for, sweeps_answer.sweeps, _little)


@routes.get("/sweeps/{name}", summary="One sweep with its spec")
async def sweep(
    request: Request,
    name: Name,
    namespace: Annotated[
        str | None, Query(max_length=253, description="Where it is; empty for a workstation.")
    ] = None,
) -> Response:
    """Return a sweep; several may have one name in different namespaces."""
    service = service_of(request)
    return await service.answer_with(
        request, service.asked_for, lambda data, stored: sweeps_answer.sweep(data, stored, name, namespace)
    )


@routes.get("/sweeps/{name}/search", summary="What a search tried, and the best so far", dependencies=FORMATS)
async def search(
    request: Request,
    name: Name,
    namespace: Annotated[
        str | None, Query(max_length=253, description="Where it is; empty for a workstation.")
    ] = None,
) -> Response:
    """Return each setting with its figures and why it was dropped, how the best came about, what matters."""
    service = service_of(request)

    async def known(_: Snapshot) -> searches.SearchMaterial:
        return await service.run(lambda: searches.SearchMaterial.of(service.source))

    return await service.answer_with(
        request, known, lambda data, found: searches.search(data, found, name, namespace)
    )


@routes.get("/evaluations", summary="Evaluations that there are results of", dependencies=FORMATS)
async def evaluations(request: Request) -> Response:
    """Return each with its outcomes."""
    return await service_of(request).answer(request, catalog.evaluations, _little)


def _serve(kind: str, has: str) -> None:
    """Serve what the catalog has of a kind, and one of them."""
    many, one = f"{kind.lower()}s", kind.lower()

    def known(service: Service) -> Callable[[Snapshot], Awaitable[list[CatalogEntry]]]:
        async def look_up(_: Snapshot) -> list[CatalogEntry]:
            return await service.run(lambda: service.source.catalog(kind))

        return look_up

    @routes.get(f"/{many}", name=many, summary=f"{kind}s that runs used", dependencies=FORMATS)
    async def entries(request: Request) -> Response:
        """Return each with what became of its runs."""
        service = service_of(request)
        return await service.answer_with(
            request, known(service), lambda data, found: catalog.catalog(data, found, kind), _little
        )

    @routes.get(
        f"/{many}/{{name}}",
        name=one,
        summary=f"One {one}",
        description=f"Return it with its manifest and {has}.",
    )
    async def entry(request: Request, name: Name) -> Response:
        service = service_of(request)
        return await service.answer_with(
            request, known(service), lambda data, found: catalog.catalog_entry(data, found, kind, name)
        )


_serve("Algorithm", "parameters")
_serve("Dataset", "sensors")


@routes.get("/datasets/{name}/overview", summary="What is drawn of a dataset's recording")
async def overview(request: Request, name: Name) -> Response:
    """Images, path, rates and gaps, IMU; on a workstation, once `dataset show --html` made it."""
    service = service_of(request)

    async def found(_: Snapshot) -> dict[str, Any]:
        return await service.run(lambda: recordings.kept(service.source, name))

    return await service.answer_with(request, found, recordings.overview)


@routes.get("/runs/{uid}", summary="All that is known of one run")
async def run(request: Request, uid: Name) -> Response:
    """Return configuration, provenance, usage, results, log and the YAML to run it again."""
    service = service_of(request)
    return await service.answer_with(request, _found(service, uid), one_run.detail)


@routes.get("/runs/{uid}/manifest", summary="The YAML that runs it again")
async def manifest(request: Request, uid: Name) -> Response:
    """Return a MappingRun."""
    service = service_of(request)
    await service.fresh()
    record = await service.run(lambda: one_run.find(service.source, uid))
    headers = {"Content-Disposition": _attachment(f"{record.name}.yaml")}
    return Response(run_manifest(record), media_type="application/yaml", headers=headers)


@routes.get(
    "/runs/{uid}/trajectory", summary="Aligned path over its ground truth, with errors", dependencies=FORMATS
)
async def trajectory(
    request: Request,
    uid: Name,
    *,
    evaluation: Annotated[str | None, Query(max_length=10_000)] = None,
    points: Most = 2000,
) -> Response:
    """The pose with the largest error is always among those shown."""
    service = service_of(request)

    async def material(_: Snapshot) -> one_run.RunMaterial:
        return await service.run(lambda: one_run.material(service.source, uid))

    return await service.answer_with(
        request, material, lambda data, given: one_run.trajectory(data, given, evaluation, points)
    )


@routes.get("/runs/{uid}/usage", summary="CPU and memory over time", dependencies=FORMATS)
async def usage(request: Request, uid: Name, *, points: Most = 2000) -> Response:
    """Of each stretch the mean load and the largest memory."""
    service = service_of(request)
    return await service.answer_with(
        request,
        _found(service, uid, lambda _: one_run.WANTED_OF_USAGE),
        lambda data, found: one_run.usage(data, found, points),
    )


def _found(
    service: Service, uid: str, wanted: Callable[[ArtifactFolder], Iterable[str]] | None = None
) -> Callable[[Snapshot], Awaitable[one_run.FoundRun]]:
    """Return a function that looks a run up, and has files of it at hand."""

    async def find(_: Snapshot) -> one_run.FoundRun:
        return await service.run(lambda: one_run.found(service.source, uid, wanted))

    return find


@routes.get("/runs/{uid}/files", summary="Files of a run", dependencies=FORMATS)
async def files(request: Request, uid: Name) -> Response:
    """At most 1,000 of them."""
    service = service_of(request)
    return await service.answer_with(request, _found(service, uid), one_run.files)


@routes.get("/runs/{uid}/settings-files", summary="Settings files that were rendered for a run")
async def settings_files(request: Request, uid: Name) -> Response:
    """A text of more than 128 KiB is null: it can be downloaded as a file."""
    service = service_of(request)
    return await service.answer_with(
        request, _found(service, uid, one_run.wanted_settings), one_run.settings_files
    )


@routes.get("/runs/{uid}/files/{path:path}", summary="One file of a run")
async def file(request: Request, uid: Name, path: Name) -> Response:
    """Links are not followed."""
    service = service_of(request)
    await service.fresh()
    return await service.run(lambda: _download(service, uid, path))


@routes.get("/events", summary="Changes, as server-sent events", response_class=StreamingResponse)
async def changes(request: Request) -> StreamingResponse:
    """One event `revision` at once, and one whenever something changed."""
    stream = request.app.state.events.stream(client_of(request))
    await anext(stream)  # here a refusal has a status of its own
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(stream, media_type="text/event-stream", headers=headers)


def _download(service: Service, uid: str, path: str) -> Response:
    place = one_run.found(service.source, uid).folder
    with place.open(path) as opened:
        descriptor = os.dup(opened)
    size = os.fstat(descriptor).st_size

    def chunks() -> Iterator[bytes]:
        left = size
        with os.fdopen(descriptor, "rb") as stream:
            while left > 0 and (chunk := stream.read(min(_CHUNK, left))):
                left -= len(chunk)
                yield chunk

    headers = {
        "Content-Disposition": _attachment(path.rpartition("/")[2]),
        "Cache-Control": "no-cache",
        "Content-Length": str(size),
    }
    return StreamingResponse(chunks(), media_type="application/octet-stream", headers=headers)


def _attachment(name: str) -> str:
    return f"attachment; filename*=UTF-8''{quote(name, safe='')}"
