# SPDX-License-Identifier: Apache-2.0
"""Repetitions of a configuration: does the same come out again? And scales that are wrong by equal parts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.cells import different
from slamhive.analysis.grouping import SUBJECT, Groups, aggregate, apart, pooling_notes, varying, where_equal
from slamhive.analysis.measures import follows_trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.cells import Cell
    from slamhive.analysis.columns import Floats
    from slamhive.analysis.frame import Frame

LEAST_OFF = 0.01
"""Least distance of a suspect scale from 1."""

MOST_SPREAD = 0.25
"""Spread over deviation up to which scales count as equal: noise would scatter around 1."""

LEAST_RUNS = 3
_SAME = 0.01


@dataclass(frozen=True)
class Repetitions:
    """The runs of one configuration.

    Attributes:
        cell: what they came to.
        distinct: number of different trajectories, equal ones counted once; 0 when none is known.
        figures: the numbers, (k,); errors of different trajectories alone.
        relative_spread: standard deviation over mean of those; None below 2.
    """

    cell: Cell
    distinct: int
    figures: tuple[float, ...]
    relative_spread: float | None

    @property
    def verdict(self) -> str:
        """Summary in a sentence: whether the runs are deterministic, their spread, and failures."""
        parts = []
        if self.cell.deterministic:
            parts.append(f"deterministic: one result, {self.cell.n + self.cell.copies} equal runs")
        if self.relative_spread is not None:
            word = "repeatable" if self.relative_spread <= _SAME else "varies"
            parts.append(f"{word}: {100 * self.relative_spread:.2g} % around the mean")
        if self.cell.failures:
            parts.append(f"{sum(self.cell.failures.values())} of {self.cell.runs} runs failed")
        return "; ".join(parts) or "no figure"


def repeatability(frame: Frame, metric: str = "ate.rmse") -> tuple[list[Repetitions], list[str]]:
    """Return the configurations that ran more than once, those with most runs first, and notes.

    Args:
        frame: one row a run and evaluation.
        metric: a column of numbers.
    """
    changing = varying(frame)
    keys = [*SUBJECT, *(name for name in changing if not name.startswith("dataset.attributes."))]
    frame, facets = apart(frame, keys, [metric])
    all_of_them = Groups(frame, [*facets, *keys])
    alone = int((all_of_them.sizes == 1).sum())
    notes = pooling_notes([name for name in changing if name not in all_of_them.names])
    if alone:
        ran = "configuration" if alone == 1 else "configurations"
        notes = [*notes, f"{alone} {ran} ran once: a single run says nothing of repeatability"]
    frame = frame.select(all_of_them.sizes[all_of_them.of_row] > 1)
    # By the same columns: what is left of the rows might not need all of them, and would be pooled.
    found = aggregate(frame, [metric], all_of_them.names)
    numbers = frame.column(metric).floats()
    trajectories = frame.column("trajectory.sha256")
    counted = frame.column("status")
    repetitions = []
    for cell, rows in zip(found.cells, found.members, strict=True):
        tracked = np.array([counted.values[code] == "Tracked" for code in counted.codes[rows]], dtype=bool)
        inside = rows[tracked & ~np.isnan(numbers[rows])]
        unnamed = trajectories.kind.is_numeric or not follows_trajectory(metric)
        hashes = np.full(len(inside), -1) if unnamed else trajectories.codes[inside]
        kept = different(hashes)
        values = numbers[inside[kept]]
        spread = float(values.std(ddof=1) / values.mean()) if len(values) > 1 and values.mean() else None
        distinct = int((hashes[kept] >= 0).sum())
        repetitions.append(Repetitions(cell, distinct, tuple(values.tolist()), spread))
    repetitions.sort(key=lambda one: -one.cell.runs)
    return repetitions, notes


def spread_within(repetitions: Sequence[Repetitions], names: Sequence[str]) -> dict[tuple[str, ...], float]:
    """Return the standard deviation of repetitions of a setting, over all settings of a group.

    Args:
        repetitions: of `repeatability`.
        names: keys that tell groups apart.
    """
    squares: dict[tuple[str, ...], list[tuple[float, int]]] = {}
    for one in repetitions:
        if len(one.figures) > 1:
            key = tuple(str(one.cell.keys.get(name)) for name in names)
            freedom = len(one.figures) - 1
            squares.setdefault(key, []).append((float(np.var(one.figures, ddof=1)) * freedom, freedom))
    return {
        key: math.sqrt(sum(square for square, _ in found) / sum(freedom for _, freedom in found))
        for key, found in squares.items()
    }


@dataclass(frozen=True)
class Suspect:
    """Runs whose scale is wrong by equal parts.

    Attributes:
        keys: algorithm, sensors, dataset and the facets that vary.
        scale: median scale of the alignment.
        spread: standard deviation.
        n: number of runs.
    """

    keys: dict[str, Any]
    scale: float
    spread: float
    n: int

    @property
    def sentence(self) -> str:
        """Warning of a wrong calibration, with the number of runs, their median scale and its spread."""
        return (
            f"calibration suspect: in {self.n} runs the scale is {self.scale:.4g} ± {self.spread:.2g}; an "
            "algorithm's own error would vary, a wrong calibration or depth factor doesn't"
        )


def suspects(frame: Frame) -> list[Suspect]:
    """Return the subjects whose scale, of a kind that has one, is off 1 by the same factor in all runs."""
    scale = frame.column("scale").floats()
    alignment, sensors = frame.column("alignment"), frame.column("sensors")
    if alignment.kind.is_numeric or sensors.kind.is_numeric:
        return []
    good = alignment.among(("sim3",)) & ~sensors.among(("mono",)) & where_equal(frame, "status", "Tracked")
    inside = frame.select(good & ~np.isnan(scale))
    if not len(inside):
        return []
    numbers = inside.column("scale").floats()
    facets = [name for name in apart(inside, SUBJECT, ())[1] if name in {"evaluation", "input.pace"}]
    alone = _suspects_by(inside, numbers, [*SUBJECT, *facets])
    known = {(item.keys["algorithm"], item.keys["sensors"]) for item in alone}
    # With few runs a dataset, all datasets together may tell.
    together = _suspects_by(inside, numbers, ["algorithm", "sensors", *facets])
    found = [*alone, *(s for s in together if (s.keys["algorithm"], s.keys["sensors"]) not in known)]
    return sorted(found, key=lambda suspect: -abs(suspect.scale - 1))


def _suspects_by(inside: Frame, numbers: Floats, keys_by: list[str]) -> list[Suspect]:
    groups = Groups(inside, keys_by)
    found = []
    for rows, keys in zip(groups.members(), groups.keys, strict=True):
        values = numbers[rows]
        middle, spread = float(np.median(values)), float(values.std(ddof=1)) if len(values) > 1 else np.inf
        off = abs(middle - 1)
        if len(values) >= LEAST_RUNS and off >= LEAST_OFF and spread <= MOST_SPREAD * off:
            found.append(Suspect(keys, middle, spread, len(values)))
    return found
