# SPDX-License-Identifier: Apache-2.0
"""Preparation as its Job does it: the very program, on real recordings."""

from __future__ import annotations

import hashlib
import json
import re
import resource
import shutil
import signal
import stat
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.files.once import in_use
from slamhive.data.inspecting.known import FINDINGS, keep
from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.entries import DatasetEntry, dataset_sha256
from slamhive.data.store.datasets import materialise
from slamhive.data.store.groundtruth import ground_truth
from slamhive.kube.reports import read_description
from slamhive.model.algorithm import DataFormat
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role
from slamhive_eval import read_tum

ACTOR = Path(__file__).resolve().parents[1] / "actor"


def request_of(dataset: Any, roles: Any = ("lidar",), **more: Any) -> Any:
    return {
        "dataset": dataset,
        "roles": list(roles),
        "input": {},
        "formats": ["Rosbag1"],
        "assets": [],
    } | more


@pytest.fixture
def synthetic() -> Any:
    return request_of(yaml.safe_load((ACTOR / "tiny.yaml").read_text()))


@pytest.fixture
def filed(pod: Any, tiny: Path) -> Any:
    """The small recording as files of a dataset, with its ground truth."""
    made = next(tiny.glob("tiny-*"))
    folder = pod.root / "data" / "datasets" / "hall"
    folder.mkdir()
    for name in ("recording.bag", "groundtruth.txt"):
        shutil.copyfile(made / name, folder / name)
    sensors = json.loads((made / "sensors.json").read_text())["sensors"]
    plain = {
        role: {key: value for key, value in entry.items() if key != "name"} for role, entry in sensors.items()
    }
    spec = {
        "recording": {"files": [{"path": "recording.bag"}]},
        "sensors": plain,
        "groundTruth": {"file": "groundtruth.txt"},
    }
    manifest = {"apiVersion": "slamhive.io/v1alpha1", "kind": "Dataset", "metadata": {"name": "hall"}}
    return request_of(manifest | {"spec": spec})


def test_it_makes_what_the_workstation_makes(pod: Any, synthetic: Any, tiny: Path, tmp_path: Path) -> None:
    synthetic["input"] = {"frameRate": 5, "duration": "4s"}
    ended = pod.run("prepare", request=synthetic)
    assert (ended.code, ended.told["v"]) == (0, 1)
    found = read_description(ended.message)
    assert found is not None
    dataset = load_file(ACTOR / "tiny.yaml")[0]
    entry = materialise(dataset, tiny, tiny)  # type: ignore[arg-type]
    options = InputOptions.model_validate(synthetic["input"])
    variant = prepare(entry, [Role.LIDAR], options, [DataFormat.ROSBAG1], tmp_path / "own")
    assert (found.key, found.frames, found.frame_rate) == (variant.key, variant.frames, variant.frame_rate)
    assert (found.start_time, found.duration_seconds) == (variant.start_time, variant.duration_seconds)
    assert found.sensors == variant.sensors
    assert found.dataset_sha256 == dataset_sha256(entry)
    assert found.ground_truth == "poses"
    folder = pod.root / "data" / "variants" / found.folder
    assert (folder / found.recording).stat().st_size <= found.size_bytes
    assert not list(folder.glob("*groundtruth*"))
    truth = ground_truth(entry)
    assert truth is not None
    assert found.T_body_frame == truth.T_body_frame.tolist()
    written = read_tum(pod.root / "data" / "groundtruth" / "tiny.txt")
    assert written.quaternions.tolist() == truth.poses.quaternions.tolist()  # type: ignore[union-attr]


def test_folders_are_made_as_on_a_workstation(pod: Any, synthetic: Any, tiny: Path, tmp_path: Path) -> None:
    asked = synthetic | {"formats": ["Kitti"], "input": {"frameRate": 5, "duration": "4s"}}
    ended = pod.run("prepare", request=asked)
    assert ended.code == 0, ended.message
    found = read_description(ended.message)
    assert found is not None
    assert (found.format, found.recording, found.frames) == ("Kitti", "recording", 20)
    entry = materialise(load_file(ACTOR / "tiny.yaml")[0], tiny, tiny)  # type: ignore[arg-type]
    options = InputOptions.model_validate(asked["input"])
    variant = prepare(entry, [Role.LIDAR], options, [DataFormat.KITTI], tmp_path / "own")
    assert found.key == variant.key
    folder = pod.root / "data" / "variants" / found.folder
    mine, theirs = (
        {path.relative_to(place): path.read_bytes() for path in place.rglob("*") if path.is_file()}
        for place in (variant.path, folder / found.recording)
    )
    assert mine == theirs
    assert len(mine) == 22
    assert (folder / "frames.txt").read_bytes() == (variant.folder / "frames.txt").read_bytes()
    assert not (folder / found.recording / "velodyne" / "000000.bin").stat().st_mode & 0o222


def test_a_form_that_can_not_hold_the_sensors_is_refused(pod: Any, synthetic: Any) -> None:
    reason, sentence = pod.run("prepare", request=synthetic | {"formats": ["Euroc"]}).error
    assert reason == "PreparationFailed"
    assert "Euroc can't hold these sensors of tiny (sensors lidar); Euroc holds mono" in sentence


def test_what_it_makes_is_read_only_and_nobody_else_s(pod: Any, filed: Any) -> None:
    found = read_description(pod.run("prepare", request=filed).message)
    assert found is not None
    folder = pod.root / "data" / "variants" / found.folder
    assert not (folder / found.recording).stat().st_mode & 0o222
    assert not (pod.root / "data" / "groundtruth" / "hall.txt").stat().st_mode & 0o227
    assert stat.S_IMODE(folder.stat().st_mode) == 0o750


@pytest.mark.slow
def test_two_at_once_make_it_once(pod: Any, synthetic: Any) -> None:
    pod.ask(synthetic)
    logs = ["first", "second", "third"]
    processes = [pod.start("prepare", log=log) for log in logs]
    ended = [pod.end(process, log) for process, log in zip(processes, logs, strict=True)]
    assert [one.code for one in ended] == [0, 0, 0]
    assert len({one.message for one in ended}) == 1
    made = [one for one in ended if "preparing the variant: 100 %" in one.stderr]
    assert len(made) == 1
    data = pod.root / "data"
    assert not [path for path in data.rglob("*") if path.name.endswith(".making")]


def test_terminated_it_leaves_no_half_variant(pod: Any, synthetic: Any) -> None:
    synthetic["dataset"]["spec"]["recording"]["synthetic"]["durationSeconds"] = 600
    pod.ask(synthetic)
    process = pod.start("prepare")
    assert "generating" in process.stderr.readline()
    process.send_signal(signal.SIGTERM)
    reason, sentence = pod.end(process).error
    assert (reason, sentence) == ("SystemFault", "the pod was taken away before it had finished")
    left = [path for path in (pod.root / "data").rglob("*") if path.name.endswith((".making", ".bag"))]
    assert left == []


def test_terminated_while_another_one_makes_it(pod: Any, filed: Any) -> None:
    """Waiting for a lock can be ended, too."""
    folder = read_description(pod.run("prepare", request=filed).message)
    assert folder is not None
    place = pod.root / "data" / "variants" / folder.folder
    (place / folder.recording).chmod(0o644)
    (place / folder.recording).write_bytes(b"damaged")  # has to be made again, for which nobody may use it
    with in_use(place):
        process = pod.start("prepare")
        waiting = re.compile(rf"-> FLOCK .* {process.pid} ")
        deadline = time.monotonic() + 60
        while not waiting.search(Path("/proc/locks").read_text()) and time.monotonic() < deadline:
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal.SIGTERM)
        assert pod.end(process).error[0] == "SystemFault"


@pytest.mark.parametrize("name", ["recording.bag", "groundtruth.txt"])
def test_a_missing_file_is_named(pod: Any, filed: Any, name: str) -> None:
    path = pod.root / "data" / "datasets" / "hall" / name
    path.unlink()
    reason, sentence = pod.run("prepare", request=filed).error
    assert reason == "DatasetMissing"
    assert str(path) in sentence


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"input": {"start": "1h"}}, "start"),
        ({"input": {"remap": {"lidar": "laser"}}}, "input.remap.lidar: unknown sensor 'laser'"),
        ({"roles": ["imu"]}, "no sensor for the role 'imu'"),
        ({"input": {"resolution": 2}}, "request.input.resolution"),
        ({"roles": []}, "request.roles"),
        ({"formats": ["Rosbag9"]}, "request.formats.0"),
        (
            {"assets": [{"name": "a", "url": "file:///etc/group", "sha256": "0" * 64}]},
            "request.assets.0.url",
        ),
        ({"assets": [{"name": "../a", "url": "https://x", "sha256": "0" * 64}]}, "request.assets.0.name"),
    ],
)
def test_wrong_options_fail_with_a_sentence(pod: Any, filed: Any, change: Any, sentence: str) -> None:
    reason, found = pod.run("prepare", request=filed | change).error
    assert reason == "PreparationFailed"
    assert sentence in found


def test_another_file_than_declared_is_refused(pod: Any, filed: Any) -> None:
    filed["dataset"]["spec"]["recording"]["files"][0]["sha256"] = "0" * 64
    reason, sentence = pod.run("prepare", request=filed).error
    assert reason == "PreparationFailed"
    assert "sha256" in sentence


@pytest.mark.parametrize("content", ["", "[]", "{", None])
def test_a_request_that_is_none_is_a_fault(pod: Any, content: str | None) -> None:
    if content is not None:
        (pod.root / "request" / "request.json").write_text(content)
    reason, sentence = pod.run("prepare").error
    assert reason == "SystemFault"
    assert "request.json" in sentence


def test_a_damaged_recording_fails_by_a_sentence(pod: Any, filed: Any) -> None:
    path = pod.root / "data" / "datasets" / "hall" / "recording.bag"
    path.write_bytes(path.read_bytes()[:5000])
    reason, sentence = pod.run("prepare", request=filed).error
    assert reason == "PreparationFailed"
    assert "recording.bag" in sentence


@pytest.mark.parametrize("severity", [Severity.ERROR, Severity.WARNING])
def test_findings_of_its_recording_prevent_runs_or_are_told(pod: Any, filed: Any, severity: Severity) -> None:
    data = pod.root / "data"
    entry = DatasetEntry(Dataset.model_validate(filed["dataset"]), data / "datasets" / "hall")
    repair = sensor_repair("lidar", pointTimes="us")
    known = [
        Finding("points.times.unit", severity, "sensors.lidar: times are in us", "lidar", repair=repair),
        Finding("imu.units", Severity.ERROR, "sensors.imu: forces are in g", "imu"),
        Finding("truth.jump", Severity.WARNING, "groundTruth: it jumps", "groundTruth"),
    ]
    keep(entry, known, data / "generated" / FINDINGS, is_sample=False)
    ended = pod.run("prepare", request=filed)
    line = 'in its spec: repair: {"sensors": {"lidar": {"pointTimes": "us"}}}'
    said = f"sensors.lidar: times are in us (points.times.unit; {line})"
    if severity is Severity.ERROR:
        assert ended.error == ("PreparationFailed", f"dataset 'hall': runs with lidar aren't started: {said}")
        return
    found = read_description(ended.message)
    assert found is not None
    assert found.findings == ["points.times.unit", "truth.jump"]
    assert found.suspicion == f"its recording may be why: {said}"


def test_a_full_disk_is_a_fault_of_the_machine(pod: Any, filed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    # Python 3.11 would leave the first part of what it compiles, and nobody could import that any more.
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    ended = pod.run("prepare", request=filed, preexec_fn=limit)
    assert ended.error[0] == "SystemFault"
    assert "Traceback" not in ended.stderr
    assert not [path for path in (pod.root / "data" / "variants").rglob("*") if path.suffix == ".bag"]


def test_no_ground_truth_takes_away_an_older_one(pod: Any, filed: Any) -> None:
    assert pod.run("prepare", request=filed).code == 0
    del filed["dataset"]["spec"]["groundTruth"]
    found = read_description(pod.run("prepare", request=filed).message)
    assert found is not None
    assert (found.ground_truth, found.T_body_frame) == (None, None)
    assert list((pod.root / "data" / "groundtruth").iterdir()) == []


def test_relations_stay_relations(pod: Any, filed: Any, shared: Path) -> None:
    text = (shared / "lidar2d" / "intel.relations").read_text()
    (pod.root / "data" / "datasets" / "hall" / "gt").write_text(text)
    filed["dataset"]["spec"]["groundTruth"] = {"file": "gt", "format": "Relations"}
    found = read_description(pod.run("prepare", request=filed).message)
    assert found is not None
    assert found.ground_truth == "relations"
    assert (pod.root / "data" / "groundtruth" / "hall.relations").read_text() == text


def test_files_of_the_network_are_fetched_once(pod: Any, filed: Any, https: Any) -> None:
    bag = (pod.root / "data" / "datasets" / "hall" / "recording.bag").rename(https.folder / "hall.bag")
    (https.folder / "words").write_bytes(b"vocabulary")
    sha256 = hashlib.sha256(b"vocabulary").hexdigest()
    filed["dataset"]["spec"]["recording"]["files"][0] |= {
        "url": f"{https.url}/hall.bag",
        "sha256": hashlib.sha256(bag.read_bytes()).hexdigest(),
    }
    filed["assets"] = [{"name": "words.txt", "url": f"{https.url}/words", "sha256": sha256}]
    ended = pod.run("prepare", request=filed)
    assert ended.code == 0, ended.stderr
    asset = pod.root / "data" / "assets" / sha256
    assert asset.read_bytes() == b"vocabulary"
    assert not asset.stat().st_mode & 0o222
    https.close()
    assert pod.run("prepare", request=filed).message == ended.message
    asset.chmod(0o644)
    asset.write_bytes(b"damaged")
    reason, sentence = pod.run("prepare", request=filed).error
    assert reason == "SystemFault"
    assert f"{https.url}/words" in sentence


@pytest.fixture
def masked(filed: Any) -> Any:
    """The request of a run whose frames a program makes."""
    filed["dataset"]["spec"]["preparations"] = {"masked": {"image": "example.org/mask:1"}}
    filed["input"] = {"preparedBy": "masked", "duration": "2s"}
    return filed


def made_by_program(pod: Any, does: Any) -> None:
    """Do what the container between both of ours does."""
    given, out = pod.root / "work" / "in" / "lidar", pod.root / "work" / "own" / "out"
    assert len([*given.glob("*.npy")]) == 20
    does(given, out)


def test_a_program_of_the_dataset_runs_between_showing_and_taking(pod: Any, masked: Any) -> None:
    (pod.root / "work" / "in").mkdir(parents=True)
    plain = read_description(pod.run("prepare", request=masked | {"input": {"duration": "2s"}}).message)
    assert pod.run("prepare", "--show", request=masked).code == 0
    made_by_program(pod, lambda given, out: shutil.copytree(given, out / "lidar"))
    found = read_description(pod.run("prepare", request=masked).message)
    assert found is not None
    assert plain is not None
    assert found.prepared_by
    assert (plain.prepared_by, found.frames, found.sensors) == (None, 20, plain.sensors)
    assert (found.recorded_seconds, found.dataset_sha256) == (plain.recorded_seconds, plain.dataset_sha256)
    assert (pod.root / "data" / "variants" / found.folder / "recording.bag").exists()


@pytest.mark.parametrize(
    ("does", "sentence"),
    [
        (lambda *_: None, "wrote nothing; expected frames of lidar; its log: kubectl logs "),
        (lambda given, out: (out.rmdir(), out.symlink_to(given.parent)), "left no folder 'out'; its log: "),
        (
            lambda given, out: (out / "lidar").symlink_to(given),
            "wrote 'lidar', which is no folder; its log: ",
        ),
    ],
)
def test_what_a_program_of_the_dataset_left_is_no_way_to_elsewhere(
    pod: Any, masked: Any, does: Any, sentence: str
) -> None:
    (pod.root / "work" / "in").mkdir(parents=True)
    assert pod.run("prepare", "--show", request=masked).code == 0
    made_by_program(pod, does)
    reason, message = pod.run("prepare", request=masked).error
    assert reason == "PreparationFailed"
    assert message.startswith(f"the preparation 'masked' of dataset 'hall' {sentence}")


def test_a_program_that_a_dataset_does_not_name_is_refused(pod: Any, masked: Any) -> None:
    masked["input"]["preparedBy"] = "maskd"
    expected = "input.preparedBy: no preparation 'maskd'; did you mean 'masked'?"
    assert pod.run("prepare", "--show", request=masked).error == ("PreparationFailed", expected)
