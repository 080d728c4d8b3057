# SPDX-License-Identifier: Apache-2.0
"""One run: what is known of it, its files, its path over the ground truth."""

from __future__ import annotations

import math
import os
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from slamhive.archive import Archive
from slamhive.dashboard.answers.one_run import MOST_SETTINGS
from slamhive.dashboard.sources.archived import Workstation
from slamhive.model.algorithm import DataFormat, Pace
from slamhive.model.configuration import DatasetView, InputView, RecordingPlace, RunConfiguration
from slamhive.model.results import Outcome, Result
from slamhive.model.run import MappingRun
from slamhive.model.sensors import SensorMode
from slamhive.runfiles.artifacts import ArtifactFolder
from slamhive.runfiles.trajectories import usage_columns
from slamhive_eval import Options, evaluate, read_tum

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.model.results import RunRecord


def write_poses(path: Path, offset: float, count: int = 400) -> None:
    lines = []
    for k in range(count):
        t = k / 10
        x, y, z = math.cos(t / 5) * 5, math.sin(t / 5) * 5, offset * math.sin(t)
        lines.append(f"{t} {x} {y} {z} 0 0 0 1\n")
    path.write_text("".join(lines))


@pytest.fixture
def home(tmp_path: Path, url: str, make_run: Callable[..., RunRecord]) -> Path:
    """A home with the files of one run, whose result is the evaluator's."""
    output = tmp_path / "runs" / "study" / "run-000" / "run" / "output"
    output.mkdir(parents=True)
    write_poses(output / "trajectory.txt", 0.1)
    (tmp_path / "groundtruth").mkdir()
    write_poses(tmp_path / "groundtruth" / "dataset-0.txt", 0.0)
    (output / "usage.csv").write_text(
        "time_seconds,cpu_cores,memory_bytes,anonymous_bytes\n"
        + "".join(f"{k / 10},{k % 2},{k * 100},{k * 50}\n" for k in range(100))
    )
    (output / "leak").symlink_to("/etc/passwd")
    (output / "folder").symlink_to("/etc")
    os.mkfifo(output / "pipe")
    found = evaluate(
        read_tum(tmp_path / "groundtruth" / "dataset-0.txt"), read_tum(output / "trajectory.txt"), Options()
    ).as_dict()
    outcome, coverage = found.pop("outcome"), found.pop("coverage")
    result = Result(evaluation="se3", outcome=Outcome(outcome), coverage=coverage, values=found)
    with Archive.open(url) as archive:
        archive.put_run(make_run(0, folder="/elsewhere/runs/study/run-000", results=[result], log_tail="bye"))
        archive.put_run(make_run(1, folder="/etc/ssh"))
        archive.put_run(make_run(2, folder="../../etc"))
        archive.put_run(make_run(3, folder=str(tmp_path / "runs/study/../../..")))
        archive.put_run(make_run(4))
    return tmp_path


@pytest.fixture
async def api(home: Path, url: str, open_app: Callable[..., Any]) -> Any:
    async with open_app(Workstation(url, home)) as client:
        yield client


async def test_a_result_of_an_earlier_version_of_the_evaluation_is_marked(
    home: Path, url: str, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> None:
    values = {"settings": "x", "ate": {"rmse": 1.0}, "notes": ["2 of 9 rows hold NaN"]}
    old = Result(evaluation="se3", outcome=Outcome.TRACKED, coverage=1.0, values=values)
    with Archive.open(url) as archive:
        archive.put_run(make_run(5, results=[old]))
    async with open_app(Workstation(url, home)) as client:
        first, second = (await client.get("/runs/uid-005"))["notes"]
    assert first.startswith(
        "se3: measured by version 1 of the evaluation, 2 is current: slamhive results measure"
    )
    assert second == "se3: 2 of 9 rows hold NaN"


async def test_all_that_is_known(api: Any) -> None:
    run = await api.get("/runs/uid-000")
    assert run["configuration"]["parameters"] == {"nFeatures": 500, "loop": True}
    assert run["results"][0]["outcome"] == "Tracked"
    assert run["logTail"] == "bye"
    assert run["files"] is True
    assert run["notes"] == []
    assert run["cameras"] is True
    manifest = MappingRun.model_validate(yaml.safe_load(run["manifest"]))
    assert manifest.spec.parameters["nFeatures"] == 500
    download = await api.raw.get("/api/v1/runs/uid-000/manifest")
    assert download.text == run["manifest"]
    assert "run-000.yaml" in download.headers["content-disposition"]


async def test_settings_that_tell_a_run_from_others_are_named_and_a_lidar_run_has_no_cameras(
    url: str, home: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> None:
    with Archive.open(url) as archive:
        for number, size in ((90, 0.5), (96, 1.0)):
            settings = {"voxelSize": size, "deskew": True}
            archive.put_run(make_run(number, spec={"sensors": "lidar-inertial"}, parameters=settings))
    async with open_app(Workstation(url, home)) as client:
        run = await client.get("/runs/uid-090")
    assert [one["name"] for one in run["varied"]] == ["parameters.voxelSize"]
    assert run["cameras"] is False


async def test_unknown_runs_are_404(api: Any) -> None:
    for uid in ("nobody", "%00", "../x", "x" * 3000, "'; DROP TABLE runs; --"):
        answer = await api.raw.get(f"/api/v1/runs/{uid}")
        assert answer.status_code == 404, uid
        assert answer.json()["error"]


async def test_errors_are_those_of_the_evaluation(api: Any) -> None:
    drawn = await api.get("/runs/uid-000/trajectory?points=5000")
    result = (await api.get("/runs/uid-000"))["results"][0]
    errors = np.array(drawn["estimate"]["error"], dtype=float)
    assert drawn["poses"] == drawn["shown"] == len(errors) == 400
    assert math.sqrt((errors**2).mean()) == pytest.approx(result["ate"]["rmse"], rel=1e-9)
    assert drawn["notes"] == []
    assert len(drawn["reference"]["x"]) == 400


async def test_a_thinned_path_keeps_the_worst_pose(api: Any) -> None:
    whole = await api.get("/runs/uid-000/trajectory?points=5000")
    drawn = await api.get("/runs/uid-000/trajectory?points=20")
    assert drawn["shown"] <= 20
    assert max(drawn["estimate"]["error"]) == max(whole["estimate"]["error"])


async def test_unknown_evaluations_are_named(api: Any) -> None:
    answer = await api.get("/runs/uid-000/trajectory?evaluation=sm3", 400)
    assert answer["field"] == "evaluation"


async def test_thinned_usage_keeps_the_peak(api: Any) -> None:
    usage = await api.get("/runs/uid-000/usage?points=10")
    assert usage["samples"] == 100
    assert max(usage["memory"]) == 9900
    assert usage["cpu"] == [0.5] * 10
    assert usage["kind"] == "WorkingSet"


async def test_a_chart_of_cpu_says_that_it_holds_the_reader(
    home: Path, url: str, open_app: Callable[..., Any]
) -> None:
    """The curve holds what the figures beside it leave out."""
    notes: list[str] = []
    for changes in ({}, {"reader_cpu_seconds": 4.0, "reader_share": 0.38}):
        with Archive.open(url) as archive:
            record = archive.get("uid-000")
            assert record is not None
            assert record.usage is not None
            archive.put_run(record.replace(usage=record.usage.replace(**changes)))
        async with open_app(Workstation(url, home)) as client:
            labels = (await client.get("/runs/uid-000"))["labelled"]
            assert labels["usage.wallSeconds"] == "wall time [s]"
            usage = await client.get("/runs/uid-000/usage")
        assert usage["readerShare"] == changes.get("reader_share")
        notes += usage["notes"]
    assert "its part isn't known" in notes[0]
    assert "38% of all CPU seconds" in notes[1]


@pytest.mark.parametrize(
    ("header", "kind"),
    [
        (b"time_seconds,cpu_cores,resident_bytes,anonymous_bytes,working_set_bytes", "Resident"),
        (b"time,cpu_usage,memory_usage", "Container"),
        (b"a,b,c", None),
    ],
)
def test_usage_says_what_its_memory_is(tmp_path: Path, header: bytes, kind: str | None) -> None:
    (tmp_path / "usage.csv").write_bytes(header + b"\n0.1,1,300,200,400\n")
    found = usage_columns(ArtifactFolder(tmp_path), 10)
    assert (found["kind"], found["memory"].tolist()) == (kind, [300])


def give(home: Path, configuration: object, latencies: str | None = None) -> None:
    """Give the run of ``home`` a configuration, and what a player noted."""
    run = home / "runs" / "study" / "run-000" / "run"
    (run / "config.yaml").write_text(yaml.safe_dump(configuration))
    if latencies is not None:
        (run / "output" / "latency.csv").write_text(f"stamp,frame_arrival,pose_arrival,latency\n{latencies}")


STARTED = datetime(2026, 1, 2, 3, 4, 0, 250_000, tzinfo=UTC).timestamp()


@pytest.mark.parametrize(
    ("configuration", "clock"),
    [
        (None, {"start": 0.0, "of": "groundTruth"}),
        ({"dataset": {"startTime": 7.0}, "input": {"start": 4.0}}, {"start": 3.0, "of": "recording"}),
        ({"dataset": {"startTime": 7}}, {"start": 7.0, "of": "recording"}),
        ({"dataset": {"startTime": math.nan}}, {"start": 0.0, "of": "groundTruth"}),
        ({"dataset": {"startTime": 10**400}}, {"start": 0.0, "of": "groundTruth"}),
        ({"dataset": "x", "input": ["y"]}, {"start": 0.0, "of": "groundTruth"}),
        (["x"], {"start": 0.0, "of": "groundTruth"}),
    ],
)
async def test_time_begins_with_the_recording_or_else_the_ground_truth(
    home: Path, api: Any, configuration: object, clock: dict[str, Any]
) -> None:
    if configuration is not None:
        give(home, configuration)
    assert (await api.get("/runs/uid-000/trajectory"))["clock"] == clock


async def test_time_begins_with_the_first_pose_where_nothing_else_is_known(home: Path, api: Any) -> None:
    (home / "groundtruth" / "dataset-0.txt").unlink()
    assert (await api.get("/runs/uid-000/trajectory"))["clock"] == {"start": 0.0, "of": "estimate"}


def told(pace: Pace) -> dict[str, Any]:
    """Return the configuration of a run from 3 s on, at twice the speed."""
    return RunConfiguration(
        run="run-000",
        algorithm="node",
        mode=SensorMode.LIDAR,
        dataset=DatasetView(
            name="dataset-0",
            recording=RecordingPlace(format=DataFormat.ROSBAG1, path="dataset/recording.bag"),
            start_time=13.0,
        ),
        sensors={},
        input=InputView(pace=pace, rate=2.0, start=3.0),
        seed=1,
        cores=1,
    ).as_json()


async def test_load_in_real_time_lies_where_the_player_played(home: Path, api: Any) -> None:
    """It played the first frame 3 s after the program began; one frame came late."""
    arrivals = [(10, 3.0), (12, 4.0), (14, 5.9), (16, 6.0), (18, 7.0)]
    rows = "".join(f"{stamp}.0,{STARTED + seconds},0,0\n" for stamp, seconds in arrivals)
    give(home, told(Pace.REALTIME), rows)
    usage = await api.get("/runs/uid-000/usage")
    assert usage["clock"] == {"start": 10.0, "of": "recording"}
    assert usage["t"][30] == 3.0
    assert usage["stamp"][30] == pytest.approx(10.0, abs=1e-5)
    assert usage["stamp"][40] == pytest.approx(12.0, abs=1e-5)
    header = (await api.raw.get("/api/v1/runs/uid-000/usage?format=csv")).text.splitlines()[0]
    assert header == "t,stamp,cpu,memory,anonymous"


async def test_load_in_steps_lies_at_the_frame_that_was_worked_on(home: Path, api: Any) -> None:
    """Frames of 2 s are played in 1 s each; time stood before the second, while the first was worked on."""
    arrivals = [(10, 1.0), (12, 4.0), (14, 5.0)]
    rows = "".join(f"{stamp}.0,{STARTED + seconds},0,0\n" for stamp, seconds in arrivals)
    give(home, told(Pace.STEPPED), rows)
    usage = await api.get("/runs/uid-000/usage")
    at = dict(zip(np.round(usage["t"], 3), usage["stamp"], strict=True))
    stamps = [at[seconds] for seconds in (0.5, 1.5, 2.5, 3.9, 4.5, 6.0)]
    assert stamps == pytest.approx([9.0, 11.0, 12.0, 12.0, 13.0, 16.0], abs=1e-5)


@pytest.mark.parametrize(
    ("pace", "rows"),
    [
        (["Realtime"], f"10.0,{STARTED},0,0\n"),
        ("Stepped", "10.0\n"),
        ("Lockstep", f"10.0,{STARTED},0,0\n"),
        ("Realtime", None),
        ("Realtime", ""),
        ("Realtime", "10.0\n"),
        ("Realtime", f"nan,{STARTED},0,0\n"),
        ("Realtime", "ten,eleven,0,0\n"),
        ("Realtime", "\x00,ü\n"),
    ],
)
async def test_other_load_has_no_place_on_the_datasets_clock(
    home: Path, api: Any, pace: str, rows: str | None
) -> None:
    give(home, {"dataset": {"startTime": 10.0}, "input": {"pace": pace}}, rows)
    usage = await api.get("/runs/uid-000/usage")
    assert (usage["clock"], usage["stamp"]) == (None, None)
    assert usage["t"][0] == 0.0


async def test_only_regular_files_are_listed_and_sent(api: Any) -> None:
    files = (await api.get("/runs/uid-000/files"))["items"]
    assert [item["path"] for item in files] == ["run/output/trajectory.txt", "run/output/usage.csv"]
    answer = await api.raw.get("/api/v1/runs/uid-000/files/run/output/usage.csv")
    assert answer.text.startswith("time_seconds")
    assert answer.headers["content-disposition"].startswith("attachment")


async def test_settings_files_are_shown_as_the_program_read_them(home: Path, api: Any) -> None:
    folder = home / "runs" / "study" / "run-000" / "run" / "files"
    (folder / "config").mkdir(parents=True)
    (folder / "config" / "vins.yaml").write_text("%YAML:1.0\n---\nmax_cnt: 150 # <b>é</b>\n")
    (folder / "large.yaml").write_text("x" * (MOST_SETTINGS + 1))
    (folder / "leak.yaml").symlink_to("/etc/passwd")
    (folder / "broken.yaml").write_bytes(b"\xff")
    os.mkfifo(folder / "pipe")
    items = (await api.get("/runs/uid-000/settings-files"))["items"]
    found = {item["path"]: (item["file"], item["text"]) for item in items}
    assert found == {
        "broken.yaml": ("run/files/broken.yaml", "\N{REPLACEMENT CHARACTER}"),
        "config/vins.yaml": ("run/files/config/vins.yaml", "%YAML:1.0\n---\nmax_cnt: 150 # <b>é</b>\n"),
        "large.yaml": ("run/files/large.yaml", None),
    }


async def test_settings_files_of_a_run_that_wrote_many_are_bounded(home: Path, api: Any) -> None:
    folder = home / "runs" / "study" / "run-000" / "run" / "files"
    folder.mkdir()
    for number in range(50):
        (folder / f"{number}").write_text("")
    assert len((await api.get("/runs/uid-000/settings-files"))["items"]) == 16


async def test_no_path_leads_out(api: Any) -> None:
    for path in (
        "run/output/leak",
        "run/output/folder/passwd",
        "run/output/pipe",
        "run/output",
        "run//output/usage.csv",
        "%2e%2e/%2e%2e/%2e%2e/archive.sqlite",
        "..%2f..%2f..%2farchive.sqlite",
        "run/output/usage.csv%00.txt",
        "%2fetc%2fpasswd",
        "run/output/usage.csv/x",
        "x" * 3000,
    ):
        answer = await api.raw.get(f"/api/v1/runs/uid-000/files/{path}")
        assert answer.status_code in {400, 404}, path
        assert answer.json()["error"]


async def test_folders_elsewhere_are_not_read(api: Any) -> None:
    for uid in ("uid-001", "uid-002", "uid-003", "uid-004"):
        for part in ("files", "settings-files", "trajectory", "usage"):
            answer = await api.get(f"/runs/{uid}/{part}", 404)
            assert "no files" in answer["error"]
        assert (await api.get(f"/runs/{uid}"))["files"] is False


@pytest.mark.parametrize("content", ["", "nothing\n", "1 2\n", "nan nan nan nan nan nan nan nan\n", "\0\0"])
async def test_a_damaged_trajectory_is_a_sentence(api: Any, home: Path, content: str) -> None:
    (home / "runs/study/run-000/run/output/trajectory.txt").write_text(content)
    answer = await api.get("/runs/uid-000/trajectory", 404)
    assert "no pose" in answer["error"]
