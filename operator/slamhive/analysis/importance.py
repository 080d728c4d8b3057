# SPDX-License-Identifier: Apache-2.0
"""Importance of settings: how much of a figure's variance each one explains, within one subject.

The dashboard shows it.

A subject is an algorithm with its sensors on a dataset, under one set of facets. The variance is that of the
logarithm, as errors are multiplied by settings, not added to. A setting's share is η², the sum of squares
between its values over that of all; an interaction is what a pair of settings explains beyond both alone.
η² favours settings with many values: ε² (Kelley 1935) is corrected for that, and what is shown. Samples that
a search chose by their result are left out, as they are no fair picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.grouping import (
    SUBJECT,
    Copies,
    Groups,
    Outcomes,
    apart,
    copy_notes,
    counting,
    disturbance_notes,
    sound,
    varying,
    without_chosen,
    worst,
)
from slamhive.analysis.measures import follows_trajectory
from slamhive.analysis.statistics import rank_correlation

if TYPE_CHECKING:
    import numpy.typing as npt

    from slamhive.analysis.columns import Floats, Mask
    from slamhive.analysis.frame import Frame

LEAST_RUNS = 8
MAX_PARAMETERS = 60
MAX_INTERACTIONS = 10
MAX_SUBJECTS = 200


@dataclass(frozen=True)
class Influence:
    """Influence of one setting on a metric: shares of variance that it explains, and rank correlation.

    Attributes:
        name: its column.
        distinct: number of its values.
        variance: share of the variance of the logarithm that it explains alone, 0 … 1.
        rank_correlation: Spearman's, −1 … 1; None where its values have no order.
        failures: share of the variance of failing or not that it explains.
    """

    name: str
    distinct: int
    variance: float
    rank_correlation: float | None
    failures: float


@dataclass(frozen=True)
class Interaction:
    """Share of the variance that two settings explain together beyond what each explains alone."""

    a: str
    b: str
    variance: float


@dataclass(frozen=True)
class Influences:
    """Importance of the settings of one subject: influence of each, and interactions of pairs.

    Attributes:
        keys: the subject.
        runs, n: runs, and different results of those with a figure that counts.
        copies: runs that repeat a result of their setting.
        influences: the strongest first.
        interactions: of the strongest settings, the strongest first.
        unexplained: share that no shown setting and interaction explains: other ones and repetition.
    """

    keys: dict[str, Any]
    runs: int
    n: int
    copies: int
    influences: list[Influence]
    interactions: list[Interaction]
    unexplained: float


def importance(frame: Frame, metric: str = "ate.rmse") -> tuple[list[Influences], list[str]]:
    """Return the influences of settings on a metric for each subject, and notes.

    Args:
        frame: one row a run and evaluation.
        metric: a column of numbers.
    """
    frame, notes = without_chosen(frame)
    frame, facets = apart(frame, SUBJECT, [metric])
    names = [name for name in varying(frame) if not name.startswith("dataset.")][:MAX_PARAMETERS]
    groups = Groups(frame, [*facets, *SUBJECT])
    counted = counting(frame, Outcomes.TRACKED) & sound(frame, metric)
    copies = np.zeros(len(frame), dtype=bool)
    if follows_trajectory(metric):
        # Equal results of one setting are one; of two settings they say that it doesn't matter.
        settings = Groups(frame, [*groups.names, *names])
        copies = Copies(frame, Outcomes.TRACKED).among(settings.of_row, groups.of_row)
    numbers = frame.column(metric).floats()
    logarithms = np.full(len(frame), np.nan)
    positive = counted & (numbers > 0) & ~copies
    logarithms[positive] = np.log(numbers[positive])
    failed = worst(frame, metric, Outcomes.TRACKED) & ~copies
    repeating = counted & copies
    subjects: list[Influences] = []
    small = 0
    for rows, keys in zip(groups.members(), groups.keys, strict=True):
        if int((~np.isnan(logarithms[rows])).sum()) < LEAST_RUNS:
            small += 1
        elif len(subjects) < MAX_SUBJECTS:
            found = _subject(frame.select(rows), keys, names, logarithms[rows], failed[rows])
            subjects.append(replace(found, copies=int(np.count_nonzero(repeating[rows]))))
    if small:
        notes.append(f"{small} subjects with fewer than {LEAST_RUNS} results of tracked runs are left out")
    notes += copy_notes(int(np.count_nonzero(repeating)), [metric])
    return subjects, [*notes, *disturbance_notes(frame, [metric])]


def _subject(
    inside: Frame, keys: dict[str, Any], names: list[str], logarithms: Floats, failing_: Mask
) -> Influences:
    known = ~np.isnan(logarithms)
    values = logarithms[known]
    judged = known | failing_  # what the machine ended says nothing of a setting
    failed = failing_[judged].astype(np.float64)
    codes: dict[str, npt.NDArray[np.int32]] = {}
    influences = []
    for name in names:
        column = inside.column(name)
        places, distinct = column.factorized()
        if len(distinct) < 2:
            continue
        codes[name] = places[known]
        order = column.floats()[known]
        ordered = len(values) > 2 and not np.isnan(order).any()
        influences.append(
            Influence(
                name,
                len(distinct),
                explained(places[known], values),
                rank_correlation(order, values) if ordered else None,
                explained(places[judged], failed),
            )
        )
    influences.sort(key=lambda influence: -influence.variance)
    strongest = [influence.name for influence in influences[:5]]
    shares = {influence.name: influence.variance for influence in influences}
    interactions = [
        Interaction(a, b, max(0.0, together - shares[a] - shares[b]))
        for a, b in combinations(strongest, 2)
        if (together := explained(_crossed(codes[a], codes[b]), values)) > 0
    ]
    interactions.sort(key=lambda interaction: -interaction.variance)
    told = sum(shares.values()) + sum(interaction.variance for interaction in interactions)
    return Influences(
        keys, len(inside), len(values), 0, influences, interactions[:MAX_INTERACTIONS], max(0.0, 1.0 - told)
    )


def _crossed(a: npt.NDArray[np.int32], b: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    return a * (int(b.max(initial=0)) + 1) + b


def explained(codes: npt.NDArray[np.integer[Any]], values: Floats) -> float:
    """Return the share of the variance of values, (n,), between groups, corrected for chance (ε²), 0 … 1."""
    _, places, counts = np.unique(codes, return_inverse=True, return_counts=True)
    total = float(((values - values.mean()) ** 2).sum()) if len(values) else 0.0
    groups, count = len(counts), len(values)
    if groups < 2 or count <= groups or total <= 1e-24 * max(1.0, float((values**2).sum())):
        return 0.0
    means = np.bincount(places, values) / counts
    within = float(((values - means[places]) ** 2).sum())
    share = 1 - within / (count - groups) / (total / (count - 1))
    return min(1.0, max(0.0, share)) if math.isfinite(share) else 0.0
