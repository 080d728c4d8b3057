# SPDX-License-Identifier: Apache-2.0
"""Results of the original SLAM Hive (ICRA 2023): one folder a run, read as finished runs.

::

    DIR/052/config.yaml     algorithm, dataset, their parameters and topics; or the only *.yaml, such as
                            16_ORB2_stereo_EuRoC.yaml, as the original named it
    DIR/052/traj.txt        estimate, TUM format
    DIR/052/profiling.csv   time [s], cpu_usage [cores], memory_usage [bytes], a line each 1 to 2 s

Its CPU and memory hold the player, the ROS master and the idle time before and after; memory counts
page cache. Its programs were played to in real time.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from slamhive.data.store.truthfolders import catalog_name
from slamhive.model.canonical import digest
from slamhive.model.errors import DataError, InputError
from slamhive.model.loading import Document, parse, read_text
from slamhive.model.results import (
    IMPORTED,
    CpuUsage,
    MemoryKind,
    MemoryUsage,
    Phase,
    Provenance,
    RunRecord,
    Usage,
)
from slamhive.model.sensors import SensorMode
from slamhive_eval import read_trajectory

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from slamhive_eval import Trajectory

SOURCE = IMPORTED
"""Name of the sweep that imported runs belong to, and value of their label ``source``."""

LONGEST_STEP = 5.0
"""Samples further apart than this, in s, have a hole between them."""

_CONFIG, _TRAJECTORY, _PROFILE = "config.yaml", "traj.txt", "profiling.csv"
_COLUMNS = ["time", "cpu_usage", "memory_usage"]
_ENDINGS = {
    "stereo-inertial": SensorMode.STEREO_INERTIAL,
    "mono-inertial": SensorMode.MONO_INERTIAL,
    "lidar-inertial": SensorMode.LIDAR_INERTIAL,
    "stereo": SensorMode.STEREO,
    "mono": SensorMode.MONO,
    "rgbd": SensorMode.RGBD,
    "lidar": SensorMode.LIDAR,
}
_WHOLE_NAMES = {
    "vins-mono": SensorMode.MONO_INERTIAL,
    "dso": SensorMode.MONO,
    "lio-sam": SensorMode.LIDAR_INERTIAL,
    **dict.fromkeys(("loam", "a-loam", "lego-loam", "ndt-loam"), SensorMode.LIDAR),
}
_INERTIAL = {
    SensorMode.MONO: SensorMode.MONO_INERTIAL,
    SensorMode.STEREO: SensorMode.STEREO_INERTIAL,
    SensorMode.LIDAR: SensorMode.LIDAR_INERTIAL,
}
_TOPICS = (
    (("stereo_left", "image1_topic"), SensorMode.STEREO),
    (("dep_topic", "depth_topic"), SensorMode.RGBD),
    (("mono_topic", "image_topic", "image0_topic"), SensorMode.MONO),
    (("lidar_topic", "points_topic", "pointCloudTopic"), SensorMode.LIDAR),
)


@dataclass(frozen=True)
class OriginalRun:
    """A run as the original system left it.

    Attributes:
        folder: its folder.
        number: the folder's name, without leading zeros if it is a number.
        algorithm_name, dataset_name: as the original called them.
        algorithm: the algorithm without its sensors, as in ``orb-slam2``.
        sensors: the sensor mode.
        parameters: the algorithm's parameters.
        attributes: the dataset's parameters, and the topics under ``algorithm-remap`` and ``dataset-remap``.
        files_sha256: check sum of each file that is there; the configuration's stands under ``config.yaml``.
    """

    folder: Path
    number: str
    algorithm_name: str
    dataset_name: str
    algorithm: str
    sensors: SensorMode
    parameters: dict[str, Any]
    attributes: dict[str, Any]
    files_sha256: dict[str, str]

    @property
    def dataset(self) -> str:
        """Return the dataset's name as the catalog writes names."""
        return catalog_name(self.dataset_name)

    @property
    def uid(self) -> str:
        """Return the identity of this run among all others, the same at each import."""
        return f"{SOURCE}-{digest([self.number, self.files_sha256])[:32]}"

    @property
    def configuration_hash(self) -> str:
        """Return the hash that runs of equal configuration share."""
        return digest([self.algorithm_name, self.dataset_name, self.parameters, self.attributes])

    def read_trajectory(self) -> Trajectory:
        """Return the estimate.

        Raises:
            EvaluationError: there is none, or it can't be read.
        """
        return read_trajectory(self.folder / _TRAJECTORY, "tum")

    @property
    def trajectory_sha256(self) -> str | None:
        """Return the check sum of the estimate's file, None where there is none."""
        return self.files_sha256.get(_TRAJECTORY)

    @property
    def trajectory_is_empty(self) -> bool:
        """Tell whether there is no estimate at all."""
        file = self.folder / _TRAJECTORY
        return not file.is_file() or not any(
            line.strip() and not line.lstrip().startswith("#")
            for line in file.read_text(encoding="utf-8", errors="replace").splitlines()
        )

    def record(self, repetition: int) -> RunRecord:
        """Return the run as a finished one, without trajectory and results.

        Raises:
            InputError: the samples can't be read.
        """
        return RunRecord(
            uid=self.uid,
            name=f"{self.algorithm}-{self.sensors}-{self.dataset}-{catalog_name(self.number)}",
            sweep=SOURCE,
            sweep_uid=SOURCE,
            labels={
                "source": SOURCE,
                "run": self.number,
                "algorithm": self.algorithm_name,
                "dataset": self.dataset_name,
            },
            spec={
                "algorithmRef": {"name": self.algorithm},
                "datasetRef": {"name": self.dataset},
                "sensors": self.sensors.value,
                "parameters": self.parameters,
                "input": {"pace": "Realtime"},
                "repetition": repetition,
            },
            attributes=self.attributes,
            phase=Phase.SUCCEEDED,
            attempts=1,
            usage=read_usage(self.folder / _PROFILE),
            provenance=Provenance(spec_hash=self.configuration_hash),
            folder=str(self.folder.absolute()),
        )


def find_runs(directory: Path) -> list[Path]:
    """Return the run folders of a folder of results, by number.

    Raises:
        InputError: there is none.
    """
    if (directory / _CONFIG).is_file():
        return [directory]
    try:
        folders = [entry for entry in directory.iterdir() if entry.is_dir() and entry.name[0] != "."]
    except OSError as error:
        raise InputError(f"{directory}: {error.strerror}") from None
    if not folders:
        raise InputError(f"{directory}: no run folders; expected folders that hold {_CONFIG}, {_TRAJECTORY}")
    return sorted(folders, key=lambda folder: (_natural(folder.name), folder.name))


def read_run(folder: Path) -> OriginalRun:
    """Read a run's configuration.

    Raises:
        InputError: it is missing, can't be read, or doesn't say what was run; names file and line.
    """
    config = _config_file(folder)
    documents = parse(read_text(config), str(config))
    if len(documents) != 1 or not isinstance(documents[0].value, dict):
        raise InputError(f"{config}: expected one mapping with slam-hive-algorithm and more")
    document = documents[0]
    algorithm_name = _text(document, "slam-hive-algorithm")
    dataset_name = _text(document, "slam-hive-dataset")
    parameters = _mapping(document, "algorithm-parameters")
    attributes = _mapping(document, "dataset-parameters")
    for name in ("algorithm-remap", "dataset-remap"):
        if topics := _mapping(document, name):
            attributes[name] = topics
    algorithm, sensors = identify(algorithm_name, {*attributes, *attributes.get("algorithm-remap", {})})
    if sensors is None:
        raise InputError(
            f"{document.where(('slam-hive-algorithm',))}: slam-hive-algorithm: {algorithm_name!r} and its "
            f"topics don't tell the sensors; expected a name that ends with -{', -'.join(_ENDINGS)}"
        )
    return OriginalRun(
        folder=folder,
        number=str(int(folder.name)) if folder.name.isdecimal() else folder.name,
        algorithm_name=algorithm_name,
        dataset_name=dataset_name,
        algorithm=algorithm,
        sensors=sensors,
        parameters={
            key: _as_text(value) if isinstance(value, list | dict) else value
            for key, value in parameters.items()
        },
        attributes=attributes,
        files_sha256={
            name: hashlib.sha256(file.read_bytes()).hexdigest()
            for name, file in (
                (_CONFIG, config),
                (_TRAJECTORY, folder / _TRAJECTORY),
                (_PROFILE, folder / _PROFILE),
            )
            if file.is_file()
        },
    )


def _config_file(folder: Path) -> Path:
    file = folder / _CONFIG
    if file.is_file():
        return file
    others = sorted(other for other in folder.iterdir() if other.suffix in {".yaml", ".yml"})
    if len(others) != 1:
        found = ", ".join(other.name for other in others) or "none"
        raise InputError(f"{folder}: expected {_CONFIG} or one other .yaml file, found {found}")
    return others[0]


def identify(name: str, topics: Iterable[str] = ()) -> tuple[str, SensorMode | None]:
    """Split an original algorithm's name into algorithm and sensor mode.

    Args:
        name: such as ``orb-slam2-ros-rgbd`` or ``vins-fusion-stereo-imu``.
        topics: names of its topics, asked where the name doesn't tell.

    >>> identify("orb-slam3-ros-mono-inertial")
    ('orb-slam3', <SensorMode.MONO_INERTIAL: 'mono-inertial'>)
    """
    plain = re.sub(r"-imu$", "-inertial", catalog_name(name).replace("rgb-d", "rgbd"))
    whole = plain.removesuffix("-ros")
    if whole in _WHOLE_NAMES:
        return whole, _WHOLE_NAMES[whole]
    for ending, mode in _ENDINGS.items():
        if plain.endswith(f"-{ending}"):
            return plain.removesuffix(f"-{ending}").removesuffix("-ros"), mode
    known = set(topics)
    found = next((mode for names, mode in _TOPICS if known.intersection(names)), None)
    if found is not None and known.intersection({"imu_topic", "imuTopic"}):
        found = _INERTIAL.get(found, found)
    return whole, found


def read_usage(path: Path) -> Usage | None:
    """Return the usage of a run, None without samples.

    The mean is the plain mean of all samples, as the original's tables have it. Each sample's CPU is that
    since the one before; where samples are missing, CPU seconds and wall time stay unknown.

    Raises:
        DataError: the file isn't what it should be; names the line.
    """
    if not path.is_file():
        return None
    samples = _samples(path)
    if not samples:
        return None
    times, cores, memory = zip(*samples, strict=True)
    steps = [later - earlier for earlier, later in pairwise(times)]
    whole = bool(steps) and max(steps) <= LONGEST_STEP
    return Usage(
        cpu=CpuUsage(
            mean_cores=math.fsum(cores) / len(cores),
            max_cores=max(cores),
            seconds=math.fsum(map(math.prod, zip(steps, cores[1:], strict=True))) if whole else None,
        ),
        memory=MemoryUsage(
            peak_bytes=round(max(memory)),
            mean_bytes=math.fsum(memory) / len(memory),
            kind=MemoryKind.CONTAINER,
        ),
        wall_seconds=times[-1] - times[0] if whole else None,
        samples=len(samples),
        source=f"{SOURCE} {path.name}",
        includes_reader=True,
        max_includes_reader=True,
    )


def _as_text(value: Any) -> str:
    """A parameter is a single value: write a list or mapping among them as text."""
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _samples(path: Path) -> list[tuple[float, float, float]]:
    reader = csv.reader(io.StringIO(read_text(path)))
    header = [name.strip() for name in next(reader, [])]
    if header != _COLUMNS:
        raise DataError(f"{path}:1: expected the columns {','.join(_COLUMNS)}, found {','.join(header)!r}")
    samples = []
    for row in reader:
        if not row:
            continue
        try:
            time, cores, memory = (float(value) for value in row)
        except ValueError:
            raise DataError(f"{path}:{reader.line_num}: expected three numbers, found {row}") from None
        if not all(map(math.isfinite, (time, cores, memory))):
            raise DataError(f"{path}:{reader.line_num}: every number must be finite, found {row}")
        samples.append((time, cores, memory))
    return samples


def _text(document: Document, field: str) -> str:
    value = document.value.get(field)
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"{document.where((field,))}: {field}: expected a name, found {value!r}")
    return value.strip()


def _mapping(document: Document, field: str) -> dict[str, Any]:
    value = document.value.get(field)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(f"{document.where((field,))}: {field}: expected a mapping, found {value!r}")
    return dict(value)


def _natural(name: str) -> tuple[bool, int]:
    return (not name.isdecimal(), int(name) if name.isdecimal() else 0)
