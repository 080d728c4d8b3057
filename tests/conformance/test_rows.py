# SPDX-License-Identifier: Apache-2.0
"""Tests of what a check says of how far a program read, by poses or by keyframes alone."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slamhive.conformance.rows import data, ran, rest_before
from slamhive.model.algorithm import Output, Poses
from slamhive.model.results import Phase
from slamhive_eval import Trajectory


def standing_from(rest: float, end: float = 20.0) -> Trajectory:
    """Return a way along x at 1 m/s until a platform rests, but for the noise of its ground truth."""
    stamps = np.arange(0.0, end + 0.05, 0.1)
    positions = np.zeros((len(stamps), 3))
    positions[:, 0] = np.minimum(stamps, rest) + 0.002 * (np.arange(len(stamps)) % 2)
    return Trajectory(stamps, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1)))


def ended(last: float) -> Any:
    frames = SimpleNamespace(processed=None, dropped=None)
    return SimpleNamespace(record=SimpleNamespace(frames=frames), trajectory=standing_from(last, last))


def test_the_rest_at_the_end_is_measured_by_the_ground_truth() -> None:
    assert rest_before(20.0, standing_from(16.0)) == pytest.approx(4.0, abs=0.2)
    assert rest_before(20.0, standing_from(30.0)) == pytest.approx(0.0, abs=0.2)
    assert rest_before(-1.0, standing_from(16.0)) == 0.0
    turning = standing_from(0.0)
    angles = turning.stamps * 0.1
    turning = Trajectory(
        turning.stamps,
        turning.positions,
        np.stack([0 * angles, 0 * angles, np.sin(angles / 2), np.cos(angles / 2)], axis=1),
    )
    assert rest_before(20.0, turning) == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize(
    ("poses", "last", "rest", "answer"),
    [
        (Poses.KEYFRAMES, 16.1, 3.9, "pass"),
        (Poses.KEYFRAMES, 9.0, 3.9, "warning"),
        (Poses.KEYFRAMES, 16.1, 0.0, "warning"),
        (Poses.FRAMES, 16.1, 3.9, "fail"),
        (Poses.FRAMES, 19.9, 3.9, "pass"),
    ],
)
def test_keyframes_end_where_the_platform_does(poses: Poses, last: float, rest: float, answer: str) -> None:
    found = data(200, 20.0, 20.0, Output(frame="body", poses=poses), ended(last), rest=rest)
    assert found.answer == answer
    assert ("keyframes" in found.found) is (poses is Poses.KEYFRAMES)
    assert ("framesProcessed" in found.help) is (answer == "fail")


@pytest.mark.parametrize(("dropped", "answer"), [(0, "pass"), (19, "pass"), (42, "warning")])
def test_a_program_that_drops_many_frames_is_in_doubt(dropped: int, answer: str) -> None:
    counted: Any = SimpleNamespace(
        record=SimpleNamespace(frames=SimpleNamespace(processed=200 - dropped, dropped=dropped))
    )
    assert data(200, 20.0, 20.0, Output(frame="body"), counted).answer == answer


@pytest.mark.parametrize(
    ("message", "answer", "found"),
    [
        (None, "pass", "2 of 2 ended well"),
        ("UsageSuspect: busy", "pass", "2 of 2 ended well"),
        ("UsageSuspect: busy; no node declares a", "warning", "2 of 2 ended well; no node declares a"),
    ],
)
def test_what_runs_remark_beside_their_load_is_told(message: str | None, answer: str, found: str) -> None:
    record = SimpleNamespace(phase=Phase.SUCCEEDED, message=message, usage=SimpleNamespace(suspect="busy"))
    told = ran([SimpleNamespace(record=record)] * 2)  # type: ignore[list-item]
    assert (told.answer, told.found) == (answer, found)
