# SPDX-License-Identifier: Apache-2.0
"""Common support: runs measured again over the time in which all of them have poses.

Dashboard and report use it.

An error over a run's own poses is that of the ground it covered: one that lost track before the hard part
may look better than one that went through it. Over the support that all share they are compared alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.statistics import average_ranks, median_of_sorted
from slamhive_eval import AssociationError, EvaluationError, common_support, evaluate, within

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.columns import Floats
    from slamhive_eval import Evaluation, Options, Trajectory


@dataclass(frozen=True, eq=False)
class Common:
    """Errors of several estimates of one recording over the time in which all of them have poses.

    Attributes:
        spans: first and last times in s, ascending, (k, 2); (0, 2) where there is no common time.
        metres: path of the ground truth meanwhile.
        share: of the ground truth's whole path, 0 … 1.
        evaluations: of each estimate over that time, aligned anew; None where that can't be done.
    """

    spans: Floats
    metres: float
    share: float
    evaluations: list[Evaluation | None]

    @property
    def seconds(self) -> float:
        """Length of the spans in s."""
        return float(np.sum(self.spans[:, 1] - self.spans[:, 0]))


def measure_in_common(
    reference: Trajectory, estimates: Sequence[Trajectory], options: Sequence[Options]
) -> Common:
    """Measure estimates over the time in which all of them have poses.

    Args:
        reference: ground truth.
        estimates: one or more, on the ground truth's clock.
        options: how to measure each.
    """
    try:
        spans = common_support(estimates)
    except AssociationError:
        return Common(np.empty((0, 2)), 0.0, 0.0, [None] * len(estimates))
    path = np.interp(spans, reference.stamps, reference.distances)
    metres = float(np.sum(path[:, 1] - path[:, 0]))
    whole = float(reference.distances[-1])
    return Common(
        spans,
        metres,
        metres / whole if whole else 0.0,
        [_measured(reference, one, spans, how) for one, how in zip(estimates, options, strict=True)],
    )


def _measured(
    reference: Trajectory, estimate: Trajectory, spans: Floats, options: Options
) -> Evaluation | None:
    try:
        return evaluate(reference, within(estimate, spans), options)
    except EvaluationError:
        return None


def ranked_medians(figures: Sequence[Sequence[float]]) -> tuple[Floats, Floats]:
    """Return the medians of competitors' figures and their ranks from 1, (n,) each.

    Args:
        figures: of the runs of each competitor; not finite for a failed run, which is ranked last.
    """
    medians = np.array(
        [
            median_of_sorted(np.sort(np.where(np.isfinite(values), values, np.inf)))
            for values in (np.asarray(one, dtype=np.float64) for one in figures)
        ]
    )
    return medians, average_ranks(medians)
