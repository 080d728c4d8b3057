# SPDX-License-Identifier: Apache-2.0
"""Names of columns as people call them: one table for axes and heads."""

from __future__ import annotations

import pytest

from slamhive.analysis.flattening import CORE_COLUMNS
from slamhive.analysis.metrics import Metric
from slamhive.analysis.names import label_of, name_of, title_of


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
    assert [name for name in figures if name_of(name).text == name] == ["ate.sse"]
