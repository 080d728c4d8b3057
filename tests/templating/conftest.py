# SPDX-License-Identifier: Apache-2.0
"""Configuration of a run with EuRoC's rig, whose calibration is published, and templates rendered for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.templating.rendering import Renderer

if TYPE_CHECKING:
    from collections.abc import Callable

# sensor.yaml of EuRoC's V1_01: cam0, cam1 and imu0; the body is the IMU.
T_BODY_LEFT = [
    [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975],
    [0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768],
    [-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949],
    [0.0, 0.0, 0.0, 1.0],
]
T_BODY_RIGHT = [
    [0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556],
    [0.999598781151, 0.0130119051815, 0.0251588363115, 0.0453689425024],
    [-0.0253898008918, 0.0179005838253, 0.999517347078, 0.00786212447038],
    [0.0, 0.0, 0.0, 1.0],
]
IDENTITY = [[float(row == column) for column in range(4)] for row in range(4)]
LEFT = {
    "width": 752,
    "height": 480,
    "model": "Pinhole",
    "fx": 458.654,
    "fy": 457.296,
    "cx": 367.215,
    "cy": 248.375,
    "distortion": "RadialTangential",
    "coefficients": [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0],
}
RIGHT = LEFT | {"fx": 457.587, "fy": 456.134, "cx": 379.999, "cy": 255.238}


def euroc() -> dict[str, Any]:
    """Return the configuration of a stereo-inertial run on EuRoC."""
    sensors = {
        "imu": {
            "name": "imu0",
            "type": "Imu",
            "topic": "/imu0",
            "rate": 200.0,
            "T_body_sensor": IDENTITY,
            "timeOffset": 0.0,
            "imu": {
                "accelerometerNoise": 0.002,
                "gyroscopeNoise": 0.00016968,
                "accelerometerRandomWalk": 0.003,
                "gyroscopeRandomWalk": 1.9393e-05,
                "gravity": 9.81,
            },
        },
        "left": {
            "topic": "/cam0/image_raw",
            "T_body_sensor": T_BODY_LEFT,
            "camera": LEFT,
            "timeOffset": 0.005,
        },
        "right": {"topic": "/cam1/image_raw", "T_body_sensor": T_BODY_RIGHT, "camera": RIGHT},
    }
    for role in ("left", "right"):
        sensors[role] |= {"name": role, "type": "Camera", "rate": 20.0}
    return {
        "apiVersion": "slamhive.io/v1alpha1",
        "kind": "RunConfiguration",
        "run": "study-1",
        "algorithm": "vins",
        "mode": "stereo-inertial",
        "dataset": {"name": "v101", "recording": {"format": "Rosbag1", "path": "dataset/recording.bag"}},
        "sensors": sensors,
        "parameters": {"features": 150, "refine": False, "name": 'O\'Neil: "x"', "small": 1e-07},
        "input": {"pace": "Lockstep", "frameRate": 20.0, "resolution": 1.0, "start": 0.0, "rate": 1.0},
        "seed": 7,
        "cores": 2,
    }


@pytest.fixture
def told() -> dict[str, Any]:
    """Configuration of a stereo-inertial run on EuRoC, as its algorithm is told it."""
    return euroc()


@pytest.fixture
def text(told: dict[str, Any]) -> Callable[[str], str]:
    """Renders a template for that run, in this process."""
    return lambda template: Renderer(told, "/slamhive", "/slamhive/files").text(template)
