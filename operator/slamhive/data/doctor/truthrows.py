# SPDX-License-Identifier: Apache-2.0
"""Rows of the ground truth that hold no pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slamhive.data.doctor.findings import Finding, Severity
from slamhive.model.variant import TRUTH

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.data.doctor.examined import Examined


def judge_truth_rows(examined: Examined) -> Iterator[Finding]:
    """Yield a note on rows of the ground truth that hold NaN: they are left out."""
    truth = examined.truth
    if truth is None or not truth.nan_rows:
        return
    count, total = truth.nan_rows, truth.nan_rows + len(truth)
    hold, were = ("holds", "was") if count == 1 else ("hold", "were")
    yield Finding(
        code="truth.nan",
        severity=Severity.NOTE,
        message=f"groundTruth: {count} of {total} rows {hold} NaN and {were} left out; where poses are then "
        "more than 1 s apart no run is measured",
        sensor=TRUTH,
        count=count,
        value=count / total,
    )
