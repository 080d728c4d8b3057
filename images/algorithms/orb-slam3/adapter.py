# SPDX-License-Identifier: Apache-2.0
"""Adapter of ORB-SLAM3 for a camera, a stereo pair or an RGB-D camera, each with an IMU or without.

It is GPL-3.0 and is only ever run in an environment or image of its own, by this program.

Its trajectory is read when the recording is at its end, after loop closure. It holds the frames of the
largest map but those whose reference keyframe was culled since. With an IMU they are poses of the IMU,
without one of the camera. Stereo images are rectified here, which turns the left camera, and the poses are
turned back.
"""

from __future__ import annotations

import os
import signal
import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pyorbslam3
from adapter_recording import Recording, decode_image, decode_imu
from adapter_support import (
    NANOSECONDS,
    AdapterError,
    HealthLog,
    Run,
    Stopwatch,
    Trajectory,
    run_adapter,
    write_results,
)
from cameras import Pinhole, Rectification, Undistortion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    from adapter_recording import Item
    from adapter_support import Sensor

CAMERAS = {"mono": ["camera"], "stereo": ["left", "right"], "rgbd": ["color", "depth"]}
IMU = "-inertial"

SMALLEST_LEVEL = 33
"""Width and height in pixels that the smallest level of the pyramid must have, or ORB-SLAM3 falls over."""

FLAGS = {"OK": "ok", "OK_KLT": "ok", "RECENTLY_LOST": "degraded"}
"""Words of health.csv for its states; of all others it is lost."""

WAITING_FRAMES = 200
"""Frames that wait for inertial samples at most: more would fill the memory where the samples have ended."""


def cameras_of(run: Run) -> list[str]:
    """Name the roles of the cameras of the run's mode.

    Raises:
        AdapterError: The mode isn't one of these.
    """
    roles = CAMERAS.get(run.mode.removesuffix(IMU))
    if roles is None:
        known = ", ".join(name + ending for ending in ("", IMU) for name in CAMERAS)
        raise AdapterError(f"the mode {run.mode} isn't known; this adapter has {known}")
    return roles


def is_inertial(run: Run) -> bool:
    """Tell whether the run's mode has an IMU."""
    return run.mode.endswith(IMU)


def settings(run: Run, rig: Rig) -> str:
    """Write ORB-SLAM3's settings, YAML as OpenCV reads it.

    Raises:
        AdapterError: The images are too small for its pyramid.
    """
    factor, levels = float(run.parameter("scaleFactor")), int(run.parameter("nLevels"))
    smallest = [round(side / factor ** (levels - 1)) for side in rig.camera.size]
    if min(smallest) < SMALLEST_LEVEL:
        raise AdapterError(
            "images of {} by {} pixels are too small for nLevels {} with scaleFactor {:g}: the smallest "
            "level has {} by {} pixels, and ORB-SLAM3 needs {} by {}".format(
                *rig.camera.size, levels, factor, *smallest, SMALLEST_LEVEL, SMALLEST_LEVEL
            )
        )
    rate = run.sensor(cameras_of(run)[0]).rate or 30.0
    values: dict[str, Any] = {
        "File.version": '"1.0"',
        "Camera.type": '"PinHole"',
        "Camera.width": rig.camera.size[0],
        "Camera.height": rig.camera.size[1],
        "Camera.fps": max(1, round(rate)),
        "Camera.RGB": 1,
        "ORBextractor.nFeatures": run.parameter("nFeatures"),
        "ORBextractor.scaleFactor": factor,
        "ORBextractor.nLevels": levels,
        "ORBextractor.iniThFAST": run.parameter("iniThFAST"),
        "ORBextractor.minThFAST": run.parameter("minThFAST"),
        "loopClosing": int(run.parameter("loopClosing")),
    }
    # The viewer is never shown, but without these the settings are refused.
    viewer = ("KeyFrameSize", "KeyFrameLineWidth", "GraphLineWidth", "PointSize", "CameraSize")
    viewer += ("CameraLineWidth", "ViewpointX", "ViewpointY", "ViewpointZ", "ViewpointF", "imageViewScale")
    values |= {f"Viewer.{name}": 1.0 for name in viewer}
    values |= _intrinsics("Camera1", rig.camera) | dict(rig.settings)
    lines = [f"{name}: {_scalar(value)}" for name, value in values.items()]
    return "\n".join(["%YAML:1.0", "---", *lines]) + "\n"


def _intrinsics(name: str, camera: Pinhole) -> dict[str, float]:
    values = {"fx": camera.K[0, 0], "fy": camera.K[1, 1], "cx": camera.K[0, 2], "cy": camera.K[1, 2]}
    values |= dict(zip(("k1", "k2", "p1", "p2", "k3"), camera.distortion, strict=True))
    return {f"{name}.{key}": float(value) for key, value in values.items()}


def _scalar(value: Any) -> str:
    if isinstance(value, np.ndarray):
        # Single precision: ORB-SLAM3 reads the bytes as such, whatever their type is said to be.
        data = ", ".join(f"{number:.9f}" for number in value.reshape(-1))
        rows, columns = value.shape
        return f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: f\n   data: [{data}]"
    # A real number must have a point, or OpenCV reads an integer and ORB-SLAM3 refuses it.
    return f"{value:.12f}" if isinstance(value, float) else str(value)


def inertial_settings(run: Run, camera: Pinhole) -> dict[str, Any]:
    """Return the IMU's settings for ORB-SLAM3: noise as densities, and the first camera's pose in it."""
    imu = run.sensor("imu")
    names = {
        "NoiseGyro": "gyroscopeNoise",
        "NoiseAcc": "accelerometerNoise",
        "GyroWalk": "gyroscopeRandomWalk",
        "AccWalk": "accelerometerRandomWalk",
    }
    values: dict[str, Any] = {f"IMU.{name}": float(imu.detail(detail)) for name, detail in names.items()}
    if not imu.rate:
        raise AdapterError("config.yaml gives no rate for the sensor imu, which is needed")
    T_imu_camera = np.linalg.inv(imu.T_body_sensor) @ camera.T_body_camera
    return values | {"IMU.Frequency": float(imu.rate), "IMU.T_b_c1": T_imu_camera}


def _as_they_are(*images: np.ndarray) -> tuple[np.ndarray, ...]:
    return images


@dataclass(frozen=True)
class Rig:
    """Camera and settings of a mode, as ORB-SLAM3 gets them, and the method that takes its images.

    Attributes:
        camera: The first camera, as its images are handed over.
        sensor: ORB-SLAM3's name of the mode.
        method: ORB-SLAM3's method that takes the images.
        prepare: Turns the images of one time, as recorded, into its arguments.
        settings: What the mode adds to the settings.
        T_camera_frame: `(4, 4)`, pose of the frame that poses are given of in the camera that ORB-SLAM3
            tracks.
        T_saved_frame: `(4, 4)`, pose of that frame in the one that ORB-SLAM3 writes poses of at the end.
    """

    camera: Pinhole
    sensor: str
    method: str
    prepare: Callable[..., tuple[np.ndarray, ...]] = _as_they_are
    settings: Mapping[str, Any] = field(default_factory=dict)
    T_camera_frame: np.ndarray = field(default_factory=lambda: np.eye(4))
    T_saved_frame: np.ndarray = field(default_factory=lambda: np.eye(4))

    @classmethod
    def of(cls, run: Run, cameras: Mapping[str, Pinhole]) -> Rig:
        """Make the rig of the run's mode."""
        kind = run.mode.removesuffix(IMU)
        camera = original = cameras[cameras_of(run)[0]]
        prepare: Callable[..., tuple[np.ndarray, ...]] = _as_they_are
        more: dict[str, Any] = {}
        if kind != "mono":
            more["Stereo.ThDepth"] = float(run.parameter("thDepth"))
        if kind == "stereo":
            prepare = rectify = Rectification(original, cameras["right"])
            camera, T_left_right = rectify.camera, np.eye(4)
            T_left_right[0, 3] = rectify.baseline
            # Not as "Rectified", with which this package falls over while it prints its settings.
            more |= _intrinsics("Camera2", camera) | {"Stereo.T_c1_c2": T_left_right}
        elif kind == "rgbd":
            scale = float(run.sensor("depth").detail("depthScale"))
            prepare = undistort = Undistortion(original, cameras["depth"], scale)
            camera = undistort.camera
            more |= {"Stereo.b": float(run.parameter("virtualBaseline")), "RGBD.DepthMapFactor": scale}
        T_body_frame = original.T_body_camera
        if is_inertial(run):
            more |= inertial_settings(run, camera)
            T_body_frame = run.sensor("imu").T_body_sensor
        T_camera_frame = np.linalg.inv(camera.T_body_camera) @ T_body_frame
        T_saved_frame = np.eye(4) if is_inertial(run) else T_camera_frame
        sensor = {"mono": "MONOCULAR", "stereo": "STEREO", "rgbd": "RGBD"}[kind]
        method = {"mono": "track_monocular", "stereo": "track_stereo", "rgbd": "track_rgbd"}[kind]
        prefix = "IMU_" if is_inertial(run) else ""
        return cls(camera, prefix + sensor, method, prepare, more, T_camera_frame, T_saved_frame)


class Tracker:
    """ORB-SLAM3 at work on a run.

    Args:
        run: The run.
        rig: What its mode hands over.

    Attributes:
        stamps: Seconds that ORB-SLAM3 was given, and the stamps in ns that they are.
        online: Poses as they were tracked, with an IMU from its initialisation on.
        health: Its state after each frame, and how many points of the map it saw in it.
        watch: The time of each frame.
        tracked: Frames with a pose.
    """

    def __init__(self, run: Run, rig: Rig) -> None:
        self._run, self._rig = run, rig
        self._system = start(run, settings(run, rig), rig.sensor)
        self._process = getattr(self._system, rig.method)
        self._period = 1 / (run.sensor(cameras_of(run)[0]).rate or 30.0)
        self._origin: int | None = None
        self._inertial = is_inertial(run)
        self._threshold = int(run.parameter("minThFAST"))
        self._samples: list[Item] = []
        self._begun = False
        self.stamps: dict[float, int] = {}
        self.online = Trajectory()
        self.health = HealthLog()
        self.watch = Stopwatch()
        self.tracked = 0

    def track(self, images: list[Item], samples: Iterable[Item]) -> np.ndarray | None:
        """Hand over the images of one time.

        Args:
            images: One of each camera.
            samples: Those of the IMU since the images before.

        Returns:
            Pose of the declared frame `(4, 4)`, or None if there is none.
        """
        stamp = images[0].stamp
        if self._origin is None:
            # ORB-SLAM3 keeps times as float64 seconds, which are exact enough from the beginning on, and
            # takes none that are negative.
            self._origin = stamp - NANOSECONDS
        seconds = (stamp - self._origin) / NANOSECONDS
        self.stamps[seconds] = stamp
        self._samples.extend(samples)
        if self._inertial and np.ptp(images[0].data) <= self._threshold:
            # No corner can be in it, and with an IMU ORB-SLAM3 falls over a frame without one.
            self.watch.seconds.append(0.0)
            self.health.add(stamp, 0, "lost")
            return None
        inertial = {"imu": self._rows(seconds)} if self._inertial else {}
        with self.watch.frame():
            result = self._process(*self._rig.prepare(*(image.data for image in images)), seconds, **inertial)
        self._begun = True
        self.health.add(stamp, result.num_tracked_points, FLAGS.get(result.state.name, "lost"))
        # Of a frame that was just lost it has a pose too: a guess, unless the IMU gave it.
        valid = result.pose_valid if self._inertial else result.ok
        if not valid or result.pose_wc is None or not np.isfinite(result.pose_wc).all():
            return None
        self.tracked += 1
        # Before it knows gravity, scale and bias, its world is another one: turned, and of any scale.
        if self._inertial and not self._system.imu_initialized():
            return None
        pose = np.asarray(result.pose_wc, float) @ self._rig.T_camera_frame
        self.online.add(stamp, pose)
        return pose

    def _rows(self, seconds: float) -> np.ndarray:
        rows = [
            [
                (sample.stamp - (self._origin or 0)) / NANOSECONDS,
                *sample.data.gyroscope,
                *sample.data.accelerometer,
            ]
            for sample in self._samples
        ]
        self._samples.clear()
        table = np.array(rows, float).reshape(-1, 7)
        # Before the first image there is nothing to integrate from.
        return table if self._begun else table[table[:, 0] > seconds - self._period]

    def wait(self) -> None:
        """Wait for the map, no longer than until the next frame would come.

        ORB-SLAM3's own programs hand over no frame before its time, so that the map can take in the last
        keyframe. Here no frame waits longer than that, and none when there is nothing to do.
        """
        wait_until_quiet(self._period - self.watch.seconds[-1])

    def finish(self, limit_seconds: float) -> tuple[Trajectory, Trajectory]:
        """End ORB-SLAM3 and read what it has in its map.

        Args:
            limit_seconds: How long to wait for its threads.

        Returns:
            Frames and keyframes.
        """
        wait_until_quiet(limit_seconds)
        self._system.shutdown()
        paths = [self._run.output / f"orb-slam3.{name}.txt" for name in ("frames", "keyframes")]
        if self._has_keyframes():
            self._save(*paths)
        elif self.tracked:
            # An earlier map may hold what the present one lacks. If none does, ORB-SLAM3 falls over.
            in_child(lambda: self._save(*paths), limit_seconds)
        frames, keyframes = (self._read(path) for path in paths)
        return in_world_of(frames, keyframes), keyframes

    def _has_keyframes(self) -> bool:
        """Tell whether the present map has keyframes."""
        path = self._run.output / "orb-slam3.present.txt"
        self._system.save_keyframe_trajectory_tum(str(path))
        found = path.exists() and path.stat().st_size > 0
        path.unlink(missing_ok=True)
        return found

    def _save(self, frames: Path, keyframes: Path) -> None:
        """Have ORB-SLAM3 write the poses of its largest map."""
        self._system.save_trajectory_euroc(str(frames))
        self._system.save_keyframe_trajectory_euroc(str(keyframes))

    def _read(self, path: Path) -> Trajectory:
        """Read a file of ORB-SLAM3, whose ns are those of the seconds that it was given."""
        trajectory = Trajectory()
        seconds = np.array(sorted(self.stamps))
        for line in path.read_text(encoding="ascii").splitlines() if path.exists() else ():
            values = np.array(line.split(), float)
            nearest = seconds[np.argmin(np.abs(seconds - values[0] / NANOSECONDS))]
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation(values[4:]), values[1:4]
            trajectory.add(self.stamps[nearest], pose @ self._rig.T_saved_frame)
        path.unlink(missing_ok=True)
        return trajectory


def in_child(action: Callable[[], None], limit_seconds: float) -> None:
    """Do in a child process what may kill it; what it leaves behind is in files.

    Args:
        action: What to do.
        limit_seconds: When to kill it.
    """
    child = os.fork()
    if not child:
        try:
            action()
        finally:
            os._exit(0)
    deadline = time.monotonic() + limit_seconds
    while not os.waitpid(child, os.WNOHANG)[0]:
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return
        time.sleep(0.01)


def in_world_of(frames: Trajectory, keyframes: Trajectory) -> Trajectory:
    """Move frames into the world of the keyframes: ORB-SLAM3 writes them as seen from its first keyframe.

    With an IMU the difference matters: the z axis of the keyframes' world points up.
    """
    known = dict(zip(keyframes.stamps, keyframes.poses, strict=True))
    both = [at for at, stamp in enumerate(frames.stamps) if stamp in known]
    if both:
        T_world_first = known[frames.stamps[both[0]]] @ np.linalg.inv(frames.poses[both[0]])
        frames.poses = [T_world_first @ pose for pose in frames.poses]
    return frames


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """Turn a quaternion `x y z w` into a matrix `(3, 3)`."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + 2.0 * w * skew + 2.0 * skew @ skew)


def program(run: Run) -> None:
    """Track every frame."""
    roles = cameras_of(run)
    cameras = {role: Pinhole.of(run.sensor(role)) for role in roles}
    decoders: dict[str, Callable[[Any, Sensor], Any]] = dict.fromkeys(roles, decode_image)
    if is_inertial(run):
        decoders["imu"] = decode_imu
    recording = Recording(run, decoders)
    tracker = Tracker(run, Rig.of(run, cameras))
    for images, samples in frames(recording, roles, run.sensor(roles[0]).rate, inertial=is_inertial(run)):
        for image in images:
            check_image(image, cameras[image.role])
        tracker.track(images, samples)
        tracker.wait()
    stamps = tracker.stamps
    if not stamps:
        raise AdapterError(f"{recording.name} has no {' and '.join(roles)} images of the same time")
    trajectory, keyframes = tracker.finish(limit_seconds=30.0)
    tracker.online.write(run.output / "trajectory.online.txt")
    tracker.health.write(run.output / "health.csv")
    keyframes.write(run.output / "trajectory.keyframes.txt")
    numbers = {
        "framesLost": len(stamps) - len(trajectory.stamps),
        "keyframes": len(keyframes.stamps),
        "framesTracked": tracker.tracked,
    }
    dropped = recording.offered[roles[0]] - len(stamps)
    write_results(run, trajectory, tracker.watch, recording.cpu_seconds, dropped, **numbers)


def start(run: Run, text: str, sensor: str) -> Any:
    """Start ORB-SLAM3 with its settings and the run's vocabulary."""
    vocabulary = run.folder / "assets" / "vocabulary.txt"
    if not vocabulary.exists():
        raise AdapterError("assets/vocabulary.txt isn't in the run folder; ORB-SLAM3 needs its vocabulary")
    path = run.output / "settings.yaml"
    path.write_text(text, encoding="ascii")
    return pyorbslam3.Slam(vocabulary, path, getattr(pyorbslam3.Sensor, sensor), use_viewer=False)


def frames(
    recording: Recording, roles: list[str], rate: float | None, *, inertial: bool = False
) -> Iterator[tuple[list[Item], list[Item]]]:
    """Put together the images of one time; those without a partner are left out.

    Args:
        recording: What to read.
        roles: One camera, or two.
        rate: Of the first, in Hz; images half a period or more apart are no pair.
        inertial: Whether the recording has samples of an IMU, which may come late in it.

    Yields:
        Images, in the order of the roles, and the inertial samples since the images before.

    Raises:
        AdapterError: The samples end long before the images.
    """
    ready: deque[list[Item]] = deque()
    samples: deque[Item] = deque()
    pairs, last = Pairs(roles, rate), None
    for item in recording.items():
        if item.role == "imu":
            samples.append(item)
            last = item.stamp
        else:
            ready.extend(pairs.take(item))
        while ready and (not inertial or (last is not None and last >= ready[0][0].stamp)):
            images = ready.popleft()
            yield images, _until(samples, images[0].stamp)
        if inertial and len(ready) > WAITING_FRAMES:
            if last is None:
                raise AdapterError("the sensor imu has no samples near the first images")
            gap = (ready[0][0].stamp - last) / NANOSECONDS
            raise AdapterError(f"the samples of the sensor imu end {gap:.1f} s before an image")
    for images in ready:
        yield images, _until(samples, images[0].stamp)


def _until(samples: deque[Item], stamp: int) -> list[Item]:
    taken = []
    while samples and samples[0].stamp <= stamp:
        taken.append(samples.popleft())
    return taken


class Pairs:
    """Images of one camera, or of two at the same time.

    Args:
        roles: One camera, or two.
        rate: Of the first, in Hz; images half a period or more apart are no pair.
    """

    def __init__(self, roles: list[str], rate: float | None) -> None:
        self._roles = roles
        self._limit = NANOSECONDS / (rate or 30.0) / 2
        self._waiting: dict[str, list[Item]] = {role: [] for role in roles}

    def take(self, item: Item) -> Iterator[list[Item]]:
        """Take an image, and give what it completes."""
        self._waiting[item.role].append(item)
        while all(self._waiting.values()):
            heads = [self._waiting[role][0] for role in self._roles]
            apart = heads[0].stamp - heads[-1].stamp
            if abs(apart) < self._limit:
                yield heads
            keep = {self._roles[0]: apart >= self._limit, self._roles[-1]: apart <= -self._limit}
            for role in self._roles:
                if not keep[role]:
                    self._waiting[role].pop(0)


def check_image(item: Item, camera: Pinhole) -> None:
    """Refuse images of which ORB-SLAM3 would make nonsense: of another size, or with more than 8 bits."""
    height, width = item.data.shape[:2]
    if (width, height) != camera.size:
        found = f"the images of {item.role} are {width} by {height} pixels"
        raise AdapterError("{}; config.yaml says {} by {}".format(found, *camera.size))
    if item.role != "depth" and item.data.dtype != np.uint8:
        raise AdapterError(f"the images of {item.role} must have 8 bits; these are {item.data.dtype}")


def wait_until_quiet(limit_seconds: float, interval_seconds: float = 0.005) -> None:
    """Wait for the threads that map and close loops, which have no way to be asked.

    Args:
        limit_seconds: Longest wait.
        interval_seconds: They are taken to be done when the process has been idle for two such intervals.
            They look for work every 3 to 5 ms, which takes next to nothing.
    """
    deadline = time.monotonic() + limit_seconds
    quiet = 0
    while quiet < 2 and time.monotonic() < deadline:
        before = time.process_time()
        time.sleep(interval_seconds)
        quiet = quiet + 1 if time.process_time() - before < 0.2 * interval_seconds else 0


if __name__ == "__main__":
    run_adapter(program)
    # The libraries it links to may fall over each other in their destructors.
    os._exit(0)
