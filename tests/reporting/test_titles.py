# SPDX-License-Identifier: Apache-2.0
"""Titles that say what a value is."""

from __future__ import annotations

from typing import Any

import pytest

from slamhive.reporting.titles import column_title, keys_text


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"algorithm": "my-icp", "sensors": "lidar", "dataset": "mylidar"}, "my-icp, lidar, mylidar"),
        ({"usage.includesReader": False, "algorithm": "my-icp"}, "reader not included, my-icp"),
        ({"usage.includesReader": True}, "reader included"),
        ({"usage.includesReader": None}, "reader unknown"),
        ({"evaluation": "sim3", "input.pace": "Realtime"}, "evaluation sim3, pace Realtime"),
        ({"input.frameRate": 7.5, "input.resolution": 0.5}, "frame rate 7.5 Hz, resolution 0.5"),
        ({"input.frameRate": None}, "frame rate –"),
        ({"parameters.loop": True, "label.camera": "front"}, "loop yes, camera front"),
        ({"parameters.rate": 1, "input.rate": 2}, "parameters.rate 1, input.rate 2"),
        ({"usage.memory.peakBytes": 2**28}, "peak memory 256 MiB"),
        ({}, ""),
    ],
)
def test_values_have_their_columns_names(keys: dict[str, Any], expected: str) -> None:
    assert keys_text(keys) == expected


def test_subjects_are_named_where_asked() -> None:
    keys = {"algorithm": "orb-slam3", "sensors": "stereo"}
    assert keys_text(keys, bare=("algorithm",), text=str.upper) == "ORB-SLAM3, sensors STEREO"


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("input.frameRate", "frame rate [Hz]"),
        ("parameters.nFeatures", "nFeatures"),
        ("dataset.attributes.loops", "loops"),
        ("ate.rmse", "ATE [m]"),
        ("provenance.cpuModel", "processor"),
        ("repetition", "repetition"),
    ],
)
def test_columns_are_called_what_people_call_them(name: str, title: str) -> None:
    assert column_title(name) == title
