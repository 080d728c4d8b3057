# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.recordings.posetopics import poses_of_topic
from slamhive.data.recordings.reading import Recording, guess_format
from slamhive.data.store.groundtruth import ground_truth, write_ground_truth
from slamhive.data.synthetic.messages import MessageMaker, typestore
from slamhive.model.errors import DataError
from slamhive_eval import ControlPoints, Relations, read_tum

START = 1_600_000_000 * 10**9
MAKER = MessageMaker(typestore())
TUM = "1600000000.0 1 2 3 0 0 0 1\n1600000001.0 2 2 3 0 0 0 1\n1600000002.0 3 2 3 0 0 0 1\n"
EUROC = "#timestamp\n1600000000000000000,1,2,3,1,0,0,0,0\n1600000001000000000,2,2,3,1,0,0,0,0\n"
KITTI = "1 0 0 1 0 1 0 2 0 0 1 3\n1 0 0 2 0 1 0 2 0 0 1 3\n"


@pytest.mark.parametrize(
    ("text", "truth", "count"),
    [
        (TUM, {"file": "gt"}, 3),
        (EUROC, {"file": "gt", "format": "Euroc"}, 2),
        (KITTI, {"file": "gt", "format": "Kitti", "times": "times"}, 2),
        (TUM, {"file": "gt", "holes": [{"start": 1600000000.5, "end": 1600000001.5}]}, 2),
        (
            "n;t\n7;1600000000000000000;1;2;3\n8;1600000001000000000;2;2;3\n",
            {
                "file": "gt",
                "format": "Table",
                "table": {"columns": ["_", "t", "tx", "ty", "tz"], "skip": 1, "timeUnit": "ns"},
            },
            2,
        ),
        (
            KITTI,
            {"file": "gt", "format": "Table", "times": "times", "table": {"columns": ["matrix"]}},
            2,
        ),
        (TUM, {"file": "gt", "format": "ControlPoints"}, 3),
    ],
)
def test_files(tmp_path: Path, bag_with_truth: Any, text: str, truth: Any, count: int) -> None:
    (tmp_path / "gt").write_text(text)
    (tmp_path / "times").write_text("1600000000\n1600000001\n")
    found = ground_truth(bag_with_truth(tmp_path, groundTruth=truth))
    assert len(found.poses) == count
    assert found.poses.stamps[0] == 1600000000
    assert found.poses.positions[0].tolist() == [1, 2, 3]
    assert found.T_body_frame.tolist() == np.eye(4).tolist()


def test_a_topic_is_read_once(tmp_path: Path, bag_with_truth: Any) -> None:
    entry = bag_with_truth(tmp_path)
    plain, kept = ground_truth(entry), ground_truth(entry, tmp_path / "cache")
    assert plain.poses.positions[:, 0] == pytest.approx(0.1 * np.arange(30))
    assert kept.poses.stamps.tolist() == plain.poses.stamps.tolist()
    note = next((tmp_path / "cache").glob("*/groundtruth.txt"))
    assert read_tum(note).positions.tolist() == plain.poses.positions.tolist()
    write_ground_truth(entry, kept, tmp_path / "out.txt", tmp_path / "cache")
    assert (tmp_path / "out.txt").read_text() == note.read_text()


PATH, POSE = "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"


@pytest.mark.parametrize("form", ["grows", "window", "single"])
def test_a_path_is_whole_however_it_is_sent(
    tmp_path: Path, bag_writer: Any, bag_entry: Any, form: str
) -> None:
    types = typestore().types
    with bag_writer(tmp_path / "walk.bag") as bag:
        poses = []
        for k in range(20):
            odometry = MAKER.odometry(START + k * 10**8, "base", np.array([0, 0, 0, k, 0, 0]))
            poses.append(types[POSE](header=odometry.header, pose=odometry.pose.pose))
            sent = poses[{"grows": 0, "window": max(0, k - 4), "single": k}[form] :]
            bag._write("/truth", PATH, START + k * 10**8, types[PATH](header=odometry.header, poses=sent))
    found = ground_truth(bag_entry(tmp_path / "walk.bag", {}, groundTruth={"topic": "/truth"}))
    assert found.kind == "poses"
    assert found.poses.positions[:, 0].tolist() == list(range(20))


def test_fixes_are_positions_about_the_first_and_kept_as_such(
    tmp_path: Path, bag_writer: Any, bag_entry: Any
) -> None:
    with bag_writer(tmp_path / "walk.bag") as bag:
        for k in range(10):
            fix = MAKER.fix(START + k * 10**8, "gps", np.array([49.0 + k * 1e-5, 8.0, 100.0 + k]))
            fix.status.status = -1 if k in (0, 4) else 2
            bag._write("/fix", "sensor_msgs/msg/NavSatFix", START + k * 10**8, fix)
    sensors = {"gnss": ("Gnss", "/fix")}
    entry = bag_entry(tmp_path / "walk.bag", sensors, groundTruth={"topic": "/fix", "frame": "gnss"})
    for cache in (None, tmp_path / "cache", tmp_path / "cache"):
        found = ground_truth(entry, cache)
        assert found.kind == "positions"
        assert (found.poses.stamps - START / 1e9) == pytest.approx([0.1, 0.2, 0.3, *np.arange(0.5, 1, 0.1)])
        # A hundred-thousandth of a degree of latitude is 1.112 m at 49°, on the ellipsoid.
        assert found.poses.positions[-1] == pytest.approx([0, 8 * 1.112, 8], abs=0.01)
        write_ground_truth(entry, found, tmp_path / "out", cache)
        assert len((tmp_path / "out").read_text().splitlines()[1].split()) == 4
    assert inspect(entry).ground_truth.kind == "positions"


@pytest.mark.parametrize(
    ("truth", "expected"),
    [
        ({"frame": "lidar"}, "sensor"),
        ({"T_body_frame": [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "marker"),
    ],
)
def test_frames(tmp_path: Path, bag_with_truth: Any, truth: Any, expected: str) -> None:
    entry = bag_with_truth(tmp_path, groundTruth={"topic": "/truth", **truth})
    pose = np.eye(4)
    pose[0, 3] = 5.0 if expected == "marker" else 0.25
    sensor = entry.dataset.spec.sensors["lidar"].replace(T_body_sensor=pose.tolist())
    spec = entry.dataset.spec.replace(sensors={"lidar": sensor})
    moved = type(entry)(entry.dataset.replace(spec=spec), entry.root)
    assert ground_truth(moved).T_body_frame.tolist() == pose.tolist()


@pytest.mark.parametrize(
    ("text", "truth", "words"),
    [
        (None, {"file": "gt"}, "gt does not exist"),
        ("", {"file": "gt"}, "holds no poses"),
        (TUM + "inf 1 2 3 0 0 0 1\n", {"file": "gt"}, "line 4"),
        (TUM + TUM, {"file": "gt"}, "line 4.*must not decrease"),
        (KITTI, {"file": "gt", "format": "Kitti"}, "groundTruth.times: needed"),
        (TUM, {"topic": "/trut"}, "no topic '/trut' .*did you mean '/truth'"),
        (TUM, {"topic": "/points"}, "PointCloud2 carry no pose; allowed"),
        (TUM, {"topic": "/tf_static:map.lidar"}, "'map' is none"),
        (TUM, {"file": "gt", "holes": [{"start": 0, "end": 2e9}]}, "leave none of 3 poses"),
        (TUM.replace("16", "15"), {"file": "gt"}, r"1500000000\.000 to .* doesn't overlap .*1600000000\.000"),
        (TUM.replace("1600000", ""), {"file": "gt"}, "may not be Unix time"),
    ],
)
def test_bad_ground_truth(tmp_path: Path, bag_with_truth: Any, text: str, truth: Any, words: str) -> None:
    if text is not None:
        (tmp_path / "gt").write_text(text)
    entry = bag_with_truth(tmp_path, groundTruth=truth)
    if "overlap" not in words and "Unix" not in words:
        with pytest.raises(DataError, match=words):
            ground_truth(entry)
    report = inspect(entry)
    assert len(report.errors) == 1
    with pytest.raises(DataError, match=words):
        raise DataError(report.errors[0])
    assert not report.is_usable


@pytest.mark.parametrize(
    ("name", "topic", "count"),
    [
        ("ROS_example.bag", "groundtruth", 12765),
        ("robot_localization_test1.bag", "/husky_velocity_controller/odom", 3952),
        ("nav2_turtlebot.mcap", "/amcl_pose", 135),
        ("tf_example", "/tf:odom.base_link", 517),
        ("tf_example.bag", "/tf:odom.base_link", 517),
        ("foxglove_example-bz2.bag", "/tf:turtle1.turtle2", None),
    ],
)
def test_real_recordings(shared: Path, name: str, topic: str, count: int | None) -> None:
    path = shared / "bags" / name
    with Recording([path], guess_format(path)) as recording:
        if count is None:
            with pytest.raises(DataError, match="only one may"):
                poses_of_topic(recording, topic)
        else:
            assert len(poses_of_topic(recording, topic)) == count


def test_relations_are_kept_as_they_are(shared: Path, tmp_path: Path, bag_with_truth: Any) -> None:
    text = (shared / "lidar2d" / "intel.relations").read_text()
    (tmp_path / "gt").write_text(text)
    entry = bag_with_truth(tmp_path, groundTruth={"file": "gt", "format": "Relations"})
    found = ground_truth(entry)
    assert isinstance(found.poses, Relations)
    write_ground_truth(entry, found, tmp_path / "copy")
    assert (tmp_path / "copy").read_text() == text


@pytest.mark.parametrize("form", ["ControlPoints", "Table"])
def test_positions_are_written_without_orientations(tmp_path: Path, bag_with_truth: Any, form: str) -> None:
    (tmp_path / "gt").write_text(TUM)
    columns = {"table": {"columns": ["t", "tx", "ty", "tz"]}}
    holes = [{"start": 1600000000.5, "end": 1600000001.5}]
    entry = bag_with_truth(tmp_path, groundTruth={"file": "gt", "format": form, "holes": holes, **columns})
    found = ground_truth(entry)
    assert found.kind == ("points" if form == "ControlPoints" else "positions")
    assert isinstance(found.poses, ControlPoints) == (form == "ControlPoints")
    write_ground_truth(entry, found, tmp_path / "out")
    text = "# t x y z\n1600000000.0 1.0 2.0 3.0\n1600000002.0 3.0 2.0 3.0\n"
    assert (tmp_path / "out").read_text() == text
    report = inspect(entry)
    assert report.ground_truth.kind == found.kind
    assert report.errors == []


@pytest.mark.parametrize(
    ("step", "form", "warned"), [(15, "Tum", True), (15, "ControlPoints", False), (1, "Tum", False)]
)
def test_truth_too_sparse_to_be_met_is_warned_of(
    tmp_path: Path, bag_with_truth: Any, step: int, form: str, *, warned: bool
) -> None:
    (tmp_path / "gt").write_text("".join(f"{1600000000 + k * step} {k} 2 3 0 0 0 1\n" for k in range(4)))
    entry = bag_with_truth(tmp_path, groundTruth={"file": "gt", "format": form})
    report = inspect(entry)
    sentences = [one.message for one in report.findings if one.code == "truth.rate"]
    assert len(sentences) == warned
    assert not warned or "its 4 poses are 15 s apart typically" in sentences[0]
    assert set(sentences) <= set(report.warnings)


def test_what_is_written_is_read_as_the_same_poses(tmp_path: Path, bag_with_truth: Any) -> None:
    rows = np.column_stack((np.arange(40) * 0.1, np.random.default_rng(3).normal(size=(40, 7)))) / 3
    (tmp_path / "gt").write_text("# x\n" + "".join(" ".join(map(str, row)) + "\n" for row in rows.tolist()))
    truth = {"file": "gt", "holes": [{"start": 0.5, "end": 0.7}, {"start": 1.2, "end": 9.0}]}
    entry = bag_with_truth(tmp_path, groundTruth=truth)
    found = ground_truth(entry)
    write_ground_truth(entry, found, tmp_path / "out")
    again = read_tum(tmp_path / "out")
    assert 0 < len(again) < 36
    for part in ("stamps", "positions", "quaternions"):
        assert getattr(again, part).tolist() == getattr(found.poses, part).tolist()
