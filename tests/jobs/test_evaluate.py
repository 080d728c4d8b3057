# SPDX-License-Identifier: Apache-2.0
"""Evaluation as its Job does it: the same results as a workstation's, whatever some runs left."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.analysis.subjects import Surroundings, subject_of
from slamhive.archive import Archive
from slamhive.jobs.lines import decode
from slamhive.jobs.requests import RunItem
from slamhive.kube.reports import read_description
from slamhive.local.home.catalog import Workshop
from slamhive.local.running.evaluating import TrajectoryEvaluator
from slamhive.local.running.workbench import Workbench
from slamhive.model.algorithm import Algorithm
from slamhive.model.dataset import Dataset
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.sensors import SensorMode
from slamhive_eval import read_kitti, read_tum, write_tum

if TYPE_CHECKING:
    from slamhive.local.home.folder import Home

ROOT = Path(__file__).parents[2]
SETTINGS = {
    "rpe": [{"delta": 1, "unit": "m"}, {"delta": 5, "unit": "s", "pairs": "Consecutive"}],
    "association": {"maxDifference": "20ms"},
}
LEVER = [[0.0, -1.0, 0.0, 0.3], [1.0, 0.0, 0.0, -0.2], [0.0, 0.0, 1.0, 0.55], [0.0, 0.0, 0.0, 1.0]]


def algorithm_of(**output: Any) -> Algorithm:
    spec = {
        "image": "x",
        "modes": [{"name": "lidar"}, {"name": "mono", "output": {"gravityAligned": True}}],
        "output": {"frame": "lidar"} | output,
    }
    return Algorithm.model_validate({"metadata": {"name": "other"}, "spec": spec})


def dataset_of(truth: Any, **spec: Any) -> Dataset:
    sensors = {
        "lidar": {"type": "Lidar", "topic": "/points", "T_body_sensor": LEVER},
        "camera": {"type": "Camera", "topic": "/none", "T_body_sensor": np.eye(4).tolist()},
    }
    spec |= {"recording": {"files": [{"path": "walk.bag"}]}, "sensors": sensors, "groundTruth": truth}
    return Dataset.model_validate({"metadata": {"name": "walk"}, "spec": spec})


def put_run(pod: Any, number: int, estimate: Path | str) -> dict[str, Any]:
    """Lay a run's folder onto the results volume, and return its item without a subject."""
    uid = f"{number:08d}-0000-4000-8000-000000000000"
    folder = f"runs/{uid}/{uid[::-1]}"
    place = pod.root / "results" / folder / "output"
    place.mkdir(parents=True)
    data = estimate.encode() if isinstance(estimate, str) else estimate.read_bytes()
    (place / "trajectory.txt").write_bytes(data)
    for name in ("segments.csv", "health.csv", "trajectory.online.txt", "trajectory.keyframes.txt"):
        if isinstance(estimate, Path) and estimate.with_name(name).exists():
            shutil.copy(estimate.with_name(name), place)
    return {
        "uid": uid,
        "name": f"run-{number}",
        "folder": folder,
        "sha256": hashlib.sha256(data).hexdigest(),
        "dataset": "walk",
        "mode": "lidar",
    }


def evaluate(pod: Any, runs: Any, *options: str, evaluation: Any = None, **popen: Any) -> list[Any]:
    request = {"evaluation": evaluation, "settings": SETTINGS, "runs": runs}
    ended = pod.run("evaluate", *options, request=request, **popen)
    assert ended.code == 0, ended.stderr
    found = decode(ended.stdout)
    assert (found.total, found.missing, found.damaged) == (len(runs), [], 0)
    lines = (pod.root / "output" / "results.jsonl").read_text().splitlines()
    records = [found.records[number] for number in range(len(runs))]
    assert [json.loads(line) for line in lines] == records
    assert [(record["uid"], record["name"]) for record in records] == [
        (run.get("uid"), run.get("name")) for run in runs
    ]
    assert ended.told["failed"] == sum("error" in record for record in records)
    return records


def prepare_truth(shared: Path, kind: str, folder: Path) -> tuple[dict[str, Any], Path, tuple[float, float]]:
    """Lay out ground truth of a kind, and return its manifest, an estimate and a window on it."""
    source, estimate = shared / "trajectories", folder / "estimate.txt"
    if kind == "Kitti":
        for name, file in (("gt", "KITTI_00_gt.txt"), ("times", "KITTI_00_gt_times.txt")):
            shutil.copyfile(source / file, folder / name)
        write_tum(estimate, read_kitti(source / "KITTI_00_ORB.txt", source / "KITTI_00_gt_times.txt"))
        return {"file": "gt", "times": "times", "format": "Kitti"}, estimate, (20.0, 400.0)
    if kind == "Euroc":
        text = (shared / "euroc_v1_01_start" / "groundtruth.txt").read_text()
        shutil.copyfile(shared / "euroc_v1_01_start" / "groundtruth.txt", estimate)
        rows = [line.split() for line in text.splitlines() if line[:1] != "#"]
        lines = [
            f"{round(float(row[0]) * 1e9)},{','.join([*row[1:4], row[7], *row[4:7]])},0,0,0" for row in rows
        ]
        (folder / "gt").write_text("#timestamp\n" + "\n".join(lines) + "\n")
        return {"file": "gt", "format": "Euroc"}, estimate, (float(rows[0][0]), float(rows[-1][0]))
    if kind == "Relations":
        poses = read_tum(source / "fr2_desk_groundtruth.txt").stamps
        lines = [f"{a} {b} 0.3 0.1 0 0 0 0.2" for a, b in zip(poses[:-900:50], poses[900::50], strict=False)]
        (folder / "gt").write_text("\n".join(lines) + "\n")
        truth: dict[str, Any] = {"file": "gt", "format": "Relations"}
    elif kind in {"Table", "ControlPoints"}:
        poses = read_tum(source / "fr2_desk_groundtruth.txt")
        chosen = poses.select(slice(None, None, 500 if kind == "ControlPoints" else 1))
        rows = np.column_stack((chosen.stamps, chosen.positions)).tolist()
        lines = [f"{t!r};{x!r};{y!r};{z!r};0;0;0;1" for t, x, y, z in rows]
        (folder / "gt").write_text("t;x;y;z;filler\n" + "\n".join(lines) + "\n")
        table = {"columns": ["t", "tx", "ty", "tz"], "skip": 1}
        truth = {"file": "gt", "format": kind, "table": table, "holes": [{"start": 0, "end": 1311868166.0}]}
    else:
        shutil.copyfile(source / "fr2_desk_groundtruth.txt", folder / "gt")
        truth = {"file": "gt", "holes": [{"start": 1311868180.0, "end": 1311868190.25}]}
    lines = [
        "start,end,map",
        "1311868160,1311868200,a",
        "1311868200.5,1311868210,b",
        "1311868212,1311868300,a",
    ]
    (folder / "segments.csv").write_text("\n".join(lines))
    shutil.copyfile(source / "fr2_desk_ORB.txt", estimate)
    return truth, estimate, (1311868170.0, 1311868230.0)


@pytest.mark.parametrize(
    ("kind", "mode"),
    [
        *(("Tum", "lidar"), ("Tum", "mono"), ("Euroc", "lidar"), ("Kitti", "mono"), ("Relations", "lidar")),
        *(("ControlPoints", "lidar"), ("ControlPoints", "mono"), ("Table", "mono")),
    ],
)
def test_results_are_those_of_the_workstation(  # noqa: PLR0917 - fixtures
    pod: Any, shared: Path, home: Home, tiny: Path, kind: str, mode: str
) -> None:
    folder = pod.root / "data" / "datasets" / "walk"
    folder.mkdir()
    truth, estimate, window = prepare_truth(shared, kind, folder)
    poses = estimate.read_text().splitlines(keepends=True)
    (folder / "trajectory.online.txt").write_text("".join(poses[: len(poses) // 2]))
    said = [f"{line.split()[0]},{k % 9},{'lost' if k % 40 < 9 else 'ok'}" for k, line in enumerate(poses)]
    (folder / "health.csv").write_text("\n".join(["stamp,value,flag", *said]))
    (folder / "trajectory.keyframes.txt").write_text("".join(poses[::10]) + "1 2 3\n" * (kind == "Kitti"))
    if mode == "mono":
        truth |= {"frame": "body" if kind in {"ControlPoints", "Table"} else "lidar"}
    else:
        truth |= {"T_body_frame": LEVER}
    shutil.copyfile(next(tiny.glob("tiny-*/recording.bag")), folder / "walk.bag")
    dataset, algorithm = dataset_of(truth, gravityAligned=True), algorithm_of(poses="Keyframes")
    spec = {
        "algorithmRef": {"name": "other"},
        "datasetRef": {"name": "walk"},
        "sensors": mode,
        "input": {"remap": {}},
    }

    request = {"dataset": dataset.as_json(), "roles": ["lidar"], "formats": ["Rosbag1"]}
    told = read_description(pod.run("prepare", request=request).message)
    assert told is not None
    given = Surroundings(
        truth_frame=told.T_body_frame,  # type: ignore[arg-type]
        by_role={role: sensor.T_body_sensor for role, sensor in told.sensors.items()},
        by_name=told.extrinsics,
        gravity_aligned=dataset.spec.gravity_aligned,
        window=window,
    )
    subject = subject_of(algorithm.spec, SensorMode(mode), given)
    item = RunItem.of(subject, **put_run(pod, 1, estimate) | {"mode": mode}).as_json()
    (pod.root / "groundtruth").rmdir()
    (pod.root / "groundtruth").symlink_to(pod.root / "data" / "groundtruth")
    [line] = evaluate(pod, [item])

    expected = on_the_workstation(home, algorithm, dataset, folder)(spec, estimate, window)
    if kind not in {"Euroc", "Kitti"}:
        assert line["result"] == expected
    found, wanted = flat(line["result"]), flat(expected)
    assert found.keys() == wanted.keys()
    for key, value in wanted.items():
        close = isinstance(value, float) and found[key] == pytest.approx(value, rel=1e-9, abs=1e-12)
        assert close or found[key] == value, key
    assert kind == "Relations" or wanted[".values.ate.rmse"] > 0
    assert (".values.health.warning.seconds" in wanted) == (kind in {"Tum", "Euroc", "Kitti"})
    assert (".values.segments[1].map" in wanted) == (kind in {"Tum", "Table"})
    if kind == "ControlPoints":
        assert (
            wanted[".values.points.met"] + wanted[".values.points.missing"] == wanted[".values.points.count"]
        )
        assert wanted[".values.points.met"] > 5
    if kind in {"ControlPoints", "Table"}:
        by_its_own = any("moved there by its own" in str(value) for value in wanted.values())
        assert by_its_own == (mode == "mono")
    assert wanted[".values.beside.online.coverage"] < wanted[".coverage"]
    if kind == "Kitti":
        wrong = f"output/trajectory.keyframes.txt, line {len(poses[::10]) + 1}: found 3 of 8 values"
        assert wanted[".values.beside.keyframes.message"].startswith(wrong)


def on_the_workstation(home: Home, algorithm: Algorithm, dataset: Dataset, folder: Path) -> Any:
    """Return a function that measures a trajectory as ``slamhive run`` does."""

    def measure(spec: dict[str, Any], estimate: Path, window: tuple[float, float]) -> Any:
        workshop = Workshop()
        workshop.add([algorithm, dataset], folder)
        with Archive.open(home.archive_url) as archive:
            bench = Workbench(home, workshop, archive)
            # A workstation would prepare what the mode needs; the recording's own sensors suffice here.
            lidar = algorithm.replace(spec=algorithm.spec.replace(modes=[algorithm.spec.modes[0]]))
            variant = bench.prepare(spec | {"sensors": "lidar"}, lidar)
            variant = replace(variant, start_time=window[0], duration_seconds=window[1] - window[0])
            settings = EvaluationSettings.model_validate(SETTINGS)
            result = TrajectoryEvaluator(bench).measure_file(estimate, spec, settings, variant)
        assert result is not None
        return json.loads(json.dumps(result.as_json()))

    return measure


def flat(value: Any, path: str = "") -> dict[str, Any]:
    if isinstance(value, dict):
        return {key: item for name in value for key, item in flat(value[name], f"{path}.{name}").items()}
    if isinstance(value, list):
        return {key: item for k, part in enumerate(value) for key, item in flat(part, f"{path}[{k}]").items()}
    return {path: value}


@pytest.fixture
def walked(pod: Any) -> str:
    """A volume with ground truth of a walk, and a good estimate of it."""
    turns = np.linspace(0, 6, 200)
    rows = [
        f"{100 + k / 10:.6f} {np.cos(t):.9f} {t:.9f} {np.sin(t):.9f} 0 0 0 1" for k, t in enumerate(turns)
    ]
    text = "\n".join(rows) + "\n"
    (pod.root / "groundtruth" / "walk.txt").write_text(text)
    return text


def damaged(pod: Any, walked: str) -> list[tuple[dict[str, Any], str]]:
    """Runs that can't be measured, each with a part of the sentence that says why."""
    cases: list[tuple[dict[str, Any], str]] = []

    def case(sentence: str, estimate: str = walked, **changes: Any) -> Path:
        run = put_run(pod, len(cases) + 10, estimate) | changes
        cases.append((run, sentence))
        return Path(pod.root, "results", str(run["folder"]), "output", "trajectory.txt")

    case("sha256", sha256="0" * 64)
    case("line 2: found 2 of 8 values", "1 0 0 0 0 0 0 1\nof poses\n", sha256=None)
    case("its only row holds NaN", "1 0 0 nan 0 0 0 1\n")
    case("finite", "1 0 0 inf 0 0 0 1\n")
    case("no ground truth", dataset="elsewhere")
    case("folder", folder="../../../etc")
    case("folder", folder="/etc")
    case("mode", mode="sonar")
    case("extrinsic", extrinsic=[[1, 2]])
    case("dataset", dataset="../walk")
    case("name", name="a/b")
    case("does not exist", folder="runs/none/none")
    case("compressed").write_bytes(b"\x1f\x8b" + b"\0" * 100)
    case("segments.csv, line 2: found 1 of 2 columns").with_name("segments.csv").write_text("start,end\n1\n")
    case("is in a segment").with_name("segments.csv").write_text("start,end\n1,2\n")
    case("segments.csv is compressed").with_name("segments.csv").write_bytes(b"BZh" + b"\0" * 100)
    case("symbolic links are not followed").with_name("segments.csv").symlink_to("/etc/passwd")
    case("at most").with_name("segments.csv").write_text("#" * (2 << 20))
    path = case("symbolic links are not followed")
    path.unlink()
    path.symlink_to("/etc/passwd")
    path = case("symbolic links are not followed")
    shutil.rmtree(path.parent)
    path.parent.symlink_to(pod.root / "groundtruth")
    path = case("not a regular file")
    path.unlink()
    path.mkdir()
    path = case("not a regular file")
    path.unlink()
    os.mkfifo(path)
    path = case("at most")
    os.truncate(path, 600 << 20)
    cases.append(({"uid": 3, "name": None}, "run None"))
    return cases


def test_one_bad_run_never_stops_the_rest(pod: Any, walked: str) -> None:
    good = put_run(pod, 1, walked)
    cases = damaged(pod, walked)
    runs = [run for case in cases for run in (case[0], good)]
    records = evaluate(pod, runs, evaluation="mine")
    for record, (_, sentence) in zip(records[::2], cases, strict=True):
        assert sentence in record["error"]
        assert str(pod.root) not in record["error"]
        assert "unforeseen" not in record["error"]
    for record in records[1::2]:
        result = record["result"]
        assert (result["evaluation"], result["outcome"]) == ("mine", "Tracked")


@pytest.mark.usefixtures("walked")
def test_a_run_without_a_pose_is_lost_whatever_its_segments_say(pod: Any) -> None:
    run = put_run(pod, 1, "# nothing was tracked\n")
    (pod.root / "results" / str(run["folder"]) / "output" / "segments.csv").write_text("start,end\n")
    (record,) = evaluate(pod, [run])
    result = record["result"]
    assert (result["evaluation"], result["outcome"], result["coverage"]) == ("se3", "Lost", 0.0)
    assert result["values"]["message"] == "the algorithm wrote no pose"
    assert result["values"]["pathLength"] > 1


def test_the_longest_map_stands_for_a_run(pod: Any, walked: str) -> None:
    rows = [line.split(" ", 2) for line in walked.splitlines()]
    moved = [f"{t} {float(x) + (9 if 60 <= k < 100 else 0)} {rest}" for k, (t, x, rest) in enumerate(rows)]
    run = put_run(pod, 1, "\n".join(moved))
    segments = Path(pod.root, "results", run["folder"], "output", "segments.csv")
    segments.write_text("start,end,map,reason\n100,105.95,0,start\n106,109.95,1,lost\n110,119,0,found\n")
    [record] = evaluate(pod, [run])
    values = record["result"]["values"]
    assert values["ate"]["rmse"] < 1e-6
    assert (values["mainSegment"], values["posesOutside"], values["segmentsLeftOut"]) == (0, 9, 0)
    assert [one["reason"] for one in values["segments"]] == ["start", "lost"]
    assert values["segments"][1]["ateInMainFrame"]["rmse"] == pytest.approx(9.0, abs=1e-6)
    segments.unlink()
    [record] = evaluate(pod, [run])
    assert record["result"]["values"]["ate"]["rmse"] > 1


def test_what_lies_beside_a_trajectory_is_measured_as_it_is(pod: Any, walked: str) -> None:
    run = put_run(pod, 1, walked)
    folder = Path(pod.root, "results", run["folder"], "output")
    [alone] = evaluate(pod, [run])
    assert "beside" not in alone["result"]["values"]
    shutil.copy(folder / "trajectory.txt", folder / "trajectory.online.txt")
    (folder / "trajectory.keyframes.txt").write_text("".join(walked.splitlines(keepends=True)[::8]))
    [record] = evaluate(pod, [run])
    values = record["result"]["values"]
    beside = values.pop("beside")
    assert record["result"] == alone["result"]
    assert beside["online"]["ate"] == values["ate"]
    assert beside["online"]["rpe"] == values["rpe"]
    assert beside["keyframes"]["estimatePoses"] == len(walked.splitlines()[::8])


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda path: path.symlink_to("trajectory.txt"), "output/trajectory.online.txt: is no regular file"),
        (os.mkfifo, "output/trajectory.online.txt: is no regular file"),
        (
            lambda path: path.write_text("1 2 3\n"),
            "output/trajectory.online.txt, line 1: found 3 of 8 values",
        ),
        (
            lambda path: path.write_bytes(b"\x1f\x8b\x08"),
            "output/trajectory.online.txt is compressed; it must",
        ),
        (
            lambda path: (path.touch(), os.truncate(path, 600 << 20)),
            "output/trajectory.online.txt is larger than 512 MiB",
        ),
    ],
)
def test_what_lies_beside_a_trajectory_costs_no_result(pod: Any, walked: str, spoil: Any, why: str) -> None:
    run = put_run(pod, 1, walked)
    spoil(Path(pod.root, "results", run["folder"], "output", "trajectory.online.txt"))
    [record] = evaluate(pod, [run])
    assert record["result"]["outcome"] == "Tracked"
    (beside,) = record["result"]["values"]["beside"].values()
    assert beside["message"].startswith(why)


def test_what_a_system_said_of_itself_is_measured(pod: Any, walked: str) -> None:
    """It stands still for five seconds, and warned half a second before."""
    lines = walked.splitlines()
    rows = [line.split() for line in lines]
    stood = [
        " ".join((row[0], *rows[100][1:])) if 100 <= k < 150 else line
        for k, (row, line) in enumerate(zip(rows, lines, strict=True))
    ]
    run = put_run(pod, 1, "\n".join(stood))
    [alone] = evaluate(pod, [run])
    folder = Path(pod.root, "results", run["folder"], "output")
    flags = ["lost" if 96 <= k < 150 else "ok" for k in range(len(rows))]
    said = [f"{row[0]},{k},{flag}" for k, (row, flag) in enumerate(zip(rows, flags, strict=True))]
    (folder / "health.csv").write_text("\n".join(["stamp,value,flag", *said]))
    (folder / "covariances.csv").write_text(
        "\n".join(["stamp,cov_xx,cov_yy,cov_zz", *(f"{row[0]},1e-2,1e-2,1e-2" for row in rows)])
    )
    [record] = evaluate(pod, [run])
    values = record["result"]["values"]
    health, losses, warnings = (values.pop(name) for name in ("health", "healthLosses", "healthWarnings"))
    assert values.pop("notes")[-1].startswith("its own health: lost once, ")
    alone["result"]["values"].pop("notes")
    assert record["result"] == alone["result"]
    assert (len(losses), len(warnings), health["of"]) == (1, 1, "final")
    assert 0.3 < health["warning"]["lead"] < 1.5
    assert health["nees"]["position"]["count"] == len(rows)
    shutil.copy(folder / "trajectory.txt", folder / "trajectory.online.txt")
    [record] = evaluate(pod, [run])
    assert record["result"]["values"]["health"] == health | {"of": "online"}


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda path: path.symlink_to("/etc/passwd"), "output/health.csv: is no regular file"),
        (lambda path: path.write_text("stamp,flag\n1,no\n"), "output/health.csv, line 2: flag is 'no'"),
        (lambda path: path.write_bytes(b"\x1f\x8b\x08"), "output/health.csv is compressed; it must"),
        (
            lambda path: (path.touch(), os.truncate(path, 65 << 20)),
            "output/health.csv is larger than 64 MiB",
        ),
    ],
)
def test_health_that_is_wrong_costs_no_result(pod: Any, walked: str, spoil: Any, why: str) -> None:
    run = put_run(pod, 1, walked)
    spoil(Path(pod.root, "results", run["folder"], "output", "health.csv"))
    [record] = evaluate(pod, [run])
    assert record["result"]["outcome"] == "Tracked"
    assert record["result"]["values"]["health"]["message"].startswith(why)


@pytest.mark.parametrize("processes", ["1", "2"])
def test_a_greedy_run_is_refused_its_memory(pod: Any, walked: str, processes: str) -> None:
    pose = "1 0 0 0 0 0 0 1\n"
    runs = [put_run(pod, 1, walked), put_run(pod, 2, pose * 5_000_000), put_run(pod, 3, walked)]
    records = evaluate(pod, runs, "--memory", str(300 << 20), "--processes", processes)
    assert "memory" in records[1]["error"]
    assert [record["result"]["outcome"] for record in records[::2]] == ["Tracked", "Tracked"]


def test_a_process_that_dies_takes_no_other_run_along(
    pod: Any, walked: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from slamhive.jobs import batch

    runs = [put_run(pod, number, walked) for number in range(1, 7)]
    measure = batch.measure

    def dying(*arguments: Any, **others: Any) -> Any:
        if arguments[3].keyframes:
            os.kill(os.getpid(), signal.SIGKILL)
        return measure(*arguments, **others)

    monkeypatch.setattr(batch, "measure", dying)
    runs[2]["keyframes"] = True
    truths = batch.read_truths(pod.root / "groundtruth", ["walk"])
    bench = batch.Bench(pod.root / "results", EvaluationSettings(), None, truths)
    records = list(batch.measure_all(bench, runs, cores=2))
    assert [record["name"] for record in records] == [run["name"] for run in runs]
    assert [k for k, record in enumerate(records) if "error" in record] == [2]


def test_the_evaluator_s_image_suffices() -> None:
    """It holds numpy, pydantic, pyyaml, rfc8785 and rosbags alone."""
    code = """
import sys
for name in ("cv2", "sqlalchemy", "kubernetes", "kopf", "rich", "typer", "scipy", "fastapi", "aiohttp"):
    sys.modules[name] = None
import slamhive.jobs.evaluate, slamhive.jobs.batch, slamhive.jobs.report, slamhive.jobs.read
assert not set(sys.modules) & {"slamhive.kube", "slamhive.data", "slamhive.archive", "slamhive.local"}
"""
    subprocess.run([sys.executable, "-P", "-c", code], check=True)


def test_links_lead_to_the_runs_folders(pod: Any, walked: str) -> None:
    runs = [put_run(pod, number, walked) for number in (1, 2)]
    for _ in range(2):  # a container may be started again
        assert pod.run("evaluate", "--links", request={"runs": runs}).code == 0
    found = {link.name: link / "output" / "trajectory.txt" for link in (pod.root / "runs").iterdir()}
    assert sorted(found) == ["run-1", "run-2"]
    assert found["run-1"].read_text() == walked
    assert found["run-1"].resolve() == Path(
        pod.root.resolve(), "results", runs[0]["folder"], "output/trajectory.txt"
    )


def test_the_documented_evaluator_measures(pod: Any, walked: str) -> None:
    """The example of docs/develop/adding.md, between what is laid out for it and what is told of it."""
    document = (ROOT / "docs" / "develop" / "adding.md").read_text()
    (script,) = re.findall(r"^```python\n# end_error.py\n(.*?)^```$", document, re.MULTILINE | re.DOTALL)
    late = walked.rstrip().splitlines()
    stamp, x, *rest = late[-1].split()
    late[-1] = " ".join([stamp, str(float(x) + 0.25), *rest])
    runs = [put_run(pod, number, text) for number, text in enumerate([walked, "\n".join(late), ""], 1)]
    request = {"evaluation": "ends", "settings": {}, "runs": runs}
    assert pod.run("evaluate", "--links", request=request).code == 0
    subprocess.run([sys.executable, "-c", script], check=True, env=os.environ | {"ROOT": str(pod.root)})
    first, second, third = decode(pod.run("report").stdout).records.values()
    assert first["result"]["values"] == {"endErrorMetres": 0.0}
    assert second["result"]["values"]["endErrorMetres"] == pytest.approx(0.25)
    assert "index out of range" in third["error"]


@pytest.mark.parametrize("change", [{"name": "../x"}, {"name": "a/b"}, {"folder": "../../etc"}])
def test_links_lead_nowhere_else(pod: Any, walked: str, change: Any) -> None:
    run = put_run(pod, 1, walked) | change
    assert pod.run("evaluate", "--links", request={"runs": [run]}).error[0] == "SystemFault"
    assert list((pod.root / "runs").iterdir()) == []


def test_subjects_keep_every_digit_in_their_request() -> None:
    random = np.random.default_rng(5)
    rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3] = np.column_stack((rotation, random.normal(size=3)))
    given = Surroundings(pose, {}, {"left": LEVER}, None, True, (1.0 / 3.0, 1e9 + 0.1))  # type: ignore[dict-item]
    algorithm = algorithm_of(frame="camera")
    subject = subject_of(algorithm.spec, SensorMode.MONO, given)
    run = {"uid": "u", "name": "n", "folder": "f", "dataset": "d"}
    text = json.dumps(RunItem.of(subject, **run).as_json())
    again = RunItem.model_validate_json(text).subject()
    assert again.extrinsic is not None
    assert subject.extrinsic is not None
    assert again.extrinsic.tolist() == subject.extrinsic.tolist()
    assert (again.window, again.gravity_aligned, again.keyframes) == (subject.window, True, False)
    assert np.allclose(pose @ subject.extrinsic, LEVER)
