# SPDX-License-Identifier: Apache-2.0
"""Tests of the checks of an Algorithm's declarations: true, false, or impossible to tell."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from slamhive.analysis.measuring import Subject, measure
from slamhive.conformance.findings import Answer
from slamhive.conformance.readings import Declared, Fit, _compared, inverse, readings
from slamhive.model.algorithm import Output
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.sensors import SensorMode
from slamhive_eval import read_tum

TRAJECTORIES = Path(__file__).resolve().parents[3] / "shared" / "data" / "trajectories"


@pytest.mark.parametrize(
    ("own", "others", "answer", "words"),
    [
        (Fit(0.01, 0.5), {"body": Fit(0.30, 0.5)}, Answer.PASS, "the next best, body: 0.3000 m"),
        (Fit(0.01, 0.5), {"body": Fit(0.01, 90.0)}, Answer.PASS, "90.00°"),
        (Fit(0.30, 0.5), {"body": Fit(0.01, 0.5)}, Answer.FAIL, "body fits better: 0.0100 m"),
        (Fit(0.30, 0.5), {"imu": Fit(0.02, 0.5), "body": Fit(0.01, 0.5)}, Answer.FAIL, "body fits better"),
        (Fit(0.3056, 1.0), {"body": Fit(0.3007, 1.0)}, Answer.WARNING, "body fits about as well: 0.3007 m"),
        (Fit(0.30, 0.5), {"body": Fit(0.01, 90.0)}, Answer.WARNING, "body fits about as well"),
        (Fit(0.01, 0.5), {}, Answer.PASS, "there is no other to compare with"),
        (Fit(0.01, math.inf), {"body": Fit(0.30, math.inf)}, Answer.PASS, "body"),
    ],
)
def test_what_is_declared_against_what_else_it_could_be(
    own: Fit, others: dict[str, Fit], answer: Answer, words: str
) -> None:
    found = _compared("frame", "frame lidar", own, others, "declare {}")
    assert found.answer is answer
    assert words in found.found


def test_a_drift_that_hides_what_a_shift_does_can_not_be_told() -> None:
    found = _compared(
        "stamp", "stamp Header", Fit(5.0, 1.0), {"+0.05 s": Fit(1.0, 0.1)}, "stamp {}", hidden=True
    )
    assert found.answer is Answer.WARNING
    assert "the drift is too large to tell" in found.found


@pytest.mark.parametrize(
    ("inverted", "answer", "words"),
    [(False, Answer.PASS, "poses not inverted: "), (True, Answer.FAIL, "; the inverse fits better: 0.0")],
)
def test_poses_that_are_inverted_are_told_by_the_ground_truth(
    *, inverted: bool, answer: Answer, words: str
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
