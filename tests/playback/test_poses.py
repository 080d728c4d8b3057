# SPDX-License-Identifier: Apache-2.0
"""Poses out of messages."""

from __future__ import annotations

from types import SimpleNamespace as Record
from typing import Any

import numpy as np
import pytest

from slamhive.playback.player.poses import Pose, compose, reader
from slamhive.playback.protocol import PoseSource

QUARTER = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))


def header(stamp: float, frame: str = "map") -> Record:
    seconds = int(stamp)
    return Record(stamp=Record(secs=seconds, nsecs=round((stamp - seconds) * 1e9)), frame_id=frame)


def point(*values: float) -> Record:
    return Record(**dict(zip("xyzw", values, strict=False)))


def bare(x: float) -> Record:
    return Record(position=point(x, 0.0, 0.0), orientation=point(*QUARTER))


def transform(stamp: float, parent: str, child: str, *place: float) -> Record:
    turn = Record(translation=point(*place), rotation=point(*QUARTER))
    return Record(header=header(stamp, parent), child_frame_id=child, transform=turn)


MESSAGES: dict[str, Any] = {
    "PoseStamped": Record(header=header(2.5), pose=bare(1.0)),
    "Odometry": Record(header=header(2.5), pose=Record(pose=bare(1.0), covariance=[0.0] * 36)),
    "PoseWithCovarianceStamped": Record(
        header=header(2.5), pose=Record(pose=bare(1.0), covariance=np.zeros(36))
    ),
    "Path": Record(poses=[Record(header=header(2.5), pose=bare(1.0))]),
}


@pytest.mark.parametrize("kind", MESSAGES)
def test_each_message(kind: str) -> None:
    assert list(reader(PoseSource("/t", kind))(MESSAGES[kind])) == [
        Pose(2_500_000_000, (1.0, 0.0, 0.0), QUARTER)
    ]


def test_transforms_are_chained_with_what_was_last_heard() -> None:
    take = reader(PoseSource("/tf", "TF", "map", "base"))
    odometry = transform(2.0, "odom", "base", 1.0, 0.0, 0.0)
    assert list(take(Record(transforms=[odometry]))) == []
    (pose,) = take(Record(transforms=[transform(1.0, "/map", "odom", 5.0, 0.0, 0.0)]))
    assert pose.stamp == 2_000_000_000
    np.testing.assert_allclose(pose.position, (5.0, 1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(pose.rotation, (0.0, 0.0, 1.0, 0.0), atol=1e-12)
    assert list(take(Record(transforms=[transform(3.0, "base", "hand", 9.0, 0.0, 0.0)]))) == []


def test_transforms_that_go_round_in_circles_give_nothing() -> None:
    take = reader(PoseSource("/tf", "TF", "map", "a"))
    circle = [transform(1.0, "b", "a", 0, 0, 0), transform(1.0, "a", "b", 0, 0, 0)]
    assert list(take(Record(transforms=circle))) == []


def matrix(pose: Pose) -> np.ndarray:
    x, y, z, w = pose.rotation
    T = np.eye(4)
    T[:3, :3] = np.eye(3) + 2 * np.array(
        [
            [-y * y - z * z, x * y - z * w, x * z + y * w],
            [x * y + z * w, -x * x - z * z, y * z - x * w],
            [x * z - y * w, y * z + x * w, -x * x - y * y],
        ]
    )
    T[:3, 3] = pose.position
    return T


def test_composing_is_the_product_of_matrices() -> None:
    random = np.random.default_rng(1)
    for _ in range(20):
        a, b = (
            Pose(i, tuple(random.normal(size=3)), tuple(q / np.linalg.norm(q)))
            for i, q in enumerate(random.normal(size=(2, 4)))
        )
        np.testing.assert_allclose(matrix(compose(a, b)), matrix(a) @ matrix(b), atol=1e-12)


@pytest.mark.parametrize(
    ("place", "turn", "sound"),
    [
        ((1, 2, 3), (0, 0, 0, 2), True),
        ((np.nan, 0, 0), (0, 0, 0, 1), False),
        ((0, 0, 0), (0, 0, 0, 0), False),
    ],
)
def test_what_is_a_pose(place: Any, turn: Any, sound: bool) -> None:
    assert Pose(0, place, turn).is_sound is sound


def test_a_line_is_normalised_and_exact_in_time() -> None:
    line = Pose(1_600_000_000_123_456_789, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, -2.0)).line(offset=-789)
    assert line == (
        "1600000000.123456000 1.000000000 2.000000000 3.000000000 "
        "0.000000000 0.000000000 0.000000000 -1.000000000\n"
    )
