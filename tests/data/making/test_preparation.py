# SPDX-License-Identifier: Apache-2.0
import json
import multiprocessing
import os
import shutil
import signal
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bagsamples import SampleWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader

from slamhive.contract.posefiles import FRAMES
from slamhive.data.making.preparation import evict_variants, prepare
from slamhive.data.recordings.clouds import cloud_points
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.recordings.images import compressed_pixels, image_pixels
from slamhive.model.algorithm import DataFormat
from slamhive.model.dataset import DataFile, Recording
from slamhive.model.errors import DataError, InputError
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role

BAG1, BAG2, MCAP = DataFormat.ROSBAG1, DataFormat.ROSBAG2, DataFormat.MCAP
STEREO, RGBD = (Role.LEFT, Role.RIGHT), (Role.COLOR, Role.DEPTH)


def read(path: Any) -> Any:
    """Read everything: by topic, the record times and the messages."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, time, raw in reader.messages():
            found.setdefault(connection.topic, []).append((time, reader.deserialize(raw, connection.msgtype)))
    return found


def stamps(messages: Any) -> Any:
    return np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, m in messages])


def make(entry: Any, roles: Any, cache: Any, formats: Any = (BAG1,), **options: Any) -> Any:
    return prepare(entry, roles, InputOptions.model_validate(options), formats, cache)


@pytest.fixture(scope="module")
def halved(camera_entries: Any, tmp_path_factory: Any) -> Any:
    """The world recorded at full resolution and prepared, and the same rendered at half of it."""
    cache = tmp_path_factory.mktemp("cache")
    roles = (*STEREO, *RGBD)
    prepared = make(camera_entries[1.0], roles, cache, resolution=0.5)
    return (
        prepared,
        read(prepared.path),
        camera_entries[0.5],
        read(camera_entries[0.5].root / "recording.bag"),
    )


@pytest.mark.parametrize("role", [Role.LEFT, Role.RIGHT, Role.COLOR])
def test_scaled_images_look_like_rendered_ones(halved: Any, role: Any) -> None:
    prepared, ours, _, rendered = halved
    topic = prepared.sensors[role].topic
    assert len(ours[topic]) == len(rendered[topic]) > 10
    for (_, mine), (_, direct) in list(zip(ours[topic], rendered[topic], strict=True))[::4]:
        a, b = (image_pixels(message, topic).astype(np.float64) for message in (mine, direct))
        assert a.shape == b.shape
        inner = (slice(2, -2), slice(2, -2))
        error = np.abs(a - b)[inner].mean()
        # Half a pixel of the scaled image to any side is clearly worse: the principal point is right.
        for shift in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            moved = 0.5 * (b + np.roll(b, shift, axis=(0, 1)))
            assert error < 0.7 * np.abs(a - moved)[inner].mean()
        assert error < 6.0


def test_scaled_depth_is_rendered_depth(halved: Any) -> None:
    prepared, ours, _, rendered = halved
    topic = prepared.sensors[Role.DEPTH].topic
    for (_, mine), (_, direct) in zip(ours[topic], rendered[topic], strict=True):
        a, b = (image_pixels(message, topic).astype(np.float64) for message in (mine, direct))
        assert np.median(np.abs(a - b) / np.maximum(b, 1)) < 0.01


def test_calibration_is_that_of_rendering_at_that_size(halved: Any) -> None:
    prepared, ours, entry, rendered = halved
    for role, view in prepared.sensors.items():
        declared = entry.dataset.spec.sensors[role]
        for name in ("width", "height", "fx", "fy", "cx", "cy", "coefficients"):
            expected = getattr(declared.camera, name)
            assert getattr(view.camera, name) == pytest.approx(expected, rel=1e-12)
        topic = view.topic.replace("image_raw", "camera_info")
        for (_, mine), (_, direct) in zip(ours[topic], rendered[topic], strict=True):
            assert (mine.width, mine.height) == (direct.width, direct.height)
            for name in "KPDR":
                assert getattr(mine, name) == pytest.approx(getattr(direct, name), rel=1e-9, abs=1e-9)


@pytest.mark.slow
def test_frames_of_all_cameras_are_thinned_together(camera_entries: Any, tmp_path: Path) -> None:
    entry = camera_entries[1.0]
    for roles, apart in ((STEREO, 0), (RGBD, 20_000_000)):
        variant = make(entry, roles, tmp_path, frameRate=1)
        found = read(variant.path)
        first, second = (stamps(found[variant.sensors[role].topic]) for role in roles)
        assert (second - first).tolist() == [apart] * len(first)
        assert np.diff(first).tolist() == [10**9] * (len(first) - 1)
        assert len(first) >= 7
        for role in roles:
            info = variant.sensors[role].topic.replace("image_raw", "camera_info")
            assert stamps(found[info]).tolist() == stamps(found[variant.sensors[role].topic]).tolist()
            assert variant.sensors[role].rate == 1.0
        assert (variant.frame_rate, variant.frames) == (1.0, len(first))


def test_only_what_was_asked_for_is_in_a_variant(
    camera_entries: Any, lidar_entry: Any, tmp_path: Path
) -> None:
    found = read(make(camera_entries[1.0], [Role.CAMERA], tmp_path).path)
    assert set(found) == {"/camera/left/image_raw", "/camera/left/camera_info", "/tf_static"}
    assert set(read(make(lidar_entry, [Role.LIDAR], tmp_path).path)) == {"/points", "/tf_static"}


@pytest.mark.parametrize("format_", [BAG1, BAG2, MCAP])
def test_formats_hold_the_same(lidar_entry: Any, tmp_path: Path, format_: Any) -> None:
    source = read(lidar_entry.root / "recording.bag")
    variant = make(lidar_entry, [Role.LIDAR, Role.IMU], tmp_path, [format_])
    assert variant.format is format_
    found = read(variant.path)
    assert {topic: len(messages) for topic, messages in found.items()} == {
        topic: len(messages) for topic, messages in source.items()
    }
    for (at, mine), (then, original) in zip(found["/points"], source["/points"], strict=True):
        assert at == then
        assert mine.data.tobytes() == original.data.tobytes()
    assert stamps(found["/imu"]).tolist() == stamps(source["/imu"]).tolist()


def test_a_variant_that_a_program_changed_is_made_again(lidar_entry: Any, tmp_path: Path) -> None:
    """A folder's files too; all runs of the variant share it."""
    variant = make(lidar_entry, [Role.LIDAR], tmp_path, [BAG2])
    (file,) = (path for path in variant.path.iterdir() if path.suffix != ".yaml")
    content = file.read_bytes()
    file.chmod(0o644)
    file.write_bytes(content[:100])
    assert make(lidar_entry, [Role.LIDAR], tmp_path, [BAG2]) == variant
    assert len(file.read_bytes()) == len(content)


def as_dataset(variant: Any, entry: Any) -> DatasetEntry:
    """Take a variant for a dataset of its own."""
    recording = Recording(format=variant.format, files=[DataFile(path=variant.path.name)])
    spec = entry.dataset.spec.replace(recording=recording, ground_truth=None)
    return DatasetEntry(entry.dataset.replace(spec=spec), variant.folder)


@pytest.mark.parametrize("format_", [BAG2, MCAP])
def test_ros2_recordings_are_prepared_alike(
    camera_entries: Any, lidar_entry: Any, tmp_path: Path, format_: Any
) -> None:
    cases = (
        (camera_entries[1.0], RGBD, {"resolution": 0.5, "frameRate": 1, "start": "1s"}),
        (lidar_entry, (Role.LIDAR, Role.IMU), {"lidar": {"maxRange": 5, "rings": 2}, "duration": "2s"}),
    )
    for entry, roles, options in cases:
        source = as_dataset(make(entry, roles, tmp_path, [format_]), entry)
        theirs = make(source, roles, tmp_path, [format_], **options)
        assert theirs.format is format_
        ours = make(entry, roles, tmp_path, **options)
        assert (theirs.sensors, theirs.start_time, theirs.frames) == (
            ours.sensors,
            ours.start_time,
            ours.frames,
        )
        expected, found = read(ours.path), read(theirs.path)
        assert set(found) == set(expected)
        for topic, messages in found.items():
            assert len(messages) == len(expected[topic])
            for (_, mine), (_, other) in zip(messages, expected[topic], strict=True):
                if hasattr(mine, "data"):
                    assert mine.data.tobytes() == other.data.tobytes()
                if hasattr(mine, "k"):
                    assert (mine.k.tolist(), mine.p.tolist()) == (other.K.tolist(), other.P.tolist())


@pytest.mark.parametrize("there", [BAG2, MCAP])
def test_there_and_back_again(camera_entries: Any, tmp_path: Path, there: Any) -> None:
    away = make(camera_entries[0.5], RGBD, tmp_path, [there])
    back = make(as_dataset(away, camera_entries[0.5]), RGBD, tmp_path)
    source = camera_entries[0.5].root / "recording.bag"
    ours, original = read(back.path), read(source)
    assert set(ours) == {topic for topic in original if "color" in topic or "depth" in topic or "tf" in topic}
    for topic, messages in ours.items():
        if topic.endswith("image_raw"):
            assert [m.data.tobytes() for _, m in messages] == [m.data.tobytes() for _, m in original[topic]]
        if topic.endswith("camera_info"):
            assert messages[0][1].K.tolist() == original[topic][0][1].K.tolist()
            assert messages[0][1].R.tolist() == original[topic][0][1].R.tolist()
    with Reader(source) as first, Reader(back.path) as second:
        digests = {connection.topic: connection.digest for connection in first.connections}
        for connection in second.connections:
            assert connection.digest == digests[connection.topic]


def test_an_unchanged_recording_is_linked(lidar_entry: Any, tmp_path: Path) -> None:
    variant = make(lidar_entry, [Role.LIDAR, Role.IMU], tmp_path)
    assert variant.path.read_bytes() == (lidar_entry.root / "recording.bag").read_bytes()
    assert variant.path.samefile(lidar_entry.root / "recording.bag")
    assert not variant.path.is_symlink()
    assert sorted(path.name for path in variant.folder.iterdir()) == [
        "frames.txt",
        "recording.bag",
        "variant.json",
    ]


def test_stamps_of_frames_are_sensor_time(lidar_entry: Any, tmp_path: Path) -> None:
    sensors = lidar_entry.dataset.spec.sensors
    late = sensors | {"lidar": sensors["lidar"].replace(time_offset=-0.0123)}
    spec = lidar_entry.dataset.spec.replace(sensors=late)
    entry = DatasetEntry(lidar_entry.dataset.replace(spec=spec), lidar_entry.root)
    variant = make(entry, [Role.IMU, Role.LIDAR], tmp_path, frameRate=5)
    found = stamps(read(variant.path)["/points"])
    assert len(found) == variant.frames
    assert (variant.folder / FRAMES).read_text().split() == [str(stamp - 12_300_000) for stamp in found]


@pytest.mark.parametrize(("roles", "options"), [(STEREO, {"frameRate": 2}), (RGBD, {"start": "1s"})])
def test_a_variant_of_an_earlier_version_gets_the_stamps_of_its_frames(
    camera_entries: Any, tmp_path: Path, roles: Any, options: Any
) -> None:
    """While runs may be reading its recording, which stays."""
    first = make(camera_entries[1.0], roles, tmp_path, **options)
    kept, recording = (first.folder / FRAMES).read_bytes(), first.path.stat()
    description = json.loads((first.folder / "variant.json").read_text())
    del description["framesSha256"]
    (first.folder / "variant.json").unlink()
    (first.folder / "variant.json").write_text(json.dumps(description))
    (first.folder / FRAMES).unlink()
    again = make(camera_entries[1.0], roles, tmp_path, **options)
    assert again == first
    assert (again.folder / FRAMES).read_bytes() == kept
    assert (again.path.stat().st_ino, again.path.stat().st_mtime_ns) == (
        recording.st_ino,
        recording.st_mtime_ns,
    )
    names = ["frames.txt", "recording.bag", "variant.json"]
    assert sorted(path.name for path in again.folder.iterdir()) == names


def test_stamps_of_frames_that_were_changed_are_made_again(lidar_entry: Any, tmp_path: Path) -> None:
    first = make(lidar_entry, [Role.LIDAR], tmp_path)
    kept = (first.folder / FRAMES).read_bytes()
    (first.folder / FRAMES).chmod(0o644)
    (first.folder / FRAMES).write_bytes(kept.replace(b"1", b"2", 1))
    assert (make(lidar_entry, [Role.LIDAR], tmp_path).folder / FRAMES).read_bytes() == kept


@pytest.mark.parametrize(
    ("start", "duration", "frames"), [(None, "2s", 20), ("1s", None, 70), ("1500ms", "1s", 10)]
)
def test_cut(lidar_entry: Any, tmp_path: Path, start: Any, duration: Any, frames: Any) -> None:
    options = {key: value for key, value in (("start", start), ("duration", duration)) if value}
    variant = make(lidar_entry, [Role.LIDAR, Role.IMU], tmp_path, **options)
    found = read(variant.path)
    scans, samples = stamps(found["/points"]), stamps(found["/imu"])
    begin = 1_600_000_000 + {None: 0.0, "1s": 1.0, "1500ms": 1.5}[start]
    assert len(scans) == frames == variant.frames
    assert (variant.folder / FRAMES).read_text() == "".join(f"{stamp}\n" for stamp in scans)
    assert variant.start_time == pytest.approx(begin, abs=1e-6)
    assert variant.duration_seconds == pytest.approx((frames - 1) / 10)
    # The IMU covers each scan from its first to its last point.
    assert samples[0] <= scans[0]
    assert samples[-1] >= scans[-1] + 10**8
    assert samples[-1] <= scans[-1] + 4 * 10**8
    times = [at for at, _ in found["/tf_static"]]
    assert min(at for messages in found.values() for at, _ in messages) <= times[0] <= found["/points"][-1][0]


def test_lidar_options(lidar_entry: Any, tmp_path: Path) -> None:
    variant = make(lidar_entry, [Role.LIDAR], tmp_path, lidar={"maxRange": 4, "minRange": 1, "rings": 4})
    source = read(lidar_entry.root / "recording.bag")["/points"]
    for (_, mine), (_, original) in zip(read(variant.path)["/points"], source, strict=True):
        points, all_points = cloud_points(mine, ""), cloud_points(original, "")
        ranges = np.sqrt(sum(all_points[axis].astype(np.float64) ** 2 for axis in "xyz"))
        expected = all_points[(ranges >= 1) & (ranges <= 4) & (all_points["ring"] % 2 == 1)]
        assert points["x"].tolist() == expected["x"].tolist()
        assert points["time"].tolist() == expected["time"].tolist()
        assert (points["ring"] * 2 + 1).tolist() == expected["ring"].tolist()
    lidar = variant.sensors[Role.LIDAR].lidar
    assert (lidar.rings, lidar.min_range, lidar.max_range) == (4, 1.0, 4.0)


def test_variants_are_found_again_by_what_matters(lidar_entry: Any, tmp_path: Path) -> None:
    first = make(lidar_entry, [Role.LIDAR], tmp_path, frameRate=5)
    changed = first.path.stat().st_mtime_ns
    again = make(lidar_entry, [Role.LIDAR], tmp_path, frameRate=5.0, resolution=0.5, pace="Lockstep", rate=2)
    assert again == first
    assert again.path.stat().st_mtime_ns == changed
    assert first.path.stat().st_mode & 0o222 == 0
    keys = {first.key}
    for options in ({}, {"frameRate": 4}, {"start": "1s"}, {"duration": "1s"}, {"lidar": {"rings": 4}}):
        keys.add(make(lidar_entry, [Role.LIDAR], tmp_path, **options).key)
    assert len(keys) == 6


def test_a_changed_recording_gives_another_variant(tmp_path: Path, frames_of: Any) -> None:
    entry = frames_of(tmp_path / "a.bag", rate=10, count=5)
    before = make(entry, [Role.CAMERA], tmp_path / "cache")
    entry = frames_of(tmp_path / "a.bag", rate=10, count=6)
    after = make(entry, [Role.CAMERA], tmp_path / "cache")
    assert (before.frames, after.frames) == (5, 6)
    assert before.key != after.key


def test_jitter_does_not_reach_the_spacing(tmp_path: Path, frames_of: Any) -> None:
    entry = frames_of(tmp_path / "a.bag", rate=20, count=101, jitter=0.01)
    variant = make(entry, [Role.CAMERA], tmp_path / "cache", frameRate=10)
    found = read(variant.path)["/cam/image_raw"]
    assert {int(m.data[0]) for _, m in found} == set(range(0, 101, 2))
    assert variant.frame_rate == pytest.approx(10, abs=0.1)


@pytest.mark.parametrize(
    ("options", "roles", "words"),
    [
        (
            {"start": "1h"},
            [Role.CAMERA],
            "nothing is left of /cam/image_raw after 3600 s; it lasts 0.4",
        ),
        ({}, [Role.LIDAR], "no sensor for the role .*lidar.*; the dataset has: camera"),
        ({"remap": {"camera": "camra"}}, [Role.CAMERA], "did you mean .camera."),
        ({}, [Role.CAMERA, Role.IMU], "no sensor for the role .*imu.*; the dataset has"),
    ],
)
def test_options_that_do_not_fit(
    tmp_path: Path, frames_of: Any, options: Any, roles: Any, words: Any
) -> None:
    entry = frames_of(tmp_path / "a.bag", rate=10, count=5)
    with pytest.raises(InputError, match=words):
        make(entry, roles, tmp_path / "cache", **options)
    cache = tmp_path / "cache"
    assert not cache.exists() or not [path for path in cache.iterdir() if not path.name.startswith(".")]


def test_a_size_that_calibration_does_not_state(tmp_path: Path, frames_of: Any) -> None:
    entry = frames_of(tmp_path / "a.bag", rate=10, count=5, size=(10, 16))
    with pytest.raises(DataError, match=r"states 16×12 pixels, but the images on /cam/image_raw have 16×10"):
        make(entry, [Role.CAMERA], tmp_path / "cache", resolution=0.5)


@pytest.mark.parametrize("form", ["png", "rvl"])
def test_depth_that_few_programs_read_is_prepared_as_png(tmp_path: Path, bag_entry: Any, form: str) -> None:
    depth = np.arange(12 * 16, dtype=np.uint16).reshape(12, 16) // 3 * 10
    with SampleWriter(tmp_path / "a.bag") as bag:
        for k in range(1, 5):
            bag.image("/color", k * 10**8, "cam", "mono8", np.zeros((12, 16), np.uint8))
            bag.compressed("/depth", k * 10**8, depth, f"16UC1; compressedDepth {form}", bytes(12))
    sensors = {"color": ("Camera", "/color"), "depth": ("DepthCamera", "/depth")}
    entry = bag_entry(tmp_path / "a.bag", sensors)
    variant = make(entry, RGBD, tmp_path / "cache")
    messages = [message for _, message in read(variant.path)["/depth"]]
    assert [message.format for message in messages] == ["16UC1; compressedDepth png"] * 4
    assert all(np.array_equal(compressed_pixels(message, "/depth"), depth) for message in messages)
    folder = make(entry, RGBD, tmp_path / "cache", formats=(DataFormat.TUM,)).path
    files = sorted((folder / "depth").iterdir())
    assert np.array_equal(cv2.imread(str(files[0]), cv2.IMREAD_UNCHANGED), depth)


def test_ground_truth_never_reaches_a_variant(tmp_path: Path, bag_with_truth: Any) -> None:
    entry = bag_with_truth(tmp_path)
    assert set(read(make(entry, [Role.LIDAR], tmp_path / "cache").path)) == {"/points", "/tf_static"}


def test_a_writable_recording_is_copied(tmp_path: Path, bag_with_truth: Any) -> None:
    entry = bag_with_truth(tmp_path)
    walk = make(entry, [Role.LIDAR], tmp_path / "cache")
    shutil.copy(walk.path, tmp_path / "plain.bag")
    (tmp_path / "plain.bag").chmod(0o644)
    recording = Recording(files=[DataFile(path="plain.bag")])
    spec = entry.dataset.spec.replace(recording=recording, ground_truth=None)
    plain = DatasetEntry(entry.dataset.replace(spec=spec), tmp_path)
    variant = make(plain, [Role.LIDAR], tmp_path / "cache")
    assert variant.path.read_bytes() == walk.path.read_bytes()
    assert not variant.path.samefile(tmp_path / "plain.bag")
    assert (tmp_path / "plain.bag").stat().st_mode & 0o777 == 0o644


def _prepare(entry: Any, cache: Path, start: Any, times: Any) -> None:
    start.wait(50)
    variant = make(entry, [Role.LIDAR], cache, frameRate=5)
    with variant.in_use():
        times.put((variant.frames, variant.path.stat().st_mtime_ns, len(read(variant.path)["/points"])))


def test_ten_runs_share_one_variant(lidar_entry: Any, tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    start, times = context.Barrier(10), context.Queue()
    processes = [
        context.Process(target=_prepare, args=(lidar_entry, tmp_path, start, times)) for _ in range(10)
    ]
    for process in processes:
        process.start()
    found = {times.get(timeout=60) for _ in processes}
    for process in processes:
        process.join(60)
    assert len(found) == 1
    assert found.pop()[::2] == (40, 40)


def _prepare_slowly(entry: Any, cache: Path, reached: Any) -> None:
    def progress(share: float) -> None:
        if share > 0.5:
            reached.set()
            time.sleep(60)

    prepare(entry, [Role.LIDAR], InputOptions(frame_rate=5), [BAG1], cache, progress)


def test_killed_while_writing_and_prepared_again(lidar_entry: Any, tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    reached = context.Event()
    process = context.Process(target=_prepare_slowly, args=(lidar_entry, tmp_path, reached))
    process.start()
    assert reached.wait(50)
    os.kill(process.pid or 0, signal.SIGKILL)
    process.join(50)
    assert not [path for path in tmp_path.iterdir() if path.is_dir() and not path.name.startswith(".")]
    variant = make(lidar_entry, [Role.LIDAR], tmp_path, frameRate=5)
    assert len(read(variant.path)["/points"]) == 40
    assert not list(tmp_path.glob(".*.making"))


def test_least_recently_used_variants_go_first(lidar_entry: Any, tmp_path: Path) -> None:
    variants = [make(lidar_entry, [Role.LIDAR], tmp_path, frameRate=rate) for rate in (5, 2)]
    for age, variant in enumerate(variants):
        then = time.time() - 10_000 + age
        os.utime(tmp_path / f".{variant.folder.name}.lock", (then, then))
    size = variants[1].path.stat().st_size
    assert evict_variants(tmp_path, size + 10_000) == [variants[0].folder.name]
    assert make(lidar_entry, [Role.LIDAR], tmp_path, frameRate=5).frames == 40
