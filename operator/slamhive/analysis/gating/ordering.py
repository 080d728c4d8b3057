# SPDX-License-Identifier: Apache-2.0
"""Order of a gate's runs: one of each setting, then repetitions of those that tell most of what is open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.gating.deciding import GateAnswer
from slamhive.analysis.gating.figures import FAILURES
from slamhive.analysis.gating.testing import shift_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.gating.cells import GateCell
    from slamhive.analysis.gating.deciding import GateFinding

_LEAST_BATCH = 2
"""Runs between two looks at least: each look costs a part of what may be spent."""


def next_runs(
    cells: Sequence[GateCell],
    findings: Sequence[GateFinding],
    most: int,
    planned: Sequence[int] | None = None,
) -> dict[int, int]:
    """Return the number of runs of each cell to do before the next look; empty where none may tell more.

    Args:
        cells: with their runs so far.
        findings: of the last look, empty before the first.
        most: runs of a cell at most.
        planned: runs of each cell that were done or tried, default: those it has.
    """
    counts = list(planned or [cell.now.count for cell in cells])
    if not findings:
        return {number: 1 for number, count in enumerate(counts) if not count}
    waiting = [one for one in findings if one.answer is GateAnswer.UNKNOWN and one.mends]
    if not waiting:
        return {}
    wanted: dict[int, int] = {}

    def take(number: int, count: int) -> None:
        count = min(count, most - counts[number])
        if count > 0:
            wanted[number] = wanted.get(number, 0) + count
            counts[number] += count

    for number in dict.fromkeys(cell for one in waiting for cell in one.cells):
        take(number, max(1, counts[number]))  # twice as many as there are
    weights = _weights(cells, waiting)
    for _ in range(max(0, max(_LEAST_BATCH, (len(cells) + 1) // 2) - sum(wanted.values()))):
        gains = [
            weight / (count * (count + 1)) if count < most else -1.0
            for weight, count in zip(weights, np.maximum(counts, 1).tolist(), strict=True)
        ]
        best = int(np.argmax(gains))
        if gains[best] < 0:
            break
        take(best, 1)
    return wanted


def _weights(cells: Sequence[GateCell], waiting: Sequence[GateFinding]) -> list[float]:
    """Return the weight of each cell's variance in the open figures, by their margins, (cells,)."""
    found = np.full(len(cells), 1e-9)
    for one in waiting:
        if one.figure.name == FAILURES:
            found += 0.1  # any run tells as much of them
            continue
        shift = shift_of(one.figure, cells)
        shares = np.zeros(len(cells))
        for cell in shift.cells if shift is not None else ():
            shares[cell.cell] = cell.variance or 0.0
        found += shares / one.figure.bound**2
    return found.tolist()
