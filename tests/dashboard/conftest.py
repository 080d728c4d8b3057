# SPDX-License-Identifier: Apache-2.0
"""Archives with a few runs of every sort, and a client that asks the application without a network."""

from __future__ import annotations

import math
import shutil
import sys
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from slamhive.archive import Archive, CatalogEntry, SweepRecord
from slamhive.dashboard.server.app import create_app
from slamhive.dashboard.sources.archived import Workstation
from slamhive.model.results import Outcome, Phase, Reason, Result, RunRecord

sys.path.insert(0, str(Path(__file__).parents[1] / "cluster"))

from testcluster.fixtures import *  # noqa: F403

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from slamhive.dashboard.sources.archived import Source

HTML = "<script>alert('x')</script> & \"quotes\""
LONG = "ü" * 10_000


def result(evaluation: str = "se3", outcome: Outcome = Outcome.TRACKED, **values: Any) -> Result:
    given = {"alignment": "se3", "ate": {"rmse": 0.1 + 0.2}, "rpe": [{"rmse": 1 / 3}], "scale": 1.0}
    return Result(evaluation=evaluation, outcome=outcome, coverage=0.95, values=given | values)


def run(number: int, **changes: Any) -> RunRecord:
    """Return a run; ``spec`` and ``parameters`` may be changed by themselves."""
    parameters = changes.pop("parameters", {"nFeatures": 500 * (1 + number % 3), "loop": number % 2 == 0})
    spec = {
        "algorithmRef": {"name": f"algorithm-{number % 2}"},
        "datasetRef": {"name": f"dataset-{number // 2 % 3}"},
        "sensors": "stereo",
        "parameters": parameters,
        "input": {"pace": "Lockstep"},
        "repetition": number // 6,
        "seed": number,
    } | changes.pop("spec", {})
    fields: dict[str, Any] = {
        "uid": f"uid-{number:03d}",
        "name": f"run-{number:03d}",
        "sweep": "study",
        "spec": spec,
        "attributes": {"loops": number % 2},
        "phase": Phase.SUCCEEDED,
        "started": f"2026-01-02T03:04:{number % 60:02d}.25Z",
        "usage": {"cpu": {"meanCores": 1.5, "seconds": 10.0 + number}, "wallSeconds": 20.0},
        "trajectory": {"poses": 10, "durationSeconds": 1.0, "sha256": f"{number:064x}", "path": "x"},
        "results": [result(ate={"rmse": 0.01 * (number + 1)})],
    }
    return RunRecord.model_validate(fields | changes)


def failed(number: int, **changes: Any) -> RunRecord:
    more: dict[str, Any] = {"phase": Phase.FAILED, "reason": Reason.OUT_OF_MEMORY, "results": []}
    more["evaluations"] = [{"evaluation": "se3", "alignment": "se3"}]
    return run(number, **(more | changes))


ASSORTED = (
    *(run(number) for number in range(24)),
    failed(24),
    run(25, results=[result("se3", Outcome.LOST), result("sim3", alignment="sim3")]),
    run(26, results=[]),
    run(27, name="run-html", labels={"note": HTML}, parameters={"text": HTML}),
    run(28, parameters={"nFeatures": "many", "long": LONG, "mixed": 1}),
    run(29, parameters={"nFeatures": None, "mixed": "one"}, message="it ended\nbadly"),
)


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path / 'archive.sqlite'}"


def fill_assorted(folder: Path) -> str:
    """Make an archive with runs of every sort in a folder, and return its URL."""
    url = f"sqlite:///{folder / 'archive.sqlite'}"
    features = {"path": "parameters.nFeatures", "values": [500, 1000]}
    spec = {"matrix": [{"path": "dataset", "values": [1]}, features]}
    with Archive.open(url) as archive:
        archive.put_sweep(SweepRecord(uid="s1", name="study", spec=spec))
        first = CatalogEntry(kind="Algorithm", name="algorithm-0", spec={"description": "the first"})
        archive.put_catalog(first)
        archive.put_runs(ASSORTED)
    return url


@pytest.fixture(scope="session")
def assorted_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("assorted")
    fill_assorted(folder)
    return folder / "archive.sqlite"


@pytest.fixture
def assorted(assorted_file: Path, tmp_path: Path) -> str:
    """An archive with runs of every sort."""
    shutil.copyfile(assorted_file, tmp_path / "archive.sqlite")
    return f"sqlite:///{tmp_path / 'archive.sqlite'}"


class Client:
    """Asks an application."""

    def __init__(self, client: httpx.AsyncClient) -> None:
        self.raw = client

    async def get(self, path: str, status: int = 200, **options: Any) -> Any:
        """Return the JSON of an answer of the expected status."""
        answer = await self.raw.get(f"/api/v1{path}", **options)
        assert answer.status_code == status, answer.text
        return answer.json()


@asynccontextmanager
async def opened(source: Source, **options: Any) -> AsyncIterator[Client]:
    app = create_app(source, **options)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(
            transport=httpx.ASGITransport(app, raise_app_exceptions=False), base_url="http://127.0.0.1"
        ) as client,
    ):
        yield Client(client)


@pytest.fixture
async def api(assorted: str, tmp_path: Path) -> AsyncIterator[Client]:
    async with opened(Workstation(assorted, tmp_path)) as client:
        yield client


@pytest.fixture
def open_app() -> Callable[..., Any]:
    return opened


@pytest.fixture
def make_run() -> Callable[..., RunRecord]:
    return run


@pytest.fixture
def looks_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have each answer look at the archive, all of it, however long the look before took."""
    for name, seconds in (("LOOK_SECONDS", 0.0), ("_REST", 0.0), ("_LONG_SECONDS", math.inf)):
        monkeypatch.setattr(f"slamhive.dashboard.sources.archived.{name}", seconds)
