# SPDX-License-Identifier: Apache-2.0
"""Messages that are delivered late, or in a neighbour's place: times of recording change, stamps don't."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from variants import make

from slamhive.data.making.delivering import in_order
from slamhive.data.making.preparation import prepare
from slamhive.model.algorithm import DataFormat
from slamhive.model.errors import InputError
from slamhive.model.run import InputOptions
from slamhive.model.sensors import Role

if TYPE_CHECKING:
    from pathlib import Path

BAG1, BAG2, MCAP = DataFormat.ROSBAG1, DataFormat.ROSBAG2, DataFormat.MCAP
ROLES = (Role.LIDAR, Role.IMU)


def delivered(path: Path) -> list[tuple[str, int, int]]:
    """Return topics, times of recording and stamps of the messages, as a reader delivers them."""
    found = []
    with AnyReader([path]) as reader:
        for connection, time, raw in reader.messages():
            stamp = getattr(reader.deserialize(raw, connection.msgtype), "header", None)
            stamp = 0 if stamp is None else stamp.stamp.sec * 10**9 + stamp.stamp.nanosec
            found.append((connection.topic, time, stamp))
    return found


def of(topic: str, messages: list[tuple[str, int, int]]) -> tuple[list[int], list[int]]:
    chosen = [(time, stamp) for name, time, stamp in messages if name == topic]
    return [time for time, _ in chosen], [stamp for _, stamp in chosen]


@pytest.mark.parametrize("form", [BAG1, BAG2, MCAP])
def test_late_messages_come_later_and_are_stamped_as_before(
    lidar_entry: Any, tmp_path: Path, form: DataFormat
) -> None:
    plain, late = (make(lidar_entry, ROLES, tmp_path, one, form) for one in (None, {"late": {"imu": 0.0125}}))
    before, after = delivered(plain.path), delivered(late.path)
    assert of("/points", after) == of("/points", before)
    times, stamps = of("/imu", before)
    assert of("/imu", after) == ([time + 12_500_000 for time in times], stamps)
    # The player takes them in this order, and so does whoever reads the file.
    assert [time for _, time, _ in after] == sorted(time for _, time, _ in after)
    assert [topic for topic, _, _ in after] != [topic for topic, _, _ in before]
    assert (late.frames, late.start_time) == (plain.frames, plain.start_time)


@pytest.mark.parametrize("share", [0.2, 1.0])
def test_swapped_messages_are_a_share_and_each_is_in_its_neighbours_place(
    lidar_entry: Any, tmp_path: Path, share: float
) -> None:
    plain, swapped = (
        make(lidar_entry, ROLES, tmp_path, one) for one in (None, {"swapped": {"lidar": share}})
    )
    times, stamps = of("/points", delivered(plain.path))
    now, order = of("/points", delivered(swapped.path))
    assert now == times
    assert sorted(order) == stamps
    assert order[0] == stamps[0]
    places = [stamps.index(stamp) for stamp in order]
    moved = [place - k for k, place in enumerate(places)]
    assert set(moved) <= {-1, 0, 1}
    assert sum(map(bool, moved)) == min(2 * round(share * len(stamps) / 2), (len(stamps) - 1) // 2 * 2)
    if share < 1:
        more = of("/points", delivered(make(lidar_entry, ROLES, tmp_path, {"swapped": {"lidar": 0.6}}).path))[
            1
        ]
        assert all(more[k] == order[k] for k, step in enumerate(moved) if step)


def test_camera_info_goes_with_its_image(tmp_path: Path, frames_of: Any) -> None:
    entry = frames_of(tmp_path / "camera.bag", rate=20, count=30)
    wanted = {"late": {"camera": 0.07}, "swapped": {"camera": 0.5}}
    messages = delivered(make(entry, [Role.CAMERA], tmp_path, wanted).path)
    assert of("/cam/image_raw", messages) == of("/cam/camera_info", messages)
    assert of("/cam/image_raw", messages)[1] != sorted(of("/cam/image_raw", messages)[1])


def test_what_waits_is_no_more_than_what_is_late() -> None:
    taken = []

    def messages() -> Any:
        for k in range(20):
            taken.append(k)
            yield "a", 10 * k, 35 if k % 2 else 0, b""

    waiting = []
    found = []
    for connection, time, _ in in_order(messages(), 0):
        found.append(time)
        waiting.append(len(taken) - len(found))
        assert connection == "a"
    assert found == sorted(found)
    assert len(found) == 20
    assert max(waiting) <= 4


def test_a_folder_has_no_order_of_delivery(camera_entries: Any, tmp_path: Path) -> None:
    asked = InputOptions.model_validate({"perturb": {"late": {"left": 0.1}}})
    with pytest.raises(InputError, match=r"input.perturb.late.left: a folder in Euroc's form has no order"):
        prepare(camera_entries[1.0], [Role.LEFT, Role.RIGHT], asked, [DataFormat.EUROC], tmp_path)


def test_none_late_is_the_variant_without(lidar_entry: Any, tmp_path: Path) -> None:
    keys = {
        make(lidar_entry, ROLES, tmp_path, one).key
        for one in (None, {"late": {"imu": 0}, "swapped": {"lidar": 0.0}}, {"late": {"left": 1}})
    }
    assert len(keys) == 1
    assert np.all([len(key) == 64 for key in keys])
