# SPDX-License-Identifier: Apache-2.0
"""Adapter of ORB-SLAM3 for a camera, a stereo pair or an RGB-D camera.

It is GPL-3.0 and is only ever run in an environment or image of its own, by this program.

Its trajectory is read when the recording is at its end, after loop closure. It holds all tracked frames but
those whose reference keyframe was culled since. Stereo images are rectified here, which turns the left
camera, and the poses are turned back.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import orbslam3
from adapter_recording import Recording, decode_image
from adapter_support import NANOSECONDS, AdapterError, Run, Stopwatch, Trajectory, run_adapter, write_results
from cameras import Pinhole, Rectification, Undistortion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from adapter_recording import Item

ROLES = {"mono": ["camera"], "stereo": ["left", "right"], "rgbd": ["color", "depth"]}


def settings(run: Run, rig: Rig) -> str:
    """Write ORB-SLAM3's settings, YAML as OpenCV reads it."""
    camera = rig.camera
    rate = run.sensor(ROLES[run.mode][0]).rate or 30.0
    values: dict[str, Any] = {
        "File.version": '"1.0"',
        "Camera.type": '"PinHole"',
        "Camera1.fx": camera.K[0, 0],
        "Camera1.fy": camera.K[1, 1],
        "Camera1.cx": camera.K[0, 2],
        "Camera1.cy": camera.K[1, 2],
        "Camera.width": camera.size[0],
        "Camera.height": camera.size[1],
        "Camera.fps": max(1, round(rate)),
        "Camera.RGB": 1,
        "ORBextractor.nFeatures": run.parameter("nFeatures"),
        "ORBextractor.scaleFactor": float(run.parameter("scaleFactor")),
        "ORBextractor.nLevels": run.parameter("nLevels"),
        "ORBextractor.iniThFAST": run.parameter("iniThFAST"),
        "ORBextractor.minThFAST": run.parameter("minThFAST"),
        "loopClosing": int(run.parameter("loopClosing")),
    }
    names = ("k1", "k2", "p1", "p2", "k3")
    if camera.distortion.any():
        values |= {f"Camera1.{name}": value for name, value in zip(names, camera.distortion, strict=True)}
    # The viewer is never shown, but without these the settings are refused.
    viewer = ("KeyFrameSize", "KeyFrameLineWidth", "GraphLineWidth", "PointSize", "CameraSize")
    viewer += ("CameraLineWidth", "ViewpointX", "ViewpointY", "ViewpointZ", "ViewpointF", "imageViewScale")
    values |= {f"Viewer.{name}": 1.0 for name in viewer}
    lines = [f"{name}: {_scalar(value)}" for name, value in (values | dict(rig.settings)).items()]
    return "\n".join(["%YAML:1.0", "---", *lines]) + "\n"


def _scalar(value: Any) -> str:
    # A real number must have a point, or OpenCV reads an integer and ORB-SLAM3 refuses it.
    return f"{value:.12f}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class Rig:
    """What a mode hands to ORB-SLAM3, and how.

    Attributes:
        camera: The first camera, as its images are handed over.
        method: ORB-SLAM3's method that takes them.
        prepare: Turns the images of one time, as recorded, into its arguments.
        settings: What the mode adds to the settings.
        T_frame_camera: `(4, 4)`, pose of that camera in the frame that poses are given of.
    """

    camera: Pinhole
    method: str
    prepare: Callable[..., tuple[np.ndarray, ...]] = lambda *images: images
    settings: Mapping[str, Any] = field(default_factory=dict)
    T_frame_camera: np.ndarray = field(default_factory=lambda: np.eye(4))

    @classmethod
    def of(cls, run: Run, cameras: Mapping[str, Pinhole]) -> Rig:
        """Make the rig of the run's mode."""
        if run.mode == "mono":
            return cls(cameras["camera"], "process_image_mono")
        close = {"Stereo.ThDepth": float(run.parameter("thDepth"))}
        if run.mode == "stereo":
            rectify = Rectification(cameras["left"], cameras["right"])
            camera = replace(cameras["left"], K=rectify.K, distortion=np.zeros(5))
            more = {"Camera.type": '"Rectified"', "Stereo.b": float(rectify.baseline)}
            return cls(camera, "process_image_stereo", rectify, close | more, rectify.T_left_rectified)
        scale = float(run.sensor("depth").detail("depthScale"))
        undistort = Undistortion(cameras["color"], cameras["depth"], scale)
        more = {"Stereo.b": float(run.parameter("virtualBaseline")), "RGBD.DepthMapFactor": scale}
        return cls(undistort.camera, "process_image_rgbd", undistort, close | more)


def program(run: Run) -> None:
    """Track every frame."""
    roles = ROLES.get(run.mode)
    if roles is None:
        raise AdapterError(f"the mode {run.mode} isn't known; this adapter has {', '.join(ROLES)}")
    cameras = {role: Pinhole.of(run.sensor(role)) for role in roles}
    recording = Recording(run, dict.fromkeys(roles, decode_image))
    rig = Rig.of(run, cameras)
    system = start(run, settings(run, rig))
    process = getattr(system, rig.method)
    period = 1 / (run.sensor(roles[0]).rate or 30.0)
    watch = Stopwatch()
    stamps: dict[float, int] = {}
    for items in frames(recording, roles, run.sensor(roles[0]).rate):
        for item in items:
            check_image(item, cameras[item.role])
        # ORB-SLAM3 keeps times as float64 seconds, which are exact enough from the beginning on.
        origin = next(iter(stamps.values()), items[0].stamp)
        seconds = (items[0].stamp - origin) / NANOSECONDS
        stamps[seconds] = items[0].stamp
        with watch.frame():
            process(*rig.prepare(*(item.data for item in items)), seconds)
        # ORB-SLAM3's own programs hand over no frame before its time, so that the map can take in the last
        # keyframe. Here no frame waits longer than that, and none when there is nothing to do.
        wait_until_quiet(period - watch.seconds[-1])
    if not stamps:
        raise AdapterError(f"{recording.name} has no {' and '.join(roles)} images of the same time")
    wait_until_quiet(limit_seconds=30.0)
    trajectory = Trajectory()
    T_camera_frame = np.linalg.inv(rig.T_frame_camera)
    for seconds, T_camera_world in system.get_trajectory_points():
        trajectory.add(stamps[seconds], np.linalg.inv(T_camera_world) @ T_camera_frame)
    numbers = {
        "framesLost": len(stamps) - len(trajectory.stamps),
        "keyframes": len(system.get_keyframe_points()),
    }
    dropped = recording.offered[roles[0]] - len(stamps)
    write_results(run, trajectory, watch, recording.cpu_seconds, dropped, **numbers)
    system.shutdown()


def start(run: Run, text: str) -> Any:
    """Start ORB-SLAM3 with its settings and the run's vocabulary."""
    vocabulary = run.folder / "assets" / "vocabulary.txt"
    if not vocabulary.exists():
        raise AdapterError("assets/vocabulary.txt isn't in the run folder; ORB-SLAM3 needs its vocabulary")
    path = run.output / "settings.yaml"
    path.write_text(text, encoding="ascii")
    sensor = {"mono": "MONOCULAR", "stereo": "STEREO", "rgbd": "RGBD"}[run.mode]
    system = orbslam3.System(str(vocabulary), str(path), getattr(orbslam3.Sensor, sensor))
    system.set_use_viewer(False)
    if not system.initialize():
        raise AdapterError("ORB-SLAM3 didn't start; the lines above say why")
    return system


def frames(recording: Recording, roles: list[str], rate: float | None) -> Iterator[list[Item]]:
    """Put together the images of one time; those without a partner are left out.

    Args:
        recording: What to read.
        roles: One camera, or two.
        rate: Of the first, in Hz; images half a period or more apart are no pair.
    """
    if len(roles) == 1:
        for item in recording.items():
            yield [item]
        return
    limit = NANOSECONDS / (rate or 30.0) / 2
    waiting: dict[str, list[Item]] = {role: [] for role in roles}
    for item in recording.items():
        waiting[item.role].append(item)
        while all(waiting.values()):
            pair = [waiting[role][0] for role in roles]
            apart = pair[0].stamp - pair[1].stamp
            if abs(apart) < limit:
                yield pair
            for role, behind in zip(roles, (apart < limit, apart > -limit), strict=True):
                if behind:
                    waiting[role].pop(0)


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
