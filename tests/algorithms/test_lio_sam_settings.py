# SPDX-License-Identifier: Apache-2.0
"""Settings of LIO-SAM for LiDARs that it can read, and a sentence for those that it can't."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from slamhive.model.algorithm import Algorithm
from slamhive.model.loading import load_file
from slamhive.model.templates import TemplateMistake
from slamhive.templating.rendering import Renderer

MANIFEST = Path(__file__).parents[2] / "images" / "algorithms" / "lio-sam" / "algorithm.yaml"
EYE = [[float(row == column) for column in range(4)] for row in range(4)]
LIDAR = {"rings": 32, "columns": 720, "timeField": "time", "ringField": "ring"}


def rendered(stamp: str = "ScanStart", **lidar: Any) -> dict[str, Any]:
    (algorithm,) = load_file(MANIFEST)
    assert isinstance(algorithm, Algorithm)
    known = {name: value for name, value in (LIDAR | lidar).items() if value is not None}
    sensors = {
        "lidar": {"type": "Lidar", "topic": "/points", "stamp": stamp, "T_body_sensor": EYE, "lidar": known},
        "imu": {"type": "Imu", "topic": "/imu", "T_body_sensor": EYE, "imu": {"gravity": 9.81}},
    }
    noise = ("accelerometerNoise", "gyroscopeNoise", "accelerometerRandomWalk", "gyroscopeRandomWalk")
    sensors["imu"]["imu"] |= dict.fromkeys(noise, 0.01)  # type: ignore[call-overload]
    told = dict.fromkeys(("algorithm", "run", "mode", "seed", "input"))
    told |= {"sensors": sensors, "parameters": algorithm.spec.fill({}), "cores": 3}
    told |= {"dataset": {"recording": {"path": "dataset/recording.bag"}}}
    template = dict(algorithm.spec.templates)["params.yaml"]
    found: dict[str, Any] = yaml.safe_load(Renderer(told, "/run", "/run/files").text(template))
    return found["lio_sam"]  # type: ignore[no-any-return]


@pytest.mark.parametrize(("field", "sensor"), [("time", "velodyne"), ("t", "ouster")])
def test_the_time_of_points_says_whose_lidar_it_is(field: str, sensor: str) -> None:
    found = rendered(timeField=field)
    assert (found["sensor"], found["N_SCAN"], found["numberOfCores"]) == (sensor, 32, 3)


@pytest.mark.parametrize(
    ("stamp", "lidar", "message"),
    [
        ("ScanEnd", {}, "takes the stamp of a scan for its start, and these are stamped ScanEnd"),
        ("ScanStart", {"rings": None}, "needs the LiDAR's rings and columns"),
        ("ScanStart", {"timeField": "timestamp"}, "timeField and ringField say otherwise"),
        ("ScanStart", {"timeField": None}, "timeField and ringField say otherwise"),
        ("ScanStart", {"ringField": "line"}, "timeField and ringField say otherwise"),
    ],
)
def test_a_lidar_that_it_can_not_read_is_refused(stamp: str, lidar: dict[str, Any], message: str) -> None:
    with pytest.raises(TemplateMistake, match=message):
        rendered(stamp, **lidar)
