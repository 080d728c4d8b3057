# SPDX-License-Identifier: Apache-2.0
"""Tests of the recorder: the frame that a pose belongs to, dropped frames, latencies."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.playback.player.poses import Pose
from slamhive.playback.player.recorder import Recorder, merge_metrics, quantile
from slamhive.playback.protocol import FrameSource

if TYPE_CHECKING:
    from pathlib import Path

MS = 1_000_000


def recorder(match: str = "At", **more: Any) -> Recorder:
    made = Recorder(FrameSource("/points", 0.1, match, **more))
    for index in range(4):
        made.frame(index * 100 * MS, 1000 * MS + index * 100 * MS)
    return made


def pose(milliseconds: float, x: float = 0.0) -> Pose:
    return Pose(round(milliseconds * MS), (x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("match", "stamps", "frames"),
    [
        ("At", [0, 101, 260], [0, 100, 300]),
        ("At", [-60, 390], []),
        ("After", [50, 100, 300], [0, 0, 200]),
        ("After", [99.9, 104.9, 399], [0, 0, 300]),
        ("After", [0, 500], []),
        ("Before", [-50, 0, 201], [0, 100, 300]),
        ("Before", [-200, 300], []),
    ],
)
def test_a_pose_belongs_to_a_frame(match: str, stamps: list[float], frames: list[int]) -> None:
    made = recorder(match)
    for stamp in stamps:
        made.poses([pose(stamp)], 2000 * MS)
    assert [stamp // MS for stamp, _, _ in made.latencies()] == sorted(set(frames))


def test_numbers() -> None:
    made = recorder(time_offset=0.5)
    made.poses([pose(200)], 1230 * MS)
    made.poses([pose(0)], 1010 * MS)
    made.poses([pose(0, 1.0), pose(1, np.nan)], 1500 * MS)
    assert made.metrics() == {
        "framesOffered": 4,
        "posesPublished": 2,
        "framesProcessed": 2,
        "framesDropped": 2,
        "posesBroken": 1,
        "latencySeconds": {"mean": 0.02, "median": 0.02, "p95": 0.029, "max": 0.03},
    }
    assert made.table().splitlines()[1:] == [
        "0.500000000,1.000000000,1.010000000,0.010000",
        "0.700000000,1.200000000,1.230000000,0.030000",
    ]
    assert [line.split()[:2] for line in made.final().splitlines()] == [
        ["0.500000000", "1.000000000"],
        ["0.700000000", "0.000000000"],
    ]
    assert made.online().splitlines()[0].split()[1] == "0.000000000"


def test_stamps_that_are_moved_leave_frames_and_latencies_as_they_are() -> None:
    made = Recorder(FrameSource("/points", 0.1, time_offset=0.5), 0.05)
    made.frame(0, 1000 * MS)
    made.poses([pose(0)], 1010 * MS)
    assert made.final().split()[0] == "0.550000000"
    assert made.table().splitlines()[1].split(",")[0] == "0.500000000"


def test_keyframes_say_nothing_of_drops() -> None:
    made = recorder(every=False)
    made.poses([pose(0)], 1010 * MS)
    assert "framesDropped" not in made.metrics()


def test_nothing_heard() -> None:
    made = Recorder(FrameSource("/points", 0.1))
    made.poses([pose(0)], 0)
    assert made.metrics() == {
        "framesOffered": 0,
        "posesPublished": 1,
        "framesProcessed": 0,
        "framesDropped": 0,
    }


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.95, 1.0])
@pytest.mark.parametrize("size", [1, 2, 7])
def test_quantiles_are_numpys(share: float, size: int) -> None:
    values = sorted(np.random.default_rng(size).normal(size=size).tolist())
    assert quantile(values, share) == pytest.approx(np.quantile(values, share))


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, {"a": 1, "b": 2}),
        ('{"b": 3, "c": 4}', {"a": 1, "b": 3, "c": 4}),
        ("[1]", {"a": 1, "b": 2}),
        ("{", {"a": 1, "b": 2}),
    ],
)
def test_what_the_algorithm_counted_stays(tmp_path: Path, content: str | None, expected: Any) -> None:
    path = tmp_path / "metrics.json"
    if content is not None:
        path.write_text(content)
    merge_metrics(path, {"a": 1, "b": 2})
    assert json.loads(path.read_text()) == expected


def test_no_link_is_followed(tmp_path: Path) -> None:
    secret = tmp_path / "secret.json"
    secret.write_text('{"secret": 1}')
    path = tmp_path / "metrics.json"
    path.symlink_to(secret)
    (tmp_path / ".metrics.json.part").symlink_to(secret)
    merge_metrics(path, {"a": 1})
    assert json.loads(path.read_text()) == {"a": 1}
    assert secret.read_text() == '{"secret": 1}'
