# SPDX-License-Identifier: Apache-2.0
"""No request costs more than its share, whatever is asked and whatever runs and sweeps hold."""

from __future__ import annotations

import csv
import io
import random
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.analysis.flattening import MAX_COLUMNS, spread
from slamhive.archive import Archive, SweepRecord
from slamhive.dashboard.answering import totals
from slamhive.dashboard.sources.archived import Workstation
from slamhive.dashboard.sources.cluster import MAX_LIVE_COLUMNS, ClusterSource
from slamhive.dashboard.sources.live import narrow_run
from slamhive.runfiles import numberfiles
from slamhive.runfiles.artifacts import ArtifactFolder
from slamhive.runfiles.clocks import configuration_of
from slamhive.runfiles.trajectories import read_poses, usage_columns

if TYPE_CHECKING:
    from collections.abc import Callable


sys.path += [str(Path(__file__).parents[2] / name) for name in ("bench", "fuzz")]

from bench_dashboard import fill
from bench_hostile import fill_home, made_up, traps
from costs import Meter

RUNS = 3000


@pytest.fixture(scope="session")
def hostile_home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home with some thousand runs, one of which left files that are made to cost much."""
    home = tmp_path_factory.mktemp("hostile")
    fill(f"sqlite:///{home / 'archive.sqlite'}", RUNS)
    fill_home(home)
    return home


@pytest.fixture
async def hostile_api(hostile_home: Path, open_app: Callable[..., Any]) -> Any:
    async with open_app(Workstation(f"sqlite:///{hostile_home / 'archive.sqlite'}", hostile_home)) as client:
        yield client


@pytest.mark.slow
@pytest.mark.timeout(600)
async def test_no_request_costs_more_than_its_share(hostile_api: Any) -> None:
    columns = ",".join(item["name"] for item in (await hostile_api.get("/columns"))["items"])
    chance = random.Random(1)
    questions = [one.replace("COLUMNS", columns) for one in traps() if not one.isupper()]
    meter = Meter(hostile_api.raw._transport.app.state.service.workers)
    for question in [*questions, *(made_up(chance) for _ in range(40))]:
        meter.begin()
        answer = await hostile_api.raw.get(f"/api/v1/{question}")
        assert meter.end() == "", question[:200]
        assert answer.status_code in {200, 400, 404, 406, 413, 414, 422, 503}, (
            question[:200],
            answer.text[:300],
        )
        if answer.status_code != 200:
            assert answer.json()["error"]


@pytest.mark.parametrize(
    ("question", "status", "told"),
    [
        ("analysis/aggregate?by=id&metrics=COLUMNS", 413, "groups of"),
        ("runs?format=csv&columns=COLUMNS", 413, "an answer has at most"),
        ("runs?limit=1000&columns=COLUMNS", 413, "an answer has at most"),
        ("analysis/pareto?by=id", 413, "groups are asked for"),
    ],
)
async def test_what_would_cost_too_much_is_not_begun(
    hostile_api: Any, monkeypatch: pytest.MonkeyPatch, question: str, status: int, told: str
) -> None:
    for place in ("analysis.MAX_FIGURES", "many_runs.MAX_CELLS", "many_runs.MAX_PAGE_CELLS"):
        monkeypatch.setattr(f"slamhive.dashboard.answers.{place}", 2000)
    asked = question.replace("COLUMNS", "ate.rmse,scale,coverage")
    answer = await hostile_api.raw.get(f"/api/v1/{asked}")
    assert (answer.status_code, told in answer.json()["error"]) == (status, True), answer.text


async def test_a_whole_table_is_what_its_pages_are(hostile_api: Any) -> None:
    asked = "runs?columns=uid,ate.rmse,algorithm,finished,usage.includesReader&sort=-ate.rmse&seed<2500"
    answer = await hostile_api.raw.get(f"/api/v1/{asked}&format=csv")
    rows = list(csv.reader(io.StringIO(answer.text)))
    pages: list[dict[str, Any]] = []
    link = f"/{asked}&limit=1000"
    while link:
        page = await hostile_api.get(link)
        pages += page["items"]
        link = (page["next"] or "").removeprefix("/api/v1")
    assert len(pages) == len(rows) - 1 == 2500
    assert [row[0] for row in rows[1:]] == [item["uid"] for item in pages]
    assert [float(row[1]) if row[1] else None for row in rows[1:]] == [item["ate.rmse"] for item in pages]
    told = [item["usage.includesReader"] for item in pages]
    assert [row[4] for row in rows[1:]] == ["" if one is None else str(one).lower() for one in told]


@pytest.mark.slow
async def test_a_whole_table_as_parquet_has_one_kind_a_column(hostile_api: Any) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    answer = await hostile_api.raw.get(
        "/api/v1/runs?format=parquet&columns=uid,seed,ate.rmse,reason,finished"
    )
    table = parquet.read_table(io.BytesIO(answer.content))
    assert table.num_rows == RUNS
    assert [str(kind) for kind in table.schema.types] == ["string", "int64", "double", "string", "string"]
    assert sorted(table["seed"].to_pylist()) == list(range(RUNS))


async def test_a_table_that_breaks_off_is_not_taken_for_a_whole_one(
    hostile_api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = hostile_api.raw._transport.app.state.service
    monkeypatch.setattr("slamhive.dashboard.answering.forking._PIPE_BYTES", 4096)
    begun = service.stream

    async def broken(*arguments: Any) -> Any:
        response = await begun(*arguments)
        for worker in list(service.workers._running):
            worker.end()
        return response

    monkeypatch.setattr(service, "stream", broken)
    columns = ",".join(item["name"] for item in (await hostile_api.get("/columns"))["items"])
    with pytest.raises(AssertionError):  # httpx asserts that the application ends what it begins
        await hostile_api.raw.get(f"/api/v1/runs?format=csv&columns={columns}")


def write_run(folder: Path, name: str, content: str) -> ArtifactFolder:
    (folder / "output").mkdir(exist_ok=True)
    (folder / name).write_text(content)
    return ArtifactFolder(folder)


def test_a_path_is_thinned_while_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numberfiles, "MAX_ROWS", 100)
    monkeypatch.setattr(numberfiles, "_BLOCK", 512)
    lines = "".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(1001))
    found = read_poses(write_run(tmp_path, "output/trajectory.txt", lines))
    assert (found.count, found.every) == (1001, 16)
    assert len(found.poses) <= 101
    assert found.poses.stamps[0] == 0
    assert found.poses.stamps[-1] > 1001 - 2 * 16
    assert np.diff(found.poses.stamps).max() <= 16


def test_a_thinned_load_keeps_its_peak(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numberfiles, "MAX_ROWS", 100)
    monkeypatch.setattr(numberfiles, "_BLOCK", 512)
    lines = "".join(f"{k / 10},{k % 2},{10**6 if k == 777 else k},{k}\n" for k in range(2000))
    place = write_run(
        tmp_path, "usage.csv", f"time_seconds,cpu_cores,resident_bytes,anonymous_bytes\n{lines}"
    )
    found = usage_columns(place, 50)
    assert found["samples"] == 2000
    assert found["memory"].max() == 10**6
    assert found["anonymous"].max() == 1999
    np.testing.assert_allclose(found["cpu"], 0.5)


@pytest.mark.parametrize(
    "line",
    [
        "1 2 3 4",
        "1 2 3 4 0 0 0 1",
        "1,2,3,4,0,0,0,1",
        "1 2 3 4 0 0 0 1 9 9",
        "  1\t2  3 4 # so",
        "1 2 3 4 0 0 0 1\nx\n1 2\nnan 1 2 3 0 0 0 1",
    ],
)
def test_lines_are_read_as_ever(tmp_path: Path, line: str) -> None:
    poses = read_poses(write_run(tmp_path, "output/trajectory.txt", f"# t x y z\n{line}\n")).poses
    assert poses.stamps.tolist() == [1.0]
    assert poses.positions.tolist() == [[2.0, 3.0, 4.0]]
    assert poses.quaternions.tolist() == [[0.0, 0.0, 0.0, 1.0]]


async def test_a_file_that_is_too_large_is_refused(
    hostile_api: Any, hostile_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bench_dashboard import make_record

    monkeypatch.setattr(numberfiles, "MAX_FILE", 10 * 2**20)
    for name in ("trajectory", "usage"):
        answer = await hostile_api.raw.get(f"/api/v1/runs/{make_record(0).uid}/{name}")
        assert answer.status_code == 413
        assert "files of at most 10 MiB are drawn" in answer.json()["error"]


LEVELS = [f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 9)]


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(["a0: &a0 [0,0,0,0,0,0,0,0,0,0]", *LEVELS, "mode: lidar"]),
        "mode: lidar\nx: " + "[" * 3000 + "]" * 3000,
        "mode: lidar\nx: [" + "1," * 60_000 + "1]",
        "mode: lidar\nx: &x [*x]",
        "mode: lidar\nx: " + "1" * 5000,
        "mode: lidar\n" + "# " * 200_000,
    ],
    ids=["aliases", "deep", "long", "endless", "digits", "large"],
)
def test_a_configuration_that_explodes_is_not_read(tmp_path: Path, text: str) -> None:
    assert configuration_of(write_run(tmp_path, "config.yaml", text)) == {}


def test_a_configuration_with_aliases_is_read(tmp_path: Path) -> None:
    text = "sensors:\n  a: &pose [[1, 0], [0, 1]]\n  b: *pose\nmode: lidar\n"
    found = configuration_of(write_run(tmp_path, "config.yaml", text))
    assert found == {"sensors": {"a": [[1, 0], [0, 1]], "b": [[1, 0], [0, 1]]}, "mode": "lidar"}


def live(number: int, metrics: dict[str, float]) -> Any:
    return narrow_run(
        {
            "metadata": {
                "name": f"r{number}",
                "namespace": "lab",
                "uid": f"u{number}",
                "resourceVersion": str(number),
                "creationTimestamp": "2026-01-01T00:00:00Z",
            },
            "spec": {"algorithmRef": {"name": "a"}, "datasetRef": {"name": "d"}},
            "status": {
                "phase": "Succeeded",
                "metrics": metrics,
                "usage": {"wallSeconds": 2.0, "cpu": {"meanCores": 1.0}},
            },
        }
    )


def test_live_runs_add_so_many_columns_and_no_more() -> None:
    source = ClusterSource(["lab"])
    runs = [live(k, {"common": 1.0} | {f"own{k}_{j}": 1.0 for j in range(60)}) for k in range(200)]
    frame = source._build(runs, {}, {})
    assert len(frame.stored) < MAX_LIVE_COLUMNS + 100
    assert not frame.column("metrics.common").is_empty
    assert not frame.column("usage.wallSeconds").is_empty
    assert source._dropped is not None
    assert "are left out" in source._dropped
    source._build(runs[:1], {}, {})
    assert source._dropped is None


def test_names_that_most_have_are_kept() -> None:
    found: dict[str, Any] = {}
    spread(found, "", [{f"own{k}": 1, "zz.common": 1} for k in range(2 * MAX_COLUMNS)])
    assert len(found) == MAX_COLUMNS
    assert "zz.common" in found


async def test_a_plan_is_laid_out_once_a_sweep(
    url: str, open_app: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    template = {"spec": {"algorithmRef": {"name": "a"}, "datasetRef": {"name": "d"}}}
    spec = {"template": template, "matrix": [{"path": "parameters.p", "values": [1, 2, 3]}]}
    with Archive.open(url) as archive:
        archive.put_sweep(SweepRecord(uid="s1", name="study", spec=spec))
    laid_out = tmp_path / "laid-out"
    laid_out.write_text("")
    real = totals.most_runs

    def noted(record: SweepRecord) -> int | None:
        with laid_out.open("a") as file:
            file.write(f"{record.uid}\n")
        return real(record)

    monkeypatch.setattr(totals, "most_runs", noted)
    async with open_app(Workstation(url)) as api:
        for path in ("/sweeps", "/sweeps/study", "/sweeps?again=1"):
            found = await api.get(path)
            assert (found["items"][0] if "items" in found else found)["total"] == 3
    assert laid_out.read_text() == "s1\n"


def test_costs_are_judged() -> None:
    meter = Meter(None)
    assert meter.judge(cpu_seconds=1.0, mib=10.0) == ""
    assert "CPU" in meter.judge(cpu_seconds=100.0, mib=10.0)
    assert "MiB" in meter.judge(cpu_seconds=1.0, mib=1000.0)
