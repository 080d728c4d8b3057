# SPDX-License-Identifier: Apache-2.0
"""Support for adapters: reads the run folder, writes trajectory and metrics. Every adapter imports it.

An adapter is a small program that runs one algorithm on the run folder `$SLAMHIVE_RUN`. It is the same
program in a pod, a container and a local process and imports nothing of slamhive, so that this file, the
standard library, numpy, PyYAML and rosbags are all there is. Times are integer nanoseconds of sensor time
throughout: a float64 resolves a Unix time to 0.24 µs only.

`adapter_recording` beside this file reads and decodes the recording.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

NANOSECONDS = 1_000_000_000


class _Loader(yaml.SafeLoader):
    """Reads 5e-6 as the number that it is in JSON and to Kubernetes; PyYAML takes it for a text."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


class AdapterError(Exception):
    """Something the user can mend; its text is the one sentence that the run ends with."""


def run_adapter(program: Callable[[Run], None]) -> None:
    """Run an adapter's program, ending the process with a sentence and status 1 if it fails.

    The sentence comes last also where both streams go into one log, as in a pod: before `sys.exit` prints it,
    Python has printed what it and C held back of stdout.

    Args:
        program: Takes the run and writes its outputs.
    """
    try:
        program(Run.from_environment())
    except AdapterError as error:
        sys.exit(f"{error}")
    except MemoryError:
        sys.exit("the algorithm asked for more memory than there is")
    except Exception as error:  # noqa: BLE001 - whatever an algorithm raises ends in a sentence
        traceback.print_exc()
        sys.exit(f"the algorithm failed: {' '.join(str(error).split()) or type(error).__name__}")


@dataclass(frozen=True)
class Sensor:
    """A sensor of the unified configuration.

    Attributes:
        role: What the mode calls it: lidar, imu, camera, left, right, color, depth.
        topic: Its topic in the recording.
        stamp: What a header stamp means: Sample, Exposure, ScanStart, ScanMid, ScanEnd.
        offset: Nanoseconds to add to a header stamp to get sensor time.
        rate: Messages per second after preparation, None if unknown.
        T_body_sensor: `(4, 4)`, pose of the sensor in the body frame.
        details: The block of its type (`lidar`, `imu` or `camera`).
    """

    role: str
    topic: str
    stamp: str
    offset: int
    rate: float | None
    T_body_sensor: np.ndarray
    details: Mapping[str, Any]

    def detail(self, key: str) -> Any:
        """Look up a calibration value that the algorithm can't do without.

        Raises:
            AdapterError: The configuration doesn't give it.
        """
        value = self.details.get(key)
        if value is None:
            raise AdapterError(f"config.yaml gives no {key} for the sensor {self.role}, which is needed")
        return value


@dataclass(frozen=True)
class Run:
    """The run folder and its unified configuration.

    Attributes:
        folder: `$SLAMHIVE_RUN`.
        config: config.yaml as it is.
        sensors: By role.
    """

    folder: Path
    config: Mapping[str, Any]
    sensors: Mapping[str, Sensor]

    @classmethod
    def from_environment(cls) -> Run:
        """Read `$SLAMHIVE_RUN/config.yaml`.

        Raises:
            AdapterError: No run folder, or no readable configuration in it.
        """
        folder = os.environ.get("SLAMHIVE_RUN")
        if not folder:
            raise AdapterError("SLAMHIVE_RUN isn't set: it names the run folder that holds config.yaml")
        return cls.from_folder(Path(folder))

    @classmethod
    def from_folder(cls, folder: Path) -> Run:
        """Read a run folder.

        Raises:
            AdapterError: No readable configuration in it.
        """
        path = folder / "config.yaml"
        try:
            config = yaml.load(path.read_bytes(), _Loader)  # noqa: S506 - it is a SafeLoader
        except (OSError, yaml.YAMLError) as error:
            raise AdapterError(f"{path} can't be read: {' '.join(str(error).split())}") from None
        if not isinstance(config, dict) or config.get("kind") != "RunConfiguration":
            raise AdapterError(f"{path} isn't a RunConfiguration")
        sensors = {role: _sensor(role, spec) for role, spec in (config.get("sensors") or {}).items()}
        return cls(folder, config, sensors)

    @property
    def mode(self) -> str:
        """The sensor mode, as in `stereo`."""
        return str(self.config["mode"])

    @property
    def cores(self) -> int:
        """Processors that the run is pinned to."""
        return int(self.config.get("cores") or 1)

    @property
    def output(self) -> Path:
        """The folder for results, made if it isn't there."""
        path = self.folder / "output"
        path.mkdir(exist_ok=True)
        return path

    @property
    def gravity_magnitude(self) -> float:
        """Gravity in m/s², from the IMU's calibration."""
        return float(self.sensor("imu").details.get("gravity") or 9.81)

    def parameter(self, name: str) -> Any:
        """Look up a parameter of the algorithm.

        Raises:
            AdapterError: The configuration lacks it.
        """
        try:
            return self.config["parameters"][name]
        except (KeyError, TypeError):
            raise AdapterError(f"config.yaml has no parameter {name}, which the adapter needs") from None

    def sensor(self, role: str) -> Sensor:
        """Look up a sensor.

        Raises:
            AdapterError: The configuration has none of this role.
        """
        if role not in self.sensors:
            known = ", ".join(self.sensors) or "none"
            raise AdapterError(f"the mode {self.mode} needs a sensor {role}; config.yaml has {known}")
        return self.sensors[role]

    def recording(self) -> tuple[str, Path]:
        """The prepared recording: what to call it in messages, and where it is.

        Raises:
            AdapterError: The configuration names none, or it isn't there.
        """
        try:
            name = str(self.config["dataset"]["recording"]["path"])
        except (KeyError, TypeError):
            raise AdapterError("config.yaml names no recording (dataset.recording.path)") from None
        if not (self.folder / name).exists():
            raise AdapterError(f"the recording {name} isn't in the run folder")
        return name, self.folder / name


def _sensor(role: str, spec: Mapping[str, Any]) -> Sensor:
    details = next((spec[key] for key in ("lidar", "imu", "camera") if spec.get(key)), {})
    pose = np.asarray(spec.get("T_body_sensor") or np.eye(4), float)
    if pose.shape != (4, 4):
        raise AdapterError(f"T_body_sensor of the sensor {role} isn't a 4 by 4 matrix")
    return Sensor(
        role=role,
        topic=str(spec["topic"]),
        stamp=str(spec.get("stamp") or "Sample"),
        offset=round(float(spec.get("timeOffset") or 0.0) * NANOSECONDS),
        rate=spec.get("rate"),
        T_body_sensor=pose,
        details=details,
    )


@dataclass
class Trajectory:
    """Poses in the order they came.

    Attributes:
        stamps: Sensor time, ns.
        poses: `(4, 4)` each, pose of the declared frame in the algorithm's world.
        lost: Poses left out because they weren't finite.
    """

    stamps: list[int] = field(default_factory=list)
    poses: list[np.ndarray] = field(default_factory=list)
    lost: int = 0

    def add(self, stamp: int, pose: np.ndarray) -> None:
        """Append a pose, unless the algorithm has lost itself in NaN."""
        if not np.isfinite(pose).all():
            self.lost += 1
            return
        self.stamps.append(stamp)
        self.poses.append(np.array(pose, float))

    def write(self, path: Path) -> None:
        """Write the TUM format, `timestamp tx ty tz qx qy qz qw`, complete or not at all.

        Without a pose it is a comment: that says that the algorithm ran to its end and is lost.

        Args:
            path: The file.
        """
        if not self.stamps:
            write_atomically(path, "# the algorithm gave no pose\n")
            return
        poses = np.stack(self.poses)
        order = np.argsort(self.stamps, kind="stable")
        rows = np.column_stack([poses[:, :3, 3], quaternions(poses[:, :3, :3])])
        lines = []
        for index in order:
            seconds, nanoseconds = divmod(self.stamps[index], NANOSECONDS)
            numbers = " ".join(f"{value:.9f}" for value in rows[index])
            lines.append(f"{seconds}.{nanoseconds:09d} {numbers}\n")
        write_atomically(path, "".join(lines))


@dataclass
class HealthLog:
    """Rows of output/health.csv, in which the algorithm speaks of itself.

    Attributes:
        rows: Sensor time in ns, its confidence (larger is more) if it has one, and ok, degraded, lost or
            nothing.
    """

    rows: list[tuple[int, float | None, str]] = field(default_factory=list)

    def add(self, stamp: int, value: float | None = None, flag: str = "") -> None:
        """Append what it says at a time; a value that isn't finite says nothing."""
        self.rows.append((stamp, value if value is not None and np.isfinite(value) else None, flag))

    def write(self, path: Path) -> None:
        """Write the file, complete or not at all; none where it said nothing."""
        if not self.rows:
            return
        lines = ["stamp,value,flag\n"]
        for stamp, value, flag in sorted(self.rows, key=lambda row: row[0]):
            seconds, nanoseconds = divmod(stamp, NANOSECONDS)
            lines.append(f"{seconds}.{nanoseconds:09d},{'' if value is None else f'{value:.9g}'},{flag}\n")
        write_atomically(path, "".join(lines))


def quaternions(R: np.ndarray) -> np.ndarray:
    """Unit quaternions of rotation matrices.

    The quaternion is the eigenvector of the largest eigenvalue of a symmetric matrix (Bar-Itzhack, "New
    method for extracting the quaternion from a rotation matrix", 2000), which has no special cases and
    takes matrices that are slightly off a rotation.

    Args:
        R: `(n, 3, 3)`.

    Returns:
        `(n, 4)`, `x y z w` with w not negative.
    """
    xx, yy, zz = R[:, 0, 0], R[:, 1, 1], R[:, 2, 2]
    K = np.empty((len(R), 4, 4))
    K[:, 0, 0], K[:, 1, 1], K[:, 2, 2], K[:, 3, 3] = xx - yy - zz, yy - xx - zz, zz - xx - yy, xx + yy + zz
    K[:, 0, 1] = K[:, 1, 0] = R[:, 0, 1] + R[:, 1, 0]
    K[:, 0, 2] = K[:, 2, 0] = R[:, 0, 2] + R[:, 2, 0]
    K[:, 1, 2] = K[:, 2, 1] = R[:, 1, 2] + R[:, 2, 1]
    K[:, 0, 3] = K[:, 3, 0] = R[:, 2, 1] - R[:, 1, 2]
    K[:, 1, 3] = K[:, 3, 1] = R[:, 0, 2] - R[:, 2, 0]
    K[:, 2, 3] = K[:, 3, 2] = R[:, 1, 0] - R[:, 0, 1]
    q = np.linalg.eigh(K)[1][:, :, -1]
    return np.where(q[:, 3:] < 0, -q, q)


def write_atomically(path: Path, text: str) -> None:
    """Write a file so that no reader ever sees half of it."""
    temporary = path.with_name(f".{path.name}.part")
    temporary.write_text(text, encoding="ascii")
    temporary.replace(path)


class Stopwatch:
    """Wall time of the algorithm, frame by frame."""

    def __init__(self) -> None:
        self.seconds: list[float] = []

    @contextlib.contextmanager
    def frame(self) -> Iterator[None]:
        """Time one frame."""
        start = time.perf_counter()
        yield
        self.seconds.append(time.perf_counter() - start)


def write_results(
    run: Run, trajectory: Trajectory, watch: Stopwatch, reader_seconds: float, dropped: int = 0, **extra: Any
) -> None:
    """Write output/trajectory.txt and output/metrics.json.

    Args:
        run: The run.
        trajectory: The final estimate.
        watch: One time per processed frame.
        reader_seconds: Processor time that went into reading and decoding.
        dropped: Frames that were read but not given to the algorithm.
        extra: The algorithm's own numbers.

    Raises:
        AdapterError: No frame was processed: then nothing can be said of the algorithm.
    """
    frames = len(watch.seconds)
    if not frames:
        raise AdapterError(f"no frame was given to the algorithm; {dropped} were empty or refused")
    metrics: dict[str, Any] = {
        "framesOffered": frames + dropped,
        "framesProcessed": frames,
        "framesDropped": dropped,
        "framesLost": trajectory.lost,
        "readerCpuSeconds": round(reader_seconds, 6),
    }
    if frames:
        mean, maximum = sum(watch.seconds) / frames, max(watch.seconds)
        metrics["timePerFrame"] = {"mean": round(mean, 6), "max": round(maximum, 6)}
    write_atomically(run.output / "metrics.json", json.dumps(metrics | extra, indent=1) + "\n")
    trajectory.write(run.output / "trajectory.txt")
