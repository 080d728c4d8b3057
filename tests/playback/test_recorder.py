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
from slamhive_eval import read_covariances

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


def test_covariances_are_those_of_the_poses_as_first_published(tmp_path: Path) -> None:
    made = recorder(time_offset=0.5)
    known = [np.diag(np.arange(1.0, 7.0)) + k * (np.eye(6, k=1) + np.eye(6, k=-1)) for k in range(3)]
    for at, which in ((100, 1), (0, 0), (0, 2)):
        made.poses([pose(at)._replace(covariance=tuple(known[which].ravel().tolist()))], 2000 * MS)
    made.poses([pose(200)], 2000 * MS)
    (tmp_path / "covariances.csv").write_text(made.covariances())
    stamps, found = read_covariances(tmp_path / "covariances.csv")
    assert stamps.tolist() == [0.5, 0.6]
    np.testing.assert_array_equal(found, known[:2])
    assert recorder().covariances() == ""


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
        "latencySeconds": {"mean": 0.02, "median": 0.02, "p95": 0.029, "p99": 0.0298, "max": 0.03},
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


@pytest.mark.parametrize(
    ("arrivals", "poses", "rate", "by_clock", "stepped"),
    [
        ([0, 100, 200, 300], [20, 120, 220, 320], 1.0, 320 / 300, 1.0),  # in time
        ([0, 100, 200, 300], [200, 400, 600, 800], 1.0, 800 / 300, 2.0),  # a queue that grows
        ([0, 100, 200, 300], [150, None, 350, None], 1.0, 350 / 300, 1.0),  # drops what comes meanwhile
        ([0, 50, 100, 150], [10, 60, 110, 160], 2.0, 160 / 150, 1.0),
        ([0, 250, 500, 750], [150, 400, 650, 900], 1.0, 900 / 300, 450 / 300),  # time stood for 150 of 250 ms
        (
            [0, 150, 300, 450],
            [200, 350, 500, None],
            1.0,
            500 / 300,
            1.0,
        ),  # answers with the next frame, in 50 ms
        ([0, 2100, 4200], [None, 4300, None], 1.0, 4300 / 200, 4000 / 200),  # patience of 2 s was at its end
        ([0, 100], [None, None], 1.0, None, None),
        ([0], [20], 1.0, None, None),
    ],
)
def test_the_real_time_factor_is_the_time_it_took_over_the_time_it_had(
    arrivals: list[int], poses: list[int | None], rate: float, by_clock: float | None, stepped: float | None
) -> None:
    made = Recorder(FrameSource("/points", 0.1))
    for index, (arrival, came) in enumerate(zip(arrivals, poses, strict=True)):
        made.frame(index * 100 * MS, arrival * MS)
        if came is not None:
            made.poses([pose(index * 100)], came * MS)
    found = [made.factor(rate, stepped=way) for way in (False, True)]
    assert found == [wanted and pytest.approx(wanted, abs=1e-4) for wanted in (by_clock, stepped)]


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
