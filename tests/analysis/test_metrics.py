# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers in the units they are shown in."""

from __future__ import annotations

import pytest

from slamhive.analysis import Metric
from slamhive.model.errors import InputError


@pytest.mark.parametrize(
    ("text", "value", "shown", "title"),
    [
        ("ate.rmse", 0.012345, "0.01235", "ATE [m]"),
        ("ate.rmse:cm:.3f", 0.012348, "1.235", "ATE [cm]"),
        ("rpe[1].median:mm", 0.012345, "12.35", "RPE 2 median [mm]"),
        ("beside.online.ate.rmse:cm", 0.012345, "1.234", "ATE, causal [cm]"),
        ("usage.memory.peakBytes", 3 * 2**20, "3", "peak memory [MiB]"),
        ("usage.memory.peakBytes:GB:.2f", 3e9, "3.00", "peak memory [GB]"),
        ("coverage:%:.1f", 0.5, "50.0", "coverage [%]"),
        ("usage.wallSeconds:min", 90.0, "1.5", "wall time [min]"),
        ("usage.cpu.meanCores:.2f", None, "–", "CPU [cores]"),
    ],
)
def test_metrics_are_shown_in_units(text: str, value: float | None, shown: str, title: str) -> None:
    metric = Metric.parse(text)
    assert metric.show(value) == shown
    assert metric.title == title


@pytest.mark.parametrize("text", ["ate.rmse:kg", "ate.sse:cm", "coverage:m", "ate.rmse:3f", "ate.rmse:.999f"])
def test_units_that_do_not_fit(text: str) -> None:
    with pytest.raises(InputError, match="is neither a unit of"):
        Metric.parse(text)
