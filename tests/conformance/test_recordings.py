# SPDX-License-Identifier: Apache-2.0
"""Generated recordings of checks: one for each mode has the sensors that it takes."""

from __future__ import annotations

import pytest

from slamhive.conformance.recordings import RECORDINGS, recording_for
from slamhive.model.algorithm import Mode
from slamhive.model.sensors import Role, SensorMode
from slamhive.plan.resolution import role_problems

DATASETS = {dataset.name: dataset for dataset in RECORDINGS}


@pytest.mark.parametrize("name", [mode for mode in SensorMode if mode is not SensorMode.CLOUD])
def test_each_mode_has_a_recording_with_its_sensors(name: SensorMode) -> None:
    mode = Mode(name=name)
    assert list(role_problems(mode, DATASETS[recording_for(mode)], {})) == []


@pytest.mark.parametrize(
    ("name", "found"),
    [
        (SensorMode.LIDAR, "check-lidar"),
        (SensorMode.STEREO_INERTIAL, "check-stereo-inertial"),
        (SensorMode.INERTIAL, "check-robot"),
        (SensorMode.SCAN_ODOMETRY, "check-robot"),
    ],
)
def test_modes_of_earlier_versions_keep_theirs(name: SensorMode, found: str) -> None:
    assert recording_for(Mode(name=name)) == found


def test_roles_that_are_listed_count() -> None:
    mode = Mode(name=SensorMode.LIDAR, roles=[Role.LIDAR, Role.GNSS, Role.BAROMETER])
    assert list(role_problems(mode, DATASETS[recording_for(mode)], {})) == []
