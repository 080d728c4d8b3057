# SPDX-License-Identifier: Apache-2.0
"""Measures of columns: their names for axes and heads, their units, and which way is good."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.analysis import measures
from slamhive.analysis.flattening import CORE_COLUMNS, spread
from slamhive.analysis.measures import Better, follows_trajectory, is_error, measure_of
from slamhive.analysis.measuring import Subject, measure
from slamhive.analysis.metrics import Metric, label_of, name_of, title_of
from slamhive.model.evaluation import EvaluationSettings
from slamhive.model.reported import ErrorFigures
from slamhive.model.sensors import SensorMode
from slamhive_eval import (
    Confidence,
    ControlPoints,
    Piece,
    Preparation,
    Relations,
    TimeOffset,
    Trajectory,
    evaluate_health,
)
from slamhive_eval.statistics import STATISTICS

if TYPE_CHECKING:
    import numpy.typing as npt


@pytest.mark.parametrize(
    ("column", "label", "title"),
    [
        ("ate.rmse", "ATE RMSE [m]", "ATE [m]"),
        ("ate.std", "ATE standard deviation [m]", "ATE standard deviation [m]"),
        ("rpe[0].rmse", "RPE RMSE [m]", "RPE [m]"),
        ("rpe[1].median", "RPE 2 median [m]", "RPE 2 median [m]"),
        ("rpe[0].rotationDeg.max", "RPE of rotation maximum [°]", "RPE of rotation maximum [°]"),
        ("ateRotationDeg.rmse", "ATE of rotation RMSE [°]", "ATE of rotation RMSE [°]"),
        ("beside.keyframes.ate.rmse", "ATE RMSE of keyframes [m]", "ATE RMSE of keyframes [m]"),
        ("relations.translation.mean", "error over relations mean [m]", "relations [m]"),
        ("relations.rotationDeg.mean", "error over relations of rotation mean [°]", "relations [°]"),
        ("input.frameRate", "frame rate [Hz]", "frame rate [Hz]"),
        ("usage.cpu.meanCores", "mean CPU load [cores]", "CPU [cores]"),
        ("parameters.nFeatures", "nFeatures", "nFeatures"),
        ("metrics.trackingSeconds", "metrics.trackingSeconds [s]", "metrics.trackingSeconds [s]"),
        ("coverage", "coverage", "coverage"),
    ],
)
def test_axes_and_heads(column: str, label: str, title: str) -> None:
    assert (label_of(column), title_of(column)) == (label, title)


def test_units_as_shown() -> None:
    assert Metric.parse("ate.rmse:cm").label == "ATE RMSE [cm]"
    assert Metric.parse("usage.memory.peakBytes").label == "peak memory [MiB]"
    assert label_of("coverage", "%") == "coverage [%]"


def test_settings_of_one_name_stay_apart() -> None:
    names = ("parameters.rate", "input.rate")
    assert label_of("parameters.rate", among=names) == "parameters.rate"
    assert label_of("parameters.rate", among=names[:1]) == "rate"


def test_every_figure_that_each_run_has_is_called_something() -> None:
    figures = [name for name in CORE_COLUMNS if name.startswith(("usage.", "frames.", "ate.", "input."))]
    assert [name for name in figures if name_of(name).text == name] == []


TIMES = np.arange(0.0, 60.0, 0.5)


def line(times: npt.NDArray[np.float64]) -> Trajectory:
    """Return the trajectory of a body that goes straight on, and turns about its way."""
    positions = np.column_stack((times, np.sin(times), np.cos(times)))
    return Trajectory(times, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1)))


@pytest.mark.parametrize("pieces", [None, [Piece(0, 20, "a"), Piece(21, 60, "b")]])
@pytest.mark.parametrize(
    "reference",
    [
        line(TIMES),
        ControlPoints.of(line(TIMES[::20])),
        Relations(TIMES[:-2], TIMES[2:], line(TIMES).positions[:-2], line(TIMES).quaternions[:-2]),
    ],
)
def test_every_number_that_the_evaluator_finds_has_a_row(
    reference: Trajectory | ControlPoints | Relations, pieces: list[Piece] | None
) -> None:
    """A new figure is given its direction in the table, or nothing could say which runs are better by it."""
    settings = EvaluationSettings.model_validate({"rpe": [{"delta": 1}, {"delta": 5, "unit": "s"}]})
    result = measure(reference, line(TIMES), settings, Subject(SensorMode.LIDAR), pieces=pieces)
    found: dict[str, Any] = {}
    spread(
        found, "", [result.values, {"coverage": result.coverage, "clock": TimeOffset(0, 0, 0, 1).as_dict()}]
    )
    numbers = [name for name, values in found.items() if any(type(one) in {int, float} for one in values)]
    assert len(numbers) > 15
    assert [name for name in numbers if measures._listed(measures.BESIDE.sub(r"\2", name)) is None] == []


def test_every_figure_of_health_has_a_row() -> None:
    flags = np.where(TIMES < 20, 2, 0).astype(np.int8)
    covariances = TIMES, np.tile(np.eye(6), (len(TIMES), 1, 1))
    found: dict[str, Any] = {}
    told = evaluate_health(
        line(TIMES),
        line(TIMES).select(np.flatnonzero(TIMES < 40)),
        Preparation(alignment="se3"),
        said=Confidence(TIMES, TIMES, flags),
        covariances=covariances,
    )
    spread(found, "", [{"health": told["health"]}])
    numbers = [name for name, values in found.items() if any(type(one) in {int, float} for one in values)]
    assert len(numbers) > 20
    assert [name for name in numbers if measures._listed(name) is None] == []
    assert not any(is_error(name) for name in numbers)


@pytest.mark.parametrize("statistic", STATISTICS)
def test_statistics_are_known_of_every_error(statistic: str) -> None:
    for error in ("ate", "rpe[3]", "relations.byTime[2].rotationDeg", "beside.online.ate"):
        measure = measure_of(f"{error}.{statistic}")
        assert (measure.is_error, measure.better) == (True, Better.LOWER)
        assert measure.unit.removesuffix("²") in {"m", "°"}
    assert statistic in ErrorFigures.model_fields
    assert f"ate.{statistic}" in CORE_COLUMNS


@pytest.mark.parametrize(
    "column", ["metrics.fps", "endErrorMetres", "ate.p95", "drift", "parameters.k", "rpe[0].count"]
)
def test_nobody_has_said_which_way_is_good(column: str) -> None:
    measure = measure_of(column)
    assert (measure.is_error, measure.better, measure.sign) == (False, Better.NONE, 1.0)
    assert measure.text == column


def test_equal_trajectories_have_equal_errors_but_not_those_beside() -> None:
    assert follows_trajectory("ate.rmse")
    assert is_error("beside.online.ate.rmse")
    assert not follows_trajectory("beside.online.ate.rmse")
    assert measure_of("beside.online.coverage").better is Better.HIGHER
