# SPDX-License-Identifier: Apache-2.0
"""Short generated recordings on which algorithms are checked, and sweeps of one run that ask for a start."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from slamhive.model.base import ObjectMeta
from slamhive.model.dataset import Dataset
from slamhive.model.sensors import FOLLOWS, STAND_INS, Role, SensorMode
from slamhive.model.sweep import RunTemplate, Sweep, SweepSpec

if TYPE_CHECKING:
    from slamhive.conformance.executors import CheckStart
    from slamhive.model.algorithm import Mode
    from slamhive.plan import Catalog

_LIDAR, _STEREO, _RGBD, _ROBOT = "check-lidar", "check-stereo", "check-rgbd", "check-robot"
_SHAKEN_STEREO, _SHAKEN_RGBD = "check-stereo-inertial", "check-rgbd-inertial"
_SHAKEN = {"durationSeconds": 25, "loops": 0.6, "rig": "Euroc", "vibration": {}}
"""Platform that visual-inertial systems need to begin: it shakes, and its IMU is mounted as EuRoC's."""


def _generated(name: str, seed: int, sensors: list[str], **more: object) -> Dataset:
    synthetic = {"seed": seed, "sensors": sensors, **more}
    return Dataset.model_validate(
        {
            "apiVersion": "slamhive.io/v1alpha1",
            "kind": "Dataset",
            "metadata": {"name": name},
            "spec": {
                "description": "A short generated recording on which algorithms are checked",
                "recording": {"synthetic": synthetic},
                "gravityAligned": True,
            },
        }
    )


RECORDINGS = (
    _generated(
        _LIDAR, 31, ["Lidar", "Imu"], durationSeconds=14, loops=0.4, lidar={"rings": 16, "columns": 360}
    ),
    _generated(
        _ROBOT,
        53,
        ["Lidar", "Imu", "LaserScan", "Odometry", "Gnss", "Magnetometer", "Barometer"],
        durationSeconds=14,
        loops=0.4,
        motion=0,
        lidar={"rings": 16, "columns": 360},
    ),
    _generated(_STEREO, 37, ["Stereo", "Imu"], durationSeconds=14, loops=0.35),
    _generated(_RGBD, 41, ["Rgbd", "Imu"], durationSeconds=14, loops=0.35),
    _generated(_SHAKEN_STEREO, 43, ["Stereo", "Imu"], **_SHAKEN),
    _generated(_SHAKEN_RGBD, 47, ["Rgbd", "Imu"], **_SHAKEN),
)
"""Made once and kept among the generated datasets; in no catalog but that of a check."""


_WITHOUT_ROBOT = {*STAND_INS, *FOLLOWS, *FOLLOWS.values(), Role.LIDAR, Role.IMU}
"""Roles for which no recording of a whole robot is needed."""


def recording_for(mode: Mode) -> str:
    """Return the name of the recording that has the sensors of a mode."""
    if set(mode.needs) - _WITHOUT_ROBOT or set(mode.needs) == {Role.IMU}:
        return _ROBOT
    if Role.LIDAR in mode.needs:
        return _LIDAR
    inertial = Role.IMU in mode.needs
    if Role.DEPTH in mode.needs or Role.COLOR in mode.needs:
        return _SHAKEN_RGBD if inertial else _RGBD
    return _SHAKEN_STEREO if inertial else _STEREO


def asked_of(algorithm: str, start: CheckStart, dataset: str | None, catalog: Catalog) -> Sweep:
    """Return the sweep of one run that asks for a start.

    Args:
        algorithm: name of the algorithm.
        start: the start.
        dataset: a dataset by name; None: the generated one for its mode.
        catalog: what names refer to.
    """
    mode: SensorMode = start.mode.name
    template = {
        "algorithmRef": {"name": algorithm},
        "datasetRef": {"name": dataset or recording_for(start.mode)},
        "sensors": mode.value,
        "timeout": f"{max(1, math.ceil(start.timeout))}s",
        "retries": 0,
    }
    spec = catalog.algorithms[algorithm].spec
    asked: dict[str, str] = {"pace": start.pace.value} if start.pace is not None else {}
    if dataset is None and spec.plays(start.pace or spec.paces[0]):
        asked["duration"] = "9s"  # by the clock: as short as tells something
    if asked:
        template["input"] = asked
    metadata = ObjectMeta(name=f"check-{algorithm}-{mode.value}"[:60].rstrip("-."))
    return Sweep(metadata=metadata, spec=SweepSpec(template=RunTemplate(spec=template)))
