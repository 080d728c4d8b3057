# SPDX-License-Identifier: Apache-2.0
"""The clock of a dataset: the zero that all pictures of its runs share, and programs by that clock."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from slamhive.dashboard.artifacts import TooLarge, first_of
from slamhive.dashboard.problems import Missing
from slamhive.model.algorithm import Pace

if TYPE_CHECKING:
    from collections.abc import Mapping

    from slamhive.analysis.columns import Floats
    from slamhive.dashboard.artifacts import Place
    from slamhive.dashboard.truths import Truth
    from slamhive.model.results import RunRecord
    from slamhive_eval import Trajectory

_CONFIGURATIONS = ("config.yaml", "run/config.yaml")
_LATENCIES = ("output/latency.csv", "run/output/latency.csv")
_MAX_CONFIGURATION = 2**20


@dataclass(frozen=True)
class Clock:
    """Where time begins in pictures.

    Attributes:
        start: sensor time of the zero, s.
        of: what begins there: recording, groundTruth, or estimate where neither is known.
    """

    start: float
    of: str

    def as_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"start": self.start, "of": self.of}


def configuration_of(place: Place) -> dict[str, Any]:
    """Return what a run was told, empty where that can't be read."""
    try:
        _, content = first_of(place, _CONFIGURATIONS)
        found = yaml.safe_load(content) if len(content) <= _MAX_CONFIGURATION else None
    except (Missing, TooLarge, yaml.YAMLError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def clock_of(
    configuration: Mapping[str, Any], truth: Truth | None = None, poses: Trajectory | None = None
) -> Clock | None:
    """Return the clock of a run's dataset, None where nothing is known of it.

    A run that left out the beginning of the recording has the zero of those that did not, up to a frame.

    Args:
        configuration: what the run was told.
        truth: ground truth of the dataset.
        poses: what the run wrote.
    """
    start = _number(configuration, "dataset", "startTime")
    if start is not None:
        return Clock(start - (_number(configuration, "input", "start") or 0.0), "recording")
    if truth is not None:
        return Clock(float(truth.poses.stamps[0]), "groundTruth")
    return Clock(float(poses.stamps[0]), "estimate") if poses is not None else None


def sensor_times(
    since_start: Floats, record: RunRecord, place: Place, configuration: Mapping[str, Any]
) -> Floats | None:
    """Return the sensor times at which samples of a run's load were taken, (n,) in s; None where unknown.

    Known in real time alone, where the player noted by the wall clock when it played each frame. In
    lockstep a program takes whatever time it needs for a frame, and nobody notes it.

    Args:
        since_start: s since the program's start, (n,).
        record: the run.
        place: its folder.
        configuration: what it was told.
    """
    rate = _number(configuration, "input", "rate") or 1.0
    given = configuration.get("input")
    pace = given.get("pace") if isinstance(given, dict) else None
    if pace != Pace.REALTIME.value or record.started is None or record.usage is None:
        return None
    try:
        _, content = first_of(place, _LATENCIES)
        lines = content.decode("ascii").splitlines()[1:]
        table = np.array([line.split(",")[:2] for line in lines], dtype=np.float64)
    except (Missing, TooLarge, ValueError):
        return None
    if table.ndim != 2 or table.shape[1] != 2 or not np.isfinite(table).all():
        return None
    began = record.started.timestamp()
    stamps, arrivals = table[:, 0], table[:, 1] - began
    # The median frame: single ones may have been late.
    return since_start * rate + float(np.median(stamps - arrivals * rate))


def _number(configuration: Mapping[str, Any], part: str, name: str) -> float | None:
    """Return a finite number of a configuration that anyone may have written."""
    held = configuration.get(part)
    value = held.get(name) if isinstance(held, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    number = float(value) if abs(value) < 1e300 else math.inf
    return number if math.isfinite(number) else None
