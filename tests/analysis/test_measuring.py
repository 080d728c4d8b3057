# SPDX-License-Identifier: Apache-2.0
"""Measuring against relations: the run's own window, and the offset of its clock."""

from __future__ import annotations

import numpy as np
import pytest

from slamhive.analysis.measuring import Subject, measure
from slamhive.model.errors import InputError
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.results import Outcome
from slamhive.model.sensors import SensorMode
from slamhive_eval import Piece, Relations, Trajectory

TIMES = np.arange(0.0, 100.0)


def line(times: np.ndarray, shift: float = 0.0) -> Trajectory:
    positions = np.column_stack((times, np.zeros((len(times), 2))))
    return Trajectory(times + shift, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1)))


RELATIONS = Relations(
    TIMES[:-1], TIMES[1:], np.tile([1.0, 0.0, 0.0], (99, 1)), np.tile([0.0, 0.0, 0.0, 1.0], (99, 1))
)


def test_relations_outside_of_the_runs_window_are_not_missed() -> None:
    subject = Subject(SensorMode.LIDAR, window=(20.0, 40.0))
    result = measure(RELATIONS, line(TIMES[20:41]), EvaluationSettings(), subject)
    assert (result.coverage, result.outcome) == (1.0, Outcome.TRACKED)
    assert result.values["relations"]["count"] == 20
    with pytest.raises(InputError, match="200"):
        measure(
            RELATIONS, line(TIMES), EvaluationSettings(), Subject(SensorMode.LIDAR, window=(200.0, 300.0))
        )


def test_an_offset_moves_the_estimates_stamps() -> None:
    settings = EvaluationSettings.model_validate({"association": {"offset": 0.5}})
    result = measure(RELATIONS, line(TIMES, -0.5), settings, Subject(SensorMode.LIDAR))
    assert result.coverage == 1.0
    assert result.values["relations"]["translation"]["rmse"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("speed", "outcome"), [(1.0, "Tracked"), (1.5, "Tracked"), (-1.0, "Diverged"), (5.0, "Diverged")]
)
def test_an_estimate_that_is_worse_than_standing_still_has_diverged(speed: float, outcome: str) -> None:
    positions = np.column_stack((speed * TIMES, np.zeros((len(TIMES), 2))))
    estimate = Trajectory(TIMES, positions, line(TIMES).quaternions)
    result = measure(RELATIONS, estimate, EvaluationSettings(), Subject(SensorMode.LIDAR))
    assert result.outcome == outcome
    assert bool(result.values["message"]) == (outcome == "Diverged")


@pytest.mark.parametrize("reference", [RELATIONS, line(TIMES)])
def test_a_run_that_wrote_no_pose_is_lost(reference: Relations | Trajectory) -> None:
    settings = EvaluationSettings.model_validate({"association": {"offset": 1}})
    subject = Subject(SensorMode.LIDAR, window=(20.0, 40.0))
    result = measure(reference, None, settings, subject, pieces=[Piece(0, 59, "a")])
    assert (result.outcome, result.coverage) == (Outcome.LOST, 0.0)
    assert result.values["message"] == "the algorithm wrote no pose"
    if isinstance(reference, Relations):
        assert result.values["relations"]["missing"] == 20
    else:
        assert (result.values["ate"], result.values["pathLength"]) == (None, 20.0)


def test_relations_between_two_maps_are_missed_not_measured() -> None:
    moved = line(TIMES).positions + np.where(TIMES >= 60, 7.0, 0.0)[:, np.newaxis]
    estimate = Trajectory(TIMES, moved, line(TIMES).quaternions)
    pieces = [Piece(0, 59, "a"), Piece(60, 80, "b")]
    settings, subject = EvaluationSettings(), Subject(SensorMode.LIDAR)
    result = measure(RELATIONS, estimate, settings, subject, pieces=pieces)
    assert result.values["relations"]["count"] == 79
    assert result.values["relations"]["translation"]["max"] < 1e-9
    assert result.coverage == pytest.approx(79 / 99)
    whole = measure(RELATIONS, estimate, settings, subject)
    assert whole.values["relations"]["translation"]["max"] > 7
    with pytest.raises(InputError, match="between two poses of one map"):
        measure(
            RELATIONS, estimate, settings, subject, pieces=[Piece(float(k), k + 0.1, str(k)) for k in TIMES]
        )
