# SPDX-License-Identifier: Apache-2.0
"""Repairs of datasets: a fault of known size is undone, so that what is read is the clean recording again."""

from __future__ import annotations

import copy
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from spoiling import spoil

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.making.preparation import prepare
from slamhive.data.recordings.clouds import cloud_points
from slamhive.data.recordings.entries import DatasetEntry, dataset_sha256
from slamhive.data.recordings.reading import Recording
from slamhive.data.recordings.repairing import open_recording
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.data.store.groundtruth import ground_truth, write_ground_truth
from slamhive.model.dataset import Dataset, DatasetSpec
from slamhive.model.errors import DataError
from slamhive.model.formats import DataFormat
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

POINTS, IMU = "/points", "/imu"
NS = 10**9
G = 9.80665


def messages(entry: DatasetEntry, topic: str) -> list[bytes]:
    """Return the messages of a topic as they are read of a dataset."""
    with open_recording(entry.dataset, entry.root) as recording:
        return [bytes(raw) for _, _, raw in recording.messages({topic})]


def decoded(entry: DatasetEntry, topic: str) -> list[Any]:
    """Return the same, decoded."""
    with open_recording(entry.dataset, entry.root) as recording:
        return [recording.decode(raw, one.msgtype) for one, _, raw in recording.messages({topic})]


def stamp_of(message: Any) -> int:
    return int(message.header.stamp.sec * NS + message.header.stamp.nanosec)


def stamped(message: Any, stamp: int) -> Any:
    """Return a message with another header stamp, ns."""
    time = replace(message.header.stamp, sec=stamp // NS, nanosec=stamp % NS)
    return replace(message, header=replace(message.header, stamp=time))


def on(topic: str, change: Callable[[Any], Any]) -> Callable[[str, Any], Any]:
    """Return a change of the messages of one topic."""
    return lambda name, message: change(message) if name == topic else message


def numbered(change: Callable[[int, Any], Any]) -> Callable[[Any], Any]:
    """Return a change that knows the number of its message."""
    numbers = count()
    return lambda message: change(next(numbers), message)


def with_points(message: Any, points: Any) -> Any:
    """Return a scan of other points."""
    field_type, codes = type(message.fields[0]), {"i4": 5, "u4": 6, "f4": 7, "f8": 8, "u2": 4, "u1": 2}
    fields = [
        field_type(name, offset, codes[kind.str[1:]], 1)
        for name, (kind, offset) in ((name, points.dtype.fields[name]) for name in points.dtype.names)
    ]
    step = points.dtype.itemsize
    data = np.frombuffer(points.tobytes(), dtype=np.uint8)
    sizes = {"height": 1, "width": len(points), "point_step": step, "row_step": step * len(points)}
    return replace(message, fields=fields, data=data, **sizes)


def retyped(message: Any, kind: str, times: Callable[[Any], Any]) -> Any:
    """Return a scan with the times of its points as another type."""
    points = cloud_points(message, "")
    names = points.dtype.names or ()
    made = np.zeros(len(points), [(name, kind if name == "time" else points.dtype[name]) for name in names])
    for name in names:
        made[name] = times(points[name].astype(np.float64)) if name == "time" else points[name]
    return with_points(message, made)


def scaled_imu(message: Any, force: float = 1.0, rate: float = 1.0) -> Any:
    changed = copy.deepcopy(message)
    for vector, scale in ((changed.linear_acceleration, force), (changed.angular_velocity, rate)):
        for axis in "xyz":
            setattr(vector, axis, getattr(vector, axis) * scale)
    return changed


def back_and_forth(number: int, message: Any) -> Any:
    """Have the stamp of one message go back by 0.3 s, and that of another one ahead by an hour."""
    leap = {7: -3 * NS // 10, 12: 3600 * NS}.get(number, 0)
    return stamped(message, stamp_of(message) + leap)


def repaired(name: str, **repair: Any) -> dict[str, Any]:
    return {"repair": {"sensors": {name: repair}}}


def under(entry: DatasetEntry, spec: dict[str, Any]) -> DatasetEntry:
    """Return a dataset with other fields of its spec."""
    values = entry.dataset.as_json()
    values["spec"] |= spec
    return DatasetEntry(Dataset.model_validate(values), entry.root)


@pytest.mark.parametrize(
    ("topic", "spoiled", "repair"),
    [
        (POINTS, lambda one: stamped(one, stamp_of(one) + 37 * NS), {"shift": -37}),
        (IMU, lambda one: stamped(one, stamp_of(one) - 1_250_000), {"shift": 0.00125}),
        (IMU, lambda one: scaled_imu(one, force=1 / 8), {"forceScale": 8}),
        (IMU, lambda one: scaled_imu(one, rate=-0.25), {"rateScale": -4}),
    ],
)
def test_what_shifts_and_scales_is_undone_to_the_bit(
    topic: str, spoiled: Any, repair: Any, lidar_entry: DatasetEntry, tmp_path: Path
) -> None:
    name = {POINTS: "lidar", IMU: "imu"}[topic]
    faulty = spoil(lidar_entry, tmp_path, on(topic, spoiled))
    assert messages(faulty, topic) != messages(lidar_entry, topic)
    mended = under(faulty, repaired(name, **repair))
    assert messages(mended, topic) == messages(lidar_entry, topic)
    assert inspect(mended).as_json()["findings"] == []


@pytest.mark.parametrize("form", [DataFormat.ROSBAG2, DataFormat.MCAP])
def test_messages_of_ros2_are_repaired_alike(
    form: DataFormat, lidar_entry: DatasetEntry, tmp_path: Path
) -> None:
    made = prepare(lidar_entry, [Role.LIDAR, Role.IMU], InputOptions(), [form], tmp_path)
    recording = {"format": str(form), "files": [{"path": made.path.name}]}
    plain = under(DatasetEntry(lidar_entry.dataset, made.folder), {"recording": recording})
    mended = under(plain, repaired("imu", shift=-37.000000001, forceScale=2, rateScale=-1))
    for one, two in zip(decoded(plain, IMU), decoded(mended, IMU), strict=True):
        assert stamp_of(two) - stamp_of(one) == -37_000_000_001
        expected = scaled_imu(one, force=2, rate=-1)
        assert vars(expected.linear_acceleration) == vars(two.linear_acceleration)
        assert vars(expected.angular_velocity) == vars(two.angular_velocity)
        np.testing.assert_array_equal(one.orientation_covariance, two.orientation_covariance)


def test_a_drift_counts_from_the_first_stamp(lidar_entry: DatasetEntry, tmp_path: Path) -> None:
    clean = np.array([stamp_of(one) for one in decoded(lidar_entry, POINTS)])

    def slow(message: Any) -> Any:
        stamp = stamp_of(message)
        return stamped(message, stamp + round((stamp - clean[0]) * 1e-3))

    spec = repaired("lidar", drift=-1e-3 / (1 + 1e-3))
    mended = spoil(lidar_entry, tmp_path, on(POINTS, slow), spec)
    found = np.array([stamp_of(one) for one in decoded(mended, POINTS)])
    assert np.abs(found - clean).max() <= 1


@pytest.mark.parametrize(("way", "lost"), [("Recorded", []), ("Drop", [7, 12])])
def test_stamps_that_go_back_have_two_ways_on(
    way: str, lost: list[int], lidar_entry: DatasetEntry, tmp_path: Path
) -> None:
    faulty = spoil(lidar_entry, tmp_path, on(POINTS, numbered(back_and_forth)))
    assert any("must not decrease" in error for error in inspect(faulty).errors)
    mended = under(faulty, repaired("lidar", stamps=way))
    clean = [one for k, one in enumerate(messages(lidar_entry, POINTS)) if k not in lost]
    assert messages(mended, POINTS) == clean
    report = inspect(mended)
    assert report.errors == []
    assert report.findings == []
    assert report.sensors[[one.name for one in report.sensors].index("lidar")].messages == len(clean)


def test_messages_are_left_out_by_their_numbers_as_recorded(
    lidar_entry: DatasetEntry, tmp_path: Path
) -> None:
    clean = messages(lidar_entry, POINTS)
    spec = repaired("lidar", dropLeading=2, drop=[0, 9, 10])
    assert messages(under(lidar_entry, spec), POINTS) == [*clean[2:9], *clean[11:]]
    beyond = under(lidar_entry, repaired("lidar", drop=[10_000]))
    with pytest.raises(
        DataError, match=r"repair\.sensors\.lidar\.drop: there is no message 10000 of /points"
    ):
        messages(beyond, POINTS)


@pytest.mark.parametrize(
    ("kind", "unit", "factor"),
    [("<u4", "us", 1e6), ("<f4", "ms", 1e3), ("<f8", "ns", 1e9), ("<u4", "ns", 1e9), ("<u2", "ms", 1e3)],
)
def test_times_of_points_become_seconds(
    kind: str, unit: str, factor: float, lidar_entry: DatasetEntry, tmp_path: Path
) -> None:
    change = on(POINTS, lambda one: retyped(one, kind, lambda times: times * factor))
    mended = spoil(lidar_entry, tmp_path, change, repaired("lidar", pointTimes=unit))
    for found, clean in zip(decoded(mended, POINTS), decoded(lidar_entry, POINTS), strict=True):
        one, other = cloud_points(found, ""), cloud_points(clean, "")
        rounding = 1e-9 if kind[1] == "f" else 1 / factor
        assert one["time"].dtype.kind == "f"
        np.testing.assert_allclose(one["time"], other["time"], rtol=1e-6, atol=rounding)
        for name in ("x", "y", "z", "ring"):
            np.testing.assert_array_equal(one[name], other[name])


def test_times_that_say_nothing_are_left_out_and_not_told_of(
    lidar_entry: DatasetEntry, tmp_path: Path
) -> None:
    mended = under(lidar_entry, repaired("lidar", pointTimes="None"))
    assert "time" not in (cloud_points(decoded(mended, POINTS)[0], "").dtype.names or ())
    variant = prepare(mended, [Role.LIDAR], InputOptions(), [DataFormat.ROSBAG1], tmp_path / "cache")
    told = variant.sensors[Role.LIDAR].lidar
    assert told is not None
    assert told.time_field is None


def test_absolute_times_of_points_go_with_the_stamp(lidar_entry: DatasetEntry, tmp_path: Path) -> None:
    def ahead(message: Any) -> Any:
        late = stamped(message, stamp_of(message) + 37 * NS)
        return retyped(late, "<f8", lambda times: times + stamp_of(late) / NS)

    mended = spoil(lidar_entry, tmp_path, on(POINTS, ahead), repaired("lidar", shift=-37))
    for found, clean in zip(decoded(mended, POINTS), decoded(lidar_entry, POINTS), strict=True):
        assert stamp_of(found) == stamp_of(clean)
        times = cloud_points(found, "")["time"] - stamp_of(clean) / NS
        np.testing.assert_allclose(times, cloud_points(clean, "")["time"], atol=1e-6)


def test_points_that_are_no_returns_go(lidar_entry: DatasetEntry, tmp_path: Path) -> None:
    def with_none(message: Any) -> Any:
        points = cloud_points(message, "")
        none = np.zeros(5, dtype=points.dtype)
        none["x"][3:] = np.nan
        return with_points(message, np.insert(points, 4, none))

    mended = spoil(lidar_entry, tmp_path, on(POINTS, with_none), repaired("lidar", noReturns=True))
    for found, clean in zip(decoded(mended, POINTS), decoded(lidar_entry, POINTS), strict=True):
        np.testing.assert_array_equal(cloud_points(found, ""), cloud_points(clean, ""))


def _halved(clean: DatasetEntry, folder: Path) -> None:
    """Write the IMU's halves in two topics into one bag, with a third of the forces and offset stamps."""
    from slamhive.data.recordings.writing import RecordingWriter

    with (
        open_recording(clean.dataset, clean.root) as recording,
        RecordingWriter(recording, folder / "recording.bag", clean.dataset.spec.recording.format) as writer,
    ):
        for number, (connection, time, raw) in enumerate(recording.messages(recording.topics)):
            if connection.topic != IMU:
                writer.write(connection, time, raw)
                continue
            message = recording.decode(raw, connection.msgtype)
            forces = scaled_imu(message, rate=0.0)
            rates = scaled_imu(message, force=float("nan"))
            if number % 2:
                writer.write(
                    connection._replace(topic="/accel"), time, recording.encode(forces, connection.msgtype)
                )
            writer.write(connection, time, recording.encode(rates, connection.msgtype))


def test_the_halves_of_an_imu_are_joined(lidar_entry: DatasetEntry, tmp_path: Path) -> None:
    _halved(lidar_entry, tmp_path)
    joined = under(
        DatasetEntry(lidar_entry.dataset, tmp_path), repaired("imu", forces="/accel", forceScale=2)
    )
    clean = {stamp_of(one): one for one in decoded(lidar_entry, IMU)}
    found = decoded(joined, IMU)
    with Recording([joined.root / "recording.bag"], joined.dataset.spec.recording.format) as recording:
        known = recording.scan(["/accel"])["/accel"].stamps
    stamps = np.array([stamp_of(one) for one in found])
    assert known[0] == stamps[0]
    assert known[-1] == stamps[-1]
    assert len(known) < 0.8 * len(stamps)
    for axis in "xyz":
        forces = np.array([getattr(one.linear_acceleration, axis) for one in found])
        exact = [2 * getattr(clean[stamp].linear_acceleration, axis) for stamp in known.tolist()]
        np.testing.assert_allclose(forces, np.interp(stamps - known[0], known - known[0], exact), rtol=1e-9)
        rates = [getattr(clean[stamp].angular_velocity, axis) for stamp in stamps.tolist()]
        assert [getattr(one.angular_velocity, axis) for one in found] == rates


@pytest.mark.parametrize(
    ("forces", "said"),
    [
        ("/acel", r"forces: no messages of a topic '/acel' in .*; did you mean|; none is known"),
        (POINTS, r"forces: /points has messages of type sensor_msgs/msg/PointCloud2; allowed: sensor_msgs"),
    ],
)
def test_a_topic_of_forces_that_has_none_is_named(forces: str, said: str, lidar_entry: DatasetEntry) -> None:
    faulty = under(lidar_entry, repaired("imu", forces=forces))
    with pytest.raises(DataError, match=r"repair\.sensors\.imu\." + said):
        messages(faulty, IMU)


def test_what_a_camera_is_repaired_of_its_camera_info_follows(
    camera_entries: dict[float, DatasetEntry], tmp_path: Path
) -> None:
    entry = camera_entries[0.5]
    topic = entry.dataset.spec.sensors["left"].topic
    info = topic.rsplit("/", 1)[0] + "/camera_info"

    def late(name: str, message: Any) -> Any:
        return stamped(message, stamp_of(message) + NS) if name in (topic, info) else message

    mended = spoil(entry, tmp_path, late, repaired("left", shift=-1, drop=[3]))
    for name in (topic, info):
        clean = messages(entry, name)
        assert messages(mended, name) == [*clean[:3], *clean[4:]]


def test_a_depth_scale_is_what_algorithms_are_told(
    camera_entries: dict[float, DatasetEntry], tmp_path: Path
) -> None:
    entry = camera_entries[0.5]
    mended = under(entry, repaired("depth", depthScale=2500))
    assert entry.dataset.spec.sensors["depth"].camera.depth_scale != 2500  # type: ignore[union-attr]
    roles = [Role.COLOR, Role.DEPTH]
    made = [
        prepare(one, roles, InputOptions(), [DataFormat.ROSBAG1], tmp_path / "cache")
        for one in (entry, mended)
    ]
    assert made[1].sensors[Role.DEPTH].camera.depth_scale == 2500  # type: ignore[union-attr]
    assert made[0].key != made[1].key


def test_record_times_made_of_stamps_move_with_them(frames_of: Any, tmp_path: Path) -> None:
    """A converter stamps the record with the stamp: else a stream 3 s ahead would come 3 s late."""
    ticks = [1600 * NS + k * NS // 10 for k in range(50)]
    both = [*((tick, "/left/image") for tick in ticks), *((tick + 3 * NS, "/right/image") for tick in ticks)]
    with BagWriter(tmp_path / "walk.bag") as bag:
        for stamp, topic in sorted(both):
            bag.image(topic, stamp, "camera", "mono8", np.zeros((12, 16), dtype=np.uint8))
    sensors = {"left": ("Camera", "/left/image"), "right": ("Camera", "/right/image")}
    spec = {"repair": {"sensors": {"right": {"shift": -3}}}}
    entry = under(frames_of.describe(tmp_path / "walk.bag", sensors), spec)
    topics = {topic for _, topic in both}
    with open_recording(entry.dataset, entry.root) as recording:
        found = [(time, one.topic) for one, time, _ in recording.messages(topics)]
        start, stop = found[31][0], found[60][0]
        part = [(time, one.topic) for one, time, _ in recording.messages(topics, start, stop)]
    assert [time for time, _ in found] == sorted(2 * ticks)
    assert part == [one for one in found if start <= one[0] < stop]


@pytest.mark.parametrize("form", [DataFormat.ROSBAG1, DataFormat.ROSBAG2, DataFormat.KITTI])
def test_a_variant_of_a_repaired_dataset_is_that_of_the_clean_one(
    form: DataFormat, lidar_entry: DatasetEntry, tmp_path: Path
) -> None:
    def spoiled(message: Any) -> Any:
        late = stamped(message, stamp_of(message) + 37 * NS)
        return retyped(late, "<f4", lambda times: times * 1e6)

    spec = repaired("lidar", shift=-37, pointTimes="us")
    mended = spoil(lidar_entry, tmp_path / "bad", on(POINTS, spoiled), spec)
    options = InputOptions.model_validate({"frameRate": 5, "start": "1s", "duration": "4s"})
    made, clean = (
        prepare(one, [Role.LIDAR], options, [form], tmp_path / name)
        for one, name in ((mended, "a"), (lidar_entry, "b"))
    )
    assert (made.folder / "frames.txt").read_text() == (clean.folder / "frames.txt").read_text()
    assert made.told == clean.told
    if form is DataFormat.KITTI:
        files = sorted(one.relative_to(clean.path) for one in clean.path.rglob("*") if one.is_file())
        assert files
        assert all((made.path / one).read_bytes() == (clean.path / one).read_bytes() for one in files)


def test_a_recording_under_repair_is_never_linked(lidar_entry: DatasetEntry, tmp_path: Path) -> None:
    """Even where nothing else is to be changed, and the file may be."""
    change = on(IMU, lambda one: scaled_imu(one, force=0.5))
    both = [Role.LIDAR, Role.IMU]
    for name, spec in (("plain", None), ("mended", repaired("imu", forceScale=2))):
        entry = spoil(lidar_entry, tmp_path / name, change, spec)
        original = entry.root / entry.dataset.spec.recording.files[0].path
        original.chmod(0o444)
        made = prepare(entry, both, InputOptions(), [DataFormat.ROSBAG1], tmp_path / "cache")
        assert original.samefile(made.path) == (name == "plain")
    clean = prepare(lidar_entry, both, InputOptions(), [DataFormat.ROSBAG1], tmp_path / "other")
    for one, two in zip(_samples(made.path), _samples(clean.path), strict=True):
        assert one == two


def _samples(path: Path) -> Iterable[bytes]:
    from slamhive.model.formats import RecordingFormat

    with Recording([path], RecordingFormat.ROSBAG1) as recording:
        yield from (bytes(raw) for _, _, raw in recording.messages({IMU}))


def test_the_truth_is_measured_against_at_its_repaired_time(
    lidar_entry: DatasetEntry, tmp_path: Path
) -> None:
    from slamhive.jobs.prepare import place_truth
    from slamhive_eval import Options, evaluate, read_tum

    clean = ground_truth(lidar_entry)
    assert clean is not None
    spec = {"repair": {"groundTruth": {"shift": -0.1, "drift": -1e-3 / (1 + 1e-3)}}}
    late = spoil(lidar_entry, tmp_path, lambda _, message: message, spec)
    rows = np.loadtxt(late.root / "groundtruth.txt")
    rows[:, 0] += 0.1 + 1e-3 * (rows[:, 0] - rows[0, 0])
    np.savetxt(late.root / "groundtruth.txt", rows, fmt="%.9f")
    mended = ground_truth(late)
    assert mended is not None
    np.testing.assert_allclose(mended.poses.stamps, clean.poses.stamps, atol=1e-6)  # type: ignore[union-attr]
    place_truth(late, mended, tmp_path / "placed", tmp_path / "cache")
    placed = read_tum(tmp_path / "placed" / f"{late.name}.txt")
    np.testing.assert_array_equal(placed.stamps, mended.poses.stamps)  # type: ignore[union-attr]
    measured = evaluate(placed, clean.poses, Options(alignment="none")).ate  # type: ignore[arg-type]
    assert measured is not None
    assert measured.rmse < 1e-6


def test_relations_are_repaired_at_both_times(lidar_entry: DatasetEntry, tmp_path: Path) -> None:
    spec: dict[str, Any] = {"groundTruth": {"file": "truth.relations", "format": "Relations"}}
    spec |= {"repair": {"groundTruth": {"shift": 2.5}}}
    (tmp_path / "truth.relations").write_text("# between\n10.5 11.25 1 2 0.333333333333 0 0 0.1\n")
    values = lidar_entry.dataset.as_json()
    values["spec"] |= spec
    entry = DatasetEntry(Dataset.model_validate(values), tmp_path)
    truth = ground_truth(entry)
    assert truth is not None
    write_ground_truth(entry, truth, tmp_path / "written")
    assert (tmp_path / "written").read_text() == "# between\n13.0 13.75 1 2 0.333333333333 0 0 0.1\n"


def test_hashes_change_with_what_a_repair_is_of(lidar_entry: DatasetEntry, tmp_path: Path) -> None:
    def known(**spec: Any) -> tuple[str, str]:
        entry = under(lidar_entry, spec)
        made = prepare(entry, [Role.LIDAR], InputOptions(), [DataFormat.ROSBAG1], tmp_path)
        return dataset_sha256(entry), made.key

    plain = known()
    assert plain == (dataset_sha256(lidar_entry), plain[1])
    of_truth = known(repair={"groundTruth": {"shift": 1}})
    of_another = known(repair={"sensors": {"imu": {"shift": 1}}})
    of_this = known(repair={"sensors": {"lidar": {"shift": 1}}})
    assert len({plain[0], of_truth[0], of_another[0], of_this[0]}) == 4
    assert plain[1] == of_truth[1] == of_another[1] != of_this[1]


@pytest.mark.parametrize(
    ("repair", "said"),
    [
        ({"sensors": {"lidr": {"shift": 1}}}, "repair.sensors: unknown sensor 'lidr'; did you mean 'lidar'?"),
        (
            {"sensors": {"imu": {"pointTimes": "us"}}},
            "repair.sensors.imu.pointTimes: imu is of type Imu; only",
        ),
        ({"sensors": {"imu": {"depthScale": 5}}}, "repair.sensors.imu.depthScale: imu is of type Imu; only"),
        ({"sensors": {"lidar": {"forceScale": 5}}}, "lidar.forceScale: lidar is of type Lidar; only Imu"),
        (
            {"sensors": {"imu": {"forces": "/imu"}}},
            "repair.sensors.imu.forces: /imu is the sensor's own topic",
        ),
        ({"sensors": {"imu": {"forceScale": 0}}}, "forceScale: 0 leaves nothing"),
        ({"sensors": {"imu": {"shift": 1e300}}}, "less than or equal to 4000000000"),
        ({"sensors": {}}, "repair: nothing is repaired"),
    ],
)
def test_a_repair_that_contradicts_the_manifest_is_refused(
    repair: Any, said: str, lidar_entry: DatasetEntry
) -> None:
    values = lidar_entry.dataset.spec.as_json() | {"repair": repair}
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - its text is looked at
        DatasetSpec.model_validate(values)
    assert said in str(refused.value)


def test_sensors_of_one_topic_have_one_repair(lidar_entry: DatasetEntry) -> None:
    values = lidar_entry.dataset.spec.as_json()
    values["sensors"]["lidar2"] = values["sensors"]["lidar"]
    same = {"repair": {"sensors": {"lidar": {"pointTimes": "None"}}}}
    told = DatasetSpec.model_validate(values | same).told_sensors
    assert told["lidar2"].lidar.time_field is None  # type: ignore[union-attr]
    other = {"repair": {"sensors": {"lidar": {"shift": 1}, "lidar2": {"shift": 2}}}}
    with pytest.raises(ValueError, match=r"repair\.sensors\.lidar2: another repair than that of lidar"):
        DatasetSpec.model_validate(values | other)
