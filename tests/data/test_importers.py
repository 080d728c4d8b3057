# SPDX-License-Identifier: Apache-2.0
import bz2
import gzip
import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bagsamples import HESAI, OUSTER, VELODYNE, SampleWriter, write_bag
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from slamhive.cli.datasets import app
from slamhive.data.importers import ImportOptions, import_recording
from slamhive.data.importers.carmen import POINT, read_log, scan_points
from slamhive.data.inspecting.inspection import inspect
from slamhive.data.inspecting.suggestion import suggest_dataset
from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.store.datasets import materialise
from slamhive.data.store.groundtruth import ground_truth
from slamhive.model.algorithm import DataFormat
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, InputError
from slamhive.model.loading import load_file, parse, to_object
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Camera, Role

LOG = """# CARMEN
PARAM robot_frontlaser_offset 0.25 nohost 0
FLASER 4 1.0 2.0 81.91 3.0 0 0 0 0 0 0 20.000002 nohost 1
ODOM 1 2 0.5 0.1 0.2 0 10.5 nohost 1
FLASER 4 1.5 2.0 3.0 3.0 0 0 0 0 0 0 10.100001 nohost 1
TRUEPOS 0 0 0 0 0 0 1 nohost 1
"""
ROBOTLASER = "ROBOTLASER1 0 -1.5 3.0 1.5 30 0.01 0 3 1 2 31 0 1.2 0 0 1 0 0 0 0 0 0 0 5.25 nohost 1\n"


@pytest.mark.parametrize(
    ("name", "pack"), [("a.log", bytes), ("a.bz2", bz2.compress), ("a.gz", gzip.compress)]
)
def test_carmen_logs_are_sorted_by_their_own_stamps(tmp_path: Path, name: str, pack: Any) -> None:
    (tmp_path / name).write_bytes(pack(LOG.encode()))
    log = read_log(tmp_path / name)
    assert [scan.stamp for scan in log.scans] == [10_100_001_000, 20_000_002_000]
    assert (log.inversions, log.laser_offset, len(log.odometry)) == (2, 0.25, 1)
    points = scan_points(log.scans[1])
    assert len(points) == 3
    assert (points["x"][0], points["y"][0]) == pytest.approx((0, -1), abs=1e-6)
    assert (points["x"][1], points["y"][1]) == pytest.approx((2**0.5, -(2**0.5)), abs=1e-6)


def test_robotlaser_lines(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(ROBOTLASER)
    log = read_log(tmp_path / "a.log")
    assert log.laser_offset == pytest.approx(0.2)
    points = scan_points(log.scans[0])
    assert np.arctan2(points["y"], points["x"]).tolist() == pytest.approx([-1.5, 0.0], abs=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (LOG.replace("nohost 1\nTRUE", "\nFLASER 9 1 2\nTRUE"), "line 6: not a complete FLASER"),
        (LOG.replace("1.5", "nan"), "line 5: not a complete FLASER"),
        ("ODOM 1 2 0 0 0 0 1.0 nohost 1\n", "no laser scans"),
        (LOG.replace("10.5", "-1"), "line 4: not a complete ODOM"),
    ],
)
def test_damaged_logs(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.log").write_text(text)
    with pytest.raises(DataError, match=words):
        import_recording(tmp_path / "a.log", tmp_path / "out", "a", "Carmen")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_whole_intel_log(shared: Path, tmp_path: Path) -> None:
    source = shared / "lidar2d"
    options = ImportOptions(relations=source / "intel.relations")
    dataset, _ = import_recording(
        source / "intel.clf.bz2", tmp_path / "intel", "intel", "Carmen", options=options
    )
    entry = DatasetEntry(dataset, tmp_path / "intel")
    truth = ground_truth(entry)
    variant = prepare(entry, [Role.LIDAR], InputOptions(), [DataFormat.ROSBAG1], tmp_path / "cache")
    assert variant.frames == 13_631
    with AnyReader([variant.path]) as reader:
        assert set(reader.topics) == {"/points", "/tf_static"}
        scans = [c for c in reader.connections if c.topic == "/points"]
        stamps = [reader.deserialize(raw, c.msgtype).header.stamp for c, _, raw in reader.messages(scans)]
    times = np.array([(stamp.sec * 10**9 + stamp.nanosec) / 10**9 for stamp in stamps])
    assert np.all(np.diff(times) >= 0)
    # Each relation is between the stamps of two scans, to the last bit.
    assert np.isin(truth.poses.begin, times).all()
    assert np.isin(truth.poses.end, times).all()


def euroc(folder: Path, *, cameras: int = 2) -> Path:
    """Write a little folder in EuRoC's layout."""
    base = folder / "mav0"
    pose = "T_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, {}, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
    for n in range(cameras):
        (base / f"cam{n}" / "data").mkdir(parents=True)
        lens = (
            "rate_hz: 20\nresolution: [8, 6]\ncamera_model: pinhole\nintrinsics: [5, 5.5, 3, 2]\n"
            "distortion_model: radial-tangential\ndistortion_coefficients: [0.1, 0.2, 0.3, 0.4]\n"
        )
        (base / f"cam{n}" / "sensor.yaml").write_text("%YAML:1.0\n" + pose.format(0.1 * n) + lens)
        rows = ["#timestamp [ns],filename"]
        for k in range(4):
            stamp = 10**18 + 50_000_000 * k
            pixels = np.full((6, 8), 10 * k + n, dtype=np.uint8)
            cv2.imwrite(str(base / f"cam{n}" / "data" / f"{stamp}.png"), pixels)
            rows.append(f"{stamp},{stamp}.png")
        (base / f"cam{n}" / "data.csv").write_text("\r\n".join(rows) + "\r\n")
    (base / "imu0").mkdir()
    (base / "imu0" / "sensor.yaml").write_text(
        "%YAML:1.0\n" + pose.format(0) + "rate_hz: 200\ngyroscope_noise_density: 1.7e-04\n"
    )
    samples = [f"{10**18 + 5_000_000 * k},1,2,3,4,5,6" for k in range(30)]
    (base / "imu0" / "data.csv").write_text("#t\n" + "\n".join(samples) + "\n")
    (base / "state_groundtruth_estimate0").mkdir()
    truth = [f"{10**18 + 50_000_000 * k},{k},0,0,1,0,0,0,9,9" for k in range(4)]
    (base / "state_groundtruth_estimate0" / "data.csv").write_text("#t\n" + "\n".join(truth) + "\n")
    return folder


@pytest.mark.parametrize(("cameras", "names"), [(2, {"left", "right", "imu"}), (1, {"camera", "imu"})])
def test_euroc_folders(tmp_path: Path, cameras: int, names: set[str]) -> None:
    dataset, _ = import_recording(euroc(tmp_path / "mh", cameras=cameras), tmp_path / "out", "mh", "Euroc")
    assert load_file(tmp_path / "out" / "dataset.yaml")[0] == dataset
    assert set(dataset.spec.sensors) == names
    report = inspect(DatasetEntry(dataset, tmp_path / "out"))
    assert report.errors == []
    assert report.ground_truth is not None
    assert report.ground_truth.path_metres == pytest.approx(3)
    camera = dataset.spec.sensors["left" if cameras == 2 else "camera"].camera
    assert camera is not None
    assert (camera.fx, camera.cy, camera.coefficients) == (5, 2, [0.1, 0.2, 0.3, 0.4, 0.0])
    assert dataset.spec.sensors["imu"].imu.gyroscope_noise == 1.7e-4
    with AnyReader([tmp_path / "out" / "recording.bag"]) as reader:
        images = [c for c in reader.connections if c.topic == "/cam0/image_raw"]
        first = [reader.deserialize(raw, c.msgtype).data[0] for c, _, raw in reader.messages(images)]
    assert first == [0, 10, 20, 30]
    with pytest.raises(InputError, match="exists already"):
        import_recording(tmp_path / "mh", tmp_path / "out", "mh", "Euroc")


@pytest.mark.parametrize(
    ("path", "text", "words"),
    [
        ("cam0/sensor.yaml", "camera_model: mei\n", "camera_model 'mei' .*allowed: pinhole"),
        ("cam0/data.csv", "#t\n1,none.png\n", "line 2: .*none.png does not exist"),
        ("cam0/data.csv", "#t\n", "no rows in it"),
        ("imu0/data.csv", "#t\n1,2,3\n", "line 2: 3 of 7 values"),
        ("imu0/data.csv", "#t\n1,2,3,nan,5,6,7\n", "line 2: a value is not a finite number"),
        ("imu0/sensor.yaml", "T_BS: {data: [1]}\n", "T_BS: 16 numbers are needed, found 1"),
        ("cam1/sensor.yaml", "a: [", "not YAML"),
    ],
)
def test_damaged_euroc_folders(tmp_path: Path, path: str, text: str, words: str) -> None:
    (euroc(tmp_path / "mh") / "mav0" / path).write_text(text)
    with pytest.raises(DataError, match=words):
        import_recording(tmp_path / "mh", tmp_path / "out", "mh", "Euroc")


def test_the_real_euroc_folder(shared: Path, tmp_path: Path) -> None:
    dataset, _ = import_recording(shared / "euroc_v1_01_start", tmp_path / "out", "v101", "Euroc")
    report = inspect(DatasetEntry(dataset, tmp_path / "out"))
    assert report.errors == []
    assert "/cam0/image_raw covers 4.7 s of the recording's 145.6 s (3%)" in " ".join(report.warnings)
    assert {sensor.name: sensor.messages for sensor in report.sensors} == {"camera": 95, "imu": 29_120}


def test_the_manifest_of_a_bag_elsewhere_works_where_it_is_written(
    camera_entries: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    bag = camera_entries[0.5].root / "recording.bag"
    runner = CliRunner()
    for words in (["add", str(bag), "--name", "mine"], ["add", "mine.yaml"], ["check", "mine"]):
        found = runner.invoke(app, words)
        assert found.exit_code == 0, found.output
    assert (here / "recording.bag").resolve() == bag.resolve()
    (here / "other").mkdir()
    monkeypatch.chdir(here / "other")
    Path("recording.bag").write_text("another one")
    found = runner.invoke(app, ["add", str(bag), "--name", "again"])
    assert "recording.bag: cannot be linked" in str(found.exception)


def test_a_suggestion_from_a_generated_bag_is_nearly_its_dataset(camera_entries: Any, tmp_path: Path) -> None:
    entry = camera_entries[0.5]
    bag = shutil.copy(entry.root / "recording.bag", tmp_path / "my.bag")
    found = suggest_dataset([Path(bag)], "my", tmp_path)
    dataset = to_object(parse(found.text, "my.yaml")[0])
    for name, sensor in entry.dataset.spec.sensors.items():
        guess = dataset.spec.sensors[name]
        assert (guess.topic, guess.type) == (sensor.topic, sensor.type)
        assert np.allclose(guess.T_body_sensor, sensor.T_body_sensor)
        assert guess.camera.fx == pytest.approx(sensor.camera.fx)
    assert any("groundTruth" in sentence for sentence in found.missing)
    report = inspect(DatasetEntry(dataset, tmp_path))
    assert report.errors == []
    length = dataset.spec.recording.duration_seconds
    assert length == pytest.approx(report.duration_seconds, abs=0.001)
    wrong = dataset.spec.recording.replace(duration_seconds=length + 5)
    report = inspect(DatasetEntry(dataset.replace(spec=dataset.spec.replace(recording=wrong)), tmp_path))
    assert any(f"recording.durationSeconds: states {length + 5:g} s" in text for text in report.warnings)


STRANGERS = {
    "ROS_example.bag": ({}, "groundtruth"),
    "foxglove_example-bz2.bag": ({}, None),
    "tf_example.bag": ({}, None),
    "tf_example": ({}, None),
    "nav2_turtlebot.mcap": ({"odometry": ("Odometry", "/odom", 2639)}, None),
    "robot_localization_test1.bag": (
        {
            "imu": ("Imu", "/imu/data", 11_865),
            "odometry": ("Odometry", "/husky_velocity_controller/odom", 3952),
            "gnss": ("Gnss", "/fix", 989),
        },
        None,
    ),
}
"""Recordings that others made: sensors in each, with messages as rosbags counts them, and ground truth."""


@pytest.mark.parametrize("name", STRANGERS)
def test_recordings_of_strangers_get_manifests_that_add_and_check(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    expected, truth = STRANGERS[name]
    bag = shared / "bags" / name
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    runner = CliRunner()
    for words in (["add", str(bag), "--name", "it"], ["add", "it.yaml"], ["check", "it", "--json"]):
        found = runner.invoke(app, words)
        assert found.exit_code == 0, found.output
    report = json.loads(found.stdout)
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        counted = {one.topic: 0 for one in reader.connections}
        for one in reader.connections:
            counted[one.topic] += one.msgcount
    sensors = {one["name"]: (one["type"], one["topic"], one["messages"]) for one in report["sensors"]}
    assert sensors == expected
    assert all(counted[topic] == messages for _, topic, messages in sensors.values())
    named = {topic for _, topic, _ in sensors.values()} | {truth, "/tf_static"}
    assert set(report["other_topics"]) == set(counted) - named
    assert report["errors"] == []
    assert (report["ground_truth"] is not None) == (truth is not None)
    assert report["duration_seconds"] > 20


def test_a_robot_s_bag_says_what_it_serves_and_what_it_lacks(tmp_path: Path) -> None:
    synthetic = {"sensors": ["LaserScan", "Odometry", "Gnss"], "durationSeconds": 8, "loops": 0.1}
    dataset = Dataset.model_validate(
        {"metadata": {"name": "robot"}, "spec": {"recording": {"synthetic": synthetic}}}
    )
    entry = materialise(dataset, tmp_path, tmp_path)
    found = suggest_dataset([entry.root / "recording.bag"], "robot", entry.root)
    guess = to_object(parse(found.text, "robot.yaml")[0])
    assert guess.spec.sensors.keys() == entry.dataset.spec.sensors.keys()
    for name, sensor in entry.dataset.spec.sensors.items():
        stated = guess.spec.sensors[name]
        assert (stated.topic, stated.type, stated.stamp, stated.frame_id, stated.rate) == (
            *(sensor.topic, sensor.type, sensor.stamp, sensor.frame_id),
            pytest.approx(sensor.rate),
        )
        assert np.allclose(stated.T_body_sensor, sensor.T_body_sensor)
    modes = next(sentence for sentence in found.missing if sentence.startswith("modes"))
    assert modes.startswith(
        "modes that it serves: scan, scan-odometry, odometry, gnss; the others lack one of"
    )
    assert "left" in modes
    assert any("leave out what another program estimated" in sentence for sentence in found.missing)


def test_several_of_a_kind_and_clouds_of_a_depth_camera_are_told_apart(
    tmp_path: Path, bag_writer: Any
) -> None:
    with bag_writer(tmp_path / "a.bag") as bag:
        for k in range(1, 4):
            for topic in ("/front/points", "/rear/points", "/camera/depth/points"):
                bag.points(topic, k * 10**8, "lidar", np.ones(2, dtype=POINT))
            for topic in ("/imu/a", "/imu/b"):
                bag.imu(topic, k * 10**8, "imu", np.zeros(3), np.array([0, 0, 9.81]))
            for topic in ("/cam/left", "/cam/right", "/cam/up"):
                bag.image(topic, k * 10**8, "cam", "mono8", np.zeros((4, 4), np.uint8))
            bag.planar_odometry("/vicon/base", k * 10**8, np.zeros(3), np.zeros(2))
    found = suggest_dataset([tmp_path / "a.bag"], "a", tmp_path).manifest["spec"]
    assert {name: (one["type"], one["topic"]) for name, one in found["sensors"].items()} == {
        "lidar": ("Lidar", "/front/points"),
        "lidar2": ("Lidar", "/rear/points"),
        "cloud": ("PointCloud", "/camera/depth/points"),
        "imu": ("Imu", "/imu/a"),
        "imu2": ("Imu", "/imu/b"),
        "left": ("Camera", "/cam/left"),
        "right": ("Camera", "/cam/right"),
        "camera2": ("Camera", "/cam/up"),
    }
    assert found["groundTruth"]["topic"] == "/vicon/base"


def test_compressed_images_are_cameras_as_raw_ones_are(tmp_path: Path) -> None:
    grey, depth = np.zeros((4, 4), np.uint8), np.full((4, 4), 1500, np.uint16)
    camera = Camera(width=4, height=4, fx=4.0, fy=4.0, cx=1.5, cy=1.5)
    with SampleWriter(tmp_path / "a.bag") as bag:
        for k in range(1, 4):
            bag.image("/cam/left/image_raw", k * 10**8, "cam", "mono8", grey)
            bag.compressed("/cam/left/image_raw/compressed", k * 10**8, grey)
            bag.compressed("/cam/right/image_raw/compressed", k * 10**8, grey, "mono8; jpeg compressed ")
            bag.compressed("/d4/color/image_raw/compressed", k * 10**8, grey, "rgb8; jpeg compressed bgr8")
            for name in ("depth", "aligned_depth_to_color"):
                bag.camera_info(f"/d4/{name}/camera_info", k * 10**8, "cam", camera)
                topic, described = f"/d4/{name}/image_raw/compressedDepth", "16UC1; compressedDepth png"
                bag.compressed(topic, k * 10**8, depth, described, bytes(12))
    found = suggest_dataset([tmp_path / "a.bag"], "a", tmp_path).manifest["spec"]["sensors"]
    assert {name: (one["type"], one["topic"]) for name, one in found.items()} == {
        "left": ("Camera", "/cam/left/image_raw"),
        "right": ("Camera", "/cam/right/image_raw/compressed"),
        "color": ("Camera", "/d4/color/image_raw/compressed"),
        "depth": ("DepthCamera", "/d4/aligned_depth_to_color/image_raw/compressedDepth"),
    }
    assert found["depth"]["camera"]["encoding"] == "16UC1"
    assert found["depth"]["camera"]["depthScale"] == 1000


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda folder: (folder / "my.bag").write_bytes((folder / "my.bag").read_bytes()[:9000]), "reindex"),
        (lambda folder: _replace(folder, "topic: /points", "topic: /pints"), "no topic '/pints' in"),
        (lambda folder: _replace(folder, "ringField: ring", "ringField: rink"), "no field 'rink'"),
        (lambda folder: _replace(folder, "spec:", "spec:\n  groundTruth: {topic: /gt}"), "no topic '/gt' in"),
        (lambda folder: (folder / "gt.txt").write_text("1 2 3"), "ground truth:"),
    ],
)
def test_a_broken_dataset_is_refused_before_it_is_known(
    lidar_entry: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: Any, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    shutil.copyfile(lidar_entry.root / "recording.bag", "my.bag")
    runner = CliRunner()
    assert runner.invoke(app, ["add", "my.bag"]).exit_code == 0
    change(tmp_path)
    if Path("gt.txt").exists():
        _replace(tmp_path, "spec:", "spec:\n  groundTruth: {file: gt.txt}")
    found = runner.invoke(app, ["add", "my.yaml"])
    assert isinstance(found.exception, DataError)
    assert words in str(found.exception)
    assert not (tmp_path / "home" / "datasets" / "my").exists()


def _replace(folder: Path, before: str, after: str) -> None:
    text = (folder / "my.yaml").read_text()
    assert before in text
    (folder / "my.yaml").write_text(text.replace(before, after, 1))


def test_an_unreadable_bag_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "here").mkdir()
    (tmp_path / "there" / "x.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(50))
    monkeypatch.chdir(tmp_path / "here")
    found = CliRunner().invoke(app, ["add", "../there/x.bag"])
    assert "`rosbag reindex` on a copy keeps what is whole" in str(found.exception)
    assert list((tmp_path / "here").iterdir()) == []


@pytest.mark.parametrize(
    ("fields", "back", "stamp", "words"),
    [
        (VELODYNE, True, "ScanEnd", "ScanEnd, as the times of the points in time tell"),
        (HESAI, False, "ScanStart", "ScanStart, as the times of the points in timestamp tell"),
        (HESAI, True, "ScanEnd", "ScanEnd, as the times of the points in timestamp tell"),
        (OUSTER, False, "ScanStart", "ScanStart is a guess"),
    ],
)
def test_what_a_stamp_means_is_told_by_the_times_of_points(
    tmp_path: Path, fields: Any, back: bool, stamp: str, words: str
) -> None:
    write_bag(tmp_path / "a.bag", {"/points": fields}, count=3, back=back)
    found = suggest_dataset([tmp_path / "a.bag"], "a", tmp_path)
    assert found.manifest["spec"]["sensors"]["lidar"]["stamp"] == stamp
    assert any(f"sensors.lidar.stamp: {words}" in sentence for sentence in found.missing)
