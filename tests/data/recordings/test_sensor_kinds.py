# SPDX-License-Identifier: Apache-2.0
"""Scanners, wheels, GNSS, magnetometers, barometers and several of a kind: checked, prepared, given."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from slamhive.data.importers.carmen import POINT
from slamhive.data.inspecting.inspection import inspect
from slamhive.data.making.preparation import prepare
from slamhive.data.recordings import kinds
from slamhive.data.recordings.entries import dataset_sha256
from slamhive.data.store.datasets import materialise
from slamhive.data.synthetic.messages import MessageMaker, typestore
from slamhive.kube.builders.variant import variant_name
from slamhive.model.dataset import Dataset
from slamhive.model.errors import DataError, InputError
from slamhive.model.formats import DataFormat
from slamhive.model.run import InputOptions
from slamhive.model.sensors import OF_A_KIND, ROLE_TYPES, Role, SensorType

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.recordings.entries import DatasetEntry

BAG = [DataFormat.ROSBAG1]
START = 1_600_000_000 * 10**9
ROBOT = ["LaserScan", "Odometry", "Gnss", "Magnetometer", "Barometer", "Imu"]


@pytest.fixture(scope="session")
def robot(tmp_path_factory: pytest.TempPathFactory) -> DatasetEntry:
    """A generated recording of a robot without cameras and LiDAR."""
    folder = tmp_path_factory.mktemp("robot")
    synthetic = {"sensors": ROBOT, "durationSeconds": 9, "loops": 0.2, "motion": 0}
    dataset = Dataset.model_validate(
        {"metadata": {"name": "robot"}, "spec": {"recording": {"synthetic": synthetic}}}
    )
    return materialise(dataset, folder, folder)


def given(entry: DatasetEntry, roles: list[Role], cache: Path, *, topics: Any = (), **options: Any) -> Any:
    """Return a variant and the header stamps in it by topic, s since the start."""
    variant = prepare(entry, roles, InputOptions.model_validate(options), BAG, cache, topics=topics)
    found: dict[str, list[float]] = {}
    with AnyReader([variant.path]) as reader:
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            stamp = getattr(message, "header", None) and message.header.stamp
            at = stamp.sec * 10**9 + stamp.nanosec if stamp else time
            found.setdefault(connection.topic, []).append((at - START) / 1e9)
    return variant, found


def test_every_kind_of_sensor_has_messages_and_a_role() -> None:
    assert set(kinds.KINDS) == set(SensorType) == set(ROLE_TYPES.values())
    assert {str(role) for role in OF_A_KIND[Role.SCAN]} == {"scan", "scan2", "scan3", "scan4"}


def test_a_robot_s_recording_is_without_fault(robot: DatasetEntry) -> None:
    report = inspect(robot)
    assert (report.errors, report.warnings, report.other_topics) == ([], [], [])
    said = {sensor.name: (sensor.messages, sensor.rate, sensor.covered) for sensor in report.sensors}
    assert said["scan"] == (90, 10.0, pytest.approx(0.99, abs=0.01))
    assert said["odometry"] == (451, 50.0, 1.0)
    assert said["gnss"][:2] == (46, 5.0)
    content = {sensor.name: sensor.content for sensor in report.sensors}
    assert content["scan"].startswith("720 rays, -180° to 179.5°, 0.2 to 30 m")
    assert content["gnss"].startswith("49.0000° N, 8.4001° E, ±0.3 m")
    assert content["magnetometer"] == "48.3 µT typically"
    assert content["barometer"].endswith("Pa typically")
    assert content["odometry"].startswith("path ")


MAKER = MessageMaker(typestore())


def scan(at: int, **changes: Any) -> Any:
    message = MAKER.laser_scan(at, "scan", np.full(360, 4.0), 0.1)
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def wheels(at: int, step: float, *, ahead: float = 1.0, turning: float = 0.0, variance: float = 1.0) -> Any:
    seconds = (at - START) / 1e9
    message = MAKER.odometry(at, "base", np.array([ahead, 0, turning, step * seconds, 0, 0]))
    message.twist.covariance[0] = variance
    return message


def fix(at: int, latitude: float, longitude: float = 8.0, **changes: Any) -> Any:
    message = MAKER.fix(at, "gps", np.array([latitude, longitude, 100.0]))
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def lost(at: int) -> Any:
    message = fix(at, 0.0)
    message.status.status = -1
    return message


NAN = float("nan")


@pytest.mark.parametrize(
    ("kind", "message_type", "make", "words"),
    [
        ("Odometry", kinds.ODOMETRY, lambda at: wheels(at, 2.0), "by the poses and 9.9 m by the speeds"),
        ("Odometry", kinds.ODOMETRY, lambda at: wheels(at, 1.0, ahead=0.0), "all speeds are 0: twist isn't"),
        ("Odometry", kinds.ODOMETRY, lambda at: wheels(at, 1.0, turning=40), "look like degrees per second"),
        ("Odometry", kinds.ODOMETRY, lambda at: wheels(at, 1.0, ahead=NAN), "a pose or speed that is not a"),
        ("Odometry", kinds.ODOMETRY, lambda at: wheels(at, 1.0, variance=-1), "variances below zero"),
        ("LaserScan", kinds.LASER_SCAN, lambda at: scan(at, angle_min=-180, angle_max=180), "like degrees"),
        ("LaserScan", kinds.LASER_SCAN, lambda at: scan(at, angle_increment=0.1), "but angle_max says"),
        ("LaserScan", kinds.LASER_SCAN, lambda at: scan(at, range_min=5.0), "only 0.0% of the rays"),
        ("LaserScan", kinds.LASER_SCAN, lambda at: scan(at, angle_increment=0.0), "no rays or no angles"),
        ("Gnss", kinds.GNSS_FIX, lambda at: fix(at, 4900.5), "allowed are -90 to 90"),
        ("Gnss", kinds.GNSS_FIX, lambda at: fix(at, 0.0, 0.0), "0 throughout"),
        ("Gnss", kinds.GNSS_FIX, lambda at: fix(at, 49.0, altitude=110e3), "looks like millimetres"),
        ("Gnss", kinds.GNSS_FIX, lambda at: fix(at, 49.0 + (at % 10**9) / 1e9), "fixes leap"),
        ("Gnss", kinds.GNSS_FIX, lost, "none of the 100 messages on /topic has a fix"),
        ("Magnetometer", kinds.MAGNETIC_FIELD, lambda at: MAKER.field(at, "m", np.full(3, 0.28)), "gauss"),
        ("Magnetometer", kinds.MAGNETIC_FIELD, lambda at: MAKER.field(at, "m", np.full(3, 28.0)), "microt"),
        ("Magnetometer", kinds.MAGNETIC_FIELD, lambda at: MAKER.field(at, "m", np.full(3, NAN)), "a field"),
        ("Barometer", kinds.FLUID_PRESSURE, lambda at: MAKER.pressure(at, "b", 1013.2), "hectopascals"),
        ("Barometer", kinds.FLUID_PRESSURE, lambda at: MAKER.pressure(at, "b", 101.3), "kilopascals"),
        ("Barometer", kinds.FLUID_PRESSURE, lambda at: MAKER.pressure(at, "b", NAN), "a pressure that is"),
    ],
)
def test_what_can_t_be_is_said(  # noqa: PLR0917
    tmp_path: Path, bag_writer: Any, bag_entry: Any, kind: str, message_type: str, make: Any, words: str
) -> None:
    with bag_writer(tmp_path / "a.bag") as bag:
        for at in range(START, START + 10 * 10**9, 10**8):
            bag._write("/topic", message_type, at, make(at))
    report = inspect(bag_entry(tmp_path / "a.bag", {"one": (kind, "/topic")}))
    said = [*report.errors, *(text for text in report.warnings if text.startswith("sensors."))]
    assert len(said) == 1, said
    assert words in said[0]
    assert said[0].startswith("sensors.one: ")


def test_a_scanner_sets_the_pace_and_wheels_go_along(robot: DatasetEntry, tmp_path: Path) -> None:
    variant, found = given(
        robot, [Role.ODOMETRY, Role.SCAN], tmp_path, frameRate=5, start="2s", duration="3s"
    )
    assert set(found) == {"/odom", "/scan", "/tf_static"}
    assert found["/scan"] == pytest.approx(np.arange(2.0, 5.0, 0.2))
    # Samples are never thinned, and reach 0.25 s beyond the window on either side.
    assert found["/odom"] == pytest.approx(np.arange(1.76, 5.25, 0.02), abs=1e-6)
    assert (variant.frames, variant.frame_rate, variant.recorded_frame_rate) == (15, 5.0, 10.0)
    assert variant.sensors[Role.ODOMETRY].rate == 50.0


def test_wheels_alone_stand_for_frames(robot: DatasetEntry, tmp_path: Path) -> None:
    variant, found = given(
        robot, [Role.ODOMETRY, Role.GNSS], tmp_path, start="2s", duration="3s", frameRate=5
    )
    assert found["/odom"] == pytest.approx(np.arange(2.0, 5.0, 0.02))
    assert found["/fix"] == pytest.approx(np.arange(1.8, 5.3, 0.2))
    assert (variant.frames, variant.frame_rate) == (150, 50.0)
    assert len((variant.folder / "frames.txt").read_text().splitlines()) == 150


def test_several_of_a_kind(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> None:
    with bag_writer(tmp_path / "a.bag") as bag:
        for k in range(10):
            for topic in ("/front", "/rear"):
                bag.points(topic, START + k * 10**8, "lidar", np.ones(3, dtype=POINT))
    entry = bag_entry(tmp_path / "a.bag", {"lidar": ("Lidar", "/front"), "back": ("Lidar", "/rear")})
    with pytest.raises(InputError, match="no sensor for the role 'lidar2'; the dataset has: back, lidar"):
        given(entry, [Role.LIDAR, Role.LIDAR2], tmp_path / "cache")
    variant, found = given(
        entry, [Role.LIDAR, Role.LIDAR2], tmp_path / "cache", remap={"lidar2": "back"}, frameRate=5
    )
    assert [len(stamps) for stamps in found.values()] == [5, 5]
    assert variant.sensors[Role.LIDAR2].topic == "/rear"
    with pytest.raises(InputError, match="'back' is of type Lidar, only LaserScan is allowed"):
        given(entry, [Role.SCAN], tmp_path / "cache", remap={"scan": "back"})


@pytest.fixture
def wandering(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> Any:
    """Makes a dataset of wheels with poses and a map beside them, which no sensor names."""

    def make(**spec: Any) -> DatasetEntry:
        with bag_writer(tmp_path / "a.bag") as bag:
            bag.points("/map", START, "map", np.ones(2, dtype=POINT))
            for k in range(50):
                at, pose = START + k * 10**8, np.array([0.1 * k, 0.0, 0.0])
                bag.planar_odometry("/odom", at, pose, np.array([1.0, 0.0]))
                bag.planar_odometry("/estimate", at, pose, np.zeros(2))
        return bag_entry(tmp_path / "a.bag", {"odometry": ("Odometry", "/odom")}, **spec)  # type: ignore[no-any-return]

    return make


def test_topics_that_no_sensor_names_are_given_to_those_who_ask(wandering: Any, tmp_path: Path) -> None:
    entry, cache = wandering(), tmp_path / "cache"
    assert inspect(entry).other_types == {
        "/estimate": "nav_msgs/msg/Odometry, 50",
        "/map": "sensor_msgs/msg/PointCloud2, 1",
    }
    plain, found = given(entry, [Role.ODOMETRY], cache)
    assert set(found) == {"/odom"}
    asked, found = given(
        entry, [Role.ODOMETRY], cache, topics=["/map", "/estimate"], start="1s", duration="1s"
    )
    assert found["/estimate"] == pytest.approx(np.arange(0.8, 2.3, 0.1))
    assert found["/map"] == [0.0]  # what was said once stays
    assert plain.key != asked.key
    with pytest.raises(DataError, match=r"modes\.topics: no topic '/estimates' .* did you mean '/estimate'"):
        given(entry, [Role.ODOMETRY], cache, topics=["/estimates"])


def test_no_one_is_given_the_ground_truth(wandering: Any, tmp_path: Path) -> None:
    entry = wandering(groundTruth={"topic": "/estimate"})
    with pytest.raises(DataError, match="/estimate is the ground truth, which no algorithm may see"):
        given(entry, [Role.ODOMETRY], tmp_path / "cache", topics=["/estimate"])


@pytest.fixture
def kept(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> DatasetEntry:
    """A dataset as there were before this version: its hashes are those of archives."""
    with bag_writer(tmp_path / "kept.bag") as bag:
        for k in range(20):
            at = START + k * 10**8
            bag.points("/points", at, "lidar", np.ones(3, dtype=POINT))
            bag.imu("/imu", at + 5 * 10**7, "imu", np.zeros(3), np.array([0, 0, 9.81]))
    sensors = {"lidar": ("Lidar", "/points"), "imu": ("Imu", "/imu")}
    return bag_entry(tmp_path / "kept.bag", sensors, groundTruth={"topic": "/truth"})  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    ("roles", "options", "key", "name"),
    [
        (
            [Role.LIDAR],
            {},
            "6ec3b6dd20bdf0170547a8f266d3f28a677937c1809de9394e9c874d8f7e24b6",
            "v-75819aebbecde5d1571c",
        ),
        (
            [Role.LIDAR, Role.IMU],
            {"frameRate": 5, "start": "500ms"},
            "510339cf93d8dc01a1a5b93d935f1ac1e6558808dfa8f6c1df0a34ad100e3071",
            "v-e931f75364c1e376ceef",
        ),
    ],
)
def test_variants_keep_their_keys(  # noqa: PLR0917
    kept: DatasetEntry, tmp_path: Path, roles: Any, options: Any, key: str, name: str
) -> None:
    content = hashlib.sha256((kept.root / "kept.bag").read_bytes()).hexdigest()
    assert content == "7c853f194b0834638539737cf61521e32673f2d951c41b1459701c4c6c3923fb"
    chosen = InputOptions.model_validate(options)
    assert prepare(kept, roles, chosen, BAG, tmp_path / "cache").key == key
    assert variant_name(kept.dataset, roles, chosen, BAG, []) == name
    assert variant_name(kept.dataset, roles, chosen, BAG, [], ["/tf"]) != name


def test_datasets_keep_their_hash(kept: DatasetEntry) -> None:
    dataset = kept.dataset.replace(spec=kept.dataset.spec.replace(ground_truth=None))
    found = dataset_sha256(type(kept)(dataset, kept.root))
    assert found == "2b42bc0c9a1ab7cc2d3ef50679fbe26d562aa3e44b6153736db1b03e7d21ae08"
