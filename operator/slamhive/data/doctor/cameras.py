# SPDX-License-Identifier: Apache-2.0
"""Judgement of cameras: their calibration, and what lies between the two of a pair."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.recordings.posetopics import relative_pose, static_tree
from slamhive.data.recordings.streams import camera_info_topic
from slamhive.model.sensors import Role, SensorType

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.data.doctor.examined import Examined
    from slamhive.data.recordings.reading import Recording
    from slamhive.model.sensors import Camera, Sensor

APART = 0.003
"""Seconds between the images of a pair above which VINS-Fusion leaves both out (its node's limit)."""
_NOTED = 0.0005
_STEADY = 0.001
"""Spread of a pair's offset, s, below which it is one of stamps rather than of exposures."""
_COEFFICIENTS = 5


def judge_cameras(examined: Examined) -> Iterator[Finding]:
    """Yield the findings of the cameras of a recording, and between them."""
    sensors = examined.entry.dataset.spec.sensors
    for name in examined.watched.watchers:
        if sensors[name].type in {SensorType.CAMERA, SensorType.DEPTH_CAMERA}:
            yield from calibration_findings(examined.recording, name, sensors[name])
    yield from _stereo(examined)
    yield from _registered(examined)


def calibration_findings(recording: Recording, name: str, sensor: Sensor) -> Iterator[Finding]:
    """Yield the intrinsics of a camera that can't be right, or aren't those of its ``camera_info``.

    Args:
        recording: The recording, with the sensor's topic in it.
        name: The sensor's name.
        sensor: A camera or depth camera.
    """
    camera, info = sensor.camera, camera_info_topic(recording, sensor.topic)
    message, stated = recording.first(sensor.topic), recording.first(info) if info else None
    if camera is None:
        zero = (
            f"; {info} is uncalibrated (K is 0)"
            if stated is not None and not np.any(_lens(stated)[0])
            else ""
        )
        yield _warning(name, f": no intrinsics are given, which most algorithms need{zero}")
        return
    encoding = getattr(message, "encoding", camera.encoding)
    if encoding != camera.encoding and sensor.type is SensorType.CAMERA:
        said = f".encoding: states {camera.encoding}, but the images on {sensor.topic} are {encoding}"
        yield replace(_warning(name, said), code="images.encoding")
    if not (0 <= camera.cx < camera.width and 0 <= camera.cy < camera.height):
        yield _warning(
            name,
            f": the principal point ({camera.cx:g}, {camera.cy:g}) lies outside of the image of "
            f"{camera.width}×{camera.height}",
        )
    if camera.distortion == "RadialTangential" and len(camera.coefficients) > _COEFFICIENTS:
        used = len(np.trim_zeros(np.array(camera.coefficients), "b"))
        rest = "leave out the zeros at their end" if used <= _COEFFICIENTS else "calibrate with as many"
        yield _warning(
            name,
            f".coefficients: {len(camera.coefficients)} are given, of which {used} count; ORB-SLAM3's "
            f"adapter takes {_COEFFICIENTS} at most and its runs fail: {rest}",
        )
    if stated is not None:
        size = getattr(message, "width", camera.width), getattr(message, "height", camera.height)
        yield from _against_info(name, camera, size, stated, str(info))


def _against_info(
    name: str, camera: Camera, size: tuple[int, int], stated: Any, info: str
) -> Iterator[Finding]:
    """Yield the values of a CameraInfo that the manifest of images of a size (width, height) contradicts."""
    k, d = _lens(stated)
    if np.any(d[8:]):
        rest = len(d) - 8
        yield _warning(
            name, f": {info} states {len(d)} coefficients, the last {rest} of which have no place here"
        )
    if stated.width and stated.binning_x < 2 and (stated.width, stated.height) != size:
        yield _warning(
            name,
            f": {info} is for {stated.width}×{stated.height} pixels, but the images have "
            f"{size[0]}×{size[1]}: intrinsics of another size turn directions into others",
        )
    if not np.any(k):
        said = (
            f": {info} is uncalibrated (K is 0); algorithms get the manifest's, nodes that read it get zeros"
        )
        yield replace(_warning(name, said), severity=Severity.NOTE)
        return
    given, found = (camera.fx, camera.fy, camera.cx, camera.cy), (k[0], k[4], k[2], k[5])
    if not np.allclose(given, found, rtol=0.005, atol=0.5):
        texts = [", ".join(f"{number:g}" for number in numbers) for numbers in (given, found)]
        yield _warning(name, f": fx, fy, cx, cy are {texts[0]}, but {info} says {texts[1]}")


def _lens(stated: Any) -> tuple[Any, Any]:
    """Return K and D of a CameraInfo of either ROS."""
    return (stated.K, stated.D) if hasattr(stated, "K") else (stated.k, stated.d)


def _warning(name: str, said: str) -> Finding:
    return Finding("camera.intrinsics", Severity.WARNING, f"sensors.{name}.camera{said}", name)


def _stereo(examined: Examined) -> Iterator[Finding]:
    """Yield the shift between the stamps of a pair's images, where there is one."""
    sensors, scans = examined.entry.dataset.spec.sensors, examined.watched.scans
    pair = [sensors[name] for name in (Role.LEFT, Role.RIGHT) if name in sensors]
    if len(pair) < 2 or any(sensor.topic not in scans for sensor in pair):
        return
    left, right = (np.sort(scans[sensor.topic].stamps) / 1e9 + sensor.time_offset for sensor in pair)
    if len(left) < 2 or len(right) < 2:
        return
    at = np.clip(np.searchsorted(right, left), 1, len(right) - 1)
    later, earlier = right[at] - left, right[at - 1] - left
    shifts = np.where(np.abs(later) < np.abs(earlier), later, earlier)
    shifts = shifts[np.abs(shifts) < np.median(np.diff(left)) / 2]
    if not shifts.size:
        return
    median, largest = float(np.median(shifts)), float(np.abs(shifts).max())
    wide = int((np.abs(shifts) > APART).sum())
    if not wide and abs(median) < _NOTED:
        return
    is_steady = float(np.ptp(np.percentile(shifts, [5, 95]))) < _STEADY
    helps = "let both be stamped by their trigger"
    if is_steady:
        helps = f"if both are exposed at once, add {-median:.4f} s to the right one's stamps"
    yield Finding(
        "stereo.offset",
        Severity.WARNING if wide else Severity.NOTE,
        f"sensors.right: its images are stamped {1e3 * abs(median):.2f} ms "
        f"{'after' if median > 0 else 'before'} the left ones typically, {1e3 * largest:.2f} ms apart at "
        f"most; VINS-Fusion drops images more than {1e3 * APART:g} ms apart, here {wide} of {len(shifts)} "
        f"pairs, and others take both for one instant: {helps}",
        Role.RIGHT,
        wide or len(shifts),
        value=1e3 * median,
        unit="ms",
        repair=sensor_repair(Role.RIGHT, shift=round(-median, 6)) if is_steady and wide else {},
    )


def _registered(examined: Examined) -> Iterator[Finding]:
    """Yield the signs that depth isn't that of the colour camera's pixels."""
    spec, recording = examined.entry.dataset.spec, examined.recording
    color, depth = spec.sensors.get("color"), spec.sensors.get("depth")
    if color is None or depth is None or not {color.topic, depth.topic} <= set(examined.watched.scans):
        return
    frames = [str(recording.first(one.topic).header.frame_id).lstrip("/") for one in (color, depth)]
    said: list[str] = []
    lenses = color.camera, depth.camera
    if lenses[0] is not None and lenses[1] is not None:
        sizes = [f"{lens.width}×{lens.height}" for lens in lenses if lens is not None]
        if sizes[0] != sizes[1]:
            said.append(f"its images have {sizes[1]} pixels, those of color {sizes[0]}")
    stated = relative_pose(static_tree(recording), *frames) if frames[0] != frames[1] else np.eye(4)
    declared = np.linalg.inv(np.array(color.T_body_sensor)) @ np.array(depth.T_body_sensor)
    if not np.allclose(declared, np.eye(4), atol=1e-6):
        away = f", {100 * np.linalg.norm(declared[:3, 3]):.1f} cm away" if declared[:3, 3].any() else ""
        said.append(f"it is a camera of its own{away}, by T_body_sensor")
    elif stated is None:
        said.append(
            f"its images are of the frame {frames[1]!r}, those of color of {frames[0]!r}; T_body_sensor "
            "states the same place for both, and no /tf_static says so"
        )
    if said:
        yield Finding(
            "depth.registered",
            Severity.WARNING,
            f"sensors.depth: not registered to color: {'; '.join(said)}. ORB-SLAM3's adapter moves it into "
            "the colour camera's pixels by T_body_sensor and camera, which leaves holes; other programs take "
            "it for each colour pixel's depth and get lost. Record aligned depth (aligned_depth_to_color, "
            "depth_registered)",
            "depth",
        )
