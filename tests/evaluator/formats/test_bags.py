# SPDX-License-Identifier: Apache-2.0
"""Trajectories in recordings: every message type in every format, and what real ones hold."""

from __future__ import annotations

import gzip
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from slamhive_eval import FileError, Trajectory, TrajectoryError, read_trajectory, rotation
from slamhive_eval.formats.posemessages import east_north_up
from slamhive_eval.formats.transforms import Frames

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

FORMATS = ("bag", "ros2", "mcap")
TF = "tf2_msgs/msg/TFMessage"


class Maker:
    """Makes messages of ROS 1 or ROS 2 out of plain values, and recordings of them."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
        if TF not in self.store.types:
            from rosbags.typesys import get_types_from_msg

            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))

    def make(self, name: str, **values: Any) -> Any:
        kind = self.store.types[name]
        if name == "std_msgs/msg/Header" and self.kind == "bag":
            values["seq"] = 0
        return kind(**values)

    def header(self, stamp: float, frame: str = "map") -> Any:
        nanoseconds = round(stamp * 1e9)
        time = self.make("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame)

    def message(self, name: str, row: Any, *, parent: str = "map", child: str = "base") -> Any:
        stamp, x, y, z, *q = map(float, row)
        header = self.header(stamp, parent)
        point = self.make("geometry_msgs/msg/Point", x=x, y=y, z=z)
        turn = self.make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", q, strict=True)))
        pose = self.make("geometry_msgs/msg/Pose", position=point, orientation=turn)
        covariance = np.zeros(36)
        full = self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance)
        if name.endswith("PoseStamped"):
            return self.make(name, header=header, pose=pose)
        if name.endswith("PoseWithCovarianceStamped"):
            return self.make(name, header=header, pose=full)
        if name.endswith("PointStamped"):
            return self.make(name, header=header, point=point)
        if name.endswith("TransformStamped"):
            shift = self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
            moved = self.make("geometry_msgs/msg/Transform", translation=shift, rotation=turn)
            return self.make(name, header=header, child_frame_id=child, transform=moved)
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        twist = self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance)
        return self.make(name, header=header, child_frame_id=child, pose=full, twist=twist)

    def record(self, folder: Path, messages: list[tuple[str, str, Any]]) -> Path:
        serialize = self.store.serialize_ros1 if self.kind == "bag" else self.store.serialize_cdr
        if self.kind == "bag":
            path = file = folder / "run.bag"
            writer: Any = Writer1(path)
        else:
            path = folder / "run"
            plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
            writer = Writer2(path, version=9, storage_plugin=plugin)
            file = path / "run.mcap" if self.kind == "mcap" else path
        with writer:
            connections = {
                topic: writer.add_connection(topic, name, typestore=self.store)
                for topic, name in dict.fromkeys((topic, name) for topic, name, _ in messages)
            }
            for k, (topic, name, message) in enumerate(messages):
                writer.write(connections[topic], k, serialize(message, name))
        return file


def rows(trajectory: Trajectory) -> Any:
    return np.column_stack((trajectory.stamps, trajectory.positions, trajectory.quaternions))


def assert_same(found: Trajectory, expected: Trajectory) -> None:
    np.testing.assert_array_equal(found.stamps, expected.stamps)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-12)
    turn = rotation.multiply(rotation.conjugate(found.quaternions), expected.quaternions)
    assert rotation.angle(turn).max() < 1e-12


@pytest.fixture(params=FORMATS, name="maker")
def maker_fixture(request: pytest.FixtureRequest) -> Maker:
    return Maker(request.param)


def test_stamped_poses(tmp_path: Path, maker: Maker, wander: Callable[..., Trajectory]) -> None:
    truth = wander(20)
    names = ["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry", "PointStamped"]
    messages = []
    for short in names:
        name = f"{'nav_msgs' if short == 'Odometry' else 'geometry_msgs'}/msg/{short}"
        messages += [(f"/{short}", name, maker.message(name, row)) for row in rows(truth)]
    poses = [maker.message("geometry_msgs/msg/PoseStamped", row) for row in rows(truth)]
    for n in (5, 20):
        path = maker.make("nav_msgs/msg/Path", header=maker.header(0), poses=poses[:n])
        messages.append(("/Path", "nav_msgs/msg/Path", path))
    for n in range(18):
        path = maker.make("nav_msgs/msg/Path", header=maker.header(0), poses=poses[n : n + 3])
        messages.append(("/Windows", "nav_msgs/msg/Path", path))
    file = maker.record(tmp_path, messages)
    for short in (*names[:4], "Path", "Windows"):
        assert_same(read_trajectory(f"{file}:/{short}"), truth)
        assert_same(read_trajectory(file, topic=short), truth)
    points = read_trajectory(file, topic="/PointStamped")
    np.testing.assert_array_equal(points.positions, truth.positions)
    assert not points.oriented
    with pytest.raises(
        FileError, match="several topics with poses, name one as in FILE:TOPIC: /Odometry, /Path"
    ):
        read_trajectory(file)
    with pytest.raises(FileError, match="no topic '/Odometri'; did you mean '/Odometry'"):
        read_trajectory(f"{file}:/Odometri")


def test_poses_of_nan_are_left_out_and_counted(tmp_path: Path, maker: Maker) -> None:
    name = "nav_msgs/msg/Odometry"
    rows = [(k, np.nan if k == 2 else k, 0, 0, 0, 0, 0, 1) for k in range(4)]
    file = maker.record(tmp_path, [("/odom", name, maker.message(name, row)) for row in rows])
    found = read_trajectory(file)
    assert (found.positions[:, 0].tolist(), found.nan_rows) == ([0, 1, 3], 1)
    assert found.notes == ("1 of 4 rows holds NaN and was left out",)


def test_fixes(tmp_path: Path, maker: Maker) -> None:
    degrees = [
        (48.0, 11.0, 500.0, 0),
        (48.0, 11.0, np.nan, -1),
        (48.001, 11.0, 500.0, 0),
        (48.0, 11.001, 510.0, 0),
    ]
    name = "sensor_msgs/msg/NavSatFix"
    messages = []
    for k, (latitude, longitude, altitude, status) in enumerate(degrees):
        fix = maker.make(
            name,
            header=maker.header(k),
            status=maker.make("sensor_msgs/msg/NavSatStatus", status=status, service=1),
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )
        messages.append(("/fix", name, fix))
    found = read_trajectory(maker.record(tmp_path, messages))
    # A minute of latitude is a nautical mile of 1852 m, give or take the ellipsoid.
    assert found.stamps.tolist() == [0, 2, 3]
    np.testing.assert_allclose(found.positions[1], (0, 0.06 * 1852, 0), atol=0.2)
    np.testing.assert_allclose(found.positions[2], (0.06 * 1852 * np.cos(np.deg2rad(48)), 0, 10), atol=0.4)
    assert not found.oriented


def test_transforms(tmp_path: Path, maker: Maker, wander: Callable[..., Trajectory]) -> None:
    """map → odom at 2 Hz, odom → base at 10 Hz, base → lidar once: the lidar in the map at 10 Hz."""
    odometry = wander(101, seed=3)
    correction = wander(26, seed=4, rate=2.5)
    mount = np.eye(4)
    mount[:3, 3] = (0.3, -0.1, 0.5)
    mount[:3, :3] = rotation.to_matrix(np.array((0.5, -0.5, 0.5, 0.5)))
    name = "geometry_msgs/msg/TransformStamped"

    def transforms(parent: str, child: str, trajectory: Trajectory) -> list[Any]:
        made = (maker.message(name, row, parent=parent, child=child) for row in rows(trajectory))
        return [maker.make(TF, transforms=[one]) for one in made]

    fixed = Trajectory(np.zeros(1), mount[:3, 3][None], np.array([[0.5, -0.5, 0.5, 0.5]]))
    messages = [("/tf_static", TF, one) for one in transforms("/base.link", "lidar", fixed)]
    messages += [("/tf", TF, one) for one in transforms("odom", "base.link", odometry)[::-1]]
    messages += [("/tf", TF, one) for one in transforms("map", "odom", correction)]
    file = maker.record(tmp_path, messages)
    assert_same(read_trajectory(f"{file}:/tf:odom.base.link"), odometry)
    assert_same(read_trajectory(f"{file}:/tf:odom.lidar"), odometry.moved(mount))
    found = read_trajectory(f"{file}:/tf:map.lidar")
    np.testing.assert_array_equal(found.stamps, odometry.stamps)
    at_corrections = found.select(np.arange(0, 101, 4))
    step = odometry.moved(mount).select(np.arange(0, 101, 4))
    positions = correction.positions + rotation.rotate(correction.quaternions, step.positions)
    np.testing.assert_allclose(at_corrections.positions, positions, atol=1e-6)
    back = read_trajectory(f"{file}:/tf:base.link.odom")
    np.testing.assert_allclose(back.positions, -rotation.rotate(back.quaternions, odometry.positions))
    assert len(read_trajectory(f"{file}:/tf_static:base.link.lidar")) == 1
    for pair, says in (
        ("map.lidr", "'lidr' is none; did you mean 'lidar'"),
        ("", "there are base.link, lidar"),
    ):
        with pytest.raises(FileError, match=says):
            read_trajectory(f"{file}:/tf:{pair}")
    with pytest.raises(
        FileError, match=r"has transforms only; name two frames as in run.*:/tf:map\.base_link"
    ):
        read_trajectory(file)


@pytest.mark.parametrize(
    ("pair", "says"),
    [
        (("a", "x"), "no transforms lead from 'a' to 'x'"),
        (("a", "a"), "a frame in itself"),
        (("a", "d"), "the frame 'd' has several parents: b, c"),
        (("a", "e"), "no time in common: a to b, b to e"),
        (("a", "f"), "transform from 'b' to 'f': pose 0 of 1: the quaternion is zero"),
        (("a", "r"), "go round in a circle"),
    ],
)
def test_trees_without_an_answer(pair: tuple[str, str], says: str) -> None:
    frames = Frames()
    here = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    edges = [("a", "b", 0), ("a", "b", 1), ("b", "d", 0), ("c", "d", 0), ("b", "e", 100), ("b", "e", 101)]
    for parent, child, stamp in [*edges, ("x", "y", 0), ("q", "r", 0), ("r", "q", 0)]:
        frames.add(parent, child, stamp, here)
    frames.add("b", "f", 0, (*here[:-1], 0.0))
    with pytest.raises(TrajectoryError, match=says):
        frames.trajectory(*pair)


def test_fixed_pose() -> None:
    frames = Frames()
    frames.add("a", "b", 0, (1, 0, 0, 0, 0, 1, 0), static=True)
    frames.add("a", "c", 0, (0, 2, 0, 0, 0, 0, 1), static=True)
    np.testing.assert_allclose(
        frames.fixed_pose("b", "c"), [[-1, 0, 0, 1], [0, -1, 0, -2], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-15
    )
    assert frames.fixed_pose("a", "z") is None


@pytest.mark.parametrize(
    ("address", "poses", "metres"),
    [
        ("ROS_example.bag:groundtruth", 12765, 304.2069),
        ("robot_localization_test1.bag:/husky_velocity_controller/odom", 3952, 358.7968),
        ("robot_localization_test1.bag:/fix", 989, None),
        ("nav2_turtlebot.mcap:/amcl_pose", 135, 34.4502),
        ("nav2_turtlebot.mcap:/tf:map.base_link", 2611, None),
        ("tf_example:/tf:odom.base_footprint", 517, 4.0011),
        ("tf_example.bag:/tf:odom.base_footprint", 517, 4.0011),
        ("foxglove_example-bz2.bag:/tf:turtle1.turtle2", 1344, None),
    ],
)
def test_real_recordings(bags: Path, address: str, poses: int, metres: float | None) -> None:
    found = read_trajectory(bags / address)
    assert len(found) == poses
    assert metres is None or found.path_length == pytest.approx(metres, abs=1e-3)


def test_a_real_robot_in_the_map(bags: Path) -> None:
    """Poses of AMCL agree with those of the chain of transforms map → odom → base."""
    said = read_trajectory(bags / "nav2_turtlebot.mcap:/amcl_pose")
    moved = read_trajectory(bags / "nav2_turtlebot.mcap:/tf:map.base_footprint")
    index = np.searchsorted(moved.stamps, said.stamps).clip(0, len(moved) - 1)
    close = np.abs(moved.stamps[index] - said.stamps) < 0.05
    assert close.sum() > 50
    apart = np.linalg.norm(moved.positions[index][close] - said.positions[close], axis=1)
    assert np.median(apart) < 0.05


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("none.bag", None, "can't be read: No such file"),
        ("none.bag:/odom", None, "none.bag: can't be read: No such file"),
        ("empty.bag", b"", "damaged or cut off"),
        ("noise.bag", b"#ROSBAG V2.0\n" + bytes(range(256)), "damaged or cut off"),
        ("noise.mcap", b"\x89MCAP0\r\n" + bytes(range(256)), "damaged or cut off"),
        ("good.txt:/odom", b"1 2 3 4 0 0 0 1\n", "is no recording; only those have topics such as '/odom'"),
    ],
)
def test_no_recordings(tmp_path: Path, name: str, content: bytes | None, says: str) -> None:
    if content is not None:
        (tmp_path / name.partition(":")[0]).write_bytes(content)
    with pytest.raises(FileError, match=says):
        read_trajectory(tmp_path / name)


def test_every_cut_of_a_recording_is_refused_by_a_sentence(
    tmp_path: Path, wander: Callable[..., Trajectory]
) -> None:
    maker = Maker("bag")
    name = "geometry_msgs/msg/PoseStamped"
    file = maker.record(tmp_path, [("/pose", name, maker.message(name, row)) for row in rows(wander(5))])
    data = file.read_bytes()
    for end in range(0, len(data), 97):
        file.write_bytes(data[:end])
        with pytest.raises(FileError, match=r"run\.bag"):
            read_trajectory(file)


def test_metadata_without_the_name_of_a_topic(tmp_path: Path) -> None:
    maker = Maker("ros2")
    name = "geometry_msgs/msg/PointStamped"
    bag = maker.record(tmp_path, [("/point", name, maker.message(name, (1, 0, 0, 0, 0, 0, 0, 1)))])
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("name: /point", "name:"))
    for topic in (None, "/point"):
        with pytest.raises(FileError, match="a topic has no name or no type"):
            read_trajectory(bag, topic=topic)


def test_names_with_colons_and_compressed_files(tmp_path: Path) -> None:
    (tmp_path / "a:b.gz").write_bytes(gzip.compress(b"1 2 3 4 0 0 0 1\n"))
    assert len(read_trajectory(tmp_path / "a:b.gz")) == 1


def test_poses_without_stamps(tmp_path: Path, maker: Maker) -> None:
    name = "geometry_msgs/msg/PoseStamped"
    row = (0, 1, 2, 3, 0, 0, 0, 1)
    file = maker.record(tmp_path, [("/pose", name, maker.message(name, row))] * 2)
    with pytest.raises(FileError, match="the 2 poses carry no stamps: all are 0 s"):
        read_trajectory(file)


def test_decreasing_stamps(tmp_path: Path) -> None:
    maker = Maker("bag")
    name = "geometry_msgs/msg/PoseStamped"
    stamped = [maker.message(name, (stamp, stamp, 0, 0, 0, 0, 0, 1)) for stamp in (2, 1, 3)]
    file = maker.record(tmp_path, [("/pose", name, one) for one in stamped])
    with pytest.raises(FileError, match=r"run.bag:/pose: pose 1 of 3: time stamp 1\.0"):
        read_trajectory(file)
    assert read_trajectory(file, unsorted="sort").positions[:, 0].tolist() == [1, 2, 3]


def test_places_on_the_ellipsoid() -> None:
    found = east_north_up(np.array([(0.0, 179.9999, 0.0), (0.0, -179.9999, 0.0)]))
    np.testing.assert_allclose(found[1], (2e-4 * np.pi / 180 * 6378137, 0, 0), atol=1e-3)
    with pytest.raises(TrajectoryError, match="within ±90"):
        east_north_up(np.array([(91.0, 0.0, 0.0)]))
