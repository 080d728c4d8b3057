# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from slamhive.data.recordings.clouds import cloud_filter, cloud_points, even_rings, filter_cloud
from slamhive.model.errors import DataError, InputError
from slamhive.model.run import LidarInput
from slamhive.model.sensors import Lidar

TYPES = get_typestore(Stores.ROS1_NOETIC).types
_LAYOUT = {
    "names": ["x", "y", "z", "ring"],
    "formats": ["<f4", "<f4", "<f4", "<u2"],
    "offsets": [0, 4, 8, 16],
}
POINT = np.dtype(_LAYOUT | {"itemsize": 24})
LIDAR = Lidar(rings=4, ring_field="ring", min_range=0.5, max_range=50.0)


def cloud(points: Any, *, height: Any = 1) -> Any:
    header = TYPES["std_msgs/msg/Header"](0, TYPES["builtin_interfaces/msg/Time"](0, 0), "lidar")
    field = TYPES["sensor_msgs/msg/PointField"]
    fields = [field(name, at[1], 4 if name == "ring" else 7, 1) for name, at in POINT.fields.items()]
    data = points.view(np.uint8).reshape(-1)
    width = len(points) // height
    return TYPES["sensor_msgs/msg/PointCloud2"](
        header, height, width, fields, False, POINT.itemsize, POINT.itemsize * width, data, False
    )


@pytest.fixture
def points() -> Any:
    result = np.zeros(8, dtype=POINT)
    result["x"] = [0.1, 1.0, 2.0, 3.0, 4.0, np.nan, 30.0, 60.0]
    result["ring"] = [0, 1, 2, 3, 0, 1, 2, 3]
    return result


def kept(points: Any, options: Any, **changes: Any) -> Any:
    rule, lidar = cloud_filter(options, LIDAR, "top")
    message = filter_cloud(replace(cloud(points, height=2), **changes), rule, "/points")
    assert message.data.size == message.width * message.height * message.point_step == message.row_step
    return cloud_points(message, "/points"), lidar


def test_points_out_of_range_go_and_the_rest_keeps_every_byte(points: Any) -> None:
    points.view(np.uint8).reshape(8, -1)[:, 20:] = 7
    found, lidar = kept(points, LidarInput(min_range=1.0, max_range=30.0))
    assert found.tobytes() == points[[1, 2, 3, 4, 6]].tobytes()
    assert (lidar.min_range, lidar.max_range, lidar.rings) == (1.0, 30.0, 4)


def test_a_wish_beyond_the_sensor_keeps_its_limits(points: Any) -> None:
    _, lidar = kept(points, LidarInput(min_range=0.1, max_range=80.0))
    assert (lidar.min_range, lidar.max_range) == (0.5, 50.0)


def test_rings_are_evenly_spaced_and_numbered_anew(points: Any) -> None:
    found, lidar = kept(points, LidarInput(rings=2))
    assert found["x"].tolist() == [1.0, 3.0, pytest.approx(np.nan, nan_ok=True), 60.0]
    assert found["ring"].tolist() == [0, 1, 0, 1]
    assert lidar.rings == 2


@pytest.mark.parametrize(("rings", "wanted"), [(32, 16), (64, 16), (32, 5), (3, 2), (4, 1)])
def test_even_rings(rings: Any, wanted: Any) -> None:
    numbers = even_rings(rings, wanted)
    chosen = np.flatnonzero(numbers >= 0)
    assert numbers[chosen].tolist() == list(range(wanted))
    assert len(set(np.diff(chosen))) <= 2
    assert abs(chosen.mean() - (rings - 1) / 2) <= 0.75


@pytest.mark.parametrize(
    ("options", "lidar", "words"),
    [
        ({"rings": 2}, None, "has no ring numbers"),
        ({"rings": 2}, Lidar(rings=4), "ringField"),
        ({"rings": 2}, Lidar(ring_field="ring"), "how many rings"),
        ({"rings": 5}, LIDAR, "5 asked for, sensor .top. has 4"),
        ({"min_range": 3, "max_range": 2}, LIDAR, "minRange 3 must be less than maxRange 2"),
    ],
)
def test_wishes_that_cannot_be_met(options: Any, lidar: Any, words: Any) -> None:
    with pytest.raises(InputError, match=words):
        cloud_filter(LidarInput(**options), lidar, "top")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"data": np.zeros(10, dtype=np.uint8)}, "has only 10 bytes"),
        ({"point_step": 4}, "don't fit a point of 4 bytes"),
        ({"fields": []}, "no field 'x'"),
    ],
)
def test_damaged_clouds(points: Any, change: Any, words: Any) -> None:
    with pytest.raises(DataError, match=words):
        kept(points, LidarInput(max_range=5), **change)


def test_ring_numbers_beyond_the_declared_ones(points: Any) -> None:
    points["ring"][0] = 9
    with pytest.raises(DataError, match="from 0 to 9, the dataset states 4 rings"):
        kept(points, LidarInput(rings=2))
