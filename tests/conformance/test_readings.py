# SPDX-License-Identifier: Apache-2.0
"""Tests of the checks of an Algorithm's declarations: true, false, or impossible to tell."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.analysis.measuring import Subject, measure
from slamhive.conformance.findings import CheckAnswer
from slamhive.conformance.readings import Declared, Fit, _compared, inverse, misread_stamps, readings
from slamhive.model.algorithm import Output
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.sensors import SensorMode
from slamhive_eval import Trajectory, read_tum

if TYPE_CHECKING:
    from collections.abc import Callable

TRAJECTORIES = Path(__file__).resolve().parents[3] / "shared" / "data" / "trajectories"


@pytest.mark.parametrize(
    ("own", "others", "answer", "words"),
    [
        (Fit(0.01, 0.5), {"body": Fit(0.30, 0.5)}, CheckAnswer.PASS, "the next best, body: 0.3000 m"),
        (Fit(0.01, 0.5), {"body": Fit(0.01, 90.0)}, CheckAnswer.PASS, "90.00°"),
        (Fit(0.30, 0.5), {"body": Fit(0.01, 0.5)}, CheckAnswer.FAIL, "body fits better: 0.0100 m"),
        (
            Fit(0.30, 0.5),
            {"imu": Fit(0.02, 0.5), "body": Fit(0.01, 0.5)},
            CheckAnswer.FAIL,
            "body fits better",
        ),
        (
            Fit(0.3056, 1.0),
            {"body": Fit(0.3007, 1.0)},
            CheckAnswer.WARNING,
            "body fits about as well: 0.3007 m",
        ),
        (Fit(0.30, 0.5), {"body": Fit(0.01, 90.0)}, CheckAnswer.WARNING, "body fits about as well"),
        (Fit(0.01, 0.5), {}, CheckAnswer.PASS, "there is no other to compare with"),
        (Fit(0.01, math.inf), {"body": Fit(0.30, math.inf)}, CheckAnswer.PASS, "body"),
    ],
)
def test_what_is_declared_against_what_else_it_could_be(
    own: Fit, others: dict[str, Fit], answer: CheckAnswer, words: str
) -> None:
    found = _compared("frame", "frame lidar", own, others, "declare {}")
    assert found.answer is answer
    assert words in found.found


def test_a_drift_that_hides_what_a_shift_does_can_not_be_told() -> None:
    found = _compared(
        "stamp", "stamp Header", Fit(5.0, 1.0), {"+0.05 s": Fit(1.0, 0.1)}, "stamp {}", hidden=True
    )
    assert found.answer is CheckAnswer.WARNING
    assert "the drift is too large to tell" in found.found


@pytest.mark.parametrize(
    ("inverted", "answer", "words"),
    [
        (False, CheckAnswer.PASS, "poses not inverted: "),
        (True, CheckAnswer.FAIL, "; the inverse fits better: 0.0"),
    ],
)
def test_poses_that_are_inverted_are_told_by_the_ground_truth(
    *, inverted: bool, answer: CheckAnswer, words: str
) -> None:
    """ORB-SLAM on TUM's fr2/desk, as it wrote its poses and as it keeps them inside."""
    if not TRAJECTORIES.is_dir():
        pytest.skip("../shared/data/trajectories is not here")
    truth, estimate = (read_tum(TRAJECTORIES / f"fr2_desk_{name}.txt") for name in ("groundtruth", "ORB"))
    estimate = inverse(estimate) if inverted else estimate
    declared = Declared(SensorMode.RGBD, Output(frame="color"), {"color": np.eye(4)}, 100.0)
    result = measure(truth, estimate, EvaluationSettings(), Subject(SensorMode.RGBD, np.eye(4)))
    found = [finding for finding in readings(declared, truth, estimate, result) if words in finding.found]
    assert [finding.answer for finding in found] == [answer]


@pytest.fixture
def desk() -> tuple[Trajectory, Trajectory, Declared]:
    """Ground truth of TUM's fr2/desk, ORB-SLAM's poses on it, and what is declared of those."""
    if not TRAJECTORIES.is_dir():
        pytest.skip("../shared/data/trajectories is not here")
    truth, estimate = (read_tum(TRAJECTORIES / f"fr2_desk_{name}.txt") for name in ("groundtruth", "ORB"))
    turned = np.eye(4)
    turned[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    turned[:3, 3] = [0.5, 0.2, 0.1]
    frames = {"color": np.eye(4), "body": turned}
    declared = Declared(SensorMode.RGBD, Output(frame="color"), frames, 100.0, estimate.stamps)
    return truth, estimate, declared


@pytest.mark.parametrize(
    ("change", "as_what", "how"),
    [
        (lambda stamps: np.arange(len(stamps)), "frame indices", "stamps: frame-index"),
        (lambda stamps: stamps - stamps[0], "seconds since the first frame", "stamps: s-since-first"),
    ],
)
def test_stamps_that_are_no_sensor_time_are_told_what_they_are(
    change: Callable[[Any], Any], as_what: str, how: str, desk: tuple[Trajectory, Trajectory, Declared]
) -> None:
    truth, estimate, declared = desk
    wrong = Trajectory(change(estimate.stamps), estimate.positions, estimate.quaternions)
    found = misread_stamps(declared, truth, wrong)
    assert found.answer is CheckAnswer.FAIL
    assert f"as {as_what} they fit, 0.0" in found.found
    assert how in found.help


def test_stamps_of_another_day_are_told_to_meet_nothing(
    desk: tuple[Trajectory, Trajectory, Declared],
) -> None:
    truth, estimate, declared = desk
    wrong = Trajectory(estimate.stamps + 86400, estimate.positions, estimate.quaternions)
    found = misread_stamps(declared, truth, wrong)
    assert "no ground truth is near them" in found.found
    assert "header stamp + timeOffset" in found.help


@pytest.mark.parametrize(
    ("share", "answer"), [(0.0, CheckAnswer.FAIL), (0.1, CheckAnswer.FAIL), (0.2, CheckAnswer.WARNING)]
)
def test_poses_of_a_player_that_dropped_frames_are_in_doubt(
    share: float, answer: CheckAnswer, desk: tuple[Trajectory, Trajectory, Declared]
) -> None:
    truth, estimate, declared = desk
    declared = replace(declared, dropped=int(share * len(declared.stamps)))
    wrong = inverse(estimate)
    result = measure(truth, wrong, EvaluationSettings(), Subject(SensorMode.RGBD, np.eye(4)))
    found = {one.check: one for one in readings(declared, truth, wrong, result)}["accuracy"]
    assert (found.answer, "frames dropped" in found.found) == (answer, answer is CheckAnswer.WARNING)


def test_poses_that_are_wrong_in_two_ways_are_told_both(
    desk: tuple[Trajectory, Trajectory, Declared],
) -> None:
    """Those of the colour camera, declared as the body's, and inverted."""
    truth, estimate, declared = desk
    declared = replace(declared, output=Output(frame="body"))
    wrong = inverse(estimate)
    result = measure(truth, wrong, EvaluationSettings(), Subject(SensorMode.RGBD, declared.frames["body"]))
    found = {one.check: one for one in readings(declared, truth, wrong, result)}
    assert found["accuracy"].answer is CheckAnswer.FAIL
    assert found["frame and stamp"].answer is CheckAnswer.FAIL
    assert "the inverse, frame color: 0.0" in found["frame and stamp"].found


def test_stamps_that_are_a_frame_late_are_told(desk: tuple[Trajectory, Trajectory, Declared]) -> None:
    truth, _, declared = desk
    # Without drift, so that a frame shows: the ground truth itself, at the stamps of the frames.
    exact = truth.select(np.arange(0, len(truth.stamps), 3))
    declared = replace(declared, stamps=exact.stamps)
    period = float(np.median(np.diff(exact.stamps)))
    late = Trajectory(exact.stamps + period, exact.positions, exact.quaternions)
    result = measure(truth, late, EvaluationSettings(), Subject(SensorMode.RGBD, np.eye(4)))
    (found,) = [one for one in readings(declared, truth, late, result) if one.check == "stamp"]
    assert found.answer is CheckAnswer.FAIL
    assert "(one frame earlier) fits better: 0.0000 m" in found.found
    assert "one frame earlier" in found.help
