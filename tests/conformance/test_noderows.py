# SPDX-License-Identifier: Apache-2.0
"""Tests of what a check says of ROS nodes: how late their poses came, and whether frame by frame is equal."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slamhive.conformance.noderows import latency, stepped
from slamhive.model.results import Phase, Reason
from slamhive.model.rosnodes import Ros2
from slamhive_eval import Trajectory

NODE = Ros2.model_validate({"poses": {"topic": "/odometry", "type": "Odometry"}})


def ended(metrics: dict[str, Any], moved: float = 0.0, **record: Any) -> Any:
    stamps = np.arange(0.0, 9.0, 0.1)
    positions = np.full((len(stamps), 3), moved)
    made = SimpleNamespace(
        metrics=metrics,
        phase=Phase.SUCCEEDED,
        message=None,
        usage=None,
        spec={"input": {}},
        provenance=SimpleNamespace(prepared=SimpleNamespace(frame_rate=10.0)),
        frames=SimpleNamespace(offered=len(stamps)),
        trajectory=SimpleNamespace(sha256=str(moved)),
    )
    vars(made).update(record)
    turned = np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))
    return SimpleNamespace(record=made, trajectory=Trajectory(stamps, positions, turned))


@pytest.mark.parametrize(
    ("slowest", "speed", "answer"),
    [(0.1, None, "pass"), (31.0, None, "warning"), (1.0, 0.1, "pass"), (None, None, "warning")],
)
def test_poses_that_come_late_are_told(slowest: float | None, speed: float | None, answer: str) -> None:
    took = {"median": 0.05, "p95": 0.06, "max": 0.07}
    sound = ended({"latencySeconds": took})
    metrics = {"latencySeconds": took | {"max": slowest}} if slowest is not None else {}
    slow = ended(metrics, spec={"input": {"rate": speed}})
    found = latency([sound, slow] if metrics else [slow])
    assert found.answer == answer
    if slowest is not None:
        assert f"{slowest:.3f} s (max)" in found.found


def said(deterministic: str, *ends: Any) -> tuple[str, str]:
    found = stepped(SimpleNamespace(deterministic=deterministic), NODE, ends)  # type: ignore[arg-type]
    return found.answer.value, found.found


def test_frame_by_frame_is_equal_or_differs() -> None:
    sound = {"framesWaitedForInVain": 0}
    equal = (ended(sound), ended(sound))
    told = "2 runs are equal to the byte; 0 of 180 frames had no pose after 2s"
    assert said("No", *equal) == ("pass", told)
    other = (ended(sound), ended(sound, moved=0.5))
    told = "2 runs differ by up to 0.5 m; 0 of 180 frames had no pose after 2s"
    assert said("No", *other) == ("warning", told)
    assert said("Yes", *other) == ("fail", told)


def test_frames_without_poses_are_told() -> None:
    answer, told = said("Yes", *(ended({"framesWaitedForInVain": 40}) for _ in range(2)))
    assert answer == "warning"
    assert "80 of 180 frames had no pose after 2s" in told


def test_what_fails_frame_by_frame_is_told() -> None:
    failed = ended({}, phase=Phase.FAILED, reason=Reason.ALGORITHM_FAILED, message="it is lost")
    answer, told = said("No", failed, failed)
    assert answer == "fail"
    assert told == "2 of 2 failed: AlgorithmFailed: it is lost"
