# SPDX-License-Identifier: Apache-2.0
"""The clock of a dataset: the zero that all pictures of its runs share, and programs by that clock."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from slamhive.model.algorithm import Pace
from slamhive.runfiles.errors import FileMissingError, FileTooLargeError
from slamhive.runfiles.numberfiles import read_numbers, stacked

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

    from slamhive.analysis.columns import Floats
    from slamhive.model.results import RunRecord
    from slamhive.runfiles.artifacts import ArtifactFolder
    from slamhive.runfiles.ground_truth import DatasetTruth
    from slamhive_eval import Trajectory

CONFIGURATIONS = ("config.yaml", "run/config.yaml")
LATENCIES = ("output/latency.csv", "run/output/latency.csv")
_MAX_CONFIGURATION = 2**18
_MAX_VALUES = 20_000
_MAX_DEPTH = 50
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Ten times as fast, where PyYAML was built with it."""


@dataclass(frozen=True)
class Clock:
    """Zero of the time axis in a run's pictures, in sensor time.

    Attributes:
        start: sensor time of the zero, s.
        of: what begins there: recording, groundTruth, or estimate where neither is known.
    """

    start: float
    of: str

    def as_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"start": self.start, "of": self.of}


def configuration_of(place: ArtifactFolder) -> dict[str, Any]:
    """Return the configuration of a run, empty where it can't be read: the run itself may have written it."""
    for name in CONFIGURATIONS:
        try:
            content = place.read(name, _MAX_CONFIGURATION)
            found = yaml.load(content, _LOADER) if _is_small(content) else None  # noqa: S506 - a safe one
        except FileMissingError:
            continue
        except (FileTooLargeError, yaml.YAMLError, ValueError, RecursionError):
            break
        return found if isinstance(found, dict) else {}
    return {}


def _is_small(content: bytes) -> bool:
    """Tell whether a document is small and flat, with all that its aliases stand for."""
    sizes: dict[str, int] = {}
    opened: list[tuple[str | None, int]] = []
    total = 0
    for number, event in enumerate(yaml.parse(content, _LOADER)):
        if isinstance(event, yaml.AliasEvent):
            total += sizes.get(event.anchor or "", _MAX_VALUES + 1)  # within itself: no end
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append((event.anchor, total))
            total += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = opened.pop()
            if anchor is not None:
                sizes[anchor] = total - before
        elif isinstance(event, yaml.ScalarEvent):
            total += 1
            if event.anchor is not None:
                sizes[event.anchor] = 1
        if max(total, number) > _MAX_VALUES or len(opened) > _MAX_DEPTH:
            return False
    return True


def clock_of(
    configuration: Mapping[str, Any], truth: DatasetTruth | None = None, poses: Trajectory | None = None
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
    since_start: Floats, record: RunRecord, place: ArtifactFolder, configuration: Mapping[str, Any]
) -> Floats | None:
    """Return the sensor times at which samples of a run's load were taken, (n,) in s; None where unknown.

    Known of runs that were played to, where the player noted by the wall clock when it played each frame. In
    Lockstep a program takes whatever time it needs for a frame, and nobody notes it; in Stepped sensor time
    stands before a frame while the last one is worked on.

    Args:
        since_start: s since the program's start, (n,).
        record: the run.
        place: its folder.
        configuration: what it was told.
    """
    rate = _number(configuration, "input", "rate") or 1.0
    given = configuration.get("input")
    pace = given.get("pace") if isinstance(given, dict) else None
    if pace not in [one.value for one in Pace if one.is_played]:
        return None
    if record.started is None or record.usage is None:
        return None
    try:
        table = read_numbers(place, LATENCIES, _arrivals, headed=True).rows
    except (FileMissingError, FileTooLargeError, ValueError):
        return None
    if not len(table) or not np.isfinite(table).all():
        return None
    began = record.started.timestamp()
    stamps, arrivals = table[:, 0], table[:, 1] - began
    if pace == Pace.STEPPED.value:
        return _stepped(since_start, stamps, arrivals, rate)
    # The median frame: single ones may have been late.
    return since_start * rate + float(np.median(stamps - arrivals * rate))


def _stepped(since_start: Floats, stamps: Floats, arrivals: Floats, rate: float) -> Floats:
    """Return sensor times between frames, each of which was played when it was its turn, (n,) in s.

    Before a frame time stands, and then goes on as the clock does; beyond the first and last frame too.

    Args:
        since_start: s since the program's start, (n,).
        stamps: of the frames, s, (k,).
        arrivals: when they were played, s since the program's start, (k,).
        rate: speed of playback.
    """
    order = np.argsort(arrivals, kind="stable")
    stamps, arrivals = stamps[order], arrivals[order]
    last = np.maximum(np.searchsorted(arrivals, since_start, side="right") - 1, 0)
    following = np.append(stamps[1:], np.inf)
    found: Floats = np.minimum(stamps[last] + (since_start - arrivals[last]) * rate, following[last])
    return found


def _arrivals(lines: bytes) -> npt.NDArray[np.float64]:
    """Return stamp and arrival of some frames, (k, 2).

    Raises:
        ValueError: a line has no such two.
    """
    rows = [[float(part) for part in line.split(b",")[:2]] for line in lines.splitlines()]
    if any(len(row) != 2 for row in rows):
        raise ValueError("a line without two numbers")
    return stacked(rows, 2)


def _number(configuration: Mapping[str, Any], part: str, name: str) -> float | None:
    """Return a finite number of a configuration that anyone may have written."""
    held = configuration.get(part)
    value = held.get(name) if isinstance(held, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    number = float(value) if abs(value) < 1e300 else math.inf
    return number if math.isfinite(number) else None
